"""How the defaults of `prior.*` were chosen: one strength varied at a time, judged frozen on other drives.

    python benchmarks/transfer/prior_study.py           writes prior_study.md beside this file (some six minutes)

Only the drives and seeds that tuning may see are in here (seed 0 to learn from, 9 to be judged by, EMPS' first half);
run.py judges the choice on others. Fits are those of `identify`, which rls comes to.
"""

import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from judge import fit_baselines, nrmse, scored, static_error
from records import EMPS, Drive, emps
from tqdm import tqdm

from friction_estimator.core.fit.batch import fit_batch, predict
from friction_estimator.core.online.first_contact import chosen
from friction_estimator.core.settings.config import PARAMETERS, Config
from friction_estimator.output.target import write_text

HERE = Path(__file__).resolve().parent
TRAIN_S, TEST_S = 20.0, 10.0
TRAIN_SEED, TEST_SEED = 0, 9
LEARNED = Drive("sine", 1.0)
JUDGES = (
    Drive("triangle", 1.0),
    Drive("speed_steps", 4.0),
    Drive("sine", 2.9),
    Drive("multisine", 2.0),
    Drive("crank", 1.5),
    Drive("dwell", 3.0),
)
GROUPS = [("parallel", 1000.0), ("parallel", 200.0), ("hammerstein", 1000.0)]

VARIED = {
    "prior.weight_slope": (0.5, 1.5, 2.0),
    "prior.tap_deviation": (0.05, 0.15, 0.5),
    "prior.gain_deviation": (0.003, 0.03, 0.3),
    "prior.theory_gain_deviation": (0.03, 0.3, 1.0),
    "prior.tap_decay": (0.5, 0.9, 0.97),
    "prior.rest_deviation": (0.003, 0.03, 1.0),
    "prior.residual_deviation": (0.03, 0.1, 0.3),
    "basis.companding": (0.0, 4.0, 16.0, 64.0),
    "rls.forgetting_factor": (0.99, 0.999, 1.0),
}


def transfers(values: dict[str, float]) -> dict[tuple[str, float], list[float]]:
    """Return frozen nrmse over `static` for each model and rate, over both plants and all judges."""
    ratios: dict[tuple[str, float], list[float]] = {group: [] for group in GROUPS}
    for plant in ("rig", "clean"):
        for rate in (1000.0, 200.0):
            train = LEARNED.record(TRAIN_S, plant, rate, TRAIN_SEED)
            curves = fit_baselines(train.velocity_m_s, train.friction_N)
            tests = [drive.record(TEST_S, plant, rate, TEST_SEED) for drive in JUDGES]
            for model, at in GROUPS:
                if at != rate:
                    continue
                config = chosen(Config.from_mapping({"model.type": model, **values}), train)
                fit = fit_batch(train, config)
                for test in tests:
                    use = scored(test, config)
                    error = nrmse(test.friction_N[use], predict(test, config, fit.parameters)[use])
                    ratios[model, rate].append(error / static_error(curves, test, use)[1])
    return ratios


def emps_first_half(values: dict[str, float]) -> float | None:
    """Return the nrmse on the second quarter of EMPS, learned on the first: the half that tuning may see."""
    if not EMPS.exists():
        return None
    samples = emps()
    quarter = len(samples) // 4
    use = np.arange(len(samples)) < quarter
    config = Config.from_mapping({"model.type": "hammerstein", **values})
    config = chosen(config, samples[:quarter])
    predicted = fit_batch(samples, config, use=use).predicted_N
    return nrmse(samples.friction_N[quarter : 2 * quarter], predicted[quarter : 2 * quarter])


def row(case: tuple[str, float]) -> str:
    name, value = case
    ratios = transfers({name: value})
    figures = [f"{np.median(v):.2f} / {max(v):.2f}" for v in ratios.values()]
    measured = emps_first_half({name: value})
    mark = " (default)" if value == PARAMETERS[name].default else ""
    shown = "" if measured is None else f"{measured:.4f}"
    return f"| `{name}` | {value:g}{mark} | {' | '.join(figures)} | {shown} |"


def main() -> int:
    cases = [(name, value) for name, values in VARIED.items() for value in values]
    with ProcessPoolExecutor(2) as pool:
        rows = list(tqdm(pool.map(row, cases), total=len(cases), disable=not sys.stderr.isatty()))
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=True, cwd=HERE
    )
    page = f"""# The study behind the prior

Commit {commit.stdout.strip()}, `python benchmarks/transfer/prior_study.py`.

Learned on a sine of 1 s at 50 psi ({TRAIN_S:g} s, seed {TRAIN_SEED}), frozen on triangle, speed steps, a sine of
2.9 s, multisine, crank and dwell (seed {TEST_SEED}), both plants: median / largest error over that of the best static
curve fitted to the same samples. EMPS: learned on the first quarter, judged on the second. One strength is varied, the
others are the defaults. These are the drives that chose the defaults; [README.md](README.md) has those that judge them.

| strength | value | Parallel, 1000 Hz | Parallel, 200 Hz | Hammerstein, 1000 Hz | EMPS |
| --- | --- | --- | --- | --- | --- |
{chr(10).join(rows)}
"""
    write_text(HERE / "prior_study.md", page)
    return 0


if __name__ == "__main__":
    sys.exit(main())
