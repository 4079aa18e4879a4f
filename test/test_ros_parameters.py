"""Every parameter: declared from its setting, checked, explained; the node outlives whatever it is given."""

import math
import os
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

import ros_graph
import yaml
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters, ListParameters, SetParameters
from rclpy.parameter import Parameter as RosParameter

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.settings.config import PARAMETERS
from friction_estimator.ros import parameter_file
from friction_estimator.ros.arguments import beside_its_file, repaired

pytestmark = pytest.mark.ros
NODE = "/friction_estimator"
CONFIG = ros_graph.ROOT / "config" / "estimator.yaml"


@pytest.fixture
def graph(tmp_path):
    with ros_graph.graph(tmp_path) as made:
        yield made


def setter(graph):
    """Return a function that sets one parameter by service and returns (successful, reason)."""

    def put(name, value, kind=None):
        given = RosParameter(name, kind, value) if kind else RosParameter(name, value=value)
        answer = graph.call(SetParameters, f"{NODE}/set_parameters", parameters=[given.to_parameter_msg()])
        return answer.results[0].successful, answer.results[0].reason

    return put


def out_of_range(item):
    return [value for bound, value in ((item.low, item.low - abs(item.low) - 1), (item.high, 2 * abs(item.high) + 1))
            if math.isfinite(bound)]  # fmt: skip


def test_every_parameter_through_the_services(graph):
    """In range, out of range, wrong type, integer for double, NaN, unknown name: the answer names the culprit."""
    process = graph.start_node()
    put = setter(graph)
    listed = set(graph.call(ListParameters, f"{NODE}/list_parameters").result.names)
    assert set(PARAMETERS) <= listed
    described = graph.call(DescribeParameters, f"{NODE}/describe_parameters", names=list(PARAMETERS)).descriptors
    for item, described_item in zip(PARAMETERS.values(), described, strict=True):
        assert described_item.description == item.description
        assert item.unit in described_item.additional_constraints
        if item.element in (int, float) and math.isfinite(item.low):
            assert described_item.floating_point_range or described_item.integer_range
        wanted = {float: "DOUBLE", int: "INTEGER", str: "STRING", bool: "BOOL"}[item.element]
        assert described_item.type == getattr(ParameterType, f"PARAMETER_{wanted}{'_ARRAY' * item.is_array}"), item.name

    for item in PARAMETERS.values():
        if item.learned:
            continue
        good = list(item.default) if item.is_array else item.default
        array = RosParameter.Type.STRING_ARRAY if item.element is str else RosParameter.Type.DOUBLE_ARRAY
        accepted, reason = put(item.name, good, array if item.is_array else None)
        assert accepted, f"{item.name}: {reason}"
        bad = [b"x", [b"x"], {"a": 1}] and [[True, False]] if item.element is not bool else ["yes", 1]
        if item.is_array:
            bad += [3, "word"]
            if item.element is float:
                bad += [[math.nan, 1.0], [math.inf, 1.0], ["a"]]
        elif item.element in (int, float):
            bad += ["word", True, [1.0, 2.0], *out_of_range(item)]
            bad += [math.nan, math.inf] if item.element is float else [1.5]
        elif item.element is str:
            bad += [1, 2.5, True] + (["nonsense"] if item.choices else [])
        for value in bad:
            accepted, reason = put(item.name, value)
            assert not accepted, f"{item.name} took {value!r}"
            assert item.name in reason, f"{item.name} = {value!r}: {reason}"
            assert len(reason) > len(item.name) + 8
        if item.element is float and not item.is_array:
            whole = next((v for v in (1, 0, 2, 100, 10**6) if item.low <= v <= item.high), None)
            if whole is not None:
                accepted, reason = put(item.name, whole)
                assert accepted, f"{item.name} = {whole} (an integer for a double): {reason}"
                assert type(graph.call_get(NODE, item.name)) is float
                assert put(item.name, item.default)[0]
        unset = ParameterMessage(name=item.name)
        answer = graph.call(SetParameters, f"{NODE}/set_parameters", parameters=[unset]).results[0]
        assert answer.successful == item.is_array, f"{item.name} without value: {answer.reason}"

    for unknown in ("rls.forgetting", "", "basis", "no.such.name"):
        accepted, reason = put(unknown, 1.0)
        assert not accepted
        assert unknown in reason
    accepted, reason = put("rls.forgetting", 1.0)
    assert "rls.forgetting_factor" in reason
    assert process.popen.poll() is None, process.output()
    assert process.stop() == 0


def test_what_acts_when(graph):
    graph.start_node()
    answer = graph.call_set(NODE, fir__order=4, lms__step_size=0.01)
    assert answer.successful
    assert "fir.order" in answer.reason
    assert "~/reset" in answer.reason
    assert "lms.step_size" not in answer.reason
    assert len(graph.call_get(NODE, "learned.fir_taps")) == 9
    from std_srvs.srv import Trigger

    assert graph.call(Trigger, f"{NODE}/reset").success
    assert len(graph.call_get(NODE, "learned.fir_taps")) == 5
    answer = graph.call_set(NODE, basis__finest_level=3, basis__coarsest_level=1)
    assert not answer.successful
    assert "basis.coarsest_level" in answer.reason
    # A set is taken as a whole or not at all.
    answer = graph.call_set(NODE, theory__kind="none", lms__step_size=2.0)
    assert not answer.successful
    assert graph.call_get(NODE, "theory.kind") == "seal"
    answer = graph.call_set(NODE, theory__kind="none", model__type="hammerstein")
    assert answer.successful, answer.reason


def test_learned_values_set_from_outside(graph):
    """Judged as a whole, without touching what runs when refused."""
    graph.start_node()
    weights = list(graph.call_get(NODE, "learned.wavelet_weights"))
    taps = list(graph.call_get(NODE, "learned.fir_taps"))
    for values, culprit in (
        ({"learned__wavelet_weights": weights[1:]}, "learned.wavelet_weights"),
        ({"learned__fir_taps": [*taps, 0.5]}, "learned.fir_taps"),
        ({"learned__fir_taps": [math.nan] * len(taps)}, "learned.fir_taps"),
        ({"learned__fir_taps": taps, "learned__wavelet_weights": [*weights, 1.0]}, "learned.wavelet_weights"),
        ({"learned__fir_taps": [1e9] * len(taps)}, "learned"),
    ):
        answer = graph.call_set(NODE, **values)
        assert not answer.successful
        assert culprit in answer.reason
    assert list(graph.call_get(NODE, "learned.wavelet_weights")) == weights
    new = [0.01 * k for k in range(len(weights))]
    answer = graph.call_set(NODE, learned__wavelet_weights=new, learned__fir_taps=taps)
    assert answer.successful, answer.reason
    assert list(graph.call_get(NODE, "learned.wavelet_weights")) == new


def test_start_up_values(graph):
    """What cannot be used is refused by name; everything else counts; the node lives."""
    process = graph.start_node(
        {
            "fir": {"order": 4},
            "rls": {"forgetting_factor": 1, "forgeting": 0.9},
            "lms": {"step_size": 7.0},
            "nlms": {"step_size": "fast"},
            "basis": {"velocity_range": [-1, 0.5], "velocity_unit": float("nan")},
            "theory": {"kind": "table"},
            "use_sim_time": 1,
            "learned": {"fir_taps": []},
        },
        arguments=("-p", "seal.density:=900", "-p", "seal.roughness:=3", "-p", "modle.type:=parallel"),
        units=False,
    )
    assert graph.call_get(NODE, "fir.order") == 4
    assert graph.call_get(NODE, "rls.forgetting_factor") == 1.0
    assert list(graph.call_get(NODE, "basis.velocity_range")) == [-1.0, 0.5]
    assert graph.call_get(NODE, "seal.density") == 900.0
    assert graph.call_get(NODE, "lms.step_size") == PARAMETERS["lms.step_size"].default
    output = process.output()
    for words in (
        "unknown parameter rls.forgeting; nearest: rls.forgetting_factor",
        "lms.step_size: 7.0 is out of range",
        "nlms.step_size: 'fast' is of type str, expected float",
        "basis.velocity_unit: nan is not a finite number",
        "seal.roughness: 3.0 is out of range",
        "unknown parameter modle.type; nearest: model.type",
        "theory.kind is table and theory.table is empty",
        "use_sim_time",
    ):
        assert words in output, f"{words!r} not in\n{output}"
    assert process.stop() == 0


def test_a_configuration_without_estimator_is_told_and_can_be_corrected(graph):
    from std_srvs.srv import Trigger
    from test_ros_node import diagnostics

    process = graph.start_node({"theory.kind": "table", "theory.table": "/no/such/curve.csv"})
    assert "/no/such/curve.csv" in process.output()
    feeder = ros_graph.Feeder(graph)
    feeder.matched()
    feeder.pair(10**18, 0.1, 2.0)
    values = diagnostics(graph, lambda v: v["estimator level"] == 2 and v["samples lost"] == "1")
    assert "/no/such/curve.csv" in values["estimator message"]
    for service in ("reset", "save", "load"):
        answer = graph.call(Trigger, f"{NODE}/{service}")
        assert not answer.success
        assert "/no/such/curve.csv" in answer.message
    assert not graph.call_set(NODE, learned__fir_taps=[1.0]).successful
    assert list(graph.call_get(NODE, "learned.fir_taps")) == []
    assert graph.call_set(NODE, theory__kind="seal").successful
    assert graph.call(Trigger, f"{NODE}/reset").success
    feeder.pair(10**18 + 10**6, 0.1, 2.0)
    diagnostics(graph, lambda v: v["predictions"] == "1" and v["estimator level"] == 0)
    assert process.stop() == 0


def test_learned_values_of_another_structure_start_cold(graph):
    process = graph.start_node({"fir.order": 3, "learned.fir_taps": [1.0, 0.5]})
    assert "starting cold" in process.output()
    assert "learned.fir_taps has 2 values" in process.output()
    assert len(graph.call_get(NODE, "learned.fir_taps")) == 4
    assert process.stop() == 0


def test_unusable_arguments_are_one_line(graph):
    file = graph.folder / "broken.yaml"
    file.write_text("/**:\n  ros__parameters: [1, 2\n")
    process = graph.start("-m", "friction_estimator.ros.node", "--ros-args", "--params-file", str(file))
    assert process.popen.wait(ros_graph.LIMIT_S) == 2
    assert "Traceback" not in process.output()
    assert "broken.yaml" in process.output()


@pytest.mark.parametrize("units", [True, False])
def test_a_dump_starts_the_next_node_warm(graph, units):
    """What `ros2 param dump` reads and writes, then the same predictions; range and units are part of it."""
    import numpy as np
    from geometry_msgs.msg import WrenchStamped
    from test_ros_node import feed

    stamps, velocity, friction = ros_graph.motion(900, 400.0)

    def predictions(stop, **parameters):
        process = graph.start_node(parameters, units=units)
        feeder = ros_graph.Feeder(graph)
        heard = graph.hear(WrenchStamped, f"{NODE}/friction_predicted", raw=True)
        feeder.matched()
        graph.reached_by()
        for _ in range(2 if stop else 1):
            before = len(heard)
            feed(feeder, stamps, velocity, friction)
            ros_graph.await_(lambda n=before: len(heard) == n + stamps.size, "predictions")
            if stop:
                assert graph.call_set(NODE, model__adapt=False).successful
        dumped = {}
        for name in sorted(graph.call(ListParameters, f"{NODE}/list_parameters").result.names):
            value = graph.call_get(NODE, name)
            dumped[name] = list(value) if hasattr(value, "__len__") and not isinstance(value, str) else value
        assert process.stop() == 0
        return [ros_graph.force(raw)[1] for raw in heard[-stamps.size :]], dumped

    first, dump = predictions(True)
    assert np.std(first) > 1.0
    text = yaml.dump(dump)  # as ros2 param dump does, empty arrays included
    assert "[]" in text
    assert bool(dump["learned.force_unit"]) is not units
    again, dump_again = predictions(False, **yaml.safe_load(text))
    assert again == first
    assert dump_again == dump


def test_relative_paths_belong_to_their_file(graph):
    folder = graph.folder / "rig"
    folder.mkdir()
    file = folder / "mine.yaml"
    file.write_text("/**:\n  ros__parameters:\n    state:\n      file: learned/state.json\n")
    assert beside_its_file("state.file", "learned/state.json", [file]) == str(folder / "learned/state.json")
    assert beside_its_file("state.file", "other.json", [file]) == "other.json"
    process = graph.start("-m", "friction_estimator.ros.node", "--ros-args", "--params-file", str(file))
    process.says("listening")
    assert graph.call_get(NODE, "state.file") == str(folder / "learned/state.json")
    assert process.stop() == 0


def test_mixed_arrays_are_made_doubles(tmp_path):
    file = tmp_path / "a.yaml"
    file.write_text("/**: {ros__parameters: {basis: {velocity_range: [0, 0.15]}}}")
    other = tmp_path / "b.yaml"
    other.write_text("/**: {ros__parameters: {fir: {order: 3}}}")
    given = ["node", "--ros-args", "--params-file", str(file), "--params-file", str(other), "-p", "x:=[1, 2.5]"]
    result = repaired(given, tmp_path)
    read = [yaml.safe_load(Path(result[index]).read_text())["/**"]["ros__parameters"] for index in (3, 5)]
    assert read == [{"basis": {"velocity_range": [0.0, 0.15]}}, {"fir": {"order": 3}}]
    assert [Path(result[index]).name for index in (3, 5)] == ["a.yaml", "b.yaml"]
    assert result[7] == "x:=[1.0, 2.5]"


@pytest.mark.parametrize(
    ("rule", "plain"),
    [("y", "'y'"), ("1e3", "1e3"), ("[1, 2]", "[1, 2]"), ("[y, 'a b']", "['y', 'a b']"), ("''", "''"), ("on", "on")],
)
def test_rules_mean_to_rcl_what_they_mean_here(tmp_path, rule, plain):
    assert repaired(["node", "-p", f"a.b:={rule}"], tmp_path)[2] == f"a.b:={plain}"


@pytest.mark.parametrize("rule", ["[1", "[[1]]", "{a: }", "&a [*a]", "9" * 400, r'"\ud800"', "!!timestamp x"])
def test_a_rule_that_is_none_is_refused_by_name(tmp_path, rule):
    with pytest.raises(ConfigError, match=r"^-p a\.b"):
        repaired(["node", "-p", f"a.b:={rule}"], tmp_path)


def test_hostile_parameter_files_end_the_node_in_one_line(graph):
    """Those that rcl's own parser would hang on, misread or quote; the others are `test_documents`'."""
    doubling = "".join(f"    a{n}: &a{n} [{f'*a{n - 1}, *a{n - 1}' if n else 'x'}]\n" for n in range(30))
    os.mkfifo(graph.folder / "pipe.yaml")
    for name, content, words in (
        ("laughs.yaml", "/**:\n  ros__parameters:\n" + doubling, "more than 50000 values"),
        ("empty.yaml", "", "is empty"),
        ("dict.yaml", "/**: {ros__parameters: {fir.order: {}}}", "fir.order is an empty section"),
        ("tag.yaml", '/**: {ros__parameters: {fir.order: !!int "x"}}', "line 1: x is no integer"),
        ("pipe.yaml", None, "a named pipe"),
        ("none.yaml", None, "No such file"),
    ):
        if content is not None:
            (graph.folder / name).write_text(content)
        arguments = ("--params-file", str(graph.folder / name))
        process = graph.start("-m", "friction_estimator.ros.node", "--ros-args", *arguments)
        assert process.popen.wait(ros_graph.LIMIT_S) == 2
        (line,) = process.output().splitlines()
        assert name in line
        assert words in line


def test_parameter_file_is_up_to_date():
    """config/estimator.yaml is what parameter_file writes, and holds the defaults."""
    assert CONFIG.read_text() == parameter_file.text()
    from friction_estimator.core.settings.config import Config
    from friction_estimator.documents.configuration import read_config

    assert read_config(CONFIG) == Config()


def test_the_papers_own_algorithm():
    """config/paper.yaml: no companding, the paper's law and theory, no guard; all else as by default."""
    from friction_estimator.core.settings.config import Config
    from friction_estimator.documents.configuration import read_config

    found = read_config(CONFIG.parent / "paper.yaml").to_mapping()
    changed = {name: value for name, value in found.items() if value != Config().to_mapping()[name]}
    assert changed == {"model.law": "lms", "basis.companding": 0.0, "theory.kind": "seal", "lms.guard": False}
