"""The kinds of files under attack: sound ones to begin with, and what the command line does with them.

A new kind is one entry in `KINDS`.
"""

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
from hard import document_kinds
from hard import mutators as m
from hard.forked_reader import by_forked_reader
from hard.fuzzing import Kind
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.io import savemat

from friction_estimator.bag.read import read_recording
from friction_estimator.bag.serialise import sample_template, typestore
from friction_estimator.bag.write import TOPICS, write_samples
from friction_estimator.cli.main import main
from friction_estimator.cli.terminal import guarded
from friction_estimator.core.model.theory import theory_from_config
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config

_START = 1_700_000_000 * 10**9


def _samples(n: int = 60) -> Samples:
    t = 0.01 * np.arange(n)
    v = 0.1 * np.sin(2 * np.pi * 2.0 * t)
    stamps = _START + 10_000_000 * np.arange(n)
    return Samples(stamps, v, 5.0 * np.tanh(v / 0.01) + 20.0 * v, np.arange(n) == 0, pressure_Pa=np.full(n, 3e5))


def _file(suffix: str) -> Callable[[Path, bytes], Path]:
    def place(folder: Path, data: bytes) -> Path:
        path = folder / f"input{suffix}"
        path.write_bytes(data)
        return path

    return place


def _info(path: Path) -> int:
    return main(["info", str(path)])


def _import(path: Path) -> int:
    columns = ["--time", "t", "--map", "velocity=v,friction=f"]
    return main(["import", str(path), "--out", str(path.parent / "out.mcap"), *columns])


# Recordings


def _recorded(suffix: str, storage: str) -> Callable[[Path], list[bytes]]:
    def seeds(folder: Path) -> list[bytes]:
        write_samples(folder / f"plain{suffix}", _samples(), storage)
        found = [(folder / f"plain{suffix}").read_bytes()]
        if storage == "mcap":
            write = _packed(folder / "packed", StoragePlugin.MCAP, CompressionMode.STORAGE)
            found.append((write / "packed.mcap").read_bytes())
            unindexed = bytearray(found[0])
            unindexed[-28:-12] = bytes(16)  # the footer leads to no summary
            found.append(bytes(unindexed))
        return found

    return seeds


def _packed(path: Path, plugin: StoragePlugin, mode: CompressionMode) -> Path:
    samples = _samples()
    writer = Writer(path, version=9, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        for name, value in (("velocity", samples.velocity_m_s), ("friction", samples.friction_N)):
            topic, kind = TOPICS[name]
            connection = writer.add_connection(topic, kind, typestore=typestore())
            for stamp, row in zip(
                samples.stamp_ns.tolist(), sample_template(kind, ("x",)).rows(samples.stamp_ns, value), strict=True
            ):
                writer.write(connection, stamp, row.tobytes())
    return path


def _ros1(folder: Path) -> list[bytes]:
    store = get_typestore(Stores.ROS1_NOETIC)
    found = []
    samples = _samples()
    for compression in (None, Ros1Writer.CompressionFormat.BZ2, Ros1Writer.CompressionFormat.LZ4):
        path = folder / f"{compression}.bag"
        writer = Ros1Writer(path)
        if compression is not None:
            writer.set_compression(compression)
        with writer:
            for name, value in (("velocity", samples.velocity_m_s), ("friction", samples.friction_N)):
                topic, kind = TOPICS[name]
                connection = writer.add_connection(topic, kind, typestore=store)
                for stamp, number in zip(samples.stamp_ns.tolist(), value.tolist(), strict=True):
                    head = struct.pack("<IIII", 0, stamp // 10**9, stamp % 10**9, 1) + b"x"
                    writer.write(connection, stamp, head + struct.pack("<6d", number, 0, 0, 0, 0, 0))
        found.append(path.read_bytes())
    return found


_FOLDERS: dict[str, dict[str, bytes]] = {}
"""Files beside a metadata.yaml, by what its bytes begin with."""


def _metadata(folder: Path) -> list[bytes]:
    write_samples(folder / "plain", _samples())
    _packed(folder / "file", StoragePlugin.MCAP, CompressionMode.FILE)
    _packed(folder / "message", StoragePlugin.SQLITE3, CompressionMode.MESSAGE)
    for path in folder.glob("*/*"):
        if path.name != "metadata.yaml":
            _FOLDERS.setdefault("files", {})[path.name] = path.read_bytes()
    return [path.read_bytes() for path in sorted(folder.glob("*/metadata.yaml"))]


def _beside_metadata(folder: Path, data: bytes) -> Path:
    (folder / "metadata.yaml").write_bytes(data)
    for name, content in _FOLDERS["files"].items():
        (folder / name).write_bytes(content)
    return folder


# Tables


def _columns() -> dict[str, np.ndarray]:
    samples = _samples()
    t = 0.01 * np.arange(len(samples))
    return {"t": t, "v": samples.velocity_m_s, "f": samples.friction_N, "other": np.arange(len(samples))}


def _csv(folder: Path) -> list[bytes]:
    frame = pd.DataFrame(_columns())
    return [frame.to_csv(index=False, sep=sep).encode() for sep in ",;"] + [
        frame.assign(seal="O-ring").to_csv(index=False).encode()
    ]


def _npz(folder: Path) -> list[bytes]:
    np.savez(folder / "plain.npz", **_columns())
    np.savez_compressed(folder / "packed.npz", **_columns(), matrix=np.eye(3))
    return [path.read_bytes() for path in sorted(folder.glob("*.npz"))]


def _mat(folder: Path) -> list[bytes]:
    savemat(folder / "plain.mat", _columns())
    savemat(folder / "packed.mat", _columns() | {"run": {"a": 1.0, "b": "text"}}, do_compression=True)
    savemat(folder / "v4.mat", _columns(), format="4")
    return [path.read_bytes() for path in sorted(folder.glob("*.mat"))]


def _parquet(folder: Path) -> list[bytes]:
    for compression in ("snappy", "zstd"):
        pd.DataFrame(_columns()).assign(seal="O-ring").to_parquet(
            folder / f"{compression}.parquet", compression=compression
        )
    return [path.read_bytes() for path in sorted(folder.glob("*.parquet"))]


# A theory table


def _theory_seeds(folder: Path) -> list[bytes]:
    head = "velocity_m_s,pressure_Pa,temperature_K,friction_N\n"
    grid = [f"{v},{p},{t},{v * 10 + p * 1e-5}" for v in (-0.1, 0.0, 0.1) for p in (0, 2e5) for t in (290, 330)]
    rng = np.random.default_rng(1)
    loose = [f"{v:.5f},{p + rng.normal() * 1e3:.1f},{300 + rng.normal():.2f},{np.sign(v) * 3 + 9 * v:.4f}"
             for p in (1e5, 3e5) for v in 0.1 * np.sin(0.1 * np.arange(60))]  # fmt: skip
    return [(head + "\n".join(rows) + "\n").encode() for rows in (grid, loose)]


def _theory(path: Path) -> int:
    def body() -> int:
        curve = theory_from_config(Config.from_mapping({"theory.kind": "table", "theory.table": str(path)}))
        assert curve is not None
        v = np.linspace(-0.2, 0.2, 101)
        friction = curve.evaluate(v, np.full(101, 2e5), np.full(101, 25.0))
        assert np.isfinite(friction).all()
        return 0

    return guarded("friction_estimator replay", body)


def _play(path: Path) -> int:
    """Read every stream of a recording, as `replay` does before it computes."""
    return guarded("friction_estimator replay", lambda: 0 * len(read_recording(path).streams))


KINDS: dict[str, Kind] = {
    "mcap": Kind(_recorded(".mcap", "mcap"), _file(".mcap"), _info, (m.mcap_record,)),
    "sqlite3": Kind(_recorded(".db3", "sqlite3"), _file(".db3"), _info, (m.sqlite_page,)),
    "ros1": Kind(_ros1, _file(".bag"), _info, (m.ros1_field,)),
    "metadata": Kind(_metadata, _beside_metadata, _play, (m.text_token, m.text_line)),
    "csv": Kind(_csv, _file(".csv"), _import, (m.table_cell, m.text_line, m.text_token)),
    "npz": Kind(_npz, _file(".npz"), _import, (m.npz_member,)),
    "mat": Kind(_mat, _file(".mat"), by_forked_reader(_import), (m.mat_element,)),
    "mat_as_it_is": Kind(_mat, _file(".mat"), _import, (m.mat_element,)),
    "parquet": Kind(_parquet, _file(".parquet"), by_forked_reader(_import), (m.parquet_footer,)),
    "parquet_as_it_is": Kind(_parquet, _file(".parquet"), _import, (m.parquet_footer,)),
    "theory": Kind(_theory_seeds, _file(".csv"), _theory, (m.table_cell, m.text_line, m.text_token)),
    **document_kinds.KINDS,
}

SLOW = frozenset({"mat_as_it_is", "parquet_as_it_is"})
"""Each input of these starts an interpreter."""
