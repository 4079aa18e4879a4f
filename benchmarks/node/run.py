"""What table.md says, measured again, one script after the other; each section names the commit.

python benchmarks/node/run.py [SCRIPT...]

Some 20 minutes on a quiet machine, ten of them endurance. Start, CPU and latency are parts of benchmarks/bench.py.
"""

import argparse
import subprocess
import sys

from common import HERE

SCRIPTS = ("curve", "joint_state", "joints", "endurance", "endings", "faults")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="SCRIPT", help=f"these only, of: {', '.join(SCRIPTS)}")
    given = parser.parse_args()
    if unknown := set(given.names) - set(SCRIPTS):
        parser.error(f"no script {', '.join(sorted(unknown))}: give some of {', '.join(SCRIPTS)}")
    for name in given.names or SCRIPTS:
        subprocess.run([sys.executable, str(HERE / f"{name}.py")], check=True)


if __name__ == "__main__":
    main()
