"""1 kHz into a basis of 4000 weights, thirty times slower than the samples come."""

import pytest

pytest.importorskip("rclpy")

import ros_graph
from ros_overload import judge_overload

pytestmark = pytest.mark.ros


def test_a_basis_of_4000_weights_at_1_khz(tmp_path):
    with ros_graph.graph(tmp_path) as graph:
        found = judge_overload(graph, -6, seconds=10.0, rate_hz=1000.0)
    print({key: value if isinstance(value, str) else round(value, 2) for key, value in found.items()})
    assert found["warned_s"] < 2.0
    assert found["grave_s"] < 2.0 + 1.0  # the first thousand wait, none of them is lost
    assert found["longest_pause_s"] < 1.5
    assert found["answered_s"] < 2.0
    assert found["stopped_s"] < 3.0


def test_a_basis_of_2000_weights_at_3_khz(tmp_path):
    with ros_graph.graph(tmp_path) as graph:
        judge_overload(graph, -5, seconds=2.0, rate_hz=3000.0)
