"""What diagnostics say of the inputs: their level, their words and their figures."""

import time
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node

from friction_estimator.core.sample import NS_PER_S
from friction_estimator.core.settings.config import Config
from friction_estimator.ros.growth import Growth
from friction_estimator.ros.inputs import Inputs
from friction_estimator.ros.silence import Finding, Findings, explain, motion_findings, stamp_offset_s
from friction_estimator.ros.source import Source
from friction_estimator.ros.stream import SampleStream

GRACE_S = 2.0
"""Discovery takes a moment: nothing is called silent before."""

LATE_S = 0.25
"""A look that comes later than this after its second means that the node stood still: messages may have been lost."""

STOOD_STILL_LOOKS = 2
"""Looks for which that is believed: the messages after it may be looked at in the next one."""


class InputStatus:
    """Looks at the inputs once a second, explains their silence and logs what is newly wrong.

    Parameters
    ----------
    node : owner of the log and the clock.

    Attributes
    ----------
    samples : admitted between the last two looks.
    """

    def __init__(self, node: Node) -> None:
        self._told_of_tracking = False
        self._node = node
        self.samples = 0
        self._stood_still = 0
        self._findings = Findings(node)
        self._since = time.monotonic()
        self._growth = Growth()

    def changed(self) -> None:
        """Start a new grace period (other topics, estimator enabled again)."""
        self._since = time.monotonic()

    def look(
        self,
        config: Config,
        inputs: Inputs,
        streams: Sequence[SampleStream],
        enabled: bool,
        span_s: float,
    ) -> tuple[bytes, str, dict[str, Any]]:
        """Return level, words and values; the last look was `span_s` ago.

        Of several streams the counts are summed: what is wrong with one joint of a message stands in its own status.
        """
        sources = inputs.sources
        self._stood_still = STOOD_STILL_LOOKS if span_s > 1.0 + LATE_S else max(0, self._stood_still - 1)
        for stream in streams:
            stream.flush()
        for source in sources.values():
            source.count_missing(pauses=not self._stood_still)
        counts = dict(sum((Counter(stream.counts) for stream in streams), Counter()))
        used, gaps, jumps = (counts.pop(key, 0) for key in ("used", "gaps", "jumps"))
        for source in sources.values():
            for reason, count in source.rejected.items():
                counts[reason] = counts.get(reason, 0) + count
        arrived = {name: self._growth.of(f"messages of {name}", s.messages) for name, s in sources.items()}
        rejects = {reason: self._growth.of(f"rejected {reason}", count) for reason, count in counts.items()}
        self.samples = self._growth.of("used", used)
        findings: list[Finding] = []
        if enabled and time.monotonic() - self._since > GRACE_S:
            findings = list(explain(self._node, config, sources, arrived, rejects, self.samples))
            findings += self._clock_findings()
            findings += motion_findings(inputs)
        ages = {name: source.looked_at() for name, source in sources.items()}
        self._findings.update(findings)

        rates = {name: count / span_s for name, count in arrived.items()}
        values = self._values(sources, rates, ages)
        values["motion"] = f"{inputs.motion.known or 'not known'}: {inputs.motion.why}"
        values |= {f"rejected: {reason}": count for reason, count in sorted(counts.items())}
        values |= {"gaps": gaps, "clock jumps back": jumps}
        if len(streams) == 1:
            values |= {"waiting velocity, friction": f"{streams[0].intake.pairer.waiting}"}
        if "velocity" in sources and "friction" in sources:
            offset = stamp_offset_s(sources["velocity"], sources["friction"])
            values["stamp offset of friction from velocity (s)"] = f"{offset:.9f}"
        if config.input.mode == "float64":
            values["stamps"] = "missing: paired by time of receipt, no bit equality with replay"
        pairer = streams[0].intake.pairer
        if len(streams) == 1 and pairer.tracks and pairer.tracker.told:
            values["velocity"] = f"from the position: {pairer.tracker.words(config.quantities.position)}"
            if not self._told_of_tracking:
                self._told_of_tracking = True
                self._node.get_logger().info(f"velocity {values['velocity']}")
        if config.input.mode == "joint_state":
            terms = ", ".join(config.load.terms)
            beside = f"load.terms: {terms}" if terms else "inertia and gravity included (load.terms takes them off)"
            values["friction"] = f"joint effort as a whole: {beside}"
        for index, finding in enumerate(findings):
            values[f"finding {index + 1}"] = finding.text
        new_rejects = {reason: count for reason, count in rejects.items() if count}
        if findings:
            first = next((finding for finding in findings if finding.grave), findings[0])
            return DiagnosticStatus.ERROR if first.grave else DiagnosticStatus.WARN, first.text, values
        if not enabled:
            return DiagnosticStatus.OK, "disabled by ~/enable", values
        if new_rejects and len(streams) == 1:
            told = ", ".join(f"{count} {reason}" for reason, count in new_rejects.items())
            return DiagnosticStatus.WARN, f"rejected in the last second: {told}", values
        return DiagnosticStatus.OK, f"{self.samples / span_s:.0f} samples/s", values

    def _values(
        self, sources: Mapping[str, Source], rates: Mapping[str, float], ages: Mapping[str, float]
    ) -> dict[str, Any]:
        values: dict[str, Any] = {}
        now_ns = self._node.get_clock().now().nanoseconds
        for name, source in sources.items():
            if not (source.required or source.messages):
                continue
            values[f"{name}: topic"] = source.topic
            values[f"{name}: messages"] = source.messages
            values[f"{name}: rate (Hz)"] = f"{rates[name]:.1f}"
            values[f"{name}: messages missing"] = source.rhythm.missing
            values[f"{name}: publishers"] = source.publishers
            if source.messages:
                values[f"{name}: age by stamp (s)"] = f"{(now_ns - source.last_stamp_ns) / NS_PER_S:.3f}"
                values[f"{name}: age by arrival (s)"] = f"{ages[name]:.1f}"
        return values

    def _clock_findings(self) -> list[Finding]:
        if self._node.get_parameter("use_sim_time").value and not self._node.get_clock().now().nanoseconds:
            return [Finding("clock", "/clock: expected the simulation's time (use_sim_time is true), seen none")]
        return []
