"""Read a recording for a verb: options, configuration, samples, and what must be said about them."""

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from friction_estimator.bag.read import Recording, read_recording
from friction_estimator.bag.samples import Admitted, to_samples
from friction_estimator.cli import common
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import PARAMETERS, Config
from friction_estimator.core.settings.derive import with_recorded_units


@dataclass(frozen=True)
class Loaded:
    """A recording, its admitted samples and the configuration with units filled in."""

    recording: Recording
    admitted: Admitted
    config: Config

    @property
    def samples(self) -> Samples:
        """The usable samples."""
        return self.admitted.samples

    def counts(self) -> dict[str, Any]:
        """Return `samples` of the JSON: read, used and rejected by reason."""
        return {"read": self.admitted.read, "used": len(self.samples), "rejected": dict(self.admitted.rejected)}


def add_run_options(parser: argparse.ArgumentParser) -> None:
    """Add the recording, `--model`, `--law`, `--freeze-after`, `--out` and the options of reading and of JSON."""
    parser.add_argument("bag", help="recording: ROS 2 folder, .mcap or .db3 file, or ROS 1 .bag")
    parser.add_argument("--model", choices=PARAMETERS["model.type"].choices, help="model structure (default: parallel)")
    parser.add_argument("--law", choices=PARAMETERS["model.law"].choices, help="adaptation law (default: rls)")
    parser.add_argument(
        "--freeze-after",
        type=float,
        metavar="FRACTION",
        help="learn from this first fraction of the samples only, and score the rest without learning",
    )
    parser.add_argument("--out", metavar="DIR", help="write bag/, figures/, report.html, summary.json, config.yaml")
    common.add_bag_options(parser)
    common.add_json_option(parser)


def load(args: argparse.Namespace, output: common.Output, overrides: Mapping[str, object] | None = None) -> Loaded:
    """Read `args.bag`, pair and admit its messages, derive units; say what was derived and what was refused.

    Raises InputError and UnanswerableError as reading does.
    """
    config = common.config_from(args, overrides)
    with common.progress("reading", unit="messages") as advance:
        recording = read_recording(args.bag, config.input, common.topics_from(args), advance)
    admitted = to_samples(recording, config)
    config = config.updated(_live_input(recording))
    units = with_recorded_units(config, admitted.samples.velocity_m_s, admitted.samples.friction_N)
    for name, stream in recording.streams.items():
        joint = f", joint {stream.joint}" if stream.joint else ""
        output.say(
            f"{name:<12}{stream.topic} ({stream.message_type.replace('/msg/', '/')}{joint}), {len(stream)} messages"
        )
    for note in recording.notes:
        output.say(f"note: {note}")
    refused = ", ".join(f"{count} {reason}" for reason, count in admitted.rejected.items())
    output.say(
        f"{'samples':<12}{len(admitted.samples)} used of {admitted.read}"
        + (f", refused: {refused}" if refused else "")
        + (f"; {admitted.gaps} gaps" if admitted.gaps else "")
        + (f"; {admitted.jumps} backward jumps of the clock" if admitted.jumps else "")
    )
    for name in ("basis.velocity_range", "force_unit"):
        value, given = PARAMETERS[name].of(units), PARAMETERS[name].of(config)
        if value != given:
            shown = f"[{value[0]:.5g}, {value[1]:.5g}]" if isinstance(value, tuple) else f"{value:.5g}"
            output.say(f"{'derived':<12}{name} = {shown} {PARAMETERS[name].unit}")
    return Loaded(recording, admitted, units)


def _live_input(recording: Recording) -> dict[str, object]:
    """Return the settings by which the live node takes the same inputs; config.yaml is written for it."""
    velocity, friction = recording.streams["velocity"], recording.streams["friction"]
    if velocity.topic == friction.topic and velocity.joint:
        return {"input.mode": "joint_state", "input.joint": velocity.joint}
    if velocity.message_type == friction.message_type == "std_msgs/msg/Float64":
        return {"input.mode": "float64"}
    return {}
