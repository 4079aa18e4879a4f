"""Why a prediction is no better: what in a record is not a function of velocity, and what helps.

A model of friction over velocity cannot follow the force on a shaft that stands, a direction or a speed that it never
met, a load that is no friction, or a machine that changes. Each is looked for by a figure of its own, on samples that
were predicted without learning where there are any; what it names is a share of the squared error, not a cause
that was tested (that is `diagnose`'s).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from friction_estimator.core import metrics, sums
from friction_estimator.core.intake.acceleration import slopes
from friction_estimator.core.model.load import LOADS, SampleMotion, smooth_sign
from friction_estimator.core.online.record_figures import RecordFigures
from friction_estimator.core.sample import NS_PER_S, Bools, Floats, Samples
from friction_estimator.core.settings.groups import LoadConfig

GOOD_NRMSE = 0.1
"""Error over the spread of friction below which nothing is asked."""

LEAST_SHARE = 0.25
"""Share of the squared error that is worth naming."""

ONE_DIRECTION = (
    "the shaft moves in one direction only: a bias of the {force} sensor cannot be told from the Coulomb level"
)
"""Said of a record in which `metrics.one_way` holds; for `Quantities.worded`."""

LEAST_SAMPLES = 200
"""Samples in motion below which no load is sought."""

FOLDS, PERIODS = 4, 10
"""Parts of the record that a load is judged on in turn, fitted to the others; parts that are compared for change."""

HALF_WIDTH_NS = round(LoadConfig().half_width * NS_PER_S)
"""Time on either side that an acceleration is taken from (`intake.acceleration`)."""

MOST_LOADS = 2

GIVEN = "the load given"
"""What was taken off as known load, once more: its share is by how much the effort holds it other than given."""

NONE_OF_IT = 0.1
"""Share of the load given below which the effort holds none of it, and does not hold it in another scale."""

SINGULAR = 1e-14
"""Share of the largest eigenvalue of the moments below which a direction is rounding."""


@dataclass(frozen=True)
class Shortcoming:
    """Something that the model cannot follow.

    Attributes
    ----------
    name : "standstill", "direction", "speeds", "load", "load_scale" or "time".
    share_percent : of the squared error that falls to it.
    text : what was seen. advice : what to do.
    """

    name: str
    share_percent: float
    text: str
    advice: str

    @property
    def is_worth_naming(self) -> bool:
        """Whether its share is large enough."""
        return self.share_percent >= 100.0 * LEAST_SHARE


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
    figures : of the n samples. predicted_N : (n,). has_loads : kinds of load that the model has already.
    given_N : (n,), what was taken off as known load; load_N : (n,), that and the load learned beside the friction;
        `NO_LOAD` of them where there is none.
    """

    figures: RecordFigures
    predicted_N: Floats
    has_loads: frozenset[str]
    given_N: Floats
    load_N: Floats

    @property
    def samples(self) -> Samples:
        """All n of them."""
        return self.figures.samples

    @property
    def error_N(self) -> Floats:
        """Measured minus predicted, (n,)."""
        return self.samples.friction_N - self.predicted_N


def in_motion(judged: Judgement) -> InMotion:
    """Return the score without the samples at standstill."""
    figures = judged.figures
    moves = figures.in_motion
    return InMotion(
        samples=int(moves.sum()),
        standing_share=figures.standing_share,
        nrmse=metrics.nrmse(figures.samples.friction_N, judged.predicted_N, moves, figures.spread_in_motion_N),
        baselines=figures.rivals_in_motion,
    )


def shortcomings(judged: Judgement) -> tuple[Shortcoming, ...]:
    """Return what the model cannot follow, the largest share first; nothing where it predicts well.

    Examples
    --------
    >>> n = 4000
    >>> v = np.where(np.arange(n) < 2000, 1.0, 0.0) * np.sin(np.arange(n) / 30)
    >>> stuck = 0.5 * np.sin(np.arange(n) / 7) * (v == 0.0)
    >>> record = Samples(np.arange(n) * 10**7, v, np.sign(v) + stuck, np.arange(n) == 0)
    >>> figures = RecordFigures(record, learned=v != 0.0, top_speed_m_s=1.0)
    >>> judged = Judgement(figures, np.sign(v), frozenset(), np.zeros(n), np.zeros(n))
    >>> [one.name for one in shortcomings(judged)]
    ['standstill']
    """
    samples, figures = judged.samples, judged.figures
    scored, standing, learned = figures.scored, figures.standing, figures.learned
    if not metrics.nrmse(samples.friction_N, judged.predicted_N, scored, figures.scored_spread_N) > GOOD_NRMSE:
        return ()
    error = judged.error_N
    total = float(np.sum(np.square(error[scored])))
    if not total > 0.0:
        return ()

    def share(part: Bools) -> float:
        return float(np.sum(np.square(error[part & scored]))) / total

    moves = scored & ~standing
    other = _other_way(samples.velocity_m_s, learned & ~standing)
    beyond = _never_met(samples.velocity_m_s, learned)
    found = [
        _standing(share(standing), float(np.mean(standing[scored]))),
        _direction(share(moves & other)),
        _speeds(share(moves & beyond & ~other)),
    ]
    within = moves & ~beyond
    left = share(within)
    if left >= LEAST_SHARE and np.count_nonzero(within) >= LEAST_SAMPLES:
        load = _load(judged, within, left)
        # A load that turns with the shaft changes with time, too.
        found.append(load if load is not None and load.is_worth_naming else _time(judged, within, left))
    return tuple(sorted((one for one in found if one.is_worth_naming), key=lambda one: -one.share_percent))


def _standing(share: float, of_samples: float) -> Shortcoming:
    return Shortcoming(
        "standstill",
        100.0 * share,
        f"{share:.0%} of the squared error is where the shaft stands ({of_samples:.0%} of the samples): there the "
        "force is whatever holds it, below breakaway, and no function of velocity",
        "read the error in motion",
    )


def _other_way(velocity: Floats, learned: Bools) -> Bools:
    """Return where the velocity has a direction that was never learned from, (n,)."""
    return np.asarray(velocity * metrics.one_way(sums.chosen(velocity, learned)) < 0.0, np.bool_)


def _never_met(velocity: Floats, learned: Bools) -> Bools:
    """Return where the velocity lies outside those learned from, (n,)."""
    if not learned.any():
        return np.zeros(velocity.size, np.bool_)
    return np.asarray((velocity < velocity[learned].min()) | (velocity > velocity[learned].max()))


def _direction(share: float) -> Shortcoming:
    return Shortcoming(
        "direction",
        100.0 * share,
        f"{share:.0%} of the squared error is in a direction that nothing was learned of",
        "learn from a drive that goes both ways",
    )


def _speeds(share: float) -> Shortcoming:
    return Shortcoming(
        "speeds",
        100.0 * share,
        f"{share:.0%} of the squared error is at speeds that nothing was learned of",
        "learn from a drive that covers the speeds of use",
    )


def _motion(samples: Samples, top_m_s: float) -> SampleMotion:
    acceleration, variance, doubt = np.empty((3, len(samples)))
    slopes(
        samples.stamp_ns,
        samples.velocity_m_s,
        samples.restart,
        HALF_WIDTH_NS,
        False,
        np.zeros(3),
        0,
        len(samples),
        acceleration,
        variance,
        doubt,
    )
    position = None if samples.position_m is None else np.nan_to_num(samples.position_m)
    return SampleMotion(replace(samples, acceleration_m_s2=acceleration, position_m=position), top_m_s)


def _load(judged: Judgement, within: Bools, left: float) -> Shortcoming | None:
    """Look for a load beside Coulomb and viscous friction, on parts of the record that it was not fitted to."""
    samples = judged.samples
    velocity = samples.velocity_m_s[within]
    smooth = smooth_sign(velocity, judged.figures.top_speed_m_s)
    parts = {"friction": np.column_stack([smooth, velocity, np.ones(velocity.size)])}
    motion = _motion(samples, judged.figures.top_speed_m_s)
    reach = float(np.ptp(motion.position_m))
    for name, load in LOADS.items():
        is_known = samples.position_m is not None or load.needs != "position"
        if name == "constant" or name in judged.has_loads or not is_known or reach < load.least_range:
            continue
        if not load.follows:
            parts[name] = load.columns(motion, load.keys)[within]
        elif judged.load_N.any():
            parts[name] = (smooth * np.abs(judged.load_N[within]))[:, None]
    if judged.given_N.any():
        parts[GIVEN] = judged.given_N[within, None]
    force = (samples.friction_N - judged.load_N + judged.given_N)[within]  # without what was learned of the load
    error_of = _held_out(parts, force)
    before = error_of(("friction",))
    kinds = [name for name in parts if name != "friction"]
    if not before > 0.0 or not kinds:
        return None
    gains = {
        names: 1.0 - error_of(("friction", *names)) / before
        for count in range(1, MOST_LOADS + 1)
        for names in combinations(kinds, count)
    }
    alone = max((names for names in gains if len(names) == 1), key=lambda names: gains[names])
    best = max(gains, key=lambda names: gains[names])
    # A second load is named where it explains a quarter of what the first one leaves.
    if 1.0 - gains[best] > (1.0 - LEAST_SHARE) * (1.0 - gains[alone]):
        best = alone
    gain = max(0.0, gains[best])
    if GIVEN in best:
        return _other_scale(parts, force, best, 100.0 * gain * left)
    words = " and ".join(best)
    return Shortcoming(
        "load",
        100.0 * gain * left,
        f"the force holds more than friction: {words} beside Coulomb and viscous friction "
        f"{'explains' if len(best) == 1 else 'explain'} {gain:.0%} of what these leave of it in motion, on parts of "
        "the record that were not fitted",
        f"set load.terms: [{', '.join(best)}] in --config, or take the load off at import",
    )


def _other_scale(
    parts: Mapping[str, Floats], force: Floats, best: tuple[str, ...], share_percent: float
) -> Shortcoming:
    """Say how many times the load given the effort holds."""
    columns = np.column_stack([parts[GIVEN], *(parts[name] for name in ("friction", *best) if name != GIVEN)])
    times = 1.0 + float(np.linalg.lstsq(columns, force, rcond=None)[0][0])
    beside = "".join(f", {name} beside it" for name in best if name != GIVEN)
    seen = f"the effort holds {times:.2f} times the load given in load.terms{beside}"
    advice = (
        "where that load is right, the effort is in another unit or scale (current for torque, motor for joint, a "
        f"torque constant): divide it by {times:.2f} at import; where the effort is right, name the terms without "
        "values"
    )
    if abs(times) < NONE_OF_IT:
        seen = f"the effort holds nothing of the load given in load.terms{beside}"
        advice = "it was taken off before, or this effort does not have it: leave those terms out"
    elif times < 0.0:
        advice = (
            "its sign is the other way about: turn the position or the values round, or the effort where friction "
            "opposes the motion with a negative sign (input.friction_sign), or name the terms without values"
        )
    return Shortcoming("load_scale", share_percent, seen, advice)


def _held_out(parts: Mapping[str, Floats], force: Floats) -> Callable[[tuple[str, ...]], float]:
    """Return what tells the squared error of a least-squares fit of some parts, each fold predicted from the others.

    The samples are gone through once: every choice of parts is a choice among the rows of the same second moments.
    """
    columns = np.column_stack(list(parts.values()))
    scale = np.sqrt(np.mean(np.square(columns), axis=0))
    columns = np.column_stack([columns / np.where(scale > 0.0, scale, 1.0), force])
    folds = [part.T @ part for part in np.array_split(columns, FOLDS)]
    whole = np.sum(folds, axis=0)
    ends = np.cumsum([0, *(part.shape[1] for part in parts.values())])
    place = {name: np.arange(ends[k], ends[k + 1]) for k, name in enumerate(parts)}

    def error_of(names: tuple[str, ...]) -> float:
        chosen = np.concatenate([place[name] for name in names])
        total = 0.0
        for fold in folds:
            rest = whole - fold
            weights = np.linalg.lstsq(rest[np.ix_(chosen, chosen)], rest[chosen, -1], rcond=SINGULAR)[0]
            residual = np.zeros(columns.shape[1])
            residual[chosen], residual[-1] = -weights, 1.0
            total += float(residual @ fold @ residual)
        return total

    return error_of


def _time(judged: Judgement, within: Bools, left: float) -> Shortcoming:
    """Look for a level or a gain that is not the one learned, and for how they differ between tenths of the record."""
    error, predicted = judged.error_N[within], judged.predicted_N[within]
    columns = np.column_stack([np.ones(error.size), predicted])
    explained = 0.0
    for part in np.array_split(np.arange(error.size), PERIODS):
        weights = np.linalg.lstsq(columns[part], error[part], rcond=1e-8)[0]
        explained += float(np.sum(np.square(columns[part] @ weights)))
    gain = explained / float(np.sum(np.square(error)))
    return Shortcoming(
        "time",
        100.0 * gain * left,
        f"{gain * left:.0%} of the squared error is a level or a gain other than the one learned, or that changes: "
        "friction, sensor or load change with time",
        "let the model learn on, with rls.forgetting_factor 0.99 to 0.997; `diagnose` names drifts and steps",
    )
