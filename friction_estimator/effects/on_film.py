"""What follows a film that lags: over a whole record, for a fit, and as samples come, for an extended model."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from friction_estimator.core.sample import Floats
from friction_estimator.effects.base import FILM_STATE, Effect
from friction_estimator.effects.columns import RunningForce
from friction_estimator.effects.features import Features
from friction_estimator.effects.reference import Reference


@dataclass(frozen=True)
class OnFilm:
    """What follows a film that lags.

    Attributes
    ----------
    share : of a column that does. features : at the film's speed, in the direction of now.
    factor : (n,), S(v) / S(u): what sets the force's sign, the velocity of now, does not lag.
    even_factor : (n,), the same of what differs between the directions: by that in which the film was built.
    """

    share: float
    features: Features
    factor: Floats
    even_factor: Floats

    def factor_of(self, effect: type[Effect]) -> Floats:
        """Return the factor of an effect's columns, (n,)."""
        return self.even_factor if effect.even else self.factor


def on_film(
    effect: type[Effect],
    params: Mapping[str, float],
    features: Features,
    reference: Reference,
    state: Floats | None = None,
) -> OnFilm | None:
    """Return what a film that lags makes of what is not the theory's, or None where it makes nothing of it.

    `state` is carried from piece to piece, (FILM_STATE,), zeros to begin with; it is not needed for a whole record.
    """
    made = effect.film(params, features, reference, np.zeros(FILM_STATE) if state is None else state)
    if made is None:
        return None
    v = features.velocity_m_s
    moved = replace(features, velocity_m_s=np.sign(v) * made.speed_m_s)
    factor = np.abs(reference.smooth_sign(v)) / reference.smooth_sign(made.speed_m_s)
    return OnFilm(made.share, moved, factor, factor if made.way is None else factor * made.way * np.sign(v))


def partly(share: float, factor: Floats, now: Floats, there: Floats) -> Floats:
    """Return columns of which a share follows a film, (n, c): of those at the velocity and those at its speed."""
    out = factor[:, None] * there
    out -= now
    out *= share
    out += now
    return out


class FilmMachine:
    """A film that lags as a causal machine: fed with consecutive pieces, it gives what one piece would.

    Parameters
    ----------
    effect, params : whose film it is. reference : what the running force on it is made from.
    """

    def __init__(self, effect: type[Effect], params: Mapping[str, float], reference: Reference) -> None:
        self._effect, self._params, self._reference = effect, params, reference
        self._running = RunningForce(reference)
        self._state = np.zeros(FILM_STATE)

    def restart(self) -> None:
        """Forget the past."""
        self._state[:] = 0.0
        self._running.restart()

    def __call__(self, features: Features) -> OnFilm | None:
        """Return what follows it in the next samples, with the running force there."""
        film = on_film(self._effect, self._params, features, self._reference, self._state)
        return None if film is None else replace(film, features=self._running(film.features))
