"""When a sample is said to have arrived: never later than it did."""

import time

from friction_estimator.ros.load import Load


def test_work_between_the_samples_of_a_message_hides_no_wait():
    """Several joints in one message: a range that grows behind the first sample keeps the second one waiting."""
    load = Load()
    load.message()
    behind = time.perf_counter_ns()
    with load.other_work():
        time.sleep(0.002)
    assert load.arrived(time.perf_counter_ns()) <= behind
    load.message_done()


def test_a_sample_right_after_other_work_counts_from_its_beginning():
    load = Load()
    begin = time.perf_counter_ns()
    with load.other_work():
        began = time.perf_counter_ns()
        time.sleep(0.002)
    assert begin <= load.arrived(time.perf_counter_ns()) <= began
    later = time.perf_counter_ns() + 10**10
    assert load.arrived(later) == later
