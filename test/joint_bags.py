"""Recordings of robots with several joints, for tests: JointState messages as drivers write them, good and bad."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer

from friction_estimator.bag.serialise import JOINT_STATE, typestore

Message = tuple[Sequence[str], Sequence[float], Sequence[float], Sequence[float]]
"""Names, positions, velocities, efforts."""

NS = 1_000_000_000
START = 1_700_000_000 * NS


def joint_state(stamp_ns: int, names: Sequence[str], *arrays: Sequence[float]) -> bytes:
    """Return a serialised JointState."""
    types = typestore().types
    stamp = types["builtin_interfaces/msg/Time"](stamp_ns // NS, stamp_ns % NS)
    header = types["std_msgs/msg/Header"](stamp, "base")
    message = types[JOINT_STATE](header, list(names), *(np.array(each, float) for each in arrays))
    return bytes(typestore().serialize_cdr(message, JOINT_STATE))


def write_joint_bag(
    path: Path,
    topics: dict[str, Iterable[Message]],
    rate_hz: float = 100.0,
    storage: str = "mcap",
    stamps: Sequence[int] | None = None,
) -> Path:
    """Write JointState topics, each message one period after the one before, or at the given stamps (ns)."""
    plugin = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}[storage]
    with Writer(path, version=8, storage_plugin=plugin) as writer:
        for topic, messages in topics.items():
            connection = writer.add_connection(topic, JOINT_STATE, typestore=typestore())
            for k, message in enumerate(messages):
                stamp = START + round(k * NS / rate_hz) if stamps is None else stamps[k]
                writer.write(connection, stamp, joint_state(stamp, *message))
    return path


def friction_of(velocity: Any) -> Any:
    """Return a Stribeck-like friction, N m, at velocities in rad/s."""
    return 2.0 * np.tanh(velocity / 0.02) * (0.7 + 0.3 * np.exp(-np.abs(velocity) / 0.1)) + 0.8 * velocity


NAMES = ("arm/elbow", "stuck", "wrist ä", "parked", "blind", "tool")


def robot(seconds: float = 20.0, rate_hz: float = 100.0, seed: int = 0, names: Sequence[str] = NAMES) -> list[Message]:
    """Return an arm of six joints as a user finds it: two move, two stand still, one lacks effort, one velocity.

    `arm/elbow` and `wrist ä` are sound, `stuck` and `parked` never move (the latter's encoder is noisy), `blind` has
    NaN for its effort, and the last one, `tool`, has neither position nor velocity: these arrays are one value short.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * rate_hz)) / rate_hz
    velocity = np.zeros((t.size, 6))
    velocity[:, 0] = 1.2 * np.sin(2 * np.pi * 0.5 * t)
    velocity[:, 2] = 3.0 * np.sin(2 * np.pi * 0.4 * t)
    velocity[:, 3] = 1e-4 * rng.standard_normal(t.size)
    velocity[:, 4] = velocity[:, 0]
    effort = friction_of(velocity) + 0.02 * rng.standard_normal((t.size, 6))
    effort[:, 2] *= 0.1
    effort[:, 4] = np.nan
    position = np.cumsum(velocity, axis=0) / rate_hz
    return [
        (names, p[:5], v[:5], e) for p, v, e in zip(position.tolist(), velocity.tolist(), effort.tolist(), strict=True)
    ]
