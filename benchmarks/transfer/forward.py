"""Forward simulation judged by position: EMPS under its measured force, friction curves of the first half.

    .venv/bin/python benchmarks/transfer/forward.py

A friction model of small error in force may still drift in position, and a simulation is what a model is bought for.
The axis M dv/dt = F(t) - f(v) starts from the measured state in the middle of the record and is never corrected; the
position error is the rms of simulated minus measured position over the second half.

Data: Janot, Gautier, Brunot 2019 (EMPS), as ../shared/data/emps_nlgreyfast/data.csv beside the project; without them it
says so and ends with code 0.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from friction_estimator.compiled import njit
from friction_estimator.core.fit.baselines import fit_baselines, scores

ROOT = Path(__file__).resolve().parents[2]
EMPS = ROOT.parent / "shared" / "data" / "emps_nlgreyfast" / "data.csv"

MASS_KG = 95.1089
"""Moving mass of EMPS, Janot, Gautier, Brunot 2019."""

NODES = 2**16
"""Nodes of the friction table each side of 0: sinh-spaced, 2e-4 apart in ratio and finer than 1e-9 of the top at 0."""

FINEST = 1e-5
"""Where the nodes pass from even to logarithmic spacing, in units of the table's top."""

STIFFEST = 1.0
"""Step times slope of f over M that Runge and Kutta's method is given: it is stable below 2.78 and accurate below 1."""

MOST_SUBSTEPS = 64
"""A jump in f has no slope: there the velocity chatters by Fc h / M, 3e-6 m/s on EMPS with this many steps a ms.

The table of `main` takes twice as many, where halving the step should change nothing.
"""

Floats = NDArray[np.float64]
Friction = Callable[[Floats], Floats]


@dataclass(frozen=True)
class Record:
    """A record of an axis: (n,) each, s, N, m, m/s, N; `start_m` is the position without its sensor's steps."""

    time_s: Floats
    force_N: Floats
    position_m: Floats
    start_m: Floats
    velocity_m_s: Floats
    friction_N: Floats

    def __getitem__(self, part: slice) -> "Record":
        return Record(*(getattr(self, name)[part] for name in self.__dataclass_fields__))

    def __len__(self) -> int:
        return int(self.time_s.size)

    @property
    def halves(self) -> tuple["Record", "Record"]:
        half = len(self) // 2
        return self[:half], self[half:]


def load(path: Path = EMPS) -> Record:
    table = np.genfromtxt(path, delimiter=",", names=True)
    names = ("t_s", "motor_force_N", "q_m", "q_filt_m", "v_m_s", "friction_N")
    return Record(*(np.ascontiguousarray(table[name]) for name in names))


def simulate_position(
    friction: Friction,
    force_N: Floats,
    time_s: Floats,
    mass_kg: float,
    q0: float,
    v0: float,
    *,
    top_m_s: float | None = None,
    substeps: int | None = None,
) -> Floats:
    """Integrate M dv/dt = F(t) - f(v), dq/dt = v from (q0, v0) and return the position (n,), m.

    Classical Runge-Kutta of fourth order, `substeps` equal steps in each interval of `time_s` (n,) s, the force (n,) N
    linear between the samples. By default so many that the slope of f at v = 0, the steepest, is resolved (`STIFFEST`).

    Parameters
    ----------
    friction : velocities (k,) m/s to friction (k,) N; called once, for a table that is read linearly.
    top_m_s : the table ends at +- this speed and is held beyond; by default the fastest the force can drive without
        friction, which no passive friction lets it exceed.
    """
    if top_m_s is None:
        # max of |integral of F| over any stretch, by its running range
        momentum = np.append(0.0, np.cumsum(0.5 * (force_N[1:] + force_N[:-1]) * np.diff(time_s)))
        top_m_s = abs(v0) + float(np.ptp(momentum)) / mass_kg
    floor = FINEST * top_m_s
    step = float(np.arcsinh(1.0 / FINEST)) / NODES
    grid = floor * np.sinh(step * np.arange(-NODES, NODES + 1))
    table = np.ascontiguousarray(friction(grid), np.float64)
    if not np.isfinite(table).all():
        raise ValueError("friction is not finite over the table's velocities")
    if substeps is None:
        # evenly over the middle, not from node to node: the rounding of neighbours' difference is no slope
        even = np.linspace(-100 * floor, 100 * floor, 401)
        steep = float(np.max(np.abs(np.diff(np.interp(even, grid, table))))) / float(even[1] - even[0])
        rate = steep * float(np.max(np.diff(time_s))) / mass_kg
        substeps = int(np.clip(np.ceil(rate / STIFFEST), 1, MOST_SUBSTEPS))
    return _runge_kutta(table, floor, step, force_N, time_s, mass_kg, q0, v0, substeps)


@njit
def _look_up(table, floor, step, v):
    """Friction at `v`, linear between the nodes of the sinh grid, held beyond its ends."""
    last = table.size - 1
    place = np.arcsinh(v / floor) / step + last // 2
    if place <= 0.0:
        return table[0]
    if place >= last:
        return table[last]
    k = int(place)
    left = floor * np.sinh(step * (k - last // 2))
    right = floor * np.sinh(step * (k + 1 - last // 2))
    return table[k] + (table[k + 1] - table[k]) * (v - left) / (right - left)


@njit
def _runge_kutta(table, floor, step, force, time, mass, q, v, substeps):
    out = np.empty(time.size)
    out[0] = q
    for k in range(time.size - 1):
        h = (time[k + 1] - time[k]) / substeps
        for i in range(substeps):
            a = force[k] + (force[k + 1] - force[k]) * i / substeps
            b = force[k] + (force[k + 1] - force[k]) * (i + 1) / substeps
            mid = 0.5 * (a + b)
            k1 = (a - _look_up(table, floor, step, v)) / mass
            v2 = v + 0.5 * h * k1
            k2 = (mid - _look_up(table, floor, step, v2)) / mass
            v3 = v + 0.5 * h * k2
            k3 = (mid - _look_up(table, floor, step, v3)) / mass
            v4 = v + h * k3
            k4 = (b - _look_up(table, floor, step, v4)) / mass
            q += h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4)
            v += h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        out[k + 1] = q
    return out


def position_error_m(friction: Friction, record: Record, substeps: int | None = None) -> float:
    """Return the rms position error, m, of a simulation of the whole of `record` from its first measured state."""
    position = simulate_position(
        friction,
        record.force_N,
        record.time_s,
        MASS_KG,
        float(record.start_m[0]),
        float(record.velocity_m_s[0]),
        top_m_s=4.0 * float(np.max(np.abs(record.velocity_m_s))),
        substeps=substeps,
    )
    return float(np.sqrt(np.mean(np.square(position - record.position_m))))


def main() -> int:
    if not EMPS.is_file():
        print(f"skipped: {EMPS} is not here (measured data are kept outside the project)")
        return 0
    fitted, held_out = load().halves
    curves = fit_baselines(fitted.velocity_m_s, fitted.friction_N)
    force = scores(curves, held_out.velocity_m_s, held_out.friction_N)
    print("| curve | nrmse of friction | position error, mm | the same with steps of 8 µs |")
    print("| --- | --- | --- | --- |")
    for name, curve in curves.items():
        error, finer = (1e3 * position_error_m(curve.evaluate, held_out, n) for n in (None, 2 * MOST_SUBSTEPS))
        print(f"| {name} | {force[name]:.4f} | {error:.3f} | {finer:.3f} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
