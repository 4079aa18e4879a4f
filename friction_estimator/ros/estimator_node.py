"""The node `friction_estimator`: inputs, parameters, services and timers around an `EstimatedJoint`."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.parameter import Parameter as RosParameter
from std_srvs.srv import SetBool, Trigger

from friction_estimator.core.errors import ConfigError, FrictionEstimatorError, sentence
from friction_estimator.core.quantities import Quantities
from friction_estimator.core.settings.config import PARAMETERS, Config
from friction_estimator.core.settings.groups import AUTO
from friction_estimator.core.settings.setting import Value
from friction_estimator.core.text import shown
from friction_estimator.ros.arguments import beside_its_file
from friction_estimator.ros.build import warm_up, without_learned
from friction_estimator.ros.estimated_joint import LEARNED, EstimatedJoint
from friction_estimator.ros.health import Health
from friction_estimator.ros.parameters import ConfiguredNode, to_ros
from friction_estimator.ros.sources import Inputs

NAME = "friction_estimator"

WORK_OFF_S = 0.002
"""Time between two pieces of what waits: for the first contact, or since the samples come too fast."""

BREATH_S = 0.05
"""Time between two proofs that timers are served; see `SampleStream.breathe`."""


class EstimatorNode(ConfiguredNode):
    """Predict the friction of each sample, publish it, learn from the measurement.

    Parameters
    ----------
    files : parameter files of the command line; relative paths in them are relative to the file.

    Attributes
    ----------
    config : the parameters without learned values: those are the joint's.
    """

    stopping: Callable[[], bool] = staticmethod(lambda: False)
    """Whether the node is to end: then it begins no more pieces of what waits, which may last minutes."""

    _joint: EstimatedJoint | None = None  # rclpy asks for parameters during construction

    def __init__(self, files: Sequence[Path] = ()) -> None:
        self._files = files
        self._found = ""
        super().__init__(NAME)
        self.health = Health(self)
        self._enabled = True
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
        self._joint = EstimatedJoint(
            self, self.config, self.health.load, self._working_off.reset, self.health.exception
        )
        self.config = without_learned(self.config)
        self.create_timer(BREATH_S, self._joint.stream.breathe, clock=steady)
        self._joint.start()
        self._inputs = self._open_inputs()
        self._service(Trigger, "~/reset", lambda _: self.joint.reset())
        self._service(Trigger, "~/save", lambda _: self.joint.save())
        self._service(Trigger, "~/load", lambda _: self.joint.load())
        self._service(SetBool, "~/enable", self._enable)
        self._service(SetBool, "~/adapt", self._adapt)
        topics = ", ".join(source.topic for source in self._inputs.sources.values() if source.required)
        self.get_logger().info(f"listening: {topics}")
        self.create_timer(1.0, self._tick, clock=steady)

    @property
    def joint(self) -> EstimatedJoint:
        """What is estimated."""
        assert self._joint is not None
        return self._joint

    def _open_inputs(self) -> Inputs:
        inputs = Inputs(self, self.config.input, self.joint.stream.event, self.health.exception, self._moves)
        self.joint.connect(inputs)
        return inputs

    def _moves(self, motion: str, why: str) -> None:
        """Take that the drive is linear or rotary."""
        self._found = motion
        self.joint.move(motion)
        self.describe_units(Quantities(motion))
        self.get_logger().info(f"the drive is {motion}: {why}")

    # --- timers ------------------------------------------------------------------------------------------------

    def _work_off(self) -> None:
        """Predict some of what waited; new samples get in between. Where the node is to end, let it."""
        if self.stopping():
            self._working_off.cancel()
            return
        stream = self.joint.stream
        try:
            stream.work_off()
        except Exception as error:
            self.health.exception("samples that waited", error)
        if stream.working_off:
            # A timer that is always due keeps the spin from ending, and so a signal from being obeyed.
            self._working_off.reset()
        else:
            self._working_off.cancel()

    def _tick(self) -> None:
        try:
            with self.health.load.other_work():
                curve = self.joint.look()
                self._inputs.expect(positions=self.joint.stream.intake.pairer.tracks)
                self.health.tick(self.config, self._inputs, self.joint, self._enabled, curve)
        except Exception as error:
            self.health.exception("diagnostics", error)

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

    def _enable(self, request: Any) -> str:
        """Open or close the inputs."""
        if request.data != self._enabled:
            self._enabled = request.data
            if self._enabled:
                self._inputs = self._open_inputs()
            else:
                self._inputs.close()
            self.joint.stream.restart()
            self.health.inputs_changed()
        return "enabled" if self._enabled else "disabled: inputs are not listened to"

    def _adapt(self, request: Any) -> str:
        result = self.set_parameters_atomically([to_ros(PARAMETERS["model.adapt"], bool(request.data))])
        if not result.successful:
            raise ConfigError(result.reason)
        return "learning" if request.data else "predicting with the present values, not learning"

    # --- parameters --------------------------------------------------------------------------------------------

    def localised(self, name: str, value: Value) -> Value:
        """Return paths relative to the parameter file that holds them as absolute ones."""
        if PARAMETERS[name].path and isinstance(value, str):
            return beside_its_file(name, value, self._files)
        return value

    def get_parameter(self, name: str) -> RosParameter:
        """Return a parameter; learned ones are read from the estimator when asked for, without any event."""
        if name == "input.motion" and self.config.input.motion == AUTO and self._found:
            return to_ros(PARAMETERS[name], self._found)  # a dump must not leave it to the next start's first messages
        if name not in LEARNED:
            return super().get_parameter(name)
        item = PARAMETERS[name]
        return to_ros(item, item.of(self._joint.learned() if self._joint is not None else self.config))

    def check_change(self, config: Config, changed: Sequence[str]) -> None:
        """Raise ConfigError where the running estimator cannot take the change."""
        self.joint.check_change(config, changed)

    def apply_change(self, config: Config, changed: Sequence[str]) -> None:
        """Let live changes act."""
        self.config = without_learned(config)
        self.joint.apply_change(config, changed)
        if any(name.startswith("input.") for name in changed):
            if self._enabled:
                self._inputs.reconfigure(self.config.input)
                self.joint.connect(self._inputs)
            self.health.inputs_changed()

    def close(self) -> None:
        """Save the state; the last act before the node is destroyed."""
        self.joint.close()
