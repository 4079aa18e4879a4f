"""The services of a playback: those of rosbag2's player, by name and type, where its types are installed.

`rosbag2_interfaces` comes with `ros2 bag`, not with the wheels. Without it, what `std_srvs/srv/Trigger` can express is
offered under the same names, and the rest is said to be missing.
"""

import threading
from collections.abc import Callable
from importlib import import_module
from typing import Any

from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger

from friction_estimator.core.sample import NS_PER_S
from friction_estimator.ros.playback_control import PlaybackControl

NODE_NAME = "rosbag2_player"
"""Of rosbag2's player: what calls `/rosbag2_player/pause` finds it here too."""

TYPES = "rosbag2_interfaces.srv"


class PlayerServices:
    """Serves requests to a playback from a thread of its own.

    Parameters
    ----------
    node : that owns the services; nobody else may spin it.
    control : what they ask.

    Attributes
    ----------
    told : a line that says what is offered.
    """

    def __init__(self, node: Node, control: PlaybackControl) -> None:
        self._node, self._control = node, control
        try:
            types = import_module(TYPES)
        except ImportError:
            offered = self._offer_triggers()
            missing = ", ".join(name for name in REQUESTS if name not in offered)
            self.told = (
                f"services /{NODE_NAME}/{{{', '.join(offered)}}} as std_srvs/srv/Trigger; rosbag2_interfaces is not "
                f"installed, so there is no {missing}"
            )
        else:
            self._offer(types)
            self.told = f"services of rosbag2's player: /{NODE_NAME}/{{{', '.join(REQUESTS)}}}"
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Serve no more; the node stays."""
        self._executor.shutdown()
        self._thread.join()

    def _serve(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            return

    def _offer(self, types: Any) -> None:
        for name, (kind, answer) in REQUESTS.items():

            def respond(request: Any, response: Any, answer: Answer = answer) -> Any:
                answer(self._control, request, response)
                return response

            self._node.create_service(getattr(types, kind), f"~/{name}", respond)

    def _offer_triggers(self) -> list[str]:
        for name, act in TRIGGERS.items():

            def respond(_: Any, response: Any, act: Act = act) -> Any:
                response.success = act(self._control) is not False
                state = "paused" if self._control.paused else f"playing at {self._control.rate:g}x"
                response.message = state if response.success else f"{state}: {_why_no_step(self._control)}"
                return response

            self._node.create_service(Trigger, f"~/{name}", respond)
        return list(TRIGGERS)


def _why_no_step(control: PlaybackControl) -> str:
    return "there is no next message to step to" if control.paused else "single steps are for pauses"


Act = Callable[[PlaybackControl], bool | None]
Answer = Callable[[PlaybackControl, Any, Any], None]


def _is_paused(control: PlaybackControl, _: Any, response: Any) -> None:
    response.paused = control.paused


def _get_rate(control: PlaybackControl, _: Any, response: Any) -> None:
    response.rate = control.rate


def _set_rate(control: PlaybackControl, request: Any, response: Any) -> None:
    response.success = control.set_rate(request.rate)


def _seek(control: PlaybackControl, request: Any, response: Any) -> None:
    response.success = control.seek(request.time.sec * NS_PER_S + request.time.nanosec)


def _play_next(control: PlaybackControl, _: Any, response: Any) -> None:
    response.success = control.play_next()


REQUESTS: dict[str, tuple[str, Answer]] = {
    "pause": ("Pause", lambda control, _, __: control.pause()),
    "resume": ("Resume", lambda control, _, __: control.resume()),
    "toggle_paused": ("TogglePaused", lambda control, _, __: control.toggle_paused()),
    "is_paused": ("IsPaused", _is_paused),
    "set_rate": ("SetRate", _set_rate),
    "get_rate": ("GetRate", _get_rate),
    "seek": ("Seek", _seek),
    "play_next": ("PlayNext", _play_next),
    "stop": ("Stop", lambda control, _, __: control.stop()),
}
"""By name: the type in rosbag2_interfaces/srv, and what fills its response."""

TRIGGERS: dict[str, Act] = {
    "pause": PlaybackControl.pause,
    "resume": PlaybackControl.resume,
    "toggle_paused": PlaybackControl.toggle_paused,
    "play_next": PlaybackControl.play_next,
    "stop": PlaybackControl.stop,
}
