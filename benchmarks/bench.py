"""`make bench`: what is measured of speed and memory, side by side, on one page: README.md, bench.json and plots.

    python benchmarks/bench.py [PART...] [--quick --out FOLDER]

Parts are measured one after the other, each in a process of its own; without names all of them, which takes some
{minutes:.0f} minutes on two cores with nothing beside it. Parts that are not named keep their figures, under their own
commit and command.
"""

import argparse
import json
import os
import platform
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import page
import plots
import provenance

HERE = Path(__file__).resolve().parent
FIGURES = "bench.json"


class Part(NamedTuple):
    """A script, the time that it takes, and sizes with which it takes seconds."""

    script: str
    minutes: float
    quick: str


PARTS = {
    "kernels": Part("kernels/run.py", 1.0, "--samples 2000 --rounds 1"),
    "peers": Part("kernels/peers.py", 1.0, "--samples 100 --rounds 1"),
    "sizes": Part("kernels/sizes.py", 1.0, "--samples 2000 --rounds 1"),
    "start_up": Part("reading/start_up.py", 1.0, "--rounds 1"),
    "reading": Part("reading/pairs.py", 5.0, "--pairs 5000 --rounds 1"),
    "long": Part("reading/long.py", 20.0, "--samples 100000 --rounds 1"),
    "many": Part("many/run.py", 35.0, "--rounds 1 --seconds 10 --settings 1 --fleet 2"),
    "node_start": Part("node/start.py", 1.0, "--rounds 1"),
    "node": Part("node/pairs.py", 9.0, "--rounds 1 --round-seconds 1 --seconds 2"),
    "latency": Part("node/latency.py", 7.0, "--rounds 1 --round-seconds 2"),
}


def figures_of(part: Part, quick: bool) -> dict[str, Any]:
    """Run the script of a part; return what it prints."""
    command = [sys.executable, str(HERE / part.script), *(part.quick.split() if quick else [])]
    path = os.pathsep.join(filter(None, [str(HERE), os.environ.get("PYTHONPATH")]))
    done = subprocess.run(command, env=os.environ | {"PYTHONPATH": path}, stdout=subprocess.PIPE, check=True)
    figures: dict[str, Any] = json.loads(done.stdout)
    return figures


def rounded(value: Any) -> Any:
    """Return figures to five digits: more are noise."""
    if isinstance(value, float):
        return float(f"{value:.5g}")
    if isinstance(value, dict):
        return {key: rounded(one) for key, one in value.items()}
    return [rounded(one) for one in value] if isinstance(value, list) else value


def dumped(figures: dict[str, Any]) -> str:
    """Return JSON in which the rounds of a figure stand on one line."""
    text = json.dumps(figures, indent=1)
    return re.sub(r"\[[^\[\]{}]*\]", lambda found: " ".join(found[0].split()), text) + "\n"


def main() -> None:
    minutes = sum(part.minutes for part in PARTS.values())
    about = (__doc__ or "").format(minutes=minutes)
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"these only, of: {', '.join(PARTS)}")
    parser.add_argument("--quick", action="store_true", help="sizes that only show that all of it runs; needs --out")
    parser.add_argument("--render", action="store_true", help="measure nothing, make the page of what was measured")
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="for the page (default: the project's own)")
    given = parser.parse_args()
    if unknown := set(given.parts) - set(PARTS):
        parser.error(f"no part {', '.join(sorted(unknown))}: give some of {', '.join(PARTS)}")
    if given.quick and not given.out:
        parser.error("--quick: give a folder with --out, figures of small sizes are not the project's")
    out: Path = given.out or HERE
    out.mkdir(parents=True, exist_ok=True)
    file = out / FIGURES
    every: dict[str, Any] = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    names = [] if given.render else given.parts or list(PARTS)
    for name in names:
        left = sum(PARTS[other].minutes for other in names[names.index(name) :])
        print(f"{time.strftime('%H:%M')} {name}" + ("" if given.quick else f", some {left:.0f} min to go"), flush=True)
        command = f"python benchmarks/bench.py {'--quick ' if given.quick else ''}{name}"
        source, load, begin = provenance.line(command).strip(), os.getloadavg()[0], time.monotonic()
        figures = figures_of(PARTS[name], given.quick)
        every[name] = {
            "source": source,
            "machine": f"{processor()}, {os.cpu_count()} cores, Python {platform.python_version()}",
            "load_before": load,
            "took_s": time.monotonic() - begin,
            "figures": figures,
        }
        every[name] = rounded(every[name])
        every = {part: every[part] for part in PARTS if part in every}
        file.write_text(dumped(every), encoding="utf-8")
        render(every, out)
    if given.render:
        render(every, out)
    print(f"{time.strftime('%H:%M')} written: {out / 'README.md'}")


def render(every: dict[str, Any], out: Path) -> None:
    """Write page and plots."""
    figures = {name: part["figures"] for name, part in every.items()}
    drawn = plots.draw(figures, out)
    (out / "README.md").write_text(page.page(every, drawn), encoding="utf-8")


def processor() -> str:
    """Return the name of the processor."""
    found = re.search(r"^model name\s*:\s*(.*)$", Path("/proc/cpuinfo").read_text(encoding="utf-8"), re.MULTILINE)
    return found[1] if found else platform.machine()


if __name__ == "__main__":
    main()
