"""Which theoretical curve `theory.kind: auto` comes to: the seal where there is one, else a Stribeck curve."""

from dataclasses import dataclass

import numpy as np

from friction_estimator.core.model.theory_seal import SealCurve
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.theory_groups import SealConfig, TheoryConfig

PLAUSIBLE = 10.0
"""Factor between the seal's friction and the measured one, up or down, within which the seal is believed: diameter,
contact width, preload and boundary friction are assumptions, each good to a factor of two."""

SCALE_POINTS = 256


@dataclass(frozen=True)
class Choice:
    """A kind of theoretical curve, and why."""

    kind: str
    reason: str


def has_pressure(samples: Samples) -> bool:
    """Return whether a pressure was recorded with any of the samples."""
    return samples.pressure_Pa is not None and bool(np.isfinite(samples.pressure_Pa).any())


def choice(config: Config, pressure: bool) -> Choice:
    """Return what auto comes to.

    Parameters
    ----------
    config : with range and units known. pressure : whether one is recorded.
    """
    kind = config.theory.kind
    if kind != "auto":
        return Choice(kind, f"theory.kind is {kind}")
    if config.quantities.is_rotary:
        return Choice("stribeck", "the drive is rotary (input.motion)")
    set_ = seal_settings(config)
    if not (pressure or set_):
        return Choice("stribeck", "no pressure is recorded and no seal.* is set")
    why = "a pressure is recorded" if pressure else f"{set_} is set"
    ratio = seal_ratio(config)
    if 1.0 / PLAUSIBLE <= ratio <= PLAUSIBLE:
        return Choice("seal", why)
    return Choice("stribeck", f"{why}, but the seal's friction would be {ratio:.3g} times the measured one")


def seal_settings(config: Config) -> str:
    """Return the first setting that says that there is a seal, or nothing."""
    usual = SealConfig()
    named = [f"seal.{name}" for name, value in vars(config.seal).items() if value != getattr(usual, name)]
    if config.theory.default_pressure != TheoryConfig().default_pressure:
        named.append("theory.default_pressure")
    return named[0] if named else ""


def seal_ratio(config: Config) -> float:
    """Return the rms of the seal's friction over the velocity scale, in units of force: about 1 where it fits."""
    curve = SealCurve(config.seal, config.theory.default_pressure, config.theory.default_temperature)
    return rms_over_unit(config, curve.evaluate(*scale_points(config)))


def scale_points(config: Config) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return velocities over the scale, which stays when the range grows, at the default pressure and temperature."""
    low, high = -config.velocity_scale, config.velocity_scale
    return (
        low + (high - low) * (np.arange(SCALE_POINTS) + 0.5) / SCALE_POINTS,
        np.full(SCALE_POINTS, config.theory.default_pressure),
        np.full(SCALE_POINTS, config.theory.default_temperature),
    )


def rms_over_unit(config: Config, friction_N: np.ndarray) -> float:
    """Return the rms of friction in units of force."""
    return float(np.sqrt(np.mean(np.square(friction_N))) / config.unit_N)


def told(config: Config, pressure: bool) -> str:
    """Return the curve that is used and why, in words."""
    if not config.is_parallel:
        none = config.model.type == "parallel"
        return f"none: {'theory.kind is none, so parallel is run as hammerstein' if none else 'hammerstein has none'}"
    now, used = choice(config, pressure), config.theory_kind
    return f"{used}: {now.reason}" if now.kind == used else f"{used}: as learned"


def warning(config: Config, pressure: bool) -> str:
    """Return what to say of a curve in another drive's units, or not the one of later samples; or nothing."""
    if not config.is_parallel or not config.has_units or config.theory_kind == "auto":
        return ""
    if config.theory_kind == "seal" and config.quantities.is_rotary:
        return (
            "theory.kind is seal on a rotary drive: the curve of a reciprocating rod takes rad/s for m/s and its N for "
            "N m; scale seal.* accordingly, or set theory.kind to stribeck"
        )
    now = choice(config, pressure)
    if now.kind == config.theory_kind or not pressure:
        return ""
    return (
        f"{now.reason}, and the theoretical curve is {config.theory_kind}, as learned without it: ~/reset, or learning "
        f"anew, makes it the {now.kind}; theory.kind settles it"
    )
