"""The friction that dynamic regressors are made from: tables of the fitted static force and of its parts."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from friction_estimator.compiled import njit
from friction_estimator.core.sample import Floats

VELOCITIES = 801
BEND = 200.0
"""Table velocities are asinh-spaced, finest near standstill: v_max / BEND is where the spacing begins to grow."""

FORCE, VISCOUS, BOUNDARY, SHEAR = range(4)

LOWEST = 0.1
"""Share of the smooth sign's speed below which its ratio to the force is taken there."""

KEPT, KEPT_BYTES = 32, 8 << 20
"""Columns that a reference keeps, and bytes of them: a joint fit asks for the same at the same samples again and again,
each in turn at the moments within a sample period that a filter of the force takes it at."""

Surface = Callable[[Floats, Floats], Floats]
"""(velocity m/s, gauge pressure Pa) -> friction N, elementwise."""


@njit(cache=True, forceinline=True)
def place(pressures, bend, reach, steps, velocity, pressure):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return where a point lies in a table: i and a part of the way to i + 1 in velocity, j and q in pressure."""
    along = (np.arcsinh(velocity / bend) / reach + 1.0) * 0.5 * steps
    if along < 0.0:
        along = 0.0
    elif along > steps:
        along = float(steps)
    i = min(int(along), steps - 1)
    j, q = 0, 0.0
    if pressures.size > 1:
        while j < pressures.size - 2 and pressure > pressures[j + 1]:
            j += 1
        q = min(max((pressure - pressures[j]) / (pressures[j + 1] - pressures[j]), 0.0), 1.0)
    return i, along - i, j, q


@njit(cache=True, forceinline=True)
def between(table, i, part, j, q):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return the bilinear interpolation of table[pressure, velocity] at a `place`."""
    below = table[j, i] * (1.0 - part) + table[j, i + 1] * part
    if table.shape[0] == 1:
        return below
    above = table[j + 1, i] * (1.0 - part) + table[j + 1, i + 1] * part
    return below * (1.0 - q) + above * q


@njit(cache=True, forceinline=True)
def lookup(table, pressures, bend, reach, velocity, pressure):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return the bilinear interpolation of table[pressure, velocity]; both are held at the edges."""
    i, part, j, q = place(pressures, bend, reach, table.shape[1] - 1, velocity, pressure)
    return between(table, i, part, j, q)


@njit(cache=True)
def _lookups(table, pressures, bend, reach, velocity, pressure, out):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    steps = table.shape[1] - 1
    for k in range(velocity.size):
        i, part, j, q = place(pressures, bend, reach, steps, velocity[k], pressure[k])
        out[k] = between(table, i, part, j, q)


@dataclass(frozen=True)
class Reference:
    """Static force of the fitted base model and its viscous and boundary parts, tabulated.

    Attributes
    ----------
    tables : (4, n_pressures, VELOCITIES), N: the force F(v, p); its derivative with respect to the logarithm of the
        viscosity; the boundary part (the derivative with respect to the logarithm of its coefficient); and the
        shear part, which is the rest of the theory.
    pressures_Pa : (n_pressures,), increasing gauge pressures.
    bend_m_s : velocity at which the asinh spacing bends.
    top_m_s : largest velocity of the table.
    sign_velocity_m_s : v_s of the smooth sign tanh(v / v_s).
    taps : (order,), FIR of the base model behind the static force: [1, taps] over their sum gives gain one.
    """

    tables: Floats
    pressures_Pa: Floats
    bend_m_s: float
    top_m_s: float
    sign_velocity_m_s: float
    taps: Floats = field(default_factory=lambda: np.zeros(0))
    _kept: dict[tuple[str, int, int], tuple[Floats, Floats, Floats]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    @classmethod
    def tabulate(
        cls,
        force: Surface,
        viscous: Surface | None,
        boundary: Surface | None,
        theory: Surface | None,
        top_m_s: float,
        pressures_Pa: Floats,
        sign_velocity_m_s: float,
        taps: Floats | None = None,
    ) -> "Reference":
        """Tabulate the surfaces.

        `taps` are those of the base model's FIR. Without a theory the parts are taken as the viscous v and the
        Coulomb tanh(v / v_s), both scaled to the force, and the shear part is the rest.
        """
        bend = top_m_s / BEND
        velocity = bend * np.sinh(np.linspace(-1.0, 1.0, VELOCITIES) * np.arcsinh(BEND))
        scale = float(np.max(np.abs(force(np.array([top_m_s]), pressures_Pa[:1])))) or 1.0
        if viscous is None or boundary is None or theory is None:
            theory = force

            def viscous(v: Floats, p: Floats) -> Floats:
                return scale * v / top_m_s + 0.0 * p

            def boundary(v: Floats, p: Floats) -> Floats:
                return np.asarray(scale * np.tanh(v / sign_velocity_m_s) + 0.0 * p)

        tables = np.array(
            [
                [surface(velocity, np.full(velocity.size, p)) for p in pressures_Pa]
                for surface in (force, viscous, boundary, theory)
            ]
        )
        tables[SHEAR] -= tables[BOUNDARY]
        return cls(
            tables,
            np.asarray(pressures_Pa, np.float64),
            bend,
            top_m_s,
            sign_velocity_m_s,
            np.zeros(0) if taps is None else taps,
        )

    @property
    def top_N(self) -> float:
        """Force at the top speed and the medium pressure, N; 1 N where it is nothing."""
        middle = np.array([float(np.mean(self.pressures_Pa))])
        return abs(float(self.force(np.array([self.top_m_s]), middle)[0])) or 1.0

    @property
    def reach(self) -> float:
        """asinh(top / bend)."""
        return float(np.arcsinh(self.top_m_s / self.bend_m_s))

    def part(self, which: int, velocity_m_s: Floats, pressure_Pa: Floats) -> Floats:
        """Return FORCE, VISCOUS, BOUNDARY or SHEAR at the given points, (n,), N; not to be written to."""
        return self._once(str(which), lambda v, p: self._looked_up(which, v, p), velocity_m_s, pressure_Pa)

    def force(self, velocity_m_s: Floats, pressure_Pa: Floats) -> Floats:
        """Return F(v, p), (n,), N; not to be written to."""
        return self.part(FORCE, velocity_m_s, pressure_Pa)

    def level(self, velocity_m_s: Floats, pressure_Pa: Floats) -> Floats:
        """Return the level F / S of friction in steady sliding, (n,), N: what stands behind the smooth sign.

        Not to be written to.
        """
        return self._once("level", self._level, velocity_m_s, pressure_Pa)

    def moving(self, velocity_m_s: Floats) -> Floats:
        """Return the speed, (n,), m/s, nowhere so low that the smooth sign tells no level."""
        return np.maximum(np.abs(velocity_m_s), LOWEST * self.sign_velocity_m_s)

    def _level(self, velocity_m_s: Floats, pressure_Pa: Floats) -> Floats:
        moving = self.moving(velocity_m_s)
        return np.asarray(self._looked_up(FORCE, moving, pressure_Pa) / self.smooth_sign(moving))

    def _looked_up(self, which: int, velocity_m_s: Floats, pressure_Pa: Floats) -> Floats:
        out = np.empty(velocity_m_s.size)
        _lookups(self.tables[which], self.pressures_Pa, self.bend_m_s, self.reach, velocity_m_s, pressure_Pa, out)
        return out

    def _once(
        self, name: str, make: Callable[[Floats, Floats], Floats], velocity_m_s: Floats, pressure_Pa: Floats
    ) -> Floats:
        """Return what is made of these very arrays, from the last few that were asked for."""
        if velocity_m_s.size == 1:  # a live sample
            return make(velocity_m_s, pressure_Pa)
        key = name, id(velocity_m_s), id(pressure_Pa)
        kept = self._kept.get(key)
        if kept is None or kept[0] is not velocity_m_s or kept[1] is not pressure_Pa:
            made = make(velocity_m_s, pressure_Pa)
            made.setflags(write=False)
            while self._kept and len(self._kept) >= min(KEPT, KEPT_BYTES // max(1, made.nbytes)):
                del self._kept[next(iter(self._kept))]
            kept = self._kept[key] = velocity_m_s, pressure_Pa, made
        return kept[2]

    def smooth_sign(self, velocity_m_s: Floats) -> Floats:
        """Return S = tanh(v / v_s), (n,)."""
        return np.asarray(np.tanh(velocity_m_s / self.sign_velocity_m_s))
