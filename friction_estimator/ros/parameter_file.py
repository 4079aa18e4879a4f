"""Writes config/estimator.yaml: every parameter with its default, meaning, unit and range.

    python -m friction_estimator.ros.parameter_file > config/estimator.yaml

A test compares the file with this text, so that it cannot lag behind core/settings/config.py.
"""

import math
import textwrap

import yaml

from friction_estimator.core.settings.config import PARAMETERS
from friction_estimator.core.settings.setting import Parameter

_HEAD = """\
# Every parameter of the node `friction_estimator` and of the command line (--config), with its default.
# Copy what you change; what is left out keeps its default. Written by friction_estimator.ros.parameter_file.
#
#   ros2 run friction_estimator estimator_node --ros-args --params-file estimator.yaml
#   ros2 launch friction_estimator estimator.launch.py config:=estimator.yaml
#
# "at once": a change on the running node acts immediately and keeps what was learned; "at ~/reset": it waits for that
# service. Relative paths are relative to this file. What is empty by default is commented out, and what is learned,
# which `ros2 param dump` of a running node writes.
"""

_TAIL = """\

    # Quality of service of each input: best effort, keep last 1000, which matches any publisher. Reliable on both sides
    # loses nothing. The name holds the resolved topic.
    # qos_overrides./velocity.subscription.reliability: reliable
    # qos_overrides./friction.subscription.reliability: reliable
    # qos_overrides./velocity.subscription.depth: 1000
"""


def text() -> str:
    """Return the annotated parameter file."""
    lines = [_HEAD, "/**:", "  ros__parameters:"]
    group = ""
    for item in sorted(PARAMETERS.values(), key=lambda item: "." in item.name):
        *groups, leaf = item.name.split(".")
        indent = "    " + "  " * len(groups)
        if groups and groups[0] != group:
            group = groups[0]
            left_out = all(_left_out(p) for p in PARAMETERS.values() if p.name.startswith(f"{group}."))
            lines += ["", f"    {'# ' if left_out else ''}{group}:"]  # a bare name would be a parameter without value
        lines += [f"{indent}# {line}" for line in textwrap.wrap(_words(item), 116 - len(indent))]
        lines.append(f"{indent}{'# ' if _left_out(item) else ''}{leaf}: {_value(item)}")
    return "\n".join(lines) + "\n" + _TAIL


def _left_out(item: Parameter) -> bool:
    return item.default == () or item.learned


def _words(item: Parameter) -> str:
    facts = []
    if item.unit:
        facts.append(item.units)
    if math.isfinite(item.low) or math.isfinite(item.high):
        facts.append(f"{item.low:g} to {item.high:g}")
    facts.append(item.acts)
    if item.learned:
        facts.append("written by the estimator")
    return f"{item.description} [{'; '.join(facts)}]"


def _value(item: Parameter) -> str:
    if item.default == ():
        return {"basis.velocity_range": "[-0.15, 0.15]"}.get(item.name, "[]")
    return yaml.safe_dump(item.default).splitlines()[0]


if __name__ == "__main__":
    print(text(), end="")
