"""`replay`: the estimator over a recording, as fast as the machine goes, without a ROS graph."""

import argparse
from pathlib import Path
from typing import Any

from friction_estimator.cli import common
from friction_estimator.cli.recorded import Loaded, add_run_options, load
from friction_estimator.core.online.replay import Replay, replay
from friction_estimator.effects.extension import extension_from_config

SCHEMA = "friction_estimator/replay/1"


def add_parser(subparsers: "common.Subparsers[common.Parser]") -> None:
    """Add the verb's parser."""
    parser = common.add_verb(
        subparsers,
        "replay",
        "the estimator over a recording",
        description="Run the estimator over a recording by the live node's own path and report the error of its "
        "predictions, each made before its measurement was used.",
        example="friction_estimator replay bags/demo --law rls --freeze-after 0.5 --out out",
    )
    add_run_options(parser)


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    output = common.Output(args.json)
    loaded = load(args, output, {"model.type": args.model, "model.law": args.law})
    with common.progress("replaying", len(loaded.samples)) as advance:
        result = replay(
            loaded.samples,
            loaded.config,
            extension=extension_from_config(loaded.config),
            freeze_after=args.freeze_after,
            advance=advance,
        )
    summary = summarise(loaded, result, SCHEMA)
    _tell(output, summary)
    if args.out:
        # Drawing and HTML are loaded only where they are asked for.
        from friction_estimator.cli.results import write_results  # noqa: PLC0415

        write_results(Path(args.out), loaded.recording, result, summary)
        output.say(f"{'written':<12}{args.out}: bag/, figures/, report.html, summary.json, config.yaml")
    output.result(summary)
    return 0


def summarise(loaded: Loaded, result: Replay, schema: str) -> dict[str, Any]:
    """Return the JSON of a replay (INTERFACE section 2)."""
    config = result.config
    return {
        "schema": schema,
        "bag": str(loaded.recording.path),
        "model": config.model.type,
        "law": config.model.law,
        "samples": loaded.counts(),
        **result.figures(),
        "health": result.health,
    }


def _tell(output: common.Output, summary: dict[str, Any]) -> None:
    figures = [
        ("nrmse", summary["nrmse"], "a priori error over the std of friction, whole record"),
        ("final", summary["nrmse_final"], "last fifth"),
        ("frozen", summary["nrmse_frozen"], "without learning, after --freeze-after"),
        ("persistence", summary["nrmse_persistence"], "the guess f[k-1], to read the others beside"),
        ("theory", summary["theory_nrmse"], "the theoretical curve alone"),
    ]
    for name, value, meaning in figures:
        if value is not None:
            output.say(f"{name:<12}{value:.4f}  {meaning}")
    if summary["diverged"]:
        common.warn("the estimator diverged: lower the step size, or use --law rls")
    health = summary["health"]
    if health.outside:
        common.warn(f"{health.outside} samples lie outside basis.velocity_range: they were predicted, not learned from")
