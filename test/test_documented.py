"""Every command, program and setting that the pages show is run, in a clean copy, in order of the page.

What cannot be run is listed in `EXEMPT` with its reason, and nowhere else. Files that belong to the reader's own rig
are made by `SUPPLIED`. What a command draws in this process is blank, but for the README: what it prints is what the
page promises.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import ros_graph
import yaml
from documented import PAGES, ROOT, Command, blocks, commands, missing
from joint_bags import robot, write_joint_bag

from friction_estimator.bag.read import read_recording
from friction_estimator.bag.samples import to_samples
from friction_estimator.cli.main import main
from friction_estimator.core.settings.config import Config
from friction_estimator.documents.configuration import read_config

NATIVE = "needs a native ROS 2 installation"
WHOLE = "takes minutes, and is run whole by another test"

EXEMPT = {
    r"make demo\b": f"{WHOLE}: test_demo.py",
    r"make (test|hard|check|docs|stale|lock|picture|format)\b": "runs the whole of what it names; .ci/run does",
    r"\.ci/run": "runs the whole suite in an environment of its own",
    r"(git|pip|sudo|cd|\.|\.venv/bin/\w+|python3 -m venv) ": "sets up the machine",
    r"ros2 |rosdep |colcon ": NATIVE,
    r"rosbags-convert ": "would write over the recordings that the project ships",
    r"friction_estimator reproduce\b": f"{WHOLE}: hard/hard_reproduce.py",
    r"friction_estimator watch --": "a second view of the same node: test_watch.py",
    r"friction_estimator simulate --out build/": "makes bags/ again: test_cli_simulate.py compares the samples",
}
"""Beginning of a command, as a pattern -> why it is not run."""

UNTIL_STOPPED = ("estimator_node", "python -m friction_estimator.ros.node", "friction_estimator watch")
"""Commands that run until they are stopped: they go on beside those that follow on the page."""

LIMIT_S = 300


def supplied_tables(folder: Path) -> None:
    """Write the tables that docs/import.md and the README read."""
    t = np.arange(2000) / 1000.0
    position, velocity, friction = 0.02 * np.sin(6 * t), 0.12 * np.cos(6 * t), 5.0 * np.sign(np.cos(6 * t))
    rig = {"t_ms": 1e3 * t, "v_mm_s": 1e3 * velocity, "F_N": friction, "p_bar": 3.0 + t}
    pd.DataFrame(rig).to_csv(folder / "rig.csv", index=False)
    q = np.degrees(np.round(position * 1000 * 4096) / 4096)
    acceleration = -0.72 * 1000 * np.sin(6 * t)
    effort = friction + 0.0189 * acceleration + 1.2 * np.sin(np.radians(q))
    pd.DataFrame({"t": t, "q": q, "acc": acceleration, "tau": effort}).to_csv(folder / "arm.csv", index=False)
    german = pd.DataFrame({"Zeit [ms]": 1e3 * t, "Weg [mm]": 1e3 * position, "Kraft (kN)": 1e-3 * friction})
    german.to_csv(folder / "axis.csv", index=False, sep=";", decimal=",", encoding="cp1252")


def supplied_arm(folder: Path) -> None:
    """Write a recording of a robot."""
    names = ("elbow", "stuck", "wrist", "parked", "blind", "tool")
    write_joint_bag(folder / "arm", {"/joint_states": robot(names=names)})


SUPPLIED: dict[str, Callable[[Path], None]] = {"docs/import.md": supplied_tables, "docs/joints.md": supplied_arm}
"""Page -> what makes the files of the reader that it names."""


def imported_as_they_are(folder: Path) -> None:
    """Compare the recordings that docs/import.md makes with what its tables were made of."""
    t = np.arange(2000) / 1000.0
    velocity, friction = 0.12 * np.cos(6 * t), 5.0 * np.sign(np.cos(6 * t))
    for name, every, scale in (("rig_bag", 1, 1.0), ("arm_bag", 1, 1000.0), ("axis_bag", 2, 1.0)):
        samples = to_samples(read_recording(folder / name), Config()).samples
        assert len(samples) == 2000 // every
        middle = slice(100 // every, -100 // every)
        true = scale * velocity[::every][middle]
        np.testing.assert_allclose(samples.velocity_m_s[middle], true, atol=0.01 * true.max())
        if every == 1:
            np.testing.assert_allclose(samples.friction_N, friction, atol=0.01)


CHECKED: dict[str, Callable[[Path], None]] = {"docs/import.md": imported_as_they_are}
"""Page -> what looks at the files that its commands made."""

PROGRAMS_ELSEWHERE = {"docs/joints.md": "runs until it is stopped: test_ros_joints.py sends it messages"}
"""Page -> why its programs are not run here."""


def exempt(command: Command) -> bool:
    return any(re.match(pattern, command.text.strip()) for pattern in EXEMPT)


def lives(command: Command) -> bool:
    return not exempt(command) and command.text.startswith(UNTIL_STOPPED)


def anywhere(command: Command) -> str:
    """Return a command that runs until it is stopped as it can run beside another suite: a page takes any free port."""
    words = shlex.split(command.text, comments=True)
    port = ["--port", "0"] if words[:2] == ["friction_estimator", "watch"] else []
    return shlex.join([*words, *port])


def parameters() -> list[object]:
    """Return the pages that have something to run; those with live nodes are ROS tests."""
    found = []
    for page in PAGES:
        shown = commands(page)
        marks = [pytest.mark.ros] if any(map(lives, shown)) else []
        if any(not exempt(command) for command in shown):
            found.append(pytest.param(page, marks=marks, id=page))
    return found


@pytest.fixture
def clean_copy(tmp_path: Path) -> Path:
    """Return a folder with what a clone holds beside the code."""
    folder = tmp_path / "friction_estimator"
    for name in ("bags", "config", "docs", "launch"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("generated", "__pycache__"))
    return folder


@pytest.fixture
def environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Have the environment of an activated one, on a ROS graph of its own."""
    programs = tmp_path / "bin"
    programs.mkdir()
    modules = {"friction_estimator": "-m friction_estimator", "estimator_node": "-m friction_estimator.ros.node"}
    for name, module in {**modules, "python": ""}.items():
        (programs / name).write_text(f'#!/bin/sh\nexec "{sys.executable}" {module} "$@"\n')
        (programs / name).chmod(0o755)
    with ros_graph.reserved_domain() as domain:
        monkeypatch.setenv("PATH", f"{programs}:{os.environ['PATH']}")
        monkeypatch.setenv("PYTHONPATH", str(ROOT))
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
        monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "ros_log"))
        yield


@pytest.mark.usefixtures("environment")
@pytest.mark.parametrize("page", parameters())
def test_the_commands_of_a_page_do_what_it_says(page, clean_copy, tmp_path, monkeypatch, capfd, request):
    if page != "README.md":
        request.getfixturevalue("blank_drawings")
    SUPPLIED.get(page, lambda _: None)(clean_copy)
    monkeypatch.chdir(clean_copy)
    living: list[ros_graph.Process] = []
    try:
        for number, command in enumerate(commands(page)):
            if exempt(command):
                continue
            if lives(command):
                log = tmp_path / f"{number}.log"
                process = ros_graph.Process(["bash", "-c", f"exec {anywhere(command)}"], dict(os.environ), log)
                living.append(process)
                ros_graph.await_(process.output, f"a word of: {command}")
                continue
            printed = run(command, capfd)
            assert not missing(command.output, printed), f"{command}\n{printed}"
        CHECKED.get(page, lambda _: None)(clean_copy)
        for process in living:
            assert process.popen.poll() is None, process.output()
    finally:
        codes = [process.stop() for process in living]
    assert not any(codes), [process.output() for process in living]


def run(command: Command, capfd: pytest.CaptureFixture[str]) -> str:
    """Run a command to its end and return what it printed; fails where its exit code is not 0."""
    if command.words:  # in this process: the imports of a verb take longer than most of its work here
        capfd.readouterr()
        code = main(command.words)
        out, err = capfd.readouterr()
    else:
        done = subprocess.run(
            ["bash", "-ec", command.text],
            capture_output=True,
            text=True,
            timeout=LIMIT_S,
            check=False,
        )
        code, out, err = done.returncode, done.stdout, done.stderr
    assert code == 0, f"{command}\n{out}{err}"
    return out


@pytest.mark.parametrize("page", sorted(set(PAGES) - set(PROGRAMS_ELSEWHERE)))
def test_the_programs_of_a_page_run(page, clean_copy, monkeypatch):
    monkeypatch.chdir(clean_copy)
    for block in blocks(page):
        if block.language == "python":
            exec(compile(block.text, f"{page}:{block.line}", "exec"), {"__name__": "__main__"})


@pytest.mark.parametrize("page", PAGES)
def test_commands_stand_in_blocks_of_shell(page):
    """A block without a language shows output or a sketch; a command in it would never be run."""
    begins = re.compile(r"^(\$ )?(friction_estimator [a-z]|estimator_node |make |ros2 |python3? -|\./)")
    for block in blocks(page):
        if block.language != "sh":
            lost = [line for line in block.text.splitlines() if begins.match(line)]
            assert not lost, f"{page}:{block.line}"


def test_the_tables_of_the_tutorial_are_what_their_script_makes(tmp_path):
    """To the last digit but one: the last bit of a sine is the processor's."""
    subprocess.run([sys.executable, str(ROOT / "docs/tutorial/make_tables.py"), str(tmp_path)], check=True)
    for kept in sorted((ROOT / "docs/tutorial").glob("*.csv")):
        shipped, made = pd.read_csv(kept), pd.read_csv(tmp_path / kept.name)
        assert list(shipped) == list(made)
        np.testing.assert_allclose(shipped, made, atol=0.0101)
        assert kept.stat().st_size < 250_000


def test_every_exemption_is_of_a_command_that_is_there():
    shown = [command.text.strip() for page in PAGES for command in commands(page)]
    for pattern, reason in EXEMPT.items():
        assert any(re.match(pattern, text) for text in shown), pattern
        assert reason
    assert set(SUPPLIED) <= set(PAGES)


@pytest.mark.parametrize("page", PAGES)
def test_settings_that_a_page_shows_are_settings(page, tmp_path):
    for block in blocks(page):
        if block.language == "yaml":
            path = tmp_path / "shown.yaml"
            path.write_text(block.text)
            assert yaml.safe_load(block.text)
            read_config(path)


def test_what_scrolls_on_the_site_can_be_reached_by_keyboard(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "docs/site")
    from reachable import levelled, reachable

    body = '<pre><span>a</span></pre><table class="docutils align-default"><tr></tr></table>'
    assert reachable(body).count('tabindex="0"') == 2
    assert reachable(reachable(body)) == reachable(body)
    assert levelled('<p role="heading">Begin</p>') == '<p role="heading" aria-level="2">Begin</p>'


def test_a_promise_that_is_not_kept_is_seen():
    assert missing(["a 1.00", "b"], "a 1.02\nb\n") == []
    assert missing(["a 1.00", "b"], "b\na 1.02\n") == ["b"]
    assert missing(["a 1.00 s"], "a 1.2 s") == ["a 1.00 s"]
