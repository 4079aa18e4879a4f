"""`friction_estimator info`: what a recording holds, and what can and cannot be identified from it."""

import argparse
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from friction_estimator.cli import common, info_joints, joints
from friction_estimator.cli.progress import progress
from friction_estimator.cli.recorded import settled
from friction_estimator.core.errors import FrictionEstimatorError, InputError, UnanswerableError, about, sentence
from friction_estimator.core.quantities import FORCE, POSITION, VELOCITY, Quantities, quantity
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.groups import AUTO

if TYPE_CHECKING:
    from friction_estimator.bag.recording import Described, Recorded
    from friction_estimator.bag.samples import Admitted
    from friction_estimator.bag.source import Source, Topic
    from friction_estimator.bag.statistics import StreamStatistics
    from friction_estimator.core.settings.config import Config

SCHEMA = "friction_estimator/info/1"

UNITS = {"velocity": VELOCITY, "friction": FORCE, "pressure": "Pa", "temperature": "degC", "position": POSITION}
"""Unit of each input on a linear drive."""

LEAST_SPEED_RATIO = 3.0
"""Fastest over slowest usual speed of a direction, below which the curve between them and rest is not seen."""

MOST_ASSESSED = 500_000
"""Samples from which is said what can be identified: what a drive excites shows within them, and the features of
each take 450 bytes."""

COARSE = 1e-4
"""Share of the top speed above which a step of a quantised velocity is worth a line."""

LEAST_MISMATCH, MISMATCH_ERRORS = 0.02, 5.0
"""Relative difference of velocity and position's derivative that is worth a line, and its standard errors."""

_CHANNELS = {
    "pressure": "pressure_dependence, and the theoretical curve at the true pressure",
    "temperature": "the oil's viscosity: viscosity_drift is told from time only",
    "position": "position_dependence from a measured position; the integral of velocity stands in for it",
}


def add_parser(subparsers: common.Subparsers) -> None:
    """Add the verb's options."""
    parser = common.add_verb(
        subparsers,
        "info",
        "what a recording holds, and what can be identified from it",
        description="Say what a recording holds: topics, rates, gaps, stamps, ranges, samples that can be paired, and "
        "what can\nand cannot be identified from it. Exit code 1 where it holds no usable sample.",
        example="friction_estimator info bags/rig --json -",
    )
    parser.add_argument("bag", metavar="BAG", help="recording: ROS 2 folder, .mcap or .db3 file, or ROS 1 .bag")
    common.add_bag_options(parser)
    common.add_json_option(parser)


def run(args: argparse.Namespace) -> int:
    """Print what is known; the failure that ends the inspection comes last."""
    from friction_estimator.bag.source import Source  # noqa: PLC0415

    with common.Output(args.json, inputs=common.paths_read(args)) as output:
        config = common.config_from(args)
        with Source(args.bag) as source:
            return _run(args, config, source, output)


def _run(args: argparse.Namespace, config: "Config", source: "Source", output: common.Output) -> int:
    from friction_estimator.bag.joint_arrays import CHOOSE_JOINT  # noqa: PLC0415
    from friction_estimator.bag.joint_survey import survey  # noqa: PLC0415
    from friction_estimator.bag.samples import read_samples  # noqa: PLC0415 - `--help` needs none of them
    from friction_estimator.bag.statistics import read_described  # noqa: PLC0415

    if args.joint == joints.ALL:
        config = config.updated({"input.joint": ""})
    quantities = config.quantities
    motions: dict[str, str] = {}
    result: dict[str, Any] = {"schema": SCHEMA, "bag": args.bag, "topics": [], "inputs": {}, "problem": None}
    result["joint_states"] = []
    inputs: dict[str, list[str]] = {}
    recording: Recorded | None = None
    failure: FrictionEstimatorError | None = None
    said: dict[str, list[str]] = {}
    try:
        looking = progress("looking for joints", unit="messages")
        with about(args.bag), looking as advance:
            found = survey(source, progress=advance)
            motions = {name: _motion(source, config, name) for each in found for name in each.joints}
        with about(args.bag), progress("reading", unit="messages") as advance:
            chosen = common.topics_from(args)
            recording, figures = read_described(source, config.input, config.sync, chosen, advance)
        config = settled(config, [recording])
        quantities = common.quantities_from(args, config)
        result["motion"], result["units"] = recording.motion, quantities.names
        for name, stream in recording.streams.items():
            inputs.setdefault(stream.topic, []).append(name)
            result["inputs"][name] = _input(name, stream, figures[name], quantities)
            if stream.joint:  # a position of the drive moves as the drive does
                motions[stream.joint] = recording.motion
        result["notes"] = list(recording.notes)
    except FrictionEstimatorError as error:
        failure = error
        if isinstance(error, InputError) and str(error).endswith(CHOOSE_JOINT) and not config.input.joint:
            failure = None  # nothing is wrong: each joint is told of
            quantities = common.quantities_from(args, config.updated({"input.mode": "joint_state"}))
            result["notes"] = ["one joint at a time is assessed: --joint NAME; replay, identify and diagnose take all"]
    result["joint_states"] = [info_joints.facts(each, motions.__getitem__) for each in found]
    result["topics"] = [_topic(topic, inputs.get(topic.name, [])) for topic in source.topics]
    if recording is not None:
        try:
            with about(args.bag), progress("pairing", unit="messages") as advance:
                _, admitted = read_samples(source, config, chosen, advance)
                result["pairing"] = _pairing(admitted, quantities.si.position)
                whole, samples = len(admitted.samples), admitted.samples.beginning(MOST_ASSESSED)
                del admitted
                result["excitation"], can, cannot = _assess(samples, config)
                if result["excitation"] is not None and whole > len(samples):
                    told = f"the drive is described by the first {len(samples)} of {whole} samples"
                    result["excitation"]["notes"].insert(0, told)
                said = {"notes": (result["excitation"] or {}).get("notes", []), "can": can, "cannot": cannot}
                worded = {title: [quantities.si.worded(text) for text in texts] for title, texts in said.items()}
                if result["excitation"] is not None:
                    result["excitation"]["notes"] = worded.pop("notes")
                result |= {title: worded[title] for title in ("can", "cannot")}
        except UnanswerableError as error:
            failure = error
    result["problem"] = None if failure is None else sentence(failure)
    _tell(output, result, said, quantities)
    output.result(result)
    if failure is not None:
        raise failure
    return 0


def _topic(topic: "Topic", inputs: list[str]) -> dict[str, Any]:
    return {"name": topic.name, "type": topic.message_type, "messages": topic.count, "inputs": inputs}


def _motion(source: "Source", config: "Config", joint: str) -> str:
    """Return whether a joint of the recording is linear or rotary."""
    from friction_estimator.bag.motion import joint_motion  # noqa: PLC0415

    return joint_motion(source, joint)[0] if config.input.motion == AUTO else config.input.motion


def _input(name: str, stream: "Described", figures: "StreamStatistics", quantities: Quantities) -> dict[str, Any]:
    unit = quantities.si.unit(UNITS[name])
    facts = {"topic": stream.topic, "type": stream.message_type, "unit": unit, "stamped": stream.stamped}
    return facts | {"frame_id": stream.frame_id, "joint": stream.joint} | asdict(figures)


def _pairing(admitted: "Admitted", unit: str) -> dict[str, Any]:
    return {
        "read": admitted.read,
        "used": len(admitted.samples),
        "rejected": dict(admitted.rejected),
        "gaps": admitted.gaps,
        "clock_jumps": admitted.jumps,
        "position_wraps": admitted.wraps.count,
        "position_modulus": admitted.wraps.modulus_m or None,
        "velocity_from_position": None if admitted.tracker is None else admitted.tracker.words(unit),
        "sample_rate_hz": admitted.samples.sample_rate_hz,
        "duration_s": admitted.samples.duration_s,
    }


def _assess(samples: Samples, config: "Config") -> tuple[dict[str, Any] | None, list[str], list[str]]:
    """Return the facts about the drive, and what can and cannot be identified, for `Quantities.worded`."""
    from friction_estimator.bag.statistics import moving_speeds  # noqa: PLC0415
    from friction_estimator.core.intake.agreement import velocity_over_position_rate  # noqa: PLC0415
    from friction_estimator.diagnosis.excitation import assess  # noqa: PLC0415
    from friction_estimator.diagnosis.record import build_record  # noqa: PLC0415
    from friction_estimator.effects.scatter import lattice_step  # noqa: PLC0415

    can: list[str] = []
    cannot = [
        f"{what} (no {name} channel)" for name, what in _CHANNELS.items() if getattr(samples, _FIELDS[name]) is None
    ]
    try:
        record = build_record([samples], config)
    except UnanswerableError as error:
        return None, can, [str(error), *cannot]
    top_N = float(abs(samples.friction_N).max())
    context = record.context(config, top_N)
    found = assess(record, context)
    low, high = found.velocity_range
    cannot = [*found.warnings, *cannot]
    ranges = moving_speeds(samples.velocity_m_s)
    if len(ranges) < 2 and not any("one direction only" in warning for warning in found.warnings):
        cannot.insert(0, "friction in both directions: the shaft moves in one direction only")
    step = lattice_step(samples.velocity_m_s)
    if step > COARSE * max(abs(low), abs(high)):
        cannot.append(f"what happens below {quantity(step, VELOCITY, '.3g')}: velocity is quantised in such steps")
    ratio = velocity_over_position_rate(samples)
    if ratio is not None and abs(ratio[0] - 1.0) > max(LEAST_MISMATCH, MISMATCH_ERRORS * ratio[1]):
        cannot.append(f"speeds as they are: the velocity is {ratio[0]:.4g} times the derivative of the position")
    if ranges and all(far / near > LEAST_SPEED_RATIO for near, far in ranges):
        can.append(f"the friction curve F(v) from {quantity((low, high), VELOCITY)}")
    elif not any("curve F(v)" in warning for warning in found.warnings):
        told = " and ".join(quantity(ends, VELOCITY, ".3g") for ends in ranges)
        cannot.insert(
            0, f"the curve F(v): the shaft runs from {told} only; vary its speed by a factor of ten within a stroke"
        )
    if found.reversals:
        can.append(f"what follows a reversal: {found.reversals} of them were recorded")
    if not context.periods_s and found.reversals:
        cannot.append("errors by drive cycle: the drive is not periodic (tenths of the record stand in for cycles)")
    if not found.undecidable:
        can.append("a diagnosis (`friction_estimator diagnose`)")
    facts = {
        "velocity_range": [low, high],
        "reversals": found.reversals,
        "cycles": found.cycles,
        "drive_periods_s": list(context.periods_s),
        "stroke_m": context.stroke_m,
        "distance_m": context.distance_m,
        "standstill_share": float(record.standstill.mean()),
        "velocity_step": step or None,
        "velocity_over_position_rate": None if ratio is None else ratio[0],
        "notes": list(found.notes),
        "channels": list(found.channels),
    }
    return facts, can, cannot


_FIELDS = {"pressure": "pressure_Pa", "temperature": "temperature_degC", "position": "position_m"}


def _tell(output: common.Output, result: dict[str, Any], said: dict[str, list[str]], quantities: Quantities) -> None:
    output.say(str(result["bag"]))
    output.say("topics")
    for topic in result["topics"]:
        kind = topic["type"].replace("/msg/", "/") or "several types"
        use = f"  -> {', '.join(topic['inputs'])}" if topic["inputs"] else ""
        output.say(f"  {topic['name']}  {kind}  {topic['messages']}{use}")
    for name, facts in result["inputs"].items():
        output.say(name)
        for line in _input_lines(facts, UNITS[name], quantities):
            output.say(f"  {line}")
    for line in info_joints.lines(result["joint_states"], quantities.of):
        output.say(line)
    for note in result.get("notes", ()):
        output.say(f"note: {note}")
    pairing = result.get("pairing")
    if pairing is None:
        return
    refused = ", ".join(f"{count} {reason.replace('_', ' ')}" for reason, count in pairing["rejected"].items())
    output.say("samples")
    output.say(
        f"  {pairing['used']} used of {pairing['read']}, {pairing['sample_rate_hz']:.5g} Hz, "
        f"{pairing['duration_s']:.5g} s" + (f"; refused: {refused}" if refused else "")
    )
    if pairing["velocity_from_position"]:
        output.say(f"  velocity from the position: {pairing['velocity_from_position']}")
    output.say(f"  {pairing['gaps']} gaps, {pairing['clock_jumps']} backward jumps of the clock")
    facts = result.get("excitation")
    if facts:
        periods = ", ".join(f"{period:.4g} s" for period in facts["drive_periods_s"]) or "none: not periodic"
        output.say("drive")
        output.say(
            f"  {facts['reversals']} reversals, {facts['cycles']} cycles, stroke "
            f"{quantities.text(facts['stroke_m'], POSITION)}; "
            f"periods: {periods}"
        )
        for note in said["notes"]:
            output.say(f"  {quantities.worded(note)}")
    for title in ("can", "cannot"):
        if said.get(title):
            output.say(f"{title} be identified" if title == "can" else "cannot be identified, or not well")
            for text in said[title]:
                output.say(f"  {quantities.worded(text)}")


def _input_lines(facts: dict[str, Any], unit: str, quantities: Quantities) -> list[str]:
    joint = f", joint {facts['joint']}" if facts["joint"] else ""
    frame = f", frame {facts['frame_id']}" if facts["frame_id"] else ""
    lines = [
        f"{facts['topic']}{joint}{frame}: {facts['messages']} messages, {facts['rate_hz']:.5g} Hz "
        f"(jitter {facts['jitter_s'] * 1e3:.3g} ms), {facts['duration_s']:.5g} s",
        f"from {quantities.value(facts['lowest'], unit):.5g} to {quantities.text(facts['highest'], unit, '.5g')}",
    ]
    if facts["gaps"]:
        lines.append(f"{facts['gaps']} gaps, the longest {facts['longest_gap_s']:.4g} s")
    if not facts["stamped"]:
        lines.append("no header: the time of recording serves as stamp, so pairing with other topics is a guess")
    elif abs(facts["delay_s"]) > 1.0:
        lines.append(f"recorded {facts['delay_s']:.4g} s after its stamps: two clocks, or a copy of a recording")
    faults = ("missing", "zero_stamps", "duplicate_stamps", "backward_stamps", "clock_jumps", "nan", "infinite")
    found = [f"{facts[name]} {name.replace('_', ' ')}" for name in faults if facts[name]]
    return [*lines, ", ".join(found)] if found else lines
