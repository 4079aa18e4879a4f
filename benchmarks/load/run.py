"""Load terms on simulated joints: are they within their intervals, what is said where the drive separates nothing, and
what does not knowing them cost the friction?

    python benchmarks/load/run.py [--seeds 20] [--first-seed 0] [--part others | 'plain gear' | moves]
    python benchmarks/load/run.py --set load.half_width=0.012

Each seed draws the load, the amplitude, the period, the noise, and an encoder of 4096 counts a turn for the position.
The plants of `simulate` stand beside friction of other forms that nothing was chosen on.
"""

import argparse
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import yaml

from friction_estimator.core.fit.batch import fit_batch, predict
from friction_estimator.core.fit.load_report import LearnedLoad
from friction_estimator.core.intake.admission import Intake
from friction_estimator.core.intake.pairing import FRICTION, POSITION, VELOCITY
from friction_estimator.core.intake.standstill import standstill
from friction_estimator.core.model.load import LoadTerms
from friction_estimator.core.model.structure import Parameters
from friction_estimator.core.online.first_contact import chosen
from friction_estimator.core.online.replay import replay
from friction_estimator.core.sample import Floats, Ints, Samples, in_sequence
from friction_estimator.core.settings.config import Config
from friction_estimator.rig.drive import Segment, run_drive
from friction_estimator.rig.profiles import PROFILES, Geometry
from friction_estimator.rig.profiles import Motion as Cycle

COUNTS = 4096
SECONDS = 24.0
VELOCITY_NOISE = 0.003
"""Of the top speed: an encoder's velocity after its own filter."""

FORCE_NOISE = 0.01
"""Of the friction's rms."""

Friction = Callable[[Floats, Floats, Floats], Floats]
"""(velocity, load, time step) -> friction, N m, in units of the joint's Coulomb level."""


SHARE = 0.03
"""Of the load that joins the friction of the geared joint."""

PENDULUM = (1.0, 0.5, 0.6, 0.04, 0.15)
"""Numbers of `stribeck`: Coulomb level, its excess at rest, Stribeck speed, width of the reversal, viscous."""

JOINT = (1.0, 0.4, 0.3, 0.03, 0.1, 0.4, 0.7, SHARE)
"""Those of `geared`: the same four, how unlike the directions are, viscous and its power, share of the load."""


def stribeck(v: Floats, load: Floats, step_s: Floats, numbers: Sequence[float] = PENDULUM) -> Floats:  # noqa: ARG001
    """The pendulum's form."""
    coulomb, excess, speed, width, viscous = numbers
    return coulomb * (1.0 + excess * np.exp(-np.square(v / speed))) * np.tanh(v / width) + viscous * v


def geared(v: Floats, load: Floats, step_s: Floats, numbers: Sequence[float] = JOINT) -> Floats:  # noqa: ARG001
    """The geared joint's form: unlike directions, teeth that rub more under load."""
    coulomb, excess, speed, width, unlike, viscous, power, share = numbers
    level = coulomb + excess * np.exp(-np.abs(v) / speed) + share * np.abs(load)
    return level * np.tanh(v / width) * (1.0 + unlike * np.sign(v)) + viscous * np.sign(v) * np.abs(v) ** power


def lugre(v: Floats, load: Floats, step_s: Floats) -> Floats:  # noqa: ARG001
    """Bristles (Canudas de Wit 1995): dz = v - |v| z / s(v), f = z / 0.01 + 0.1 v, s the Stribeck level."""
    z, out = 0.0, np.empty(v.size)
    level = 0.01 * (1.0 + 0.4 * np.exp(-np.square(v / 0.3)))
    for k in range(v.size):
        for _ in range(4):
            z += 0.25 * step_s[k] * v[k] / (1.0 + 0.25 * step_s[k] * abs(v[k]) / level[k]) - z * (
                1.0 - 1.0 / (1.0 + 0.25 * step_s[k] * abs(v[k]) / level[k])
            )
        out[k] = z / 0.01 + 0.1 * v[k]
    return out


def table(v: Floats, load: Floats, step_s: Floats) -> Floats:  # noqa: ARG001
    """Measured points with unlike directions, straight between them."""
    speed = np.array([0.0, 0.05, 0.2, 0.6, 1.5, 3.0, 6.0, 12.0])
    out = np.interp(np.abs(v), speed, [0.0, 0.95, 1.1, 0.9, 0.85, 1.0, 1.3, 1.9])
    back = np.interp(np.abs(v), speed, [0.0, 0.8, 0.9, 0.8, 0.8, 0.95, 1.2, 1.8])
    return np.where(v > 0.0, out, -back)


MOVES = (
    (0.02, 1.0, 0.005, 0.2, 0.01),
    (0.30, 0.6, 0.02, 0.08, 0.005),
    (0.5, -0.8, 0.01, 0.2, 0.01),
    (0.73, -0.4, 0.005, 0.225, 0.02),
)
"""Start, speed, and the shares of the cycle that starting, cruising and stopping take: ramps of 20 to 125 ms."""


@PROFILES.named("moves")
def moves(phase: Floats, cycle: Ints, geometry: Geometry) -> Cycle:  # noqa: ARG001
    """From point to point with trapezoids of velocity: what most machines do. Two corners may lie in one window."""
    knots, speeds = [0.0], [0.0]
    for start, speed, up, cruise, down in MOVES:
        knots += [start, start + up, start + up + cruise, start + up + cruise + down]
        speeds += [0.0, speed, speed, 0.0]
    at, rate = np.append(knots, 1.0), np.append(speeds, 0.0)
    travelled = np.append(0.0, np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(at)))
    piece = np.clip(np.searchsorted(at, phase, side="right") - 1, 0, at.size - 2)
    since, slope = phase - at[piece], (np.diff(rate) / np.diff(at))[piece]
    position = travelled[piece] + (rate[piece] + 0.5 * slope * since) * since
    scale = 2.0 * geometry.eccentric_m / travelled.max()
    return Cycle(scale * position - geometry.eccentric_m, scale * (rate[piece] + slope * since), scale * slope)


PLAIN_GEAR = "geared joint, its load_dependence not named"

FRICTIONS: dict[str, Friction] = {
    "pendulum": stribeck,
    "geared_joint": geared,
    "lugre": lugre,
    "table": table,
    PLAIN_GEAR: geared,
}

DRIVES = {
    "multisine": (("multisine", 4.0),),
    "two sines": (("sine", 4.0), ("sine", 1.5)),
    "triangle": (("triangle", 2.5),),
    "two cranks": (("crank", 5.0), ("crank", 1.2)),
    "speed steps": (("speed_steps", 8.0),),
    "moves": (("moves", 5.0),),
    "one sine": (("sine", 2.0),),
    "tiny stroke": (("multisine", 2.0),),
}
"""The last two separate little: there the figure is what is said."""

MAIN = tuple(DRIVES)[:4]
"""Drives of the first part. The cranks came last: nothing was tuned on them."""

GEARED = "geared_joint"
FOLLOWING = "load_dependence"


@dataclass(frozen=True)
class Record:
    """Samples of one drive with the truth: unknown coefficients, terms that tell them, (q, v, a) as they are."""

    time: Floats
    position: Floats
    velocity: Floats
    effort: Floats
    load: Floats
    truth: dict[str, float]
    unknown: list[str]
    known: list[str]
    exact: tuple[Floats, Floats, Floats]

    def admitted(self, config: Config) -> Samples:
        """Return the samples as replay has them."""
        n = self.time.size
        stamps = 10**18 + np.round(self.time * 1e9).astype(np.int64)
        intake = Intake(config, capacity=n + 1)
        values = np.column_stack([self.position, self.velocity, self.effort]).ravel()
        first = intake.push(np.tile([POSITION, VELOCITY, FRICTION], n), np.repeat(stamps, 3), values)
        last = intake.drain()
        return first if last is None else in_sequence([first, last])


def record(plant: str, drive: str, rate_hz: float, seed: int) -> Record:
    """Return one seed's record."""
    rng = np.random.default_rng([seed, len(plant), len(drive)])
    level = float(np.exp(rng.uniform(np.log(0.05), np.log(5.0))))
    times = rng.uniform(0.8, 1.25)
    amplitude = 0.03 if drive == "tiny stroke" else rng.uniform(0.7, 1.4)
    parts = DRIVES[drive]
    segments = [Segment(p * times, 0.0, max(1, round(SECONDS / len(parts) / p)), name) for name, p in parts]
    motion = run_drive(tuple(segments), Geometry(amplitude, 5.0 * amplitude), rate_hz)
    q, v, a = motion.position_m, motion.velocity_m_s, motion.acceleration_m_s2
    q = q + rng.uniform(-0.5, 0.5)
    truth = {
        "inertia": float(level * rng.uniform(0.3, 2.0) / np.std(a)),
        "gravity:sin": float(level * rng.uniform(1.0, 6.0)),
        "gravity:cos": float(level * rng.uniform(-2.0, 2.0)),
        FOLLOWING: SHARE,
    }
    load = truth["inertia"] * a + truth["gravity:sin"] * np.sin(q) + truth["gravity:cos"] * np.cos(q)
    friction = level * FRICTIONS[plant](v, load / level, np.full(v.size, 1.0 / rate_hz))
    noise = FORCE_NOISE * np.std(friction) * rng.standard_normal(v.size)
    count = 2.0 * np.pi / COUNTS
    unknown = ["inertia", "gravity"] + ([FOLLOWING] if plant == GEARED else [])
    known = [f"inertia={truth['inertia']!r}", f"gravity:sin={truth['gravity:sin']!r},cos={truth['gravity:cos']!r}"]
    known += unknown[2:]
    return Record(
        motion.time_s,
        np.round(q / count) * count,
        v + VELOCITY_NOISE * np.abs(v).max() * rng.standard_normal(v.size),
        friction + load + noise,
        load,
        truth,
        unknown,
        known,
        (q, v, a),
    )


def released(plant: str, rate_hz: float, seed: int) -> Record:
    """Return a weight that is let go again and again, the motor off: effort 0, gravity known, inertia sought."""
    rng = np.random.default_rng([seed, 77])
    inertia, weight, level, fine = float(0.02 * rng.uniform(0.7, 1.4)), float(0.8 * rng.uniform(0.7, 1.4)), 0.03, 8
    step = 1.0 / rate_hz / fine
    rows, start = [], 0.0
    for _ in range(8):
        q, v = rng.choice([-1.0, 1.0]) * rng.uniform(1.5, 2.6), 0.0
        for k in range(int(3.0 * rate_hz * fine)):
            friction = level * float(FRICTIONS[plant](np.array([v]), np.zeros(1), np.full(1, step))[0])
            v += step * -(weight * np.sin(q) + friction) / inertia
            q += step * v
            if k % fine == 0:
                rows.append((start + k * step, q, v))
        start += 10.0
    time, q, v = np.array(rows).T
    load = np.zeros(time.size)
    return Record(
        time,
        q,
        v + VELOCITY_NOISE * np.abs(v).max() * rng.standard_normal(v.size),
        FORCE_NOISE * level * rng.standard_normal(v.size),
        load,
        {"inertia": inertia},
        ["inertia", f"gravity:sin={weight!r},cos=0"],
        [],
        (q, v, np.gradient(v, time)),
    )


def config_of(terms: list[str], given: dict[str, Any]) -> Config:
    """Return the configuration of a run; `given` are settings of the command line."""
    settings = {"model.type": "hammerstein", "theory.kind": "none", "input.motion": "rotary"}
    return Config.from_mapping({**settings, **given, "load.terms": terms})


@dataclass(frozen=True)
class Learned:
    """What one way of learning made of a record."""

    loads: list[LearnedLoad]
    friction_error: float


def learned(rec: Record, terms: list[str], given: dict[str, Any]) -> dict[str, Learned]:
    """Return what the batch fit and rls make of a record: the loads, and the error of friction without learning."""
    config = config_of(terms, given)
    samples = rec.admitted(config)
    met = chosen(config, samples)
    still = standstill(samples, met.velocity_scale)
    fit, online = fit_batch(samples, met, use=~still), replay(samples, config)

    def error(at: Config, parameters: Parameters) -> float:
        terms, weights = LoadTerms(at), parameters.load_weights.copy()
        if terms.follows:
            weights[-1] = 0.0  # what follows the load is friction
        alone = predict(samples, at, parameters) - terms.force_N(samples, weights)
        wrong = alone - (rec.effort - rec.load)
        return float(np.sqrt(np.mean(np.square(wrong[~still]))))

    return {
        "fit": Learned(fit.loads, error(met, fit.parameters)),
        "rls": Learned(list(online.loads), error(online.estimator.config, online.parameters)),
    }


def cases(part: str, seeds: range) -> Iterator[tuple[str, str, float, int]]:
    """Yield plant, drive, rate and seed of a part: the joints of `simulate`, or other forms and drives (few seeds)."""
    joints = [(plant, drive) for plant in tuple(FRICTIONS)[:2] for drive in MAIN]
    others = [(plant, drive) for plant in tuple(FRICTIONS)[:4] for drive in DRIVES if (plant, drive) not in joints]
    wanted = {
        "joints": joints,
        "plain gear": [(PLAIN_GEAR, drive) for drive in MAIN[:2]],
        "moves": [(plant, "moves") for plant in tuple(FRICTIONS)[:2]],
    }.get(part, [*others, ("pendulum", "free swing")])
    few = seeds if part in ("joints", "moves") else seeds[: max(1, len(seeds) // 5)]
    for seed in few:
        for plant, drive in wanted:
            yield plant, drive, (200.0, 500.0, 1000.0)[seed % 3], seed


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--part", choices=("joints", "others", "plain gear", "moves"), default="joints")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="a setting; may be repeated")
    args = parser.parse_args()
    given = {name: yaml.safe_load(value) for name, _, value in (text.partition("=") for text in args.set)}
    seeds = range(args.first_seed, args.first_seed + args.seeds)
    rows: dict[tuple[str, str, str], list[tuple[int, int, int, float]]] = defaultdict(list)
    for plant, drive, rate, seed in cases(args.part, seeds):
        rec = released(plant, rate, seed) if drive == "free swing" else record(plant, drive, rate, seed)
        unknown = learned(rec, rec.unknown, given)
        known = learned(rec, rec.known, given) if rec.known else unknown
        for way, run in unknown.items():
            told = [load for load in run.loads if load.ci95 is not None]
            inside = [load.ci95[0] <= rec.truth[load.term] <= load.ci95[1] for load in told if load.ci95 is not None]
            ratio = run.friction_error / known[way].friction_error
            rows[plant, drive, way].append((len(run.loads), len(told), sum(inside), ratio))
        print(plant, drive, rate, seed, rows[plant, drive, "fit"][-1], rows[plant, drive, "rls"][-1], file=sys.stderr)
    head = [
        "friction",
        "drive",
        "learned by",
        "seeds",
        "terms",
        "separated",
        "of these inside",
        "seeds with all inside",
    ]
    print("| " + " | ".join([*head, "friction error, median", "largest"]) + " |")
    print("|" + " --- |" * 10)
    for (plant, drive, way), found in rows.items():
        terms, told, inside = (sum(row[i] for row in found) for i in range(3))
        whole = sum(row[1] == row[2] for row in found)
        ratios = [row[3] for row in found]
        words = [plant, drive, way, len(found), terms, told, inside, f"{whole} of {len(found)}"]
        ratio = ["-", "-"] if drive == "free swing" else [f"{np.median(ratios):.3f}", f"{max(ratios):.3f}"]
        print("| " + " | ".join(str(word) for word in [*words, *ratio]) + " |")


if __name__ == "__main__":
    main()
