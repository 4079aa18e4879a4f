"""Speed of the compiled sample loop beside the same algorithm in numpy, in one run, as a ratio.

    .venv/bin/python benchmarks/kernels/run.py

Also reads the memory of a replay of a million samples. Writes benchmarks/kernels/table.md.
"""

import resource
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from friction_estimator.core.online import kernels
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.online.first_contact import chosen
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config

sys.path.append(str(Path(__file__).resolve().parents[1]))
import provenance

HERE = Path(__file__).parent
SAMPLES = 20_000
NUMPY_SAMPLES = 3_000


def record(n: int) -> Samples:
    """A sine drive at 1 kHz with a Stribeck-like friction and 1 % noise."""
    rng = np.random.default_rng(1)
    v = 0.025 * np.cos(2 * np.pi * 0.2 * np.arange(n) / 1000.0)
    f = np.tanh(v / 0.002) * (1.0 + 4.0 * np.exp(-np.abs(v) / 0.005))
    restart = np.zeros(n, np.bool_)
    restart[0] = True
    return Samples(1 + np.arange(n, dtype=np.int64) * 1_000_000, v, f + 0.02 * rng.standard_normal(n), restart)


def estimator(samples: Samples, model: str, law: str) -> Estimator:
    config = Config.from_mapping({"model.type": model, "model.law": law})
    return Estimator(chosen(config, samples))


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


def seconds_per_sample(body, n: int, repeats: int = 5) -> float:
    times = []
    for _ in range(repeats):
        start = time.process_time()
        body()
        times.append(time.process_time() - start)
    return min(times) / n


def memory_of_a_million() -> float:
    """Peak resident memory (MB) of a process that runs rls over a million samples, imports included."""
    if "--million" in sys.argv:
        samples = record(1_000_000)
        estimator(samples, "parallel", "rls").run(samples)
        print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
        return 0.0
    out = subprocess.run([sys.executable, __file__, "--million"], capture_output=True, text=True, check=True)
    return float(out.stdout)


def main() -> None:
    samples = record(SAMPLES)
    short = samples[:NUMPY_SAMPLES]
    compiled = estimator(samples, "hammerstein", "lms")
    wanted = estimator(samples, "hammerstein", "lms").run(short)
    plain, kept = (
        seconds_per_sample(lambda keep=keep: plain_numpy_lms(compiled, short, keep), NUMPY_SAMPLES, 3)
        for keep in (False, True)
    )
    for keep in (False, True):
        np.testing.assert_allclose(plain_numpy_lms(compiled, short, keep), wanted, atol=1e-9)

    def row(name: str, seconds: float) -> str:
        return f"| {name} | {seconds * 1e6:.2f} | {plain / seconds:.1f} | {kept / seconds:.1f} |"

    size = compiled.model.basis.size
    lines = [
        "# What a sample costs\n",
        provenance.line("python benchmarks/kernels/run.py"),
        "| loop | us a sample | plain numpy over it | numpy with kept rows over it |",
        "| --- | --- | --- | --- |",
        row(f"plain numpy, Hammerstein lms, all {size} weights at every lag", plain),
        row(f"numpy with kept rows, Hammerstein lms, all {size} weights", kept),
    ]
    inputs = compiled.model.inputs(samples)
    predicted, deviation = np.empty(SAMPLES), np.empty(SAMPLES)
    loop = seconds_per_sample(
        lambda: kernels.run(
            kernels.LMS,
            inputs.index,
            inputs.value,
            inputs.cell,
            inputs.beyond,
            samples.velocity_m_s,
            inputs.theory,
            inputs.extension,
            inputs.noise,
            inputs.known,
            inputs.target,
            inputs.restart,
            inputs.inside,
            predicted,
            deviation,
            *compiled.work.arrays(),
        ),
        SAMPLES,
    )
    lines.append(row("compiled, Hammerstein lms, the sample loop alone", loop))
    for model, law in [(m, law) for law in ("lms", "nlms", "rls") for m in ("hammerstein", "parallel")]:
        est = estimator(samples, model, law)
        est.run(samples[:100])
        own = seconds_per_sample(lambda est=est: est.run(samples), SAMPLES)
        lines.append(row(f"compiled, {model} {law}, basis and theory included", own))
    single = estimator(samples, "parallel", "rls")
    single.run(samples[:100])
    own = seconds_per_sample(lambda: [single.run(samples[k : k + 1]) for k in range(1000)], 1000)
    lines.append(row("compiled, parallel rls, one call a sample", own))
    lines.append("")
    lines.append(f"Peak memory of a million samples, parallel rls, imports included: {memory_of_a_million():.0f} MB")
    text = "\n".join(lines) + "\n"
    (HERE / "table.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    if "--million" in sys.argv:
        memory_of_a_million()
    else:
        main()
