"""Faults of the stamps, which pairing repairs before a sample exists: found in the streams themselves."""

from collections.abc import Mapping

import numpy as np

from friction_estimator.core.sample import NS_PER_S, Ints
from friction_estimator.diagnosis.quality import Finding

LEAST_SHARE = 0.001
STEADY = 0.2
"""An offset is steady where its spread is below this share of it, or of the sample period."""


def duplicates(rejected: Mapping[str, int], read: int) -> Finding | None:
    """Return a finding where more than a thousandth of the samples were refused for a repeated stamp."""
    count = rejected.get("duplicate_stamp", 0)
    if read <= 0 or count < max(3, LEAST_SHARE * read):
        return None
    share = count / read
    reach = 2.0 * float(np.sqrt(count)) / read
    return Finding(
        "duplicate_stamps",
        1e-12,
        {"fraction": (share, "", max(0.0, share - reach), share + reach)},
        words=f"{count} of {read} samples carry the stamp of the one before",
    )


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


def stamp_offset(offset: int, period_s: float) -> Finding | None:
    """Return a finding for a steady offset of the stamps."""
    if offset == 0:
        return None
    value = offset / NS_PER_S
    reach = 0.01 * period_s
    return Finding(
        "stamp_offset",
        1e-12,
        {"offset": (value, "s", value - reach, value + reach)},
        words=f"friction is stamped {1e3 * value:.3g} ms from the nearest velocity throughout",
    )
