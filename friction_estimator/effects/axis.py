"""The velocities at which a force is tabulated, and where others lie among them."""

from collections.abc import Callable

import numpy as np

from friction_estimator.compiled import njit
from friction_estimator.core.sample import Floats

BEND = 200.0
"""Velocities are asinh-spaced, finest near standstill: v_max / BEND is where the spacing begins to grow."""

REACH = float(np.arcsinh(BEND))

KEPT, KEPT_BYTES = 32, 8 << 20
"""What is kept of what was made of arrays, and bytes of it: a joint fit asks for the same at the same samples again and
again, each in turn at the moments within a sample period that a filter of the force takes it at."""


@njit(cache=True, forceinline=True)
def share_of(bend, reach, velocity):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return where a velocity lies on an axis, from 0 at one end to 1 at the other."""
    return (np.arcsinh(velocity / bend) / reach + 1.0) * 0.5


@njit(cache=True)
def _shares(velocity, slowest, bend, reach, out):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    for k in range(velocity.size):
        v = velocity[k]
        if slowest > 0.0:
            v = max(abs(v), slowest)
        out[k] = share_of(bend, reach, v)


class LastFew:
    """What was made of arrays lately, by name and by the memory that they show; not to be written to.

    What was made of a part of an array is found again with another view of that part. The arrays are kept with it, so
    that nothing else comes to lie in their memory; nobody writes into them.

    >>> last, ones = LastFew(), np.ones(3)
    >>> last("twice", (ones[1:],), lambda: 2.0 * ones[1:]) is last("twice", (ones[1:],), lambda: 3.0 * ones[1:])
    True
    """

    def __init__(self) -> None:
        self._made: dict[tuple[object, ...], tuple[tuple[Floats, ...], Floats]] = {}

    def __call__(self, name: str, arrays: tuple[Floats, ...], make: Callable[[], Floats]) -> Floats:
        """Return what `make` makes of the arrays, from the last few that were asked for."""
        if arrays[0].size == 1:  # a live sample
            return _frozen(make())
        key = (name, *((a.__array_interface__["data"][0], a.size, a.strides) for a in arrays))
        kept = self._made.get(key)
        if kept is None:
            made = _frozen(make())
            if made.nbytes > KEPT_BYTES:
                return made
            room = KEPT_BYTES - made.nbytes
            while len(self._made) >= KEPT or sum(one.nbytes for _, one in self._made.values()) > room:
                del self._made[next(iter(self._made))]
            kept = self._made[key] = arrays, made
        return kept[1]

    def __reduce__(self) -> tuple[type["LastFew"], tuple[()]]:
        """Have copies begin with nothing: their arrays lie elsewhere."""
        return LastFew, ()


def _frozen(made: Floats) -> Floats:
    """Return an array that nobody can write into: of one sample, too, or what is compiled for it has a second form."""
    made.setflags(write=False)
    return made


class VelocityAxis:
    """Velocities v_i = (v_max / BEND) sinh(x_i), x_i evenly spaced from -REACH to REACH.

    Where samples lie on it is kept for all that is tabulated on it: the inverse sine of all samples takes ten times
    what a table's values there do.

    Parameters
    ----------
    top_m_s : v_max, positive.
    """

    def __init__(self, top_m_s: float) -> None:
        self.top_m_s, self.bend_m_s = top_m_s, top_m_s / BEND
        self._last = LastFew()

    def velocities(self, count: int) -> Floats:
        """Return v_i, (count,), m/s."""
        return np.asarray(self.bend_m_s * np.sinh(np.linspace(-1.0, 1.0, count) * REACH))

    def shares(self, velocity_m_s: Floats, slowest_m_s: float = 0.0) -> Floats:
        """Return where velocities lie, (n,), from 0 at -v_max to 1 at v_max; not to be written to.

        Where `slowest_m_s` is given the speeds are looked for, none of them as lower.
        """

        def make() -> Floats:
            return self.shares_once(velocity_m_s, slowest_m_s)

        return self._last(repr(slowest_m_s), (velocity_m_s,), make)

    def shares_once(self, velocity_m_s: Floats, slowest_m_s: float = 0.0) -> Floats:
        """Return `shares` of velocities that nobody asks for again: nothing of it is kept."""
        out = np.empty(velocity_m_s.size)
        _shares(velocity_m_s, slowest_m_s, self.bend_m_s, REACH, out)
        return _frozen(out)
