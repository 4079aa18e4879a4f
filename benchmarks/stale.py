"""List pages of figures that are older than the rooms they measure: `make stale`.

A page names the commit it was measured at in its first lines ("Commit 1a2b3c4, `command`."), or each of its sections
does. It is stale where a file of its rooms changed in a later commit. What names no commit is listed as such.
"""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

CORE = "friction_estimator/core"
KERNELS = [f"{CORE}/online", f"{CORE}/model", "benchmarks/kernels"]
NODE = ["friction_estimator/ros", f"{CORE}/online", "benchmarks/node"]

ROOMS: dict[str, list[str] | dict[str, list[str]]] = {
    "benchmarks/transfer/README.md": [CORE, "friction_estimator/rig", "benchmarks/transfer"],
    "benchmarks/transfer/prior_study.md": [f"{CORE}/fit", f"{CORE}/model", "friction_estimator/rig"],
    "benchmarks/identification/README.md": [CORE, "friction_estimator/rig", "benchmarks/identification"],
    "benchmarks/robustness/table_20000.md": [f"{CORE}/online", f"{CORE}/model", "benchmarks/robustness"],
    "benchmarks/README.md": {
        "A sample beside C": KERNELS,
        "A sample in Python": KERNELS,
        "Weights and taps": KERNELS,
        "Reading": ["friction_estimator/bag", "benchmarks/reading"],
        "Long recordings": [
            "friction_estimator/bag",
            "friction_estimator/output",
            f"{CORE}/intake",
            f"{CORE}/online",
            f"{CORE}/fit",
            "benchmarks/reading",
        ],
        "Start-up": ["friction_estimator/cli", "friction_estimator/bag", "benchmarks/reading"],
        "The node's start": NODE,
        "The node beside echo nodes": NODE,
        "The node's latency": NODE,
        "Many recordings, many settings": [
            "friction_estimator/tasks",
            "friction_estimator/sweep",
            "friction_estimator/fleet",
            "benchmarks/many",
        ],
    },
    "benchmarks/node/table.md": NODE,
    "benchmarks/diagnosis/README.md": ["friction_estimator/diagnosis", "friction_estimator/effects"],
    "benchmarks/diagnosis/measured.md": ["friction_estimator/diagnosis", "friction_estimator/effects"],
    "benchmarks/load/README.md": [
        f"{CORE}/model",
        f"{CORE}/fit",
        f"{CORE}/intake",
        f"{CORE}/online",
        "benchmarks/load",
    ],
    "docs/paper.md": ["friction_estimator/paper", f"{CORE}/online", f"{CORE}/fit"],
}
"""Page of figures: what its figures are about, or each of its sections. A change of the page is none of these."""

HEAD_LINES = 8

COMMIT = re.compile(r"[Cc]ommit `?([0-9a-f]{7,40})")


def git(*arguments: str) -> str:
    return subprocess.run(["git", *arguments], capture_output=True, text=True, check=True, cwd=ROOT).stdout


def measurements(text: str) -> list[tuple[str, str | None]]:
    """Return what a page was measured at: (section, commit); one for the whole page where its head names a commit."""
    parts = re.split(r"^## (.*)\n", text, flags=re.MULTILINE)
    sections = list(zip(parts[1::2], parts[2::2], strict=True))
    head = commit_of(text)
    if head is not None or not any(commit_of(body) for _, body in sections):
        return [("", head)]
    return [(title, commit_of(body)) for title, body in sections]


def commit_of(text: str) -> str | None:
    named = COMMIT.search("\n".join(text.splitlines()[:HEAD_LINES]))
    return named[1] if named else None


def verdict(commit: str | None, rooms: list[str]) -> str | None:
    """Return why figures that were measured at a commit are stale, or None."""
    if commit is None:
        return "names no commit"
    try:
        changed = git("diff", "--name-only", commit, "HEAD", "--", *rooms).split()
    except subprocess.CalledProcessError:
        return f"was measured at {commit}, which is not in this repository"
    changed = [name for name in changed if not name.endswith(".md")]
    return f"was measured at {commit}; since then {len(changed)} files changed, {changed[0]} first" if changed else None


def main() -> int:
    for page, rooms in ROOMS.items():
        path = ROOT / page
        if not path.exists():
            print(f"{page} is missing")
            continue
        for section, commit in measurements(path.read_text(encoding="utf-8")):
            reason = verdict(commit, rooms[section] if isinstance(rooms, dict) else rooms)
            if reason:
                print(f"{page}{f', {section},' if section else ''} {reason}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
