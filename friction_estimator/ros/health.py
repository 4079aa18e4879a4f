"""The node's account of itself, once a second on /diagnostics."""

import time
from collections.abc import Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from friction_estimator.core.errors import sentence
from friction_estimator.core.fit.band import Curve
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.sample import NS_PER_S
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.units import MOTION_S, REVERSALS
from friction_estimator.core.text import LONGEST_NAME, shown
from friction_estimator.ros.load import Account, Load
from friction_estimator.ros.silence import Finding, Findings, explain, stamp_offset_s
from friction_estimator.ros.sources import Source
from friction_estimator.ros.state_keeper import FAILURE
from friction_estimator.ros.stream import SampleStream

FASTER = "use a smaller basis (basis.*, fir.order), a cheaper model.law, or fewer samples a second"

GRACE_S = 2.0
"""Discovery takes a moment: nothing is called silent before."""

STILL_NEEDED = f"still needed: {REVERSALS} reversals or {MOTION_S:g} s of motion"
"""What ends the first contact."""

LATE_S = 0.25
"""A look that comes later than this after its second means that the node stood still: messages may have been lost."""

STOOD_STILL_LOOKS = 2
"""Looks for which that is believed: the messages after it may be looked at in the next one."""

FULL_SHARE = 0.8
"""Share of the time beyond which the node is nearly too slow: any other load would make samples late or lost."""

LEARNED_SHARE = 0.5
"""Share of the prior variance that the data must have removed where the curve counts as learned."""


class Health:
    """Collects counters, explains silence, writes diagnostics.

    Parameters
    ----------
    node : owner of the publisher and the log.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self.load = Load()
        self._stood_still = 0
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._findings = Findings(node)
        self._last = time.monotonic()
        self._since = self._last
        self._counts: dict[str, int] = {}
        self.exceptions = 0
        self.last_exception = ""
        self.notes: dict[str, str] = {}
        """Lasting facts worth a warning level, such as start-up values that were refused."""

    def exception(self, where: str, error: BaseException) -> None:
        """Count and report an exception that a callback met."""
        self.exceptions += 1
        self.last_exception = f"{where}: {sentence(error)}"
        self._node.get_logger().error(self.last_exception, throttle_duration_sec=5.0)

    def inputs_changed(self) -> None:
        """Start a new grace period (other topics, estimator enabled again)."""
        self._since = time.monotonic()
        self._counts = {}

    def tick(
        self,
        config: Config,
        sources: Mapping[str, Source],
        stream: SampleStream,
        enabled: bool,
        curve: Curve | None,
        extra: dict[str, Any],
    ) -> None:
        """Publish diagnostics and log what is newly wrong.

        Parameters
        ----------
        curve : the present static curve, at any velocities over its range.
        extra : further values of the estimator's status.
        """
        now = time.monotonic()
        span = max(now - self._last, 1e-3)
        self._last = now
        self._stood_still = STOOD_STILL_LOOKS if span > 1.0 + LATE_S else max(0, self._stood_still - 1)
        stream.flush()
        account = self.load.look()
        for source in sources.values():
            source.count_missing(pauses=not self._stood_still)
        counts = stream.counts
        used, gaps, jumps = (counts.pop(key, 0) for key in ("used", "gaps", "jumps"))
        for source in sources.values():
            for reason, count in source.rejected.items():
                counts[reason] = counts.get(reason, 0) + count
        arrived = {name: self._grown(f"messages of {name}", s.messages) for name, s in sources.items()}
        rejects = {reason: self._grown(f"rejected {reason}", count) for reason, count in counts.items()}
        samples = self._grown("used", used)
        findings: list[Finding] = []
        if enabled and now - self._since > GRACE_S:
            findings = list(explain(self._node, config, sources, arrived, rejects, samples))
            findings += self._clock_findings()
        ages = {name: source.looked_at() for name, source in sources.items()}
        self._findings.update(findings)

        rates = {name: count / span for name, count in arrived.items()}
        inputs = self._input_values(sources, rates, ages)
        inputs |= {f"rejected: {reason}": count for reason, count in sorted(counts.items())}
        inputs |= {"gaps": gaps, "clock jumps back": jumps}
        inputs |= {"waiting velocity, friction": f"{stream.intake.pairer.waiting}"}
        if "velocity" in sources and "friction" in sources:
            offset = stamp_offset_s(sources["velocity"], sources["friction"])
            inputs["stamp offset of friction from velocity (s)"] = f"{offset:.9f}"
        if config.input.mode == "float64":
            self.notes["float64"] = "messages without stamps: paired by time of receipt"
            inputs["stamps"] = "missing: paired by time of receipt, no bit equality with replay"
        if config.input.mode == "joint_state":
            inputs["friction"] = "joint effort as a whole: inertia and gravity included"
        for index, finding in enumerate(findings):
            inputs[f"finding {index + 1}"] = finding.text
        new_rejects = {reason: count for reason, count in rejects.items() if count}
        if findings:
            first = next((finding for finding in findings if finding.grave), findings[0])
            level, words = DiagnosticStatus.ERROR if first.grave else DiagnosticStatus.WARN, first.text
        elif not enabled:
            level, words = DiagnosticStatus.OK, "disabled by ~/enable"
        elif new_rejects:
            told = ", ".join(f"{count} {reason}" for reason, count in new_rejects.items())
            level, words = DiagnosticStatus.WARN, f"rejected in the last second: {told}"
        else:
            level, words = DiagnosticStatus.OK, f"{samples / span:.0f} samples/s"
        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.status = [
            self._status("inputs", level, words, inputs),
            self._estimator_status(stream, samples, span, account, curve, extra),
        ]
        self._publisher.publish(message)

    def _estimator_status(
        self,
        stream: SampleStream,
        samples: int,
        span_s: float,
        account: Account,
        curve: Curve | None,
        extra: dict[str, Any],
    ) -> DiagnosticStatus:
        level, words = DiagnosticStatus.OK, "learning" if stream.learn else "predicting, not learning"
        values: dict[str, Any] = {"samples per second": f"{samples / span_s:.1f}", "predictions": stream.predictions}
        values["samples lost"] = stream.lost
        values["samples waiting"] = stream.held_back
        values["samples dropped while waiting"] = stream.dropped
        values["samples dropped, too slow"] = stream.overrun
        predicted = self._grown("predicted", stream.predictions)
        # Where samples wait, what is used is all there is, and what would be needed is more.
        share = account.busy * (max(1.0, samples / max(predicted, 1)) if stream.working_off else 1.0)
        values["share of the sample period used (%)"] = f"{100.0 * share:.1f}"
        values["arrival to prediction p50 (ms)"] = f"{account.p50_ms:.3f}"
        values["arrival to prediction p99 (ms)"] = f"{account.p99_ms:.3f}"
        values["arrival to prediction max (ms)"] = f"{account.longest_ms:.3f}"
        values["exceptions"] = self.exceptions
        if self.last_exception:
            values["last exception"] = self.last_exception
        if stream.estimator is not None:
            health = stream.estimator.health
            values |= _account(stream.estimator, curve)
            if stream.predictions:
                values["velocity seen (m/s)"] = _interval(stream.velocity_seen)
            if health.held:
                level = DiagnosticStatus.WARN
                words = f"learning held since {health.held} samples: bad data, or friction has changed"
            outside, grown = self._grown("outside", health.outside), self._grown("grown", health.grown)
            if grown:
                self._node.get_logger().info(f"speeds beyond the range: it is {_reach(stream.estimator)} m/s now")
            elif outside:
                level = DiagnosticStatus.WARN
                words = f"velocity outside {_reach(stream.estimator)} m/s: nothing is learned there"
            if self._grown("guarded", health.guarded):
                level, words = DiagnosticStatus.WARN, "the divergence guard held a step back"
            if stream.working_off:
                level, words = DiagnosticStatus.WARN, f"catching up: {stream.held_back} samples wait for their turn"
        if level == DiagnosticStatus.OK and share > FULL_SHARE:
            level = DiagnosticStatus.WARN
            words = f"nearly too slow: {100.0 * share:.0f} % of the sample period is used; {FASTER}"
        values |= extra
        if FAILURE in extra and level == DiagnosticStatus.OK:
            level, words = DiagnosticStatus.WARN, f"{FAILURE}: {extra[FAILURE]}"
        for key, note in self.notes.items():
            values[key] = note
            if level == DiagnosticStatus.OK:
                level, words = DiagnosticStatus.WARN, f"{key}: {note}"
        if overrun := self._grown("overrun", stream.overrun):
            level = DiagnosticStatus.ERROR
            words = f"too slow: {overrun} samples dropped since the last look, {stream.overrun} in all; {FASTER}"
        if self._grown("exceptions", self.exceptions):
            level, words = DiagnosticStatus.ERROR, self.last_exception
        if stream.meeting:
            level = DiagnosticStatus.WARN if stream.held_back else DiagnosticStatus.OK
            words = f"first contact: {stream.held_back} samples wait, {STILL_NEEDED}"
        elif stream.estimator is None:
            level, words = DiagnosticStatus.ERROR, self.notes.get("configuration", "no estimator")
        return self._status("estimator", level, words, values)

    def _grown(self, key: str, count: int) -> int:
        """Return by how much a counter grew since the last look (0 at the first one)."""
        growth = count - self._counts.get(key, 0)
        self._counts[key] = count
        return max(0, growth)

    def _input_values(
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

    def _status(self, part: str, level: bytes, words: str, values: Mapping[str, Any]) -> DiagnosticStatus:
        name = self._node.get_fully_qualified_name()
        return DiagnosticStatus(
            name=f"{name}: {part}",
            hardware_id=name,
            level=level,
            message=shown(words),
            values=[KeyValue(key=shown(key, LONGEST_NAME), value=shown(value)) for key, value in values.items()],
        )


def _account(estimator: Estimator, curve: Curve | None) -> dict[str, Any]:
    """Return what the estimator says about itself."""
    health, config = estimator.health, estimator.config
    given, unit = config.basis.velocity_range, config.force_unit
    values = {
        "model": config.model.type,
        "law": config.model.law,
        "running error rms (N)": f"{health.error_rms_N:.6g}",
        "learned from": health.learned,
        "divergence guard": health.guarded,
        "outliers clipped": health.clipped,
        "alarms: learning held": health.alarmed,
        "alarms: the former model went on": health.restored,
        "learning held since (samples)": health.held,
        "outside velocity range": health.outside,
        "at standstill, not learned from": health.stood,
        "velocity range (m/s)": _reach(estimator),
        "velocity range is": "configured" if given else "learned: chosen at first contact, it grows",
        "velocity range grown (times)": health.grown,
        "force unit (N)": f"{config.unit_N:g}",
        "force unit is": "configured" if unit else "learned: chosen at first contact",
    }
    return values | _learned_part(curve)


def _learned_part(curve: Curve | None) -> dict[str, Any]:
    """Return which part of the velocity range the data have decided on."""
    key = "learned part of the velocity range"
    if curve is None or curve.learned_share is None:
        return {key: "not known: this law keeps no covariance"}
    known = curve.learned_share > LEARNED_SHARE
    if not known.any():
        return {key: "0 %"}
    where = curve.velocity_m_s[known]
    return {key: f"{100.0 * known.mean():.0f} %", "learned velocities (m/s)": _interval((where[0], where[-1]))}


def _reach(estimator: Estimator) -> str:
    return _interval(estimator.model.basis.reach)


def _interval(ends: tuple[float, float]) -> str:
    return str([float(f"{end:.6g}") for end in ends])
