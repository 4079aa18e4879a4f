"""The node without any configuration: the first contact, what ends it, and what is known after it."""

import numpy as np
import pytest

pytest.importorskip("rclpy")

import ros_graph
from geometry_msgs.msg import WrenchStamped
from ros_graph import Feeder, await_, force, motion
from sensor_msgs.msg import FluidPressure
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger
from test_ros_node import diagnostics, feed

from friction_estimator.core.intake.admission import Intake
from friction_estimator.core.intake.pairing import FRICTION, VELOCITY
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.online.first_contact import meet
from friction_estimator.core.settings.config import Config
from friction_estimator.ros.state import dumps, read_state

pytestmark = pytest.mark.ros
NODE = "/friction_estimator"


@pytest.fixture
def graph(tmp_path):
    with ros_graph.graph(tmp_path) as made:
        yield made


def replayed(stamps, velocity, friction, **values):
    """Return (predicted, deviation, estimator) as replay makes them, N."""
    config = Config.from_mapping(values)
    events = np.stack([velocity, friction], 1).ravel()
    samples = Intake(config).push(np.tile([VELOCITY, FRICTION], stamps.size), np.repeat(stamps, 2), events)
    estimator = Estimator(meet(config, samples).config)
    deviation = np.empty(len(samples))
    return estimator.run(samples, True, deviation), deviation, estimator


class Listening:
    """A feeder, and what the node publishes for it."""

    def __init__(self, graph):
        self.feeder = Feeder(graph)
        self.deviation = graph.hear(WrenchStamped, f"{NODE}/friction_stddev", raw=True)
        self.predicted = graph.hear(WrenchStamped, f"{NODE}/friction_predicted", raw=True)
        self.feeder.matched()
        graph.reached_by()

    def feed(self, stamps, velocity, friction):
        """Publish pairs, no faster than they are taken."""
        feed(self.feeder, stamps, np.asarray(velocity), np.asarray(friction), 1500.0)

    def heard(self, count):
        """Wait for so many predictions; return those since the last call as (stamps, predicted, deviation)."""
        await_(lambda: len(self.predicted) >= count and len(self.deviation) >= count, f"{count} predictions")
        found = [force(raw) for raw in self.predicted]
        spread = [force(raw) for raw in self.deviation]
        assert [stamp for stamp, _ in spread] == [stamp for stamp, _ in found]
        self.predicted.clear()
        self.deviation.clear()
        return [stamp for stamp, _ in found], [value for _, value in found], [value for _, value in spread]


def standstill_first(still, moving, rate_hz=400.0):
    """Return stamps, velocity and friction of a noisy standstill before a motion."""
    stamps, velocity, friction = motion(still + moving, rate_hz)
    rng = np.random.default_rng(1)
    velocity = np.concatenate([np.zeros(still), velocity[:moving]]) + 1e-4 * rng.standard_normal(stamps.size)
    friction = np.concatenate([0.02 * rng.standard_normal(still), friction[:moving]])
    return stamps, velocity, friction


def test_without_configuration_all_samples_come_in_order_as_in_replay(graph):
    """Three seconds of standstill and a motion that grows; a queue of 60 s would only take longer."""
    process = graph.start_node(units=False)
    listening = Listening(graph)
    stamps, velocity, friction = standstill_first(1200, 3000)
    velocity[3000:] *= 2.0  # the range grows
    listening.feed(stamps[:1200], velocity[:1200], friction[:1200])
    values = diagnostics(graph, lambda v: v["samples waiting"] == "1200")
    assert values["estimator level"] == 1
    assert values["estimator message"] == (
        "first contact: 1200 samples wait, still needed: 2 reversals or 10 s of motion"
    )
    assert listening.predicted == []
    assert graph.call_get(NODE, "learned.velocity_scale") == 0.0
    assert list(graph.call_get(NODE, "learned.velocity_range")) == []

    listening.feed(stamps[1200:], velocity[1200:], friction[1200:])
    expected, deviation, estimator = replayed(stamps, velocity, friction)
    found = listening.heard(stamps.size)
    assert found[0] == stamps.tolist()
    np.testing.assert_array_equal(found[1], expected)
    np.testing.assert_array_equal(found[2], deviation)
    assert estimator.health.grown > 0
    values = diagnostics(graph, lambda v: v["samples waiting"] == "0" and v["predictions"] == str(stamps.size))
    assert values["samples lost"] == values["samples dropped while waiting"] == "0"
    assert values["velocity range grown (times)"] == str(estimator.health.grown)
    assert values["velocity range (m/s)"] == str([float(f"{v:.6g}") for v in estimator.model.basis.reach])
    assert values["learned part of the velocity range"].endswith("%")
    assert process.output().count("first contact ended") == 1
    for name in ("learned.velocity_scale", "learned.force_unit"):
        leaf = name.partition(".")[2]
        assert graph.call_get(NODE, name) == getattr(estimator.config.learned, leaf)
    assert tuple(graph.call_get(NODE, "learned.velocity_range")) == estimator.config.learned.velocity_range
    assert process.stop() == 0


def test_reset_forgets_the_choices_and_saving_has_to_wait(graph):
    state = graph.folder / "state.json"
    graph.start_node({"state.file": str(state), "state.period": 0.0}, units=False)
    listening = Listening(graph)
    stamps, velocity, friction = motion(1500, 400.0)
    answer = graph.call(Trigger, f"{NODE}/save")
    assert not answer.success
    assert "first contact" in answer.message
    assert not state.exists()
    listening.feed(stamps, velocity, friction)
    _, first, _ = listening.heard(stamps.size)
    assert graph.call(Trigger, f"{NODE}/save").success

    answer = graph.call(Trigger, f"{NODE}/reset")
    assert answer.success
    assert "first contact" in answer.message
    assert graph.call_get(NODE, "learned.force_unit") == 0.0
    listening.feed(stamps, 0.5 * velocity, 3.0 * friction)
    _, second, _ = listening.heard(stamps.size)
    expected, *_ = replayed(stamps, 0.5 * velocity, 3.0 * friction)
    np.testing.assert_array_equal(second, expected)
    assert second != first

    # A state ends the wait at once: what waited is predicted by it.
    assert graph.call(Trigger, f"{NODE}/reset").success
    listening.feed(stamps[:5], velocity[:5], friction[:5])
    diagnostics(graph, lambda v: v["samples waiting"] == "5")
    assert listening.predicted == []
    assert graph.call(Trigger, f"{NODE}/load").success
    assert listening.heard(5)[0] == stamps[:5].tolist()
    assert graph.call_get(NODE, "learned.velocity_scale") == pytest.approx(0.105, rel=0.05)

    # Samples that still wait at a reset are let go, and counted.
    assert graph.call(Trigger, f"{NODE}/reset").success
    listening.feed(stamps[:7], velocity[:7], friction[:7])
    diagnostics(graph, lambda v: v["samples waiting"] == "7")
    assert graph.call(Trigger, f"{NODE}/reset").success
    diagnostics(graph, lambda v: v["samples dropped while waiting"] == "7" and v["samples waiting"] == "0")


def test_without_pressure_a_curve_is_found_and_said_and_reset_decides_anew(graph):
    """A shaft ten times as fast: bit for bit as in replay; pressure that comes later is a warning until the reset."""
    process = graph.start_node(units=False)
    listening = Listening(graph)
    pressure = graph.publisher(FluidPressure, "pressure")
    graph.matched("pressure")
    stamps, velocity, friction = motion(1500, 400.0)
    listening.feed(stamps, 10.0 * velocity, friction)
    expected, deviation, estimator = replayed(stamps, 10.0 * velocity, friction)
    found = listening.heard(stamps.size)
    np.testing.assert_array_equal(found[1], expected)
    np.testing.assert_array_equal(found[2], deviation)
    assert graph.call_get(NODE, "learned.theory") == "stribeck"
    assert tuple(graph.call_get(NODE, "learned.stribeck")) == estimator.config.learned.stribeck
    values = diagnostics(graph, lambda v: v.get("theory", "").startswith("stribeck: no pressure is recorded"))
    assert "theoretical curve stribeck: no pressure is recorded" in process.output()

    sample = FluidPressure(fluid_pressure=4.5e5)
    sample.header.stamp.sec = int(stamps[0] // 10**9)
    pressure.publish(sample)
    values = diagnostics(graph, lambda v: "~/reset" in v["estimator message"])
    assert values["estimator level"] == 1
    assert graph.call_get(NODE, "learned.theory") == "stribeck"
    assert "first contact" in graph.call(Trigger, f"{NODE}/reset").message
    listening.feed(stamps, 10.0 * velocity, friction)
    listening.heard(stamps.size)
    assert graph.call_get(NODE, "learned.theory") == "seal"
    assert list(graph.call_get(NODE, "learned.stribeck")) == []
    assert process.stop() == 0


def test_a_state_of_a_former_version_is_refused_and_kept_aside(graph):
    state = graph.folder / "state.json"
    process = graph.start_node({"state.file": str(state)}, units=False)
    listening = Listening(graph)
    stamps, velocity, friction = motion(900, 400.0)
    listening.feed(stamps, velocity, friction)
    listening.heard(stamps.size)
    assert process.stop() == 0

    process = graph.start_node({"state.file": str(state)}, units=False)
    listening = Listening(graph)
    listening.feed(stamps[:3] + 10**12, velocity[:3], friction[:3])
    assert listening.heard(3)[0] == (stamps[:3] + 10**12).tolist()
    assert "no first contact needed" in process.output()
    assert process.stop() == 0

    content = read_state(state)
    content["version"] = 2
    former = dumps(content)
    state.write_bytes(former)
    process = graph.start_node({"state.file": str(state)}, units=False)
    assert "starting cold" in process.output()
    assert "version 2" in process.output()
    assert (graph.folder / "state.json.refused").read_bytes() == former
    assert "first contact: basis.velocity_range, force_unit, theory.kind come" in process.output()
    assert process.stop() == 0


def test_the_curve_and_its_band(graph):
    process = graph.start_node(units=False)
    listening = Listening(graph)
    curves = graph.hear(Float64MultiArray, f"{NODE}/friction_curve")
    graph.heard_by(f"{NODE}/friction_curve")
    stamps, velocity, friction = motion(3000, 400.0)
    listening.feed(stamps, velocity, friction)
    listening.heard(stamps.size)
    *_, estimator = replayed(stamps, velocity, friction)
    expected = estimator.curve()
    wanted = np.stack([expected.velocity_m_s, expected.friction_N, expected.low_N, expected.high_N], 1)
    await_(lambda: curves and np.allclose(np.reshape(curves[-1].data, (-1, 4)), wanted, 1e-9), "the last curve")
    rows, columns = curves[-1].layout.dim
    assert (rows.label, rows.size, rows.stride) == ("velocities", 401, 1604)
    assert (columns.label, columns.size, columns.stride) == ("velocity_m_s,friction_N,low_N,high_N", 4, 4)
    assert process.stop() == 0


def test_settings_of_earlier_versions_are_passed_over_with_one_warning(graph):
    process = graph.start_node(
        {"rls": {"initial_variance": 100.0, "relinearise": True}}, arguments=("-p", "rls.relinearise:=false")
    )
    output = process.output()
    for name, successor in (
        ("rls.initial_variance", "prior.residual_deviation"),
        ("rls.relinearise", "rls.forgetting_factor"),
    ):
        lines = [line for line in output.splitlines() if name in line]
        assert len(lines) == 1, output
        assert successor in lines[0]
        assert "WARN" in lines[0]
    assert "refused" not in output
    answer = graph.call_set(NODE, rls__relinearise=True)
    assert not answer.successful
    assert "rls.forgetting_factor" in answer.reason
    assert process.stop() == 0


def test_range_and_unit_cannot_be_exchanged_while_running(graph):
    graph.start_node(units=False)
    answer = graph.call_set(NODE, learned__force_unit=3.0)
    assert not answer.successful
    assert "first contact" in answer.reason
    listening = Listening(graph)
    stamps, velocity, friction = motion(900, 400.0)
    listening.feed(stamps, velocity, friction)
    listening.heard(stamps.size)
    unit = graph.call_get(NODE, "learned.force_unit")
    assert graph.call_set(NODE, learned__force_unit=unit).successful, "what holds already may be said"
    answer = graph.call_set(NODE, learned__force_unit=2.0 * unit)
    assert not answer.successful
    assert "~/reset" in answer.reason
    assert graph.call_get(NODE, "learned.force_unit") == unit


def test_a_range_that_no_model_can_have_is_told_when_it_is_met(graph):
    process = graph.start_node({"basis.velocity_unit": 1e-9}, units=False)
    listening = Listening(graph)
    stamps, velocity, friction = motion(900, 400.0)
    listening.feed(stamps, velocity, friction)
    values = diagnostics(graph, lambda v: v["samples lost"] == "900")
    assert values["estimator level"] == 2
    assert "basis.velocity_unit" in values["estimator message"]
    assert graph.call_set(NODE, basis__velocity_unit=0.0).successful
    assert graph.call(Trigger, f"{NODE}/reset").success
    listening.feed(stamps, velocity, friction)
    listening.heard(stamps.size)
    assert process.stop() == 0
