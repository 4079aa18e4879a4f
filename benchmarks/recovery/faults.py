"""Plausible bad data: finite, of a usual size for the sensor, and not friction."""

# ruff: noqa: ARG001, ARG005 - all faults take the same arguments

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from records import Record

from friction_estimator.core.intake.pairing import USED, Sequencer
from friction_estimator.core.sample import NS_PER_S, Samples
from friction_estimator.core.settings.groups import SyncConfig

Channels = tuple[np.ndarray, np.ndarray]
"""Velocity, m/s, and force over the record's scale of 10 N, of the samples at fault."""


@dataclass(frozen=True)
class Fault:
    """One kind of bad data.

    Attributes
    ----------
    seconds : it lasts.
    apply : takes (velocity, force in N of a 10 N scale, time since the onset in s, the last velocity and force before
        it, a generator) and returns both channels at fault.
    held_out : nothing was tuned on it.
    """

    seconds: float
    apply: Callable[..., Channels]
    held_out: bool = False


def offset(newton: float) -> Callable[..., Channels]:
    return lambda v, f, t, last, rng: (v, f + newton)


def ramped(v, f, t, last, rng):
    return v, f + 20.0 * np.minimum(t, 1.0)


def spikes(v, f, t, last, rng):
    return v, f + np.where(rng.random(f.size) < 0.1, 100.0 * rng.choice([-1.0, 1.0], f.size), 0.0)


FAULTS = {
    "50 N for 0.1 s": Fault(0.1, offset(50.0)),
    "100 N for 0.2 s": Fault(0.2, offset(100.0)),
    "50 N for 1 s": Fault(1.0, offset(50.0)),
    "20 N for 1 s": Fault(1.0, offset(20.0)),
    "1 kN for 1 s": Fault(1.0, offset(1000.0)),
    "velocity stuck for 5 s": Fault(5.0, lambda v, f, t, last, rng: (np.full(v.size, last[0]), f)),
    "second publisher for 2 s": Fault(2.0, lambda v, f, t, last, rng: (v, f)),  # see `second_publisher`
    "ramp to 20 N in 1 s, 1 s more": Fault(2.0, ramped, held_out=True),
    "force times 3 for 2 s": Fault(2.0, lambda v, f, t, last, rng: (v, 3.0 * f), held_out=True),
    "sign flipped for 0.5 s": Fault(0.5, lambda v, f, t, last, rng: (v, -f), held_out=True),
    "force stuck for 3 s": Fault(3.0, lambda v, f, t, last, rng: (v, np.full(f.size, last[1])), held_out=True),
    "spikes of 100 N for 2 s": Fault(2.0, spikes, held_out=True),
    "velocity times 0.5 for 2 s": Fault(2.0, lambda v, f, t, last, rng: (0.5 * v, f), held_out=True),
    "velocity zero for 1 s": Fault(1.0, lambda v, f, t, last, rng: (np.zeros(v.size), f), held_out=True),
    "20 N for 10 s": Fault(10.0, offset(20.0), held_out=True),
    "noise of 10 N for 2 s": Fault(
        2.0, lambda v, f, t, last, rng: (v, f + 10.0 * rng.standard_normal(f.size)), held_out=True
    ),
}


def faulty(record: Record, name: str, start: int, seed: int) -> tuple[Samples, int, int]:
    """Return the record with a fault, and the samples (first, one past the last) that are at fault."""
    fault, samples = FAULTS[name], record.samples
    stop = start + max(1, round(fault.seconds * samples.sample_rate_hz))
    if name.startswith("second publisher"):
        return _second_publisher(samples, start, stop, record.force_N)
    unit = record.force_N / 10.0
    velocity, force = samples.velocity_m_s.copy(), samples.friction_N.copy()
    bad = slice(start, stop)
    time = (samples.stamp_ns[bad] - samples.stamp_ns[start]) / NS_PER_S
    last = velocity[start - 1], force[start - 1] / unit
    changed = fault.apply(velocity[bad], force[bad] / unit, time, last, np.random.default_rng(seed))
    velocity[bad], force[bad] = changed[0], unit * changed[1]
    return replace(samples, velocity_m_s=velocity, friction_N=force), start, stop


def _second_publisher(samples: Samples, start: int, stop: int, unit: float) -> tuple[Samples, int, int]:
    """Between the samples come those of another joint, 1 ms (at most half a period) late."""
    period = NS_PER_S / samples.sample_rate_hz
    late = round(min(1e-3 * NS_PER_S, 0.5 * period))
    rows = np.arange(start, stop)
    ahead = np.minimum(rows + round(0.37 * samples.sample_rate_hz), len(samples) - 1)
    order = np.argsort(np.concatenate([np.arange(len(samples)), rows + 0.5]), kind="stable")
    take = np.concatenate([np.arange(len(samples)), rows])[order]
    other = order >= len(samples)
    stamps = samples.stamp_ns[take] + np.where(other, late, 0)
    velocity = np.concatenate([samples.velocity_m_s, 0.7 * samples.velocity_m_s[ahead]])[order]
    force = np.concatenate([samples.friction_N, 0.5 * unit - 0.5 * samples.friction_N[ahead]])[order]
    status, restart = Sequencer(SyncConfig()).admit(stamps, velocity, force)
    if not np.all(status == USED):
        raise RuntimeError("a sample of the second publisher was refused: its stamp is that of another")
    held = {
        name: None if (value := getattr(samples, name)) is None else value[take]
        for name in ("pressure_Pa", "temperature_degC", "position_m", "position_shift_m")
    }
    return Samples(stamps, velocity, force, restart, **held), start, 2 * stop - start
