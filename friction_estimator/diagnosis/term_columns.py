"""Columns of the effects of a model, each made from what stands before it: the force at its stage, film, bristles.

An effect that scales a force scales all of it that is there at its stage: the base's with its own memories, and that of
the other effects of the model. What the friction law is made of is carried by bristles with the rest of the law.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Generic, TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from friction_estimator.core.sample import Floats
from friction_estimator.core.sums import parts
from friction_estimator.diagnosis.library import with_running_force
from friction_estimator.diagnosis.own_columns import (
    LastMade,
    OwnColumns,
    Term,
    before,
    bristles_of,
    film_of,
    time_of,
    whole,
)
from friction_estimator.diagnosis.tangent import Carried
from friction_estimator.effects.base import FILM_STATE
from friction_estimator.effects.features import Features
from friction_estimator.effects.on_film import OnFilm, on_film, partly
from friction_estimator.effects.reference import Reference
from friction_estimator.effects.shapes import sliding
from friction_estimator.effects.trace import STAGES

T = TypeVar("T")


class Kept(Generic[T]):
    """What was made last of features with one reference and one key, as long as somebody has the features."""

    def __init__(self) -> None:
        self._of = WeakKeyDictionary[Features, tuple[Reference, object, T]]()

    def __call__(self, features: Features, reference: Reference, key: object, make: Callable[[Features], T]) -> T:
        """Return what `make` makes of the features; it does so where reference or key are others than the last."""
        kept = self._of.get(features)
        if kept is None or kept[0] is not reference or kept[1] != key:
            kept = self._of[features] = reference, key, make(features)
        return kept[2]


@dataclass(frozen=True)
class Made:
    """What is made of the terms of a model.

    Attributes
    ----------
    columns : (n, c) of each term. carried : by bristles among them, or None.
    """

    columns: list[Floats]
    carried: Carried | None


class TermColumns:
    """Makes the columns of a model's terms.

    Parameters
    ----------
    base : the base's problem with its own columns changed by some terms.

    Attributes
    ----------
    forces : what `settle` has found, by name of the term, and the features for which it holds.
    """

    def __init__(self, base: OwnColumns) -> None:
        self._base = base
        self.forces: tuple[Features, dict[str, Floats]] | None = None
        self._films, self._forced = Kept[OnFilm | None](), Kept[Features]()
        self._lacking, self._levels = Kept[Floats](), Kept[Floats]()
        self._forward = Kept[tuple[Features, Floats]]()
        self._made = LastMade(Term.pieces)

    def settle(self, fitted_N: Floats, terms: Sequence[Term], reference: Reference, features: Features) -> None:
        """Take the force that runs at the stage of each term from a fit, for columns at these features.

        It is the base's, (n,), N, with what changes it, and that of the terms that act before. Nothing is known of it
        before a time of the whole force, where the static curve at the earlier time stands for it.
        """
        time, forces = time_of(terms), dict[str, Floats]()
        self.forces = features, forces
        beside = [i for i, term in enumerate(terms) if not self._base.changed_by(term)]
        of_force = {i for i in beside if terms[i].effect.columns(terms[i].params).of_force}
        # Of one stage those come last that are made from the force, in the order in which they were found.
        beside.sort(key=lambda i: (STAGES.index(terms[i].effect.stage), i in of_force))
        while beside and beside[-1] not in of_force:
            beside.pop()
        force = fitted_N
        for i in beside:
            if i in of_force and (time is None or not before(terms[i].effect, time.effect)):
                forces[terms[i].name] = force
            if terms[i].weights.size and i != beside[-1]:
                force = force + self.one(terms, i, reference, features) @ terms[i].weights

    def __call__(self, terms: Sequence[Term], reference: Reference, features: Features) -> Made:
        """Return the columns of each term, (n, c), at the time of the whole force; none where the base is changed."""
        columns = [self.one(terms, i, reference, features) for i in range(len(terms))]
        bristles = bristles_of(terms)
        if bristles is None:
            return Made(columns, None)
        change = self._change(terms, bristles, reference, features)
        return Made(columns, Carried(change, columns[terms.index(bristles)] @ bristles.weights))

    def one(self, terms: Sequence[Term], i: int, reference: Reference, features: Features) -> Floats:
        """Return the columns of one term, (n, c), at the time of the whole force where it acts before that."""
        term, time = terms[i], time_of(terms)
        if self._base.changed_by(term):
            return np.zeros((features.size, 0))
        forces = self.forces[1] if self.forces is not None and self.forces[0] is features else {}
        if term.name in forces and term.effect.columns(term.params).of_force:
            # The fitted force has film and bristles in it.
            return term.columns(features.with_force(forces[term.name]), reference)
        if time is not None and not before(term.effect, time.effect):
            time = None
        return self._seen(time, reference, features, lambda moment: self._at(term, terms, reference, moment))

    def _change(self, terms: Sequence[Term], bristles: Term, reference: Reference, features: Features) -> Floats:
        """Return how what bristles carry changes with each coefficient of the base's static curve, (n, m).

        What they lack of the level in steady sliding is a share of it, and the level is linear in them.
        """
        lag = film_of(terms)

        def made(moment: Features) -> Iterator[Floats]:
            share, levels = self._share(bristles, reference, moment), self._base.levels(lag, moment, reference)
            return (share[p, None] * level for p, level in zip(parts(moment.size), levels, strict=True))

        return self._seen(time_of(terms), reference, features, made)

    def _seen(
        self,
        time: Term | None,
        reference: Reference,
        features: Features,
        make: Callable[[Features], Iterator[Floats]],
    ) -> Floats:
        """Return columns at the time of the whole force, (n, c), of what makes them at a moment, part after part."""
        made = [make(moment) for moment in self._moments(time, reference, features)]
        if time is None:
            return whole(made[-1], features.size)
        smooth = time.effect.smoother(time.params)
        steps = (features.step_s[part] for part in parts(features.size))
        return whole((smooth(now, step) for *now, step in zip(*made, steps, strict=True)), features.size)

    def _moments(self, time: Term | None, reference: Reference, features: Features) -> list[Features]:
        """Return the features of `OwnColumns.moments` with the base's force; the last ones made are kept."""
        if time is None:
            return [features]
        moments = self._base.moments(time, features)
        made = partial(with_running_force, reference=reference)
        return [m if m is features else self._forced(m, reference, None, made) for m in moments]

    def _at(self, term: Term, terms: Sequence[Term], reference: Reference, features: Features) -> Iterator[Floats]:
        """Return the columns of a term at the moment of these features, (n_part, c), part after part."""
        made = self._made(term, features, reference)
        if term.effect.stage == STAGES[0]:
            made = self._on_bristles(made, term, terms, reference, features)
        lag = film_of(terms)
        film = None if lag is None or not term.effect.follows_film() else self._on_film(lag, features, reference)
        if film is not None:
            made = _on(film.share, film.factor_of(term.effect), made, self._made(term, film.features, reference))
        if lag is not None and term.effect.carries(term.params):
            level = self._level_on_film(lag, features, reference)
            made = (m * level[part, None] for m, part in zip(made, parts(features.size), strict=True))
        return made

    def _on_bristles(
        self, made: Iterator[Floats], term: Term, terms: Sequence[Term], reference: Reference, features: Features
    ) -> Iterator[Floats]:
        """Return the columns of a term of the friction law, (n_part, c), as bristles carry them.

        What they lack, as a share of the level that they carry, the term lacks of its own level.
        """
        bristles = bristles_of(terms)
        if bristles is None:
            return made

        forward, sign = self._forward(features, reference, None, partial(_sliding, reference=reference))
        share = self._share(bristles, reference, features) / sign
        return _carried(made, share, self._made(term, forward, reference))

    def _share(self, bristles: Term, reference: Reference, features: Features) -> Floats:
        """Return what bristles lack over the level that they carry, (n,); nothing where there is no level."""

        def made(features: Features) -> Floats:
            lacking = whole(self._made(bristles, features, reference), features.size) @ bristles.weights
            level = reference.level(features.velocity_m_s, features.pressure_Pa)
            return np.divide(lacking, level, out=np.zeros(level.size), where=level != 0.0)

        return self._lacking(features, reference, bristles, made)

    def _level_on_film(self, lag: Term, features: Features, reference: Reference) -> Floats:
        """Return the level that bristles carry on a film that lags over that at the velocity, (n,)."""
        level = partial(lag.effect.level_on_film, lag.params, reference=reference, state=np.zeros(FILM_STATE))
        return self._levels(features, reference, lag.params, level)

    def _on_film(self, lag: Term, features: Features, reference: Reference) -> OnFilm | None:
        """Return what follows a film that lags, with the running force there."""

        def made(features: Features) -> OnFilm | None:
            film = on_film(lag.effect, lag.params, features, reference)
            return None if film is None else replace(film, features=with_running_force(film.features, reference))

        return self._films(features, reference, lag.params, made)


def _sliding(features: Features, reference: Reference) -> tuple[Features, Floats]:
    """Return the features of a forward motion at the same speeds, and what the curve is there of its level."""
    forward = sliding(features, reference)
    return forward, reference.forward_sign(forward.velocity_m_s, features.pressure_Pa)


def _on(share: float, factor: Floats, made: Iterator[Floats], there: Iterator[Floats]) -> Iterator[Floats]:
    """Yield columns of which a share follows a film, (n_part, c), of those at the velocity and those at its speed."""
    for now, on_it, part in zip(made, there, parts(factor.size), strict=True):
        yield partly(share, factor[part], now, on_it)


def _carried(made: Iterator[Floats], share: Floats, stands: Iterator[Floats]) -> Iterator[Floats]:
    """Yield columns, (n_part, c), with a share (n,) of what they are on bristles that have settled."""
    for now, settled, part in zip(made, stands, parts(share.size), strict=True):
        out = share[part, None] * settled
        out += now
        yield out
