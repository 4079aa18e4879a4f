"""`identify`: the best that the model structure can do on recordings, and how far each online law stays from it."""

import argparse
import time
from typing import Any

import numpy as np

from friction_estimator.added_terms import added_terms, added_terms_as_met
from friction_estimator.cli import common, joints, loads, side_by_side
from friction_estimator.cli.progress import progress
from friction_estimator.cli.recorded import Session, add_run_options, load, outputs, tell_theory, tell_units
from friction_estimator.cli.replay import judged, summarise
from friction_estimator.core.errors import ConfigError, about
from friction_estimator.core.fit.batch import BatchFit, fit_batch
from friction_estimator.core.intake.standstill import standstill
from friction_estimator.core.metrics import NrmseInTurn, nrmse
from friction_estimator.core.online.adaptation import LAWS
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.online.first_contact import chosen, meet, refined
from friction_estimator.core.online.record_figures import RecordFigures
from friction_estimator.core.online.replay import Replay, check_answerable, curves_of
from friction_estimator.core.online.run import Run
from friction_estimator.core.sample import Bools, Floats
from friction_estimator.core.settings.config import Config

SCHEMA = "friction_estimator/identify/2"


def add_parser(subparsers: common.Subparsers) -> None:
    """Add the verb's parser."""
    parser = common.add_verb(
        subparsers,
        "identify",
        "batch reference fit: the best this structure can do on this record",
        description="Fit the model to all recordings at once (global start by over-parameterised least squares "
        "and rank-one factorisation, then variable projection from several starts), say how many directions in "
        "parameter space the recording determines, and compare the online laws (or the one of --law) with it. "
        "Other recordings (--test) are predicted with the fit and judged beside the textbook's friction curves.",
        example="friction_estimator identify bags/demo --model hammerstein --out out\n"
        "  friction_estimator identify monday tuesday --test wednesday",
    )
    add_run_options(parser)
    parser.add_argument("--fit-only", action="store_true", help="leave the online laws out")


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    with outputs(args) as output:
        return joints.run(args, output, joints.HEADS, _run)


def _run(args: argparse.Namespace, output: common.Outlet) -> joints.Outcome:
    session = load(args, output, {"model.type": args.model})
    samples = session.samples
    with about(", ".join(session.bags)):
        check_answerable(samples, session.quantities)
        learned = _learned(len(samples), args.freeze_after)
        # Range, units and theory are those of the samples that are fitted: all are known before;
        # so is a Stribeck curve, of whatever samples it was found before.
        config = chosen(session.config, samples[: int(learned.sum())])
        if config.finds_stribeck:
            config = refined(config, samples[: int(learned.sum())])
    tell_units(output, session.quantities, session.config, config)
    tell_theory(output, config, samples)
    begin = time.perf_counter()
    with progress("fitting", len(samples)) as advance:
        # Greater: and not. Nothing else holds it, so that the fit lets go of it when it knows what it uses of it.
        fit = fit_batch(samples, config, added_terms(config), use=learned > standstill(samples, config.velocity_scale))
        advance(len(samples))
    seconds = time.perf_counter() - begin
    result = judged(session, _as_replay(session, config, fit, learned, seconds))
    summary = summarise(session, result, SCHEMA) | {"law": "batch", **_identifiability(fit)}
    if not args.fit_only:
        summary["online"] = _online(session, fit, [args.law] if args.law else list(LAWS), args.freeze_after)
    _tell(output, summary)
    loads.tell(output, result.loads, session.quantities, 14)
    side_by_side.tell(output, result, session.quantities)
    if args.out:
        from friction_estimator.cli.results import write_results  # noqa: PLC0415 - drawing is loaded where asked for

        with output.part() as folder:
            write_results(folder, session.recordings, result, summary, session.quantities, args.words, args.figures)
        output.say(f"{'written':<14}{args.out}: bag/, figures/, report.html, summary.json, config.yaml")
    output.result(summary)
    return joints.outcome(summary, result)


def _learned(n: int, freeze_after: float | None) -> Bools:
    """Return which of n samples are fitted, (n,)."""
    if freeze_after is not None and not 0.0 < freeze_after <= 1.0:
        raise ConfigError(
            f"freeze-after is {freeze_after:g}: give the fraction of the record to fit, above 0 to 1 "
            "(replay takes 0: it scores what --config has learned)"
        )
    if freeze_after is None:
        return np.broadcast_to(np.bool_(True), (n,))
    learned = np.zeros(n, np.bool_)
    learned[: max(1, round(freeze_after * n))] = True
    return learned


def _as_replay(session: Session, config: Config, fit: BatchFit, learned: Bools, seconds: float) -> Replay:
    """Return the fit as a replay whose parameters never change: both are then scored and written alike."""
    estimator = Estimator(config, added_terms(config))
    estimator.parameters = fit.parameters
    samples = session.samples
    begins, ends = session.starts, (*session.starts[1:], len(samples))
    shown = [index for begin, end in zip(begins, ends, strict=True) for index in (begin, end - 1)]
    curve, outlook = curves_of(fit, samples, learned)
    return Replay(
        config=config,
        record=RecordFigures.of(samples, learned, session.starts, estimator.model),
        predicted_N=fit.predicted_N,
        snapshot_index=shown,
        snapshots=[fit.parameters for _ in shown],
        health=estimator.health,
        seconds=seconds,
        estimator=estimator,
        curve=curve,
        outlook=outlook,
        loads=fit.loads,
    )


def _identifiability(fit: BatchFit) -> dict[str, Any]:
    """Return rank, spectrum and standard errors, in the units of `parameters`."""
    errors = fit.model.split(np.sqrt(np.maximum(np.diag(fit.covariance), 0.0)))
    return {
        "identifiable_rank": fit.identifiable_rank,
        "parameter_count": fit.model.size,
        "singular_values": fit.singular_values,
        "singular_value_threshold": fit.threshold,
        "residual_rms_N": fit.residual_rms_N,
        "start_costs": fit.start_costs,
        "standard_errors": {
            "fir_taps": errors.fir_taps,
            "theory_taps": errors.theory_taps if errors.theory_taps.size else None,
            "wavelet_weights": errors.wavelet_weights,
            "load_weights": errors.load_weights if errors.load_weights.size else None,
            "extension_weights": errors.extension_weights if errors.extension_weights.size else None,
        },
    }


def _online(
    session: Session, fit: BatchFit, laws: list[str], freeze_after: float | None
) -> dict[str, dict[str, float]]:
    """Return for each law its a priori error, and that error over the batch fit's on the same samples."""
    # What waits for the first contact, and may be let go, is the same for every law.
    samples, dropped = session.samples, meet(session.config, session.samples).dropped
    measured = samples.friction_N[dropped:]
    late = measured.size - max(2, measured.size // 5)
    fitted = [nrmse(measured[begin:], fit.predicted_N[dropped + begin :]) for begin in (0, late)]
    rows = {}
    with progress("online laws", len(laws) * len(samples)) as advance:
        for law in laws:
            config = session.config.updated({"model.law": law})
            errors = [NrmseInTurn(measured, begin) for begin in (0, late)]

            def take(predicted: Floats, errors: list[NrmseInTurn] = errors) -> None:
                for error in errors:
                    error.take(predicted)

            run = Run(
                config,
                extension=added_terms_as_met(config, samples),
                deviation=False,
                freeze_after=freeze_after,
                total=len(samples),
                advance=advance,
                told=take,
            )
            run.begin()
            run.push(samples)
            run.finish()
            whole, end = (error.value for error in errors)
            rows[law] = {
                "nrmse": whole,
                "nrmse_final": end,
                "excess": _over(whole, fitted[0]),
                "excess_final": _over(end, fitted[1]),
            }
    return rows


def _over(error: float, least: float) -> float:
    return error / least if least > 0.0 else float("nan")


def _tell(output: common.Outlet, summary: dict[str, Any]) -> None:
    figures = [
        ("nrmse", summary["nrmse"], "error of the batch fit over the std of friction, whole record"),
        ("frozen", summary["nrmse_frozen"], "over what was not fitted, after --freeze-after"),
        ("persistence", summary["nrmse_persistence"], "the guess f[k-1], to read the others beside"),
        ("theory", summary["theory_nrmse"], "the theoretical curve alone"),
    ]
    for name, value, meaning in figures:
        if value is not None:
            output.say(f"{name:<14}{value:.4f}  {meaning}")
    largest, threshold = summary["singular_values"][0], summary["singular_value_threshold"]
    output.say(
        f"{'identifiable':<14}{summary['identifiable_rank']} of {summary['parameter_count']} directions "
        f"(singular values from {largest:.2g} down to the threshold {threshold:.2g})"
    )
    for law, row in summary.get("online", {}).items():
        output.say(
            f"{law:<14}{row['nrmse_final']:.4f}  over the last fifth, {row['excess_final']:.3f} times the batch fit; "
            f"{row['excess']:.3f} times over the whole record"
        )
