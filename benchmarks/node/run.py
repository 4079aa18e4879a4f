"""Everything that table.md says, measured again, one script after the other; each section names the commit.

python benchmarks/node/run.py [SCRIPT...]

Some 25 minutes on a quiet machine; `python benchmarks/node/run.py latency` alone takes 5.
"""

import subprocess
import sys

from common import HERE

SCRIPTS = ("start", "pairs", "latency", "curve", "joint_state", "endurance", "endings", "faults")


def main() -> None:
    for name in sys.argv[1:] or SCRIPTS:
        subprocess.run([sys.executable, str(HERE / f"{name}.py")], check=True)


if __name__ == "__main__":
    main()
