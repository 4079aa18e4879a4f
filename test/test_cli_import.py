"""`import`: a table becomes a recording, and the words say what was left out."""

import json

import numpy as np
import pandas as pd
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


@pytest.mark.parametrize("name", ["rig.csv", "rig.npz", "rig.mat", "rig.parquet"])
def test_a_git_lfs_pointer_is_named(tmp_path, capsys, name):
    (tmp_path / name).write_text("version https://git-lfs.github.com/spec/v1\noid sha256:4d\nsize 2873394\n")
    assert (
        run(str(tmp_path / name), "--out", str(tmp_path / "bag"), "--time", "t", "--map", "velocity=v,friction=f") == 2
    )
    said = capsys.readouterr().err
    assert "not the file itself, which has 2873394 bytes: run `git lfs pull`" in said


@pytest.mark.parametrize("name", ["a.mcap", "a.db3", "a.bag", "folder/a.mcap", "folder/metadata.yaml"])
def test_a_recording_that_is_a_git_lfs_pointer_is_named(tmp_path, capsys, name):
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    (tmp_path / name).write_text("version https://git-lfs.github.com/spec/v1\noid sha256:4d\nsize 2873394\n")
    target = tmp_path / name.split("/")[0]
    assert main(["info", str(target)]) == 2
    assert "is a Git LFS pointer" in capsys.readouterr().err


def write(path, text, encoding="utf-8"):
    path.write_bytes(text.encode(encoding))
    return str(path)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252", "utf-16"])
def test_tables_as_spreadsheets_write_them(tmp_path, encoding):
    rows = "".join(f"{k};{k / 2};{1000.5 + k}\n".replace(".", ",") for k in range(50))
    path = write(tmp_path / "rig.csv", "Zeit [s];Geschw. [mm/s];Kraft [N] für µ\n" + rows, encoding)
    words = ["--time", "Zeit", "--map", "velocity=Geschw.,friction=Kraft [N] für µ"]
    assert run(path, "--out", str(tmp_path / "bag"), *words) == 0
    samples = to_samples(read_recording(tmp_path / "bag"), Config()).samples
    np.testing.assert_allclose(samples.velocity_m_s, 0.5e-3 * np.arange(50))
    np.testing.assert_allclose(samples.friction_N, 1000.5 + np.arange(50))


def test_thousands_and_decimal_commas(tmp_path):
    path = write(tmp_path / "rig.csv", "t;v;f\n0;0,5;1.234,5\n1;0,25;-2.000,0\n2;1;3\n")
    assert run(path, "--out", str(tmp_path / "bag"), "--time", "t", "--map", "velocity=v,friction=f") == 0
    samples = to_samples(read_recording(tmp_path / "bag"), Config()).samples
    assert samples.velocity_m_s.tolist() == [0.5, 0.25, 1.0]
    assert samples.friction_N.tolist() == [1234.5, -2000.0, 3.0]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--map", "velocity=v_mm_s,friction=F_N*"], "--map friction: F_N*: cannot be read"),
        (["--map", "velocity=sinn(v_mm_s),friction=F_N"], "no function 'sinn'; nearest: sin"),
        (["--map", "velocity=v_mm_s/0,friction=F_N"], "a division by zero leaves nothing of v_mm_s"),
        (["--map", "velocity=velocity,friction=F_N"], "--map velocity: no column 'velocity'"),
        (
            ["--map", "velocity=d(position),position=velocity*2,friction=F_N"],
            "velocity refers to itself: velocity -> pos",
        ),
        (["--map", "velocity=v_mm_s[N],friction=F_N"], "--map velocity=v_mm_s[N] is a linear force, where velocity"),
        (["--map", "velocity=v_mm_s[deg/s],friction=F_N[N]"], "velocity is a rotary velocity and friction is a linear"),
        (["--map", "velocity=3,friction=F_N"], "--map velocity=3 names no column"),
        (["--map", "friction=F_N"], "the map has no velocity: give velocity=COLUMN, or velocity=d(COLUMN)"),
        (["--map", MAP, "--rate", "-5"], "--rate -5: the samples can be given at at most"),
    ],
)
def test_a_wrong_expression_is_answered_in_one_line(tmp_path, table, capsys, words, message):
    assert run(table, "--out", str(tmp_path / "bag"), "--time", "t_ms*1e-3", *words) == 2
    printed = capsys.readouterr()
    assert len(printed.err.splitlines()) == 1
    assert table in printed.err
    assert message in printed.err


def test_what_has_no_answer_is_missing(tmp_path, capsys):
    path = write(tmp_path / "rig.csv", "t,v,f,g\n0,1,4,1\n1,1,4,0\n2,1,-4,1\n3,1,9,1\n4,1,0,0\n")
    words = ["--time", "t", "--map", "velocity=v,friction=sqrt(f)/g"]
    assert run(path, "--out", str(tmp_path / "bag"), *words) == 0
    assert "missing samples (rows left out): 2 empty friction, 1 infinite friction" in capsys.readouterr().out
    samples = to_samples(read_recording(tmp_path / "bag"), Config()).samples
    assert samples.friction_N.tolist() == [2.0, 3.0]


def test_units_of_rotation_make_the_recording_rotary(tmp_path, capsys):
    """Degrees, or rpm in the header: angular velocity and torque are written, and read again without configuration."""
    t = np.arange(400) / 100.0
    columns = {
        "t": t,
        "q": np.degrees(np.sin(t)),
        "n [rpm]": np.cos(t) * 60 / (2 * np.pi),
        "tau": 1e3 * np.sign(np.cos(t)),
    }
    pd.DataFrame(columns).to_csv(tmp_path / "arm.csv", index=False)
    words = ["--time", "t", "--map", "velocity=n,position=q[deg],friction=tau[mN m]"]
    assert run(str(tmp_path / "arm.csv"), "--out", str(tmp_path / "bag"), *words) == 0
    assert "rotary drive: rad/s, N m and rad are written" in capsys.readouterr().out
    recording = read_recording(tmp_path / "bag")
    assert recording.motion == "rotary"
    samples = to_samples(recording, Config()).samples
    np.testing.assert_allclose(samples.velocity_m_s, np.cos(t), atol=1e-12)
    np.testing.assert_allclose(samples.friction_N, np.sign(np.cos(t)))
    np.testing.assert_allclose(samples.position_m, np.sin(t), atol=1e-12)
