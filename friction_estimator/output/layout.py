"""What a folder of results holds, so that one of ours is told from a user's and nothing put into it is lost."""

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from friction_estimator.output.staging import Refusal

_HEAD = 200
"""Bytes at the start of a document in which its mark stands."""


@dataclass(frozen=True)
class Layout:
    """A folder of results as a verb writes it.

    Attributes
    ----------
    document : file that every such folder has, and that says whose it is.
    mark : what that file begins with.
    files : names of the other files that may be in it.
    folders : names of folders that may be in it, and what refuses to replace each.
    other_folders : what refuses to replace a folder of any other name; None where there may be none.
    """

    document: str
    mark: re.Pattern[str]
    files: frozenset[str] = frozenset()
    folders: Mapping[str, Refusal] = field(default_factory=dict)
    other_folders: Refusal | None = None

    def refusal(self, folder: Path) -> str | None:
        """Return why a folder may not be replaced by such results; None where it holds them, or nothing."""
        inside = sorted(folder.iterdir())
        if not inside:
            return None
        if not self.is_of(folder):
            return "a folder that does not hold such results stands there; choose another --out"
        for item in inside:
            reason: str | None = strange(item)
            known = self.folders.get(item.name, self.other_folders)
            if known is not None and item.is_dir() and not item.is_symlink():
                reason = known(item)
            elif (item.name == self.document or item.name in self.files) and _is_plain(item):
                reason = None
            if reason is not None:
                return reason
        return None

    def is_of(self, folder: Path) -> bool:
        """Whether a folder says of itself that it holds such results."""
        path = folder / self.document
        if not _is_plain(path):
            return False
        with path.open("rb") as file:
            return self.mark.match(file.read(_HEAD).decode("utf-8", "replace")) is not None


def only(stems: Collection[str], suffixes: Collection[str]) -> Refusal:
    """Return what refuses a folder that holds anything else than files of these names."""

    def refusal(folder: Path) -> str | None:
        for item in sorted(folder.iterdir()):
            if not _is_plain(item) or item.stem not in stems or item.suffix not in suffixes:
                return strange(item)
        return None

    return refusal


def _is_plain(path: Path) -> bool:
    return path.is_file() and not path.is_symlink()


def strange(item: Path) -> str:
    """Return why a folder with this in it is not replaced."""
    return f"{item} is not part of the results; move it out, or choose another --out"
