"""Why a prediction is no better: what in a record is not a function of velocity, and what helps.

A model of friction over velocity cannot follow the force on a shaft that stands, a direction or a speed that it never
met, a load that is no friction, or a machine that changes. Each is looked for by a figure of its own, on samples that
were predicted without learning where there are any; what it names is a share of the squared error, not a cause
that was tested (that is `diagnose`'s).
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from friction_estimator.core import metrics
from friction_estimator.core.fit.baselines import StaticCurve
from friction_estimator.core.fit.frozen_score import CURVES, curves_learned
from friction_estimator.core.intake.acceleration import slopes
from friction_estimator.core.intake.standstill import standstill
from friction_estimator.core.model.load import LOADS, Motion
from friction_estimator.core.sample import Bools, Floats, Samples

GOOD_NRMSE = 0.1
"""Error over the spread of friction below which nothing is asked."""

LEAST_SHARE = 0.25
"""Share of the squared error that is worth naming."""

ONE_WAY = 0.98
"""Share of the samples in motion that go one way, from which the other direction counts as never met."""

LEAST_SAMPLES = 200
"""Samples in motion below which no load is sought."""

FOLDS, PERIODS = 4, 10
"""Parts of the record that a load is judged on in turn, fitted to the others; parts that are compared for change."""

SMOOTH_SHARE = 0.02
"""Of the top speed: width of the smooth sign beside which a load is sought."""

HALF_WIDTH = 5
"""Samples on either side that an acceleration is taken from (`intake.acceleration`)."""

MOST_LOADS = 2


@dataclass(frozen=True)
class Shortcoming:
    """Something that the model cannot follow.

    Attributes
    ----------
    name : "standstill", "direction", "speeds", "load" or "time".
    share_percent : of the squared error that falls to it.
    text : what was seen. advice : what to do.
    """

    name: str
    share_percent: float
    text: str
    advice: str


@dataclass(frozen=True)
class InMotion:
    """The score over the samples in motion alone.

    Attributes
    ----------
    samples : their number. standing_share : share of the scored samples that stand.
    nrmse : of the model; NaN where too few move. baselines : of the textbook's curves, fitted to what moved of the
        samples learned from.
    """

    samples: int
    standing_share: float
    nrmse: float
    baselines: Mapping[str, float]


@dataclass(frozen=True)
class Judgement:
    """A prediction with what it is judged by.

    Attributes
    ----------
    samples : all n of them. predicted_N : (n,). learned, scored : (n,), learned from, and judged on.
    top_speed_m_s : of the range learned. has_loads : kinds of load that the model has already.
    """

    samples: Samples
    predicted_N: Floats
    learned: Bools
    scored: Bools
    top_speed_m_s: float
    has_loads: frozenset[str]

    @property
    def error_N(self) -> Floats:
        """Measured minus predicted, (n,)."""
        return self.samples.friction_N - self.predicted_N

    def standing(self) -> Bools:
        """Return where the shaft stands, (n,)."""
        return standstill(self.samples, self.top_speed_m_s)


def in_motion(judged: Judgement, standing: Bools) -> InMotion:
    """Return the score without the samples at standstill."""
    samples = judged.samples
    moves = judged.scored & ~standing
    measured = samples.friction_N[moves]
    curves: dict[str, StaticCurve] = {}
    fitted = judged.learned & ~standing
    if np.count_nonzero(fitted) and np.count_nonzero(moves) > 1:
        curves = curves_learned(samples.velocity_m_s[fitted], samples.friction_N[fitted])
    scores = {
        name: metrics.nrmse(measured, curves[name].evaluate(samples.velocity_m_s[moves]))
        for name in CURVES
        if name in curves
    }
    share = float(np.mean(standing[judged.scored])) if judged.scored.any() else 0.0
    return InMotion(int(moves.sum()), share, metrics.nrmse(measured, judged.predicted_N[moves]), scores)


def shortcomings(judged: Judgement, standing: Bools) -> tuple[Shortcoming, ...]:
    """Return what the model cannot follow, the largest share first; nothing where it predicts well.

    Examples
    --------
    >>> n = 4000
    >>> v = np.where(np.arange(n) < 2000, 1.0, 0.0) * np.sin(np.arange(n) / 30)
    >>> stuck = 0.5 * np.sin(np.arange(n) / 7) * (v == 0.0)
    >>> record = Samples(np.arange(n) * 10**7, v, np.sign(v) + stuck, np.arange(n) == 0)
    >>> judged = Judgement(record, np.sign(v), v != 0.0, np.ones(n, bool), 1.0, frozenset())
    >>> [one.name for one in shortcomings(judged, judged.standing())]
    ['standstill']
    """
    samples, scored, error = judged.samples, judged.scored, judged.error_N
    measured = samples.friction_N[scored]
    total = float(np.sum(np.square(error[scored])))
    score = metrics.nrmse(measured, judged.predicted_N[scored])
    if not score > GOOD_NRMSE or not total > 0.0:
        return ()

    def share(part: Bools) -> float:
        return float(np.sum(np.square(error[part & scored]))) / total

    moves = scored & ~standing
    other = _other_way(samples.velocity_m_s, judged.learned & ~standing)
    beyond = _never_met(samples.velocity_m_s, judged.learned)
    found = [
        *_standing(share(standing), float(np.mean(standing[scored]))),
        *_direction(moves & other, share),
        *_speeds(moves & beyond & ~other, share),
    ]
    within = moves & ~beyond
    left = share(within)
    if left >= LEAST_SHARE and np.count_nonzero(within) >= LEAST_SAMPLES:
        loads = [one for one in _load(judged, within, left) if one.share_percent >= 100.0 * LEAST_SHARE]
        found += loads or _time(judged, within, left)  # a load that turns with the shaft changes with time, too
    kept = [one for one in found if one.share_percent >= 100.0 * LEAST_SHARE]
    return tuple(sorted(kept, key=lambda one: -one.share_percent))


def _standing(share: float, of_samples: float) -> Iterator[Shortcoming]:
    yield Shortcoming(
        "standstill",
        100.0 * share,
        f"{share:.0%} of the squared error is where the shaft stands ({of_samples:.0%} of the samples): there the "
        "force is whatever holds it, below breakaway, and no function of velocity",
        "read the error in motion",
    )


def _other_way(velocity: Floats, learned: Bools) -> Bools:
    """Return where the velocity has a direction that was never learned from, (n,)."""
    known = velocity[learned]
    forward = float(np.mean(known > 0.0)) if known.size else 0.5
    if ONE_WAY > forward > 1.0 - ONE_WAY:
        return np.zeros(velocity.size, np.bool_)
    return np.asarray(velocity < 0.0 if forward >= ONE_WAY else velocity > 0.0)


def _never_met(velocity: Floats, learned: Bools) -> Bools:
    """Return where the velocity lies outside those learned from, (n,)."""
    if not learned.any():
        return np.zeros(velocity.size, np.bool_)
    return np.asarray((velocity < velocity[learned].min()) | (velocity > velocity[learned].max()))


def _direction(other: Bools, share: Callable[[Bools], float]) -> Iterator[Shortcoming]:
    yield Shortcoming(
        "direction",
        100.0 * share(other),
        f"{share(other):.0%} of the squared error is in a direction that nothing was learned of",
        "learn from a drive that goes both ways",
    )


def _speeds(beyond: Bools, share: Callable[[Bools], float]) -> Iterator[Shortcoming]:
    yield Shortcoming(
        "speeds",
        100.0 * share(beyond),
        f"{share(beyond):.0%} of the squared error is at speeds that nothing was learned of",
        "learn from a drive that covers the speeds of use",
    )


@dataclass(frozen=True)
class _Motion:
    acceleration_m_s2: Floats
    position_m: Floats


def _motion(samples: Samples) -> Motion:
    acceleration = np.empty(len(samples))
    slopes(samples.stamp_ns, samples.velocity_m_s, samples.restart, HALF_WIDTH, 0, len(samples), acceleration)
    position = samples.position_m
    return _Motion(acceleration, np.zeros(len(samples)) if position is None else np.nan_to_num(position))


def _load(judged: Judgement, within: Bools, left: float) -> Iterator[Shortcoming]:
    """Look for a load beside Coulomb and viscous friction, on parts of the record that it was not fitted to."""
    samples = judged.samples
    velocity = samples.velocity_m_s[within]
    smooth = np.tanh(velocity / (SMOOTH_SHARE * judged.top_speed_m_s))
    friction = np.column_stack([smooth, velocity, np.ones(velocity.size)])
    force = samples.friction_N[within]
    motion = _motion(samples)
    position = samples.position_m is not None
    kinds = {
        name: load.columns(motion, load.keys)[within]
        for name, load in LOADS.items()
        if name != "constant" and name not in judged.has_loads and (position or load.needs != "position")
    }
    before = _held_out(friction, force)
    if not before > 0.0:
        return
    gains: dict[tuple[str, ...], float] = {}
    for count in range(1, MOST_LOADS + 1):
        for names in combinations(kinds, count):
            gains[names] = 1.0 - _held_out(np.column_stack([friction, *(kinds[n] for n in names)]), force) / before
    if not gains:
        return
    alone = max((names for names in gains if len(names) == 1), key=lambda names: gains[names])
    best = max(gains, key=lambda names: gains[names])
    # A second load is named where it explains a quarter of what the first one leaves.
    if 1.0 - gains[best] > (1.0 - LEAST_SHARE) * (1.0 - gains[alone]):
        best = alone
    gain = max(0.0, gains[best])
    words = " and ".join(best)
    yield Shortcoming(
        "load",
        100.0 * gain * left,
        f"the force holds more than friction: {words} beside Coulomb and viscous friction explains {gain:.0%} of what "
        "these leave of it in motion, on parts of the record that were not fitted",
        f"set load.terms: [{', '.join(best)}] in --config, or take the load off at import",
    )


def _held_out(columns: Floats, force: Floats) -> float:
    """Return the squared error of a least-squares fit, each part of the record predicted from the others."""
    scale = np.sqrt(np.mean(np.square(columns), axis=0))
    columns = columns / np.where(scale > 0.0, scale, 1.0)
    total = 0.0
    for part in np.array_split(np.arange(force.size), FOLDS):
        rest = np.ones(force.size, np.bool_)
        rest[part] = False
        weights = np.linalg.lstsq(columns[rest], force[rest], rcond=1e-8)[0]
        total += float(np.sum(np.square(force[part] - columns[part] @ weights)))
    return total


def _time(judged: Judgement, within: Bools, left: float) -> Iterator[Shortcoming]:
    """Look for a level or a gain that is not the one learned, and for how they differ between tenths of the record."""
    error, predicted = judged.error_N[within], judged.predicted_N[within]
    columns = np.column_stack([np.ones(error.size), predicted])
    explained = 0.0
    for part in np.array_split(np.arange(error.size), PERIODS):
        weights = np.linalg.lstsq(columns[part], error[part], rcond=1e-8)[0]
        explained += float(np.sum(np.square(columns[part] @ weights)))
    gain = explained / float(np.sum(np.square(error)))
    yield Shortcoming(
        "time",
        100.0 * gain * left,
        f"{gain * left:.0%} of the squared error is a level or a gain other than the one learned, or that changes: "
        "friction, sensor or load change with time",
        "let the model learn on, with rls.forgetting_factor 0.99 to 0.997; `diagnose` names drifts and steps",
    )
