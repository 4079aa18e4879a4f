"""What people look at: decimated without losing an extreme, published only while somebody looks."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from friction_estimator.core.decimation import MONITOR_COLUMNS, MONITOR_WIDTH, telling_rows


@given(st.integers(1, 3000), st.integers(1, 6), st.integers(14, 200), st.integers(0, 2**32 - 1))
def test_decimation_keeps_extremes_order_and_whole_rows(count, columns, most, seed):
    rows = np.random.default_rng(seed).standard_normal((count, columns)).round(2)
    rows[:, 0] = np.arange(count)
    kept = telling_rows(rows, most)
    assert len(kept) <= max(most, 0) or len(kept) == count <= most
    index = kept[:, 0].astype(int)
    assert (np.diff(index) > 0).all()
    np.testing.assert_array_equal(kept, rows[index])
    np.testing.assert_array_equal(kept.min(0), rows.min(0))
    np.testing.assert_array_equal(kept.max(0), rows.max(0))
    assert {0, count - 1} <= set(index)
    if count > most:  # in every piece, not over all only
        length = -(-count // ((most - 2) // (2 * columns)))
        for begin in range(0, count, length):
            piece = rows[begin : begin + length]
            ours = kept[(index >= begin) & (index < begin + length)]
            np.testing.assert_array_equal(ours.max(0), piece.max(0))


@pytest.fixture
def graph(tmp_path):
    pytest.importorskip("rclpy")
    import ros_graph

    with ros_graph.graph(tmp_path) as made:
        yield made


@pytest.mark.ros
def test_the_node_publishes_its_samples_for_people_while_somebody_looks(graph):
    from geometry_msgs.msg import WrenchStamped
    from ros_graph import NS, Feeder, await_, force, motion
    from std_msgs.msg import Float64MultiArray

    from friction_estimator.ros.monitor import MOST_ROWS

    node = graph.start_node()
    predicted = graph.hear(WrenchStamped, "/friction_estimator/friction_predicted", raw=True)
    graph.heard_by("/friction_estimator/friction_predicted")
    feeder = Feeder(graph)
    feeder.matched()
    stamps, velocity, friction = motion(20000, 1000.0)
    samples = list(zip(stamps.tolist(), velocity.tolist(), friction.tolist(), strict=True))
    sent = 0

    def feed(count):  # no faster than they are predicted, or a queue on the way would lose some
        nonlocal sent
        for sample in samples[sent : sent + count]:
            feeder.pair(*sample)
        sent += count
        await_(lambda: len(predicted) >= sent, "the predictions")

    for _ in range(4):  # nobody looks
        feed(50)
    batches = []
    topic = "/friction_estimator/monitor"
    subscription = graph.probe.create_subscription(Float64MultiArray, topic, batches.append, 10)

    def fed():
        feed(100)
        return len(batches) >= 5

    await_(fed, "batches")
    rows = np.concatenate([np.reshape(batch.data, (-1, MONITOR_WIDTH)) for batch in batches])
    for batch in batches:
        assert [dimension.label for dimension in batch.layout.dim] == ["samples", MONITOR_COLUMNS]
        assert batch.layout.dim[0].size <= MOST_ROWS
        assert batch.layout.dim[0].size * MONITOR_WIDTH == len(batch.data)
    assert rows[0, 0] >= stamps[200] / NS - 1e-6  # nothing from before somebody looked
    published = {stamp // 1000: value for stamp, value in map(force, predicted)}
    at = {stamp // 1000: (v, f) for stamp, v, f in samples}
    for time_s, v, measured, guess, stddev in rows.tolist():
        stamp_us = round(1e6 * time_s)
        assert (v, measured) == at[stamp_us]
        assert guess == published[stamp_us]
        assert stddev > 0.0
    graph.probe.destroy_subscription(subscription)
    assert node.stop() == 0
