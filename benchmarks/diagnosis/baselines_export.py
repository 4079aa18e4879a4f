"""Write the library and the residual of records for `baselines.py`: `python baselines_export.py DIR [--first-seed S]`.

The base's tangent is projected out of residual and columns, so that all methods see the same; effects
without a regressor (lattice, dropout, ...) are left out, since regression cannot name them.
"""

import argparse
from pathlib import Path

import numpy as np
from draws import hidden
from drives import USUAL
from records import Made, make

from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.base import fit_base
from friction_estimator.diagnosis.diagnose import diagnose
from friction_estimator.diagnosis.joint import fit_joint
from friction_estimator.diagnosis.library import build_library
from friction_estimator.diagnosis.record import build_record
from friction_estimator.effects import EFFECTS
from friction_estimator.effects.base import Effect

REGRESSED = [n for n, c in EFFECTS.items() if c.columns.__func__ is not Effect.columns.__func__]  # type: ignore[attr-defined]
THIN = 2


def export(made: Made, truth: str, condition: str, target: Path) -> None:
    config = Config()
    data = build_record([made.samples], config)
    base = fit_base(data, config)
    context = data.context(config, float(np.abs(base.static_N).max()))
    joint = fit_joint(data, config, context, start=base)
    evidence = joint.evidence(data, 0)
    library = build_library(joint.features, joint.reference, context, evidence)
    columns = np.concatenate([h.columns for h in library], axis=1).astype(np.float64)
    names = np.concatenate([[h.name] * h.columns.shape[1] for h in library])
    q, _ = np.linalg.qr(joint.tangent)
    columns -= q @ (q.T @ columns)
    residual = joint.residual_N - q @ (q.T @ joint.residual_N)
    norm = np.sqrt(np.mean(np.square(columns), axis=0))
    keep = norm > 1e-6 * norm.max()
    result = diagnose([made.samples], config)
    ours = result.effects[0].name if result.effects else ""
    np.savez(
        target,
        columns=(columns[:, keep] / norm[keep])[::THIN].astype(np.float32),
        names=names[keep],
        residual=residual[::THIN],
        whole=residual,
        truth=truth,
        condition=condition,
        ours=ours,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--first-seed", type=int, default=2000)
    parser.add_argument("--empty", type=int, default=10)
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    for size, noise in ((0.04, 0.01), (0.005, 0.03)):
        for name in REGRESSED:
            made = make(USUAL, "clean", [hidden(name, USUAL, given.first_seed, size)], noise, given.first_seed)
            export(made, name, f"size {size} noise {noise}", given.folder / f"{name}_{size}.npz")
    for k in range(given.empty):
        seed = given.first_seed + k
        export(make(USUAL, "clean", [], 0.01, seed), "", "nothing, white", given.folder / f"white_{k}.npz")
        export(
            make(USUAL, "clean", [], 0.01, seed, coloured=True),
            "",
            "nothing, AR(1) 0.7",
            given.folder / f"coloured_{k}.npz",
        )


if __name__ == "__main__":
    main()
