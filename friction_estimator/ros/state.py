"""The state file: what the estimator has learned, on disk, whole or not at all.

One JSON document with a checksum over its content; arrays are base64 of their bytes, so that a restored state
is bit-equal. It is written aside and renamed, so that a node killed at any moment leaves the last complete one.
"""

import base64
import binascii
import contextlib
import hashlib
import json
import os
import shutil
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from friction_estimator.core.errors import InputError
from friction_estimator.output.target import replacing_file

FORMAT = "friction_estimator/state/1"
_ARRAY_TYPES = ("float64", "int64", "int32", "bool", "int8")
_STALE_AFTER_S = 60.0


def dumps(state: Mapping[str, Any]) -> bytes:
    """Return the state file's content."""
    content = json.dumps(_packed(state), separators=(",", ":"))
    return json.dumps({"format": FORMAT, "sha256": _checksum(content), "content": content}).encode()


def loads(data: bytes, source: str) -> dict[str, Any]:
    """Return the state in a state file's content; raises InputError with the reason where it is damaged."""
    try:
        document = json.loads(data)
        kind, checksum, content = (document[key] for key in ("format", "sha256", "content"))
    except (ValueError, TypeError, KeyError):
        raise InputError(f"{source} is no state file or is cut short; delete it to start cold") from None
    if kind != FORMAT:
        raise InputError(f"{source} has format {kind!r}, this program reads {FORMAT!r}")
    if not isinstance(content, str) or _checksum(content) != checksum:
        raise InputError(f"{source} is damaged: its checksum does not fit its content; delete it to start cold")
    try:
        state = _unpacked(json.loads(content))
    except (ValueError, TypeError, KeyError, binascii.Error) as error:
        raise InputError(f"{source} is damaged: {error}") from None
    if not isinstance(state, dict):
        raise InputError(f"{source} is damaged: it holds no state")
    return state


def write_state(path: str | os.PathLike[str], data: bytes) -> None:
    """Write a state file atomically; raises InputError where that is impossible."""
    try:
        with replacing_file(path) as part:
            part.write_bytes(data)
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror}") from error


def read_state(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a state file; raises InputError with the reason where it cannot be used."""
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise InputError(f"cannot read state file {path}: {error.strerror}") from error
    return loads(data, str(path))


def set_aside(path: str | os.PathLike[str]) -> Path:
    """Rename a refused state file, so that the next save does not destroy the evidence; return its new name."""
    aside = Path(f"{path}.refused")
    with contextlib.suppress(OSError):
        Path(path).replace(aside)
    return aside


def sweep(path: str | os.PathLike[str]) -> None:
    """Remove what killed writers of this state file left beside it."""
    target = Path(path)
    for leftover in target.parent.glob(f".{target.name}.*"):
        with contextlib.suppress(OSError):
            if leftover.is_dir() and time.time() - leftover.stat().st_mtime > _STALE_AFTER_S:
                shutil.rmtree(leftover, ignore_errors=True)


def _checksum(content: str) -> str:
    return hashlib.sha256(content.encode()).hexdigest()


def _packed(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _packed(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        data = base64.b64encode(np.ascontiguousarray(value).tobytes()).decode()
        return {"array": data, "type": value.dtype.name, "shape": list(value.shape)}
    if isinstance(value, list | tuple):
        return [_packed(item) for item in value]
    return value.item() if isinstance(value, np.generic) else value


def _unpacked(value: Any) -> Any:
    if isinstance(value, dict):
        if "array" not in value:
            return {key: _unpacked(item) for key, item in value.items()}
        if value["type"] not in _ARRAY_TYPES:
            raise ValueError(f"array of type {value['type']}")
        data = base64.b64decode(value["array"], validate=True)
        return np.frombuffer(data, np.dtype(value["type"])).reshape(value["shape"]).copy()
    if isinstance(value, list):
        return [_unpacked(item) for item in value]
    return value
