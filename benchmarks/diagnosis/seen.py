"""What the hidden change itself would explain in each record of a study, beside the base and the plant's own traits.

    python benchmarks/diagnosis/seen.py LINES.jsonl... [--row "abba 1 %"] [--missed]
    python benchmarks/diagnosis/seen.py --seed 8000 --seed 8100 --share 0/4 --share 2/4 --row "abba 1 %"

The diagnosis is let name the traits of the plant alone. Then the very change that the hidden effect made of the force,
which is no regressor of ours, is fitted beside the tangent of what was found, as one column of free size, and judged on
held-out blocks. Where that is next to nothing, base and traits have taken the change up, and a method that gives them
this freedom cannot see it. Three shares are printed, in percent:

- `explains`: of the error power, what the change explains so. A cause needs 0.2 (`causes.LEAST_SHARE`).
- `beside`: of that, what is left of it beside other forms of the traits (decision 0168).
- `forms`: of that, what those other forms explain without it.

Beside them is said what the change could be taken for: the cause of the catalogue whose force comes nearest to it,
beside what was found, and by how many deviations of the noise the two differ (`apart`). Who knew both forces, and asked
which is the likelier, would name the true one in Phi(apart / 2) of such records: 84 % at 2, 69 % at 1, half at 0.

Records are those of a study's lines, or of the design of some seeds, of which nobody has asked the diagnosis.
"""

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from design import ROWS, cases
from judge import Line, scored
from scipy.optimize import minimize_scalar
from study import make_case

from friction_estimator.core.sample import Floats
from friction_estimator.diagnosis.evidence import Rule
from friction_estimator.diagnosis.forms import OtherForms
from friction_estimator.diagnosis.joint import Joint
from friction_estimator.diagnosis.lack_of_fit import LackOfFit
from friction_estimator.diagnosis.library import build_library, built
from friction_estimator.diagnosis.record import Record, build_record
from friction_estimator.diagnosis.rivals import Alike, alike, own_power
from friction_estimator.diagnosis.search import Searcher
from friction_estimator.diagnosis.theory import with_theory
from friction_estimator.effects import EFFECTS, Effect
from friction_estimator.effects.features import Context
from friction_estimator.rig.plant import PLANTS

SEED = 0

NEAR = 3
"""Effects that come nearest on the grid and are looked at more closely."""

WITHIN = (-3.0, 1.0)
"""Logarithm of what their length or time may be times that on the grid, which begins at a part of a sample."""


@dataclass(frozen=True)
class Seen:
    """The three shares of the hidden change, %; the name of the nearest other cause, and how far it is apart."""

    explains: float
    beside: float
    forms: float
    nearest: str
    apart: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("lines", type=Path, nargs="*")
    parser.add_argument("--seed", type=int, action="append", help="records of this seed, too; may be repeated")
    parser.add_argument("--share", metavar="K/N", action="append", help="of a seed's: as of study.py; may be repeated")
    parser.add_argument("--row", action="append", help="this row only; may be repeated")
    parser.add_argument("--missed", action="store_true", help="only records whose truth is not the first name")
    given = parser.parse_args()
    print("row | hidden | plant | drive | named first | explains, % | beside, % | forms, % | nearest | apart")
    for line in [*_lines(given.lines), *_designed(given.seed or [], given.share or ["0/1"])]:
        named = scored(line).named if "verdict" in line else None
        if (given.row and line["row"] not in given.row) or (given.missed and named is not False):
            continue
        said = "-" if named is None else "yes" if named else "no"
        words = [line["row"], line["truth"][0], line["plant"], line["drive"], said]
        one = seen(line)
        numbers = [f"{value:.2f}" for value in (one.explains, one.beside, one.forms)]
        print(" | ".join([*words, *numbers, one.nearest, f"{one.apart:.2f}"]), flush=True)


def _designed(seeds: list[int], shares: list[str]) -> Iterator[Line]:
    """Yield the records of some seeds that hide one effect of the catalogue."""
    parts = [tuple(map(int, share.split("/"))) for share in shares]
    for seed in seeds:
        for number, case in enumerate(cases(list(ROWS), range(seed, seed + 1))):
            if any(number % n == k for k, n in parts) and _hides_one(case):
                yield case


def _lines(paths: list[Path]) -> Iterator[Line]:
    """Yield the records that hide one effect of the catalogue."""
    for path in paths:
        for text in path.read_text(encoding="utf-8").splitlines():
            line = json.loads(text)
            if "verdict" in line and _hides_one(line):
                yield line


def _hides_one(line: Line) -> bool:
    return len(line["truth"]) == 1 and not line["out"]


def seen(case: dict[str, Any]) -> Seen:
    """Return what can be seen of the hidden change of one record."""
    made = make_case(case)
    config = with_theory(made.config, made.samples)
    record = build_record([made.samples], config)
    context = record.context(config, float(np.abs(record.friction_N).max()))
    traits = {name: EFFECTS[name] for name in PLANTS[case["plant"]].traits}
    found = Searcher(record, config, context, traits, SEED)(lambda _stage, _part: None)
    model, change = found.models[-1], made.changes_N[0]
    loss = float(model.held_out_loss(record, SEED).sum())
    gain = _explained(model, change, record)
    share = 100.0 * gain / loss
    others = {name: cls for name, cls in EFFECTS.items() if name not in (*traits, *case["truth"])}
    name, lost_N2 = _nearest(model, change, record, context, others)
    noise_N2 = max(float(np.var(made.noise_N)), np.finfo(np.float64).tiny)
    apart = float(np.sqrt(lost_N2 / noise_N2))
    if not model.terms or gain <= 0.0:
        return Seen(share, 100.0, 0.0, name, apart)
    other = LackOfFit(OtherForms.of(model), model, loss, record, SEED)
    return Seen(share, 100.0 * other.beside(change) / gain, 100.0 * other.alone_N2 / gain, name, apart)


def _nearest(
    model: Joint, change_N: Floats, record: Record, context: Context, others: dict[str, type[Effect]]
) -> tuple[str, float]:
    """Return which other effect comes nearest to a change (n,), and by what power it misses it, N^2.

    Its length or time is sought about that of the best point of the grid (`WITHIN`).
    """
    evidence = model.evidence(record, SEED)
    library = build_library(others, model.features, model.reference, context, evidence)
    best: dict[str, float] = {}
    for name, one in list(alike(evidence, library, change_N).items())[:NEAR]:
        effect = others[name]

        def lost(scale: float, effect: type[Effect] = effect, one: Alike = one) -> float:
            at = one.params
            moved = at | {key: scale * at[key] for key in effect.refined[:1] if at.get(key, 0.0) > 0.0}
            here = built({effect: [moved]}, model.features, model.reference, evidence)
            there = alike(evidence, here, change_N).get(effect.name)
            return one.lost_N2 if there is None else there.lost_N2

        found = minimize_scalar(lambda x: lost(float(np.exp(x))), bounds=WITHIN, method="bounded")
        best[name] = max(min(float(found.fun), one.lost_N2), 0.0)
    name = min(best, key=best.__getitem__, default="-")
    return name, best.get(name, own_power(evidence.with_residual(change_N)))


def _explained(model: Joint, change_N: Floats, record: Record) -> float:
    """Return the held-out decrease of the error power by a force (n,) of free size beside a model, N^2."""
    evidence = model.evidence(record, SEED)
    return float(evidence.cross_validated(evidence.moments(change_N[:, None]), Rule((0,))).sum())


if __name__ == "__main__":
    main()
