"""What one estimator carries from sample to sample, and the names of the places in it."""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from friction_estimator.core.sample import Floats, Ints

# Places in Workspace.shape
TAPS, WEIGHTS, THEORY_TAPS, EXTENSIONS = range(4)

# Places in Workspace.status
HEAD, SEEN, LEARNED, GUARDED, CLIPPED, OUTSIDE, ALARMED, SINCE, LEARNED_BEFORE, SLOT, DUE, PROPOSED, STARTED = range(13)

# Places in Workspace.moments
ERROR_POWER, QUIET_POWER, DIAGONAL_AGE, ALARM, BACKOFF = range(5)

# Places in Workspace.law
STEP, FLOOR, FORGETTING = range(3)

# Columns of Workspace.kept; those of the extension terms follow
(
    KEPT_PLACE,
    KEPT_VELOCITY,
    KEPT_THEORY,
    KEPT_TARGET,
    KEPT_ERROR,
    KEPT_RESTART,
    KEPT_LEARNED,
    KEPT_EXTENSION,
) = range(8)

KEPT_BLOCK = 128
"""Consecutive samples that are kept or passed over together: the FIR's regressors need their neighbours."""

KEPT_BLOCKS = 64
"""Blocks that are kept."""

SAMPLES_A_PARAMETER = 10
"""Learned samples a parameter before the first fit to the kept samples."""


@dataclass
class Workspace:
    """Everything that one estimator carries from sample to sample.

    Attributes
    ----------
    shape : (4,) int64, number of FIR taps, weights, theory taps and extension columns.
    theta : (n,) parameters [A, W, A1, C] in normalised units.
    ring : (taps, weights), the last rows of Psi, dense (so that the loops over them vectorise); `status[HEAD]` counts
        the rows, the newest is at `status[HEAD] % taps`.
    ring_theory : (max(theory taps, 1),), the last values of d, newest at `status[HEAD] % size`.
    root : (n, n), square root S of the covariance P = S S' (rls), else (0, 0).
    diagonal : (n,), the diagonal of P (rls), else (0,).
    prior : (n,), the metric of nlms; for rls the diagonal of P before the first sample, which no variance exceeds;
        (0,) for lms.
    law : (3,), constants of the law.
    moments : (5,), running powers, the state of the alarm and of the back-off.
    status : (13,) int64, counters.
    kept : (rows, 7 + extension columns), a random sample, in blocks, of all that was seen since the start or the last
        alarm, with the a priori errors; (0, 0) where nothing is fitted to it (see `relinearisation`).
    proposal : (1 + n, n), theta and the square root of its covariance that a fit to `kept` proposes, adopted when
        `status[DUE]` samples have been learned from; zeros where it proposes nothing. Not for the compiled loop.
    """

    shape: Ints
    theta: Floats
    ring: Floats
    ring_theory: Floats
    root: Floats
    diagonal: Floats
    prior: Floats
    law: Floats
    moments: Floats
    status: Ints
    kept: Floats
    proposal: Floats

    def copy(self) -> "Workspace":
        """Return an independent copy."""
        return Workspace(**{f.name: getattr(self, f.name).copy() for f in fields(self)})

    def arrays(self) -> tuple[NDArray[np.generic], ...]:
        """Return the arrays in the order in which `kernels.run` takes them."""
        return tuple(getattr(self, f.name) for f in fields(self) if f.name != "proposal")
