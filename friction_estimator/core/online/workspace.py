"""What one estimator carries from sample to sample, and the names of the places in it."""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from friction_estimator.core.model.prediction import HEAD
from friction_estimator.core.sample import Floats, Ints

# Places in Workspace.status; HEAD is that of model/prediction.py, where the places in Workspace.shape are as well
SEEN, LEARNED, GUARDED, CLIPPED, OUTSIDE, ALARMED, ADOPTED = range(HEAD + 1, 8)
KEPT, SLOT, BROKEN, REVERSALS, DIRECTION, DUE, PROPOSED = range(8, 15)
STATUS_SIZE = 15

# Places in Workspace.moments
ERROR_POWER, QUIET_POWER, DIAGONAL_AGE, ALARM, BACKOFF, FASTEST, TOLERANCE = range(7)

# Places in Workspace.law
STEP, FLOOR, FORGETTING = range(3)

# Columns of Workspace.kept; those of the extension terms follow
KEPT_PLACE, KEPT_VELOCITY, KEPT_THEORY, KEPT_TARGET, KEPT_ERROR, KEPT_JOINT, KEPT_EXTENSION = range(7)

CONTINUES, RESTARTS, JOINS = range(3)
"""Values of KEPT_JOINT: the sample follows the one before it, restarts the delay lines, or follows something that was
not kept, so that the first samples only fill them."""

KEPT_BLOCK = 128
"""Consecutive samples that are kept or passed over together: the FIR's regressors need their neighbours."""

KEPT_BLOCKS = 64
"""Blocks that are kept."""

SAMPLES_A_PARAMETER = 10
"""Learned samples a parameter before the first fit to the kept samples."""

FEWEST_REVERSALS = 2
"""Of the shaft before anything is fitted: a fit to part of the first cycle says nothing of the rest."""


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
    moments : (7,), running powers, the state of the alarm and of the back-off, the largest speed learned from, the
        factor on the alarm's ratio.
    status : (15,) int64, counters. Those from KEPT on count from the start or the last alarm: samples learned from,
        place of the present block in `kept` (-1: passed over), whether the next sample does not follow the one kept
        last, reversals of the shaft, its direction, when the next fit is to be started or adopted, and how many samples
        had been learned from when the fit under way was started (0: none).
    kept : (rows, 6 + extension columns), a random sample, in blocks, of all that was learned from since the start or
        the last alarm, with the a priori errors; (0, 0) where nothing is fitted to it (see `relinearisation`).
    proposal : (1 + n, n), theta and the square root of its covariance that a fit to `kept` proposes; zeros where it
        proposes nothing. Not for the compiled loop.
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
