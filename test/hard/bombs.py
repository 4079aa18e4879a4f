"""Small files that unpack to gigabytes, of every kind that is read."""

import struct
import zipfile
from pathlib import Path

import lz4.frame
import numpy as np
import pyarrow as pa
import yaml
from backports import zstd
from pyarrow import parquet

_MAGIC = b"\x89MCAP0\r\n"
_STEP = 1 << 24


def zeros(size: int, compression: str, first: bytes = b"") -> bytes:
    """Return zeros, packed without ever being in memory at once."""
    packer = zstd.ZstdCompressor() if compression == "zstd" else lz4.frame.LZ4FrameCompressor()
    packed = packer.begin() if compression == "lz4" else b""
    packed += packer.compress(first)
    for _ in range(size // _STEP):
        packed += packer.compress(bytes(_STEP))
    return packed + packer.flush()


def mcap_chunk(path: Path, size: int, compression: str, *, declared: int | None = None, indexed: bool = True) -> None:
    """Write a recording of one velocity topic whose only chunk unpacks to `size` bytes of zeros behind a message."""
    message = _record(0x05, struct.pack("<HIQQ", 1, 0, 1, 1) + b"\0\1\0\0" + bytes(64))
    topics = [(1, "/velocity", "geometry_msgs/msg/TwistStamped"), (2, "/friction", "geometry_msgs/msg/WrenchStamped")]
    schemas = b"".join(
        _record(3, struct.pack("<H", k) + _text(kind) + _text("ros2msg") + _text("")) for k, _, kind in topics
    )
    channels = b"".join(
        _record(4, struct.pack("<HH", k, k) + _text(name) + _text("cdr") + struct.pack("<I", 0))
        for k, name, _ in topics
    )
    packed = zeros(size, compression, message)
    head = struct.pack("<QQQI", 1, 1, declared or size + len(message), 0) + _text(compression)
    chunk = _record(6, head + struct.pack("<Q", len(packed)) + packed)
    index = b"".join(_record(7, struct.pack("<HIQQ", k, 16, 1, 0)) for k, _, _ in topics)
    start = _MAGIC + _record(1, _text("ros2") + _text("test"))
    where = len(start) + len(chunk)
    places = struct.pack("<HQHQ", 1, where, 2, where + len(index) // 2)
    about = struct.pack("<QQQQI", 1, 1, len(start), len(chunk), len(places)) + places + struct.pack("<Q", len(index))
    about += _text(compression) + struct.pack("<QQ", len(packed), declared or size)
    counts = struct.pack("<QHIIIIQQI", 2, 2, 2, 0, 0, 1, 1, 1, 20) + struct.pack("<HQHQ", 1, 1, 2, 1)
    data = (
        start + (chunk if indexed else schemas + channels + chunk) + (index if indexed else b"") + _record(15, bytes(4))
    )
    summary = schemas + channels + _record(8, about) + _record(11, counts) if indexed else b""
    footer = struct.pack("<QQI", len(data) if indexed else 0, 0, 0)
    path.write_bytes(data + summary + _record(2, footer) + _MAGIC)


def _record(code: int, body: bytes) -> bytes:
    return struct.pack("<BQ", code, len(body)) + body


def _text(text: str) -> bytes:
    return struct.pack("<I", len(text)) + text.encode()


def packed_file(folder: Path, size: int) -> None:
    """Write a recording whose only file is packed whole and unpacks to `size` zeros."""
    folder.mkdir()
    (folder / "run.mcap.zstd").write_bytes(zeros(size, "zstd", _MAGIC))
    topic = {"name": "/velocity", "type": "geometry_msgs/msg/TwistStamped", "serialization_format": "cdr"}
    about = {
        "version": 9,
        "storage_identifier": "mcap",
        "relative_file_paths": ["run.mcap.zstd"],
        "duration": {"nanoseconds": 1},
        "starting_time": {"nanoseconds_since_epoch": 1},
        "message_count": 1,
        "compression_format": "zstd",
        "compression_mode": "FILE",
        "topics_with_message_count": [{"topic_metadata": topic, "message_count": 1}],
    }
    (folder / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": about}))


def table(path: Path, rows: int, *, mapped: bool) -> None:
    """Write a packed table of short columns t, v, f and a column of `rows` zeros, which is v where it is mapped."""
    columns = {name: np.arange(9.0) for name in "tvf"}
    large = "v" if mapped else "unmapped"
    if path.suffix == ".npz":
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, values in columns.items():
                if name != large:
                    with archive.open(f"{name}.npy", "w") as file:
                        np.lib.format.write_array(file, values)
            with archive.open(f"{large}.npy", "w", force_zip64=True) as file:
                head = {"descr": "<f8", "fortran_order": False, "shape": (rows,)}
                np.lib.format.write_array_header_1_0(file, head)
                for _ in range(8 * rows // _STEP):
                    file.write(bytes(_STEP))
    elif path.suffix == ".parquet":
        # One row group of 9 rows: the large column holds its zeros as lists of bytes in one page.
        cells = pa.array([bytes(8 * rows // 9)] * 9)
        parquet.write_table(pa.table(columns | {large: cells}), path, compression="zstd", use_dictionary=False)
    else:
        from scipy.io import savemat

        savemat(path, columns | {large: np.zeros(rows)}, do_compression=True)
