"""Start-up: imports and verbs beside the import of rosbags and numpy, by processor time.

A part of `python benchmarks/bench.py`.
"""

import sys
from typing import Any

from measure import DEMO, PROGRAM, child, columns, in_turn, part

COMMANDS = {
    "import rosbags.highlevel, numpy": [sys.executable, "-c", "import rosbags.highlevel, numpy"],
    "import friction_estimator": [sys.executable, "-c", "import friction_estimator"],
    "import numba": [sys.executable, "-c", "import numba"],
    "--help": [*PROGRAM, "--help"],
    "info of bags/demo": [*PROGRAM, "info", str(DEMO)],
    "replay of bags/demo": [*PROGRAM, "replay", str(DEMO)],
}


def measured(rounds: int) -> dict[str, Any]:
    found = in_turn({name: (lambda words=words: child(words)) for name, words in COMMANDS.items()}, rounds)
    return {"commands": {name: columns(costs) for name, costs in found.items()}}


if __name__ == "__main__":
    part(measured, __doc__, rounds=9)
