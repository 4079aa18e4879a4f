"""Put effects into a trace, in the order of their stages, each of the size asked for."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.sample import Floats
from friction_estimator.effects.base import Effect, Key
from friction_estimator.effects.trace import STAGES, Trace

FINE = STAGES[: STAGES.index("sensor")]


def rms(values: Floats) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def relative_change(effect: Effect, clean: Trace, every: int, seed: int) -> float:
    """Return rms(change of friction) / rms(friction) of one effect on a clean trace, at the recording's rate.

    Parameters
    ----------
    clean : at the simulation's rate, lubricated. every : simulation steps per recorded sample. seed : of the
        effect's own random numbers.
    """
    before = clean.sampled(every) if effect.stage not in FINE else clean
    after = effect.apply(before, np.random.default_rng(seed))
    if effect.stage == "lubrication":
        after = after.lubricated()
    change = effect.change(before, after)
    if effect.stage in FINE:
        change, before = change[::every], before.sampled(every)
    return rms(change) / rms(before.friction_N)


def resolved(effect: Effect, clean: Trace, every: int, seed: int) -> Effect:
    """Return the effect with `size` turned into a value of its size key (a root of `relative_change`).

    Raises
    ------
    ConfigError : the effect has no size, or cannot become that large (or small) on this trace.
    """
    if effect.size is None:
        return effect
    if not effect.size_key:
        raise ConfigError(f"effect {effect.name} changes stamps only and has no size: give its keys")
    key = next(k for k in effect.keys if k.name == effect.size_key)

    def excess(value: float) -> float:
        return relative_change(effect.with_values(**{key.name: value}), clean, every, seed) - effect_size

    effect_size = effect.size
    if effect.linear:
        start = key.default
        gain = relative_change(effect.with_values(**{key.name: start}), clean, every, seed) / start
        value = effect_size / gain if gain > 0.0 else np.inf
        if not value <= key.high:
            raise ConfigError(f"effect {effect.name} cannot reach size={effect_size:g} on this drive")
        if abs(excess(value)) < 1e-6 * effect_size:
            return effect.with_values(**{key.name: value})
        # Another key brings a share of its own: the size is that of both together.
    low, high = _bracket(effect, key, excess)
    from scipy.optimize import brentq  # noqa: PLC0415 - slow to import

    root = float(brentq(excess, low, high, rtol=1e-4, maxiter=60))
    # Where the change jumps (a sample falls into a gap) the two sides differ: the nearer one, in ratio.
    sides = [v for v in (root * (1.0 - 2e-3), root, root * (1.0 + 2e-3)) if key.low <= v <= key.high]
    sizes = [max(excess(v) + effect_size, 1e-300) for v in sides]
    best = min(range(len(sides)), key=lambda i: abs(np.log(sizes[i] / effect_size)))
    return effect.with_values(**{key.name: sides[best]})


def _bracket(effect: Effect, key: Key, excess) -> tuple[float, float]:  # type: ignore[no-untyped-def]
    """Return two values of the key between which `excess` changes its sign, found by steps of a factor of two."""
    value = key.default
    here = excess(value)
    for factor in (2.0, 0.5):
        last, last_excess = value, here
        for _ in range(48):
            step = last * factor
            if not key.low <= step <= key.high or step < 1e-12:
                break
            there = excess(step)
            if last_excess * there <= 0.0:
                return min(last, step), max(last, step)
            if abs(there) > abs(last_excess):
                break
            last, last_excess = step, there
    for edge in (key.low, key.high):
        if edge > 0.0 and excess(edge) * here <= 0.0:
            return min(value, edge), max(value, edge)
    raise ConfigError(f"effect {effect.name} cannot reach size={effect.size:g} on this drive")


def compose(
    clean: Trace, effects: Sequence[Effect], *, noise: Floats | float, every: int, seed: int
) -> tuple[Trace, list[Effect]]:
    """Return the recorded trace with all effects and noise in it, and the effects with their sizes resolved.

    Parameters
    ----------
    clean : plant without effects, lubricated, at the simulation's rate.
    effects : in any order; they act in the order of their stages.
    noise : (n_recorded,) force noise to be added, N; or its standard deviation (white, drawn from `seed`).
    every : simulation steps per recorded sample.
    seed : of everything random.
    """
    seeds = [int(s.generate_state(1)[0]) for s in np.random.SeedSequence(seed).spawn(len(effects) + 1)]
    ready = [resolved(e, clean, every, s) for e, s in zip(effects, seeds[1:], strict=True)]
    trace = clean
    for stage in STAGES:
        if stage == "sensor":
            trace = trace.sampled(every)
            if not isinstance(noise, np.ndarray):
                noise = float(noise) * np.random.default_rng(seeds[0]).standard_normal(trace.time_s.size)
            trace = trace.with_friction(trace.friction_N + noise)
        for effect, own in zip(ready, seeds[1:], strict=True):
            if effect.stage == stage:
                trace = effect.apply(trace, np.random.default_rng(own))
        if stage == "lubrication":
            trace = trace.lubricated()
    return replace(trace), ready
