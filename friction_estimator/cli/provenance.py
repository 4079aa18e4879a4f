"""Where a page comes from: the command, the recordings' hashes, the versions, the date and what was configured."""

import hashlib
import platform
import shlex
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from friction_estimator.core.settings.config import PARAMETERS, Config
from friction_estimator.report.page.content import Section

LIBRARIES = ("friction_estimator", "numpy", "scipy", "numba", "PyWavelets", "rosbags", "matplotlib", "bokeh")

MOST_HASHED = 4 << 30
"""Bytes of a recording that are hashed: a larger one is named by its size only."""


def provenance(words: Sequence[str], recordings: Iterable[Path], config: Config | None) -> list[Section]:
    """Return the sections: what made the page, and every setting that is not the default.

    Parameters
    ----------
    words : the command line.
    recordings : what was read. config : what ran; None where there is none.
    """
    rows: list[Sequence[object]] = [("", "")]
    rows.append(("command", shlex.join(words)))
    rows.append(("date", datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S UTC")))
    versions = [f"{name} {known}" for name in LIBRARIES if (known := _version(name))]
    rows.append(("versions", f"Python {platform.python_version()}, " + ", ".join(versions)))
    for recording in recordings:
        rows += [(f"sha256 of {file.name}", digest) for file, digest in hashes(recording)]
    sections = [Section("Where this page comes from", table=rows)]
    if config is not None:
        changed = [
            (name, _told(item.of(config)), config.quantities.si.unit(item.unit) if item.of_drive else item.unit)
            for name, item in PARAMETERS.items()
            if item.of(config) != item.default and not name.startswith("learned.")
        ]
        table: list[Sequence[object]] = [("parameter", "value", "unit"), *changed]
        text = "What differs from the defaults; values that were learned are in config.yaml beside this page."
        sections.append(Section("Configuration", [text], table if changed else (), folded=True))
    return sections


def hashes(recording: Path) -> list[tuple[Path, str]]:
    """Return each file of a recording with its SHA-256, as `sha256sum` prints it."""
    files = sorted(recording.iterdir()) if recording.is_dir() else [recording]
    return [(file, _hash(file)) for file in files if file.is_file()]


def _hash(file: Path) -> str:
    try:
        size = file.stat().st_size
        if size > MOST_HASHED:
            return f"not computed ({size} bytes)"
        with file.open("rb") as opened:
            return hashlib.file_digest(opened, "sha256").hexdigest()
    except OSError as error:
        return f"not computed ({error.strerror})"


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _told(value: object) -> str:
    if isinstance(value, tuple):
        told = ", ".join(f"{x:.6g}" if isinstance(x, float) else str(x) for x in value[:8])
        return f"[{told}{f', ... of {len(value)}' if len(value) > 8 else ''}]"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
