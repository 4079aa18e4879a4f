"""Estimators of configurations: with the terms of a diagnosis, on trial, and one to compile the loops with."""

from dataclasses import replace

from friction_estimator.added_terms import added_terms
from friction_estimator.core.intake.pairing import FRICTION, VELOCITY
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.online.first_contact import NO_SAMPLES, refined
from friction_estimator.core.online.kernels import GROW_AFTER
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.units import NO_FORCE, NO_VELOCITY
from friction_estimator.ros.stream import SampleStream


def build(config: Config) -> Estimator:
    """Return the estimator of a configuration, with the terms that a diagnosis added."""
    return Estimator(config, added_terms(config))


def without_learned(config: Config) -> Config:
    """Return the configuration for a cold start."""
    return replace(config, learned=type(config.learned)())


def supposed(config: Config) -> Config:
    """Return the configuration with range and units of no meaning where they are open, to try the rest of it."""
    values: dict[str, object] = {}
    if config.reach is None:
        values |= {"learned.velocity_range": (-NO_VELOCITY, NO_VELOCITY), "learned.velocity_scale": NO_VELOCITY}
    if not config.unit_N > 0.0:
        values["learned.force_unit"] = NO_FORCE
    known = config.updated(values)
    if known.is_parallel and known.theory_kind == "auto":
        known = known.updated({"learned.theory": "seal"})
    return known if known.has_theory or not known.finds_stribeck else refined(known, NO_SAMPLES)


def warm_up() -> None:
    """Compile all that samples may need, so that none is late by seconds: neither the first nor a later one."""
    known = [supposed(Config.from_mapping({"theory.kind": kind})) for kind in ("none", "seal", "stribeck")]
    for config in (Config(), *known):
        stream = SampleStream(config, build, lambda *_: None)
        stream.begin(config)
        for stamp_ns in (1, 2):
            stream.event(VELOCITY, stamp_ns, 0.01)
            stream.event(FRICTION, stamp_ns, 1.0)
        if stream.estimator is not None:
            for stamp_ns in range(3, 4 + GROW_AFTER):  # the way of samples that have waited; then the range grows
                stream.estimator.step(stamp_ns, 2.0 * NO_VELOCITY, 1.0)
            stream.estimator.curve()
