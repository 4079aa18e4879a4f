"""What diagnostics say of one estimate: its level, its words and its figures."""

from collections.abc import Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus

from friction_estimator.core.fit.band import Curve
from friction_estimator.core.model.theory_choice import told as theory_told
from friction_estimator.core.model.theory_choice import warning as theory_warning
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.quantities import Quantities
from friction_estimator.ros.estimated_joint import STILL_NEEDED, EstimatedJoint
from friction_estimator.ros.growth import Growth
from friction_estimator.ros.load import Account
from friction_estimator.ros.silence import REPEAT_S
from friction_estimator.ros.state_keeper import FAILURE

FASTER = "use a smaller basis (basis.*, fir.order), a cheaper model.law, or fewer samples a second"

FULL_SHARE = 0.8
"""Share of the time beyond which the node is nearly too slow: any other load would make samples late or lost."""

LEARNED_SHARE = 0.5
"""Share of the prior variance that the data must have removed where the curve counts as learned."""


class EstimatorStatus:
    """Looks at one joint, once a second, and says how it is and what has happened since the last look.

    Parameters
    ----------
    joint : to look at.

    Attributes
    ----------
    name : of the status: one of several joints goes by its own name.
    """

    def __init__(self, joint: EstimatedJoint) -> None:
        self._joint = joint
        self.name = joint.feed.joint if joint.plain else "estimator"
        self._growth = Growth()
        self._refused: dict[str, int] = {}

    def look(
        self,
        span_s: float,
        account: Account,
        notes: Mapping[str, str],
    ) -> tuple[bytes, str, dict[str, Any]]:
        """Return level, words and values.

        Parameters
        ----------
        span_s : time since the last look.
        account : of the time that the node used.
        notes : the node's own, beside the joint's.
        """
        stream, quantities = self._joint.stream, self._joint.quantities
        samples = self._growth.of("samples", stream.counts.get("used", 0))
        level, words = DiagnosticStatus.OK, "learning" if stream.learn else "predicting, not learning"
        values: dict[str, Any] = {"samples per second": f"{samples / span_s:.1f}", "predictions": stream.predictions}
        values["subscribers of the prediction"] = self._joint.outputs.subscribers
        values["samples lost"] = stream.lost
        values["samples waiting"] = stream.held_back
        values["samples dropped while waiting"] = stream.dropped
        values["samples dropped, too slow"] = stream.overrun
        predicted = self._growth.of("predicted", stream.predictions)
        # Where samples wait, what they need is still to come; on a busy machine they wait although it is little.
        share = account.busy + (max(0, samples - predicted) * stream.sample_s / span_s if stream.working_off else 0.0)
        values["share of the sample period used (%)"] = f"{100.0 * share:.1f}"
        values["arrival to prediction p50 (ms)"] = f"{account.p50_ms:.3f}"
        values["arrival to prediction p99 (ms)"] = f"{account.p99_ms:.3f}"
        values["arrival to prediction max (ms)"] = f"{account.longest_ms:.3f}"
        if stream.estimator is not None:
            health = stream.estimator.health
            values |= _account(stream.estimator, self._joint.curve, quantities, stream.has_pressure)
            if stream.predictions:
                values[f"velocity seen ({quantities.velocity})"] = _interval(stream.velocity_seen)
            if health.held:
                level = DiagnosticStatus.WARN
                words = f"learning held since {health.held} samples: bad data, or friction has changed"
            outside, grown = self._growth.of("outside", health.outside), self._growth.of("grown", health.grown)
            if grown:
                self._joint.log.info(
                    f"speeds beyond the range: it is {_reach(stream.estimator)} {quantities.velocity} now"
                )
            elif outside:
                level = DiagnosticStatus.WARN
                words = f"velocity outside {_reach(stream.estimator)} {quantities.velocity}: nothing is learned there"
            if self._growth.of("guarded", health.guarded):
                level, words = DiagnosticStatus.WARN, "the divergence guard held a step back"
            if warning := theory_warning(stream.estimator.config, stream.has_pressure):
                level, words = DiagnosticStatus.WARN, warning
            if stream.working_off:
                level, words = DiagnosticStatus.WARN, f"catching up: {stream.held_back} samples wait for their turn"
        if level == DiagnosticStatus.OK and share > FULL_SHARE:
            level = DiagnosticStatus.WARN
            words = f"nearly too slow: {100.0 * share:.0f} % of the sample period is used; {FASTER}"
        if self._joint.plain:
            values |= self._taken()
            if new := {reason: n for reason, n in self._refused.items() if n}:
                level, words = self._told_of(new, samples) or (level, words)
            if not self._joint.enabled:
                level, words = DiagnosticStatus.OK, f"disabled by {self._joint.prefix}enable"
        file = self._joint.keeper.report()
        values |= file
        if FAILURE in file and level == DiagnosticStatus.OK:
            level, words = DiagnosticStatus.WARN, f"{FAILURE}: {file[FAILURE]}"
        for key, note in {**notes, **self._joint.notes}.items():
            values[key] = note
            if level == DiagnosticStatus.OK:
                level, words = DiagnosticStatus.WARN, f"{key}: {note}"
        if overrun := self._growth.of("overrun", stream.overrun):
            level = DiagnosticStatus.ERROR
            words = f"too slow: {overrun} samples dropped since the last look, {stream.overrun} in all; {FASTER}"
        if stream.meeting:
            level = DiagnosticStatus.WARN if stream.held_back else DiagnosticStatus.OK
            words = f"first contact: {stream.held_back} samples wait, {STILL_NEEDED}"
        elif stream.estimator is None:
            level, words = DiagnosticStatus.ERROR, self._joint.notes.get("configuration", "no estimator")
        return level, words, values

    def _told_of(self, refused: Mapping[str, int], samples: int) -> tuple[bytes, str] | None:
        """Return level and words about what was refused of one of several joints, and log it where nothing came.

        A message without the joint is no fault as long as others hold it: a machine may publish its joints in parts.
        """
        absent = {"wrong_joint", "empty"} & set(refused)
        if absent and samples and len(absent) == len(refused):
            return None
        told = ", ".join(f"{count} {reason}" for reason, count in refused.items())
        words = f"rejected in the last second: {told}" + (f" ({self._joint.feed.absence})" if absent else "")
        if not samples:
            self._joint.log.warning(words, throttle_duration_sec=REPEAT_S)
        return DiagnosticStatus.WARN, words

    def _taken(self) -> dict[str, Any]:
        """Return what one of several joints has taken of the messages that all share, and note what was new in it."""
        counts = self._joint.stream.counts
        counts.pop("used", None)
        gaps, jumps = counts.pop("gaps"), counts.pop("jumps")
        counts |= self._joint.feed.rejected
        self._refused = {reason: self._growth.of(f"rejected {reason}", count) for reason, count in counts.items()}
        values: dict[str, Any] = {f"rejected: {reason}": count for reason, count in sorted(counts.items())}
        pairer = self._joint.stream.intake.pairer
        if pairer.tracks and pairer.tracker.told:
            values["velocity"] = f"from the position: {pairer.tracker.words(self._joint.quantities.position)}"
        return values | {"gaps": gaps, "clock jumps back": jumps}


def _account(estimator: Estimator, curve: Curve | None, quantities: Quantities, pressure: bool) -> dict[str, Any]:
    """Return what the estimator says about itself."""
    health, config = estimator.health, estimator.config
    given, unit = config.basis.velocity_range, config.force_unit
    values = {
        "model": config.structure,
        "theory": theory_told(config, pressure),
        "law": config.model.law,
        f"running error rms ({quantities.force})": f"{health.error_rms_N:.6g}",
        "learned from": health.learned,
        "divergence guard": health.guarded,
        "outliers clipped": health.clipped,
        "alarms: learning held": health.alarmed,
        "alarms: the former model went on": health.restored,
        "learning held since (samples)": health.held,
        "outside velocity range": health.outside,
        "at standstill, not learned from": health.stood,
        f"velocity range ({quantities.velocity})": _reach(estimator),
        "velocity range is": "configured" if given else "learned: chosen at first contact, it grows",
        "velocity range grown (times)": health.grown,
        f"force unit ({quantities.force})": f"{config.unit_N:g}",
        "force unit is": "configured" if unit else "learned: chosen at first contact",
    }
    values |= {f"load: {load.term}": load.text(quantities) for load in estimator.loads}
    if estimator.model.load.needs("acceleration"):
        values["predicted late by (s)"] = config.load.half_width
    return values | _learned_part(curve, quantities)


def _learned_part(curve: Curve | None, quantities: Quantities) -> dict[str, Any]:
    """Return which part of the velocity range the data have decided on."""
    key = "learned part of the velocity range"
    if curve is None:
        return {key: "not known yet"}
    if curve.learned_share is None:
        return {key: "not known: this law keeps no covariance"}
    known = curve.learned_share > LEARNED_SHARE
    if not known.any():
        return {key: "0 %"}
    where = curve.velocity_m_s[known]
    extent = {f"learned velocities ({quantities.velocity})": _interval((where[0], where[-1]))}
    return {key: f"{100.0 * known.mean():.0f} %"} | extent


def _reach(estimator: Estimator) -> str:
    return _interval(estimator.model.basis.reach)


def _interval(ends: tuple[float, float]) -> str:
    return str([float(f"{end:.6g}") for end in ends])
