"""A rotary drive from the recording to the page: nothing that a person reads speaks of metres, newtons or a seal."""

import contextlib
import io
import json
import re
import struct
from pathlib import Path

import numpy as np
import pages
import pytest
from rosbags.rosbag2 import Writer
from synthetic import noisy, samples_of, stribeck

from friction_estimator.bag.motion import Look, described_motion
from friction_estimator.bag.read import read_recording
from friction_estimator.bag.serialise import typestore
from friction_estimator.bag.source import Source
from friction_estimator.bag.write import write_samples, writing
from friction_estimator.cli.main import main
from friction_estimator.core.quantities import LINEAR, ROTARY, VELOCITY, Quantities
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.groups import InputConfig
from friction_estimator.documents.configuration import config_of, read_parameters
from friction_estimator.effects import list_effects
from friction_estimator.report.diagnosis_figures import Axis

pytestmark = pytest.mark.xdist_group("rotary")

RATE = 60.0
TURNING = ("gravity", "load_dependence")
"""Effects of rotary drives alone, which speak of torques and angles."""

LINEAR_WORDS = re.compile(
    r"\bmm?/s\b|\bN s/m|\bkg\b(?! m2)|\b[Ss]eal\b|\d N\b(?! m)|\(N\)|in N\b(?! m)|\d m\b|load cell|\bforces?\b"
)
ROTARY_WORDS = re.compile(r"\brad\b|\bN m\b|\btorque|moment of inertia|turns")


def turning(scale: float = 1.0, force: float = 1.0) -> Samples:
    """Two periods of a drive with a biased sensor; `scale` and `force` make it faster and stronger."""
    t = np.arange(int(36 * RATE)) / RATE
    rate = np.where(t < 18.0, 2 * np.pi / 3.0, 2 * np.pi / 1.5)
    velocity = 0.1 * np.cos(rate * (t - 18.0))
    friction = noisy(stribeck(velocity) + 0.6, 0.005)
    stroke = 0.1 * np.sin(rate * (t - 18.0)) / rate
    samples = samples_of(scale * velocity, force * friction, RATE)
    return Samples(
        samples.stamp_ns, samples.velocity_m_s, samples.friction_N, samples.restart, position_m=scale * stroke
    )


@pytest.fixture(scope="module", params=[ROTARY, LINEAR])
def told(request, tmp_path_factory) -> tuple[str, str, Path]:
    """The motion, and all that the verbs write and say of a recording of it."""
    folder = tmp_path_factory.mktemp(request.param)
    rotary = request.param == ROTARY
    write_samples(folder / "run", turning(400.0, 0.02) if rotary else turning(), motion=request.param)
    return request.param, *_said(folder)


def _said(folder: Path) -> tuple[str, Path]:
    words = io.StringIO()
    run, out = str(folder / "run"), str(folder / "out")
    commands = [
        ["info", run, "--json", str(folder / "info.json")],
        ["replay", run, "--model", "hammerstein", "--freeze-after", "0.5", "--out", out],
        ["identify", run, "--model", "hammerstein", "--fit-only"],
        ["diagnose", run, "--out", str(folder / "diagnosis")],
        *(["export", out, "--format", name, "--out", str(folder / f"model.{name}")] for name in _FORMATS),
    ]
    with contextlib.redirect_stdout(words), contextlib.redirect_stderr(words):
        assert [main(command) for command in commands] == [0] * len(commands)
    return words.getvalue(), folder


_FORMATS = ("csv", "json", "c", "urdf", "mjcf")


def test_what_is_said_has_the_units_of_the_drive(told):
    motion, words, folder = told
    written = [(folder / name / "report.html").read_text() for name in ("out", "diagnosis")]
    plain = [
        re.sub(r'src="data:[^"]*"|"data":"[^"]*"|<style>.*?</style>', "", pages.own(page), flags=re.S)
        for page in written
    ]
    files = [(folder / f"model.{name}").read_text() for name in _FORMATS]
    strange = LINEAR_WORDS if motion == ROTARY else ROTARY_WORDS
    for text in (words, *plain, *files):
        found = strange.search(text.replace(str(folder), ""))
        assert found is None, text[max(0, found.start() - 80) : found.end() + 40]
    own = "N m" if motion == ROTARY else "N"
    assert all(own in text for text in (words, *plain, *files))


def test_the_json_has_true_units_in_si(told):
    motion, _, folder = told
    expected = Quantities(motion).names
    info = json.loads((folder / "info.json").read_text())
    summary, diagnosis = (json.loads((folder / name / "summary.json").read_text()) for name in ("out", "diagnosis"))
    assert info["units"] == summary["units"] == diagnosis["units"] == expected
    assert json.loads((folder / "model.json").read_text())["units"] == expected
    assert info["motion"] == motion
    assert info["inputs"]["position"]["unit"] == ("rad" if motion == ROTARY else "m")
    (bias,) = (found["parameters"]["bias"] for found in diagnosis["effects"] if found["name"] == "sensor_bias")
    assert bias["unit"] == expected["friction"]
    assert bias["value"] == pytest.approx(0.6 * (0.02 if motion == ROTARY else 1.0), rel=0.1)


def test_the_results_go_on_as_the_same_drive(told):
    motion, _, folder = told
    assert read_recording(folder / "out" / "bag").motion == motion
    residual = read_recording(folder / "out" / "bag", topics={"friction": "/friction_estimator/residual"})
    assert np.any(residual.streams["friction"].value)
    again = ["simulate", "--config", str(folder / "out/config.yaml"), "--seconds", "2", "--rate", "50"]
    assert main([*again, "--out", str(folder / "again")]) == 0
    assert read_recording(folder / "again").motion == motion
    for name in ("out/config.yaml", "diagnosis/extended.yaml"):
        assert config_of(read_parameters(folder / name), name).input.motion == motion


def test_the_reader_chooses_units(tmp_path, capsys):
    write_samples(tmp_path / "run", turning(400.0, 0.02), motion=ROTARY)
    plain, chosen = tmp_path / "plain.json", tmp_path / "chosen.json"
    assert main(["info", str(tmp_path / "run"), "--json", str(plain)]) == 0
    capsys.readouterr()
    assert main(["info", str(tmp_path / "run"), "--units", "rpm,mNm,deg", "--json", str(chosen)]) == 0
    words = capsys.readouterr().out
    assert "from -382 to 382 rpm" in words
    assert re.search(r"from -\d+\.?\d* to \d+\.?\d* mN m", words)
    assert re.search(r"stroke \d+\.?\d* deg", words)
    assert plain.read_text() == chosen.read_text()
    assert main(["info", str(tmp_path / "run"), "--units", "mm/s"]) == 2
    assert "--units mm/s: mm/s is a unit of linear motion; this drive is rotary" in capsys.readouterr().err
    with pytest.raises(SystemExit, match="2"):
        main(["info", str(tmp_path / "run"), "--units", "parsec"])
    assert "'parsec' is no unit" in capsys.readouterr().err


def test_drives_of_two_kinds_are_not_learned_together(tmp_path, capsys):
    write_samples(tmp_path / "a", turning(), motion=LINEAR)
    write_samples(tmp_path / "b", turning(400.0), motion=ROTARY)
    assert main(["replay", str(tmp_path / "a"), str(tmp_path / "b")]) == 2
    assert "a is linear and" in capsys.readouterr().err


def test_an_axis_is_in_the_unit_that_fits_or_that_was_chosen():
    small, large = np.array([1e-5, np.nan]), np.array([2.0])
    cases = [
        (Quantities(LINEAR), small, "v (µm/s)", 1e6),
        (Quantities(LINEAR), large, "v (m/s)", 1.0),
        (Quantities(ROTARY), small, "v (µrad/s)", 1e6),
        (Quantities(ROTARY).in_units(["rpm"]), small, "v (rpm)", 60.0 / (2.0 * np.pi)),
    ]
    for quantities, values, label, factor in cases:
        axis = Axis(quantities, "v", VELOCITY, 1.0, values)
        assert (axis.label, axis.factor) == (label, pytest.approx(factor))


def test_the_catalogue_is_in_the_units_of_the_drive():
    for motion, strange in ((ROTARY, LINEAR_WORDS), (LINEAR, ROTARY_WORDS)):
        rows = [row for row in list_effects(Quantities(motion)) if row["name"] not in TURNING]
        text = json.dumps(rows).replace('"unit": "rad"', "")  # the phase of a ripple is an angle whatever moves
        assert strange.search(text) is None, strange.search(text)
        units = {f"{row['name']}.{key['name']}": key["unit"] for row in rows for key in row["keys"]}
        assert units["inertia.mass"] == ("kg m2" if motion == ROTARY else "kg")
        assert units["position_dependence.wavelength"] == ("rad" if motion == ROTARY else "m")


# Which way a drive moves


def twist(linear: float, angular: float) -> bytes:
    """A serialised Twist or Wrench, along and about x."""
    return b"\0\1\0\0" + struct.pack("<6d", linear, 0, 0, angular, 0, 0)


@pytest.mark.parametrize(
    ("quantity", "linear", "angular", "told"),
    [
        ("velocity", 0.1, 0.0, LINEAR),
        ("velocity", 0.0, 0.1, ROTARY),
        ("velocity", float("nan"), 0.1, ROTARY),
        ("velocity", 0.1, 0.1, LINEAR),  # a vehicle: what it is along x is said by the first
        ("velocity", 0.0, 0.0, ""),
        ("friction", 5.0, 0.0, LINEAR),
        ("friction", 0.0, 0.2, ROTARY),
        ("friction", 5.0, 0.2, ""),  # a sensor of six axes
        ("friction", 0.0, float("inf"), ""),
    ],
)
def test_a_message_tells_what_moves(quantity: str, linear: float, angular: float, told: str):
    kind = {"velocity": "geometry_msgs/msg/Twist", "friction": "geometry_msgs/msg/Wrench"}[quantity]
    assert Look(quantity, kind, "x").told(twist(linear, angular)) == told
    assert Look(quantity, kind, "y").told(twist(linear, angular)) == ""
    assert Look(quantity, kind, "x").told(b"\0\1\0\0") == ""


def test_a_recording_is_read_as_what_moves_first(tmp_path):
    """Both at rest, then an angular velocity beside a sensor of six axes; a value that is given wins."""
    times = 10**9 * np.arange(1, 31)
    turns = np.where(times > 5e9, np.sin(times / 1e9), 0.0)
    with writing(tmp_path / "run") as writer:
        for name, kind in (
            ("velocity", "geometry_msgs/msg/TwistStamped"),
            ("friction", "geometry_msgs/msg/WrenchStamped"),
        ):
            writer.add_stream(f"/{name}", kind, times, turns, quantity=name, motion=ROTARY)
    recording = read_recording(tmp_path / "run")
    assert recording.motion == ROTARY
    np.testing.assert_array_equal(recording.streams["friction"].value, turns)
    assert any("the drive is rotary" in note for note in recording.notes)
    given = read_recording(tmp_path / "run", InputConfig(motion=LINEAR))
    assert given.motion == LINEAR
    assert not np.any(given.streams["velocity"].value)


@pytest.mark.parametrize(
    ("description", "motion"),
    [
        (None, ROTARY),
        ('<robot><joint name="lift" type="prismatic"/></robot>', LINEAR),
        ('<robot><joint name="lift" type="continuous"/></robot>', ROTARY),
        (
            '<robot><transmission><joint name="lift"/></transmission><joint name="lift" type="prismatic"/></robot>',
            LINEAR,
        ),
        ("<robot><joint", ROTARY),
        ('<!DOCTYPE a [<!ENTITY b "c">]><robot><joint name="lift" type="prismatic"/></robot>', ROTARY),
    ],
)
def test_a_joint_is_rotary_unless_a_robot_description_has_it_as_prismatic(tmp_path, description, motion):
    times = 10**9 * np.arange(1, 9)
    values = {name: np.arange(8.0) for name in ("position", "velocity", "friction")}
    with writing(tmp_path / "run") as writer:
        writer.add_stream("/joint_states", "sensor_msgs/msg/JointState", times, values, joint="lift")
    with Writer(tmp_path / "with", version=8) as writer:
        if description is not None:
            kind = "std_msgs/msg/String"
            connection = writer.add_connection("/robot_description", kind, typestore=typestore())
            text = typestore().serialize_cdr(typestore().types[kind](description), kind)
            writer.write(connection, 1, text)
        with Source(tmp_path / "run") as source:
            connection = writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=typestore())
            for _, time, raw in source.messages(["/joint_states"]):
                writer.write(connection, time, raw)
    assert read_recording(tmp_path / "with").motion == motion
    assert read_recording(tmp_path / "with", InputConfig(motion=LINEAR)).motion == LINEAR


def test_a_robot_description_without_end_is_passed_over():
    assert described_motion("<robot>" + "<link/>" * 3_000_000, "lift") == ""
