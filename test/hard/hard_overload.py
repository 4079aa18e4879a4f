"""1 and 3 kHz into a basis that is far too slow for them, and into a node that stands still for too long.

make hard PYTEST_ARGS=test/hard/hard_overload.py
"""

import pytest

pytest.importorskip("rclpy")

import ros_graph
from ros_overload import WEIGHTS_2000, WEIGHTS_4000, overload

pytestmark = [pytest.mark.ros, pytest.mark.parametrize("attempt", range(10))]


@pytest.mark.parametrize("rate_hz", [1000.0, 3000.0])
@pytest.mark.parametrize("parameters", [WEIGHTS_4000, WEIGHTS_2000], ids=["4000", "2000"])
def test_a_basis_that_is_too_slow(tmp_path, parameters, rate_hz, attempt):
    with ros_graph.graph(tmp_path) as graph:
        found = overload(graph, parameters, seconds=6.0, rate_hz=rate_hz)
    print(found)
    assert found["dropped"] > 0
    assert any("too slow" in words and "smaller basis" in words for words in found["words"])
    assert found["warned_s"] < 2.0
    assert found["longest_pause_s"] < 1.5
    assert found["answered_s"] < 2.0
    assert found["stopped_s"] < 3.0


@pytest.mark.parametrize("rate_hz", [1000.0, 3000.0])
def test_a_node_that_stands_still(tmp_path, rate_hz, attempt):
    """`overload` counts every sample, those that went meanwhile among them: the publisher made no pause."""
    with ros_graph.graph(tmp_path) as graph:
        found = overload(graph, {}, seconds=9.0, rate_hz=rate_hz, stopped=True)
    print(found)
    assert found["answered_s"] < 2.0
    assert found["stopped_s"] < 3.0
