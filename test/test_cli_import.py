"""`import`: a table becomes a recording, and the words say what was left out."""

import json

import numpy as np
import pytest

from friction_estimator.bag.read import read_recording
from friction_estimator.bag.samples import to_samples
from friction_estimator.cli.main import main
from friction_estimator.core.settings.config import Config

TABLE = """t_ms,v_mm_s,F_N,p_Pa,seal,piece
0,10,1,5e5,O,1
10,20,2,,O,1
20,,3,5e5,O,1
30,40,4,5e5,O,2
40,50,5,5e5,X,2
5,60,6,5e5,O,2
5,70,7,5e5,O,2
"""

MAP = "velocity=v_mm_s*1e-3,friction=F_N*-1,pressure=p_Pa+101325"


@pytest.fixture
def table(tmp_path):
    path = tmp_path / "rig.csv"
    path.write_text(TABLE)
    return str(path)


def run(*words):
    return main(["import", *words])


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_table_becomes_a_recording(tmp_path, table, capsys, storage):
    out = str(tmp_path / "bag")
    words = ["--time", "t_ms*1e-3", "--map", MAP, "--where", "seal=O", "--segment", "piece", "--storage", storage]
    assert run(table, "--out", out, *words, "--json", "-") == 0
    printed = capsys.readouterr()
    summary = json.loads(printed.out)
    assert summary["schema"] == "friction_estimator/import/1"
    assert (summary["rows"], summary["selected"], summary["samples"], summary["gaps"]) == (7, 6, 3, 1)
    assert summary["missing"] == {"velocity": 1}
    assert summary["backward"] == 2
    assert "missing samples (rows left out): 1 empty velocity, 2 backward time" in printed.err
    assert "pressure: 1 empty or infinite cells; the last value is held" in printed.err

    admitted = to_samples(read_recording(out), Config())
    np.testing.assert_allclose(admitted.samples.velocity_m_s, [0.010, 0.020, 0.040])
    np.testing.assert_array_equal(admitted.samples.friction_N, [-1, -2, -4])
    np.testing.assert_array_equal(admitted.samples.pressure_Pa, np.full(3, 601325.0))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--map", "velocity=v_mm_s"], "the map has no friction"),
        (["--map", "velocity=v_mm_s,friction"], "--map friction: write INPUT=EXPRESSION"),
        (["--map", "velocity=v_mm_s", "--map", "velocity=F_N"], "velocity is mapped twice"),
        (["--map", "velocity=v_mms,friction=F_N"], "no column 'v_mms'; nearest: v_mm_s"),
        (["--map", MAP, "--where", "seal"], "--where seal: write COLUMN=VALUE"),
        (["--map", MAP, "--where", "seal=Q"], "no row matches seal=Q; the column holds O, X"),
        (["--map", "velocity=v_mm_s,friction=seal"], "column seal: row 1 (the header not counted) holds 'O'"),
        (["--map", MAP, "--segment", "pieces"], "no column 'pieces'; nearest: piece"),
    ],
)
def test_a_wrong_word_is_answered_in_one_line(tmp_path, table, capsys, words, message):
    assert run(table, "--out", str(tmp_path / "bag"), "--time", "t_ms*1e-3", *words) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert len(printed.err.splitlines()) == 1
    assert message in printed.err
    assert not (tmp_path / "bag").exists()


def test_a_table_without_a_usable_row_cannot_answer(tmp_path, capsys):
    (tmp_path / "rig.csv").write_text("t,v,f\n0,,\n")
    words = ["--out", str(tmp_path / "bag"), "--time", "t", "--map", "velocity=v,friction=f"]
    assert run(str(tmp_path / "rig.csv"), *words) == 1
    assert "no usable row: 1 without velocity" in capsys.readouterr().err


def test_unlikely_units_are_doubted_on_stderr(tmp_path, table, capsys):
    words = ["--out", str(tmp_path / "bag"), "--time", "t_ms*1e-3", "--map", "velocity=v_mm_s,friction=F_N"]
    assert run(table, *words) == 0
    assert "warning: velocity reaches 50 m/s" in capsys.readouterr().err
