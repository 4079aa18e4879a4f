"""Causes of an extended model beside each other: on a film that lags, carried by bristles, made from the running force.

What a fit makes of a whole record (`diagnosis.term_columns`), as a causal machine.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from friction_estimator.core.sample import Floats, Samples
from friction_estimator.effects.base import FILM_STATE, Effect, Smoother
from friction_estimator.effects.columns import Columns, RunningForce
from friction_estimator.effects.features import FeatureMaker, Features
from friction_estimator.effects.moments import Moments
from friction_estimator.effects.on_film import FilmMachine, partly
from friction_estimator.effects.reference import Reference
from friction_estimator.effects.shapes import sliding
from friction_estimator.effects.term import TermSpec, held
from friction_estimator.effects.trace import STAGES


@dataclass(frozen=True, eq=False)
class Cause:
    """One effect with one set of parameters.

    Attributes
    ----------
    spec : the first of its terms; the others are other columns of it. weights : of its columns, (c,).
    """

    spec: TermSpec
    weights: Floats

    @property
    def effect(self) -> type[Effect]:
        """Whose."""
        return self.spec.effect

    @property
    def stage(self) -> int:
        """Where it acts."""
        return STAGES.index(self.effect.stage)

    def columns(self) -> Columns:
        """Return its columns, which know no past."""
        return self.effect.columns(self.spec.params)


class _Made:
    """The machines of one cause: its columns at the velocity, on the film, and on bristles that have settled."""

    def __init__(self, cause: Cause, film: bool, bristles: bool, early: bool) -> None:
        self.cause, self.columns = cause, cause.columns()
        # What is made of the running force is made of all of it, and that has the film in it.
        on_film = film and cause.effect.follows_film() and (early or not self.columns.of_force)
        self.on_film = cause.columns() if on_film else None
        self.settled = cause.columns() if bristles and self.cause.stage == 0 else None
        self.level_state = np.zeros(FILM_STATE if film and cause.effect.carries(cause.spec.params) else 0)

    def restart(self) -> None:
        self.level_state[:] = 0.0
        for columns in (self.columns, self.on_film, self.settled):
            if columns is not None:
                columns.restart()


class Together:
    """Columns of causes beside each other as a causal machine: fed with consecutive pieces, it gives what one would.

    Parameters
    ----------
    causes : all of the model. made : those of which columns are made, in the order in which they act.
    reference : what they are made from.
    early : whether they act before a time of the whole force: that which runs there is the static curve's through the
        common memory, as in a fit, else the base's with the force of the causes before.
    """

    def __init__(self, causes: Sequence[Cause], made: Sequence[Cause], reference: Reference, early: bool) -> None:
        self._reference = reference
        self._lag = next((c for c in causes if c.effect.in_theory), None)
        bristles = next((c for c in causes if c.effect.carries(c.spec.params) and c.weights.any()), None)
        film = self._lag is not None
        self._made = [_Made(c, film and c is not self._lag, bristles is not None, early) for c in made]
        static = replace(reference, theory_lags=np.zeros(0))
        of_force = [i for i, one in enumerate(self._made) if one.columns.of_force]
        self._running = RunningForce(static if early else reference) if of_force else None
        self._adding = of_force[-1] if of_force and not early else 0
        self._film: FilmMachine | None = None
        if self._lag is not None and any(one.on_film for one in self._made):
            self._film = FilmMachine(self._lag.effect, self._lag.spec.params, static)
        self._bristles: tuple[Cause, Columns] | None = None
        if bristles is not None and any(one.settled for one in self._made):
            self._bristles = bristles, bristles.columns()

    def restart(self) -> None:
        """Forget the past."""
        for one in self._made:
            one.restart()
        if self._running is not None:
            self._running.restart()
        if self._film is not None:
            self._film.restart()
        if self._bristles is not None:
            self._bristles[1].restart()

    def __call__(self, features: Features, before_N: Floats | None = None) -> list[Floats]:
        """Return the columns of each cause for the next samples, (n, c).

        `before_N` : (n,), force of the causes before a time of the whole force.
        """
        r, top = self._reference, self._reference.top_m_s
        if self._running is not None:
            features = self._running(features)
            if before_N is not None:
                features = features.with_force(features.force_N + before_N)
        film = None if self._film is None else self._film(features)
        forward, lacking = features, np.zeros(0)
        if self._bristles is not None:
            forward, lacking = self._lacking(features, *self._bristles)
        out = []
        for i, one in enumerate(self._made):
            spec = one.cause.spec
            made = one.columns(held(features, spec, top), r)
            if one.settled is not None:
                made = made + lacking[:, None] * one.settled(held(forward, spec, top), r)
            if film is not None and one.on_film is not None:
                there = one.on_film(held(film.features, spec, top), r)
                made = partly(film.share, film.factor_of(spec.effect), made, there)
            if self._lag is not None and one.level_state.size:
                lag = self._lag.spec.params
                made = made * self._lag.effect.level_on_film(lag, features, r, one.level_state)[:, None]
            if i < self._adding:
                features = features.with_force(features.force_N + made @ one.cause.weights)
            out.append(made)
        return out

    def _lacking(self, features: Features, bristles: Cause, columns: Columns) -> tuple[Features, Floats]:
        """Return the features of a forward motion, and what bristles lack of the level that they carry, (n,), over it.

        What the friction law is made of lacks the same share of its own level.
        """
        r = self._reference
        forward = sliding(features, r)
        force = columns(held(features, bristles.spec, r.top_m_s), r) @ bristles.weights
        level = r.level(features.velocity_m_s, features.pressure_Pa)
        return forward, np.asarray(force / (level * r.forward_sign(forward.velocity_m_s, features.pressure_Pa)))


class AtTime:
    """Columns of causes that act before a time of the whole force, at its time; a causal machine.

    Parameters
    ----------
    time : that time. causes, made, reference : as of `Together`. make : gives a maker of features that knows no past.
    """

    def __init__(
        self,
        time: Cause,
        causes: Sequence[Cause],
        made: Sequence[Cause],
        reference: Reference,
        make: Callable[[], FeatureMaker],
    ) -> None:
        self._time, self._made = time, made
        self._moments = Moments(time.effect, time.spec.params, make)
        self._at = [Together(causes, made, reference, early=True) for _ in range(self._moments.count)]
        self._smoothers = self._smooth()

    def _smooth(self) -> list[Smoother]:
        return [self._time.effect.smoother(self._time.spec.params) for _ in self._made]

    def restart(self) -> None:
        """Forget the past."""
        self._moments.restart()
        for together in self._at:
            together.restart()
        self._smoothers = self._smooth()

    def __call__(self, samples: Samples, features: Features) -> tuple[list[Floats], Floats]:
        """Return the columns of each cause for the next samples, (n, c), and their force, (n,)."""
        moments = self._moments(samples, features)
        at = [together(moment) for moment, together in zip(moments, self._at, strict=True)]
        made = [smooth(parts, features.step_s) for smooth, *parts in zip(self._smoothers, *at, strict=True)]
        force = np.zeros(features.size)
        for cause, columns in zip(self._made, made, strict=True):
            force += columns @ cause.weights
        return made, force
