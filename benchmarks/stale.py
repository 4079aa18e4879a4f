"""List pages of figures that are older than the rooms they measure: `make stale`.

A page names the commit it was measured at in its first lines ("Commit 1a2b3c4, `command`."). It is stale where a file
of its rooms changed in a later commit. Pages without a commit are listed as such.
"""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

CORE = "friction_estimator/core"
ROOMS = {
    "benchmarks/transfer/README.md": [CORE, "friction_estimator/rig", "benchmarks/transfer"],
    "benchmarks/transfer/prior_study.md": [f"{CORE}/fit", f"{CORE}/model", "friction_estimator/rig"],
    "benchmarks/identification/README.md": [CORE, "friction_estimator/rig", "benchmarks/identification"],
    "benchmarks/robustness/table_20000.md": [f"{CORE}/online", f"{CORE}/model", "benchmarks/robustness"],
    "benchmarks/kernels/table.md": [f"{CORE}/online", f"{CORE}/model", "benchmarks/kernels"],
    "benchmarks/node/table.md": ["friction_estimator/ros", f"{CORE}/online", "benchmarks/node"],
    "benchmarks/diagnosis/README.md": ["friction_estimator/diagnosis", "friction_estimator/effects"],
    "benchmarks/load/README.md": [
        f"{CORE}/model",
        f"{CORE}/fit",
        f"{CORE}/intake",
        f"{CORE}/online",
        "benchmarks/load",
    ],
    "docs/paper.md": ["friction_estimator/paper", f"{CORE}/online", f"{CORE}/fit"],
}
"""Page of figures: what its figures are about. A change of the page itself does not make it stale."""

HEAD_LINES = 8


def git(*arguments: str) -> str:
    return subprocess.run(["git", *arguments], capture_output=True, text=True, check=True, cwd=ROOT).stdout


def verdict(page: str, rooms: list[str]) -> str | None:
    """Return why a page is stale, or None."""
    path = ROOT / page
    if not path.exists():
        return "is missing"
    head = "\n".join(path.read_text(encoding="utf-8").splitlines()[:HEAD_LINES])
    named = re.search(r"[Cc]ommit `?([0-9a-f]{7,40})", head)
    if named is None:
        return "names no commit"
    try:
        changed = git("diff", "--name-only", named[1], "HEAD", "--", *rooms).split()
    except subprocess.CalledProcessError:
        return f"was measured at {named[1]}, which is not in this repository"
    changed = [name for name in changed if not name.endswith(".md")]
    return (
        f"was measured at {named[1]}; since then {len(changed)} files changed, {changed[0]} first" if changed else None
    )


def main() -> int:
    for page, rooms in ROOMS.items():
        reason = verdict(page, rooms)
        if reason:
            print(f"{page} {reason}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
