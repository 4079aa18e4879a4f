"""The sensors: sampling, stamps, absolute pressure, and the noise of the force channel."""

from fractions import Fraction

import numpy as np

from friction_estimator.core.sample import NS_PER_S, Floats, Ints, Samples
from friction_estimator.effects.trace import Trace

START_NS = 1_700_000_000 * NS_PER_S
"""Stamp of the first sample: fixed, so that a seed gives the same recording on every day."""

AMBIENT_PRESSURE_PA = 101325.0


def stamps(n: int, rate_hz: float, start_ns: int = START_NS) -> Ints:
    """Return n stamps at k / rate_hz, (n,) int64 ns, each rounded down on its own: no drift.

    >>> stamps(4, 3.0, 0).tolist()
    [0, 333333333, 666666666, 1000000000]
    """
    rate = Fraction(rate_hz).limit_denominator(1000)
    whole, rest = np.divmod(np.arange(n, dtype=np.int64) * rate.denominator, rate.numerator)
    return np.asarray(start_ns + whole * NS_PER_S + rest * NS_PER_S // rate.numerator)


def force_noise(clean_N: Floats, noise: float, seed: int) -> Floats:
    """Return white Gaussian noise of `noise` times the rms of the clean friction, (n,), N.

    It depends on the seed, the length and that rms only: an effect added to a scenario leaves it as it was.
    """
    deviation = noise * float(np.sqrt(np.mean(np.square(clean_N))))
    return deviation * np.random.default_rng([seed, 1]).standard_normal(clean_N.size)


def as_samples(trace: Trace) -> Samples:
    """Return what the channels show at the recording's rate: stamps of the motion, absolute pressure."""
    restart = np.zeros(trace.time_s.size, np.bool_)
    restart[:1] = True
    return Samples(
        stamp_ns=trace.stamp_ns,
        velocity_m_s=trace.velocity_measured_m_s,
        friction_N=trace.friction_N,
        restart=restart,
        pressure_Pa=trace.pressure_Pa + AMBIENT_PRESSURE_PA,
        temperature_degC=trace.temperature_degC,
        position_m=trace.position_measured_m,
    )
