"""`reproduce`: the paper's Figs. 3 to 6, and its claims confirmed or refuted by numbers."""

import argparse
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from friction_estimator.cli import common
from friction_estimator.cli.progress import progress
from friction_estimator.cli.workers import Task, run_tasks
from friction_estimator.core.errors import InputError
from friction_estimator.output.layout import Layout
from friction_estimator.paper import convergence, landscape, structure
from friction_estimator.paper.claims import Claim, Interval
from friction_estimator.paper.study import MODELS, Plan, Study, assemble, run_recording
from friction_estimator.rig.drive import CONDITIONS

SCHEMA = "friction_estimator/claims/1"

STRUCTURE_SEEDS = 3
"""Recordings of each condition for the claim on orders, which takes six fits each."""

LAYOUT = Layout(
    "claims.json",
    re.compile(r'\{\s*("schema": "friction_estimator/claims/\d+"|"claims": \[)'),
    frozenset({"index.html", *(f"figure_{k}.{form}" for k in range(3, 7) for form in common.FIGURE_FORMATS)}),
)


def add_parser(subparsers: common.Subparsers) -> None:
    """Add the verb's parser."""
    parser = common.add_verb(
        subparsers,
        "reproduce",
        "the paper's Figs. 3-6 and a table of its claims",
        description="Repeat the paper's experiments on the simulated rig and put its claims to the test. Writes "
        "claims.json, index.html with figures and verdicts, and the figures as PNG. The same seeds give the same "
        "numbers.",
        example="friction_estimator reproduce --out reproduced",
    )
    parser.add_argument("--out", metavar="DIR", required=True, help="folder to write")
    parser.add_argument("--seeds", type=int, default=Plan().seeds, metavar="N", help="seeds (default: %(default)s)")
    parser.add_argument(
        "--seconds", type=float, default=Plan().seconds, metavar="S", help="of each recording (default: %(default)g)"
    )
    common.add_figures_option(parser)
    common.add_json_option(parser)


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    longest = max(period for period, _ in CONDITIONS.values())
    if args.seeds < 2:
        raise InputError(f"--seeds {args.seeds}: confidence intervals need at least 2")
    if not 6 * longest <= args.seconds <= 3600.0:
        raise InputError(f"--seconds {args.seconds:g}: give {6 * longest:g} to 3600, six cycles of the slowest drive")
    with common.Output(args.json, args.out, LAYOUT.refusal) as output:
        return _run(args, output)


def _run(args: argparse.Namespace, output: common.Output) -> int:
    plan = Plan(seeds=args.seeds, seconds=args.seconds)
    tasks = plan_tasks(plan)
    with progress("reproducing", len(tasks), "tasks") as advance:
        results = run_tasks(tasks, advance)
    study, claims = judge(plan, results)
    for claim in claims:
        output.say(f"{claim.verdict:<10} {claim.id}: {claim.why}")
    result = {"schema": SCHEMA, "claims": claims}
    with output.part() as folder:
        write(folder, study, claims, common.to_json(result) + "\n", args.words, args.figures)
    output.say(f"written    {args.out}: claims.json, index.html, figure_3.png to figure_6.png")
    output.result(result)
    return 0


def plan_tasks(plan: Plan) -> list[Task]:
    """Return all work, longest first."""
    few = Plan(min(plan.seeds, STRUCTURE_SEEDS), plan.seconds, plan.rate_hz, plan.noise)
    tasks = [
        Task(("landscape", condition, model), landscape.examine, (plan, condition, model))
        for condition in CONDITIONS
        for model in MODELS
    ]
    tasks += [
        Task(("orders", condition, rate, seed), structure.order_errors, (few, condition, seed, rate))
        for rate in sorted(structure.RATES, reverse=True)
        for condition in CONDITIONS
        for seed in range(few.seeds)
    ]
    for condition in CONDITIONS:
        for seed in range(plan.seeds):
            tasks.append(Task(("run", condition, seed), run_recording, (plan, condition, seed)))
            tasks.append(Task(("theory", condition, seed), convergence.wrong_theory, (plan, condition, seed)))
    tasks += [Task(("bases", seed), structure.basis_errors, (seed,)) for seed in range(plan.seeds)]
    return tasks


def judge(plan: Plan, results: dict[tuple[Any, ...], Any]) -> tuple[Study, list[Claim]]:
    """Return the study and the verdicts."""

    def of(kind: str) -> dict[tuple[Any, ...], Any]:
        return {key[1:]: value for key, value in results.items() if key[0] == kind}

    study = assemble(plan, {(condition, seed): value for (condition, seed), value in of("run").items()})
    scans = {c: [value for (condition, _), value in of("theory").items() if condition == c] for c in CONDITIONS}
    orders: dict[tuple[str, float], list[Any]] = {}
    for (condition, rate, _), value in of("orders").items():
        orders.setdefault((condition, rate), []).append(value)
    claims = [
        convergence.hammerstein_converges(study),
        convergence.parallel_ends_closer(study),
        convergence.parallel_converges_faster(study),
        convergence.good_before_convergence(study, scans),
        convergence.g_has_the_shape(study),
        structure.higher_orders_help_little(plan, orders),
        structure.wavelets_need_fewer(list(of("bases").values())),
        landscape.unique_minimum(
            plan, {(condition, model): value for (condition, model), value in of("landscape").items()}
        ),
    ]
    return study, claims


def write(
    folder: Path, study: Study, claims: Sequence[Claim], text: str, words: Sequence[str], formats: Sequence[str]
) -> None:
    """Write claims.json, figures and page into `folder`, which is made here."""
    from friction_estimator.cli.provenance import provenance  # noqa: PLC0415 - workers do not draw
    from friction_estimator.report.page.paper_page import paper_page  # noqa: PLC0415
    from friction_estimator.report.page.write import write_page  # noqa: PLC0415
    from friction_estimator.report.reproduce_figures import write_figures  # noqa: PLC0415

    folder.mkdir()
    (folder / "claims.json").write_text(text, encoding="utf-8")
    figures = write_figures(study, folder, formats)
    page = paper_page(study, claims, _table, figures, provenance(words, [], None))
    write_page(folder / "index.html", page)


def _table(claim: Claim) -> list[tuple[object, ...]]:
    """Return the numbers of a claim as rows of name and value; deeper levels are joined into the name."""
    rows: list[tuple[object, ...]] = [("number", "value")]

    def add(name: str, value: Any) -> None:
        if isinstance(value, dict):
            for key, item in value.items():
                add(f"{name}, {key}" if name else str(key), item)
        elif isinstance(value, list):
            for index, item in enumerate(value):
                add(f"{name} {index + 1}", item)
        elif isinstance(value, Interval):
            rows.append((name.replace("_", " "), str(value)))
        elif hasattr(value, "__dataclass_fields__"):
            add(name, vars(value))
        else:
            rows.append((name.replace("_", " "), "never" if value is None else value))

    add("", claim.numbers)
    return rows
