"""The friction that dynamic regressors are made from: tables of the fitted static force and of its parts."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from friction_estimator.compiled import njit
from friction_estimator.core.sample import Floats
from friction_estimator.effects.axis import LastFew, VelocityAxis, share_of

VELOCITIES = 801

PARTS = 5
FORCE, VISCOUS, BOUNDARY, DRY, WET = range(PARTS)

THEORY = (DRY, WET)
"""The parts that the theory's share of the force is the sum of."""

LOWEST = 0.1
"""Share of the smooth sign's speed below which its ratio to the force is taken there."""

LEAST_FORCE = 1e-3
"""Of the friction at top speed: what that at another speed is taken as at the least where it is divided by."""

Surface = Callable[[Floats, Floats], Floats]
"""(velocity m/s, gauge pressure Pa) -> friction N, elementwise."""

Surfaces = tuple[Surface, Surface | None, Surface | None, Surface | None]
Tabled = tuple[Floats, Floats | None, Floats | None, Floats | None]
"""Force, viscous and boundary part and theory's share, and their tables; those that are not known are None."""


MOST_STEPS = 64
"""Parts into which a step between samples is divided at most; velocity is taken as linear between samples."""


@njit(cache=True, forceinline=True)
def substeps(before, now, bend):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return the number of parts in which the velocity changes by at most `bend`: the curve is straight within each."""
    return max(1, min(MOST_STEPS, int(np.ceil(abs(now - before) / bend - 1e-9))))


@njit(cache=True)
def within(previous, velocity, pressure, bend):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return the velocity at the end of each part of each step, and the pressure there."""
    count = 0
    for k in range(velocity.size):
        count += substeps(previous[k], velocity[k], bend)
    moved, pressed = np.empty(count), np.empty(count)
    at = 0
    for k in range(velocity.size):
        count = substeps(previous[k], velocity[k], bend)
        for i in range(1, count):
            moved[at] = previous[k] + (velocity[k] - previous[k]) * i / count
            pressed[at] = pressure[k]
            at += 1
        moved[at], pressed[at] = velocity[k], pressure[k]
        at += 1
    return moved, pressed


@njit(cache=True, forceinline=True)
def cell(share, steps, pressures, pressure):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return where a point lies in a table: i and a part of the way to i + 1 in velocity, j and q in pressure."""
    along = share * steps
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
def place(pressures, bend, reach, steps, velocity, pressure):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return the `cell` of a velocity."""
    return cell(share_of(bend, reach, velocity), steps, pressures, pressure)


@njit(cache=True, forceinline=True)
def between(table, i, part, j, q):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    """Return the bilinear interpolation of table[pressure, velocity] at a `place`."""
    below = table[j, i] * (1.0 - part) + table[j, i + 1] * part
    if table.shape[0] == 1:
        return below
    above = table[j + 1, i] * (1.0 - part) + table[j + 1, i + 1] * part
    return below * (1.0 - q) + above * q


@njit(cache=True)
def _lookups(table, pressures, share, pressure, out):  # type: ignore[no-untyped-def] # pragma: no cover - compiled
    steps = table.shape[1] - 1
    for k in range(share.size):
        i, part, j, q = cell(share[k], steps, pressures, pressure[k])
        out[k] = between(table, i, part, j, q)


def table(surface: Surface, axis: VelocityAxis, pressures_Pa: Floats) -> Floats:
    """Return a surface at `VELOCITIES` of the axis and at some pressures, (n_pressures, VELOCITIES)."""
    velocity = axis.velocities(VELOCITIES)
    return np.array([surface(velocity, np.full(velocity.size, p)) for p in pressures_Pa])


def tabled(surfaces: Surfaces, axis: VelocityAxis, pressures_Pa: Floats) -> Tabled:
    """Return the `table` of a force and of those of its parts that are known."""
    force, *parts = surfaces
    viscous, boundary, theory = (None if one is None else table(one, axis, pressures_Pa) for one in parts)
    return table(force, axis, pressures_Pa), viscous, boundary, theory


@dataclass(frozen=True)
class Reference:
    """Static force of the fitted base model and its viscous and boundary parts, tabulated.

    Attributes
    ----------
    tables : (PARTS, n_pressures, VELOCITIES), N: the force F(v, p); its derivative with respect to the logarithm of the
        viscosity; the boundary part (the derivative with respect to the logarithm of its coefficient); and of the
        theory's share of the force the boundary part and the shear part, which is the rest.
    pressures_Pa : (n_pressures,), increasing gauge pressures.
    axis : the velocities.
    sign_velocity_m_s : v_s of the smooth sign tanh(v / v_s).
    taps : (order,), FIR of the base model behind the static force: [1, taps] over their sum gives gain one.
    theory_lags : (order,) or empty, lags c of the theory's part t beside it: sum_i c_i (t[k - i] - t[k]).
    theory_sign_m_s : v_s of the theory's own smooth sign, where that is known: what its part stands behind.
    """

    tables: Floats
    pressures_Pa: Floats
    axis: VelocityAxis
    sign_velocity_m_s: float
    taps: Floats = field(default_factory=lambda: np.zeros(0))
    theory_lags: Floats = field(default_factory=lambda: np.zeros(0))
    theory_sign_m_s: float | None = None
    _last: LastFew = field(default_factory=LastFew, init=False, repr=False, compare=False)

    @classmethod
    def of(
        cls,
        parts: Tabled,
        axis: VelocityAxis,
        pressures_Pa: Floats,
        sign_velocity_m_s: float,
        taps: Floats | None = None,
        theory_sign_m_s: float | None = None,
    ) -> "Reference":
        """Return the tables of a force and its parts, (n_pressures, VELOCITIES) each: see `tabled`.

        `taps` are those of the base model's FIR, `theory_sign_m_s` is v_s of the theory's own sign. Where a theory has
        no such parts they are taken as the viscous v and the Coulomb tanh(v / v_s), both scaled to the force, its own
        one to the theory. Without a theory all of the force stands for it.
        """
        force, viscous, boundary, theory = parts
        velocity = axis.velocities(VELOCITIES)

        def coulomb(scale: float, width_m_s: float) -> Floats:
            return np.broadcast_to(scale * np.tanh(velocity / width_m_s), force.shape)

        if viscous is not None and boundary is not None:
            dry = boundary
        else:
            scale = abs(float(force[0, -1])) or 1.0
            boundary = coulomb(scale, sign_velocity_m_s)
            own = theory_sign_m_s or sign_velocity_m_s
            dry = boundary if theory is None else coulomb(float(theory[0, -1]), own)
            viscous = np.broadcast_to(scale * velocity / axis.top_m_s, force.shape)
        tables = np.array([force, viscous, boundary, dry, force if theory is None else theory])
        tables[WET] -= tables[DRY]
        return cls(
            tables,
            np.asarray(pressures_Pa, np.float64),
            axis,
            sign_velocity_m_s,
            np.zeros(0) if taps is None else taps,
            theory_sign_m_s=theory_sign_m_s,
        )

    @property
    def top_N(self) -> float:
        """Force at the top speed and the medium pressure, N; 1 N where it is nothing."""
        middle = np.array([float(np.mean(self.pressures_Pa))])
        return abs(float(self.force(np.array([self.top_m_s]), middle)[0])) or 1.0

    def size_N(self, speed_m_s: float, pressure_Pa: float) -> float:
        """Return |F| at one point, N, to divide by: `LEAST_FORCE` of `top_N` where it is less."""
        (force,) = self.once(np.array([speed_m_s]), np.array([pressure_Pa]), FORCE)
        return max(abs(float(force[0])), LEAST_FORCE * self.top_N)

    @property
    def at_rest_N(self) -> float:
        """Level of friction in steady sliding at low speed and medium pressure, N."""
        return float(self.level(np.zeros(1), np.array([float(np.mean(self.pressures_Pa))]))[0])

    @property
    def top_m_s(self) -> float:
        """Largest velocity of the table."""
        return self.axis.top_m_s

    @property
    def bend_m_s(self) -> float:
        """Velocity at which the asinh spacing bends."""
        return self.axis.bend_m_s

    def part(self, which: int, velocity_m_s: Floats, pressure_Pa: Floats, slowest_m_s: float = 0.0) -> Floats:
        """Return FORCE, VISCOUS, BOUNDARY, DRY or WET at the given points, (n,), N; not to be written to.

        Where `slowest_m_s` is given it is that at the speeds, none of them as lower.
        """

        def make() -> Floats:
            return self._looked_up(which, self.axis.shares(velocity_m_s, slowest_m_s), pressure_Pa)

        return self._last(f"{which} from {slowest_m_s!r}", (velocity_m_s, pressure_Pa), make)

    def force(self, velocity_m_s: Floats, pressure_Pa: Floats) -> Floats:
        """Return F(v, p), (n,), N; not to be written to."""
        return self.part(FORCE, velocity_m_s, pressure_Pa)

    def once(self, velocity_m_s: Floats, pressure_Pa: Floats, *which: int) -> tuple[Floats, ...]:
        """Return some `part` each at points that nobody asks for again: nothing of it is kept."""
        share = self.axis.shares_once(velocity_m_s)
        return tuple(self._looked_up(part, share, pressure_Pa) for part in which)

    def within(self, previous_m_s: Floats, velocity_m_s: Floats, pressure_Pa: Floats, *which: int) -> Floats:
        """Return the sum of some `part` in shares of the way to each sample in which it is straight, N: (n,) or longer.

        The velocity is linear between samples and changes by at most the bend in each share (`substeps`). Not to be
        written to.
        """

        def make() -> Floats:
            found = self.once(*within(previous_m_s, velocity_m_s, pressure_Pa, self.bend_m_s), *which)
            return found[0] if len(found) == 1 else np.asarray(sum(found))

        return self._last(f"{which} within", (velocity_m_s, previous_m_s, pressure_Pa), make)

    def level(self, velocity_m_s: Floats, pressure_Pa: Floats) -> Floats:
        """Return the level F / S of friction in steady sliding, (n,), N: what stands behind the smooth sign.

        The theory's share stands behind its own one, which may be wider than a slow drive's: over S it would fall
        towards rest. Not to be written to.
        """
        return self._last("level", (velocity_m_s, pressure_Pa), lambda: self._level(velocity_m_s, pressure_Pa))

    def moving(self, velocity_m_s: Floats) -> Floats:
        """Return the speed, (n,), m/s, nowhere so low that the smooth sign tells no level."""
        return np.maximum(np.abs(velocity_m_s), self._slowest_m_s)

    @property
    def _slowest_m_s(self) -> float:
        return LOWEST * self.sign_velocity_m_s

    def _level(self, velocity_m_s: Floats, pressure_Pa: Floats) -> Floats:
        share, moving = self.axis.shares(velocity_m_s, self._slowest_m_s), self.moving(velocity_m_s)
        force = self._looked_up(FORCE, share, pressure_Pa)
        if self._one_sign:
            return np.asarray(force / self.smooth_sign(moving))
        theory = np.sum([self._looked_up(part, share, pressure_Pa) for part in THEORY], axis=0)
        return np.asarray((force - theory) / self.smooth_sign(moving) + theory / self.theory_sign(moving))

    def steady_sign(self, velocity_m_s: Floats, pressure_Pa: Floats) -> Floats:
        """Return the share of the level that the curve is at a velocity, with its sign, (n,)."""
        if self._one_sign:
            return self.smooth_sign(velocity_m_s)
        level, force = self.level(velocity_m_s, pressure_Pa), self.force(velocity_m_s, pressure_Pa)
        return np.divide(force, level, out=np.zeros(force.size), where=level != 0.0)

    def forward_sign(self, velocity_m_s: Floats, pressure_Pa: Floats) -> Floats:
        """Return `steady_sign` of a forward motion, (n,), between the two smooth signs: others are divided by it.

        Parts of unlike signs may cancel in the curve where they do not in its level.
        """
        narrow, wide = self.smooth_sign(velocity_m_s), self.theory_sign(velocity_m_s)
        there = self.steady_sign(velocity_m_s, pressure_Pa)
        return np.clip(there, np.minimum(narrow, wide), np.maximum(narrow, wide))

    @property
    def theory_width_m_s(self) -> float:
        """Velocity v_s of the smooth sign behind which the theory's share stands, m/s: the force's own, if unknown."""
        return self.theory_sign_m_s or self.sign_velocity_m_s

    @property
    def _one_sign(self) -> bool:
        return self.theory_width_m_s == self.sign_velocity_m_s

    def _looked_up(self, which: int, share: Floats, pressure_Pa: Floats) -> Floats:
        out = np.empty(share.size)
        _lookups(self.tables[which], self.pressures_Pa, share, pressure_Pa, out)
        return out

    def smooth_sign(self, velocity_m_s: Floats) -> Floats:
        """Return S = tanh(v / v_s), (n,)."""
        return np.asarray(np.tanh(velocity_m_s / self.sign_velocity_m_s))

    def theory_sign(self, velocity_m_s: Floats) -> Floats:
        """Return the smooth sign of the theory's share of the force, (n,)."""
        return np.asarray(np.tanh(velocity_m_s / self.theory_width_m_s))
