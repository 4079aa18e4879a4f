"""The node `friction_estimator`: parameters, services and timers around a `SampleStream`. It holds no maths."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.parameter import Parameter as RosParameter
from std_srvs.srv import SetBool, Trigger

from friction_estimator.core.errors import ConfigError, FrictionEstimatorError
from friction_estimator.core.intake.pairing import FRICTION, VELOCITY
from friction_estimator.core.model.structure import Parameters
from friction_estimator.core.online import relinearisation
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.settings.config import PARAMETERS, Config
from friction_estimator.core.settings.derive import with_live_units
from friction_estimator.core.settings.setting import Value
from friction_estimator.ros.arguments import beside_its_file
from friction_estimator.ros.health import Health
from friction_estimator.ros.outputs import Outputs
from friction_estimator.ros.parameters import ConfiguredNode, to_ros
from friction_estimator.ros.sources import Inputs
from friction_estimator.ros.state_keeper import StateKeeper
from friction_estimator.ros.stream import SampleStream

NAME = "friction_estimator"

LEARNED = tuple(name for name, item in PARAMETERS.items() if item.learned)

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
        self._snapshot: tuple[float, Parameters | None] = (0.0, None)
        self._enabled = True
        self._configured = self.config.learned
        self._outputs = Outputs(self, self.config.input.axis)
        self._keeper = StateKeeper(self.get_logger())
        for reason in self.refused:
            self.get_logger().error(f"parameter refused: {reason}")
        if self.refused:
            self.health.notes["refused parameters"] = "; ".join(self.refused)
        warm_up()
        self._stream = SampleStream(self.config, self._estimator(self.config), self._publish)
        self._keeper.configure(self.config.state)
        self._load_at_start()
        self._inputs = self._open_inputs()
        self._service(Trigger, "~/reset", self._reset)
        self._service(Trigger, "~/save", self._save)
        self._service(Trigger, "~/load", self._load)
        self._service(SetBool, "~/enable", self._enable)
        self._service(SetBool, "~/adapt", self._adapt)
        # Housekeeping must go on when the simulation's clock stands still.
        self.get_logger().info(f"listening: {', '.join(s.topic for s in self._inputs.sources.values() if s.required)}")
        self.create_timer(1.0, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))

    # --- estimator ---------------------------------------------------------------------------------------------

    def _estimator(self, config: Config) -> Estimator | None:
        """Build the estimator; where the configuration does not allow it, say why and live on without."""
        unset = [name for name in ("basis.velocity_range", "force_unit") if not PARAMETERS[name].of(config)]
        config = with_live_units(config)
        for name in unset:
            value = PARAMETERS[name].of(config)
            shown = list(value) if isinstance(value, tuple) else value
            self.get_logger().info(f"{name} is unset: using {shown} {PARAMETERS[name].unit}")
        self.health.notes.pop("configuration", None)
        try:
            return build(config)
        except FrictionEstimatorError as error:
            reason = str(error)
        if any(PARAMETERS[name].of(config) for name in LEARNED):
            try:
                estimator = build(without_learned(config))
            except FrictionEstimatorError as error:
                reason = str(error)
            else:
                self.get_logger().error(f"starting cold: {reason}")
                self.health.notes["started cold"] = reason
                return estimator
        self.get_logger().error(f"not estimating: {reason}; correct it and call ~/reset")
        self.health.notes["configuration"] = f"not estimating: {reason}"
        return None

    def _load_at_start(self) -> None:
        if self._stream.estimator is None or not self._keeper.start():
            return
        try:
            self.get_logger().info(self._keeper.load(self._stream.estimator))
        except FrictionEstimatorError as error:
            self._keeper.refuse(error)

    def _open_inputs(self) -> Inputs:
        return Inputs(self, self.config.input, self._stream.event, self.health.exception)

    def _publish(self, stamp_ns: int, predicted_N: float, friction_N: float) -> None:
        self._outputs.sample(stamp_ns, self._inputs.frame, predicted_N, friction_N)
        estimator = self._stream.estimator
        if self._outputs.parameters_due(self.config.publish.parameters_rate) and estimator is not None:
            self._outputs.parameters(estimator.parameters)

    def _tick(self) -> None:
        try:
            estimator = self._stream.estimator
            if estimator is not None:
                self._keeper.tick(estimator)
            self.health.tick(self.config, self._inputs.sources, self._stream, self._enabled, self._keeper.report())
        except Exception as error:
            self.health.exception("diagnostics", error)

    # --- services ----------------------------------------------------------------------------------------------

    def _service(self, kind: type, name: str, answer: Callable[[Any], str]) -> None:
        """Open a service; `answer` returns the message of success or raises the reason of failure."""

        def respond(request: Any, response: Any) -> Any:
            try:
                response.message = answer(request)
                response.success = True
            except FrictionEstimatorError as error:
                response.success, response.message = False, str(error)
            except Exception as error:
                self.health.exception(name, error)
                response.success, response.message = False, f"{type(error).__name__}: {error}"
            return response

        self.create_service(kind, name, respond)

    def _reset(self, _: Any) -> str:
        """Forget what was learned and put all parameters into force."""
        # Extension terms refer to the model that they were found beside, so that one is gone back to.
        self.config = (
            replace(self.config, learned=self._configured)
            if self.config.extension.terms
            else without_learned(self.config)
        )
        self._stream.estimator = self._estimator(self.config)
        self._stream.restart()
        self._stream.learn = self.config.model.adapt
        self._snapshot = (0.0, None)
        self._keeper.changed()
        if self._stream.estimator is None:
            raise ConfigError(self.health.notes["configuration"])
        return "started cold with the present parameters"

    def _save(self, _: Any) -> str:
        return self._keeper.save(self._running())

    def _load(self, _: Any) -> str:
        answer = self._keeper.load(self._running())
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
            raise ConfigError(self.health.notes["configuration"])
        return self._stream.estimator

    # --- parameters --------------------------------------------------------------------------------------------

    def localised(self, name: str, value: Value) -> Value:
        """Return paths relative to the parameter file that holds them as absolute ones."""
        if name in ("theory.table", "state.file") and isinstance(value, str):
            return beside_its_file(name, value, self._files)
        return value

    def get_parameter(self, name: str) -> RosParameter:
        """Return a parameter; learned ones are read from the estimator when asked for, without any event."""
        if name not in LEARNED:
            return super().get_parameter(name)
        values = self._learned()
        numbers = getattr(values, name.rpartition(".")[2]).tolist() if values is not None else []
        return RosParameter(name, RosParameter.Type.DOUBLE_ARRAY, numbers)

    def _learned(self) -> Parameters | None:
        taken, values = self._snapshot
        now = time.monotonic()
        if now - taken > SNAPSHOT_S:
            stream = getattr(self, "_stream", None)  # rclpy may ask during construction
            values = stream.estimator.parameters if stream and stream.estimator else None
        self._snapshot = (now, values)
        return values

    def check_change(self, config: Config, changed: Sequence[str]) -> None:
        """Raise ConfigError where learned values do not fit the running model, judged all together."""
        if any(name in LEARNED for name in changed):
            given = self._given(config, changed)
            running = self._running()
            trial = build(replace(running.config, learned=type(config.learned)()))
            trial.parameters = given

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
            self._rewire()
        if "state" in groups:
            self._keeper.configure(self.config.state)

    def _given(self, config: Config, changed: Sequence[str]) -> Parameters:
        """Return the learned values after a change: those that were set, and the present others."""
        present = self._running().parameters
        values = {}
        for name in changed:
            if name in LEARNED:
                leaf = name.rpartition(".")[2]
                ours, given = getattr(present, leaf), PARAMETERS[name].of(config)
                if len(given) != ours.size:  # type: ignore[arg-type]
                    raise ConfigError(
                        f"{name}: {len(given)} values given, this model has {ours.size}"  # type: ignore[arg-type]
                    )
                values[leaf] = type(ours)(ours.shape, ours.dtype)
                values[leaf][:] = given
        return replace(present, **values)

    def _rewire(self) -> None:
        """Put changed input and pairing settings into force; what was learned and counted stays."""
        self._stream.reconfigure(self.config)
        self._outputs.set_axis(self.config.input.axis)
        if self._enabled:
            self._inputs.close()
            self._inputs = self._open_inputs()
        self.health.inputs_changed()

    def close(self) -> None:
        """Save the state; the last act before the node is destroyed."""
        if self._stream.estimator is not None:
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


def warm_up() -> None:
    """Compile the sample loops, so that the first sample is not late by seconds."""
    for model in ("hammerstein", "parallel"):
        config = with_live_units(Config.from_mapping({"model.type": model}))
        estimator = build(config)
        relinearisation.warm_up(estimator.model)
        stream = SampleStream(config, estimator, lambda *_: None)
        for stamp_ns in (1, 2):
            stream.event(VELOCITY, stamp_ns, 0.01)
            stream.event(FRICTION, stamp_ns, 1.0)
