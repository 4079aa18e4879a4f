"""What `--out` writes: the enriched recording, figures, page, summary and configuration, each whole or not at all."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from friction_estimator.bag.read import Recording
from friction_estimator.bag.source import Source
from friction_estimator.bag.write import add_results, writing
from friction_estimator.cli.common import to_json
from friction_estimator.core.online.replay import Replay, with_learned
from friction_estimator.core.sample import Floats, Ints
from friction_estimator.files import atomic_path, write_config, write_text
from friction_estimator.report.figures import write_figures
from friction_estimator.report.html import Section, write_page


def write_results(folder: Path, recording: Recording, result: Replay, summary: Mapping[str, Any]) -> None:
    """Write bag/, figures/, report.html, summary.json and config.yaml into `folder`.

    config.yaml starts the live node, or the next replay, warm from what was learned.

    Raises InputError where the folder cannot be written.
    """
    write_bag(folder / "bag", recording, result)
    write_config(
        folder / "config.yaml",
        with_learned(result.config, result.parameters),
        header=f"Written by friction_estimator from {recording.path}: derived units and learned values.\n"
        "Start warm with it: estimator_node --ros-args --params-file config.yaml",
    )
    write_text(folder / "summary.json", to_json(summary) + "\n")
    with atomic_path(folder / "figures") as part:
        part.mkdir()
        figures = write_figures(result, part)
        write_page(
            folder / "report.html",
            "Friction estimated",
            f"{result.config.model.type} model, law {result.config.model.law}, over {recording.path}",
            [_figures_of_merit(summary), _inputs(recording, summary), Section("Figures", figures=figures)],
        )


def write_bag(path: Path, recording: Recording, result: Replay) -> None:
    """Write the inputs as they were recorded, with prediction, residual and parameters."""
    names = sorted({stream.topic for stream in recording.streams.values()})
    friction, samples = recording.streams["friction"], result.samples
    # Outputs stand beside the friction that they belong to, whatever clock made its stamps.
    log_time_ns = friction.log_time_ns[_places(friction.stamp_ns, samples.stamp_ns)]
    parameters = _snapshots(result, log_time_ns)
    with writing(path) as writer:
        with Source(recording.path) as source:
            writer.copy(source, names)
        add_results(
            writer,
            samples.stamp_ns,
            result.predicted_N,
            result.residual_N,
            parameters,
            log_time_ns=log_time_ns,
            frame_id=friction.frame_id,
            axis=result.config.input.axis,
        )


def _places(stamp_ns: Ints, wanted_ns: Ints) -> Ints:
    """Return where each wanted stamp stands, (m,); both are in order of arrival, so equal stamps keep their order."""
    places, at = np.empty(wanted_ns.size, np.int64), 0
    stamps = stamp_ns.tolist()
    for k, wanted in enumerate(wanted_ns.tolist()):
        while stamps[at] != wanted and at < len(stamps) - 1:
            at += 1
        places[k] = at
        at = min(at + 1, len(stamps) - 1)
    return places


def _snapshots(result: Replay, log_time_ns: Ints) -> dict[str, tuple[Ints, Floats]]:
    times = log_time_ns[_places(result.samples.stamp_ns, np.array(result.snapshot_stamp_ns, np.int64))]
    return {
        name: (times, np.array([getattr(snapshot, name) for snapshot in result.snapshots]))
        for name in ("fir_taps", "theory_taps", "wavelet_weights")
    }


def _figures_of_merit(summary: Mapping[str, Any]) -> Section:
    rows: list[tuple[object, ...]] = [("figure", "value", "meaning")]
    meanings = {
        "nrmse": "a priori error rms over the std of measured friction, whole record",
        "nrmse_final": "the same over the last fifth",
        "fit_percent": "100 (1 - nrmse_final)",
        "nrmse_frozen": "after learning was stopped",
        "nrmse_persistence": "the guess that friction is what it was one sample ago",
        "theory_nrmse": "the theoretical curve alone",
    }
    rows += [(name, summary[name], meaning) for name, meaning in meanings.items() if summary.get(name) is not None]
    rows.append(("diverged", "yes" if summary["diverged"] else "no", "error above twice the spread, or not finite"))
    return Section("Error", table=rows)


def _inputs(recording: Recording, summary: Mapping[str, Any]) -> Section:
    counts = summary["samples"]
    rows: list[tuple[object, ...]] = [("input", "topic", "messages")]
    rows += [(name, stream.topic, len(stream)) for name, stream in recording.streams.items()]
    refused = ", ".join(f"{count} {reason}" for reason, count in counts["rejected"].items()) or "none"
    text = f"{counts['used']} samples used of {counts['read']}; refused: {refused}."
    return Section("Input", [text], rows)
