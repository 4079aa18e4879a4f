"""`reproduce`: the paper's Figs. 3 to 6, and its claims confirmed or refuted by numbers."""

import argparse
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from friction_estimator.cli import common
from friction_estimator.cli.progress import progress
from friction_estimator.core.errors import InputError
from friction_estimator.output.layout import Layout
from friction_estimator.paper import bases, convergence, landscape, shape, structure
from friction_estimator.paper.claims import Claim, Interval
from friction_estimator.paper.runs import run_recording
from friction_estimator.paper.study import COMPANDED, MODELS, PLAIN, Plan, Study, assemble
from friction_estimator.rig.drive import CONDITIONS
from friction_estimator.tasks.local import LocalWorkers, usable_cores
from friction_estimator.tasks.task import Task, TaskError

SCHEMA = "friction_estimator/claims/1"

FEW_SEEDS, PLAIN_SEEDS = 3, 6
"""Recordings of each condition for the claim on orders, which takes six fits each, and for g learned elsewhere; and for
what the paper's own basis changes, where the share of seeds needs six of them to be told from one half.
"""

WORKERS = 2
"""Processes at the most."""

PAPER_FIGURES, JUDGED_FIGURE = tuple(f"figure_{number}" for number in range(3, 7)), "figure_judged"
"""Those that the paper has, and the errors while learning, frozen and elsewhere in one."""

LAYOUT = Layout(
    "claims.json",
    re.compile(r'\{\s*("schema": "friction_estimator/claims/\d+"|"claims": \[)'),
    frozenset(
        {
            "index.html",
            *(f"{name}.{form}" for name in (*PAPER_FIGURES, JUDGED_FIGURE) for form in common.FIGURE_FORMATS),
        }
    ),
)


def add_parser(subparsers: common.Subparsers) -> None:
    """Add the verb's parser."""
    parser = common.add_verb(
        subparsers,
        "reproduce",
        "the paper's Figs. 3-6 and a table of its claims",
        description="Repeat the paper's experiments on the simulated rig and put its claims to the test. Writes "
        "claims.json, index.html with figures and verdicts, and the figures as SVG and PNG. The same seeds give the "
        "same numbers.",
        example="friction_estimator reproduce --out reproduced",
    )
    parser.add_argument("--out", metavar="DIR", required=True, help="folder to write")
    parser.add_argument("--seeds", type=int, default=Plan().seeds, metavar="N", help="seeds (default: %(default)s)")
    parser.add_argument(
        "--seconds", type=float, default=Plan().seconds, metavar="S", help="of each recording (default: %(default)g)"
    )
    common.add_figures_option(parser, ("svg", "png"))
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
    results: dict[Any, Any] = {}
    with progress("reproducing", len(tasks), "tasks") as advance, LocalWorkers(min(WORKERS, usable_cores())) as workers:
        for done in workers.run(tasks):
            if done.failure is not None:
                raise TaskError(done.failure)
            results[done.task.key] = done.result
            advance(1)
    results = {task.key: results[task.key] for task in tasks}
    study, claims = judge(plan, results)
    for claim in claims:
        modes = ", ".join(
            f"{mode} {word} ({claim.cases[mode]['hold']} of {sum(claim.cases[mode].values())} cases)"
            for mode, word in claim.verdicts.items()
        )
        output.say(f"{claim.verdict:<10} {claim.id}: {modes or 'by proof'}")
    result = {"schema": SCHEMA, "claims": claims}
    with output.part() as folder:
        write(folder, study, claims, common.to_json(result) + "\n", args.words, args.figures)
    output.say(f"written    {args.out}: claims.json, index.html, figure_3 to figure_6, {JUDGED_FIGURE}")
    output.result(result)
    return 0


def plan_tasks(plan: Plan) -> list[Task]:
    """Return all work, longest first."""
    few = replace(plan, seeds=min(plan.seeds, FEW_SEEDS))
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
            for companding in (COMPANDED, PLAIN)[: 2 if seed < PLAIN_SEEDS else 1]:
                arguments = (plan, condition, seed, companding)
                tasks.append(Task(("run", companding, condition, seed), run_recording, arguments))
            tasks.append(Task(("theory", condition, seed), convergence.wrong_theory, (plan, condition, seed)))
        for seed in range(few.seeds):
            tasks.append(Task(("shape", condition, seed), shape.learned_elsewhere, (plan, condition, seed)))
        tasks.append(Task(("mirror", condition), shape.mirrored_run, (plan, condition)))
    tasks += [Task(("bases", seed), bases.basis_errors, (seed,)) for seed in range(plan.seeds)]
    return tasks


def judge(plan: Plan, results: dict[tuple[Any, ...], Any]) -> tuple[Study, list[Claim]]:
    """Return the study in the companded basis and the verdicts."""

    def of(*kind: Any) -> dict[tuple[Any, ...], Any]:
        return {key[len(kind) :]: value for key, value in results.items() if key[: len(kind)] == kind}

    def by_condition(kind: str) -> dict[str, list[Any]]:
        return {c: [value for (condition, _), value in of(kind).items() if condition == c] for c in CONDITIONS}

    study = assemble(plan, of("run", COMPANDED))
    plain = assemble(replace(plan, seeds=min(plan.seeds, PLAIN_SEEDS)), of("run", PLAIN))
    orders: dict[tuple[str, float], list[Any]] = {}
    for (condition, rate, _), value in of("orders").items():
        orders.setdefault((condition, rate), []).append(value)
    mirrored = {condition: value for (condition,), value in of("mirror").items()}
    claims = [
        convergence.hammerstein_converges(study, plain),
        convergence.parallel_ends_closer(study, plain),
        convergence.parallel_converges_faster(study, plain),
        convergence.good_before_convergence(study, by_condition("theory"), plain),
        shape.g_has_the_shape(study, by_condition("shape"), mirrored, plain),
        structure.higher_orders_help_little(plan, orders),
        bases.wavelets_need_fewer(list(of("bases").values())),
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
