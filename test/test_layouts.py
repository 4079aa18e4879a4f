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

NAMESPACE = (r'"/(velocity|friction)', r'"/left/\1')
ROTARY = [(r"linear([./])x", r"angular\1x"), (r"force([./])x", r"torque\1x")]
"""What docs/node.md replaces with sed."""


def layout(name, replaced):
    """Return the text of a layout with these patterns replaced."""
    text = (ROOT / "config" / name).read_text()
    for pattern, by in replaced:
        text = re.sub(pattern, by, text)
    return text


def plotjuggler(replaced):
    """Return the curves of the layout, and the topics that it subscribes to."""
    root = ElementTree.fromstring(layout("plotjuggler.xml", replaced))
    curves = [curve.get("name") for curve in root.iter("curve")]
    return curves, [topic.get("name") for topic in root.iter("topic")]


def foxglove(replaced):
    """Return the message paths of the layout's plots, their labels, and its diagnostics."""
    read = json.loads(layout("foxglove.json", replaced))
    panels = read["configById"]
    shown = re.findall(r"\w+!\w+", json.dumps(read["layout"]))
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


@pytest.mark.parametrize(
    ("namespace", "rotary", "settings"),
    [
        ("", False, {}),
        ("/left", True, {"theory.kind": "stribeck", "load.terms": ["inertia", "load_dependence"], "model.law": "nlms"}),
    ],
    ids=["as started", "other names, theory, loads"],
)
def test_every_topic_and_field_exists_on_a_running_node(graph, namespace, rotary, settings):
    from diagnostic_msgs.msg import DiagnosticArray
    from sensor_msgs.msg import JointState

    replaced = [NAMESPACE] * bool(namespace) + ROTARY * rotary
    graph.start_node(settings, namespace=namespace)
    topic_named = f"{namespace}/friction_estimator/parameters/named"
    named, diagnostics = graph.hear(JointState, topic_named), graph.hear(DiagnosticArray, "/diagnostics")
    feeder = Feeder(graph, namespace, rotary=rotary)
    feeder.matched()
    graph.heard_by(topic_named)
    stamps, velocity, friction = motion(20_000, 500.0)
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

    curves, topics = plotjuggler(replaced)
    assert curves
    used = set()
    for curve in curves:
        topic = max((topic for topic in topics if curve.startswith(f"{topic}/")), key=len, default=None)
        assert topic is not None, f"{curve}: no subscribed topic"
        used.add(topic)
        parts = curve.removeprefix(f"{topic}/").split("/")
        if topic == topic_named:
            assert parts[0] in values, curve
            assert parts[1:] == ["position"]
        else:
            field_of(kind_of(topic), parts)
    assert used == set(topics)
    for topic in topics:
        kind_of(topic)

    paths, panel = foxglove(replaced)
    assert paths
    for path, label in paths:
        topic, *parts = path.split(".")
        if topic == topic_named:
            index = int(re.fullmatch(r"position\[(\d+)\]", parts[0])[1])
            assert named[-1].name[index] == label
        else:
            field_of(kind_of(topic), parts)
    kind_of(panel["topicToRender"])
    statuses = {(status.hardware_id, status.name) for status in diagnostics[-1].status}
    assert (panel["selectedHardwareId"], panel["selectedName"]) in statuses
