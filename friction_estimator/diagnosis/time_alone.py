"""What only a function of the time explains: unlike forces where the drive is alike.

What the form of a cause, or the base's curve, gets wrong comes again with the drive: where speed, acceleration, place
and pressure are the same at two samples far apart in time, it is the same, too. A function of the time is not.
"""

import numpy as np
from scipy.spatial import cKDTree

from friction_estimator.core.sample import Floats, Ints
from friction_estimator.diagnosis.held_out import block_sums, error_of_sum
from friction_estimator.diagnosis.pressures import recorded_steps
from friction_estimator.diagnosis.record import Record
from friction_estimator.effects.whole import FirstOrder

PARTS = 8
"""Parts of the record, with as many used samples each; between the two of a pair lies one whole part at least."""

MOST = 30000
"""Samples that are looked at."""

SAME = 0.2
"""Of the deviation of each quantity that tells samples apart: how far two of them may be apart and be alike."""

SAME_PRESSURE, SAME_TEMPERATURE_K = 0.03, 0.5
"""Of the mean pressure, and K: nearer ones are alike, however little a channel changes that creeps or is noisy."""

HISTORY = 0.03
"""Time constant, over the length of the record, with which friction may follow a pressure: that is alike, too."""

FEWEST = 1000
"""Pairs below which they say nothing."""

TRUE_SHARE = 0.5
"""Of what a true function of the time explains of the differences: what one must."""

SURE = 3.0
"""Standard errors from block to block by which it must explain something of them."""


class TimeAlone:
    """Judges functions of the time on pairs of samples of one record.

    Parameters
    ----------
    record : repaired.
    """

    def __init__(self, record: Record) -> None:
        self._record = record
        self._later, self._earlier = _alike(record)

    def explains(self, before_N: Floats, after_N: Floats) -> bool:
        """Return whether what a fit took off the residual is a function of the time.

        With D the differences of the residual before, A those after it and d = D - A, over all pairs::

            sum D^2 - A^2 = sum d^2 + sum 2 d A

        That is sum d^2 where d is true, and -sum d^2 where D has nothing of it. Only the second sum differs by chance.
        Too few pairs explain nothing.

        Parameters
        ----------
        before_N, after_N : (n,), residuals of both models, N.
        """
        if self._later.size < FEWEST:
            return False
        before, after = (residual[self._later] - residual[self._earlier] for residual in (before_N, after_N))
        taken = before - after
        chance = np.zeros(self._record.used.size)
        chance[self._later] = 2.0 * taken * after
        truth = float(np.square(taken).sum())
        gain, error = truth + float(chance.sum()), error_of_sum(block_sums(chance, self._record))
        return gain > 0.0 and gain >= TRUE_SHARE * truth and gain >= SURE * error


def _alike(record: Record) -> tuple[Ints, Ints]:
    """Return pairs of samples (m,), (m,), the later one first, at which the drive is alike.

    Each has the nearest one among those that are far enough before it.
    """
    f = record.features
    apart_s = recorded_steps(f)
    was_Pa = FirstOrder(HISTORY * float(apart_s.sum()))([f.pressure_Pa[:, None]], apart_s)[:, 0]
    used = np.flatnonzero(record.used & np.isfinite(f.since_reversal_s))
    used = used[:: max(1, -(-used.size // MOST))]
    motion = (f.velocity_m_s, f.acceleration_m_s2, f.position_m, f.since_reversal_s)
    nearest_Pa = SAME_PRESSURE * float(np.mean(np.abs(f.pressure_Pa)))
    scaled = [
        *(_scaled(values[used]) for values in motion),
        *(_scaled(values[used], nearest_Pa) for values in (f.pressure_Pa, was_Pa)),
        _scaled(f.temperature_degC[used], SAME_TEMPERATURE_K),
    ]
    # Of one direction, and of one recording: encoders of two may have unlike origins.
    places = np.column_stack([*scaled, 2.0 * f.direction[used], 2.0 * record.recording[used]])
    parts = np.array_split(np.arange(used.size), PARTS)
    later, earlier = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for number in range(2, PARTS):
        here, before = parts[number], np.concatenate(parts[: number - 1])
        if not here.size or not before.size:
            continue
        nearest: Ints = np.asarray(
            cKDTree(places[before]).query(places[here], p=np.inf, distance_upper_bound=1.0)[1], np.int64
        )
        found = nearest < before.size  # the size itself says that none is near
        later.append(used[here[found]])
        earlier.append(used[before[nearest[found]]])
    return np.concatenate(later), np.concatenate(earlier)


def _scaled(values: Floats, nearest: float = 0.0) -> Floats:
    """Return values in units of how far apart alike ones may be; `nearest` ones are alike in any case."""
    return np.asarray(values / (max(SAME * float(np.std(values)), nearest) or 1.0))
