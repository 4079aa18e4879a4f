"""The layouts for PlotJuggler and Foxglove name topics and fields that a running node publishes, and nothing else."""

import json
import re
from importlib import import_module
from xml.etree import ElementTree

import pytest

pytest.importorskip("rclpy")

import ros_graph
from ros_graph import ROOT, Feeder, await_, motion

pytestmark = pytest.mark.ros
NAMED = "/friction_estimator/parameters/named"


def plotjuggler():
    """Return the curves of the layout, and the topics that it subscribes to."""
    root = ElementTree.parse(ROOT / "config" / "plotjuggler.xml").getroot()
    curves = [curve.get("name") for curve in root.iter("curve")]
    return curves, [topic.get("name") for topic in root.iter("topic")]


def foxglove():
    """Return the message paths of the layout's plots, their labels, and its diagnostics."""
    layout = json.loads((ROOT / "config" / "foxglove.json").read_text())
    panels = layout["configById"]
    shown = re.findall(r"\w+!\w+", json.dumps(layout["layout"]))
    assert sorted(shown) == sorted(panels)
    paths = [(path["value"], path["label"]) for panel in panels.values() for path in panel.get("paths", [])]
    return paths, panels["DiagnosticStatusPanel!node"]


def field_of(kind, parts):
    """Walk fields by name; fails where one is not there."""
    message = kind()
    for part in parts:
        assert hasattr(message, part), f"{kind.__name__} has no field {'/'.join(parts)}"
        message = getattr(message, part)
    assert isinstance(message, float)


@pytest.fixture
def graph(tmp_path):
    with ros_graph.graph(tmp_path) as made:
        yield made


def test_every_topic_and_field_exists_on_a_running_node(graph):
    from diagnostic_msgs.msg import DiagnosticArray
    from sensor_msgs.msg import JointState

    graph.start_node()
    named, diagnostics = graph.hear(JointState, NAMED), graph.hear(DiagnosticArray, "/diagnostics")
    feeder = Feeder(graph)
    feeder.matched()
    graph.heard_by(NAMED)
    stamps, velocity, friction = motion(400, 500.0)
    samples = iter(zip(stamps.tolist(), velocity.tolist(), friction.tolist(), strict=True))

    def fed():
        feeder.pair(*next(samples))
        return named and diagnostics

    await_(fed, "named parameters and diagnostics")
    values = dict(zip(named[-1].name, named[-1].position, strict=True))
    assert named[-1].header.stamp.sec == 1_700_000_000
    types = dict(graph.probe.get_topic_names_and_types())

    def kind_of(topic):
        assert topic in types, f"{topic} is not there: {sorted(types)}"
        package, _, name = types[topic][0].partition("/msg/")
        return getattr(import_module(f"{package}.msg"), name)

    curves, topics = plotjuggler()
    assert curves
    used = set()
    for curve in curves:
        topic = max((topic for topic in topics if curve.startswith(f"{topic}/")), key=len, default=None)
        assert topic is not None, f"{curve}: no subscribed topic"
        used.add(topic)
        parts = curve.removeprefix(f"{topic}/").split("/")
        if topic == NAMED:
            assert parts[0] in values, curve
            assert parts[1:] == ["position"]
        else:
            field_of(kind_of(topic), parts)
    assert used == set(topics)
    for topic in topics:
        kind_of(topic)

    paths, panel = foxglove()
    assert paths
    for path, label in paths:
        topic, *parts = path.split(".")
        if topic == NAMED:
            index = int(re.fullmatch(r"position\[(\d+)\]", parts[0])[1])
            assert named[-1].name[index] == label
        else:
            field_of(kind_of(topic), parts)
    kind_of(panel["topicToRender"])
    statuses = {(status.hardware_id, status.name) for status in diagnostics[-1].status}
    assert (panel["selectedHardwareId"], panel["selectedName"]) in statuses
