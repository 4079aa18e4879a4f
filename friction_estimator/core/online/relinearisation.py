"""Fits to a random sample of the past, from which rls goes on: what linearisation along the way cannot reach.

rls learns from each sample at the parameters that it had then. Where the cost has a long curved valley (the parallel
model's two branches played against each other) it creeps along it, since what it learned at earlier points holds it
back. So a sample of the past is kept (`kernels.run`), and after 10 samples a parameter and at every doubling
the model is fitted to it from the present parameters: for fixed FIR taps the rest is linear and is eliminated, and the
taps are found by Newton's method (`variable_projection`). Where the fit then predicts better than rls did, rls goes on
from there, with the information of the kept samples at the new point (docs/decisions/0005-relinearisation.md).

The fit runs in a thread beside the estimator. It is adopted a fixed number of samples after its start, whenever it was
ready, so results do not depend on the machine's load.
"""

import contextlib
import threading
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import cho_factor, solve_triangular

from friction_estimator.core.fit.moments import accumulate, products
from friction_estimator.core.fit.variable_projection import refine
from friction_estimator.core.model.prediction import TAPS, delay_lines, predict_fixed
from friction_estimator.core.model.structure import LARGEST_PARAMETER, Inputs, Model
from friction_estimator.core.online.kernels import CLIP
from friction_estimator.core.online.workspace import (
    ADOPTED,
    CONTINUES,
    DUE,
    KEPT,
    KEPT_BLOCK,
    KEPT_BLOCKS,
    KEPT_ERROR,
    KEPT_EXTENSION,
    KEPT_JOINT,
    KEPT_PLACE,
    KEPT_TARGET,
    KEPT_THEORY,
    KEPT_VELOCITY,
    PROPOSED,
    RESTARTS,
    SAMPLES_A_PARAMETER,
    SLOT,
    Workspace,
)
from friction_estimator.core.sample import Bools, Floats
from friction_estimator.core.settings.config import Config

MOST_PRODUCTS = 1500
"""Structures with more over-parameterised coefficients are not fitted again: it would take seconds."""

LEAST_GAIN = 0.02
"""Share of the error power on unseen samples that a fit must save to be adopted: rls is left alone if it does well."""

NEWTON: Any = {"gtol": 1e-7, "maxiter": 30, "initial_trust_radius": 0.1, "max_trust_radius": 1.0}
"""Of the fit: a better point is wanted, not the best."""

PRIOR_SHARE = 0.01
"""Share of rls' prior information that the fit uses: the prior is that of a cold start, and would hold the fit back."""

LARGEST_TARGET = 100.0
"""Friction beyond this many force units is no friction, however long it lasts."""

SAMPLES_A_PRODUCT = 2
"""Samples that pass before a fit is adopted, for each over-parameterised coefficient; at least an eighth of those
learned from. A fit takes some 0.2 ms a coefficient, and a node that had to wait for it would be late."""

VARIANCE_SHARE = 0.1
"""Share of the fit's variance with which rls goes on. With the whole of it rls, which takes the model's error for white
noise, moves off again and needs five cycles to come back (condition b: 1.15 of the batch fit's error on the way)."""


class Fit(threading.Thread):
    """One fit, in a thread of its own; `proposal` when it has ended. No daemon: the interpreter's end waits for it."""

    def __init__(self, model: Model, work: Workspace) -> None:
        super().__init__(name="relinearise")
        self._model, self._work = model, work
        self.proposal = np.zeros_like(work.proposal)

    def run(self) -> None:
        """Fit; where the numbers allow no fit, propose nothing: rls goes on as it is."""
        with contextlib.suppress(ArithmeticError, ValueError, MemoryError):
            self.proposal = propose(self._model, self._work)


class Relinearisation:
    """Starts the fits and hands over what they propose.

    Parameters
    ----------
    model : structure.
    """

    def __init__(self, model: Model) -> None:
        self._model = model
        self._fit: Fit | None = None

    @staticmethod
    def arrays(model: Model, config: Config) -> tuple[Floats, Floats, int]:
        """Return `Workspace.kept` and `.proposal`, empty where nothing is to be fitted, and the first `status[DUE]`."""
        if not config.rls.relinearise or config.model.law != "rls" or products(model) > MOST_PRODUCTS:
            return np.zeros((0, 0)), np.zeros((0, 0)), 0
        kept = np.zeros((KEPT_BLOCKS * KEPT_BLOCK, KEPT_EXTENSION + int(model.shape[-1])))
        return kept, np.zeros((1 + model.size, model.size)), SAMPLES_A_PARAMETER * model.size

    def visit(self, work: Workspace) -> None:
        """Do what is due: start a fit, or adopt the one that was started."""
        status = work.status
        if status[PROPOSED]:
            self.settle(work)
            if work.proposal.any() and predicts_better(self._model, work):
                work.theta[:] = work.proposal[0]
                work.root[:] = work.proposal[1:]
                work.diagonal[:] = np.sum(np.square(work.root), axis=1)
                status[ADOPTED] += 1
            status[DUE] = max(2 * status[PROPOSED], status[KEPT] + 1)
            status[PROPOSED] = 0
            return
        status[PROPOSED] = status[KEPT]
        status[DUE] = status[KEPT] + max(status[KEPT] // 8, SAMPLES_A_PRODUCT * products(self._model))
        work.proposal[:] = 0.0
        fit = Fit(self._model, work.copy())
        try:
            fit.start()
            self._fit = fit
        except RuntimeError:  # no thread to be had
            fit.run()
            work.proposal[:] = fit.proposal

    def settle(self, work: Workspace) -> None:
        """Wait for the fit that is under way, if any, and write what it proposes into `work.proposal`."""
        if self._fit is None:
            return
        self._fit.join()
        if work.status[PROPOSED]:
            work.proposal[:] = self._fit.proposal
        self._fit = None


def warm_up(model: Model) -> None:
    """Compile what a fit runs, so that the first one does not wait for it."""
    index, value = model.basis.rows(np.zeros(1))
    arrays = (index, value, np.zeros(1), np.zeros((1, int(model.shape[-1]))), np.ones(1, np.bool_))
    predict_fixed(*arrays, np.empty(1), model.shape, np.zeros(model.size), *delay_lines(model.shape))


def propose(model: Model, work: Workspace) -> Floats:
    """Return theta and the square root of its covariance from a fit to the kept samples, (1 + n, n).

    Zeros where there are too few samples, and where the fit is no better than what is, or out of range. Raises
    LinAlgError where the kept samples do not determine a covariance.
    """
    nothing = np.zeros_like(work.proposal)
    kept = Kept.of(model, work)
    used = kept.used & kept.believed(kept.inputs.target - kept.predicted(work, work.theta))
    count = int(np.count_nonzero(used))
    taps = work.theta[: work.shape[TAPS]]
    length = float(np.linalg.norm(taps))
    if count < model.size or not length > 0.0:
        return nothing
    ridge = PRIOR_SHARE / (model.config.rls.initial_variance * count)
    moments = accumulate(model, [kept.inputs], kept.inputs.restart, used, ridge)
    theta = refine(moments, taps / length, NEWTON)
    if not moments.cost(theta) < (1.0 - LEAST_GAIN) * moments.cost(work.theta):
        return nothing
    known = count * moments.gauss_newton(theta, ridge=False) + np.diag(1.0 / work.prior)
    factor, _ = cho_factor(known, lower=True)
    # known = L L', so P = S S' with S = sqrt(share) L'^-1.
    root = np.sqrt(VARIANCE_SHARE) * solve_triangular(factor, np.eye(model.size), lower=True).T
    proposal = np.concatenate([theta[None], root])
    return proposal if np.all(np.abs(proposal) < LARGEST_PARAMETER) else nothing  # NaN is refused as well


def predicts_better(model: Model, work: Workspace) -> bool:
    """Tell whether the proposal predicts what it has not seen better than rls, which went on learning, did."""
    started = int(work.status[PROPOSED])
    kept = Kept.of(model, work, started)
    fresh = kept.used & (kept.place >= started) & kept.believed(kept.error)
    if not fresh.any():
        return False
    error = kept.inputs.target - kept.predicted(work, work.proposal[0])
    proposed, present = (float(np.mean(np.square(e[fresh]))) for e in (error, kept.error))
    return proposed < (1.0 - LEAST_GAIN) * present


@dataclass(frozen=True)
class Kept:
    """The kept samples, block after block; a block starts the delay lines anew.

    Attributes
    ----------
    inputs : as the compiled loop takes them.
    used : (n,), those to fit: not those that only fill the delay lines, and none of an impossible size.
    place : (n,), number of the sample since the start or the last alarm.
    error : (n,), what rls' prediction was off when the sample came, normalised.
    """

    inputs: Inputs
    used: Bools
    place: Floats
    error: Floats

    @classmethod
    def of(cls, model: Model, work: Workspace, since: int = 0) -> "Kept":
        """Read the kept samples of a work space, or only the blocks that end at place `since` or later."""
        count, taps = int(work.status[KEPT]), int(work.shape[TAPS])
        blocks = min(KEPT_BLOCKS, -(-count // KEPT_BLOCK))
        row = np.arange(blocks * KEPT_BLOCK) % KEPT_BLOCK
        valid = np.ones(row.size, np.bool_)
        unfinished = count % KEPT_BLOCK
        if unfinished and work.status[SLOT] >= 0:  # the rest of this block is still that of the one before it
            first = int(work.status[SLOT]) * KEPT_BLOCK
            valid[first + unfinished : first + KEPT_BLOCK] = False
        newest = work.kept[: valid.size, KEPT_PLACE].reshape(blocks, KEPT_BLOCK).max(axis=1)
        valid &= np.repeat(newest >= since, KEPT_BLOCK)
        kept, row = work.kept[: valid.size][valid], row[valid]
        joint = kept[:, KEPT_JOINT]
        index = np.arange(row.size)
        start = np.maximum.accumulate(np.where((row == 0) | (joint > CONTINUES), index, 0))
        filled = (joint[start] == RESTARTS) | (index - start >= taps - 1)
        target = kept[:, KEPT_TARGET]
        possible = np.abs(target) < LARGEST_TARGET
        places, values = model.basis.rows(np.ascontiguousarray(kept[:, KEPT_VELOCITY]))
        inputs = Inputs(
            index=places,
            value=values,
            theory=np.ascontiguousarray(kept[:, KEPT_THEORY]),
            extension=np.ascontiguousarray(kept[:, KEPT_EXTENSION:]),
            target=np.where(possible, target, 0.0),
            restart=start == index,
            inside=np.ones(row.size, np.bool_),
        )
        return cls(inputs, filled & possible, kept[:, KEPT_PLACE], kept[:, KEPT_ERROR])

    def predicted(self, work: Workspace, theta: Floats) -> Floats:
        """Return what fixed parameters predict, (n,), normalised."""
        inputs, out = self.inputs, np.empty(self.place.size)
        arrays = (inputs.index, inputs.value, inputs.theory, inputs.extension, inputs.restart)
        predict_fixed(*arrays, out, work.shape, theta, *delay_lines(work.shape))
        return out

    def believed(self, error: Floats) -> Bools:
        """Return which samples are no spikes, (n,): errors beyond `CLIP` deviations, alone among their neighbours.

        Neighbours that err together are the model's fault, not the sensor's: what the model has yet to learn.
        """
        usual = float(np.median(np.abs(error[self.used]))) if self.used.any() else 0.0
        far = np.abs(error) > CLIP * 1.4826 * usual
        follows = far[1:] & far[:-1] & (np.diff(self.place) == 1.0)
        return np.asarray(~far | np.append(False, follows) | np.append(follows, False), np.bool_)
