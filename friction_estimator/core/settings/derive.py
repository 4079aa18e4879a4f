"""Units and ranges where the configuration leaves them open."""

import numpy as np

from friction_estimator.core.sample import Floats
from friction_estimator.core.settings.config import Config, LearnedConfig

LIVE_VELOCITY_RANGE = (-0.15, 0.15)
"""m/s; an eccentric of 20 mm at one turn a second reaches 0.126 m/s."""

LIVE_FORCE_UNIT = 10.0
"""N."""

MARGIN = 1.05
"""Derived velocity ranges reach this much beyond the largest velocity."""


def with_recorded_units(config: Config, velocity_m_s: Floats, friction_N: Floats) -> Config:
    """Fill in what is unset from a recording: a symmetric velocity range and the usual magnitude of friction.

    One wild velocity must not stretch the range: the 99.9 % quantile of |v| counts where the maximum is more than twice
    as large. Non-finite values are passed over. Learned values keep the units that they were learned in: those of the
    live node, where their file leaves them open (a dump of a running node does).
    """
    if config.learned != LearnedConfig():
        return with_live_units(config)
    values: dict[str, object] = {}
    if not config.basis.velocity_range:
        speed = np.abs(velocity_m_s[np.isfinite(velocity_m_s)])
        top = float(speed.max()) if speed.size else 0.0
        usual = float(np.quantile(speed, 0.999)) if speed.size else 0.0
        top = usual if top > 2.0 * usual > 0.0 else top
        reach = MARGIN * top if top > 0.0 else LIVE_VELOCITY_RANGE[1]
        values["basis.velocity_range"] = (-reach, reach)
    if not config.force_unit > 0.0:
        values["force_unit"] = usual_magnitude(friction_N) or LIVE_FORCE_UNIT
    return config.updated(values)


def with_live_units(config: Config) -> Config:
    """Fill in what is unset with the documented defaults of the live node."""
    values: dict[str, object] = {}
    if not config.basis.velocity_range:
        values["basis.velocity_range"] = LIVE_VELOCITY_RANGE
    if not config.force_unit > 0.0:
        values["force_unit"] = LIVE_FORCE_UNIT
    return config.updated(values)


def usual_magnitude(friction_N: Floats) -> float:
    """Return the rms of friction while there is some, N; 0 where there is none.

    Spikes (the largest 2 %) are cut off, and what is below a tenth of the rest is left out, so that neither a wild
    sensor nor a long standstill decides.
    """
    magnitude = np.abs(friction_N[np.isfinite(friction_N)])
    top = float(np.quantile(magnitude, 0.98)) if magnitude.size else 0.0
    top = top if top > 0.0 else float(magnitude.max(initial=0.0))
    if not top > 0.0:
        return 0.0
    moving = np.minimum(magnitude[magnitude >= 0.1 * top], top)
    return top * float(np.sqrt(np.mean(np.square(moving / top))))
