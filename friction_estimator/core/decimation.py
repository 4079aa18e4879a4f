"""Rows of samples for people to look at: fewer, and all that stands out among them."""

import numpy as np

from friction_estimator.core.sample import Floats

MONITOR_COLUMNS = "time_s,velocity_m_s,measured_N,predicted_N,stddev_N"
"""The columns of what people look at while a node runs; `time_s` is the sample's stamp."""

MONITOR_WIDTH = len(MONITOR_COLUMNS.split(","))


def telling_rows(rows: Floats, most: int) -> Floats:
    """Return at most so many rows, (m, c), of rows in time order, (n, c): all of them, or those that a picture needs.

    The rows are cut into pieces of equal length; of each piece those rows are kept, whole and in order, in which a
    column is lowest or highest. So what is drawn has the same extremes in every column as what was measured, to within
    a piece of time, and each kept row is a sample that was (nothing is averaged).

    Parameters
    ----------
    most : at least 2 c + 2, the extremes of one piece and both ends.

    Examples
    --------
    >>> spike = np.zeros((1000, 1)); spike[567] = 9.0; spike[568] = -9.0
    >>> kept = telling_rows(spike, 20)
    >>> len(kept) <= 20, kept.min(), kept.max()
    (True, np.float64(-9.0), np.float64(9.0))
    """
    count, columns = rows.shape
    if count <= most:
        return rows
    pieces = (most - 2) // (2 * columns)
    length = -(-count // pieces)
    # The last piece is filled up with its own last row.
    padded = np.concatenate([rows, np.repeat(rows[-1:], pieces * length - count, axis=0)])
    cut = padded.reshape(pieces, length, columns)
    offset = length * np.arange(pieces)[:, None]
    kept = np.concatenate([(offset + find(cut, axis=1)).ravel() for find in (np.argmin, np.argmax)])
    kept = np.unique(np.minimum(np.append(kept, [0, count - 1]), count - 1))
    return np.asarray(rows[kept], np.float64)
