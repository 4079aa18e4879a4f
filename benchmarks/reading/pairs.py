"""Pairs of velocity and friction from a recording into arrays: here, by rosbags' loop and by mcap-ros2-support.

A part of `python benchmarks/bench.py`. Each way opens the file, and its arrays are those of the others to the bit.
"""

import importlib
import importlib.util
from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from measure import cpu_us, in_turn, part
from recordings import driven
from rosbags.highlevel import AnyReader

from friction_estimator.bag.read import read_recording
from friction_estimator.bag.write import write_samples
from friction_estimator.core.sample import NS_PER_S

TOPICS = ("/velocity", "/friction")

Arrays = tuple[np.ndarray, ...]
"""Stamps (ns) and values of the velocity, and of the friction."""


def ours(path: Path) -> Arrays:
    streams = read_recording(path).streams
    return tuple(
        numbers for name in ("velocity", "friction") for numbers in (streams[name].stamp_ns, streams[name].value)
    )


def arrays(messages: Iterable[tuple[str, Any]]) -> Arrays:
    """Return the arrays of topics and decoded messages."""
    stamps: dict[str, list[int]] = {topic: [] for topic in TOPICS}
    values: dict[str, list[float]] = {topic: [] for topic in TOPICS}
    for topic, message in messages:
        stamp = message.header.stamp
        stamps[topic].append(stamp.sec * NS_PER_S + stamp.nanosec)
        values[topic].append(message.twist.linear.x if topic == "/velocity" else message.wrench.force.x)
    return tuple(np.array(column[topic]) for topic in TOPICS for column in (stamps, values))


def of_rosbags(path: Path) -> Arrays:
    """Read as rosbags' documentation reads."""
    with AnyReader([path]) as reader:
        wanted = [connection for connection in reader.connections if connection.topic in TOPICS]
        return arrays(
            (connection.topic, reader.deserialize(raw, connection.msgtype))
            for connection, _, raw in reader.messages(connections=wanted)
        )


def of_mcap_ros2_support(path: Path) -> Arrays:
    """Read as mcap-ros2-support's documentation reads."""
    make_reader = importlib.import_module("mcap.reader").make_reader
    factory = importlib.import_module("mcap_ros2.decoder").DecoderFactory()
    (file,) = path.glob("*.mcap")
    with file.open("rb") as stream:
        decoded = make_reader(stream, decoder_factories=[factory]).iter_decoded_messages(TOPICS)
        return arrays((channel.topic, message) for _, channel, _, message in decoded)


def opened(path: Path) -> None:
    with AnyReader([path]):
        pass


def measured(pairs: int, rounds: int) -> dict[str, Any]:
    installed = importlib.util.find_spec("mcap_ros2") is not None
    found: dict[str, Any] = {}
    with TemporaryDirectory() as scratch:
        for storage in ("mcap", "sqlite3"):
            path = Path(scratch) / storage
            write_samples(path, driven(pairs), storage)
            ways = {"here": ours, "rosbags": of_rosbags}
            if storage == "mcap" and installed:
                ways["mcap-ros2-support"] = of_mcap_ros2_support
            wanted = ours(path)
            for way in ways.values():
                for one, other in zip(way(path), wanted, strict=True):
                    np.testing.assert_array_equal(one, other)
            bodies = {name: (lambda way=way, path=path: way(path)) for name, way in (ways | {"opened": opened}).items()}
            # Each way has run once already: no round is needed to fill the caches.
            found[storage] = in_turn({name: cpu_us(body, pairs) for name, body in bodies.items()}, rounds, unkept=0)
    return {"pairs": pairs, "missing": [] if installed else ["mcap-ros2-support"], "storages": found}


if __name__ == "__main__":
    part(measured, __doc__, pairs=1_000_000, rounds=3)
