"""How the cost of a sample grows with weights and taps: the compiled loops beside the same laws in C.

A part of `python benchmarks/bench.py`.
"""

from typing import Any

from bodies import COMPILER, LAWS, c_of, estimator, loop_of, record
from in_c import compiled
from measure import cpu_us, in_turn, part

AXES = {
    "weights": ("basis.finest_level", (1, 0, -1, -2, -3, -4)),
    "taps": ("fir.order", (2, 5, 8, 17, 32, 64)),
}
"""What grows: the setting and its values."""


def measured(samples: int, rounds: int) -> dict[str, Any]:
    driven, library = record(samples), compiled() if COMPILER else None
    found: dict[str, Any] = {axis: {} for axis in AXES}
    for axis, (setting, values) in AXES.items():
        for law in LAWS:
            part_of = driven[: samples // 5 if law == "rls" else samples]
            bodies, sizes = {}, []
            for value in values:
                est = estimator(driven, "hammerstein", law, **{setting: value})
                sizes.append(int(est.model.shape[1 if axis == "weights" else 0]))
                bodies["loop", value] = cpu_us(loop_of(est, part_of), len(part_of))
                if library:
                    bodies["C", value] = cpu_us(c_of(library, est, part_of), len(part_of))
            costs = in_turn(bodies, rounds)
            found[axis][law] = {"size": sizes} | {
                f"{who}_us": [costs[who, value] for value in values]
                for who in ("loop", "C")
                if (who, values[0]) in costs
            }
    return {"samples": samples, **found}


if __name__ == "__main__":
    part(measured, __doc__, samples=20_000, rounds=7)
