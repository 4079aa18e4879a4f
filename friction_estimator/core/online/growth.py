"""The range grows with the speeds that come: functions are appended, curve and band stay what they were."""

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from friction_estimator.core.addresses import placed, placed_zeros
from friction_estimator.core.errors import ConfigError
from friction_estimator.core.intake import standstill
from friction_estimator.core.model.prior import Prior
from friction_estimator.core.model.structure import Model
from friction_estimator.core.online import recovery
from friction_estimator.core.online import workspace as at
from friction_estimator.core.online.adaptation import Law, constants
from friction_estimator.core.online.carried_curve import CarriedCurve
from friction_estimator.core.online.workspace import Workspace
from friction_estimator.core.sample import Floats, Ints
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.units import ALONE_ABOVE, MARGIN, with_units_of

LARGEST_GROWTH = 10.0
"""Largest factor by which the range grows at once: faster drives take another twenty samples, and a burst of absurd
velocities does not make the model large."""

LEAST_GROWTH = 1.25
"""Smallest factor: a drive that runs up goes on, and each growth takes milliseconds. Companded cells are few there."""


def grown_model(model: Model, velocity_m_s: float) -> Model | None:
    """Return the model whose range holds `velocity_m_s` with its margin, or None where it would grow too large."""
    low, high = model.basis.reach
    most = LARGEST_GROWTH * max(abs(low), abs(high))
    sign, edge = (1.0, high) if velocity_m_s > 0.0 else (-1.0, -low)
    reached = sign * min(max(MARGIN * abs(velocity_m_s), LEAST_GROWTH * edge), most)
    low, high = min(low, reached), max(high, reached)
    try:
        return model.reaching(low, high)
    except ConfigError:
        return None


class Growth:
    """A range on its way to be larger.

    All of it can be made ahead, a part at a time, since samples beyond an edge teach nothing: what they do change, the
    larger work space shares with the present one, but for the delay lines.

    Parameters
    ----------
    before, after : the model and the larger one.
    work : the present work space.
    config, law : of the estimator.
    """

    def __init__(self, before: Model, after: Model, work: Workspace, config: Config, law: type[Law]) -> None:
        self.before, self.after, self._work = before, after, work
        self._given, self._law, self._first = config, law, _first_beyond(work)
        self._asked_for = 0

    def is_under_way(self, model: Model, work: Workspace, config: Config) -> bool:
        """Return whether the samples beyond the edge that asked for this growth are still coming, and nothing else."""
        same = self.before is model and self._work is work and self._given is config
        return same and self._first == _first_beyond(work)

    def prepare(self) -> bool:
        """Make the next part, a third of a millisecond with a hundred parameters; return whether there was one."""
        parts: list[Callable[[], object]] = [
            lambda: self.prior,
            lambda: self.prior.root,
            lambda: self.prior.inverse_root,
            lambda: (self.prior.information, self.law_arrays, self.config),
            lambda: self.fit.wide,
            lambda: self.fit.points,
            lambda: (self.fit.rows, self.fit.functions),
            lambda: self.fit.normal,
            lambda: (self.fit.factor, self.fit.former_rows),
            lambda: self.fit.inverse_factor,
            lambda: self.fit.missing,
            lambda: self.thetas,
            lambda: self.roots,
            lambda: self.larger,
            lambda: (self.larger.addresses, self.constants),
        ]
        if self._asked_for == len(parts):
            return False
        self._asked_for += 1
        parts[self._asked_for - 1]()
        return True

    @cached_property
    def prior(self) -> Prior:
        """The prior of `after`."""
        return Prior.of(self.after)

    @cached_property
    def law_arrays(self) -> dict[str, Any]:
        """What the law takes from it."""
        return prior_arrays(self.prior) if self._law.keeps_covariance else {}

    @cached_property
    def fit(self) -> "CarriedCurve":
        """What carries curves over."""
        taps, old = int(self.before.shape[0]), int(self.before.shape[1])
        return CarriedCurve(self.before, self.after, np.ascontiguousarray(self._thetas[:, taps : taps + old]))

    @cached_property
    def config(self) -> Config:
        """The configuration with the larger range."""
        return with_units_of(self._given, self.after.config)

    @cached_property
    def constants(self) -> Floats:
        """`Workspace.law`."""
        return constants(self._law, self.config, self.after.basis)

    @cached_property
    def _places(self) -> tuple[Ints, Ints]:
        """Where the functions of `before` stand among those of `after`, and where its parameters do."""
        taps, old, new = int(self.before.shape[0]), int(self.before.shape[1]), int(self.after.shape[1])
        place = self.after.basis.places_of(self.before.basis)
        head, tail = np.arange(taps), np.arange(self.before.size - taps - old)
        return place, np.concatenate([head, taps + place, taps + new + tail])

    @cached_property
    def _thetas(self) -> Floats:
        """Parameters of the present model and of those kept aside, (models, former n)."""
        kept_aside = (recovery.Kept.of(row, self._work).theta for row in self._work.kept)
        return np.stack([self._work.theta, *kept_aside])

    @cached_property
    def thetas(self) -> Floats:
        """The same in the larger model, (models, n)."""
        taps, weights = int(self.after.shape[0]), int(self.after.shape[1])
        larger = np.zeros((len(self._thetas), self.after.size))
        larger[:, self._places[1]] = self._thetas
        larger[:, taps : taps + weights] = self.fit.weights
        return larger

    @cached_property
    def roots(self) -> tuple[Floats, Floats]:
        """Roots of the covariance, of the present model and of those kept aside."""
        work, prior, size = self._work, self.prior, self.after.size
        if not work.root.size:
            return work.root, work.kept_root
        kept = self._places[1]
        fresh = np.ones(size, np.bool_)
        fresh[kept] = False
        unknown = prior.deviation[fresh] / np.sqrt(prior.residual_variance)

        def fill(larger: Floats, root: Floats) -> None:
            larger[np.ix_(kept, kept)] = root
            larger[fresh, fresh] = unknown

        present, aside = placed_zeros((size, size)), placed_zeros((2, size, size))
        fill(present, work.root)
        for place, used in ((recovery.HELD, at.HOLDING), (recovery.FORMER, at.HAS_FORMER)):
            if work.hold[used]:
                fill(aside[place], work.kept_root[place])
        return present, aside

    @cached_property
    def larger(self) -> Workspace:
        """The work space of `after`, with what `before` had learned; its delay lines are empty.

        The curve over the former range is what it was, and level beyond. Functions that reach into the former range
        keep their covariance, the appended ones have the prior's.
        """
        before, after, prior, work = self.before, self.after, self.prior, self._work
        _, kept = self._places
        shift = before.basis.first_cell - after.basis.first_cell

        def larger_errors(errors: Floats) -> Floats:
            larger = np.zeros((after.basis.cell_count, 3))
            larger[shift : shift + before.basis.cell_count] = errors
            return larger

        def larger_owed(owed: Floats) -> Floats:
            larger = np.zeros(after.size if owed.size else 0)
            larger[kept[: owed.size]] = owed
            return larger

        def larger_row(model: recovery.Kept, theta: Floats) -> Floats:
            return np.concatenate([theta, larger_owed(model.owed), larger_errors(model.errors).ravel(), model.moments])

        models = [recovery.Kept.of(row, work) for row in work.kept]
        return replace(
            work,
            shape=after.shape.copy(),
            theta=self.thetas[0].copy(),
            ring=np.zeros((int(before.shape[0]), int(after.shape[1]))),
            root=self.roots[0],
            prior=prior.metric if work.prior.size else work.prior,
            errors=larger_errors(work.errors),
            owed=larger_owed(work.owed),
            kept=np.stack([larger_row(*each) for each in zip(models, self.thetas[1:], strict=True)]),
            kept_root=self.roots[1],
            trial=np.zeros((recovery.bins(after), 3)),
            **self.law_arrays,
        )

    def done(self) -> Workspace:
        """Return `larger` with the delay lines as they are."""
        self.larger.ring[:, self._places[0]] = self._work.ring
        self.larger.law[:] = self.constants
        return self.larger


def _first_beyond(work: Workspace) -> int:
    """Return the number of the sample from which on all lie beyond one edge."""
    return int(work.status[at.SEEN]) - abs(int(work.status[at.BEYOND]))


def next_growth(
    model: Model, work: Workspace, config: Config, law: type[Law], under_way: Growth | None
) -> Growth | None:
    """Return the growth that the first velocities in a row beyond an edge ask for, or None: too large a basis.

    Parameters
    ----------
    model, work, config, law : of the estimator. under_way : returned if it is the one.
    """
    if under_way is not None and under_way.is_under_way(model, work, config):
        return under_way
    nearest, farthest = float(work.moments[at.NEAREST]), float(work.moments[at.FARTHEST])
    # All of them lie beyond the edge; one that stands far out among them is a wild value.
    velocity = farthest if abs(farthest) <= ALONE_ABOVE * abs(nearest) else nearest
    after = grown_model(model, velocity)
    return Growth(model, after, work, config, law) if after else None


def prior_arrays(prior: Prior) -> dict[str, Floats]:
    """Return the constants of `Workspace` that rls takes from the prior, in units of the residual variance."""
    return {
        "mean": prior.mean.copy(),
        "information": placed(prior.information * prior.residual_variance),
        "prior_root": placed(prior.root / np.sqrt(prior.residual_variance)),
    }


def cold_start(model: Model, prior: Prior, metric: Floats, covariance: bool, constants: Floats) -> Workspace:
    """Return the work space before the first sample.

    Parameters
    ----------
    metric : of nlms, or empty. covariance : whether the law keeps one. constants : of the law.
    """
    taps, weights, theory_taps, _ = (int(v) for v in model.shape)
    nothing = {"mean": np.zeros(0), "information": np.zeros((0, 0)), "prior_root": np.zeros((0, 0))}
    arrays = prior_arrays(prior) if covariance else nothing
    return Workspace(
        shape=model.shape.copy(),
        theta=model.initial_theta(),
        ring=np.zeros((taps, weights)),
        ring_theory=np.zeros(max(1, theory_taps)),
        root=arrays["prior_root"].copy(),
        prior=metric,
        noise=np.zeros((model.load.size, 2)),
        residual=np.zeros(recovery.KEPT + 1),
        owed=np.zeros(model.size if covariance else 0),
        law=constants,
        moments=at.cold_moments(),
        status=at.cold_status(may_grow=not model.config.basis.velocity_range),
        errors=np.zeros((model.basis.cell_count, 3)),
        rest=np.zeros(standstill.STATE_SIZE),
        **nothing_kept(model, covariance),
        **arrays,
    )


def nothing_kept(model: Model, covariance: bool) -> dict[str, Floats]:
    """Return the arrays of `recovery` before the first sample."""
    cells, root = model.basis.cell_count, model.size if covariance else 0
    return {
        "kept": np.zeros((recovery.KEPT, model.size + root + 3 * cells + at.MOMENTS_SIZE)),
        "kept_root": np.zeros((2, root, root)),
        "trial": np.zeros((recovery.bins(model), 3)),
        "hold": np.zeros(at.HOLD_SIZE),
    }
