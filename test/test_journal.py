"""What an unfinished run has computed outlives it in the staging folder, and nothing hidden outlives the next run."""

import os
import signal
import subprocess
import sys

import pytest

from friction_estimator.core.errors import InputError, UnanswerableError
from friction_estimator.output.journal import Journal
from friction_estimator.output.run import RunOutput
from friction_estimator.output.staging import InUseError

WRITER = (
    "import os, signal, sys\nfrom friction_estimator.output.run import RunOutput\n"
    "with RunOutput(sys.argv[1], lambda folder: None, resumes=True) as output, output.journal() as journal:\n"
    "    for k in range(3): journal.add(str(k), [k])\n"
    "    os.kill(os.getpid(), getattr(signal, sys.argv[2]))\n"
)


def anything(folder):
    """Refuses nothing."""


def put(out, **options):
    with RunOutput(out, anything, **options) as output, output.part() as part:
        part.mkdir()
        (part / "a").write_text("new")


@pytest.mark.parametrize("name", ["SIGKILL", "SIGINT", "SIGTERM"])
def test_rows_outlive_a_run_that_is_ended_and_go_with_the_one_that_finishes(tmp_path, name):
    out = tmp_path / "out"
    subprocess.run([sys.executable, "-c", WRITER, str(out), name], capture_output=True, check=False)
    assert os.listdir(tmp_path) == [".out.friction_estimator"]
    with RunOutput(out, anything, resumes=True) as output:
        assert output.journal().rows() == {"0": [0], "1": [1], "2": [2]}
        with pytest.raises(InUseError, match="in use by process"), RunOutput(out, anything, resumes=True):
            pass
    put(out, resumes=True)
    assert os.listdir(tmp_path) == ["out"]


def test_a_run_that_does_not_resume_sweeps_the_rows(tmp_path):
    out = tmp_path / "out"
    subprocess.run([sys.executable, "-c", WRITER, str(out), "SIGKILL"], capture_output=True, check=False)
    put(out)
    assert os.listdir(tmp_path) == ["out"]


def test_a_wrong_option_of_the_next_run_loses_no_row(tmp_path):
    out = tmp_path / "out"
    subprocess.run([sys.executable, "-c", WRITER, str(out), "SIGKILL"], capture_output=True, check=False)

    def refused():
        with RunOutput(out, anything, resumes=True):
            raise InputError("no such setting")

    with pytest.raises(InputError):
        refused()
    with RunOutput(out, anything, resumes=True) as output:
        assert len(output.journal().rows()) == 3


def test_a_set_that_cannot_be_put_in_place_keeps_its_rows(tmp_path):
    out = tmp_path / "out"

    def failing():
        with RunOutput(out, anything, resumes=True) as output:
            with output.journal() as journal:
                journal.add("a", 1)
            with output.part() as part:
                part.mkdir()
                raise UnanswerableError

    with pytest.raises(UnanswerableError):
        failing()
    assert not out.exists()
    with RunOutput(out, anything, resumes=True) as output:
        assert output.journal().rows() == {"a": 1}


def test_nothing_computed_leaves_nothing(tmp_path):
    with RunOutput(tmp_path / "deep" / "out", anything, resumes=True):
        pass
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("damage", [b'{"key":"x","row":', b"\0\0\0\0", b"[1]\n", b"\xff\xfe\n", b"[" * 100_000 + b"\n"])
def test_a_damaged_line_is_passed_over(tmp_path, damage):
    path = tmp_path / "rows"
    with Journal(path) as journal:
        journal.add("a", 1)
    with path.open("ab") as file:
        file.write(damage)
    with Journal(path) as journal:
        journal.add("b", 2)
    assert Journal(path).rows() == {"a": 1, "b": 2}


@pytest.mark.skipif(not hasattr(signal, "SIGXFSZ"), reason="limits of the size of files")
def test_a_full_disk_is_one_line_and_loses_no_row_before_it(tmp_path):
    code = (
        "import resource, signal, sys\nfrom pathlib import Path\n"
        "from friction_estimator.core.errors import InputError\n"
        "from friction_estimator.output.journal import Journal\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\nresource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))\n"
        "try:\n"
        "    with Journal(Path(sys.argv[1])) as journal:\n"
        "        for k in range(9): journal.add(str(k), 'x' * 20)\n"
        "except InputError as error: print(error)\n"
    )
    path = tmp_path / "rows"
    done = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True)
    assert done.stdout == f"cannot write {path}: File too large; choose another --out\n"
    assert list(Journal(path).rows()) == ["0", "1"]
