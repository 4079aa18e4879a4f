"""Hide effects in recordings of real machines: plants that no simulation made.

    python benchmarks/diagnosis/measured.py --seed 5 --workers 2                   what ../shared/data holds
    python benchmarks/diagnosis/measured.py --seed 5 --workers 2 --tables DIR      and the tables of ../shared/real

What a machine says of itself, with nothing hidden, is not judged: nobody knows its truth. Judged is what an answer says
beside that. Each effect changes the recorded force (or velocity) by `--size` of the force's rms, along the motion that
was recorded. What acts through the curve of friction acts on a Coulomb and viscous fit of the machine; the rest of the
measured force stays. One JSON line a record goes to benchmarks/out/; a run that was interrupted goes on where it
stopped. Seeds 0 and 1 are for tuning, 2 to 5 were looked at. Set OPENBLAS_NUM_THREADS=1.
"""

import argparse
import json
import sys
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path
from time import process_time

import numpy as np
from judge import Line, told

from friction_estimator.bag.table import TableSpec, read_table
from friction_estimator.core.errors import ConfigError
from friction_estimator.core.sample import NS_PER_S, Bools, Floats, Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.diagnose import diagnose
from friction_estimator.effects import EFFECTS, Effect
from friction_estimator.effects.compose import compose
from friction_estimator.effects.trace import Trace

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import provenance
from tables import table

HERE = Path(__file__).resolve().parent
DATA = HERE.parents[2] / "shared" / "data"
NOTHING = "nothing"
WITHOUT_THEORY = Config.from_mapping({"model.type": "hammerstein", "theory.kind": "none"})
ATMOSPHERE_PA = 101325.0
DAMIAO_TURN, DAMIAO_SCALE = 25.0, 0.5026
"""Of motor 3: where its encoder wraps, rad, and its velocity over the derivative of its position."""

NAMES = (
    *("sensor_bias", "sensor_drift", "bias_step", "gain_step", "viscosity_drift", "wear"),
    *("side_spring", "viscoelastic_relaxation", "inertia", "direction_asymmetry", "position_dependence"),
    *("presliding", "squeeze_film", "frictional_lag", "time_delay", "sensor_lowpass", "velocity_delay"),
    *("periodic_disturbance", "dropout", "outliers", "quantization", "saturation", "velocity_mismatch"),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--tables", type=Path, help="folder of fairino_S.csv, fairino_zhixian.csv and damiao_3.csv")
    parser.add_argument("--size", type=float, default=0.1, help="rms of a change over that of the friction")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--out", type=Path, default=HERE.parent / "out", help="folder of the lines")
    parser.add_argument("--page", type=Path, default=HERE / "measured.md")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    path = given.out / f"measured_{given.seed}_{given.size:g}.jsonl"
    done = {(line["machine"], line["hidden"]) for line in _lines(path)}
    cases = [
        (machine, samples, hidden, given.size, given.seed)
        for machine, samples in machines(given.data, given.tables)
        for hidden in (NOTHING, *NAMES)
        if (machine, hidden) not in done
    ]
    with get_context("spawn").Pool(given.workers) as pool, path.open("a", encoding="utf-8") as file:
        for line in pool.imap(answer, cases):
            file.write(json.dumps(line) + "\n")
            file.flush()
            told_as = line.get("not_made") or [line["verdict"], [one["name"] for one in _findings(line)]]
            print(line["machine"], line["hidden"], told_as, flush=True)
    options = "".join(f" --{name} {value:g}" for name, value in (("seed", given.seed), ("size", given.size)))
    command = f"python benchmarks/diagnosis/measured.py{options}{' --tables DIR' if given.tables else ''}"
    given.page.write_text(page(_lines(path), given.size, command), encoding="utf-8")


def _lines(path: Path) -> list[Line]:
    """Return the lines of a file; one that a stopped run wrote in part is taken off it."""
    whole = path.read_text(encoding="utf-8") if path.exists() else ""
    kept = whole[: whole.rfind("\n") + 1]
    if kept != whole:
        path.write_text(kept, encoding="utf-8")
    return [json.loads(text) for text in kept.splitlines()]


# Machines


def machines(data: Path, tables: Path | None) -> Iterator[tuple[str, Samples]]:
    """Yield name and recording of each machine."""
    emps = {"velocity": "v_m_s", "friction": "friction_filt_N", "position": "q_filt_m"}
    yield "EMPS", read_table(data / "emps_nlgreyfast" / "data.csv", TableSpec("t_s", emps))[0]
    inputs = {"velocity": "v_m_s", "friction": "friction_N", "pressure": "pressure_Pa", "position": "x_m"}
    for seal, bar in (("O-ring257", "5"), ("X-ring257", "3")):
        spec = TableSpec("t_s", inputs, [("seal", seal), ("nominal_bar", bar)], "segment")
        samples, _ = read_table(data / "seal_zillen_pneumatic" / "data.csv", spec)
        assert samples.pressure_Pa is not None
        yield f"{seal}, {bar} bar", replace(samples, pressure_Pa=samples.pressure_Pa + ATMOSPHERE_PA)
    if tables is None:
        return
    joint = {"velocity": "v_rad_s", "friction": "friction_Nm", "position": "q_rad"}
    for run in ("S", "zhixian"):
        yield f"FAIRINO {run}", read_table(tables / f"fairino_{run}.csv", TableSpec("t_s", joint))[0]
    wrapped = TableSpec("t_s", joint | {"position": "q_wrapped_rad"}, [("repetition", "1")])
    motor, _ = read_table(tables / "damiao_3.csv", wrapped)
    assert motor.position_m is not None
    yield "damiao 3", replace(motor, position_m=np.unwrap(motor.position_m, period=DAMIAO_TURN) * DAMIAO_SCALE)


def trace(samples: Samples) -> Trace:
    """Return a recording as a simulated run that has come as far as its sensors.

    Its law is Coulomb, viscous and an offset, fitted where the shaft moves, with what they leave of the measured force.
    """
    time_s = (samples.stamp_ns - samples.stamp_ns[0]) / NS_PER_S
    n, velocity = len(samples), samples.velocity_m_s
    ones = np.ones(n)
    columns = np.column_stack([np.sign(velocity), velocity, ones])
    moves = np.abs(velocity) > 0.02 * _top(samples)
    coulomb, viscous, offset = np.linalg.lstsq(columns[moves], samples.friction_N[moves], rcond=None)[0]
    rest_N = samples.friction_N - columns @ np.array([coulomb, viscous, offset])

    def law(run: Trace) -> Floats:
        direction = np.sign(run.velocity_m_s)
        film = direction * run.film_speed_m_s * run.viscosity_factor
        return np.asarray(coulomb * direction * run.boundary_factor + viscous * film + offset + rest_N)

    assert samples.position_m is not None
    return Trace(
        time_s=time_s,
        position_m=samples.position_m,
        velocity_m_s=velocity,
        acceleration_m_s2=_accelerations(velocity, time_s, samples.restart),
        pressure_Pa=ATMOSPHERE_PA * ones if samples.pressure_Pa is None else samples.pressure_Pa,
        temperature_degC=20.0 * ones,
        friction_N=samples.friction_N.copy(),
        velocity_measured_m_s=velocity.copy(),
        position_measured_m=samples.position_m.copy(),
        stamp_ns=samples.stamp_ns.copy(),
        friction_stamp_ns=samples.stamp_ns.copy(),
        film_speed_m_s=np.abs(velocity),
        viscosity_factor=ones,
        boundary_factor=ones,
        period_s=np.zeros(n),
        law=law,
    )


def _accelerations(velocity: Floats, time_s: Floats, restart: Bools) -> Floats:
    """Return the derivative of the velocity within each stretch without gap, (n,), m/s^2."""
    out = np.zeros(velocity.size)
    edges = np.append(np.flatnonzero(restart), velocity.size)
    for a, b in pairwise(edges):
        if b - a > 1:
            out[a:b] = np.gradient(velocity[a:b], time_s[a:b])
    return out


def _top(samples: Samples) -> float:
    """Return the speed that is seldom exceeded, m/s."""
    return float(np.quantile(np.abs(samples.velocity_m_s), 0.95))


# What is hidden


def drawn(name: str, machine: str, samples: Samples, size: float, seed: int) -> Effect:
    """Draw an effect of a given size, its times and lengths in the units of the recording."""
    rng = np.random.default_rng([seed, *machine.encode(), *name.encode()])

    def wide(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    time_s = (samples.stamp_ns - samples.stamp_ns[0]) / NS_PER_S
    step_s, length_s = float(np.median(np.diff(time_s))), float(time_s[-1])
    assert samples.position_m is not None
    stroke = float(np.ptp(samples.position_m))
    distance = float(np.abs(samples.velocity_m_s).sum()) * step_s
    draws: Mapping[str, Mapping[str, float]] = {
        "viscosity_drift": {"time_constant": wide(0.05, 0.64) * length_s},
        "wear": {"length": wide(0.05, 0.7) * distance},
        "bias_step": {"at": rng.uniform(0.08, 0.92) * length_s},
        "gain_step": {"at": rng.uniform(0.08, 0.92) * length_s},
        "presliding": {"length": wide(2.5e-4, 2e-3) * stroke},
        "squeeze_film": {"speed": wide(0.05, 0.3) * _top(samples)},
        "viscoelastic_relaxation": {"time_constant": wide(3.0, 100.0) * step_s},
        "periodic_disturbance": {"frequency": wide(0.02, 0.3) / step_s},
        "position_dependence": {"wavelength": wide(0.04, 0.4) * stroke, "phase": rng.uniform(-3.1, 3.1)},
        "dropout": {"length": float(rng.integers(3, 13))},
        "outliers": {"fraction": wide(3e-4, 1e-3)},
    }
    bounds = {key.name: (key.low, key.high) for key in EFFECTS[name].keys}
    values = {key: float(np.clip(value, *bounds[key])) for key, value in draws.get(name, {}).items()}
    return EFFECTS[name](size=size, **values)


def answer(case: tuple[str, Samples, str, float, int]) -> Line:
    """Return what the diagnosis says of a recording with an effect hidden in it, as plain data.

    A case is the machine, its recording, what is hidden, its size and the seed.
    """
    machine, samples, hidden, size, seed = case
    line: Line = {"machine": machine, "hidden": hidden}
    if hidden != NOTHING:
        effect = drawn(hidden, machine, samples, size, seed)
        try:
            run, (effect,) = compose(trace(samples), [effect], noise=0.0, every=1, seed=seed)
        except ConfigError as error:
            return line | {"not_made": str(error)}
        line["values"] = effect.values
        samples = replace(
            samples,
            friction_N=run.friction_N,
            velocity_m_s=run.velocity_measured_m_s,
            position_m=run.position_measured_m,
        )
    began = process_time()
    result = told(diagnose([samples], WITHOUT_THEORY))
    return line | {"cpu_s": process_time() - began} | result


# The page

BEFORE, NAMED, SET, MISSED, UNMADE = "there before", "named", "in a set", "no", "-"


def judged(line: Line, alone: Line) -> tuple[str, list[str]]:
    """Return how the hidden effect was told, and the further names that the machine alone does not have."""
    hidden = line["hidden"]
    if "not_made" in line:
        return UNMADE, []
    before = {one["name"]: one["rivals"] for one in _findings(alone)}
    now = {one["name"]: one["rivals"] for one in _findings(line)}
    known = set(before).union(*before.values())
    listed = {name for name, rivals in now.items() if hidden in rivals}
    further = [name for name in now if name not in known | listed | {hidden}]
    if hidden in before:
        return BEFORE, further
    if hidden in now:
        return NAMED, further
    if listed - {name for name, rivals in before.items() if hidden in rivals}:
        return SET, further
    return (BEFORE if hidden in known else MISSED), further


def _findings(line: Line) -> list[Line]:
    return [*line["faults"], *line["effects"]]


def page(lines: list[Line], size: float, command: str) -> str:
    """Return the page."""
    alone = {line["machine"]: line for line in lines if line["hidden"] == NOTHING}
    found = {(line["machine"], line["hidden"]): judged(line, alone[line["machine"]]) for line in lines}
    made = {key: one for key, one in found.items() if key[1] != NOTHING and one[0] != UNMADE}
    asked = [told_as for told_as, _ in made.values() if told_as != BEFORE]
    further = [names for _, names in made.values() if names]
    own = [
        [
            machine,
            f"{100 * line['base']:.3g}",
            f"{line['unexplained']:.3g}",
            ", ".join(e["name"] for e in _findings(line)),
        ]
        for machine, line in alone.items()
    ]
    cells = [[found.get((machine, name), (UNMADE, [])) for machine in alone] for name in NAMES]
    told_as = [[name, *(" + ".join([one, *more]) for one, more in row)] for name, row in zip(NAMES, cells, strict=True)]
    parts = [
        "# Effects hidden in measured recordings",
        provenance.line(command).strip(),
        f"Changes of {100 * size:g} % of the friction's rms in recordings of real machines; what is hidden, and\n"
        "how it is judged, says [measured.py](measured.py). A machine's own names are not: nobody knows its truth.",
        "## What each machine says of itself",
        table(["machine", "error, %", "left, %", "names"], own),
        "## With an effect hidden",
        f"Named in {asked.count(NAMED)} of {len(asked)}, in a set in {asked.count(SET)} more.\n"
        f"In {len(further)} of {len(made)} a further name, which the machine alone neither has nor lists as a rival.",
        table(["hidden", *alone], told_as),
    ]
    return "\n\n".join(parts) + "\n"


if __name__ == "__main__":
    main()
