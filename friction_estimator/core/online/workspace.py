"""What one estimator carries from sample to sample, and the names of the places in it."""

from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from friction_estimator.core.addresses import LINE, Addresses, Layout, padded, placed, placed_zeros
from friction_estimator.core.model import prediction
from friction_estimator.core.sample import Floats, Ints

# Places in Workspace.status; the first is `prediction.HEAD`
HEAD = prediction.HEAD
SEEN, LEARNED, GUARDED, CLIPPED, OUTSIDE, ALARMED, GROWN, BEYOND, MAY_GROW, UNPULLED, FOLLOWS, STOOD = range(1, 13)
STATUS_SIZE = 13

# Places in Workspace.moments
ERROR_POWER, MISFIT_POWER, TOLERANCE, BACKOFF, ABSORBED, PULL, LAST_ERROR, NEAREST, FARTHEST, OWED = range(10)
MOMENTS_SIZE = 10

# Places in Workspace.hold
SUM, CALM, SINCE_KEPT, HOLDING, JUDGED, REVERSALS, SIDE, UNREVERSED = range(8)
HELD_RECENT, FORMER_RECENT, HELD_POWER, HAS_FORMER, RESTORED, HELD_SINCE, ACROSS, SLOW_SUM = range(8, 16)
HOLD_SIZE = 16

# Places in Workspace.law
STEP, FLOOR, LEAST_LEVERAGE, RESIDUAL_VARIANCE, LEAST_SPEED, TOP_SPEED, ROW_POWER = range(7)

START_POWER = 1.0
"""Running powers before the first sample: an error of one force unit is nothing unusual yet."""

WRITTEN_ONCE = ("shape", "prior", "mean", "information", "prior_root")
"""Fields that follow from model and prior: copies share them."""

CONSTANTS = (*WRITTEN_ONCE, "law", "scratch")
"""Fields that follow from the configuration, or hold nothing, and are no part of a state."""

IN_LINES = ("ring", "root", "information", "prior_root", "kept_root")
"""Fields whose rows are whole cache lines (`addresses.placed`)."""


@dataclass(frozen=True)
class Workspace:
    """Everything that one estimator carries from sample to sample.

    Attributes
    ----------
    shape : (4,) int64, number of FIR taps, weights, theory taps and extension columns.
    theta : (n,) parameters [A, W, A1, C] in normalised units.
    ring : (taps, weights), the last rows of Psi, dense (so that the loops over them vectorise); `status[HEAD]` counts
        the rows, the newest is at `status[HEAD] % taps`.
    ring_theory : (max(theory taps, 1),), the last values of d, newest at `status[HEAD] % size`.
    root : (n, n), square root S of the covariance P = S S' over the residual variance (rls), else (0, 0).
    prior : (n,), the metric of nlms, else (0,).
    mean : (n,), information, prior_root : (n, n), of the prior over the residual variance (rls), else empty.
    noise : (loads, 2), of each column of the load the noise in it that the covariance took for excitation, to be taken
        off again, and 1 where that was half of the column's own part or more: nothing is known of it (rls).
    residual : (models kept aside + 1,), mean square of the errors that a fit to the last samples would leave (rls), of
        each of these models and, last, of the present one.
    owed : (n,), where the parameters stood over the prior's mean at the last alarm (rls), else (0,): a share
        `moments[OWED]` of it is still to be paid back.
    law : (7,), constants (see `adaptation.constants`).
    moments : (10,): running error power, mean power of errors at velocities that are known, the factor on what the
        alarm takes for usual, lms' back-off, samples that the covariance holds, the pull towards the prior that is
        due, the error before, the slowest and the fastest of the first velocities in a row beyond an edge, the share
        owed.
    status : (13,) int64, counters; `BEYOND` counts the samples in a row beyond one edge (negative: the lower one),
        `MAY_GROW` is 1 where the range may grow, `FOLLOWS` is 1 where the last error is that of the sample before.
    errors : (cells, 3), running errors by cell of velocity (see `fit.band`).
    rest : (15,), what tells standstill (see `intake.standstill`).
    kept : (models, parameters + owed + 3 cells + moments), models kept aside, flat: theta, owed, errors, moments
        (see `recovery`).
    kept_root : (2, n, n), root of the first two of them (rls), else (2, 0, 0).
    trial : (bins, 3), samples of a trial by bin of velocity, and the mean surprises of held model and challenger.
    hold : (16,), the sum of the alarm, samples without alarm, samples since a model was kept, whether one is held, and
        the figures of the trial.
    scratch : (3, n and room), for the regressor and two vectors beside it.
    """

    shape: Ints
    theta: Floats
    ring: Floats
    ring_theory: Floats
    root: Floats
    prior: Floats
    mean: Floats
    information: Floats
    prior_root: Floats
    noise: Floats
    residual: Floats
    owed: Floats
    law: Floats
    moments: Floats
    status: Ints
    errors: Floats
    rest: Floats
    kept: Floats
    kept_root: Floats
    trial: Floats
    hold: Floats
    scratch: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Lay the arrays out as the compiled loops read them; theta and its metric so that the weights begin a line."""
        for name in IN_LINES:
            object.__setattr__(self, name, placed(getattr(self, name)))
        taps, size = int(self.shape[prediction.TAPS]), self.theta.size
        for name in ("theta", "prior"):
            object.__setattr__(self, name, placed(getattr(self, name), taps))
        object.__setattr__(self, "scratch", placed_zeros((3, padded(size) + 2 * LINE)))

    def __reduce__(self) -> tuple[Any, ...]:
        """Copies, and processes that it is sent to, lay their arrays out anew."""
        return Workspace, tuple(getattr(self, f.name) for f in fields(self) if f.init)

    def copy(self) -> "Workspace":
        """Return a copy whose every sample leaves this one as it is."""
        written = (f.name for f in fields(self) if f.init and f.name not in WRITTEN_ONCE)
        return replace(self, **{name: getattr(self, name).copy() for name in written})

    @cached_property
    def addresses(self) -> Addresses:
        """The arrays as `kernels.run` takes them, in the order of the fields."""
        return LAYOUT.addresses(**{name: getattr(self, name) for name in NAMES})


NAMES = tuple(f.name for f in fields(Workspace))

LAYOUT = Layout(**{name: np.int64 if name in ("shape", "status") else np.float64 for name in NAMES})


def cold_moments() -> Floats:
    """Return `moments` before the first sample."""
    moments = np.zeros(MOMENTS_SIZE)
    moments[ERROR_POWER] = START_POWER
    moments[[TOLERANCE, BACKOFF]] = 1.0
    return moments


def cold_status(may_grow: bool) -> Ints:
    """Return `status` before the first sample."""
    status = np.zeros(STATUS_SIZE, np.int64)
    status[MAY_GROW] = int(may_grow)
    return status
