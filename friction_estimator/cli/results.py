"""What `--out` writes: the enriched recording, figures, page, summary and configuration."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from friction_estimator.bag import own
from friction_estimator.bag.read import times_of
from friction_estimator.bag.recording import Recorded
from friction_estimator.bag.source import Source
from friction_estimator.bag.write import add_results, written
from friction_estimator.cli import loads, side_by_side
from friction_estimator.cli.common import to_json
from friction_estimator.cli.data_quality import data_quality
from friction_estimator.cli.provenance import provenance
from friction_estimator.core import sums
from friction_estimator.core.online.replay import Replay
from friction_estimator.core.quantities import Quantities
from friction_estimator.core.sample import Floats, Ints
from friction_estimator.core.series import Formed
from friction_estimator.core.text import shown
from friction_estimator.documents.configuration import write_config
from friction_estimator.output.layout import Layout, only, strange
from friction_estimator.report.figures import FIGURES, write_figures
from friction_estimator.report.page.content import Section
from friction_estimator.report.page.replay_page import replay_page
from friction_estimator.report.page.write import write_page
from friction_estimator.report.style import SUFFIXES, USUAL

LONGEST_FOLDER = 60
"""Characters of a recording's name that are taken over: with four bytes each a file system takes them."""


def _recordings_refusal(folder: Path) -> str | None:
    """Return why bag/ may not be replaced: it is one recording of ours, or a folder of some."""
    reason = own.refusal(folder)
    if reason is not None and not (folder / "metadata.yaml").exists():
        for item in sorted(folder.iterdir()):
            if not item.is_dir() or item.is_symlink():
                return strange(item)
            reason = own.refusal(item)
            if reason is not None:
                break
    return None if reason is None else f"in {folder.name}/, {reason}"


RESULTS = Layout(
    "summary.json",
    re.compile(r'\{\s*"schema": "friction_estimator/(replay|identify)/\d+"'),
    frozenset({"report.html", "config.yaml"}),
    {"bag": _recordings_refusal, "figures": only(FIGURES, SUFFIXES)},
)
"""What `replay`, `identify` and the demonstration write."""


def write_results(
    folder: Path,
    recordings: Recorded | Sequence[Recorded],
    result: Replay,
    summary: Mapping[str, Any],
    quantities: Quantities | None = None,
    words: Sequence[str] = (),
    formats: Sequence[str] = USUAL,
) -> None:
    """Write bag/, figures/, report.html, summary.json and config.yaml into `folder`.

    bag/ is the recording with what was predicted; where several were learned, it holds one for each, numbered in order.
    config.yaml starts the live node, or the next replay, warm from what was learned.

    Parameters
    ----------
    folder : made here; nothing stands there yet.
    recordings : those that were learned, in the order of `result.parts`.
    summary : the JSON of the run.
    quantities : how numbers are shown; in SI units unless given.
    words : the command line. formats : of the figures.

    Raises InputError where a recording cannot be written.
    """
    quantities = quantities or result.config.quantities
    taken = list(recordings) if isinstance(recordings, Sequence) else [recordings]
    paths = ", ".join(str(recording.path) for recording in taken)
    folder.mkdir()
    write_bags(folder / "bag", taken, result)
    write_config(
        folder / "config.yaml",
        result.estimator.learned_config,
        header=f"Written by friction_estimator from {paths}: derived units and learned values.\n"
        "Start warm with it: estimator_node --ros-args --params-file config.yaml",
    )
    (folder / "summary.json").write_text(to_json(summary) + "\n", encoding="utf-8")
    (folder / "figures").mkdir()
    fitted = summary["law"] == "batch"
    figures = write_figures(result, folder / "figures", quantities, formats, fitted=fitted)
    details = [
        data_quality(taken, result.config, quantities, summary["samples"]),
        *provenance(words, [recording.path for recording in taken], result.config),
    ]
    scores = [(name, score) for name, score, _ in side_by_side.scores_of(result)]
    elsewhere = [*loads.section(result.loads, quantities), *_on_other_data(result, quantities)]
    page = replay_page(result, scores, summary, quantities, figures, elsewhere, details, fitted=fitted, words=words)
    write_page(folder / "report.html", page)


def write_bags(path: Path, recordings: Sequence[Recorded], result: Replay) -> None:
    """Write one recording to `path`; several, numbered in order, into the folder `path`."""
    if len(recordings) == 1:
        write_bag(path, recordings[0], result)
        return
    path.mkdir()
    digits = len(str(len(recordings)))
    for number, (recording, part) in enumerate(zip(recordings, result.parts, strict=True), start=1):
        name = recording.path.name if recording.path.is_dir() else recording.path.stem
        write_bag(path / f"{number:0{digits}d}_{shown(name, LONGEST_FOLDER)}", recording, result, part)


def write_bag(path: Path, recording: Recorded, result: Replay, part: slice = slice(None)) -> None:
    """Write the inputs as they were recorded, with prediction, residual and parameters.

    `part` are the recording's samples in `result`.
    """
    names = sorted({stream.topic for stream in recording.streams.values()})
    samples, residual = result.samples[part], result.residual_N
    first, end, _ = part.indices(residual.size)
    # Outputs stand beside the friction that they belong to, whatever clock made its stamps.
    log_time_ns = _log_times(*times_of(recording, "friction"), samples.stamp_ns)
    with written(path) as writer:
        with Source(recording.path) as source:
            writer.copy(source, names)
        add_results(
            writer,
            samples.stamp_ns,
            result.predicted_N[part],
            Formed(end - first, lambda some: residual[first + some.start : first + some.stop]),
            _snapshots(result, part, log_time_ns),
            log_time_ns=log_time_ns,
            frame_id=recording.streams["friction"].frame_id,
            axis=result.config.input.axis,
            motion=recording.motion,
        )


def _log_times(stamp_ns: Ints, log_time_ns: Ints, wanted_ns: Ints) -> Ints:
    """Return when the messages of some stamps were recorded, (m,).

    All are in order of arrival, so equal stamps keep their order.
    """
    if np.array_equal(stamp_ns, wanted_ns):
        return log_time_ns
    found, at, last = np.empty(wanted_ns.size, np.int64), 0, stamp_ns.size - 1
    for part in sums.parts(wanted_ns.size):
        count = part.stop - part.start
        if np.array_equal(stamp_ns[at : at + count], wanted_ns[part]):
            found[part] = log_time_ns[at : at + count]
            at = min(at + count, last)
            continue
        for k, wanted in enumerate(wanted_ns[part].tolist(), part.start):
            while stamp_ns[at] != wanted and at < last:
                at += 1
            found[k] = log_time_ns[at]
            at = min(at + 1, last)
    return found


def _snapshots(result: Replay, part: slice, log_time_ns: Ints) -> dict[str, tuple[Ints, Floats]]:
    """Return times of recording and values of the parameters learned by samples of `part`.

    Where the velocity range grew, weights are those since it grew last: a topic's arrays have one size.
    """
    first, end, _ = part.indices(len(result.samples))
    kept = [k for k, index in enumerate(result.snapshot_index) if first <= index < end]
    out = {}
    for name in ("fir_taps", "theory_taps", "wavelet_weights") if kept else ():
        values = {k: getattr(result.snapshots[k], name) for k in kept}
        alike = [k for k in kept if values[k].size == values[kept[-1]].size]
        times = log_time_ns[[result.snapshot_index[k] - first for k in alike]]
        out[name] = (times, np.array([values[k] for k in alike]))
    return out


def _on_other_data(result: Replay, quantities: Quantities) -> list[Section]:
    """Return the section on what was predicted without learning; none where nothing was."""
    rows = side_by_side.rows(result, quantities)
    if not rows:
        return []
    text = (
        "Predicted with what was learned, without learning, beside curves of velocity alone fitted to the same samples "
        "that the model learned from, the guess that friction is what it was one sample ago, and the theoretical "
        f"curve alone. Error rms over the std of measured friction (nrmse), and in {quantities.force}."
    )
    if result.others:
        text += (
            f" Of other recordings the first {result.config.fir.order} samples, and as many after a gap, are left out: "
            "the model's memory is not filled there."
        )
    return [Section("On other data", [text], [side_by_side.HEAD, *rows])]
