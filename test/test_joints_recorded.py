"""Recordings of several joints: which there are, what is wrong with each, and every verb over all of them."""

import json
import sqlite3

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from joint_bags import friction_of, joint_state, robot, write_joint_bag

from friction_estimator.bag.joint_reader import JointReader
from friction_estimator.bag.joint_survey import MOST_JOINTS, survey
from friction_estimator.bag.layout import LayoutError
from friction_estimator.bag.messages import EXTRACTORS, Decoder, NoValueError, Want
from friction_estimator.bag.read import read_recording
from friction_estimator.bag.samples import to_samples
from friction_estimator.bag.source import Source
from friction_estimator.bag.write import write_samples
from friction_estimator.cli.main import main
from friction_estimator.core.errors import ConfigError
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.groups import InputConfig
from friction_estimator.core.settings.joint_names import plain_name, plain_names
from friction_estimator.core.settings.joints import Settings
from friction_estimator.documents.configuration import read_config

pytestmark = pytest.mark.xdist_group("joints_recorded")

SOUND, STILL, BLIND = ("arm/elbow", "wrist ä"), ("stuck", "parked"), ("blind", "tool")


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """The recording of `joint_bags.robot`."""
    return write_joint_bag(tmp_path_factory.mktemp("robot") / "arm", {"/joint_states": robot(10.0)})


def run(verb, *words):
    try:
        return main([verb, *map(str, words)])
    except SystemExit as end:
        return end.code


def document(capsys, verb, *words):
    """Return exit code and JSON of a verb."""
    capsys.readouterr()
    code = run(verb, *words, "--json", "-")
    return code, json.loads(capsys.readouterr().out)


# Names


@pytest.mark.parametrize(
    ("joint", "name"),
    [("elbow", "elbow"), ("/left/elbow-1", "_left_elbow_1"), ("Schulter ä", "Schulter__"), ("6", "joint_6")],
)
def test_a_joints_name_becomes_one_that_ros_and_files_take(joint, name):
    assert plain_name(joint) == name


@given(st.lists(st.text(min_size=1), unique=True))
def test_names_are_told_apart_or_refused(joints):
    try:
        plain = plain_names(joints)
    except ConfigError:
        assert len({plain_name(joint) for joint in joints}) < len(joints)
    else:
        assert list(plain) == joints
        assert len(set(plain.values())) == len(joints)
        assert all(name.isascii() and name.replace("_", "a").isalnum() for name in plain.values())


@pytest.mark.parametrize(
    ("joints", "says"), [(["a b", "a/b"], "both become a_b"), (["a", ""], "has no name"), (["a", "a"], "twice")]
)
def test_names_that_cannot_be_told_apart_are_refused(joints, says):
    with pytest.raises(ConfigError, match=says):
        Config.from_mapping({"input.mode": "joint_state", "input.joints": joints})


def test_several_joints_need_the_mode_that_has_joints():
    with pytest.raises(ConfigError, match=r"set input\.mode to joint_state"):
        Config.from_mapping({"input.joints": ["a", "b"]})


SEVERAL = {"input.mode": "joint_state", "input.joints": ["a b", "model"], "fir.order": 8, "state.file": "/s.json"}


def test_the_settings_of_one_joint_win_over_those_of_all():
    settings = Settings().updated(SEVERAL | {"a_b.fir.order": 4, "model.learned.force_unit": 2.0})
    one, other = settings.of("a_b"), settings.of("model")
    assert (one.fir.order, one.learned.force_unit, one.input.joint, one.state.file) == (4, 0.0, "a b", "/s.json.a_b")
    assert (other.fir.order, other.learned.force_unit, other.input.joint) == (8, 2.0, "model")
    assert settings.of_joint("c").input.joint == "c"
    assert settings.of_joint("").input.joints == ("a b", "model")
    assert settings.of_joint("model") == other
    assert settings.without_learned().of("model").learned.force_unit == 0.0
    assert settings.without_learned().of("a_b") == one
    assert settings.concerning("a_b", ["fir.order", "rls.forgetting_factor", "model.learned.force_unit"]) == [
        "rls.forgetting_factor"
    ]
    assert settings.concerning("model", ["fir.order", "model.learned.force_unit"]) == [
        "fir.order", "learned.force_unit"
    ]  # fmt: skip
    names = settings.names()
    assert len(set(names)) == len(names)
    assert {"fir.order", "a_b.fir.order", "a_b.learned.fir_taps", "model.learned.fir_taps"} <= set(names)
    assert not {"learned.fir_taps", "model.fir.order"} & set(names)
    assert (settings.value("a_b.fir.order"), settings.value("fir.order")) == (4, 8)
    assert settings.declaration("model.learned.fir_taps").name == "model.learned.fir_taps"


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("learned.force_unit", 1.0, "name it JOINT.learned.force_unit"),
        ("c.fir.order", 4, "unknown parameter c.fir.order"),
        ("a_b.fir.oder", 4, "unknown parameter a_b.fir.oder"),
        ("a_b.fir.order", 400, "a_b.fir.order: 400 is out of range"),
        ("a_b.input.mode", "stamped", "all joints share input.mode"),
        ("model.basis.velocity_range", [1.0, -1.0], "model: .*lowest first"),
    ],
)
def test_what_no_joint_can_have_is_refused_by_its_name(name, value, says):
    with pytest.raises(ConfigError, match=says):
        Settings().updated(SEVERAL | {name: value})


# Several joints out of one message

values = st.lists(st.floats(), max_size=4)


@settings(deadline=None)
@given(st.lists(st.sampled_from(["a", "b", "ä", ""]), max_size=4), values, values, values, st.integers(0, 2**60))
def test_a_message_gives_each_joint_what_its_own_reading_gives(names, position, velocity, effort, stamp_ns):
    """One decode for all joints agrees with the extractor that replay uses, joint by joint, absences included."""
    raw = joint_state(stamp_ns, names, position, velocity, effort)
    joints = ("b", "a", "c", "")
    places = JointReader(joints).places(raw)
    assert sorted(row[0] for row in (*places.present, *places.absent)) == [0, 1, 2, 3]
    numbers = places.unpack(raw)
    assert numbers[0] * 10**9 + numbers[1] == stamp_ns
    for number, *indices in places.present:
        for at, quantity in zip(indices, ("position", "velocity", "friction"), strict=True):
            if not at:
                with pytest.raises(NoValueError):
                    Decoder(EXTRACTORS["sensor_msgs/msg/JointState"], Want("position", joint=joints[number])).one(raw)
                continue
            decoder = Decoder(EXTRACTORS["sensor_msgs/msg/JointState"], Want(quantity, joint=joints[number]))
            np.testing.assert_array_equal(numbers[at], decoder.one(raw)[1])
    for number, reason in places.absent:
        assert reason == why_not(raw, joints[number])


def why_not(raw, joint):
    """Return why replay reads no sample of a joint from a message."""
    for quantity in ("velocity", "friction"):
        try:
            Decoder(EXTRACTORS["sensor_msgs/msg/JointState"], Want(quantity, joint=joint)).one(raw)
        except NoValueError as error:
            return str(error)
    return "it does"


def test_a_machine_that_publishes_its_joints_in_parts_is_walked_once_a_part():
    reader = JointReader(("arm", "grip"))
    parts = [joint_state(k, [name], [], [0.1 * k], [k]) for k in range(3) for name in ("arm", "grip")]
    first, second = reader.places(parts[0]), reader.places(parts[1])
    assert [row[0] for row in first.present] == [0]
    assert [row[0] for row in second.present] == [1]
    assert all(reader.places(raw) is (first, second)[k % 2] for k, raw in enumerate(parts))


def test_what_is_no_joint_state_is_refused():
    with pytest.raises(LayoutError):
        JointReader(("a",)).places(b"\0\1\0\0nothing")


# What is in a recording


def test_every_topic_is_surveyed_joint_by_joint(tmp_path):
    nan, inf = float("nan"), float("inf")
    messages = [
        (["a", "b", "b"], [1.0, 2.0, 3.0], [0.5, -1.0, 9.0], [4.0, nan, 0.0]),
        (["a", "b", "b"], [1.5, 2.0, 3.0], [0.25, inf, 9.0], [5.0, 6.0]),
        (["a"], [], [2.0], []),
        ([], [1.0], [1.0], []),
    ]
    bag = write_joint_bag(tmp_path / "run", {"/joint_states": messages, "/grip": messages[:1]}, storage="sqlite3")
    with Source(bag) as source:
        grip, found = survey(source)
    assert (grip.topic.name, list(grip.joints)) == ("/grip", ["a", "b"])
    assert found.unnamed == {"1 of position, 1 of velocity, 0 of effort": 1}
    one, other = found.joints["a"], found.joints["b"]
    assert (one.messages, one.named_twice, other.messages, other.named_twice) == (3, 0, 2, 2)
    assert one.rate_hz == pytest.approx(100.0)
    assert (one.quantities["velocity"].lowest, one.quantities["velocity"].highest) == (0.25, 2.0)
    assert one.quantities["friction"].absent == {"effort is empty": 1}
    assert (other.quantities["friction"].nan, other.quantities["velocity"].infinite) == (1, 1)
    assert other.quantities["velocity"].highest == -1.0
    assert (one.problem, other.problem) == ("", "")


def test_bytes_that_are_no_joint_state_are_a_fault_of_their_topic_alone(tmp_path, capsys):
    """`info` still lists everything, and a drive that needs nothing of that topic is assessed."""
    stamps = np.arange(1, 1001, dtype=np.int64) * 10**7
    velocity = np.sin(np.arange(1000) / 40)
    write_samples(tmp_path / "run", Samples(stamps, velocity, friction_of(velocity), stamps == stamps[0]), "sqlite3")
    (file,) = (tmp_path / "run").glob("*.db3")
    with sqlite3.connect(file) as database:
        for number, (topic, raw) in enumerate(
            (("/cut", b"\0\1\0\0cut"), ("/sound", joint_state(1, ["a"], [], [1], [2])))
        ):
            database.execute(
                "insert into topics (id, name, type, serialization_format, offered_qos_profiles, type_description_hash)"
                " values (?, ?, 'sensor_msgs/msg/JointState', 'cdr', '', '')",
                (70 + number, topic),
            )
            database.execute("insert into messages (topic_id, timestamp, data) values (?, 5, ?)", (70 + number, raw))
    code, found = document(capsys, "info", file)
    assert (code, found["problem"]) == (0, None)
    cut, sound = found["joint_states"]
    assert cut["fault"]
    assert (sound["fault"], list(sound["joints"])) == (None, ["a"])
    assert run("replay", file, "--joint", "all", "--topic", "joint_states=/cut") == 2
    assert "a message on /cut is no sensor_msgs/JointState" in capsys.readouterr().err


def test_names_without_end_are_not_kept(tmp_path):
    messages = [([f"joint{k}", "a"], [], [1.0, 2.0], [1.0, 2.0]) for k in range(MOST_JOINTS + 50)]
    with Source(write_joint_bag(tmp_path / "run", {"/joint_states": messages})) as source:
        (found,) = survey(source)
    assert len(found.joints) == MOST_JOINTS
    assert found.unlisted == 51
    assert found.joints["a"].messages == len(messages)


def test_info_says_what_is_wrong_with_each_joint(arm, capsys):
    code, found = document(capsys, "info", arm)
    assert code == 0
    assert found["problem"] is None
    (topic,) = found["joint_states"]
    problems = {name: joint["problem"] for name, joint in topic["joints"].items()}
    assert problems == dict.fromkeys((*SOUND, *STILL)) | {
        "blind": "effort is NaN throughout",
        "tool": "velocity has 5 values for 6 joints",
    }
    assert topic["joints"]["wrist ä"]["velocity"]["highest"] == pytest.approx(3.0, rel=1e-3)
    assert run("info", arm, "--joint", "all") == 0
    text = capsys.readouterr().out
    assert "velocity -3 to 3 rad/s" in text
    assert "stands still: the velocity never changes" in text
    assert "velocity has 5 values for 6 joints" in text


def test_a_joint_that_is_not_there_is_asked_back_with_the_nearest(arm, capsys):
    assert run("replay", arm, "--joint", "arm_elbow") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.count("no joint 'arm_elbow' (did you mean arm/elbow?) among arm/elbow, stuck") == 1


def test_joint_states_is_taken_before_other_topics_of_its_type(tmp_path, capsys):
    moving = [(["a"], [], [v], [friction_of(v)]) for v in np.sin(np.arange(300) / 20)]
    bag = write_joint_bag(tmp_path / "run", {"/arm/joint_states": moving, "/joint_states": moving, "/ref": moving})
    assert read_recording(bag).streams["velocity"].topic == "/joint_states"
    other = write_joint_bag(tmp_path / "other", {"/left/joint_states": moving, "/right/joint_states": moving})
    assert run("replay", other, "--joint", "all") == 2
    assert "choose with --topic joint_states=/left/joint_states" in capsys.readouterr().err


def test_joint_states_without_efforts_gives_way_to_a_topic_with_them(tmp_path):
    without = [(["a", "b"], [], [v, v], []) for v in np.sin(np.arange(50) / 20)]
    sound = [(["a", "b"], [], [v, v], [v, v]) for v in np.sin(np.arange(50) / 20)]
    bag = write_joint_bag(tmp_path / "run", {"/joint_states": without, "/drive/state": sound})
    assert read_recording(bag, InputConfig(joint="b")).streams["velocity"].topic == "/drive/state"


# Every joint of a recording


@pytest.mark.usefixtures("blank_drawings")
def test_all_joints_are_a_row_a_folder_and_a_document_each(arm, tmp_path, capsys):
    out = tmp_path / "out"
    code, found = document(capsys, "replay", arm, "--joint", "all", "--freeze-after", 0.5, "--out", out)
    assert code == 0
    assert (found["schema"], list(found["joints"])) == ("friction_estimator/joints/1", [*SOUND[:1], "stuck", "wrist ä",
                                                                                         "parked", *BLIND])  # fmt: skip
    problems = {name: joint["problem"] for name, joint in found["joints"].items()}
    assert all(problems[name] is None for name in SOUND)
    assert problems["stuck"] == "stands still: the velocity never changes"
    assert "hardly moves" in problems["parked"]
    assert "1000 nan" in problems["blind"]
    assert "velocity has 5 values for 6 joints" in problems["tool"]
    assert sorted(path.name for path in out.iterdir()) == ["arm_elbow", "parked", "stuck", "summary.json", "wrist__"]
    assert json.loads((out / "summary.json").read_text()) == found
    for joint in SOUND:
        alone = document(capsys, "replay", arm, "--joint", joint, "--freeze-after", 0.5)[1]
        alone.pop("samples_per_second"), found["joints"][joint].pop("samples_per_second")
        assert {"problem": None, **alone} == found["joints"][joint]
    config = read_config(out / "wrist__" / "config.yaml")
    assert (config.input.mode, config.input.joint, config.input.joints) == ("joint_state", "wrist ä", ())
    # A file of the user's is kept; without one, one joint takes the place of all.
    (out / "arm_elbow" / "notes.txt").write_text("mine")
    assert run("replay", arm, "--joint", "all", "--out", out) == 2
    assert "notes.txt is not part of the results" in capsys.readouterr().err
    (out / "arm_elbow" / "notes.txt").unlink()
    assert run("replay", arm, "--joint", "stuck", "--out", out) == 0
    assert (out / "config.yaml").exists()
    assert not (out / "arm_elbow").exists()


def test_identify_has_a_row_for_each_joint_under_heads(arm, capsys):
    assert run("identify", arm, "--joint", "all", "--fit-only") == 0
    head, *rows = capsys.readouterr().out.splitlines()
    assert head.split() == ["joint", "samples", "rate", "(Hz)", "nrmse", "final", "frozen", "verdict"]
    assert [row.split()[-1] for row in rows if row.startswith(SOUND)] == ["estimated"] * 2
    assert [row[:9].rstrip() for row in rows] == ["arm/elbow", "stuck", "wrist ä", "parked", "blind", "tool"]


def test_diagnose_takes_every_joint(tmp_path, capsys):
    rng = np.random.default_rng(3)
    velocity = np.sin(np.arange(1500) / 40) * (1.0 + 0.5 * np.sin(np.arange(1500) / 333))
    effort = friction_of(velocity) + 0.02 * rng.standard_normal(1500)
    messages = [(["a", "b"], [], [v, 0.0], [f, f]) for v, f in zip(velocity.tolist(), effort.tolist(), strict=True)]
    bag = write_joint_bag(tmp_path / "run", {"/joint_states": messages})
    code, found = document(capsys, "diagnose", bag, "--joint", "all", "--out", tmp_path / "out")
    assert code == 0
    assert found["joints"]["a"]["schema"] == "friction_estimator/diagnosis/2"
    assert found["joints"]["a"]["problem"] is None
    assert found["joints"]["b"]["problem"]
    assert (tmp_path / "out" / "a" / "report.html").exists()


def test_where_no_joint_can_be_estimated_the_table_says_why_and_the_code_is_1(tmp_path, capsys):
    messages = [(["a", "b"], [], [0.1, np.nan], [1.0, 1.0])] * 50
    bag = write_joint_bag(tmp_path / "run", {"/joint_states": messages})
    code, found = document(capsys, "replay", bag, "--joint", "all")
    assert code == 1
    assert all(joint["problem"] for joint in found["joints"].values())


@pytest.mark.parametrize(
    ("messages", "words", "code", "says"),
    [
        ([([], [1.0], [1.0], [1.0])], [], 1, "names no joint"),
        ([(["a"], [1.0], [1.0], [1.0])] * 9, ["--topic", "velocity=/joint_states"], 2, "leave one of them out"),
        ([(["a"], [], [0.1 * k], [1.0 * k]) for k in range(99)], ["--freeze-after", "2"], 2, "0 to 1"),
        ([(["a b", "a/b"], [], [1.0, 1.0], [1.0, 1.0])] * 9, ["--out", "OUT"], 2, "both become a_b"),
    ],
)
def test_what_cannot_be_done_with_all_joints_is_one_line(tmp_path, capsys, messages, words, code, says):
    bag = write_joint_bag(tmp_path / "run", {"/joint_states": messages})
    words = [str(tmp_path / "out") if word == "OUT" else word for word in words]
    assert run("replay", bag, "--joint", "all", *words) == code
    (line,) = capsys.readouterr().err.splitlines()
    assert says in line
    assert not (tmp_path / "out").exists()


def test_all_joints_of_a_recording_without_joints_is_one_line(tmp_path, capsys):
    stamps = np.arange(1, 101, dtype=np.int64) * 10**7
    write_samples(tmp_path / "rig", Samples(stamps, np.ones(100), np.ones(100), stamps == stamps[0]))
    for verb in ("replay", "identify", "diagnose"):
        assert run(verb, tmp_path / "rig", "--joint", "all") == 1
        assert "no JointState topic for --joint all" in capsys.readouterr().err


@pytest.mark.usefixtures("blank_drawings")
def test_a_configuration_for_several_joints_serves_each_of_them(arm, tmp_path, capsys):
    """What a node of several joints dumps: shared settings once, learned values by joint."""
    out = tmp_path / "out"
    assert run("replay", arm, "--joint", "arm/elbow", "--out", out) == 0
    learned = {k: v for k, v in read_config(out / "config.yaml").to_mapping().items() if k.startswith("learned.")}
    several = tmp_path / "several.yaml"
    lines = {
        "input.mode": "joint_state",
        "input.joints": ["wrist ä", "arm/elbow"],
        **{f"arm_elbow.{name}": list(value) if isinstance(value, tuple) else value for name, value in learned.items()},
    }
    several.write_text("/**:\n  ros__parameters:\n" + "".join(f"    {k}: {json.dumps(v)}\n" for k, v in lines.items()))
    code, found = document(capsys, "replay", arm, "--joint", "all", "--config", several, "--freeze-after", 0)
    assert code == 0
    assert list(found["joints"]) == ["wrist ä", "arm/elbow"]
    one = document(capsys, "replay", arm, "--joint", "arm/elbow", "--config", out / "config.yaml", "--freeze-after", 0)[
        1
    ]
    assert found["joints"]["arm/elbow"]["nrmse_frozen"] == one["nrmse_frozen"] < 0.05
    assert found["joints"]["wrist ä"]["health"]["learned"] == 0
    other = found["joints"]["wrist ä"]["parameters"]["wavelet_weights"]
    assert other != found["joints"]["arm/elbow"]["parameters"]["wavelet_weights"]
    samples = to_samples(read_recording(arm, InputConfig(joint="wrist ä")), Config()).samples
    assert found["joints"]["wrist ä"]["samples"]["used"] == len(samples)
