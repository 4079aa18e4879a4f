"""What a sample costs: the compiled loops beside the same laws in C (laws.c), what comes before them, one live sample.

A part of `python benchmarks/bench.py`.
"""

from typing import Any

import numpy as np
from bodies import COMPILER, LAWS, MODELS, c_of, estimator, live_of, loop_of, record
from in_c import FLAGS, compiled, compiler
from measure import cpu_us, in_turn, part

from friction_estimator.core.sample import Samples

LIVE_SAMPLES, SINGLE_SAMPLES = 4_000, 300
EQUAL = 1e-11
"""Force units by which no prediction in C may differ."""

PAIRS = [(law, model) for law in LAWS for model in MODELS]


def against_c(samples: Samples, rounds: int) -> dict[str, Any]:
    library = compiled() if COMPILER else None
    bodies, sizes = {}, {}
    for law, model in PAIRS:
        est, name = estimator(samples, model, law), f"{law} {model}"
        ours = loop_of(est, samples)
        bodies[f"loop {name}"], sizes[name] = cpu_us(ours, len(samples)), est.model.size
        if library:
            theirs = c_of(library, est, samples)
            np.testing.assert_allclose(ours()[1], theirs()[1], rtol=0.0, atol=EQUAL)
            bodies[f"C {name}"] = cpu_us(theirs, len(samples))
    found = in_turn(bodies, rounds)
    return {
        name: {"law": name.split()[0], "parameters": size, "loop_us": found[f"loop {name}"]}
        | ({"C_us": found[f"C {name}"]} if library else {})
        for name, size in sizes.items()
    }


def before_the_loop(samples: Samples, rounds: int) -> dict[str, list[float]]:
    est = estimator(samples, "parallel", "lms")
    seal = estimator(samples, "parallel", "lms", **{"theory.kind": "seal"})
    bodies = {
        "loop, parallel lms": loop_of(est, samples),
        "basis": lambda: est.model.basis.located(samples.velocity_m_s),
        "Stribeck curve": lambda: est.model.theoretical_friction(samples),
        "seal": lambda: seal.model.theoretical_friction(samples),
    }
    return in_turn({name: cpu_us(body, len(samples)) for name, body in bodies.items()}, rounds)


def live(samples: Samples, rounds: int) -> dict[str, dict[str, list[float]]]:
    short = samples[:LIVE_SAMPLES]
    bodies = {}
    for law, model in PAIRS:
        one, many, single = (estimator(samples, model, law) for _ in range(3))
        singles = [short[k : k + 1] for k in range(SINGLE_SAMPLES)]
        bodies |= {
            (law, model, "live_us"): cpu_us(live_of(one, short), len(short)),
            (law, model, "batch_us"): cpu_us(lambda est=many: est.run(samples), len(samples)),
            (law, model, "run_us"): cpu_us(
                lambda est=single, singles=singles: [est.run(sample) for sample in singles], SINGLE_SAMPLES
            ),
        }
    found = in_turn(bodies, rounds)
    ways = ("live_us", "batch_us", "run_us")
    return {f"{law} {model}": {way: found[law, model, way] for way in ways} for law, model in PAIRS}


def measured(samples: int, rounds: int) -> dict[str, Any]:
    driven = record(samples)
    return {
        "samples": samples,
        "compiler": f"cc {' '.join(FLAGS)} ({compiler()})" if COMPILER else "",
        "equal_within": EQUAL,
        "loops": against_c(driven, rounds),
        "before": before_the_loop(driven, rounds),
        "live": live(driven, rounds),
    }


if __name__ == "__main__":
    part(measured, __doc__, samples=20_000, rounds=21)
