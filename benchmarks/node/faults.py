"""A hostile publisher: how far off the predictions are after each fault, and what was counted.

python faults.py
"""

import argparse
import math
import tempfile
from pathlib import Path

from common import PREDICTED, write_section
from geometry_msgs.msg import WrenchStamped
from ros_faults import FAULTS, Hostile
from ros_graph import Feeder, force, graph
from tables import table


def main() -> None:
    argparse.ArgumentParser(description=__doc__).parse_args()
    with graph(Path(tempfile.mkdtemp())) as made:
        process = made.start_node(deep=False, units=False)
        heard = made.hear(WrenchStamped, PREDICTED, raw=True)
        feeder = Feeder(made)
        feeder.matched()
        made.reached_by()
        hostile = Hostile(feeder, heard, wall_rate_hz=1000.0)
        before = hostile.normal(20.0)
        lines = []
        for name, (commit, counter) in FAULTS.items():
            commit(hostile)
            after = hostile.normal(2.0)
            lines.append([name, counter or "-", f"{after:.4f}", f"{after / before:.2f}"])
        finite = all(math.isfinite(force(raw)[1]) for raw in heard)
        code = process.stop()
    write_section(
        "Faults",
        f"500 Hz; rms error before any fault {before:.4f} N.\n\n"
        + table(["fault", "counted under", "rms error 1.5 to 2 s after its end (N)", "over before"], lines)
        + f"\n\nAll {len(heard)} predictions finite: {finite}; exit code {code}.",
    )


if __name__ == "__main__":
    main()
