"""The node `friction_estimator`: parameters, services and timers around a `SampleStream`. It holds no maths."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.parameter import Parameter as RosParameter
from std_srvs.srv import SetBool, Trigger

from friction_estimator.core.errors import ConfigError, FrictionEstimatorError, sentence
from friction_estimator.core.fit.band import Curve
from friction_estimator.core.intake.pairing import FRICTION, VELOCITY
from friction_estimator.core.model.structure import Parameters
from friction_estimator.core.online.estimator import CHOSEN, Estimator, stated_config
from friction_estimator.core.settings.config import PARAMETERS, Config
from friction_estimator.core.settings.setting import Value
from friction_estimator.core.settings.units import NO_FORCE, NO_VELOCITY
from friction_estimator.core.text import shown
from friction_estimator.ros.arguments import beside_its_file
from friction_estimator.ros.health import STILL_NEEDED, Health
from friction_estimator.ros.outputs import Outputs
from friction_estimator.ros.parameters import ConfiguredNode, to_ros
from friction_estimator.ros.sources import Inputs
from friction_estimator.ros.state_keeper import StateKeeper
from friction_estimator.ros.stream import SampleStream

NAME = "friction_estimator"

LEARNED = tuple(name for name, item in PARAMETERS.items() if item.learned)
ARRAYS = tuple(name for name in LEARNED if name not in CHOSEN)
"""What is learned in range and units, which are the rest of the learned values."""

WORK_OFF_S = 0.002
"""Time between two pieces of what waits: for the first contact, or since the samples come too fast."""

BREATH_S = 0.05
"""Time between two proofs that timers are served; see `SampleStream.breathe`."""

FEW_POINTS = 41
"""Velocities at which the learned part of the range is looked for where nobody asks for the whole curve."""

SNAPSHOT_S = 2.0
"""Learned parameters read in quick succession are of one moment, so that a dump is consistent."""


class EstimatorNode(ConfiguredNode):
    """Predict the friction of each sample, publish it, learn from the measurement.

    Parameters
    ----------
    files : parameter files of the command line; relative paths in them are relative to the file.
    """

    def __init__(self, files: Sequence[Path] = ()) -> None:
        self._files = files
        super().__init__(NAME)
        self.health = Health(self)
        self._snapshot: tuple[float, Config | None] = (0.0, None)
        self._enabled = True
        self._configured = self.config.learned
        self._outputs = Outputs(self, self.config.input.axis)
        for fault in self._outputs.faults:
            self.get_logger().error(fault)
            self.health.notes["outputs"] = "; ".join(self._outputs.faults)
        self._keeper = StateKeeper(self.get_logger())
        for reason in self.refused:
            self.get_logger().error(f"parameter refused: {reason}")
        if self.refused:
            self.health.notes["refused parameters"] = "; ".join(self.refused)
        for line in self.retired:
            self.get_logger().warning(line)
        warm_up()
        # Housekeeping must go on when the simulation's clock stands still.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._working_off = self.create_timer(WORK_OFF_S, self._work_off, clock=steady, autostart=False)
        self._stream = SampleStream(self.config, self._met, self._publish, self.health.load)
        self._stream.on_backlog = self._working_off.reset
        self.create_timer(BREATH_S, self._stream.breathe, clock=steady)
        self._keeper.configure(self.config.state)
        self._start()
        self._inputs = self._open_inputs()
        self._service(Trigger, "~/reset", self._reset)
        self._service(Trigger, "~/save", self._save)
        self._service(Trigger, "~/load", self._load)
        self._service(SetBool, "~/enable", self._enable)
        self._service(SetBool, "~/adapt", self._adapt)
        topics = ", ".join(source.topic for source in self._inputs.sources.values() if source.required)
        self.get_logger().info(f"listening: {topics}")
        self.create_timer(1.0, self._tick, clock=steady)

    # --- estimator ---------------------------------------------------------------------------------------------

    def _start(self) -> None:
        """Begin as the parameters and the state file say: warm, cold, or with the first contact.

        Where the configuration allows no estimator, say why and live on without.
        """
        try:
            estimator = self._trial(self.config)
        except FrictionEstimatorError as error:
            self._unusable(sentence(error))
            self._stream.begin(None)
            return
        self._begin(estimator)
        if self._keeper.start():
            try:
                self.get_logger().info(self._keeper.load(self._restored))
            except FrictionEstimatorError as error:
                self._keeper.refuse(error)

    def _begin(self, estimator: Estimator) -> None:
        """Begin with an estimator of the present configuration, or with the first contact that it asks for."""
        self._stream.begin(self.config, estimator if self.config.is_met else None)
        if self._stream.meeting:
            unset = " and ".join(name for name in ("basis.velocity_range", "force_unit") if not self._known(name))
            self.get_logger().info(
                f"first contact: {unset} come from the first samples; nothing is published before ({STILL_NEEDED})"
            )

    def _known(self, name: str) -> object:
        return self.config.reach if name == "basis.velocity_range" else self.config.unit_N

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
            self.health.notes.pop(note, None)
        if reason:
            self.get_logger().error(f"starting cold: {reason}")
            self.health.notes["started cold"] = reason
        self.config = config
        return estimator

    def _unusable(self, reason: str) -> None:
        self.get_logger().error(f"not estimating: {reason}; correct it and call ~/reset")
        self.health.notes["configuration"] = f"not estimating: {reason}"

    def _met(self, config: Config) -> Estimator:
        """Build the estimator that the first contact asks for, and say what it chose."""
        try:
            estimator = build(config)
        except FrictionEstimatorError as error:
            self._unusable(str(error))
            raise
        estimator.retune(self.config)
        told = f"first contact ended, {self._stream.held_back} samples waited"
        if self._stream.dropped:
            told += f" and {self._stream.dropped} before them were let go"
        self.get_logger().info(f"{told}: {units_of(config)}; ~/reset forgets that")
        self._working_off.reset()
        return estimator

    def _restored(self, state: Mapping[str, Any]) -> Estimator:
        """Go on with a state; raises where it does not fit, and nothing has changed then."""
        estimator = self._stream.estimator
        if estimator is not None:
            estimator.restore(state)
            return estimator
        if "configuration" in self.health.notes:
            raise ConfigError(self.health.notes["configuration"])
        estimator = build(stated_config(self.config, state))
        estimator.restore(state)
        self._stream.go_on(estimator)
        self.get_logger().info(f"no first contact needed: {units_of(estimator.config)}")
        self._working_off.reset()
        return estimator

    def _work_off(self) -> None:
        """Predict some of what waited; new samples get in between."""
        try:
            self._stream.work_off()
        except Exception as error:
            self.health.exception("samples that waited", error)
        if not self._stream.working_off:
            self._working_off.cancel()

    def _open_inputs(self) -> Inputs:
        inputs = Inputs(self, self.config.input, self._stream.event, self.health.exception)
        self._stream.queue_depth = inputs.depth
        return inputs

    def _publish(self, stamp_ns: int, predicted_N: float, friction_N: float, stddev_N: float) -> None:
        self._outputs.sample(stamp_ns, self._inputs.frame, predicted_N, friction_N, stddev_N)
        estimator = self._stream.estimator
        if self._outputs.parameters_due(self.config.publish.parameters_rate) and estimator is not None:
            self._outputs.parameters(estimator.parameters)

    def _tick(self) -> None:
        try:
            with self.health.load.other_work():
                estimator = self._stream.estimator
                if estimator is not None:
                    self._keeper.tick(estimator)
                curve = self._curve(estimator) if estimator is not None else None
                extra = self._keeper.report()
                self.health.tick(self.config, self._inputs.sources, self._stream, self._enabled, curve, extra)
        except Exception as error:
            self.health.exception("diagnostics", error)

    def _curve(self, estimator: Estimator) -> Curve:
        """Return the static curve, published where somebody listens; at few velocities where nobody does."""
        conditions = self._stream.conditions
        if not self._outputs.curve_wanted:
            low, high = estimator.model.basis.reach
            return estimator.curve(conditions, np.linspace(low, high, FEW_POINTS))
        curve = estimator.curve(conditions)
        self._outputs.curve(curve)
        return curve

    # --- services ----------------------------------------------------------------------------------------------

    def _service(self, kind: type, name: str, answer: Callable[[Any], str]) -> None:
        """Open a service; `answer` returns the message of success or raises the reason of failure."""

        def respond(request: Any, response: Any) -> Any:
            try:
                with self.health.load.other_work():
                    response.success, response.message = True, shown(answer(request))
            except Exception as error:
                if not isinstance(error, FrictionEstimatorError):
                    self.health.exception(name, error)
                response.success, response.message = False, sentence(error)
            return response

        self.create_service(kind, name, respond)

    def _reset(self, _: Any) -> str:
        """Forget what was learned and put all parameters into force; where they allow no estimator, go on as before."""
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
            if not self._stream.running:
                self._unusable(reason)
                raise
            self.get_logger().error(f"~/reset refused: {reason}; what was running goes on")
            self.health.notes["reset"] = f"refused, what was running goes on: {reason}"
            raise
        self._begin(estimator)
        self._stream.restart()
        self._stream.learn = self.config.model.adapt
        self._snapshot = (0.0, None)
        self._keeper.changed()
        return f"started cold with the present parameters{'; first contact' if self._stream.meeting else ''}"

    def _save(self, _: Any) -> str:
        return self._keeper.save(self._running())

    def _load(self, _: Any) -> str:
        if "configuration" in self.health.notes:
            raise ConfigError(self.health.notes["configuration"])
        answer = self._keeper.load(self._restored)
        self._stream.restart()
        self._snapshot = (0.0, None)
        return answer

    def _enable(self, request: Any) -> str:
        """Open or close the inputs."""
        if request.data != self._enabled:
            self._enabled = request.data
            if self._enabled:
                self._inputs = self._open_inputs()
            else:
                self._inputs.close()
            self._stream.restart()
            self.health.inputs_changed()
        return "enabled" if self._enabled else "disabled: inputs are not listened to"

    def _adapt(self, request: Any) -> str:
        result = self.set_parameters_atomically([to_ros(PARAMETERS["model.adapt"], bool(request.data))])
        if not result.successful:
            raise ConfigError(result.reason)
        return "learning" if request.data else "predicting with the present values, not learning"

    def _running(self) -> Estimator:
        if self._stream.estimator is None:
            waiting = f"first contact: nothing is learned yet, {self._stream.held_back} samples wait, {STILL_NEEDED}"
            raise ConfigError(self.health.notes.get("configuration", waiting))
        return self._stream.estimator

    # --- parameters --------------------------------------------------------------------------------------------

    def localised(self, name: str, value: Value) -> Value:
        """Return paths relative to the parameter file that holds them as absolute ones."""
        if PARAMETERS[name].path and isinstance(value, str):
            return beside_its_file(name, value, self._files)
        return value

    def get_parameter(self, name: str) -> RosParameter:
        """Return a parameter; learned ones are read from the estimator when asked for, without any event."""
        if name not in LEARNED:
            return super().get_parameter(name)
        item = PARAMETERS[name]
        return to_ros(item, item.of(self._learned()))

    def _learned(self) -> Config:
        """Return the configuration with what was learned, of one moment for questions in quick succession."""
        taken, config = self._snapshot
        now = time.monotonic()
        if config is None or now - taken > SNAPSHOT_S:
            stream = getattr(self, "_stream", None)  # rclpy may ask during construction
            config = stream.estimator.learned_config if stream and stream.estimator else self.config
        self._snapshot = (now, config)
        return config

    def check_change(self, config: Config, changed: Sequence[str]) -> None:
        """Raise ConfigError where learned values do not fit the running model, judged all together."""
        if not any(name in LEARNED for name in changed):
            return
        running = self._running()
        for name in CHOSEN:
            item = PARAMETERS[name]
            if name in changed and item.of(config) != item.of(running.config):
                raise ConfigError(
                    f"{name}: all that was learned is in terms of the present {item.of(running.config)}; give another "
                    "one in the parameter file of the next start, or let ~/reset choose anew"
                )
        running.model.checked(self._given(config, changed))

    def apply_change(self, config: Config, changed: Sequence[str]) -> None:
        """Let live changes act."""
        estimator = self._stream.estimator
        if any(name in LEARNED for name in changed):
            self._running().parameters = self._given(config, changed)
            self.config = without_learned(config)
            self._snapshot = (0.0, None)
            self._keeper.changed()
        if estimator is not None:
            estimator.retune(self.config)
        self._stream.learn = self.config.model.adapt
        groups = {name.partition(".")[0] for name in changed}
        if groups & {"input", "sync"}:
            self._stream.retune(self.config)
        if "input" in groups:
            self._outputs.set_axis(self.config.input.axis)
            if self._enabled:
                self._inputs.reconfigure(self.config.input)
                self._stream.queue_depth = self._inputs.depth
            self.health.inputs_changed()
        if "publish" in groups:
            self._outputs.parameters_at_once()
        if "state" in groups:
            self._keeper.configure(self.config.state)

    def _given(self, config: Config, changed: Sequence[str]) -> Parameters:
        """Return the learned values after a change: those that were set, and the present others."""
        present = self._running().parameters
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

    def close(self) -> None:
        """Save the state; the last act before the node is destroyed."""
        self._keeper.close(self._stream.estimator)


def build(config: Config) -> Estimator:
    """Return the estimator of a configuration, with the terms that a diagnosis added."""
    if not config.extension.terms:
        return Estimator(config)
    from friction_estimator.effects.extension import extension_from_config  # noqa: PLC0415 - seldom needed

    return Estimator(config, extension_from_config(config))


def without_learned(config: Config) -> Config:
    """Return the configuration for a cold start."""
    return replace(config, learned=type(config.learned)())


def supposed(config: Config) -> Config:
    """Return the configuration with range and units of no meaning where they are open, to try the rest of it."""
    values: dict[str, object] = {}
    if config.reach is None:
        values |= {"learned.velocity_range": (-NO_VELOCITY, NO_VELOCITY), "learned.velocity_scale": NO_VELOCITY}
    if not config.unit_N > 0.0:
        values["learned.force_unit"] = NO_FORCE
    return config.updated(values)


def units_of(config: Config) -> str:
    """Return range and unit of a configuration in words."""
    low, high = config.reach or (0.0, 0.0)
    return f"velocity range [{low:.5g}, {high:.5g}] m/s, force unit {config.unit_N:.5g} N"


def warm_up() -> None:
    """Compile the sample loops, so that the first sample is not late by seconds."""
    for model in ("hammerstein", "parallel"):
        config = supposed(Config.from_mapping({"model.type": model}))
        stream = SampleStream(config, build, lambda *_: None)
        stream.begin(config)
        for stamp_ns in (1, 2):
            stream.event(VELOCITY, stamp_ns, 0.01)
            stream.event(FRICTION, stamp_ns, 1.0)
        if stream.estimator is not None:
            stream.estimator.step(3, 0.01, 1.0)  # the way of samples that have waited
            stream.estimator.curve()
