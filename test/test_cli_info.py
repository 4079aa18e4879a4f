"""`info` says what is in a recording, what is wrong with its stamps, and what it cannot answer."""

import json
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from friction_estimator.bag import source as source_module
from friction_estimator.bag.merge import Part
from friction_estimator.bag.recording import Stream
from friction_estimator.bag.statistics import Account, describe, moving_speeds
from friction_estimator.bag.write import TOPICS, write_samples, writing
from friction_estimator.cli import info as info_verb
from friction_estimator.cli.main import main
from friction_estimator.core.sample import NS_PER_S, Samples
from friction_estimator.core.settings.groups import SyncConfig

START = 1_700_000_000 * NS_PER_S
MS = 1_000_000


def drive(velocity, period_ms=1, **channels):
    n = velocity.size
    return Samples(
        stamp_ns=START + period_ms * MS * np.arange(n),
        velocity_m_s=velocity,
        friction_N=5.0 * np.tanh(velocity / 1e-3) + 20.0 * velocity,
        restart=np.arange(n) == 0,
        **channels,
    )


def sine(n=20_000):
    return 0.1 * np.sin(2 * np.pi * np.arange(n) / 1000)


def info(path, capsys, *words):
    code = main(["info", str(path), "--json", "-", *words])
    printed = capsys.readouterr()
    return code, json.loads(printed.out), printed.err


def test_a_type_that_is_no_text_is_refused_in_one_line(tmp_path, capsys):
    """metadata.yaml of a recording is edited by people: `type: 1.5` is a number."""
    path = tmp_path / "bag"
    write_samples(path, drive(sine(2000), pressure_Pa=np.full(2000, 1e5)))
    about = path / "metadata.yaml"
    text = about.read_text()
    assert "sensor_msgs/msg/FluidPressure" in text
    about.write_text(text.replace("sensor_msgs/msg/FluidPressure", "1.5"))
    assert main(["info", str(path)]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert "metadata.yaml" in said.err


def test_a_channel_of_absurd_values_is_told_and_not_used(tmp_path, capsys):
    write_samples(
        tmp_path / "bag", drive(sine(2000), pressure_Pa=np.full(2000, 1e308), position_m=np.full(2000, -1e308))
    )
    code, result, _ = info(tmp_path / "bag", capsys)
    assert code == 0
    assert result["inputs"]["pressure"]["infinite"] == 2000
    assert sum("2000 of 2000 values of " in note for note in result["notes"]) == 2
    assert result["excitation"]["channels"] == ["velocity", "friction"]


# Figures of one stream


@given(st.lists(st.integers(1, 10**10) | st.just(0), min_size=1, max_size=30))
def test_every_stamp_is_counted_once(stamps):
    stamp_ns = np.array(stamps, np.int64)
    figures = describe(Stream("/v", "", stamp_ns, stamp_ns, np.ones(stamp_ns.size)), SyncConfig())
    forward = int(np.count_nonzero(np.diff(stamp_ns[stamp_ns != 0]) > 0))
    faults = figures.duplicate_stamps + figures.backward_stamps + figures.clock_jumps
    assert figures.messages == stamp_ns.size
    assert figures.zero_stamps + faults + forward == max(stamp_ns.size - 1, figures.zero_stamps)


@given(st.lists(st.integers(0, 9_000_000_000), min_size=1, max_size=60), st.integers(1, 7), st.integers(0, 9))
def test_figures_of_stamps_in_pieces_are_those_of_the_whole(steps, length, seed):
    """Against the formulas, with steps and delays beyond what four bytes hold."""
    rng = np.random.default_rng(seed)
    stamps = 10**18 + np.cumsum(steps) * rng.choice([1, 1, 1, -1], len(steps)) * rng.choice([1, 10**3])
    stamps[rng.random(stamps.size) < 0.1] = 0
    delay = rng.choice([0, 10**6, 10**12, 3 * 10**9], stamps.size)
    value = rng.choice([1.0, -2.0, np.nan, np.inf], stamps.size)
    account = Account(SyncConfig())
    for start in range(0, stamps.size, length):
        part = slice(start, start + length)
        account.add(Part(stamps[part], (stamps + delay)[part], value[part]))
    stream = Stream("/v", "", stamps, stamps + delay, value)
    found = account.figures(stream)
    known = stamps[stamps != 0]
    step = np.diff(known)
    forward = step[step > 0]
    assert found.zero_stamps == stamps.size - known.size
    assert found.delay_s == float(np.median(delay)) / NS_PER_S
    assert found.duplicate_stamps == np.count_nonzero(step == 0)
    assert found.nan == np.count_nonzero(np.isnan(value))
    if forward.size:
        period = float(np.median(forward))
        regular = forward[forward <= SyncConfig().gap_factor * period]
        assert found.rate_hz == NS_PER_S / period
        assert found.gaps == forward.size - regular.size
        assert found.longest_gap_s == forward.max() / NS_PER_S
        ends = np.quantile(regular, [0.01, 0.99])
        assert found.jitter_s == pytest.approx(float(np.ptp(ends)) / 2 / NS_PER_S, rel=1e-12)


def test_faults_of_stamps_and_values_are_told_apart():
    stamps = START + MS * np.array([0, 1, 2, 2, 4, 3, 5, 6, 7, 30, 31, 32])
    stamps[-1] -= 10 * NS_PER_S
    stamps[1] = 0
    value = np.array([1.0, np.nan, np.inf, -3.0, *np.zeros(8)])
    figures = describe(Stream("/v", "", stamps, stamps + 2 * MS, value, missing=4), SyncConfig())
    assert (figures.zero_stamps, figures.duplicate_stamps, figures.backward_stamps, figures.clock_jumps) == (1, 1, 1, 1)
    assert (figures.gaps, figures.longest_gap_s) == (1, 0.023)
    assert (figures.nan, figures.infinite, figures.missing) == (1, 1, 4)
    assert (figures.lowest, figures.highest) == (-3.0, 1.0)
    assert figures.delay_s == pytest.approx(0.002)


def test_the_usual_speeds_of_a_two_speed_drive_are_narrow():
    velocity = np.concatenate([np.full(500, 0.014), np.zeros(300), np.full(400, -0.015)])
    np.testing.assert_allclose(moving_speeds(velocity), [(0.014, 0.014), (-0.015, -0.015)])
    assert moving_speeds(np.abs(velocity))[1:] == []
    (near, far), _ = moving_speeds(sine())
    assert far / near > 3.0


# The verb


def test_a_good_recording_is_described(tmp_path, capsys):
    position = np.cumsum(sine()) * 1e-3
    write_samples(tmp_path / "run", drive(sine(), position_m=position), frame_id="rig")
    code, found, _ = info(tmp_path / "run", capsys)
    assert code == 0
    assert found["schema"] == "friction_estimator/info/1"
    assert {topic["name"]: topic["inputs"] for topic in found["topics"]} == {
        "/velocity": ["velocity"],
        "/friction": ["friction"],
        "/position": ["position"],
    }
    velocity = found["inputs"]["velocity"]
    assert (velocity["rate_hz"], velocity["unit"], velocity["frame_id"]) == (1000.0, "m/s", "rig")
    assert velocity["highest"] == pytest.approx(0.1)
    assert found["pairing"]["used"] == 20_000
    assert found["excitation"]["reversals"] == pytest.approx(39, abs=2)
    assert any("friction curve F(v)" in text for text in found["can"])
    assert any("no pressure channel" in text for text in found["cannot"])
    assert not any("no position channel" in text for text in found["cannot"])
    assert found["problem"] is None


def test_a_long_recording_is_described_by_its_beginning_and_says_so(tmp_path, capsys, monkeypatch):
    velocity = sine()
    velocity[12_000:] *= 3.0
    write_samples(tmp_path / "run", drive(velocity))
    monkeypatch.setattr(info_verb, "MOST_ASSESSED", 10_000)
    code, found, _ = info(tmp_path / "run", capsys)
    assert code == 0
    assert found["excitation"]["velocity_range"] == pytest.approx([-0.1, 0.1], rel=1e-3)
    assert found["excitation"]["notes"][0] == "the drive is described by the first 10000 of 20000 samples"
    assert (found["pairing"]["used"], found["inputs"]["velocity"]["highest"]) == (20_000, pytest.approx(0.3, rel=1e-3))


def test_the_words_hold_what_the_json_holds(tmp_path, capsys):
    write_samples(tmp_path / "run", drive(sine()))
    assert main(["info", str(tmp_path / "run")]) == 0
    text = capsys.readouterr().out
    for words in (
        "/velocity  geometry_msgs/TwistStamped  20000  -> velocity",
        "20000 used of 20000",
        "reversals",
        "cannot",
    ):
        assert words in text


@pytest.mark.parametrize(
    ("velocity", "words"),
    [
        (np.tile(np.repeat([0.014, -0.015], 500), 20), "curve F(v)"),
        (np.abs(sine()), "the shaft moves in one direction only"),
        (np.full(5000, 0.1), "the velocity never changes"),
        (sine(200), "usable samples are too few"),
        (sine(1500), "reversals in"),
        (
            sine() * np.linspace(0.3, 1, 20_000) + 0.05 * np.sin(np.arange(20_000) ** 1.2 / 300),
            "the drive is not periodic",
        ),
    ],
)
def test_what_a_drive_does_not_excite_is_said(tmp_path, capsys, velocity, words):
    write_samples(tmp_path / "run", drive(velocity))
    code, found, _ = info(tmp_path / "run", capsys)
    assert code == 0
    assert any(words in text for text in found["cannot"]), found["cannot"]


def test_wraps_standstill_steps_and_a_velocity_that_is_off_are_said(tmp_path, capsys):
    wave = 6.0 * sine() / 0.1
    velocity = np.where(np.abs(wave) < 2.0, 0.0, wave)
    position = (np.cumsum(velocity) * 1e-2 + 20.0) % 25.0 - 12.5
    shown = 0.01 * (np.round(0.6 * velocity / 0.01))
    write_samples(tmp_path / "run", drive(shown, period_ms=10, position_m=position))
    code, found, _ = info(tmp_path / "run", capsys)
    assert code == 0
    wraps = np.count_nonzero(np.abs(np.diff(position)) > 12.0)
    assert found["pairing"]["position_wraps"] == wraps > 0
    assert found["pairing"]["position_modulus"] == pytest.approx(25.0, rel=1e-3)
    facts = found["excitation"]
    assert facts["standstill_share"] == pytest.approx(np.mean(velocity == 0.0), abs=0.01)
    assert facts["velocity_step"] == pytest.approx(0.01, rel=1e-3)
    assert facts["velocity_over_position_rate"] == pytest.approx(0.6, rel=0.01)
    assert facts["drive_periods_s"] == pytest.approx([10.0], rel=0.01)
    assert len(facts["notes"]) == 2
    for words in ("quantised in such steps", "0.6 times the derivative of the position"):
        assert any(words in text for text in found["cannot"]), found["cannot"]


def test_a_recording_without_the_topics_is_listed_and_cannot_answer(tmp_path, capsys):
    with writing(tmp_path / "run") as writer:
        writer.add_stream(*TOPICS["pressure"], START + MS * np.arange(5), np.ones(5), quantity="pressure")
    code, found, error = info(tmp_path / "run", capsys)
    assert code == 1
    assert [topic["name"] for topic in found["topics"]] == ["/pressure"]
    assert "no topic for velocity or friction" in found["problem"]
    assert "no topic for velocity or friction" in error


def test_samples_that_never_pair_are_described_and_cannot_answer(tmp_path, capsys):
    times = START + MS * np.arange(50)
    with writing(tmp_path / "run") as writer:
        writer.add_stream(*TOPICS["velocity"], times, np.ones(50), quantity="velocity")
        writer.add_stream(*TOPICS["friction"], times + 1, np.ones(50), quantity="friction")
    code, found, _ = info(tmp_path / "run", capsys)
    assert code == 1
    assert found["inputs"]["velocity"]["messages"] == 50
    assert "set sync.slop" in found["problem"]


def test_an_ambiguous_recording_is_listed_and_asked_back(tmp_path, capsys):
    times = START + MS * np.arange(5)
    with writing(tmp_path / "run") as writer:
        for name in ("/left/velocity", "/right/velocity"):
            writer.add_stream(name, TOPICS["velocity"][1], times, np.ones(5), quantity="velocity")
    code, found, error = info(tmp_path / "run", capsys)
    assert code == 2
    assert len(found["topics"]) == 2
    assert "choose with --topic velocity=/left/velocity" in error


def test_an_unreadable_recording_is_one_line(tmp_path, capsys):
    (tmp_path / "run.mcap").write_bytes(b"\x89MCAP0\r\n")
    assert main(["info", str(tmp_path / "run.mcap")]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert len(printed.err.splitlines()) == 1


@pytest.mark.parametrize(
    ("name", "messages"), [("servo_ros2_sqlite3", 1294), ("rosbag2_split_sqlite3", 6074), ("rosbag2_split_mcap", 6074)]
)
def test_recordings_of_others_are_listed(shared_data, capsys, name, messages):
    code, found, _ = info(shared_data / "bags" / name, capsys)
    assert code == 1
    assert sum(topic["messages"] for topic in found["topics"]) == messages


def test_a_small_recording_is_told_of_without_what_takes_long_to_load(tmp_path):
    """scipy's parts, and what numba needs to compile, are two fifths of a start."""
    write_samples(tmp_path / "bag", drive(sine(2000)))
    script = (
        "import sys\nfrom friction_estimator.cli.main import main\n"
        f"main(['info', {str(tmp_path / 'bag')!r}])\n"
        "heavy = ('scipy.linalg', 'scipy.sparse', 'scipy.special', 'numba.np.npyimpl', 'pandas', 'matplotlib')\n"
        "print([name for name in heavy if name in sys.modules])"
    )
    for _ in range(2):  # the first may have to compile
        done = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_a_recording_is_opened_once(tmp_path, capsys, monkeypatch):
    """What is packed is unpacked once, however often it is read."""
    path, opened = tmp_path / "bag", []
    write_samples(path, drive(sine(2000)))
    prepared = source_module.prepared
    monkeypatch.setattr(source_module, "prepared", lambda path, stack: opened.append(path) or prepared(path, stack))
    code, found, _ = info(path, capsys)
    assert code == 0
    assert found["pairing"]["used"] == 2000
    assert opened == [path]
