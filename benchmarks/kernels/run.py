"""What a sample costs: the compiled loops beside the same laws in C, plain numpy and padasip, in one run, as ratios.

    .venv/bin/python benchmarks/kernels/run.py

Bodies that are compared run in turn, round by round; a ratio is the median of those within a round, so that a machine
that others use too slows both. Writes benchmarks/kernels/table.md and cost.png.
"""

import argparse
import importlib.util
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from in_c import FLAGS, InC, compiled, compiler

from friction_estimator.core.intake.admission import Intake
from friction_estimator.core.online import kernels
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.online.first_contact import chosen
from friction_estimator.core.online.live import LiveStep
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config

sys.path.append(str(Path(__file__).resolve().parents[1]))
import provenance

HERE = Path(__file__).parent
SAMPLES, LIVE_SAMPLES, NUMPY_SAMPLES, PEER_SAMPLES = 20_000, 4_000, 1_500, 1_500
ROUNDS = 21
LAWS, MODELS = ("lms", "nlms", "rls"), ("hammerstein", "parallel")
BOUNDS = {"lms": 1.8, "nlms": 2.0, "rls": 2.0}
EQUAL = 1e-11
"""Force units by which no prediction in C may differ."""

WIDE = {"basis.finest_level": (1, 0, -1, -2, -3, -4)}
LONG = {"fir.order": (2, 5, 8, 17, 32, 64)}

Body = Callable[[], object]


def record(n: int) -> Samples:
    """A sine drive at 1 kHz with a Stribeck-like friction and 1 % noise."""
    rng = np.random.default_rng(1)
    v = 0.025 * np.cos(2 * np.pi * 0.2 * np.arange(n) / 1000.0)
    f = np.tanh(v / 0.002) * (1.0 + 4.0 * np.exp(-np.abs(v) / 0.005))
    restart = np.zeros(n, np.bool_)
    restart[0] = True
    return Samples(1 + np.arange(n, dtype=np.int64) * 1_000_000, v, f + 0.02 * rng.standard_normal(n), restart)


def estimator(samples: Samples, model: str, law: str, **settings: object) -> Estimator:
    config = Config.from_mapping({"model.type": model, "model.law": law} | settings)
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


def in_turn(bodies: Mapping[str, tuple[Body, int]], rounds: int = ROUNDS) -> dict[str, np.ndarray]:
    """Return microseconds a sample of each body, (rounds,): the processor time of a call over its samples."""
    for body, _ in bodies.values():
        body()
    found: dict[str, list[float]] = {name: [] for name in bodies}
    for _ in range(rounds):
        for name, (body, count) in bodies.items():
            start = time.process_time()
            body()
            found[name].append((time.process_time() - start) / count * 1e6)
    return {name: np.array(values) for name, values in found.items()}


def loop_of(est: Estimator, samples: Samples) -> Callable[[], tuple[np.ndarray, np.ndarray]]:
    """Return the compiled loop alone, from the start, on rows and theory made before."""
    inputs, n = est.model.inputs(samples), len(samples)
    predicted, deviation = np.empty(n), np.empty(n)
    batch = kernels.batch(inputs, samples.velocity_m_s, inputs.inside, predicted, deviation)

    def body() -> tuple[np.ndarray, np.ndarray]:
        work = est.work.copy()
        kernels.run(est.law.number, batch.table, work.addresses.table)
        return work.theta, predicted

    return body


def c_of(library: object, est: Estimator, samples: Samples) -> InC:
    return InC(library, est, est.model.inputs(samples), samples.velocity_m_s)


def live_of(est: Estimator, samples: Samples) -> Body:
    """Return a body that hands over sample by sample as the node does, at stamps that go on from call to call."""
    step = LiveStep(Intake(est.config), est.config, estimator=est)
    velocity, friction = samples.velocity_m_s.tolist(), samples.friction_N.tolist()
    now = 10**15

    def body() -> None:
        nonlocal now
        for v, f in zip(velocity, friction, strict=True):
            now += 1_000_000
            step.stream[0], step.stream[1] = 0, 1
            step.stamp_ns[0] = step.stamp_ns[1] = now
            step.value[0], step.value[1] = v, f
            assert len(step.run(2, learn=True)) == 1

    return body


def against_c(samples: Samples, library: object) -> list[str]:
    lines = [
        "| law, model | parameters | loop, us | C, us | loop over C | bound |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    bodies, sizes = {}, {}
    for law in LAWS:
        for model in MODELS:
            est = estimator(samples, model, law)
            ours, theirs = loop_of(est, samples), c_of(library, est, samples)
            np.testing.assert_allclose(ours()[1], theirs()[1], rtol=0.0, atol=EQUAL)
            bodies |= {f"{law} {model}": (ours, SAMPLES), f"C {law} {model}": (theirs, SAMPLES)}
            sizes[f"{law} {model}"] = est.model.size
    found = in_turn(bodies)
    for name, size in sizes.items():
        ours, theirs = found[name], found[f"C {name}"]
        bound = BOUNDS[name.split()[0]]
        lines.append(
            f"| {name} | {size} | {np.median(ours):.3f} | {np.median(theirs):.3f} "
            f"| {np.median(ours / theirs):.2f} | {bound:g} |"
        )
    return lines


def beside_the_loop(samples: Samples) -> list[str]:
    est = estimator(samples, "parallel", "lms")
    bodies = {
        "loop, parallel lms": (loop_of(est, samples), SAMPLES),
        "basis": (lambda: est.model.basis.located(samples.velocity_m_s), SAMPLES),
        "theory (Stribeck)": (lambda: est.model.theoretical_friction(samples), SAMPLES),
    }
    seal = estimator(samples, "parallel", "lms", **{"theory.kind": "seal"})
    bodies["theory (seal)"] = (lambda: seal.model.theoretical_friction(samples), SAMPLES)
    found = in_turn(bodies)
    loop = found["loop, parallel lms"]
    lines = ["| before the loop | us | over the loop |", "| --- | --- | --- |"]
    both = {
        "basis and Stribeck curve": found["basis"] + found["theory (Stribeck)"],
        "basis and seal": found["basis"] + found["theory (seal)"],
    }
    lines += [
        f"| {name} | {np.median(own):.3f} | {np.median(own / loop):.2f} |" for name, own in (found | both).items()
    ]
    return lines


def live(samples: Samples) -> list[str]:
    short = samples[:LIVE_SAMPLES]
    lines = [
        "| law, model | live, us | batch, us | live less batch, us | `Estimator.run` a sample, us |",
        "| --- | --- | --- | --- | --- |",
    ]
    bodies = {}
    for law in LAWS:
        for model in MODELS:
            one, many, single = (estimator(samples, model, law) for _ in range(3))
            bodies[f"live {law} {model}"] = live_of(one, short), LIVE_SAMPLES
            bodies[f"batch {law} {model}"] = (lambda est=many: est.run(samples)), SAMPLES
            bodies[f"single {law} {model}"] = (lambda est=single: [est.run(short[k : k + 1]) for k in range(300)]), 300
    found = in_turn(bodies)
    for law in LAWS:
        for model in MODELS:
            one, many, single = (found[f"{way} {law} {model}"] for way in ("live", "batch", "single"))
            lines.append(
                f"| {law} {model} | {np.median(one):.2f} | {np.median(many):.2f} | {np.median(one - many):.2f} "
                f"| {np.median(single):.1f} |"
            )
    return lines


def against_python(samples: Samples) -> list[str]:
    short = samples[:NUMPY_SAMPLES]
    est = estimator(samples, "hammerstein", "lms")
    size = est.model.basis.size
    bodies: dict[str, tuple[Body, int]] = {
        "compiled, Hammerstein lms, basis included": (lambda: estimator_run(est, samples), SAMPLES),
        f"plain numpy, all {size} weights at every lag": (
            lambda: plain_numpy_lms(est, short, False),
            NUMPY_SAMPLES,
        ),
        f"numpy with kept rows, all {size} weights": (lambda: plain_numpy_lms(est, short, True), NUMPY_SAMPLES),
    }
    wanted = estimator(samples, "hammerstein", "lms").run(short)
    for keep in (False, True):
        np.testing.assert_allclose(plain_numpy_lms(est, short, keep), wanted, atol=1e-9)
    if importlib.util.find_spec("padasip"):
        padasip = importlib.import_module("padasip")

        rng = np.random.default_rng(2)
        for law, given in (("LMS", {"mu": 0.001}), ("NLMS", {"mu": 0.1}), ("RLS", {"mu": 0.999})):
            n = 112
            x, d = rng.standard_normal((PEER_SAMPLES, n)), rng.standard_normal(PEER_SAMPLES)
            make = getattr(padasip.filters, f"Filter{law}")
            bodies[f"padasip Filter{law}, {n} regressors given"] = (
                lambda make=make, n=n, given=given, x=x, d=d: make(n=n, **given).run(d, x),
                PEER_SAMPLES,
            )
        for law in LAWS:
            own = estimator(samples, "parallel", law)
            bodies[f"compiled, parallel {law}, basis and theory included"] = (
                lambda own=own: estimator_run(own, samples),
                SAMPLES,
            )
    found = in_turn(bodies, 5)
    first = next(iter(found.values()))
    lines = ["| what | us a sample | over compiled lms |", "| --- | --- | --- |"]
    return lines + [f"| {name} | {np.median(own):.2f} | {np.median(own / first):.1f} |" for name, own in found.items()]


def estimator_run(est: Estimator, samples: Samples) -> None:
    est.run(samples)


def exponent(size: np.ndarray, cost: np.ndarray) -> float:
    """Return the slope of log cost over log size in the upper half."""
    half = size.size // 2
    return float(np.polyfit(np.log(size[half:]), np.log(cost[half:]), 1)[0])


def growth(samples: Samples, library: object) -> tuple[list[str], dict[str, dict[str, np.ndarray]]]:
    """Return lines, and by axis the sizes and the costs of each law, ours and C's."""
    lines = [
        "| law | over | sizes | loop, us | exponent | C, us | exponent |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    curves: dict[str, dict[str, np.ndarray]] = {}
    for axis, (setting, values) in (("weights", *WIDE.items()), ("taps", *LONG.items())):
        curves[axis] = {}
        for law in LAWS:
            count = SAMPLES // 5 if law == "rls" else SAMPLES
            part, bodies, sizes = samples[:count], {}, []
            for value in values:
                est = estimator(samples, "hammerstein", law, **{setting: value})
                sizes.append(int(est.model.shape[1 if axis == "weights" else 0]))
                bodies[f"ours {value}"] = loop_of(est, part), count
                bodies[f"C {value}"] = c_of(library, est, part), count
            found = in_turn(bodies, 7)
            ours, theirs = (np.array([np.median(found[f"{who} {v}"]) for v in values]) for who in ("ours", "C"))
            size = np.array(sizes, np.float64)
            curves[axis] |= {"size": size, law: ours, f"C {law}": theirs}
            shown = [", ".join(f"{v:.3g}" for v in row) for row in (size, ours, theirs)]
            lines.append(
                f"| {law} | {axis} | {shown[0]} | {shown[1]} | {exponent(size, ours):.2f} | {shown[2]} "
                f"| {exponent(size, theirs):.2f} |"
            )
    return lines, curves


def draw(curves: Mapping[str, Mapping[str, np.ndarray]]) -> None:
    plt = importlib.import_module("matplotlib.pyplot")  # not in the process whose memory is read
    figure, panels = plt.subplots(1, 2, figsize=(9.0, 3.6), sharey=True, layout="constrained")
    for panel, (axis, rows) in zip(panels, curves.items(), strict=True):
        for law, colour in zip(LAWS, ("#0072b2", "#d55e00", "#009e73"), strict=True):
            panel.loglog(rows["size"], rows[law], "o-", color=colour, label=law, markersize=4)
            panel.loglog(
                rows["size"], rows[f"C {law}"], "s--", color=colour, label=f"{law}, C", markersize=3, alpha=0.6
            )
        panel.set_xlabel(axis if axis == "weights" else "FIR taps")
        panel.set_xticks(rows["size"], [f"{size:.0f}" for size in rows["size"]])
        panel.minorticks_off()
        panel.grid(alpha=0.3)
    panels[0].set_ylabel("us a sample")
    panels[0].legend(fontsize=8)
    figure.savefig(HERE / "cost.png", dpi=110)


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
    source = provenance.line("python benchmarks/kernels/run.py")  # before files are written
    memory = memory_of_a_million()  # while this process is small: a child's peak begins at its parent's
    samples, library = record(SAMPLES), compiled()
    growing, curves = growth(samples, library)
    draw(curves)
    parts = [
        "# What a sample costs\n",
        source,
        f"{SAMPLES} samples of a sine drive, the default basis and 9 taps, one core. Processor time, medians of rounds "
        "in which all rows of a table take turns; ratios are medians of the ratios within a round.\n",
        "## The sample loop beside C\n",
        f"`cc {' '.join(FLAGS)}` ({compiler()}) of [laws.c](laws.c): the same law on the same rows, every prediction "
        f"equal within {EQUAL:g} force units. C is the law alone: delay lines, regressor, prediction, step; nlms and "
        "rls with the shortening of outliers, rls with the weight of a sample and the recall of the prior. The loop "
        "does beside that what an estimator needs: standstill, the band's running errors by velocity, the deviation of "
        "each prediction, the guard of the step, the range, counters; nlms and rls the alarm and the kept model.\n",
        *against_c(samples, library),
        "\n## Basis and theory\n",
        *beside_the_loop(samples),
        "\n## One live sample\n",
        "`LiveStep.run`: two events in, paired, admitted, predicted, learned, and the event arrays filled by Python; "
        "batch is `Estimator.run` over all samples, basis and theory included.\n",
        *live(samples),
        "\n## Python\n",
        *against_python(samples),
        "\n## Growth\n",
        "Exponents are the slope of the upper half.\n",
        *growing,
        "\n![Cost of a sample over weights and taps](cost.png)\n",
        f"Peak memory of a million samples, parallel rls, imports included: {memory:.0f} MB",
    ]
    text = "\n".join(parts) + "\n"
    (HERE / "table.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--million", action="store_true", help="print the peak memory (MB) of a million samples alone")
    if parser.parse_args().million:
        memory_of_a_million()
    else:
        main()
