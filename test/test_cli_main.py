"""Every verb has help, one-line failures and the exit codes of the interface; interrupted runs leave nothing behind."""

import io
import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from friction_estimator import __version__
from friction_estimator.cli import common, main, terminal
from friction_estimator.cli.main import VERBS
from friction_estimator.cli.progress import progress
from friction_estimator.core.errors import ConfigError, InputError, UnanswerableError, about
from friction_estimator.core.settings.config import Config

BAG = Path(__file__).parents[1] / "bags" / "demo"

# Dispatch


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_has_help_with_an_example_and_the_exit_codes(verb, capsys):
    with pytest.raises(SystemExit) as ended:
        main.main([verb, "--help"])
    text = capsys.readouterr().out
    assert ended.value.code == 0
    assert f"friction_estimator {verb}" in text.split("example")[1]
    assert "exit codes" in text


def test_the_list_of_verbs_needs_no_verb_imported():
    code = (
        "import sys; from friction_estimator.cli.main import main\n"
        "try: main(['--help'])\n"
        "except SystemExit: print(sorted(m for m in sys.modules if m.split('.')[0] in ('numpy', 'rosbags')))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"
    for verb, (_, summary) in VERBS.items():
        assert f"    {verb}" in done.stdout
        assert summary.split()[0] in done.stdout


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "no verb given: choose one of"),
        (["inof"], "unknown verb 'inof': did you mean info?"),
        (["zzz"], "unknown verb 'zzz': choose one of simulate,"),
        (["info"], "the following arguments are required: BAG"),
        (["info", "bag", "--frob"], "unrecognized arguments: --frob"),
        (["import", "t.csv", "--json", "rig.mcap"], "rig.mcap is no JSON file"),
    ],
)
def test_a_usage_error_is_one_line_and_exit_code_2(words, message, capsys):
    with pytest.raises(SystemExit) as ended:
        main.main(words)
    lines = capsys.readouterr().err.splitlines()
    assert ended.value.code == 2
    assert len(lines) == 1
    assert message in lines[0]
    assert "--help" in lines[0]


def test_version_and_module_entry():
    done = subprocess.run(
        [sys.executable, "-m", "friction_estimator", "--version"], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == f"friction_estimator {__version__}"


# Failures


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (InputError("a.mcap is damaged:\n  badly"), 2, r"verb: a.mcap is damaged:\n  badly"),
        (
            InputError("no such column", where="a\x1b[2J.csv", remedy="see it"),
            2,
            r"verb: a\x1b[2J.csv: no such column; see it",
        ),
        (ConfigError("unknown parameter x"), 2, "verb: unknown parameter x"),
        (UnanswerableError("no such topic"), 1, "verb: no such topic"),
        (KeyboardInterrupt(), 130, "verb: interrupted"),
        (PermissionError(13, "Permission denied", "/etc/x"), 2, "verb: cannot use /etc/x: Permission denied"),
        (
            ModuleNotFoundError("No module named 'matplotlib.figure'", name="matplotlib.figure"),
            2,
            "verb: needs the Python module matplotlib, which is not installed: see README.md",
        ),
        (OSError(28, "No space left on device"), 2, "verb: cannot use a file: No space left on device"),
    ],
)
def test_an_expected_failure_is_one_line_and_its_exit_code(error, code, line, capsys):
    def body():
        raise error

    assert terminal.guarded("verb", body) == code
    assert capsys.readouterr().err == f"{line}\n"


@pytest.mark.parametrize(
    ("provoke", "words"),
    [
        (lambda: 1 // 0, "ZeroDivisionError: integer division or modulo by zero"),
        (lambda: int("\x1b[2J"), r"ValueError: invalid literal for int() with base 10: '\x1b[2J'"),
    ],
)
def test_a_fault_of_the_program_is_one_line_and_exit_code_70(provoke, words, capsys):
    assert terminal.guarded("verb", provoke) == 70
    error = capsys.readouterr().err
    assert error.startswith("verb: a fault of the program")
    assert words in error
    assert error.count("\n") == 1
    assert error.endswith("--debug shows the trace, please report it\n")


def test_a_fault_names_its_place_and_debug_shows_the_trace(capsys):
    def body():
        Config().updated(None)

    assert terminal.guarded("verb", body) == 70
    assert "(core/settings/config.py line " in capsys.readouterr().err
    assert terminal.guarded("verb", body, ["verb", "--debug"]) == 70
    lines = capsys.readouterr().err.splitlines()
    assert lines[0].startswith("Traceback")
    assert lines[-1].startswith("verb: a fault of the program (core/settings/config.py line ")
    assert not lines[-1].endswith("report it")


def test_debug_shows_the_trace_of_an_expected_failure_too(tmp_path, capsys):
    assert main.main(["info", str(tmp_path / "none.mcap"), "--debug"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert lines[0].startswith("Traceback")
    assert "none.mcap" in lines[-1]


def nested(depth):
    return nested(depth + 1)


@pytest.mark.parametrize(
    ("provoke", "code", "line"),
    [
        (lambda: nested(0), 70, "verb: a fault of the program"),
        (lambda: len(bytearray(1 << 62)), 2, "verb: not enough memory: give a shorter recording"),
    ],
)
def test_too_deep_and_too_large_are_one_line(provoke, code, line, capsys):
    assert terminal.guarded("verb", provoke) == code
    error = capsys.readouterr().err
    assert error.startswith(line)
    assert error.count("\n") == 1


def test_what_was_worked_on_is_named(capsys):
    for failure, code in ((UnanswerableError("no usable sample"), 1), (MemoryError(), 2), (ZeroDivisionError(), 70)):

        def body(failure=failure):
            with about("monday"), about("a.mcap"):
                raise failure

        assert terminal.guarded("verb", body) == code
        assert capsys.readouterr().err.startswith("verb: a.mcap: ")


def test_warnings_and_logs_of_libraries_are_shown_with_debug_only():
    code = (
        "import sys, warnings, logging\n"
        "from friction_estimator.cli.terminal import guarded\n"
        "def body():\n"
        "    warnings.warn('overflow'); logging.getLogger('library').warning('font')\n"
        "    return 0\n"
        "sys.exit(guarded('verb', body, sys.argv))"
    )
    quiet = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert quiet.stderr == ""
    loud = subprocess.run([sys.executable, "-c", code, "--debug"], capture_output=True, text=True, check=True)
    assert "overflow" in loud.stderr
    assert "font" in loud.stderr


def test_a_reader_that_goes_away_is_no_failure():
    code = (
        "import sys; from friction_estimator.cli.terminal import guarded\n"
        "def body():\n"
        "    for _ in range(100000): print('x' * 100)\n"
        "    return 0\n"
        "sys.exit(guarded('verb', body))"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.readline()
    process.stdout.close()
    assert process.stderr.read() == ""
    assert process.wait(60) == 141
    process.stderr.close()


def run(*words, shell="", **environment):
    """Run the command line in a process of its own; `shell` is what comes after the command."""
    command = shlex.join([sys.executable, "-m", "friction_estimator", *map(str, words)])
    script = f"set -o pipefail; {command} {shell}"
    return subprocess.run(
        ["bash", "-c", script],
        check=False,
        capture_output=True,
        text=True,
        timeout=60,
        env={**os.environ, **environment},
    )


@pytest.mark.parametrize("buffered", [True, False])
@pytest.mark.parametrize(
    ("shell", "codes", "said"),
    [
        ("| head -c1", (0, 141), ""),  # 0 where all was written before the reader left
        (">&-", (2,), "friction_estimator info: cannot use stdout: it is closed\n"),
        ("2>&-", (0,), ""),
        (">&- 2>&- <&-", (2,), ""),
        (">/dev/full", (2,), "friction_estimator info: cannot use stdout: No space left on device\n"),
    ],
)
def test_a_closed_or_full_stdout_gives_no_trace(shell, codes, said, buffered):
    done = run("info", BAG, shell=shell, PYTHONUNBUFFERED="" if buffered else "1")
    assert done.returncode in codes, done
    assert done.stderr == said


def test_a_failure_is_told_by_its_code_where_stderr_is_closed():
    done = run("info", "/nowhere/a.mcap", shell="2>&-")
    assert (done.returncode, done.stdout) == (2, "")


def test_json_needs_an_open_stdout(tmp_path):
    done = run("info", BAG, "--json", "-", shell=">&-")
    assert done.returncode == 2
    assert "argument --json: stdout is closed, the result cannot be printed" in done.stderr


def test_a_closed_stream_lends_no_number_to_a_file(tmp_path):
    """What a library writes to descriptor 1 or 2 must not get into the user's data."""
    code = (
        "import os, sys\n"
        "from friction_estimator.cli.terminal import guarded\n"
        "def body():\n"
        f"    with open({str(tmp_path / 'data')!r}, 'wb') as data:\n"
        "        os.write(1, b'chatter'); os.write(2, b'chatter'); data.write(b'kept')\n"
        "    return 0\n"
        "sys.exit(guarded('verb', body))"
    )
    subprocess.run(["bash", "-c", f"{shlex.join([sys.executable, '-c', code])} <&- >&- 2>&-"], check=True, timeout=60)
    assert (tmp_path / "data").read_bytes() == b"kept"


def test_a_usage_error_shows_no_escape():
    done = run("info", "--\x1b[2J", "bag", "\n[FATAL] forged")
    assert done.returncode == 2
    said = r"friction_estimator: unrecognized arguments: --\x1b[2J \n[FATAL] forged (see friction_estimator --help)"
    assert done.stderr == said + "\n"


def test_a_locale_that_holds_no_umlaut_is_no_failure(tmp_path):
    """On stderr and on stdout: the recording's name is the first line of `info`."""
    bag = shutil.copytree(BAG, tmp_path / "prüfstand")
    for words, code in (([tmp_path / "prüfer.mcap"], 2), ([bag], 0), ([bag, "--json", "-"], 0)):
        done = run("info", *words, PYTHONIOENCODING="ascii")
        assert done.returncode == code, done
        assert r"pr\xfcf" in done.stdout + done.stderr
        assert "Traceback" not in done.stderr


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130), (signal.SIGHUP, 129)])
def test_a_stopped_run_leaves_nothing_half_written(tmp_path, number, code):
    script = (
        "import sys, time; from friction_estimator.cli.terminal import guarded\n"
        "from friction_estimator.output.target import replacing_file\n"
        "def body():\n"
        f"    with replacing_file({str(tmp_path / 'out.json')!r}) as part:\n"
        "        part.write_text('half')\n"
        "        print('ready', flush=True)\n"
        "        time.sleep(60)\n"
        "sys.exit(guarded('verb', body))"
    )
    process = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stdout.readline() == b"ready\n"
    os.kill(process.pid, number)
    process.communicate(timeout=60)
    assert process.returncode == code
    assert list(tmp_path.iterdir()) == []


# JSON

values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


def finite(value):
    if isinstance(value, float) and not np.isfinite(value):
        return None
    if isinstance(value, list):
        return [finite(item) for item in value]
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    return value


@given(values)
def test_json_is_strict_and_null_stands_for_what_is_not_finite(value):
    def refuse(word):
        raise AssertionError(word)

    assert json.loads(common.to_json(value), parse_constant=refuse) == finite(value)


def test_json_takes_arrays_and_numpy_numbers():
    value = {"a": np.array([[1.5, np.nan]]), "b": np.int64(3), "c": np.bool_(True), "d": (np.float32(0.5),)}
    assert json.loads(common.to_json(value)) == {"a": [[1.5, None]], "b": 3, "c": True, "d": [0.5]}
    with pytest.raises(TypeError, match="complex has no JSON form"):
        common.to_json(1j)


def test_words_leave_stdout_to_the_json(tmp_path, capsys):
    for target in (None, "-", str(tmp_path / "out.json")):
        with common.Output(target) as output:
            output.say("words")
            output.result({"x": 1})
        caught = capsys.readouterr()
        if target == "-":
            assert json.loads(caught.out) == {"x": 1}
            assert caught.err == "words\n"
        else:
            assert (caught.out, caught.err) == ("words\n", "")
    assert json.loads((tmp_path / "out.json").read_text()) == {"x": 1}


# Progress


class Screen(io.StringIO):
    """A stream that is, or is not, a terminal."""

    def __init__(self, terminal):
        super().__init__()
        self._terminal = terminal

    def isatty(self):
        return self._terminal


@pytest.mark.parametrize("terminal", [True, False])
def test_a_bar_is_drawn_on_a_terminal_only(monkeypatch, terminal):
    screen = Screen(terminal)
    monkeypatch.setattr(sys, "stderr", screen)
    with progress("reading") as advance:
        for _ in range(3):
            advance(10, total=30)
            time.sleep(0)
    assert ("reading" in screen.getvalue()) == terminal


# Options


def parsed(*words):
    parser = terminal.Parser(prog="x")
    common.add_bag_options(parser)
    return parser.parse_args(words)


def test_topics_are_named_by_input():
    args = parsed("--topic", "velocity=/rig/v", "--topic", "joint_states=js")
    assert common.topics_from(args) == {"velocity": "/rig/v", "joint_states": "js"}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--topic", "velocity"], "--topic velocity: write INPUT=TOPIC"),
        (["--topic", "velocity="], "--topic velocity=: write INPUT=TOPIC"),
        (["--topic", "speed=/v"], "unknown input 'speed': choose one of velocity, friction"),
        (["--topic", "velocity=/v", "--topic", "velocity=/w"], "velocity is given twice"),
    ],
)
def test_a_topic_option_that_makes_no_sense_is_refused(words, message):
    with pytest.raises(InputError) as caught:
        common.topics_from(parsed(*words))
    assert message in str(caught.value)


def test_the_command_line_overrides_the_file(tmp_path):
    (tmp_path / "c.yaml").write_text(
        "/**:\n  ros__parameters:\n    input: {joint: a, axis: y}\n    model: {law: lms}\n"
    )
    config = common.config_from(
        parsed("--config", str(tmp_path / "c.yaml"), "--joint", "b"), {"model.law": "nlms", "model.type": None}
    )
    assert (config.input.joint, config.input.axis, config.model.law) == ("b", "y", "nlms")
    assert config.model.type == "parallel"
