"""What is formed part by part is what whole arrays give, to the bit."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from friction_estimator.bag.merge import in_order, merged_parts, recorded_order
from friction_estimator.core import metrics, series, sums
from friction_estimator.core.sample import NS_PER_S
from friction_estimator.core.series import Formed, RunningTime
from friction_estimator.report.page import curves, envelope

N = 2 * sums.BLOCK + 4321


def test_running_time_passes_over_jumps_and_between_recordings():
    rng = np.random.default_rng(0)
    step = rng.integers(900_000, 1_100_000, N)
    step[[5, sums.BLOCK, N - 2]] = -3 * NS_PER_S
    starts = (0, 777, sums.BLOCK - 1, sums.BLOCK + 9)
    stamp = np.cumsum(step)
    expected = np.diff(stamp, prepend=stamp[:1])
    expected[expected < 0] = 0
    expected[list(starts[1:])] = 1_000_000
    whole = np.cumsum(expected) / NS_PER_S
    time = RunningTime(stamp, starts, 1_000_000)
    assert time.size == N
    for part in (slice(None), slice(5, 9), slice(sums.BLOCK - 3, sums.BLOCK + 3), slice(N - 3, None), slice(9, 2)):
        assert time[part].tolist() == whole[part].tolist()
    places = np.array([0, 5, sums.BLOCK, N - 1])
    assert series.at(time, places).tolist() == whole[places].tolist()
    assert RunningTime(stamp[:0])[:].size == 0


def test_ends_and_quantiles_of_a_series():
    values = np.random.default_rng(1).standard_normal(N)
    formed = Formed(N, lambda part: values[part])
    assert series.ends(formed) == (values.min(), values.max())
    assert series.upper_quantile(series.sizes(formed), 0.999) == np.quantile(np.abs(values), 0.999)
    values[3] = np.nan
    assert series.ends(formed) == (np.nanmin(values), np.nanmax(values))
    assert np.isnan(series.ends(np.empty(0))).all()


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    sizes=st.lists(st.integers(0, 40), min_size=1, max_size=4),
    spread=st.integers(1, 60),
    block=st.integers(1, 20),
    seed=st.integers(0, 99),
)
def test_parts_of_streams_are_merged_as_the_whole(sizes, spread, block, seed):
    rng = np.random.default_rng(seed)
    streams = [np.sort(rng.integers(0, spread, size)) for size in sizes]
    assert all(map(in_order, streams))
    names = [[(k, index) for index in range(size)] for k, size in enumerate(sizes)]
    flat = [name for stream in names for name in stream]
    expected = [flat[k] for k in recorded_order(*streams)]
    found = []
    for parts in merged_parts(streams, block):
        some = [name for stream, part in zip(names, parts, strict=True) for name in stream[part]]
        found += [some[k] for k in recorded_order(*(one[part] for one, part in zip(streams, parts, strict=True)))]
    assert found == expected


def test_a_time_that_goes_back_is_out_of_order_at_the_edge_of_a_block_too():
    times = np.arange(N)
    times[sums.BLOCK] = sums.BLOCK - 2
    assert not in_order(times)


@pytest.mark.parametrize("rows", [40, 3000])
def test_extremes_of_rows_longer_and_shorter_than_a_block(rows):
    rng = np.random.default_rng(2)
    values, gap = rng.standard_normal(N), rng.random(N) < 1e-4
    values[100:200] = np.nan
    table = envelope.table(np.arange(N) * 1e-3, {"x": values}, gap, rows)
    edges = np.round(1e3 * np.asarray(table.columns["time_s"], float)).astype(int)
    zero, step = table.steps["x"]
    for name, whole in (("x_low", np.fmin.reduceat(values, edges)), ("x_high", np.fmax.reduceat(values, edges))):
        assert np.nanmax(np.abs(zero + step * table.columns[name].astype(float) - whole)) <= 1.01 * step


def test_means_in_bins_do_not_depend_on_pieces():
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-2.0, 5.0, N), rng.standard_normal(N)
    x[7], y[sums.BLOCK] = np.nan, np.inf
    used = np.isfinite(x) & np.isfinite(y) & (np.arange(N) >= 1000)
    kept, count = x[used], curves.BINS[1]
    cell = np.minimum(((kept - kept.min()) / np.ptp(kept) * count).astype(int), count - 1)
    mean = np.bincount(cell, weights=y[used], minlength=count) / np.bincount(cell, minlength=count)
    found = curves.binned(curves.Points(x, y, 1000))
    assert found.mean.tolist() == mean.tolist()


def test_white_noise_over_blocks_is_that_of_the_whole():
    rng = np.random.default_rng(4)
    force, restart = rng.standard_normal(N), rng.random(N) < 0.01
    whole = ~(restart[1:-2] | restart[2:-1] | restart[3:])
    third = np.abs(np.diff(force, 3)[whole])
    assert metrics.white_noise(force, restart) == float(np.median(third) / (0.6745 * np.sqrt(20.0)))
