"""The node `friction_estimator`: inputs, parameters, services and timers around one `EstimatedJoint` or several."""

import math
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.parameter import Parameter as RosParameter
from std_srvs.srv import SetBool, Trigger

from friction_estimator.core.errors import ConfigError, FrictionEstimatorError, sentence
from friction_estimator.core.quantities import Quantities
from friction_estimator.core.sample import NS_PER_S
from friction_estimator.core.settings.config import PARAMETERS
from friction_estimator.core.settings.groups import AUTO
from friction_estimator.core.settings.joints import Settings
from friction_estimator.core.settings.setting import Value
from friction_estimator.core.text import shown
from friction_estimator.ros.arguments import beside_its_file
from friction_estimator.ros.build import warm_up
from friction_estimator.ros.estimated_joint import EstimatedJoint
from friction_estimator.ros.health import Health
from friction_estimator.ros.inputs import Inputs
from friction_estimator.ros.parameters import ConfiguredNode, to_ros

NAME = "friction_estimator"

WORK_OFF_S = 0.002
"""Time between two pieces of what waits: for the first contact, or since the samples come too fast."""

BREATH_S = 0.05
"""Time between two turns of housekeeping, which prove that timers are served (`SampleStream.breathe`)."""

LOOK_S = 1.0
"""Time between two messages of /diagnostics."""

BREATHS = 16
"""Of a second's, those over which saving and drawing are spread: threads that work at one time hold each other up."""


class EstimatorNode(ConfiguredNode):
    """Predict the friction of each sample, publish it, learn from the measurement: of one joint, or of several.

    Several such nodes may live in one process, in one context or in contexts of their own, and be served by any
    executor. `close` saves what was learned; `destroy_node` does so, too.

    Parameters
    ----------
    name : of the node.
    files : parameter files of the command line; relative paths in them are relative to the file.
    options : what rclpy's Node takes: namespace, context, parameter_overrides, cli_args, use_global_arguments.

    Attributes
    ----------
    settings : the parameters without learned values: those are the joints'.
    joints : what is estimated, by plain name (`core.settings.joint_names`); the only joint under the empty name.
    """

    stopping: Callable[[], bool] = staticmethod(lambda: False)
    """Whether the node is to end: then it begins no more pieces of what waits, which may last minutes."""

    def __init__(self, name: str = NAME, *, files: Sequence[Path] = (), **options: Any) -> None:
        self._files = files
        self._found = ""
        self.joints: dict[str, EstimatedJoint] = {}  # rclpy asks for parameters during construction
        self._closed = False
        self._pieces: deque[Callable[[], None]] = deque()
        super().__init__(name, **options)
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
        self._timer = self.create_timer(BREATH_S, self._serve, clock=steady)
        self._house_due = self._look_due = math.inf
        load, failed = self.health.load, self.health.exception
        self.joints = {
            plain: EstimatedJoint(self, self.settings.of(plain), load, self._begin_working_off, failed, plain)
            for plain in self.settings.joints
        }
        self.settings = self.settings.without_learned()
        for joint in self.joints.values():
            joint.start()
            joint.on_motion = self._describe_joints
        self._inputs = self._open_inputs()
        self._service(Trigger, "~/reset", lambda _: self._of_all(EstimatedJoint.reset))
        self._service(Trigger, "~/save", lambda _: self._of_all(EstimatedJoint.save))
        self._service(Trigger, "~/load", lambda _: self._of_all(EstimatedJoint.load))
        self._service(SetBool, "~/enable", self._enable)
        self._service(SetBool, "~/adapt", self._adapt)
        if self.settings.several:
            for joint in self.joints.values():
                self._services_of(joint)
        topics = ", ".join(source.topic for source in self._inputs.sources.values() if source.required)
        names = ", ".join(self.settings.joints.values())
        self.get_logger().info(f"listening: {topics}" + (f" for {names}" if self.settings.several else ""))
        self._house_due = time.monotonic()
        self._look_due = self._house_due + LOOK_S

    def _open_inputs(self) -> Inputs:
        feeds = [joint.feed for joint in self.joints.values()]
        shared, health = self.settings.shared.input, self.health
        inputs = Inputs(self, shared, feeds, health.exception, health.load, self._moves)
        self._connect(inputs)
        return inputs

    def _connect(self, inputs: Inputs) -> None:
        for joint in self.joints.values():
            joint.connect(inputs)

    def _moves(self, motion: str, why: str) -> None:
        """Take that the only drive is linear or rotary."""
        self._found = motion
        for joint in self.joints.values():
            joint.move(motion)
        self.describe_units({"": Quantities(motion)})
        self.get_logger().info(f"the drive is {motion}: {why}")

    def describe_units(self, quantities: Mapping[str, Quantities]) -> None:
        """Let the descriptors say the units of the joints."""
        super().describe_units(quantities)
        for joint in self.joints.values():  # rclpy has read every value
            joint.reread()

    def _describe_joints(self) -> None:
        self.describe_units({plain: joint.quantities for plain, joint in self.joints.items()})

    # --- timers ------------------------------------------------------------------------------------------------

    def _serve(self) -> None:
        """Work off what waits, and keep house in between.

        The node's only timer, never reset: executors hand a timer over once too often otherwise (docs/decisions/0081).
        """
        self._work_off()
        if time.monotonic() >= self._house_due:
            self._keep_house()
            self._house_due = time.monotonic() + BREATH_S - WORK_OFF_S  # never a turn too late

    def _keep_house(self) -> None:
        """Prove that timers are served; look at everything once a second, else begin what is due in the background."""
        for joint in self.joints.values():
            joint.stream.breathe()
        late = time.monotonic() - self._look_due
        if late >= 0.0:
            self._look_due += LOOK_S * (1 + late // LOOK_S)
            self._look()
        else:
            self._begin_pieces()

    def _begin_pieces(self) -> None:
        for _ in range(min(len(self._pieces), math.ceil(2 * len(self.joints) / BREATHS))):
            try:
                with self.health.load.other_work():
                    self._pieces.popleft()()
            except Exception as error:
                self.health.exception("background", error)

    def _begin_working_off(self) -> None:
        self._timer.timer_period_ns = round(WORK_OFF_S * NS_PER_S)

    def _work_off(self) -> None:
        """Predict some of what waited, of each joint; new samples get in between. Where the node is to end, let it."""
        waiting = [joint for joint in self.joints.values() if joint.stream.working_off]
        for joint in waiting:
            if self.stopping():
                waiting = []  # a timer that is always due keeps the spin from ending
                break
            try:
                joint.stream.work_off()
            except Exception as error:
                self.health.exception("samples that waited", error)
        if not any(joint.stream.working_off for joint in waiting):
            self._timer.timer_period_ns = round(BREATH_S * NS_PER_S)

    def _look(self) -> None:
        try:
            with self.health.load.other_work():
                joints = list(self.joints.values())
                self._inputs.expect(positions=any(joint.stream.intake.pairer.tracks for joint in joints))
                self.health.tick(self.settings.shared, self._inputs, joints, self._enabled)
        except Exception as error:
            self.health.exception("diagnostics", error)
        if not self._pieces:  # else the last second's are still under way
            for joint in self.joints.values():
                self._pieces += (joint.begin_drawing, joint.begin_saving)

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

    def _services_of(self, joint: EstimatedJoint) -> None:
        """Open the services of one of several joints."""
        self._service(Trigger, f"{joint.prefix}reset", lambda _: joint.reset())
        self._service(Trigger, f"{joint.prefix}save", lambda _: joint.save())
        self._service(Trigger, f"{joint.prefix}load", lambda _: joint.load())
        self._service(SetBool, f"{joint.prefix}enable", lambda request: joint.enable(request.data))
        self._service(SetBool, f"{joint.prefix}adapt", lambda request: joint.adapt(request.data))

    def _of_all(self, act: Callable[[EstimatedJoint], str]) -> str:
        """Have every joint act, whatever becomes of another; raise ConfigError with all answers where one failed."""
        told, failed = [], False
        for joint in self.joints.values():
            try:
                answer = act(joint)
            except FrictionEstimatorError as error:
                if not joint.plain:
                    raise
                answer, failed = sentence(error), True
            told.append(f"{joint.plain}: {answer}" if joint.plain else answer)
        if failed:
            raise ConfigError("; ".join(told))
        return "; ".join(told)

    def _enable(self, request: Any) -> str:
        """Open or close the inputs."""
        if request.data != self._enabled:
            self._enabled = request.data
            if self._enabled:
                self._inputs = self._open_inputs()
            else:
                self._inputs.close()
            for joint in self.joints.values():
                joint.stream.restart()
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
        if self.settings.declaration(name).path and isinstance(value, str):
            return beside_its_file(name, value, self._files)
        return value

    def get_parameter(self, name: str) -> RosParameter:
        """Return a parameter; learned ones are read from the estimator when asked for, without any event."""
        shared = self.settings.shared
        if name == "input.motion" and shared.input.motion == AUTO and self._found:
            return to_ros(PARAMETERS[name], self._found)  # a dump must not leave it to the next start's first messages
        item = self._declarations.get(name)
        if item is None or not item.learned or not self.joints:
            return super().get_parameter(name)
        plain, setting = self.settings.split(name)
        return to_ros(item, PARAMETERS[setting].of(self.joints[plain].learned()))

    def check_change(self, settings: Settings, changed: Sequence[str]) -> None:
        """Raise ConfigError where a running estimator cannot take the change."""
        for plain, joint in self.joints.items():
            joint.check_change(settings.of(plain), settings.concerning(plain, changed))

    def apply_change(self, settings: Settings, changed: Sequence[str]) -> None:
        """Let live changes act."""
        self.settings = settings.without_learned()
        for plain, joint in self.joints.items():
            names = settings.concerning(plain, changed)
            if names:
                joint.apply_change(settings.of(plain), names)
        if any(name.startswith("input.") for name in changed):
            if self._enabled:
                self._inputs.reconfigure(self.settings.shared.input)
                self._connect(self._inputs)
            self.health.inputs_changed()

    def close(self) -> None:
        """Save the states; nothing is to come after it but `destroy_node`."""
        if not self._closed:
            self._closed = True
            for joint in self.joints.values():
                joint.close()

    def destroy_node(self) -> None:
        """Save the states and leave the graph."""
        self.close()
        super().destroy_node()
