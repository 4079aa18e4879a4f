"""Arrays that go to compiled code by address: what is read there is the array, and nothing else is let through."""

import copy
import pickle

import numpy as np
import pytest
from synthetic import config_for, samples_of

from friction_estimator.core import addresses
from friction_estimator.core.addresses import LINE, Addresses, Layout, padded, placed
from friction_estimator.core.online import workspace
from friction_estimator.core.online.estimator import Estimator

ARRAYS = {
    "floats": np.arange(5.0),
    "float_rows": np.arange(15.0).reshape(3, 5),
    "float_blocks": np.arange(30.0).reshape(2, 3, 5),
    "ints": np.arange(5),
    "int_rows": np.arange(6).reshape(2, 3),
    "int32_rows": np.arange(6, dtype=np.int32).reshape(2, 3),
    "bytes_of": np.arange(5, dtype=np.int8),
    "bools": np.array([True, False, True]),
}


@pytest.mark.parametrize("reader", ARRAYS)
def test_what_is_read_and_written_is_the_array(reader):
    array = ARRAYS[reader].copy()
    kept = Addresses([np.zeros(1), array], [np.float64, array.dtype])
    read = getattr(addresses, reader)
    np.testing.assert_array_equal(read(kept.table, 1), array)
    read(kept.table, 1)[0] = 1
    assert np.all(array[0] == 1)


@pytest.mark.parametrize("shape", [(5,), (3, 5), (1, 5), (2, 3, 5), (3, 8), (0, 0), (2, 0, 0)])
def test_placed_rows_are_whole_lines_with_zeros_behind(shape):
    array = np.random.default_rng(0).standard_normal(shape)
    own = placed(array)
    np.testing.assert_array_equal(own, array)
    if not array.size or len(shape) == 1:
        return
    sizes = Addresses([own], [np.float64]).table[0, 1 : 1 + len(shape)]
    assert list(sizes) == [*shape[:-1], padded(shape[-1])]
    assert own.ctypes.data % 64 == 0
    assert placed(own) is own
    read = addresses.float_rows if len(shape) == 2 else addresses.float_blocks
    whole = read(Addresses([own], [np.float64]).table, 0)
    np.testing.assert_array_equal(whole[..., : shape[-1]], array)
    np.testing.assert_array_equal(whole[..., shape[-1] :], 0.0)


@pytest.mark.parametrize("start", range(1, 18))
def test_the_entry_that_is_asked_for_begins_a_line_and_there_is_room_behind(start):
    array = np.arange(1.0, 21.0)
    own = placed(array, start)
    assert own[start:].ctypes.data % 64 == 0
    wider = np.lib.stride_tricks.as_strided(own, (own.size + LINE,))
    assert np.shares_memory(wider[-1:], own.base)
    np.testing.assert_array_equal(wider, [*array, *[0.0] * LINE])


@pytest.mark.parametrize(
    ("array", "dtype"),
    [
        (np.zeros(4, np.float32), np.float64),
        (np.zeros(4, np.int64), np.float64),
        (np.zeros(8)[::2], np.float64),
        (np.zeros((4, 6))[:, ::2], np.float64),
        (np.zeros((4, 6)).T, np.float64),
        (np.zeros((3, 4, 6))[:, :2], np.float64),
        (np.broadcast_to(np.zeros(1), 5), np.float64),
        (np.zeros((1, 1, 1, 1)), np.float64),
        (np.float64(1.0) * np.ones(()), np.float64),
    ],
)
def test_another_type_or_a_strided_array_is_refused(array, dtype):
    with pytest.raises(ValueError, match="an array of"):
        Addresses([array], [dtype])


def test_read_only_arrays_are_found():
    array = np.arange(3.0)
    array.flags.writeable = False
    np.testing.assert_array_equal(addresses.floats(Addresses([array], [np.float64]).table, 0), [0.0, 1.0, 2.0])


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))])
def test_copies_find_arrays_of_their_own(copied):
    layout = Layout(row=np.float64)
    one = layout.addresses(row=np.arange(3.0))
    other = copied(one)
    addresses.floats(other.table, 0)[0] = 7.0
    assert addresses.floats(one.table, 0)[0] == 0.0
    assert addresses.floats(other.table, 0)[0] == 7.0


@pytest.mark.parametrize("law", ["lms", "rls"])
@pytest.mark.parametrize("copied", [copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))])
def test_a_copied_estimator_goes_on_alike_in_rows_of_whole_lines(copied, law):
    velocity = 0.1 * np.sin(0.05 * np.arange(400.0))
    samples = samples_of(velocity, np.tanh(velocity / 0.01))
    one = Estimator(config_for(samples, **{"model.law": law}))
    one.run(samples[:200], True)
    other = copied(one)
    for name in workspace.IN_LINES:
        own = getattr(other.work, name)
        assert placed(own) is own or own.ndim < 2 or not own.size
    np.testing.assert_array_equal(other.run(samples[200:], True), one.run(samples[200:], True))
