"""`diagnose --each`: a row a recording, since when a rig shows what, and how it grows."""

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pages
import pytest
from dask_cluster import ROOT, cluster
from pyarrow import parquet

from friction_estimator.bag.read import read_recording
from friction_estimator.bag.samples import to_samples
from friction_estimator.bag.write import write_samples
from friction_estimator.cli.each import rig_of
from friction_estimator.cli.main import main
from friction_estimator.core.errors import InputError
from friction_estimator.core.settings.config import Config
from friction_estimator.fleet.trend import DAY, HOUR, RECORDING, Entry, trends

pytestmark = pytest.mark.xdist_group("fleet")

DAY_NS = 86_400 * 10**9
BEGIN_NS = 1_700_000_000 * 10**9


def run(*words):
    try:
        return main(["diagnose", *map(str, words)])
    except SystemExit as end:
        return end.code


# Trends


def entry(day, value=None, half=0.01, rig="a", verdict="effects_found", dated=True, name="sensor_bias"):
    ci = [None, None] if half is None else [value - half, value + half] if value is not None else None
    found = [] if value is None else [
        {"name": name, "what": "it reads too much", "parameters": {"bias": {"value": value, "unit": "N", "ci95": ci}},
         "gain": {"reduction_percent": 10.0 * value}}
    ]  # fmt: skip
    row = {
        "verdict": verdict,
        "effects": found,
        "faults": [],
        "start_ns": int(BEGIN_NS + day * DAY_NS) if dated else None,
    }
    return Entry(rig, f"{rig}/{day}", row)


def test_since_when_and_how_it_grows_in_order_of_time():
    given = [entry(day, 0.1 * day) for day in (9, 3, 6)] + [entry(0), entry(1, verdict="undecidable")]
    (trend,) = trends(given)
    assert (trend.recordings, trend.of) == (3, 4)
    assert (trend.since.bag, trend.before.bag) == ("a/3", "a/0")
    assert trend.gain_percent == pytest.approx(6.0)
    (course,) = trend.courses
    assert (course.name, course.unit, course.first, course.last) == (
        "bias",
        "N",
        pytest.approx(0.3),
        pytest.approx(0.9),
    )
    assert course.growth.per == DAY
    assert course.growth.value == pytest.approx(0.1)
    assert course.growth.told


def test_rigs_are_apart_and_two_recordings_make_no_line():
    found = trends([entry(day, value, rig=rig) for rig, value in (("a", 0.2), ("b", 0.3)) for day in (0, 5)])
    assert [(trend.rig, trend.courses[0].growth) for trend in found] == [("a", None), ("b", None)]


def test_recordings_without_a_date_are_counted_and_those_of_a_day_take_hours():
    counted = trends([entry(k, 0.1 * k, dated=False) for k in range(1, 5)])[0].courses[0].growth
    assert (counted.per, counted.value) == (RECORDING, pytest.approx(0.1))
    of_a_day = trends([entry(k / 24.0, 0.1 * (k + 1)) for k in range(4)])[0].courses[0].growth
    assert (of_a_day.per, of_a_day.value) == (HOUR, pytest.approx(0.1))


def test_the_interval_of_a_growth_covers_the_truth_where_recordings_scatter_beyond_their_intervals():
    """Scatter of 0.05 between recordings beside intervals of 0.01: without the widening hardly any would cover."""
    generator, covered, trials = np.random.default_rng(0), 0, 300
    for _ in range(trials):
        values = 1.0 + 0.02 * np.arange(8) + 0.05 * generator.normal(size=8)
        growth = trends([entry(day, value) for day, value in enumerate(values)])[0].courses[0].growth
        covered += growth.low <= 0.02 <= growth.high
    assert 0.91 * trials <= covered <= 0.99 * trials


def test_values_without_intervals_count_alike():
    values = [1.0, 1.2, 1.1, 1.5]
    growth = trends([entry(day, value, half=None) for day, value in enumerate(values)])[0].courses[0].growth
    assert growth.value == pytest.approx(np.polyfit(range(4), values, 1)[0])
    assert growth.low < growth.value < growth.high


@pytest.mark.parametrize(
    ("path", "pattern", "rig"),
    [
        ("fleet/press_3/monday", None, "press_3"),
        ("fleet/press_3/monday/metadata.yaml", None, "press_3"),
        ("fleet/press_3_monday.mcap", "press_[0-9]+", "press_3"),
        ("fleet/press_3_monday.mcap", "press_([0-9]+)", "3"),
    ],
)
def test_a_rig_is_named_by_its_folder_or_by_a_pattern(path, pattern, rig):
    assert rig_of(path, pattern) == rig


@pytest.mark.parametrize("pattern", ["axis", "press_("])
def test_a_pattern_that_does_not_do_is_told(pattern):
    with pytest.raises(InputError, match="--rig "):
        rig_of("fleet/press_3", pattern)


# The verb


@pytest.fixture(scope="module")
def fleet(tmp_path_factory):
    """Three recordings of a rig whose sensor gains 0.2 N a day, and a file that is none."""
    folder = tmp_path_factory.mktemp("fleet")
    for day in range(3):
        words = ["--schedule", "1:50:8,2:50:8:crank", "--rate", 200, "--plant", "clean", "--seed", day]
        words += ["--effect", f"sensor_bias:bias={0.2 * (day + 1):g}"]
        assert main(["simulate", *map(str, words), "--out", str(folder / "made")]) == 0
        samples = to_samples(read_recording(folder / "made"), Config()).samples
        (folder / "rig").mkdir(exist_ok=True)
        write_samples(folder / "rig" / f"day_{day}", replace(samples, stamp_ns=samples.stamp_ns + day * DAY_NS))
    (folder / "rig" / "broken.mcap").write_bytes(b"nothing")
    return folder / "rig"


@pytest.fixture(scope="module")
def diagnosed(fleet, tmp_path_factory):
    out = tmp_path_factory.mktemp("out") / "out"
    assert run(*sorted(fleet.iterdir()), "--each", "--workers", 2, "--out", out) == 0
    return out


def test_a_cluster_says_the_same_to_the_bit(fleet, diagnosed, tmp_path):
    with cluster(tmp_path) as (address, _):
        command = [sys.executable, "-m", "friction_estimator", "diagnose", *map(str, sorted(fleet.iterdir())), "--each"]
        command += ["--scheduler", address, "--out", str(tmp_path / "out")]
        done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    for name in ("rows.jsonl", "table.parquet", "findings.parquet"):
        assert (diagnosed / name).read_bytes() == (tmp_path / "out" / name).read_bytes(), name


def test_a_fleet_is_a_row_a_recording_with_what_grows(fleet, diagnosed):
    summary = json.loads((diagnosed / "summary.json").read_text())
    assert summary["schema"] == "friction_estimator/fleet/1"
    rows = {row["bag"].rpartition("/")[2]: row for row in summary["recordings"]}
    assert "broken.mcap is damaged" in rows["broken.mcap"]["problem"]
    assert rows["day_1"]["start"] == "2023-11-15T22:13:20Z"
    for day in range(3):
        (effect,) = rows[f"day_{day}"]["effects"]
        low, high = effect["parameters"]["bias"]["ci95"]
        assert low < 0.2 * (day + 1) < high
    (trend,) = summary["trends"]
    assert (trend["rig"], trend["name"], trend["recordings"], trend["of"]) == ("rig", "sensor_bias", 3, 3)
    growth = trend["parameters"]["bias"]["growth"]
    assert growth["per"] == "day"
    assert growth["ci95"][0] < 0.2 < growth["ci95"][1]
    table = parquet.read_table(diagnosed / "table.parquet").to_pydict()
    assert len(table["bag"]) == 4
    assert table["effects"][1] == ["sensor_bias"]
    findings = parquet.read_table(diagnosed / "findings.parquet").to_pydict()
    assert findings["parameter"] == ["bias"] * 3
    text = pages.words((diagnosed / "report.html").read_text())
    assert "the force sensor reads a constant too much" in text
    assert "{" not in text


def test_who_hands_out_recordings_loads_nothing_that_computes_or_draws(fleet, diagnosed):
    """A run is as long as what one process does alone, whatever the number of processes beside it."""
    words = ["diagnose", *map(str, sorted(fleet.iterdir())), "--each", "--workers", "1", "--out", str(diagnosed)]
    code = (
        "import sys\nfrom friction_estimator.cli.main import main\n"
        f"if __name__ == '__main__':\n    main({words!r})\n"
        "    heavy = ('numba', 'scipy.optimize', 'bokeh', 'rosbags')\n"
        "    print([name for name in heavy if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.splitlines()[-1] == "[]", done.stdout
    assert "the force sensor reads a constant too much" in pages.words((diagnosed / "report.html").read_text())


def test_a_row_is_what_diagnose_says_of_that_recording_alone(fleet, diagnosed, capsys):
    capsys.readouterr()
    assert run(fleet / "day_1", "--json", "-") == 0
    alone = json.loads(capsys.readouterr().out)
    row = next(
        one for one in json.loads((diagnosed / "summary.json").read_text())["recordings"] if "day_1" in one["bag"]
    )
    for name in (
        "verdict",
        "units",
        "excitation",
        "base",
        "total_gain",
        "traces",
        "needs_channel",
        "unexplained_percent",
    ):
        assert row[name] == alone[name]
    assert [one["parameters"] for one in row["effects"]] == [one["parameters"] for one in alone["effects"]]


def test_rows_are_taken_over_and_one_process_says_the_same(fleet, diagnosed, capsys):
    before = {path.name: path.read_bytes() for path in diagnosed.iterdir() if path.suffix in (".jsonl", ".parquet")}
    capsys.readouterr()
    assert run(*sorted(fleet.iterdir()), "--each", "--workers", 1, "--out", diagnosed) == 0
    assert "taken over  3 of 4 rows" in capsys.readouterr().out  # what failed is tried again
    assert {name: (diagnosed / name).read_bytes() for name in before} == before


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--each"], "--each needs --out"),
        (["--each", "--out", "o", "--units", "mm"], "--units is not for --each"),
        (["--each", "--out", "o", "--figures", "svg"], "--figures is not for --each"),
        (["--each", "--out", "o", "--joint", "all"], "name one joint"),
        (["--rig", "x"], "--rig goes with --each"),
        (["--workers", "2"], "--workers goes with --each"),
    ],
)
def test_wrong_use_is_one_line(fleet, tmp_path, monkeypatch, capsys, words, said):
    monkeypatch.chdir(tmp_path)
    assert run(fleet / "day_0", *words) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
