"""The page of `make bench`, from the figures of bench.json: every number on it is computed here from those."""

from collections.abc import Callable, Mapping, Sequence
from statistics import median
from typing import Any

import bounds
from bounds import Requirement, difference, share
from measure import exponent
from tables import table

Figures = Mapping[str, Any]


def spread(one: Sequence[float], other: Sequence[float]) -> str:
    """Return the median of the ratios within a round, and their range where there are several."""
    ratios = [a / b for a, b in zip(one, other, strict=True)]
    return f"{median(ratios):.2f}" + (f" ({min(ratios):.2f} to {max(ratios):.2f})" if len(ratios) > 1 else "")


def medians(rounds: Sequence[Sequence[float]]) -> list[float]:
    return [median(one) for one in rounds]


def listed(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.3g}" for value in values)


def page(every: Figures, plots: Sequence[str]) -> str:
    """Return the page.

    Parameters
    ----------
    every : source, machine and figures by part.
    plots : files beside the page; one is shown in the section that it is named after.
    """
    required = {name: list(of(every[name]["figures"])) for name, of in bounds.OF.items() if name in every}
    rows = [summarised(one) for found in required.values() for one in found]
    missing = [f"`{name}`" for name in bounds.OF if name not in every]
    met = sum(one.met for found in required.values() for one in found)
    parts = [
        "# Speed and memory\n",
        "Written by `make bench` from [bench.json](bench.json); each section names the commit and the command that its "
        "figures come from. All that is compared ran side by side, in turns; ratios are medians of those within a "
        "round. Times are processor time unless the clock is named, memory is the largest resident set.\n",
        f"{met} of {len(rows)} requirements are met; where several figures belong to one, it is the worst."
        + (f" Not measured: {', '.join(missing)}." if missing else "")
        + "\n",
        table(["requirement", "figure", "bound", "met"], rows),
    ]
    for name, (title, section) in SECTIONS.items():
        if name in every:
            one = every[name]
            told = (
                f"{one['source']} {one['machine']}; load before it {one['load_before']:.2f}, took "
                f"{one['took_s'] / 60.0:.1f} min."
            )
            shown = [f"![{title}]({file})" for file in plots if file.startswith(f"{name}.")]
            parts += [f"\n## {title}\n", f"{told}\n", "\n\n".join([section(one["figures"]), *shown])]
    return "\n".join(parts) + "\n"


def summarised(one: Requirement) -> list[str]:
    """Return a row of the summary."""
    digits = ".0f" if one.bound >= 100 else ".2f"
    bound = f"{'at most' if one.at_most else 'at least'} {one.bound:g}{one.unit}"
    return [one.what, f"{one.figure:{digits}}{one.unit}", bound, "yes" if one.met else "**no**"]


def kernels(figures: Figures) -> str:
    loops = []
    for name, one in figures["loops"].items():
        row = [name, one["parameters"], f"{median(one['loop_us']):.3f}"]
        if "C_us" in one:
            bound = bounds.LOOP_OVER_C[one["law"]]
            row += [f"{median(one['C_us']):.3f}", spread(one["loop_us"], one["C_us"]), f"{bound:g}"]
        loops.append(row)
    head = ["law, model", "parameters", "loop, us", "C, us", "loop over C", "at most"][: len(loops[0])]
    before = dict(figures["before"])
    loop = before["loop, parallel lms"]
    for theory in ("Stribeck curve", "seal"):
        before[f"basis and {theory}"] = [a + b for a, b in zip(before["basis"], before[theory], strict=True)]
    live = [
        [
            name,
            *(f"{median(one[way]):.2f}" for way in ("live_us", "batch_us")),
            f"{median(difference(one['live_us'], one['batch_us'])):.2f}",
            f"{median(one['run_us']):.1f}",
        ]
        for name, one in figures["live"].items()
    ]
    in_c = (
        f"`{figures['compiler']}` of [laws.c](kernels/laws.c): the same law on the same rows, every prediction equal "
        f"within {figures['equal_within']:g} force units. C is the law alone: delay lines, regressor, prediction, "
        "step; nlms and rls with the shortening of outliers, rls with the weight of a sample and the recall of the "
        "prior. The loop does beside that what an estimator needs: standstill, the band's running errors by velocity, "
        "the deviation of each prediction, the guard of the step, the range, counters; nlms and rls the alarm and the "
        "kept model."
        if figures["compiler"]
        else "No C compiler was found: nothing stands beside C."
    )
    return "\n\n".join(
        [
            f"{figures['samples']} samples of a sine drive, the default basis and 9 taps, one core.",
            in_c,
            table(head, loops),
            "What comes before the loop:",
            table(
                ["body", "us a sample", "over the loop"],
                [[name, f"{median(own):.3f}", spread(own, loop)] for name, own in before.items()],
            ),
            "One live sample, `LiveStep.run`: two events in, paired, admitted, predicted, learned, and the event "
            "arrays filled by Python. Batch is `Estimator.run` over all samples, basis and theory included.",
            table(
                ["law, model", "live, us", "batch, us", "live less batch, us", "`Estimator.run` of one sample, us"],
                live,
            ),
        ]
    )


def peers(figures: Figures) -> str:
    rows = figures["rows"]
    lines = [
        [name, f"{median(one['us']):.2f}", spread(one["us"], rows[one["over"]]["us"])] for name, one in rows.items()
    ]
    versions = [f"{name} {version}" for name, version in figures["versions"].items()]
    missing = figures["missing"]
    return "\n\n".join(
        [
            "Plain numpy computes what the compiled Hammerstein lms does, with equal predictions. The filters of "
            "padasip and pyroomacoustics are linear in as many regressors as the parallel model has parameters: "
            "padasip is given them ready, pyroomacoustics takes them from its delay line (its lms is BlockLMS, block "
            "1); neither evaluates a basis, learns a product of parameters or knows how sure it is. "
            f"Installed: {', '.join(versions) or 'none'}."
            + (f" Not installed, and so left out: {', '.join(missing)}." if missing else ""),
            table(["what", "us a sample", "over the compiled estimator with its law"], lines),
        ]
    )


def sizes(figures: Figures) -> str:
    lines = []
    for axis in ("weights", "taps"):
        for law, one in figures[axis].items():
            row: list[object] = [law, axis, ", ".join(map(str, one["size"]))]
            for who in ("loop_us", "C_us"):
                cost = medians(one[who]) if who in one else []
                row += [listed(cost), f"{exponent(one['size'], cost):.2f}"] if cost else ["-", "-"]
            lines.append(row)
    return "\n\n".join(
        [
            "Hammerstein. Exponents are the slope of log cost over log size (least squares) in the upper half.",
            table(["law", "over", "sizes", "loop, us", "exponent", "C, us", "exponent"], lines),
        ]
    )


def reading(figures: Figures) -> str:
    ways = ["here", "rosbags", "mcap-ros2-support", "opened"]
    lines = []
    for storage, found in figures["storages"].items():
        costs = [f"{median(found[way]):.3f}" if way in found else "-" for way in ways]
        over = [spread(found[way], found["here"]) if way in found else "-" for way in ways[1:3]]
        lines.append([storage, *costs, *over, f"{bounds.READING[storage]:g}"])
    missing = figures["missing"]
    head = ["storage", "here", "rosbags' loop", "mcap-ros2-support", "opening alone, rosbags"]
    return "\n\n".join(
        [
            f"{figures['pairs']} pairs of velocity and friction into arrays, us a pair; all arrays equal to the bit. "
            "Opening a file is part of every way; rosbags counts the messages of a .db3 file when it opens it, and "
            "mcap-ros2-support reads mcap only."
            + (f" Not installed, and so left out: {', '.join(missing)}." if missing else ""),
            table([*head, "rosbags over here", "mcap-ros2-support over here", "rosbags at least"], lines),
        ]
    )


SPEEDS = [
    "what", "s", "s by the clock", "start by the clock, s", "samples/s by the clock, without start", "share",
    "share by the clock", "share with the start", "the same by the clock",
]  # fmt: skip


def long(figures: Figures) -> str:
    loops, once, samples = figures["loops"], figures["once"], figures["samples"]
    speeds = []
    for law in ("rls", "lms"):
        bare, own = loops[f"bare loop, {law}"], f"replay, {law}"
        whole, start = loops[own], loops[f"start of {own}"]
        took = median(difference(whole["clock"], start["clock"]))
        shares = [(kind, with_start) for with_start in (False, True) for kind in ("cpu", "clock")]
        speeds += [
            [
                f"bare loop, {law}",
                *(f"{median(bare[kind]):.1f}" for kind in ("cpu", "clock")),
                "-",
                f"{samples / median(bare['clock']):.3g}",
                *("1" for _ in shares),
            ],
            [
                own,
                *(f"{median(whole[kind]):.1f}" for kind in ("cpu", "clock")),
                f"{median(start['clock']):.2f}",
                f"{samples / took:.3g}",
                *(f"{share(loops, law, kind, with_start):.2f}" for kind, with_start in shares),
            ],
        ]
    verbs = []
    for name, own in ((loops, ("replay, rls", "replay, lms")), (once, [n for n in once if "start of" not in n])):
        for verb in own:
            cost, start = name[verb], name[f"start of {verb}"]
            peak, bare = max(cost["memory"]), max(start["memory"])
            figures_of = (median(cost["cpu"]), median(cost["clock"]), bare, peak)
            per_sample = f"{1e6 * (peak - bare) / samples:.0f}"
            verbs.append([f"`{verb}`", *(f"{figure:.1f}" for figure in figures_of), per_sample])
    grown, count = figures["growth"], figures["growth"]["samples"]
    lines = []
    for name in ("replay, rls", "replay --out"):
        start, found = grown[name]["start"], grown[name]["sizes"]
        for what, unit, cost in (
            ("processor time", "s", [median(difference(one["cpu"], start["cpu"])) for one in found]),
            ("memory", "MB", [median(difference(one["memory"], start["memory"])) for one in found]),
        ):
            kept = [(size, value) for size, value in zip(count, cost, strict=True) if value > 0.0]
            slope = f"{exponent(*zip(*kept, strict=True)):.2f}" if len(kept) > 1 else "-"
            lines.append([f"`{name}`", f"{what}, {unit}", ", ".join(map(str, count)), listed(cost), slope])
    return "\n\n".join(
        [
            f"A recording of {samples} samples (mcap). Speed over that of the bare loop, which is `Estimator.run` over "
            "samples in memory. `replay` reads, and says what does not depend on the prediction, in a thread beside "
            "the one that learns. Start is what the verb takes for bags/demo.",
            table(SPEEDS, speeds),
            "Memory:",
            table(["verb", "s", "s by the clock", "memory of the start, MB", "memory, MB", "bytes a sample"], verbs),
            "Growth with samples, what the start takes subtracted:",
            table(["verb", "what", "samples", "cost", "exponent"], lines),
        ]
    )


def start_up(figures: Figures) -> str:
    commands = figures["commands"]
    reference = commands[bounds.REFERENCE]["cpu"]
    lines = [
        [
            f"`{name}`",
            f"{median(one['cpu']):.3f}",
            spread(one["cpu"], reference),
            f"{bounds.START_UP[name]:g}" if name in bounds.START_UP else "-",
            f"{max(one['memory']):.0f}",
        ]
        for name, one in commands.items()
    ]
    return table(["command", "s", "over the import of rosbags and numpy", "at most", "memory, MB"], lines)


def node_start(figures: Figures) -> str:
    processes = figures["processes"]
    bare = processes["bare rclpy node"]
    lines = [
        [
            name,
            *(
                text
                for kind in ("clock", "cpu")
                for text in (f"{median(one[kind]):.2f}", spread(one[kind], bare[kind]))
            ),
        ]
        for name, one in processes.items()
    ]
    return "\n\n".join(
        [
            f"From the start of a process to its first message, while pairs come at {figures['rate_hz']:g} Hz; "
            f"medians of {len(bare['clock'])} rounds, with warm caches, range and units given, and a feeder that "
            f"announces itself every 50 ms. At most {bounds.FIRST_MESSAGE:g} by the clock.",
            table(
                ["process", "s by the clock", "over the bare node", "processor time, s", "over the bare node"], lines
            ),
        ]
    )


def lost(one: Figures) -> int:
    return sum(one["sent"]) - sum(one["received"])


def node(figures: Figures) -> str:
    variants, keys = figures["variants"], ("cpu_us", "p50_us", "p99_us")
    own = variants["node"]
    lines = [
        [name, *(text for key in keys for text in (f"{median(one[key]):.0f}", spread(own[key], one[key]))), lost(one)]
        for name, one in variants.items()
    ]
    alone = figures["unconfigured"]
    head = ["variant"]
    for what in ("processor time a pair, us", "round trip p50, us", "p99, us"):
        head += [what, "node over it"]
    return "\n\n".join(
        [
            f"{figures['rate_hz']:g} Hz pairs, rounds of {figures['round_seconds']:g} s, medians (range) of "
            f"{len(own['cpu_us'])}, law rls, model parallel, reliable on both sides. Echo nodes have the node's "
            "subscriptions and publications and send back what comes, raw or decoded (typed), under rclpy's events "
            "executor or its stock one (single). The plot shows every round, and the medians in red.",
            table([*head, "lost"], lines),
            f"The node without configuration for {alone['seconds']:g} s (the load took {alone['took_s']:.1f} s): "
            f"{alone['received']} predictions of {alone['sent']} samples, in order: {said(alone['in_order'])}, "
            f"bit-equal to replay: {said(alone['equal'])}, exit code {alone['exit_code']}.",
        ]
    )


def said(true: bool) -> str:
    return "yes" if true else "no"


LATENCY = [
    "variant", "processor time a pair, us", "p50, us", "p99, us", "max, us", "processor time over echo",
    "p99 over echo", "lost",
]  # fmt: skip


def latency(figures: Figures) -> str:
    variants, keys = figures["variants"], ("cpu_us", "p50_us", "p99_us", "max_us")
    echo = variants["echo, typed"]
    lines = [
        [
            name,
            *(f"{median(one[key]):.0f}" for key in keys),
            *(spread(one[key], echo[key]) for key in ("cpu_us", "p99_us")),
            lost(one),
        ]
        for name, one in variants.items()
    ]
    costs = [
        [what, *(spread(variants[with_it][key], variants[without][key]) for key in keys[1:])]
        for what, (with_it, without) in figures["costs"].items()
    ]
    notes = [
        f"Refits took the range of the {name} from 0.15 to {one['reach']:.2f} m/s. Of {one['pairs']} pairs with refits "
        f"{one['near']} are near one; p99 of all {one['p99_us']:.0f} us, of those that are not "
        f"{one['rest_p99_us']:.0f} us, of those that are {one['near_p99_us']:.0f} us, "
        f"{100.0 * one['near_late']:.1f} % of them above the p99 of the others."
        for name, one in figures["refits"].items()
    ]
    return "\n\n".join(
        [
            f"Round trips of {figures['rate_hz']:g} Hz pairs, rounds of {figures['round_seconds']:g} s in turns, "
            f"medians of {len(echo['cpu_us'])} (the maximum too), law rls, model parallel, reliable on both sides.",
            table(LATENCY, lines),
            "What it costs the same node process, with over without:",
            table(["cost of", "p50", "p99", "max"], costs),
            *notes,
        ]
    )


def many(figures: Figures) -> str:
    lines, scaling = [], []
    for name, verb in figures["verbs"].items():
        counts, runs = verb["workers"], verb["processes"]
        one = runs[counts.index(1)]["clock"]
        rows = "equal" if verb["equal"] else "**they differ**"
        for count, cost in zip(counts, runs, strict=True):
            figures_of = f"{median(cost['clock']):.1f}", f"{median(cost['cpu']):.1f}"
            lines.append([f"`{name}`", f"{count} processes"[: None if count > 1 else -2], *figures_of])
            lines[-1] += [spread(one, cost["clock"]), rows]
        where = f"Dask, {figures['dask_workers']} workers"
        lines.append(
            [f"`{name}`", where, f"{median(verb['dask']['clock']):.1f}", "-", spread(one, verb["dask"]["clock"])]
        )
        lines[-1].append(rows)
        twice = verb["twice"]
        both = f"{median(twice['clock']):.1f}", f"{median(twice['cpu']):.1f}"
        gives = spread(one, [clock / 2.0 for clock in twice["clock"]])
        lines.append([f"`{name}`", "1 process, twice at once", *both, gives, rows])
        clocks = [median(cost["clock"]) for cost in runs]
        scaling.append([f"`{name}`", "workers", listed(counts), listed(clocks), f"{exponent(counts, clocks):.2f}"])
    recordings = figures["recordings"]
    clocks = [median(cost["clock"]) for cost in recordings["costs"]]
    slope = f"{exponent(recordings['size'], clocks):.2f}"
    scaling.append(["`diagnose --each`, one process", "recordings", listed(recordings["size"]), listed(clocks), slope])
    about = [f"`{name}` is of {verb['what']}" for name, verb in figures["verbs"].items()]
    return "\n\n".join(
        [
            f"{'; '.join(about)}. Times by the clock, start and the writing of the output included; the processor time "
            "of Dask's workers, which are there before, is not the verb's, and no cluster waits beside what is "
            "measured without it. Rows are those of rows.jsonl, compared as bytes. Twice at once is what the machine "
            "gives: two runs of one process each, started together, that share nothing else, and one process over half "
            "of their time.",
            table(["verb", "on", "s by the clock", "processor time, s", "one process over it", "rows"], lines),
            "Growth, by the clock:",
            table(["verb", "over", "sizes", "s", "exponent"], scaling),
        ]
    )


SECTIONS: dict[str, tuple[str, Callable[[Figures], str]]] = {
    "kernels": ("A sample beside C", kernels),
    "peers": ("A sample in Python", peers),
    "sizes": ("Weights and taps", sizes),
    "reading": ("Reading", reading),
    "long": ("Long recordings", long),
    "start_up": ("Start-up", start_up),
    "node_start": ("The node's start", node_start),
    "node": ("The node beside echo nodes", node),
    "latency": ("The node's latency", latency),
    "many": ("Many recordings, many settings", many),
}
"""Title and text by part, in order of the page; benchmarks/stale.py names the titles."""
