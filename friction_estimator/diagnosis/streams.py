"""Faults of the stamps, which pairing repairs before a sample exists: found in the streams themselves."""

from collections.abc import Mapping

import numpy as np

from friction_estimator.core.sample import Ints
from friction_estimator.effects.base import EFFECTS, Effect
from friction_estimator.effects.detection import Fault

STEADY = 0.2
"""An offset is steady where its spread is below this share of it, or of the sample period."""


def counted(facts: Mapping[str, float], catalogue: Mapping[str, type[Effect]] = EFFECTS) -> list[Fault]:
    """Return the faults that show in what was counted while reading.

    Parameters
    ----------
    facts : samples refused, by reason; `read`, the number of all; `stamp_offset_s`, a steady offset that was taken out;
        `period_s`, the sample period.
    """
    return [fault for fault in (cls.counted(facts) for cls in catalogue.values()) if fault is not None]


def offset_ns(velocity_stamp_ns: Ints, friction_stamp_ns: Ints) -> int:
    """Return the steady difference of friction stamps minus velocity stamps, ns; 0 where there is none.

    >>> t = np.arange(100) * 5_000_000
    >>> offset_ns(t, t + 1_200_000)
    1200000
    """
    if velocity_stamp_ns.size < 10 or friction_stamp_ns.size < 10:
        return 0
    place = np.searchsorted(velocity_stamp_ns, friction_stamp_ns)
    before = friction_stamp_ns - velocity_stamp_ns[np.clip(place - 1, 0, velocity_stamp_ns.size - 1)]
    after = friction_stamp_ns - velocity_stamp_ns[np.clip(place, 0, velocity_stamp_ns.size - 1)]
    nearest = np.where(np.abs(before) < np.abs(after), before, after)
    middle = int(np.median(nearest))
    spread = float(np.median(np.abs(nearest - middle)))
    period = float(np.median(np.diff(velocity_stamp_ns)))
    return middle if abs(middle) > 0.01 * period and spread < STEADY * min(abs(middle), period) else 0
