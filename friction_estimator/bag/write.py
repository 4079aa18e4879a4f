"""Write recordings: samples and results from arrays, inputs as they were recorded.

A recording is built aside and put under its name when it is complete; within a set of files that is itself built aside
it is written in place (`written`).
"""

import sqlite3
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, Writer

from friction_estimator.bag.merge import in_order, merged_parts, recorded_order
from friction_estimator.bag.own import MARK, OUTPUT_PREFIX, refusal
from friction_estimator.bag.serialise import Template, array_template, sample_template, typestore
from friction_estimator.bag.source import Source
from friction_estimator.core.errors import InputError
from friction_estimator.core.quantities import LINEAR
from friction_estimator.core.sample import Ints, Samples
from friction_estimator.core.series import Series
from friction_estimator.core.text import is_utf8
from friction_estimator.output.staging import Refusal
from friction_estimator.output.target import Target

STORAGES = ("mcap", "sqlite3")

TOPICS = {
    "velocity": ("/velocity", "geometry_msgs/msg/TwistStamped"),
    "friction": ("/friction", "geometry_msgs/msg/WrenchStamped"),
    "pressure": ("/pressure", "sensor_msgs/msg/FluidPressure"),
    "temperature": ("/temperature", "sensor_msgs/msg/Temperature"),
    "position": ("/position", "sensor_msgs/msg/JointState"),
}
"""Topic and type of each input where nothing else is asked for."""

JOINT = "shaft"

_SUFFIXES = {".mcap": "mcap", ".db3": "sqlite3"}
_PLUGINS = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}

_BLOCK = 32768
"""Messages of a topic serialised at a time, at the most: bounds the memory of a long recording."""

_METADATA_VERSION: Literal[8] = 8
"""Version 9 changed the form of the QoS profiles, which are empty here; older ROS 2 releases read 8."""

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class _Pending:
    connection: Connection
    template: Template
    log_time_ns: Ints
    stamp_ns: Ints
    values: tuple[Series, ...]


class RecordingWriter:
    """Collects streams and writes them, merged by time, when it is closed; made by `writing`."""

    def __init__(self, writer: Writer, where: str, progress: Progress | None) -> None:
        self._writer, self._where, self._progress = writer, where, progress
        self._pending: list[_Pending] = []

    def add_stream(
        self,
        topic: str,
        message_type: str,
        stamp_ns: Ints,
        value: Series | Mapping[str, Series],
        *,
        quantity: str = "friction",
        log_time_ns: Ints | None = None,
        frame_id: str = "",
        joint: str = JOINT,
        axis: str = "x",
        motion: str = LINEAR,
    ) -> None:
        """Add one topic.

        Parameters
        ----------
        topic, message_type : the type one of `messages.EXTRACTORS`.
        stamp_ns : (n,) header stamps, ns; unstamped types have them as time of recording only.
        value : (n,) in SI units, NaN allowed; or several of them by quantity, for a JointState.
        quantity : what `value` is, one of `messages.INPUTS`, where it is one array.
        log_time_ns : (n,) time of recording; the stamps unless given.
        frame_id, joint, axis : where the type has them.
        motion : "linear" or "rotary": of a rotary drive a twist is angular, and a wrench a torque.
        """
        by_quantity = value if isinstance(value, Mapping) else {quantity: value}
        template = sample_template(
            message_type, tuple(by_quantity), frame_id=frame_id, joint=joint, axis=axis, motion=motion
        )
        self._add(topic, template, stamp_ns, log_time_ns, *by_quantity.values())

    def add_array(self, topic: str, label: str, log_time_ns: Ints, values: NDArray[np.float64]) -> None:
        """Add a topic of Float64MultiArray: `values` is (n, size), `label` names the dimension."""
        template = array_template(label, values.shape[1])
        self._add(topic, template, log_time_ns, None, *values.T)

    def copy(self, source: Source, topics: Mapping[str, str] | list[str]) -> None:
        """Copy topics message by message; those of ROS 1 are translated. Written before all streams.

        Parameters
        ----------
        source : an open recording.
        topics : names, or a mapping from old to new name.

        Raises InputError where the source is damaged.
        """
        renamed = dict(topics) if isinstance(topics, Mapping) else {name: name for name in topics}
        kinds = {topic.name: topic.message_type for topic in source.topics}
        connections = {name: self._connection(new, kinds[name]) for name, new in renamed.items()}
        total = sum(topic.count for topic in source.topics if topic.name in renamed)
        for name, log_times, messages in source.batches(renamed):
            connection = connections[name]
            raws: Sequence[bytes | memoryview] = _views(messages) if isinstance(messages, np.ndarray) else messages
            for log_time, raw in zip(log_times.tolist(), raws, strict=True):
                data = typestore().ros1_to_cdr(raw, kinds[name]) if source.ros1 else raw
                self._writer.write(connection, log_time, data)
            if self._progress is not None:
                self._progress(len(messages), total)

    def _connection(self, topic: str, message_type: str) -> Connection:
        return self._writer.add_connection(topic, message_type, typestore=typestore())

    def _add(self, topic: str, template: Template, stamp_ns: Ints, log_time_ns: Ints | None, *values: Series) -> None:
        log_time_ns = stamp_ns if log_time_ns is None else log_time_ns
        if np.any(log_time_ns < 0):
            raise InputError(f"cannot write {topic} to {self._where}: a time of recording is before 1970")
        if not in_order(log_time_ns):
            order = recorded_order(log_time_ns)
            log_time_ns, stamp_ns = log_time_ns[order], stamp_ns[order]
            values = tuple(value[:][order] for value in values)
        connection = self._connection(topic, template.message_type)
        self._pending.append(_Pending(connection, template, log_time_ns, stamp_ns, values))

    def finish(self) -> None:
        """Write the streams, merged by time of recording; at equal times in the order in which they were added."""
        streams, self._pending = self._pending, []
        if not streams:
            return
        total = sum(item.log_time_ns.size for item in streams)
        for parts in merged_parts([item.log_time_ns for item in streams], _BLOCK):
            waiting = []
            for item, part in zip(streams, parts, strict=True):
                rows = item.template.rows(item.stamp_ns[part], *(value[part] for value in item.values))
                waiting.append(zip(item.log_time_ns[part].tolist(), _views(rows), strict=True))
            number = np.repeat(np.arange(len(streams)), [part.stop - part.start for part in parts])
            number = number[
                recorded_order(*(item.log_time_ns[part] for item, part in zip(streams, parts, strict=True)))
            ]
            for own in number.tolist():
                log_time, raw = next(waiting[own])
                self._writer.write(streams[own].connection, log_time, raw)
            if self._progress is not None:
                self._progress(number.size, total)


def _views(rows: NDArray[np.uint8]) -> list[memoryview]:
    """Return each row's bytes without copying them one by one."""
    whole, length = memoryview(np.ascontiguousarray(rows).tobytes()), rows.shape[1]
    return [whole[start : start + length] for start in range(0, len(whole), length)]


@contextmanager
def writing(
    path: str | PathLike[str], storage: str | None = None, progress: Progress | None = None
) -> Iterator[RecordingWriter]:
    """Yield a writer; the recording appears under `path` when the block ends well, and not at all otherwise.

    Parameters
    ----------
    path : folder of the recording (an older one from here is replaced), or a bare .mcap or .db3 file.
    storage : "mcap" or "sqlite3"; unless given by the file's name, mcap.
    progress : told of the messages written.

    Raises
    ------
    InputError : `path` cannot be written, or what stands there was not written by this program.
    """
    kind = storage_of(path, storage)
    with Target(path, refusal_at(path)) as target, target.part() as part, written(part, kind, progress) as writer:
        yield writer


def refusal_at(path: str | PathLike[str]) -> Refusal | None:
    """Return what keeps a folder that is not ours where a recording is to be written; None for a bare file."""
    return None if Path(path).suffix in _SUFFIXES else refusal


def storage_of(path: str | PathLike[str], storage: str | None = None) -> str:
    """Return the storage of a recording: as asked for, else by its name, else mcap.

    Raises InputError where what is asked for contradicts the name, or where metadata.yaml cannot hold the name.
    """
    if not is_utf8(Path(path).name):
        raise InputError(
            f"cannot write {path}: its name stands in the recording, as UTF-8, which it is not; choose another name"
        )
    by_name = _SUFFIXES.get(Path(path).suffix)
    if storage is not None and by_name not in (None, storage):
        raise InputError(f"cannot write {path} as {storage}: its name says {by_name}; choose another name")
    return storage or by_name or "mcap"


@contextmanager
def written(path: Path, storage: str = "mcap", progress: Progress | None = None) -> Iterator[RecordingWriter]:
    """Yield a writer of a new recording at `path`, a folder or a bare .mcap or .db3 file; nothing stands there yet.

    Raises InputError where it cannot be written.
    """
    folder = path if path.suffix not in _SUFFIXES else path.with_suffix(".parts")
    try:
        with Writer(folder, version=_METADATA_VERSION, storage_plugin=_PLUGINS[storage]) as writer:
            writer.set_custom_data(*MARK)
            recording = RecordingWriter(writer, path.name, progress)
            yield recording
            recording.finish()
    except sqlite3.Error as error:
        raise InputError(f"cannot write {path.name}: {error}; choose another place") from error
    if folder != path:
        (folder / f"{folder.name}{path.suffix}").rename(path)


def write_samples(
    path: str | PathLike[str],
    samples: Samples,
    storage: str | None = None,
    *,
    motion: str = LINEAR,
    frame_id: str = "",
    progress: Progress | None = None,
) -> None:
    """Write samples as a recording on the default topics, one message a sample and recorded channel.

    NaN in velocity or friction is written; a channel's NaN (no value yet) is not. Of a rotary `motion` they
    are written as angular velocity and torque, by which they are known again. Raises InputError as `writing`.
    """
    with writing(path, storage, progress) as writer:
        add_samples(writer, samples, motion=motion, frame_id=frame_id)


def add_samples(writer: RecordingWriter, samples: Samples, *, motion: str = LINEAR, frame_id: str = "") -> None:
    """Add the default topics of `samples` to a recording (see `write_samples`)."""
    # What a sample needs is recorded before what completes it.
    channels = {
        "pressure": samples.pressure_Pa,
        "temperature": samples.temperature_degC,
        "position": samples.position_m,
        "velocity": samples.velocity_m_s,
        "friction": samples.friction_N,
    }
    for name, value in channels.items():
        if value is None:
            continue
        known = np.ones(len(samples), np.bool_) if name in ("velocity", "friction") else ~np.isnan(value)
        if known.any():
            topic, kind = TOPICS[name]
            stamps = samples.stamp_ns[known]
            writer.add_stream(topic, kind, stamps, value[known], quantity=name, frame_id=frame_id, motion=motion)


def add_results(
    writer: RecordingWriter,
    stamp_ns: Ints,
    predicted_N: Series,
    residual_N: Series,
    parameters: Mapping[str, tuple[Ints, NDArray[np.float64]]] | None = None,
    *,
    log_time_ns: Ints | None = None,
    frame_id: str = "",
    axis: str = "x",
    motion: str = LINEAR,
) -> None:
    """Add the estimator's outputs under the names of the node's topics.

    Parameters
    ----------
    stamp_ns, predicted_N, residual_N : (n,), of the samples that they belong to; residual is measured - predicted.
    parameters : by name (fir_taps, theory_taps, wavelet_weights): times of recording (m,) and values (m, size).
    log_time_ns : (n,) time of recording; the stamps unless given.
    axis, motion : as the inputs have them: of a rotary drive the outputs are torques.
    """
    for name, value in (("friction_predicted", predicted_N), ("residual", residual_N)):
        writer.add_stream(
            f"{OUTPUT_PREFIX}/{name}",
            "geometry_msgs/msg/WrenchStamped",
            stamp_ns,
            value,
            log_time_ns=log_time_ns,
            frame_id=frame_id,
            axis=axis,
            motion=motion,
        )
    for name, (times, values) in (parameters or {}).items():
        if values.shape[1]:
            writer.add_array(f"{OUTPUT_PREFIX}/parameters/{name}", name, times, values)
