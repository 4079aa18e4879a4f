"""Names from outside on their way through every verb: no control character reaches the terminal, nothing breaks.

Topics, joints, frames, columns and settings hold escapes and line ends; names of files hold bytes that are no UTF-8.
"""

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pages
import pytest
import yaml
from rosbags.rosbag2 import StoragePlugin, Writer
from synthetic import samples_of, sine, stribeck

from friction_estimator.bag.serialise import typestore
from friction_estimator.bag.write import write_samples
from friction_estimator.cli.main import main
from friction_estimator.core.sample import NS_PER_S

EVIL = "\x1b[2J\n[FATAL] forged\x07\x9b31m\u202e\x7f"
BYTES = os.fsdecode(b"b\xff\x1b[2J\n")
START = 1_700_000_000 * NS_PER_S
TYPES = {"/velocity": "geometry_msgs/msg/TwistStamped", "/friction": "geometry_msgs/msg/WrenchStamped"}


@pytest.fixture
def run(capfd):
    """Return what runs a verb and returns its code, stdout and stderr, having looked for control characters."""

    def ran(*words):
        try:
            code = main([str(word) for word in words])
        except SystemExit as ended:  # usage
            code = ended.code
        out, error = capfd.readouterr()
        for text in (out, error):
            assert all(c.isprintable() for c in text.replace("\n", "")), ascii(text)
            assert not [line for line in text.splitlines() if line.startswith("[FATAL]")]
        assert code != 70, error
        return code, out, error

    return ran


def hostile_recording(path, n=600):
    """Write frames, a topic and a joint that hold escapes, beside the usual `/velocity` and `/friction`."""
    store = typestore()
    types = store.types
    t = np.arange(n) / 100.0
    v = 0.1 * np.sin(2 * np.pi * t)

    def stamped(kind, k, value):
        time = types["builtin_interfaces/msg/Time"](START // NS_PER_S + k // 100, k % 100 * 10_000_000)
        header = types["std_msgs/msg/Header"](time, f"frame{EVIL}")
        vector = types["geometry_msgs/msg/Vector3"]
        zero, body = vector(0.0, 0.0, 0.0), vector(value, 0.0, 0.0)
        inner = types["geometry_msgs/msg/Twist" if "Twist" in kind else "geometry_msgs/msg/Wrench"](body, zero)
        return types[kind](header, inner)

    def joints(k):
        time = types["builtin_interfaces/msg/Time"](START // NS_PER_S + k // 100, k % 100 * 10_000_000)
        header = types["std_msgs/msg/Header"](time, f"frame{EVIL}")
        values = (np.array([v[k]]), np.array([v[k]]), np.array([np.sign(v[k])]))
        return types["sensor_msgs/msg/JointState"](header, [f"joint{EVIL}"], *values)

    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        links = {topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in TYPES.items()}
        other = writer.add_connection(f"/states{EVIL}", "sensor_msgs/msg/JointState", typestore=store)
        for k in range(n):
            at = START + k * 10_000_000
            for topic, value in (("/velocity", v[k]), ("/friction", 5.0 * np.tanh(v[k] / 1e-3))):
                message = stamped(TYPES[topic], k, float(value))
                writer.write(links[topic], at, store.serialize_cdr(message, TYPES[topic]))
            writer.write(other, at, store.serialize_cdr(joints(k), "sensor_msgs/msg/JointState"))
    return path


@pytest.fixture(scope="module")
def hostile(tmp_path_factory):
    return hostile_recording(tmp_path_factory.mktemp("hostile") / "bag")


@pytest.mark.parametrize(
    "words",
    [
        ["info"],
        ["info", "--json", "-"],
        ["info", "--topic", f"velocity=/nope{EVIL}"],
        ["info", "--topic", f"joint_states=/states{EVIL}", "--joint", f"other{EVIL}"],
        ["replay", "--topic", f"joint_states=/states{EVIL}", "--out", "OUT", "--json", "-"],
        ["identify", "--fit-only", "--topic", f"joint_states=/states{EVIL}"],
        ["diagnose", "--out", "OUT"],
        ["replay", "--law", f"rls{EVIL}"],
        ["play", "--topics", f"/nope{EVIL}"],
    ],
    ids=lambda words: f"{words[0]}-{len(words)}",
)
def test_no_control_character_of_a_recording_reaches_the_terminal(run, hostile, tmp_path, words):
    if words[0] == "play":
        pytest.importorskip("rclpy")
    code, out, error = run(words[0], hostile, *(tmp_path / "out" if word == "OUT" else word for word in words[1:]))
    assert code in (0, 1, 2)
    told = out + error
    if "--json" in words:
        json.loads(out)
    elif code != 2 or "nope" in told:
        assert r"\x1b[2J" in told or words[0] == "diagnose"
    if (tmp_path / "out").exists():
        for name in ("report.html", "config.yaml", "summary.json"):
            if (tmp_path / "out" / name).exists():
                text = pages.own((tmp_path / "out" / name).read_text(encoding="utf-8"))
                assert all(c.isprintable() for c in text.replace("\n", "")), name


def test_settings_with_escapes_are_told_safely(run, hostile, tmp_path):
    for number, values in enumerate(
        ({f"x{EVIL}": 1}, {"model.law": EVIL}, {"input.mode": "joint_state", "input.joint": EVIL}, {"seal": {EVIL: 1}})
    ):
        path = tmp_path / f"{number}.yaml"
        path.write_text(yaml.safe_dump({"/**": {"ros__parameters": values}}))
        code, _, error = run("replay", hostile, "--config", path)
        assert code in (1, 2)
        assert error.count("\n") == 1
        assert r"\x1b[2J" in error


def test_columns_with_escapes_are_told_safely(run, tmp_path):
    (tmp_path / "rig.csv").write_text("t,v,f,\x1b[31mx\n0,1,2,3\n1,2,3,\x1b[2J\n")
    for mapping in ("velocity=v,friction=g", "velocity=v,friction=\x1b[31mx", "velocity=v,friction=f\x1b[2J"):
        code, _, error = run("import", tmp_path / "rig.csv", "--out", tmp_path / "bag", "--time", "t", "--map", mapping)
        assert code == 2
        assert error.count("\n") == 1
        assert "rig.csv" in error


@pytest.fixture(scope="module")
def usual(tmp_path_factory):
    path = tmp_path_factory.mktemp("usual") / "bag"
    velocity = sine(4, period_s=1.0)
    write_samples(path, samples_of(velocity, stribeck(velocity)))
    return path


@pytest.mark.usefixtures("blank_drawings")
@pytest.mark.parametrize("form", ["folder", "file"])
def test_names_that_are_no_utf8_work(run, usual, tmp_path, form):
    """As input, as output, in reports and in JSON."""
    bag, out = tmp_path / BYTES, tmp_path / f"out{BYTES}"
    if form == "file":
        bag = bag.with_name(f"{BYTES}.mcap")
        shutil.copy(next(usual.glob("*.mcap")), bag)
    else:
        shutil.copytree(usual, bag)
    assert run("info", bag, "--json", "-")[0] == 0
    for words in (["identify", bag, "--fit-only"], ["replay", bag, bag]):
        code, printed, error = run(*words, "--out", out, "--json", "-")
        assert (code, json.loads(printed)["bags"][0]) == (0, str(bag)), error
        assert json.loads((out / "summary.json").read_text())["bags"][0] == str(bag)
        assert r"b\xff\x1b[2J\n" in pages.words((out / "report.html").read_text(encoding="utf-8"))
    assert [p.name.isprintable() for p in (out / "bag").iterdir()] == [True, True]
    # What was written is read again.
    assert run("replay", bag, "--config", out / "config.yaml")[0] == 0
    assert run("info", next(iter(sorted((out / "bag").iterdir()))))[0] == 0


def test_names_that_cannot_be_taken_are_refused_in_one_line(run, usual, tmp_path):
    bare = tmp_path / os.fsdecode(b"r\xff.db3")
    shutil.copy(next(usual.glob("*.mcap")), bare)
    (tmp_path / "t.csv").write_text("t,v,f\n0,1,2\n1,2,3\n")
    table = ["import", tmp_path / "t.csv", "--time", "t", "--map", "velocity=v,friction=f"]
    for words, remedy in (
        (["info", bare], "rename it"),
        ([*table, "--out", tmp_path / BYTES], "choose another name"),
        (["simulate", "--out", tmp_path / BYTES, "--condition", "a"], "choose another name"),
    ):
        code, _, error = run(*words)
        assert (code, error.count("\n")) == (2, 1)
        assert remedy in error
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([bare.name, "t.csv"])


def test_a_table_whose_name_is_no_utf8_is_read(run, tmp_path):
    path = Path(tmp_path, BYTES).with_suffix(".csv")
    path.write_text("t,v,f\n0,1,2\n1,2,3\n")
    code, out, _ = run("import", path, "--out", tmp_path / "bag", "--time", "t", "--map", "velocity=v,friction=f")
    assert (code, "2 samples" in out) == (0, True)
