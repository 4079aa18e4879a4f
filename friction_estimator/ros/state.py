"""The state file: what the estimator has learned, on disk, whole or not at all.

One JSON document with a checksum over its content; arrays are base64 of their bytes, so that a restored state is
bit-equal. A file is one of ours by its first bytes; nothing else is ever read further, renamed or replaced.
"""

import base64
import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from friction_estimator.core.errors import InputError
from friction_estimator.core.regular_file import open_regular, read_regular
from friction_estimator.core.text import LONGEST_NAME, shown
from friction_estimator.documents.load import Limits, parse_json
from friction_estimator.documents.schema import Schema
from friction_estimator.output.staging import Staging

_FAMILY = "friction_estimator/state/"
FORMAT = f"{_FAMILY}1"
_HEAD = f'{{"format": "{_FAMILY}'.encode()

LIMITS = Limits(size=128 * 2**20, depth=8, nodes=20_000)
"""Of a state: the root of the covariance of 3,400 parameters, and reading it takes less than 1 GB."""

_MOST_ASIDE = 1000
"""Refused files that are kept beside a state file, each under a number of its own."""

_PIECE = 3 * 2**14
"""Bytes of an array that are written at once: a multiple of three, so that base64 goes on without a seam."""

_ARRAY_TYPES = ("float64", "int64", "int32", "bool", "int8")

_VALUE = {
    "type": ["boolean", "number", "string", "array"],
    "description": "a value or a list of values",
    "items": {"type": ["number", "string"], "description": "a value"},
}
_VALUES = {"type": "object", "description": "NAME: VALUE", "additionalProperties": _VALUE}
_ARRAY = {
    "type": "object",
    "description": "an array with its type and shape",
    "required": ["array", "type", "shape"],
    "additionalProperties": False,
    "properties": {
        "array": {"type": "string", "description": "the bytes of an array in base64"},
        "type": {"enum": _ARRAY_TYPES, "description": "a type of numbers"},
        "shape": {
            "type": "array",
            "description": "up to three lengths",
            "maxItems": 3,
            "items": {"type": "integer", "minimum": 0, "maximum": 10**8, "description": "a length"},
        },
    },
}
_DOCUMENT = Schema(
    {
        "type": "object",
        "description": "format, checksum and content of a state",
        "required": ["format", "sha256", "content"],
        "properties": {name: {"type": "string", "description": "text"} for name in ("format", "sha256", "content")},
    }
)
_CONTENT = Schema(
    {
        "type": "object",
        "description": "the state of an estimator",
        "required": ["estimator"],
        "properties": {
            "estimator": {
                "type": "object",
                "description": "the state of an estimator",
                "required": ["version"],
                "properties": {
                    "version": {"type": "integer", "description": "a version"},
                    "structure": _VALUES,
                    "chosen": _VALUES,
                    "arrays": {"type": "object", "description": "arrays by name", "additionalProperties": _ARRAY},
                },
            }
        },
    }
)
"""What a state of the present version must have, and whether it is sound, is said in `core.online.state_check`."""


class Standing(Enum):
    """What stands under the name of a state file."""

    NOTHING = "nothing, or a file without content"
    STATE = "a state file, sound or not"


def standing(path: str | os.PathLike[str]) -> Standing:
    """Return what stands there; raises InputError where that is nothing that this program may replace."""
    try:
        with open_regular(path) as handle:
            head = handle.read(len(_HEAD))
    except InputError as error:
        if isinstance(error.__cause__, FileNotFoundError):
            return Standing.NOTHING
        raise InputError(f"{error}; move it away, or set state.file to another path") from error
    if head and head != _HEAD:
        raise InputError(f"{shown(path)} is no state file; move it away, or set state.file to another path")
    return Standing.STATE if head else Standing.NOTHING


def dumps(state: Mapping[str, Any]) -> bytes:
    """Return the content of the state file for the state of an estimator; raises InputError where it is too large.

    Made in pieces, so that a thread that packs keeps no other waiting for long.
    """
    size = sum(4 * array.nbytes // 3 for array in state.get("arrays", {}).values())
    if size <= LIMITS.size:
        pieces = ['{"estimator":', *_pieces(state), "}"]
        digest = hashlib.sha256()
        for piece in pieces:
            digest.update(piece.encode())
        head = f'{{"format": "{FORMAT}", "sha256": "{digest.hexdigest()}", "content": "'
        # The content is ASCII without control characters: as a JSON string only these two are written otherwise.
        data = b"".join([head.encode(), *(_escaped(piece).encode() for piece in pieces), b'"}'])
        size = len(data)
    if size > LIMITS.size:
        raise InputError(
            f"the state has {size / 2**20:.0f} MiB, more than the {LIMITS.size / 2**20:g} MiB that are read back: "
            "set a larger basis.velocity_unit or basis.finest_level, or model.law to nlms"
        )
    return data


def loads(data: bytes, source: str) -> dict[str, Any]:
    """Return the state of an estimator in a state file's content; raises InputError with the reason."""
    if not data.startswith(_HEAD):
        raise InputError(f"{source} is no state file; move it away, or set state.file to another path")
    try:
        document = parse_json(data, source, LIMITS)
    except InputError as error:
        raise InputError(f"{error}: it is damaged or cut short; delete it to start cold") from None
    _DOCUMENT.check(document, source)
    if document["format"] != FORMAT:
        kind = shown(document["format"], LONGEST_NAME)
        raise InputError(f"{source} has format {kind}, this program reads {FORMAT}; delete it to start cold")
    content = document.pop("content")
    if _checksum(content) != document["sha256"]:
        raise InputError(f"{source} is damaged: its checksum does not fit its content; delete it to start cold")
    inner = parse_json(content.encode(), source, LIMITS)
    del content
    _CONTENT.check(inner, source)
    state: dict[str, Any] = inner["estimator"]
    try:
        if "arrays" in state:
            state["arrays"] = {name: _array(item) for name, item in state["arrays"].items()}
    except ValueError as error:  # base64, or bytes that do not fit the shape
        raise InputError(f"{source} is damaged: {shown(error, LONGEST_NAME)}; delete it to start cold") from None
    return state


def read_state(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a state file; raises InputError with the reason where it cannot be used."""
    standing(path)
    return loads(read_regular(path, LIMITS.size), shown(path))


def write_state(staging: Staging, data: bytes) -> None:
    """Put a state file under its name, on disk, in place of nothing else than a state file.

    Parameters
    ----------
    staging : of the state file, taken. data : of `dumps`.

    Raises InputError where that is impossible; the former file then is what it was.
    """
    standing(staging.target)
    try:
        with staging.file() as part:
            part.write_bytes(data)
    except OSError as error:
        raise InputError(f"cannot write {shown(staging.target)}: {error.strerror}") from error


def set_aside(path: str | os.PathLike[str]) -> Path:
    """Rename a state file that was refused, so that the next save does not destroy the evidence; return its new name.

    Names that are taken stay as they are. The caller holds the lock of the state file. Raises InputError.
    """
    standing(path)
    names = (Path(f"{os.fspath(path)}.refused{number or ''}") for number in range(_MOST_ASIDE))
    aside = next((name for name in names if not os.path.lexists(name)), None)
    if aside is None:
        raise InputError(
            f"{shown(path)} cannot be set aside: {_MOST_ASIDE} refused files are kept beside it; remove some"
        )
    try:
        Path(path).rename(aside)
    except OSError as error:
        raise InputError(f"{shown(path)} cannot be set aside: {error.strerror}") from error
    return aside


def _checksum(content: str) -> str:
    return hashlib.sha256(content.encode()).hexdigest()


def _pieces(value: Any) -> Iterator[str]:
    """Yield the JSON text of a state, in pieces."""
    if isinstance(value, Mapping):
        yield "{"
        for number, (key, item) in enumerate(value.items()):
            yield f"{',' if number else ''}{json.dumps(str(key))}:"
            yield from _pieces(item)
        yield "}"
    elif isinstance(value, np.ndarray):
        data = np.ascontiguousarray(value).tobytes()
        yield '{"array":"'
        for start in range(0, len(data), _PIECE):
            yield base64.b64encode(data[start : start + _PIECE]).decode()
        yield f'","type":"{value.dtype.name}","shape":{json.dumps(value.shape, separators=(",", ":"))}}}'
    else:
        plain = value.item() if isinstance(value, np.generic) else value
        yield json.dumps(plain, separators=(",", ":"), default=np.generic.item)


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"')


def _array(packed: Mapping[str, Any]) -> np.ndarray[Any, Any]:
    data = base64.b64decode(packed["array"], validate=True)
    return np.frombuffer(data, np.dtype(packed["type"])).reshape(packed["shape"]).copy()
