"""One joint, shaft or slide whose friction the node estimates: everything that is the estimate's own."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from rclpy.node import Node

from friction_estimator.core.errors import ConfigError, FrictionEstimatorError, sentence
from friction_estimator.core.fit.band import Curve
from friction_estimator.core.model.structure import Parameters
from friction_estimator.core.model.theory_choice import told as theory_told
from friction_estimator.core.online.estimator import CHOSEN, Estimator, stated_config
from friction_estimator.core.quantities import FORCE, VELOCITY, Quantities
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import PARAMETERS, Config
from friction_estimator.core.settings.units import MOTION_S, REVERSALS
from friction_estimator.ros.background import Background
from friction_estimator.ros.build import build, supposed, without_learned
from friction_estimator.ros.inputs import Inputs
from friction_estimator.ros.load import Load
from friction_estimator.ros.log import SafeLogger
from friction_estimator.ros.outputs import Outputs
from friction_estimator.ros.source import Feed
from friction_estimator.ros.state_keeper import StateKeeper
from friction_estimator.ros.stream import SampleStream
from friction_estimator.ros.wire import NO_FRAME

LEARNED = tuple(name for name, item in PARAMETERS.items() if item.learned)
ARRAYS = tuple(name for name in LEARNED if name not in CHOSEN)
"""What is learned in range and units, which are the rest of the learned values."""

STILL_NEEDED = f"still needed: {REVERSALS} reversals or {MOTION_S:g} s of motion"
"""What ends the first contact."""

FEW_POINTS = 41
"""Velocities at which the learned part of the range is looked for where nobody asks for the whole curve."""

LONGEST_DRAWING_S = 1.0
"""Time that the curve is waited for at the end: thousands of weights must not keep the node from ending."""

SNAPSHOT_S, LONGEST_SNAPSHOT_S = 0.5, 5.0
"""Learned parameters that are read in quick succession are of one moment, so that a dump is consistent: with at most so
long between two questions, and for so long in all, since who asks ten times a second wants new values, too."""


class EstimatedJoint:
    """Samples in, predictions out, with what is learned between them: its stream, outputs and state file.

    The node around it owns inputs, services, timers and parameters, and calls. Nothing begins before `start`.

    Parameters
    ----------
    node : owner of publishers and log.
    config : all parameters, learned values among them.
    load : is told how long each sample took.
    on_backlog : called where samples begin to wait; `work_off` has to be called then, until nothing waits.
    on_error : takes an exception that the drawing of the curve met.
    plain : name of the joint among several, as topics, services and the log have it; empty for the only one.

    Attributes
    ----------
    feed : what it takes of the inputs.
    config : in force; the parameters, with the learned values that this joint was given.
    notes : lasting facts worth a warning level in diagnostics, by their key.
    quantities : what the drive's numbers are.
    enabled, adapts : whether it takes samples; whether it learns where `model.adapt` lets it.
    prefix : of its topics and services. log : of its words.
    """

    def __init__(
        self,
        node: Node,
        config: Config,
        load: Load,
        on_backlog: Callable[[], None],
        on_error: Callable[[str, Exception], None],
        plain: str = "",
    ) -> None:
        self.log = SafeLogger(f"{node.get_logger().name}.{plain}") if plain else node.get_logger()
        self.plain, self.prefix = plain, f"~/{plain}/" if plain else "~/"
        self.config, self._configured = config, config.learned
        self.notes: dict[str, str] = {}
        self.quantities = config.quantities
        self._snapshot: tuple[float, float, Config | None] = (0.0, 0.0, None)
        self._inputs: Inputs | None = None
        self.outputs = Outputs(node, config.input.axis, self.quantities.motion, self.prefix)
        for fault in self.outputs.faults:
            self.log.error(fault)
            self.notes["outputs"] = "; ".join(self.outputs.faults)
        self.keeper = StateKeeper(self.log)
        self._drawing = Background("curve", on_error)
        self._curve: Curve | None = None
        self._on_backlog = on_backlog
        self.stream = SampleStream(config, self._met, self._publish, load)
        self.stream.on_backlog = on_backlog
        self.feed = Feed(config.input.joint, self.stream.event, self.moves, lambda: self.config.input)
        self.enabled = self.adapts = True
        self.on_motion: Callable[[], None] = lambda: None
        """Called where one of several joints is known to be linear or rotary."""

    def move(self, motion: str) -> None:
        """Take that the drive is linear or rotary."""
        self.quantities = Quantities(motion)
        self.outputs.set_axis(self.config.input.axis, motion)

    def moves(self, motion: str, why: str) -> None:
        """Take that this one of several joints is linear or rotary, and say why."""
        self.move(motion)
        self.log.info(f"the joint is {motion}: {why}")
        self.on_motion()

    def connect(self, inputs: Inputs) -> None:
        """Be fed by these inputs from now on."""
        self._inputs = inputs
        self.stream.queue_depth = inputs.depth

    def enable(self, enabled: bool) -> str:
        """Take samples from now on, or pass them over; what was learned stays."""
        if enabled != self.enabled:
            self.enabled = enabled
            self.feed.deliver = self.stream.event if enabled else _pass_over
            self.stream.restart()
        return "enabled" if enabled else "disabled: its samples are passed over"

    def adapt(self, adapts: bool) -> str:
        """Learn as `model.adapt` says, or not at all."""
        self.adapts = adapts
        self._set_learning()
        if adapts and not self.stream.learn:
            return "as model.adapt says for all joints: not learning"
        return "learning" if adapts else "predicting with the present values, not learning"

    def _set_learning(self) -> None:
        self.stream.learn = self.config.model.adapt and self.adapts

    # --- the estimator -----------------------------------------------------------------------------------------

    def start(self) -> None:
        """Begin as the parameters and the state file say: warm, cold, or with the first contact.

        Where the configuration allows no estimator, say why and live on without.
        """
        self.keeper.configure(self.config.state)
        try:
            estimator = self._trial(self.config)
        except FrictionEstimatorError as error:
            self._unusable(sentence(error))
            self.stream.begin(None)
            return
        self._begin(estimator)
        if self.keeper.start():
            try:
                self.log.info(self.keeper.load(self._restored))
            except FrictionEstimatorError as error:
                self.keeper.refuse(error)

    def _begin(self, estimator: Estimator) -> None:
        """Begin with an estimator of the present configuration, or with the first contact that it asks for."""
        self._curve = None
        self.stream.begin(self.config, estimator if self.config.is_met else None)
        if self.stream.meeting:
            unset = ", ".join(self._open())
            self.log.info(
                f"first contact: {unset} come from the first samples; nothing is published before ({STILL_NEEDED})"
            )

    def _open(self) -> list[str]:
        """Return the names of what the first contact has to say."""
        config = self.config
        known = {
            "basis.velocity_range": config.reach is not None,
            "force_unit": config.unit_N > 0.0,
            "theory.kind": config.has_theory or not config.is_parallel,
        }
        return [name for name, value in known.items() if not value]

    def _trial(self, config: Config) -> Estimator:
        """Return an estimator of the parameters, with units of no meaning where they are open.

        The configuration is in force then, but for learned values that fit no estimator: they are forgotten. Raises
        FrictionEstimatorError where there can be none; nothing has changed then.
        """
        cold = without_learned(config)
        given = [name for name in ARRAYS if PARAMETERS[name].of(config)]
        reason = ""
        try:
            if given and not config.is_met:
                raise ConfigError(
                    f"{given[0]} is given without the range and units that it was learned in ({', '.join(CHOSEN)})"
                )
            estimator = build(supposed(config))
        except FrictionEstimatorError as error:
            if not given:
                raise
            reason = sentence(error)
            config, estimator = cold, build(supposed(cold))
        for note in ("configuration", "started cold", "reset"):
            self.notes.pop(note, None)
        if reason:
            self.log.error(f"starting cold: {reason}")
            self.notes["started cold"] = reason
        self.config = config
        return estimator

    def _unusable(self, reason: str) -> None:
        self.log.error(f"not estimating: {reason}; correct it and call {self.prefix}reset")
        self.notes["configuration"] = f"not estimating: {reason}"

    def _met(self, config: Config) -> Estimator:
        """Build the estimator that the first contact asks for, and say what it chose."""
        try:
            estimator = build(config)
        except FrictionEstimatorError as error:
            self._unusable(str(error))
            raise
        estimator.retune(self.config)
        self.reread()  # what was read before the end of the contact is no more
        told = f"first contact ended, {self.stream.held_back} samples waited"
        if self.stream.dropped:
            told += f" and {self.stream.dropped} before them were let go"
        told += f": {_units_of(config, self.quantities)}, "
        told += f"theoretical curve {theory_told(config, self.stream.has_pressure)}"
        self.log.info(f"{told}; {self.prefix}reset forgets that")
        self._on_backlog()
        return estimator

    def _restored(self, state: Mapping[str, Any]) -> Estimator:
        """Go on with a state; raises where it does not fit, and nothing has changed then."""
        estimator = self.stream.estimator
        if estimator is not None:
            estimator.restore(state)
            return estimator
        if "configuration" in self.notes:
            raise ConfigError(self.notes["configuration"])
        estimator = build(stated_config(self.config, state))
        estimator.restore(state)
        self.stream.go_on(estimator)
        self.log.info(f"no first contact needed: {_units_of(estimator.config, self.quantities)}")
        self._on_backlog()
        return estimator

    def running(self) -> Estimator:
        """Return the estimator; raises ConfigError with the reason where there is none."""
        if self.stream.estimator is None:
            waiting = f"first contact: nothing is learned yet, {self.stream.held_back} samples wait, {STILL_NEEDED}"
            raise ConfigError(self.notes.get("configuration", waiting))
        return self.stream.estimator

    # --- what comes out ----------------------------------------------------------------------------------------

    def _publish(
        self, stamp_ns: int, velocity_m_s: float, predicted_N: float, friction_N: float, stddev_N: float
    ) -> None:
        frame = self._inputs.frame if self._inputs is not None else NO_FRAME
        self.outputs.sample(stamp_ns, frame, velocity_m_s, predicted_N, friction_N, stddev_N)
        if self.outputs.parameters_due(self.config.publish.parameters_rate) and self.stream.estimator is not None:
            self.outputs.parameters(self.stream.estimator.parameters, stamp_ns)

    @property
    def curve(self) -> Curve | None:
        """The last static curve that is ready; None before the first."""
        return None if self.stream.estimator is None else self._curve

    def begin_saving(self) -> None:
        """Begin to save, where it is time to."""
        if self.stream.estimator is not None:
            self.keeper.tick(self.stream.estimator)

    def begin_drawing(self) -> None:
        """Begin to draw the static curve of this moment, unless the last one is still being drawn."""
        estimator = self.stream.estimator
        if estimator is not None and not self._drawing.busy:
            moment, conditions = estimator.predicting(), self.stream.conditions
            self._drawing.begin(lambda: self._draw(moment, conditions))

    def _draw(self, moment: Estimator, conditions: Samples) -> None:
        """Draw the static curve, and publish it where somebody listens; at few velocities where nobody does."""
        if self.outputs.curve_wanted:
            self._curve = moment.curve(conditions)
            self.outputs.curve(self._curve)
        else:
            low, high = moment.model.basis.reach
            self._curve = moment.curve(conditions, np.linspace(low, high, FEW_POINTS))

    # --- what the services ask for -----------------------------------------------------------------------------

    def reset(self) -> str:
        """Forget what was learned and put all parameters into force; where they allow no estimator, go on as before.

        Raises FrictionEstimatorError with the reason then.
        """
        # Extension terms refer to the model that they were found beside, so that one is gone back to.
        config = (
            replace(self.config, learned=self._configured)
            if self.config.extension.terms
            else without_learned(self.config)
        )
        try:
            estimator = self._trial(config)
        except FrictionEstimatorError as error:
            reason = sentence(error)
            if not self.stream.running:
                self._unusable(reason)
                raise
            self.log.error(f"{self.prefix}reset refused: {reason}; what was running goes on")
            self.notes["reset"] = f"refused, what was running goes on: {reason}"
            raise
        self._begin(estimator)
        self.stream.restart()
        self._set_learning()
        self._learned_changed()
        return f"started cold with the present parameters{'; first contact' if self.stream.meeting else ''}"

    def save(self) -> str:
        """Write the state file; raises FrictionEstimatorError with the reason where that is impossible."""
        return self.keeper.save(self.running())

    def load(self) -> str:
        """Go on with the state file; raises FrictionEstimatorError, and changes nothing, where that is impossible."""
        if "configuration" in self.notes:
            raise ConfigError(self.notes["configuration"])
        answer = self.keeper.load(self._restored)
        self.stream.restart()
        self.reread()
        return answer

    def close(self) -> None:
        """Save the state; the last act."""
        self.keeper.close(self.stream.estimator)
        self._drawing.join(LONGEST_DRAWING_S)
        self.outputs.close()

    # --- parameters --------------------------------------------------------------------------------------------

    def learned(self) -> Config:
        """Return the configuration with what was learned, of one moment for questions in quick succession."""
        taken, asked, config = self._snapshot
        now = time.monotonic()
        if config is None or now - asked > SNAPSHOT_S or now - taken > LONGEST_SNAPSHOT_S:
            config = self.stream.estimator.learned_config if self.stream.estimator else self.config
            taken = now
        self._snapshot = (taken, now, config)
        return config

    def reread(self) -> None:
        """Let the next question be answered anew."""
        self._snapshot = (0.0, 0.0, None)

    def _learned_changed(self) -> None:
        self.reread()
        self.keeper.changed()

    def check_change(self, config: Config, changed: Sequence[str]) -> None:
        """Raise ConfigError where learned values do not fit the running model, judged all together."""
        if not any(name in LEARNED for name in changed):
            return
        running = self.running()
        for name in CHOSEN:
            item = PARAMETERS[name]
            if name in changed and item.of(config) != item.of(running.config):
                raise ConfigError(
                    f"{name}: all that was learned is in terms of the present {item.of(running.config)}; give another "
                    "one in the parameter file of the next start, or let ~/reset choose anew"
                )
        running.model.checked(self._given(config, changed))

    def apply_change(self, config: Config, changed: Sequence[str]) -> None:
        """Let what was changed and acts at once act; `config` has passed `check_change`."""
        if any(name in LEARNED for name in changed):
            self.running().parameters = self._given(config, changed)
            self.config = without_learned(config)
            self._learned_changed()
        else:
            self.config = replace(config, learned=self.config.learned)
        if self.stream.estimator is not None:
            self.stream.estimator.retune(self.config)
        self._set_learning()
        groups = {name.partition(".")[0] for name in changed}
        if groups & {"input", "sync"}:
            self.stream.retune(self.config)
        if "input" in groups:
            self.outputs.set_axis(self.config.input.axis, self.quantities.motion)
        if "publish" in groups:
            self.outputs.parameters_at_once()
        if "state" in groups:
            self.keeper.configure(self.config.state)

    def _given(self, config: Config, changed: Sequence[str]) -> Parameters:
        """Return the learned values after a change: those that were set, and the present others."""
        present = self.running().parameters
        values = {}
        for name in changed:
            if name in ARRAYS:
                leaf = name.rpartition(".")[2]
                ours, given = getattr(present, leaf), PARAMETERS[name].of(config)
                if len(given) != ours.size:  # type: ignore[arg-type]
                    raise ConfigError(
                        f"{name}: {len(given)} values given, this model has {ours.size}"  # type: ignore[arg-type]
                    )
                values[leaf] = type(ours)(ours.shape, ours.dtype)
                values[leaf][:] = given
        return replace(present, **values)


def _pass_over(stream: int, stamp_ns: int, value: float) -> None:
    """Take no event: the joint is disabled."""


def _units_of(config: Config, quantities: Quantities) -> str:
    """Return range and unit of a configuration in words."""
    reach = quantities.range_text(config.reach or (0.0, 0.0), VELOCITY, ".5g")
    return f"velocity range {reach}, force unit {quantities.text(config.unit_N, FORCE, '.5g')}"
