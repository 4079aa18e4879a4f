"""Tables become samples: what a row holds arrives, what it lacks is counted, and time never restarts."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from friction_estimator.bag.expression import Expression
from friction_estimator.bag.read import read_recording
from friction_estimator.bag.samples import to_samples
from friction_estimator.bag.table import read_table
from friction_estimator.bag.table_map import GAP_PERIODS, RESTART_GAP_S, TableSpec
from friction_estimator.bag.write import write_samples
from friction_estimator.core.errors import FrictionEstimatorError, InputError, UnanswerableError
from friction_estimator.core.sample import NS_PER_S
from friction_estimator.core.settings.config import Config

SPEC = TableSpec("t", {"velocity": "v", "friction": "f"})


def table(tmp_path, text, name="run.csv"):
    (tmp_path / name).write_text(text)
    return tmp_path / name


def plain(n=30):
    t = 0.01 * np.arange(n)
    return {"t": t, "v": np.sin(t), "f": np.cos(t), "p": 1e5 + t}


# Formats


def write_csv(path, columns):
    pd.DataFrame(columns).to_csv(path, index=False)


def write_tsv(path, columns):
    pd.DataFrame(columns).to_csv(path, index=False, sep="\t")


def write_npz(path, columns):
    np.savez(path, **columns)


def write_parquet(path, columns):
    pd.DataFrame(columns).to_parquet(path)


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("run.csv", write_csv),
        ("run.tsv", write_tsv),
        ("run.npz", write_npz),
        ("run.mat", savemat),
        ("run.parquet", write_parquet),
    ],
)
def test_every_format_gives_the_same_samples(tmp_path, name, write):
    columns = plain()
    write(tmp_path / name, columns)
    spec = TableSpec("t", {"velocity": "v", "friction": "f*-2+1", "pressure": "p+101325"})
    samples, report = read_table(tmp_path / name, spec)
    np.testing.assert_array_equal(samples.velocity_m_s, columns["v"])
    np.testing.assert_array_equal(samples.friction_N, -2.0 * columns["f"] + 1.0)
    np.testing.assert_array_equal(samples.pressure_Pa, columns["p"] + 101325.0)
    np.testing.assert_allclose(samples.time_s, columns["t"], atol=1e-9)
    assert samples.stamp_ns[0] == NS_PER_S
    assert (report.rows, report.selected, report.pieces, report.shift_s) == (30, 30, 1, 1.0)


def test_structures_and_matrices_become_columns(tmp_path):
    columns = plain()
    savemat(tmp_path / "run.mat", {"rig": {"log": np.column_stack([columns["t"], columns["v"]])}, "f": columns["f"]})
    spec = TableSpec("rig.log[0]", {"velocity": "rig.log[1]*1e-3", "friction": "f"})
    np.testing.assert_array_equal(read_table(tmp_path / "run.mat", spec)[0].velocity_m_s, 1e-3 * columns["v"])


@pytest.mark.parametrize("separator", [",", ";", "\t", ", "])
def test_separators_are_found_and_words_and_blanks_survive(tmp_path, separator):
    rows = [["t", " v", "f", "note"], ["0", "1", "2", "a b"], ["1", "", "3", ""], ["2", "5", "6", "x"]]
    path = table(tmp_path, "\n".join(separator.join(row) for row in rows) + "\n")
    samples, report = read_table(path, SPEC)
    np.testing.assert_array_equal(samples.velocity_m_s, [1.0, 5.0])
    assert report.missing == {"velocity": 1}


# What cannot be read


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("run.xlsx", b"PK", "is no table that can be read; expected one of .csv"),
        ("run.csv", b"", "has no header line"),
        ("run.csv", b"t,v,f\n", "no usable row: the table is empty"),
        ("run.csv", b"t,v,f\n0,1\n1,2,3,4,5\n", "is no readable csv table"),
        ("run.csv", b"t," * 10_000 + b"v\n0,1\n", "names 10001 columns; at most 10000 are read"),
        ("run.csv", b"t,v,f\n0,1,2,3\n1,2,3,4\n", "its rows hold 4 cells and the header names 3: name every column"),
        ("run.csv", b"t,v," + b"f" * 2_000_000, "has a first line of more than"),
        ("run.csv", b"t,v,f\n0,1,\xff\xfe\n", "is no readable csv table"),
        ("run.csv", b"t,v,force\n0,1,2\n", "no column 'f'; "),
        ("run.csv", b"t,vel,f\n0,1,2\n", "no column 'v'; columns: t, vel, f"),
        ("run.csv", b"t,v,f\n0,1,2\n1,fast,2\n2,quick,3\n", "column v: row 2 (the header not counted) holds 'fast'"),
        (
            "run.csv",
            b"t;v;f\n0;0,5;2.5\n",
            "holds '0,5', no number; write all numbers with a decimal point or all with",
        ),
        (
            "run.csv",
            b"t,v,f\n0,,2\n1,2,\n,2,3\n",
            "no usable row: 1 without time, 1 without velocity, 1 without friction",
        ),
        ("run.csv", b"t,v,f\n1e12,1,2\n", "beyond what a stamp can hold; is it in seconds? *1e-3 takes milliseconds"),
        ("run.npz", b"text", "is no .npz file: write it with numpy.savez"),
        ("run.mat", b"text" * 40, "is no readable mat table"),
        (
            "run.mat",
            b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + bytes(64),
            "is a MATLAB v7.3 file; save it again",
        ),
        ("run.parquet", b"text", "is no readable parquet table"),
    ],
)
def test_a_table_that_cannot_be_used_is_refused_in_one_line(tmp_path, name, content, words):
    (tmp_path / name).write_bytes(content)
    with pytest.raises((InputError, UnanswerableError)) as caught:
        read_table(tmp_path / name, SPEC)
    assert str(tmp_path / name) in str(caught.value)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_is_not_there_is_named(tmp_path):
    with pytest.raises(InputError, match=r"gone.csv: no such file"):
        read_table(tmp_path / "gone.csv", SPEC)
    with pytest.raises(InputError, match=r"gone.npz: no such file"):
        read_table(tmp_path / "gone.npz", SPEC)
    np.savez(tmp_path / "odd.npz", t=np.arange(3.0), v=np.arange(3.0), f=np.arange(4.0))
    with pytest.raises(InputError, match="the columns differ in length: t 3, v 3, f 4"):
        read_table(tmp_path / "odd.npz", SPEC)


def test_a_reader_that_is_not_installed_is_named_with_its_remedy(tmp_path, monkeypatch):
    (tmp_path / "pyarrow.py").write_text("raise ModuleNotFoundError('No module', name='pyarrow')")
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "run.parquet").write_bytes(b"")
    with pytest.raises(InputError, match=r"run.parquet: reading it needs pyarrow: pip install pyarrow"):
        read_table(tmp_path / "run.parquet", SPEC)


@pytest.mark.parametrize(
    ("inputs", "words"),
    [
        ({"velocity": "v"}, "the map has no friction: give velocity=COLUMN,friction=COLUMN"),
        ({"friction": "f"}, "the map has no velocity: give velocity=COLUMN, or velocity=d(COLUMN) of a position"),
        ({"velocity": "v", "friction": "f", "presure": "p"}, "unknown input 'presure' in the map; nearest: pressure"),
        ({"velocity": "v*0", "friction": "f"}, "--map velocity: v*0: a factor of zero leaves nothing of v"),
    ],
)
def test_a_map_that_makes_no_sense_is_refused(tmp_path, inputs, words):
    path = table(tmp_path, "t,v,f,p\n0,1,2,3\n")
    with pytest.raises(InputError) as caught:
        read_table(path, TableSpec("t", inputs))
    assert words in str(caught.value)


# Names of columns

names = st.text("abv_[]/ .-+*12", min_size=1, max_size=8).map(str.strip).filter(bool)
plain_names = names.filter(lambda name: name[0] in "abv_")
factors = st.floats(1e-6, 1e6) | st.floats(-1e6, -1e-6)


@settings(derandomize=True)
@given(plain_names, factors, st.floats(-1e9, 1e9))
def test_scale_and_offset_are_read_whatever_the_column_is_called(name, scale, offset):
    text = f"{name}*{scale!r}{'+' if offset >= 0 else '-'}{abs(offset)!r}"
    found = Expression.parse(text, [name])
    assert found.columns == (name,)
    assert found.value({name: np.array([3.0])}.__getitem__).data[0] == 3.0 * scale + offset


@settings(derandomize=True)
@given(names)
def test_a_column_s_whole_name_and_its_name_in_quotes_are_the_column(name):
    for text in (name, f"'{name}'", f'"{name}"*2'):
        assert Expression.parse(text, [name, "other"]).columns == (name,)


# Rows


def test_rows_are_filtered_by_words_and_by_numbers(tmp_path):
    path = table(tmp_path, "t,v,f,seal,bar\n0,1,2,O,1\n1,2,3,X,1\n2,3,4,O,3.0\n3,4,5,O,1\n")

    def velocities(*where):
        return read_table(path, TableSpec("t", SPEC.inputs, where))[0].velocity_m_s.tolist()

    assert velocities(("seal", "O")) == [1, 3, 4]
    assert velocities(("bar", "1")) == [1, 2, 4]
    assert velocities(("bar", "1.0"), ("seal", "O")) == [1, 4]
    with pytest.raises(InputError, match="no row matches seal=Q; the column holds O, X"):
        velocities(("seal", "Q"))
    with pytest.raises(InputError, match=r"the column holds numbers .* 'one' is none"):
        velocities(("bar", "one"))


def test_missing_duplicate_and_backward_rows_are_left_out_and_counted(tmp_path):
    text = "t,v,f,p\n" + "".join(
        f"{row}\n"
        for row in (
            "0,1,1,5e5",
            "0.1,2,2,",  # the channel's last value is held
            "0.1,3,3,5e5",  # duplicate
            "0.2,,4,5e5",  # missing
            "0.3,5,nan,5e5",  # missing
            "0.25,6,6,5e5",  # a little late, but later than what was kept
            "0.2,7,7,5e5",  # backward
            ",8,8,5e5",  # no time
            "0.5,9,9,5e5",
        )
    )
    spec = TableSpec("t", {**SPEC.inputs, "pressure": "p"})
    samples, report = read_table(table(tmp_path, text), spec)
    assert samples.velocity_m_s.tolist() == [1, 2, 6, 9]
    assert report.missing == {"time": 1, "velocity": 1, "friction": 1}
    assert (report.duplicate, report.backward, report.pieces) == (1, 1, 1)
    assert report.not_held == {"pressure": 1}
    assert np.isnan(samples.pressure_Pa[1])


def test_infinite_rows_are_left_out_and_counted_by_what_is_infinite(tmp_path):
    text = "t,v,f,p\n0,1,1,1e5\ninf,2,2,1e5\n-inf,3,3,1e5\n0.1,inf,4,1e5\n0.2,5,1e300,1e5\n0.3,6,6,inf\n,7,7,1e5\n"
    spec = TableSpec("t", {"friction": "f", "velocity": "v", "pressure": "p"})
    samples, report = read_table(table(tmp_path, text), spec)
    assert samples.velocity_m_s.tolist() == [1, 6]
    assert report.infinite == {"time": 2, "velocity": 1, "friction": 1}
    assert (report.missing, report.not_held, report.warnings) == ({"time": 1}, {"pressure": 1}, ())
    assert np.isnan(samples.pressure_Pa[1])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,v,f\n-1e18,1,2\n1,2,3\n2,3,4\n", "--time t runs from -1e+18 to 2 s, beyond what a stamp can hold"),
        ("t,v,f\n0,1,2\n1,2,3\n-1e300,3,4\n3,4,5\n", "--time t runs from -1e+300 to 3 s, beyond what a stamp"),
        ("t,v,f\n0,inf,2\n1,1,-inf\n", "no usable row: 1 with infinite velocity, 1 with infinite friction"),
    ],
)
def test_what_is_said_of_an_absurd_table_is_true(tmp_path, text, message):
    path = table(tmp_path, text)
    with pytest.raises(FrictionEstimatorError) as caught:
        read_table(path, SPEC)
    assert str(caught.value).startswith(f"{path}: {message}")


@st.composite
def pieces_of_time(draw):
    """Pieces of regular time, each from its own origin."""
    period = draw(st.sampled_from([1e-3, 0.01, 2.0]))
    sizes = draw(st.lists(st.integers(12, 40), min_size=1, max_size=5))
    starts = [draw(st.floats(0.0, 50.0)) for _ in sizes]
    return period, [start + period * np.arange(size) for start, size in zip(starts, sizes, strict=True)]


@settings(max_examples=30, deadline=None, derandomize=True)
@given(pieces_of_time())
def test_time_that_restarts_or_a_segment_makes_a_gap(tmp_path_factory, case):
    period, parts = case
    path = tmp_path_factory.mktemp("table") / "run.npz"
    label = np.repeat(np.arange(len(parts)) % 2, [part.size for part in parts])
    t = np.concatenate(parts)
    np.savez(path, t=t, v=np.arange(t.size) + 0.0, f=np.ones(t.size), label=label)
    samples, report = read_table(path, TableSpec("t", SPEC.inputs, segment="label"))
    assert len(samples) == t.size
    assert (report.missing, report.duplicate, report.backward) == ({}, 0, 0)
    assert report.pieces == len(parts)
    np.testing.assert_array_equal(np.flatnonzero(samples.restart), np.cumsum([0, *(p.size for p in parts[:-1])]))
    step = np.diff(samples.stamp_ns) / NS_PER_S
    inside = ~samples.restart[1:]
    np.testing.assert_allclose(step[inside], period, atol=1e-6)
    assert np.all(step[~inside] >= GAP_PERIODS * period - 1e-6)
    restarts = np.diff(t)[~inside] < 0
    assert np.all(step[~inside][restarts] >= RESTART_GAP_S - 1e-6)

    # Replay sees the same pieces: every boundary restarts the delay lines, nothing is lost.
    write_samples(path.parent / "run", samples)
    admitted = to_samples(read_recording(path.parent / "run"), Config())
    assert admitted.rejected == {}
    np.testing.assert_array_equal(admitted.samples.restart, samples.restart)
    np.testing.assert_array_equal(admitted.samples.velocity_m_s, samples.velocity_m_s)


@settings(deadline=None, derandomize=True)
@given(st.lists(st.floats(-10, 10) | st.just(float("nan")), min_size=1, max_size=40))
def test_any_column_of_time_gives_rising_stamps_and_every_row_is_accounted_for(tmp_path_factory, times):
    path = tmp_path_factory.mktemp("table") / "run.npz"
    np.savez(path, t=np.array(times), v=np.ones(len(times)), f=np.ones(len(times)))
    if np.isnan(times).all():
        with pytest.raises(UnanswerableError):
            read_table(path, SPEC)
        return
    samples, report = read_table(path, SPEC)
    left_out = sum(report.missing.values()) + report.duplicate + report.backward
    assert len(samples) + left_out == len(times)
    assert samples.stamp_ns[0] > 0
    assert np.all(np.diff(samples.stamp_ns) >= 0)


def test_unlikely_units_are_doubted(tmp_path):
    path = table(tmp_path, "t,v,f,p\n0,150,2,3e4\n1,-300,2,3e4\n")
    _, report = read_table(path, TableSpec("t", {**SPEC.inputs, "pressure": "p"}))
    assert "velocity reaches 300 m/s" in report.warnings[0]
    assert "gauge pressure is mapped as pressure=COLUMN+101325" in report.warnings[1]


# Measured tables


def test_the_positioning_axis_is_imported_whole(shared_data, tmp_path):
    inputs = {"velocity": "v_m_s", "friction": "friction_filt_N", "position": "q_filt_m"}
    samples, report = read_table(shared_data / "emps_nlgreyfast" / "data.csv", TableSpec("t_s", inputs))
    assert (len(samples), report.pieces, report.missing) == (24841, 1, {})
    write_samples(tmp_path / "run", samples)
    admitted = to_samples(read_recording(tmp_path / "run"), Config())
    assert (len(admitted.samples), admitted.rejected, admitted.gaps) == (24841, {}, 0)
    np.testing.assert_array_equal(admitted.samples.position_m, samples.position_m)


def test_pieces_without_a_usable_row_make_no_gap_of_their_own(tmp_path):
    rows = ["t,v,f,piece"]
    for k in range(100):
        piece = 0 if k < 50 else k if k < 60 else 99  # ten pieces of one row each, none with a velocity
        rows.append(f"{0.01 * k:.2f},{'' if 50 <= k < 60 else 0.1},1.0,{piece}")
    table = tmp_path / "short.csv"
    table.write_text("\n".join(rows) + "\n")
    samples, report = read_table(table, TableSpec("t", {"velocity": "v", "friction": "f"}, segment="piece"))
    assert report.pieces == 2
    step = np.diff(samples.stamp_ns) * 1e-9
    assert step.max() == pytest.approx(max(0.11, 20 * 0.01))
    assert np.flatnonzero(samples.restart).tolist() == [0, 50]


def test_the_pneumatic_seal_is_imported_with_its_gaps(shared_data, tmp_path):
    inputs = {"velocity": "v_m_s", "friction": "friction_N", "pressure": "pressure_Pa+101325"}
    spec = TableSpec("t_s", inputs, [("seal", "O-ring257")], "segment")
    samples, report = read_table(shared_data / "seal_zillen_pneumatic" / "data.csv", spec)
    assert report.selected == 27755
    assert len(samples) + sum(report.missing.values()) == report.selected
    assert report.pieces > 100
    assert samples.pressure_Pa is not None
    assert np.min(samples.pressure_Pa) > 101325 + 9e4
    write_samples(tmp_path / "run", samples)
    admitted = to_samples(read_recording(tmp_path / "run"), Config())
    assert admitted.rejected == {}
    assert admitted.gaps == report.pieces - 1
