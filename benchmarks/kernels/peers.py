"""A sample in Python: plain numpy, and adaptive filters of padasip and pyroomacoustics where they are installed.

A part of `python benchmarks/bench.py`. The filters are linear in as many regressors as the parallel model has
parameters: padasip is given them ready, pyroomacoustics takes them from its delay line. Neither has a basis to evaluate
nor a product of parameters.
"""

import importlib
import importlib.metadata
import importlib.util
from collections.abc import Iterator
from typing import Any

import numpy as np
from bodies import LAWS, Body, estimator, record
from measure import cpu_us, in_turn, part

from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.sample import Samples

OURS = 20_000
"""Samples of our own batch: fewer would measure the call."""


def plain_numpy_lms(est: Estimator, samples: Samples, keep_rows: bool) -> np.ndarray:
    """The paper's Hammerstein lms, sample by sample, over all weights, in plain numpy.

    As the equations are written, F[k-i] = W' Psi(v[k-i]) is evaluated for every lag at every sample; `keep_rows` keeps
    the rows of Psi instead, which is what one would do next.
    """
    basis, config = est.model.basis, est.config
    mu, unit, taps = config.lms.step_size, config.unit_N, config.fir.order + 1
    table = basis._table
    steps = table.shape[1] - 1
    curves = [np.append(table[kind, :-1].T.ravel(), 0.0) for kind in (0, 1)]
    support = table.shape[2]
    grid = np.arange(curves[0].size) / steps
    scale = 2.0 ** -basis.level_of.astype(float)
    amplitude = np.sqrt(scale)
    a, w = np.eye(taps)[0], np.zeros(basis.size)
    predicted = np.empty(len(samples))

    def rows(velocity: np.ndarray) -> np.ndarray:
        u = basis.bend * np.arcsinh(velocity / basis.bend) / basis.unit
        argument = u[:, None] * scale - basis.translation
        phi, psi = np.interp(argument, grid, curves[0], 0, 0), np.interp(argument, grid, curves[1], 0, 0)
        return amplitude * np.where(basis.is_scaling, phi, psi) * ((argument >= 0) & (argument < support))

    for k in range(len(samples)):
        if k == 0 or not keep_rows:
            history = rows(samples.velocity_m_s[np.maximum(k - np.arange(taps), 0)])
        else:
            history = np.roll(history, 1, axis=0)
            history[0] = rows(samples.velocity_m_s[k : k + 1])[0]
        g = history @ w
        predicted[k] = a @ g
        e = samples.friction_N[k] / unit - predicted[k]
        filtered = a @ history
        a = a + mu * e * g
        a /= np.linalg.norm(a)
        w = w + mu * e * filtered
    return predicted * unit


def of_padasip(regressors: int, samples: int) -> Iterator[tuple[str, str, Body]]:
    """Yield law, name and body of each filter."""
    filters = importlib.import_module("padasip").filters
    rng = np.random.default_rng(2)
    x, d = rng.standard_normal((samples, regressors)), rng.standard_normal(samples)
    for law, mu in (("lms", 0.001), ("nlms", 0.1), ("rls", 0.999)):
        make = getattr(filters, f"Filter{law.upper()}")
        yield law, make.__name__, lambda make=make, mu=mu: make(n=regressors, mu=mu).run(d, x)


def of_pyroomacoustics(regressors: int, samples: int) -> Iterator[tuple[str, str, Body]]:
    """Yield law, name and body of each filter."""
    adaptive = importlib.import_module("pyroomacoustics.adaptive")
    rng = np.random.default_rng(2)
    x, d = rng.standard_normal((2, samples))
    made = {
        "lms": lambda: adaptive.BlockLMS(regressors, mu=0.001),
        "nlms": lambda: adaptive.NLMS(regressors, mu=0.1),
        "rls": lambda: adaptive.RLS(regressors, lmbd=0.999, dtype=np.float64),
    }

    def run(make: Any) -> None:
        update = make().update
        for now, wanted in zip(x, d, strict=True):
            update(now, wanted)

    for law, make in made.items():
        yield law, type(make()).__name__, lambda make=make: run(make)


PEERS = {"padasip": of_padasip, "pyroomacoustics": of_pyroomacoustics}


def measured(samples: int, rounds: int) -> dict[str, Any]:
    driven = record(OURS)
    short = driven[:samples]
    hammerstein = estimator(driven, "hammerstein", "lms")
    wanted = estimator(driven, "hammerstein", "lms").run(short)
    for keep in (False, True):
        np.testing.assert_allclose(plain_numpy_lms(hammerstein, short, keep), wanted, atol=1e-9)
    size = hammerstein.model.basis.size
    rows: dict[str, tuple[str, str]] = {}  # name: law, and what it is compared with
    bodies: dict[str, Any] = {}

    def add(name: str, law: str, over: str, body: Body, count: int) -> None:
        rows[name], bodies[name] = (law, over), cpu_us(body, count)

    first = "compiled, Hammerstein lms, basis included"
    add(first, "lms", first, lambda: hammerstein.run(driven), OURS)
    for keep, what in (
        (False, "plain numpy, all {} weights at every lag"),
        (True, "numpy with kept rows, all {} weights"),
    ):
        add(what.format(size), "lms", first, lambda keep=keep: plain_numpy_lms(hammerstein, short, keep), samples)
    ours = {law: f"compiled, parallel {law}, basis and theory included" for law in LAWS}
    regressors = 0
    for law, name in ours.items():
        own = estimator(driven, "parallel", law)
        regressors = own.model.size
        add(name, law, name, lambda own=own: own.run(driven), OURS)
    installed = {name: importlib.util.find_spec(name) is not None for name in PEERS}
    for peer, bodies_of in PEERS.items():
        if installed[peer]:
            for law, name, body in bodies_of(regressors, samples):
                add(f"{peer} {name}, {regressors} regressors", law, ours[law], body, samples)
    found = in_turn(bodies, rounds)
    return {
        "samples": samples,
        "missing": [name for name, there in installed.items() if not there],
        "versions": {name: importlib.metadata.version(name) for name, there in installed.items() if there},
        "rows": {name: {"law": law, "over": over, "us": found[name]} for name, (law, over) in rows.items()},
    }


if __name__ == "__main__":
    part(measured, __doc__, samples=1500, rounds=5)
