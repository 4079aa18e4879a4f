"""Make the tables of the tutorial: two days of one simulated rig, as its data logger would have written them.

    python docs/tutorial/make_tables.py FOLDER

The friction is a textbook's (plant `stribeck`: Coulomb, Stribeck and viscous), beside which a hose pulls like a spring.
The logger rounds: positions to 1 um, velocities to 0.01 mm/s, forces to 1 mN.
"""

import sys
from pathlib import Path

import numpy as np

from friction_estimator.effects import parse_effect
from friction_estimator.rig.drive import parse_schedule
from friction_estimator.rig.profiles import Geometry
from friction_estimator.rig.simulate import Scenario, simulate

STIFFNESS = 45.0
"""Of the hose, N/m: what the tutorial is to find."""

RATE_HZ = 200.0

DAYS = {
    "monday": ("4:0:16,2:0:12,1:0:6", 0.020, 11),
    "tuesday": ("3:0:12:triangle,1:0:8:crank", 0.016, 12),
}
"""Table -> schedule, half stroke in m, seed of the noise."""

HEADER = "t [ms],x [mm],v [mm/s],F [N]"


def make(folder: Path) -> None:
    """Write the tables into a folder."""
    for day, (schedule, half_stroke, seed) in DAYS.items():
        scenario = Scenario(
            parse_schedule(schedule),
            plant="stribeck",
            rate_hz=RATE_HZ,
            noise=0.015,
            seed=seed,
            effects=(parse_effect(f"side_spring:stiffness={STIFFNESS}"),),
            geometry=Geometry(half_stroke, 5.0 * half_stroke),
        )
        samples = simulate(scenario).samples
        assert samples.position_m is not None
        rows = np.column_stack([1e3 * samples.position_m, 1e3 * samples.velocity_m_s, samples.friction_N])
        lines = [f"{1e3 * t:.0f},{x:.3f},{v:.2f},{f:.3f}" for t, (x, v, f) in zip(samples.time_s, rows, strict=True)]
        (folder / f"{day}.csv").write_text("\n".join([HEADER, *lines]) + "\n", encoding="utf-8")


if __name__ == "__main__":
    make(Path(sys.argv[1]))
