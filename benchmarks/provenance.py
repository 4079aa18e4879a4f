"""Where a page of figures comes from: the line that every page begins with, and that benchmarks/stale.py reads."""

import subprocess
from pathlib import Path


def line(command: str) -> str:
    """Return "Commit 1a2b3c4, `command`." with a word about changes that are not committed."""
    here = Path(__file__).parent
    commit = _git("rev-parse", "--short", "HEAD", cwd=here).strip()
    # What benchmarks write changes nothing that they measure.
    pages = [f":(exclude,top)benchmarks/*.{kind}" for kind in ("md", "png", "json")]
    changed = _git("status", "--porcelain", "--untracked-files=no", "--", ":/", *pages, cwd=here).strip()
    return f"Commit {commit}{' with changes' if changed else ''}, `{command}`.\n"


def _git(*arguments: str, cwd: Path) -> str:
    return subprocess.run(["git", *arguments], capture_output=True, text=True, check=True, cwd=cwd).stdout
