"""Git LFS pointers: small texts that stand where a large file was to be, in a clone that did not fetch it."""

import re
from pathlib import Path

from friction_estimator.core.errors import InputError

_MAGIC = b"version https://git-lfs"
_LONGEST = 1024


def check_no_pointer(path: Path) -> None:
    """Raise InputError where a file is a Git LFS pointer, and not what it points to."""
    if not path.is_file() or path.stat().st_size > _LONGEST:
        return
    content = path.read_bytes()
    if content.startswith(_MAGIC):
        size = re.search(rb"^size (\d+)", content, re.MULTILINE)
        meant = f", which has {int(size[1])} bytes" if size else ""
        raise InputError(
            f"{path} is a Git LFS pointer ({len(content)} bytes), not the file itself{meant}: run `git lfs pull` in "
            "that clone, or download the file"
        )
