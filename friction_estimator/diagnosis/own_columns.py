"""Effects that change the base's own columns: one time of the whole force, and a film that follows an earlier speed.

A delay moves every column of the base, a lagging film the theory's alone. Held beside the base with coefficient one,
the film's column would be made from the theory's gain of the fit before it: a fixed point that takes tens of rounds to
settle, while the lag, fitted beside a wrong gain, hardly moves (decision 0132).
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import chain, islice
from weakref import WeakKeyDictionary

import numpy as np
from scipy.linalg import norm

from friction_estimator.core.sample import Bools, Floats
from friction_estimator.core.sums import parts
from friction_estimator.diagnosis.base import theory_reference
from friction_estimator.diagnosis.base_problem import BaseProblem, Coefficients
from friction_estimator.diagnosis.lagged import force
from friction_estimator.diagnosis.library import columns_of
from friction_estimator.effects.base import FILM_STATE, Effect
from friction_estimator.effects.extension import theory_sign
from friction_estimator.effects.features import Context, Features
from friction_estimator.effects.moments import WITHIN, share_ago
from friction_estimator.effects.on_film import on_film
from friction_estimator.effects.reference import LOWEST, Reference
from friction_estimator.effects.shapes import information
from friction_estimator.effects.trace import STAGES

MOST_KEPT = 32 << 20
"""Bytes of columns of each kind that are kept at most: of a record of more than some 30,000 samples a part is made
anew."""


@dataclass(frozen=True, eq=False)
class Term:
    """One effect in a model: its class, its parameters and the coefficients of its columns; equal to itself alone."""

    effect: type[Effect]
    params: dict[str, float]
    weights: Floats = field(default_factory=lambda: np.zeros(0))

    @property
    def name(self) -> str:
        """Id of the effect."""
        return self.effect.name

    @property
    def refined(self) -> tuple[str, ...]:
        """Parameters that are refined continuously, of those that this form has."""
        return tuple(name for name in self.effect.refined if name in self.params)

    @property
    def one_sided(self) -> Bools:
        """Which of its coefficients cannot be negative, (c,)."""
        machine = self.effect.columns(self.params)
        return np.arange(machine.size) < machine.one_sided

    @property
    def held(self) -> Bools:
        """Which of its coefficients stand at zero because they cannot be negative, (c,)."""
        return np.asarray(self.one_sided & (self.weights == 0.0))

    def beyond(self, context: Context) -> bool:
        """Return whether its values lie beyond what the record spans."""
        return self.effect.spans(self.params, self.weights, context) is not None

    def known(self, columns: Floats, friction_N: float) -> Floats:
        """Return what is known before of the coefficients of its columns (n, c), (c,): see `information`."""
        return information(self.effect.columns(self.params).shapes, columns, friction_N)

    def columns(self, features: Features, reference: Reference) -> Floats:
        """Return its columns beside nothing else, (n, c)."""
        return columns_of(self.effect, self.params, features, reference)

    def pieces(self, features: Features, reference: Reference) -> Iterator[Floats]:
        """Yield them for one of `parts` after the other, (n_part, c)."""
        machine = self.effect.columns(self.params)
        return (machine(features[part], reference) for part in parts(features.size))


def before(one: type[Effect], other: type[Effect]) -> bool:
    """Return whether an effect acts at an earlier stage than another one."""
    return STAGES.index(one.stage) < STAGES.index(other.stage)


def moves(term: Term, other: Term) -> bool:
    """Return whether a term that changes the base's own columns changes those of another one, too.

    A time of the whole force moves what acts before it; what is friction at a speed, or is carried by bristles, follows
    a film that lags.
    """
    if term.effect.delays:
        return before(other.effect, term.effect)
    return other.effect.follows_film() or other.effect.carries(other.params)


def time_of(terms: Sequence[Term]) -> Term | None:
    """Return the one time of the whole force among some terms."""
    return next((t for t in terms if t.effect.delays), None)


def film_of(terms: Sequence[Term]) -> Term | None:
    """Return the film that lags among some terms."""
    return next((t for t in terms if t.effect.in_theory), None)


def bristles_of(terms: Sequence[Term]) -> Term | None:
    """Return the bristles that carry the level among some terms, once their forces are fitted."""
    return next((t for t in terms if t.weights.size and t.effect.carries(t.params)), None)


def weighted(terms: Sequence[Term], columns: Sequence[Floats], weights: Floats) -> list[Term]:
    """Hand the fitted coefficients out to the terms; those of fixed gain have coefficient one."""
    place, out = 0, []
    for term, column in zip(terms, columns, strict=True):
        if term.effect.fixed_gain:
            out.append(replace(term, weights=np.ones(1)))
        else:
            out.append(replace(term, weights=weights[place : place + column.shape[1]]))
            place += column.shape[1]
    return out


def largest_change(
    before: Sequence[Term], terms: Sequence[Term], anchors: Sequence[Mapping[str, tuple[float, float]]]
) -> float:
    """Return the largest change of a refined parameter, over its bracket, or of a term's coefficients."""
    steps = []
    for old, new, bracket in zip(before, terms, anchors, strict=True):
        steps += [abs(new.params[n] - old.params[n]) / max(high - low, 1e-300) for n, (low, high) in bracket.items()]
        # The squares of what has run away are beyond the numbers: this norm forms none.
        size = float(norm(new.weights, check_finite=False)) or 1.0
        steps.append(float(norm(new.weights - old.weights, check_finite=False)) / size)
    return max(steps, default=0.0)


def _within(features: Features, share: float, channel: str, values: Floats) -> Floats:  # noqa: ARG001
    """Return what a channel was a share of a sample ago."""
    return share_ago(values, features.step_s, share)


class LastMade:
    """What was made last of each effect at each moment, with one reference, as long as somebody has its features.

    A step of one term's parameter leaves what the others are made of as it is: most of a fit's time would go there.

    Parameters
    ----------
    make : what makes it of a term, the features of a moment and a reference, (n_part, c) for one of `parts` after the
        other. Nobody writes into what is kept.
    """

    def __init__(self, make: Callable[[Term, Features, Reference], Iterator[Floats]]) -> None:
        self._make = make
        self._reference: Reference | None = None
        self._at = WeakKeyDictionary[Features, dict[str, tuple[dict[str, float], Floats]]]()

    def __call__(self, term: Term, features: Features, reference: Reference) -> Iterator[Floats]:
        """Yield what is made of a term, (n_part, c), for one of `parts` after the other."""
        if self._reference is not reference:
            self._reference = reference
            self._at.clear()
        kept = self._at.setdefault(features, {})
        last = kept.get(term.name)
        if last is None or last[0] != term.params:
            made = self._make(term, features, reference)
            first = next(made)
            kept.pop(term.name, None)
            size = first.nbytes * features.size // len(first)
            if size + sum(m.nbytes for here in self._at.values() for _, m in here.values()) > MOST_KEPT:
                yield first
                yield from made
                return
            last = kept[term.name] = term.params, whole(chain([first], made), features.size)
        for part in parts(features.size):
            yield last[1][part]


def whole(made: Iterator[Floats], n: int) -> Floats:
    """Return what is made piece by piece as one, (n, c)."""
    first = next(made)
    if len(first) == n:
        return first
    out = np.empty((n, first.shape[1]))
    out[: len(first)] = first
    for part, values in zip(islice(parts(n), 1, None), made, strict=True):
        out[part] = values
    return out


class OwnColumns:
    """The base's problem with its own columns changed by some terms.

    Parameters
    ----------
    problem : without any. context : facts about the record.
    """

    def __init__(self, problem: BaseProblem, context: Context) -> None:
        self.problem, self._context = problem, context
        self._chosen: Bools | None = None
        self._last: tuple[list[tuple[str, dict[str, float]]], BaseProblem] | None = None
        self._moved: tuple[tuple[str, dict[str, float]], Features] | None = None
        self._timed: tuple[tuple[str, dict[str, float]], Floats] | None = None
        # No method: this object and what it makes would keep each other alive until a search for garbage.
        self._changes = LastMade(partial(_film_change, problem))

    def on(self, chosen: Bools) -> "OwnColumns":
        """Return the same of which products are formed on some blocks alone, (blocks,) bool; it shares what is kept."""
        other = copy(self)
        other._chosen, other._last = chosen, None
        return other

    def forget(self) -> None:
        """Let go of the problem made last, which is as large as its columns."""
        self._last = None

    @cached_property
    def _theory(self) -> Reference:
        return theory_reference(self.problem, self._context.sign_velocity_m_s)

    def changed_by(self, term: Term) -> bool:
        """Return whether a term changes the base's own columns; a film does so where there is a theory."""
        return term.effect.delays or (term.effect.in_theory and self.problem.theory is not None)

    def __call__(self, terms: Sequence[Term]) -> BaseProblem:
        """Return the problem with these terms in it; the last one made is kept."""
        inside = [t for t in terms if self.changed_by(t)]
        if not inside:
            return self.problem
        key = [(t.name, t.params) for t in inside]
        if self._last is None or self._last[0] != key:
            self._last = None  # both at once are not needed
            self._last = key, self.problem.with_static(self._static(inside), self._chosen)
        return self._last[1]

    def force(self, terms: Sequence[Term], found: Coefficients) -> Floats:
        """Return the base's force with these terms in it, (n,), N; no products are formed for it."""
        inside = [t for t in terms if self.changed_by(t)]
        products = self.problem.products
        static = self._static(inside)
        return force(static, products.start, found.weights, found.taps, found.own)

    def at(self, time: Term, features: Features) -> Features:
        """Return the features at the time at which what acts before the delay did so.

        The motion is moved, not its columns: a reversal between two samples is then as sharp as before.
        """
        if time.effect.late_s(time.params) == 0.0:
            return features
        key, record = (time.name, time.params), self.problem.record
        if self._moved is None or self._moved[0] != key:
            self._moved = None  # and with it all that was made of it: both at once are not needed

            def seen(channel: str, values: Floats) -> Floats:
                return time.effect.seen(time.params, channel, values, record.features)

            self._moved = key, record.features_at(self.problem.config, seen)
        return self._moved[1]

    def moments(self, time: Term | None, features: Features) -> list[Features]:
        """Return the features at the moments at which what acts before the time of the whole force is worked out.

        For a filter these are some within each sample, the last one its own: after a reversal a column bends between
        two samples, and a filter of a part of a sample sees the last part alone.
        """
        if time is None:
            return [features]
        if not time.effect.smooths:
            return [self.at(time, features)]
        return [*self._within, features]

    @cached_property
    def _within(self) -> list[Features]:
        record, config = self.problem.record, self.problem.config
        return [record.features_at(config, partial(_within, record.features, share)) for share in WITHIN]

    def level_at_rest_N(self, found: Coefficients) -> float:
        """Return `Reference.at_rest_N` of the base's static curve, without its tables."""
        tables, slow = self.problem.tables, np.array([LOWEST * self._context.sign_velocity_m_s])
        level = self._over_signs(tables.at(slow, tables.pressures_Pa.mean(keepdims=True)), slow)
        return float(level[0] @ found.weights) * (1.0 + float(found.taps.sum()))

    def _over_signs(self, columns: Floats, speed_m_s: Floats) -> Floats:
        """Divide each of the base's own columns at some speeds, (n, m), by the smooth sign behind which it stands.

        The theory is the first of them, where there is one.
        """
        sign, lead = self._context.sign_velocity_m_s, int(self.problem.theory is not None)
        columns[:, :lead] /= np.tanh(speed_m_s / (theory_sign(self.problem.theory) or sign))[:, None]
        columns[:, lead:] /= np.tanh(speed_m_s / sign)[:, None]
        return columns

    def levels(self, film: Term | None, features: Features, reference: Reference) -> Iterator[Floats]:
        """Yield the levels F / S behind the base's own columns, on a film that lags where there is one, (n_part, m).

        A share of the splines follows the film, and all of the theory. Without a theory each follows it as the force of
        the reference does.
        """

        def at(part: slice, speed_m_s: Floats) -> Floats:
            made = self.problem.tables.at(speed_m_s[part], features.pressure_Pa[part])
            return self._over_signs(made, speed_m_s[part])

        moving = reference.moving(features.velocity_m_s)
        if film is None:
            yield from (at(part, moving) for part in parts(features.size))
            return
        changed = self.changed_by(film)
        wholly, of = (slice(1), self._theory) if changed else (slice(None), reference)
        factor = film.effect.level_on_film(film.params, features, of, np.zeros(FILM_STATE))
        splines = film.effect.film(film.params, features, of, np.zeros(FILM_STATE)) if changed else None
        for part in parts(features.size):
            level = at(part, moving)
            follows = level[:, wholly] * factor[part, None]
            if splines is not None:
                level += splines.share * (at(part, splines.speed_m_s) - level)
            level[:, wholly] = follows
            yield level

    def _static(self, inside: Sequence[Term]) -> Floats:
        problem, time = self.problem, time_of(inside)
        here = problem.record.features
        static = problem.products.static if time is None else self._whole(time)
        ours = time is not None and self._timed is None  # nobody else has it
        for term in inside:
            if term.effect.delays:
                continue
            change = [self._changes(term, features, self._theory) for features in self.moments(time, here)]
            smooth = None if time is None else time.effect.smoother(time.params)
            static, ours = static if ours else static.copy(), True
            for part, *at_moments in zip(parts(here.size), *change, strict=True):
                made = at_moments[-1] if smooth is None else smooth(at_moments, here.step_s[part])
                static[part, : made.shape[1]] += made
        return static

    def _whole(self, time: Term) -> Floats:
        """Return the base's own columns with a time of the whole force in them, (n, m); the last ones may be kept."""
        key = time.name, time.params
        if self._timed is not None and self._timed[0] == key:
            return self._timed[1]
        self._timed = None
        made = time.effect.whole(time.params, self.problem.tables, self.problem.record.features)
        if made.nbytes <= MOST_KEPT:
            self._timed = key, made
        return made


def _film_change(problem: BaseProblem, term: Term, features: Features, theory: Reference) -> Iterator[Floats]:
    """Yield what a film that lags changes in the base's own columns, (n_part, m), or in the first one, (n_part, 1)."""
    film = on_film(term.effect, term.params, features, theory)
    column, tables = term.effect.columns(term.params), problem.tables
    for part in parts(features.size):
        first = column(features[part], theory)
        if film is None:
            yield first
            continue
        change = tables.at(film.features.velocity_m_s[part], film.features.pressure_Pa[part])
        change *= film.factor[part, None]
        change -= tables.at(features.velocity_m_s[part], features.pressure_Pa[part])
        change *= film.share
        change[:, :1] = first
        yield change
