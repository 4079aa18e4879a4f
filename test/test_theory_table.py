"""Tables of the user's own: what they mean and how they are refused."""

import itertools
import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.model.theory import theory_from_config
from friction_estimator.core.model.theory_table import Grid, TableCurve
from friction_estimator.core.model.theory_table_file import COLUMNS, read_table
from friction_estimator.core.settings.config import Config

HEADER = ",".join(COLUMNS)
finite = st.floats(-1e3, 1e3)


def write(folder, *rows, header=HEADER):
    path = folder / "curve.csv"
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return path


def one_line(friction_at_ends, velocity=(-1.0, 1.0)):
    values = np.reshape(np.array(friction_at_ends, float), (2, 1, 1))
    return TableCurve(Grid(np.array(velocity, float), np.zeros(1), np.array([20.0]), values), 0.0, 20.0)


def at(curve, v, p=0.0, t=20.0):
    return curve.evaluate(np.atleast_1d(float(v)), np.atleast_1d(float(p)), np.atleast_1d(float(t)))[0]


def random_grid(seed, shape=(5, 3, 4)):
    rng = np.random.default_rng(seed)
    axes = [np.cumsum(rng.uniform(0.1, 1.0, n)) - 1.5 for n in shape]
    return Grid(*axes, rng.normal(size=shape))


@given(st.integers(0, 20))
def test_it_passes_through_every_point_of_the_grid_to_the_bit(seed):
    grid = random_grid(seed)
    points = np.array(list(itertools.product(grid.velocity_m_s, grid.gauge_pressure_Pa, grid.temperature_degC))).T
    d = TableCurve(grid, 0.0, 0.0).evaluate(*points)
    np.testing.assert_array_equal(d, grid.friction_N.ravel())


@given(st.lists(finite, min_size=8, max_size=8), finite, finite, finite)
def test_a_multilinear_function_is_reproduced(coefficients, v, p, t):
    def plane(x, y, z):
        terms = [1.0, x, y, z, x * y, x * z, y * z, x * y * z]
        return sum(c * term for c, term in zip(coefficients, terms, strict=True))

    axes = np.linspace(-1e3, 1e3, 4), np.linspace(-1e3, 1e3, 3), np.linspace(-1e3, 1e3, 3)
    curve = TableCurve(Grid(*axes, plane(*np.meshgrid(*axes, indexing="ij"))), 0.0, 0.0)
    scale = 1e3 * 1e3**3
    assert at(curve, v, p, t) == pytest.approx(plane(v, p, t), rel=1e-9, abs=1e-12 * scale)


@given(st.integers(0, 20), finite, finite, finite)
def test_it_stays_between_the_smallest_and_the_largest_value(seed, v, p, t):
    grid = random_grid(seed)
    d = at(TableCurve(grid, 0.0, 0.0), v, p, t)
    assert grid.friction_N.min() - 1e-12 <= d <= grid.friction_N.max() + 1e-12


def test_the_edge_holds_outside_and_is_counted():
    curve = one_line([-3.0, 5.0])
    assert [at(curve, v) for v in (-7.0, -1.0, 1.0, 9.0)] == [-3.0, -3.0, 5.0, 5.0]
    assert curve.held == 2


def test_an_axis_of_one_value_does_not_matter():
    curve = one_line([-3.0, 5.0])
    assert at(curve, 0.5, 1e6, 100.0) == at(curve, 0.5)
    assert curve.held == 0


def test_a_table_of_positive_velocities_is_half_of_an_odd_curve():
    curve = one_line([2.0, 4.0], velocity=(0.0, 1.0))
    assert [at(curve, v) for v in (-2.0, -0.5, 0.0, 0.5)] == [-4.0, -3.0, 0.0, 3.0]


def test_rows_may_stand_in_any_order_with_other_columns_between(tmp_path):
    rng = np.random.default_rng(0)
    points = list(itertools.product((-0.1, 0.0, 0.1), (0.0, 1e5), (300.0, 320.0, 340.0)))
    values = rng.normal(size=len(points))
    rows = [f"x,{f},{t}, {p} ,{v}" for (v, p, t), f in zip(points, values, strict=True)]
    rng.shuffle(rows)
    header = "note,friction_N,temperature_K,pressure_Pa,velocity_m_s"
    grid = read_table(write(tmp_path, *rows, "", header=header))
    np.testing.assert_array_equal(grid.friction_N.ravel(), values)
    np.testing.assert_allclose(grid.temperature_degC, [26.85, 46.85, 66.85])


def test_the_configuration_names_the_file(tmp_path):
    path = write(tmp_path, "-1,0,300,-2", "1,0,300,2")
    curve = theory_from_config(Config.from_mapping({"theory.kind": "table", "theory.table": str(path)}))
    assert at(curve, 0.5) == 1.0


@pytest.mark.parametrize(
    ("header", "rows", "message"),
    [
        ("velocity_m_s,pressure_Pa,friction_N", ["0,0,0"], r"row 1 lacks the column temperature_K"),
        (HEADER, [], "has no row below the header"),
        (HEADER, ["0,0,300,0", "x,0,300,1"], r"row 3: velocity_m_s is 'x', not a finite number"),
        (HEADER, ["0,0,300,0", "1,0,300"], r"row 3: friction_N is '', not a finite number"),
        (HEADER, ["0,0,300,nan"], r"row 2: friction_N is 'nan'"),
        (HEADER, ["0,0,54.4,0"], r"row 2: temperature_K 54.4 K is -218.75 degC, outside -40 to 150 degC"),
        (HEADER, ["0,-2e5,300,0"], r"row 2: pressure_Pa is -200000, a gauge pressure below vacuum"),
        (HEADER, ["0,0,300,0", "1,0,300,1", "0,0,300,2"], r"row 4 repeats .* of row 2"),
        (HEADER, ["0,0,300,0", "0,1,300,1"], "has 1 velocities"),
        (
            HEADER,
            ["0,0,300,0", "1,0,300,1", "0,1,300,1"],
            r"lacks 1 of the 4 points .*: \(1 m/s, 1 Pa, 300 K\)",
        ),
    ],
)
def test_a_table_that_cannot_be_used_is_refused_by_file_and_row(tmp_path, header, rows, message):
    path = write(tmp_path, *rows, header=header)
    with pytest.raises(ConfigError, match=message) as caught:
        read_table(path)
    assert str(path) in str(caught.value)


def test_an_unreadable_file_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="cannot read"):
        read_table(tmp_path / "absent.csv")
    binary = tmp_path / "binary.csv"
    binary.write_bytes(bytes(range(256)))
    with pytest.raises(ConfigError, match="no CSV text"):
        read_table(binary)


# Scattered measurements


def law(v, p):
    """Friction of a seal that grows with its pressure, with a Stribeck bend, N."""
    return np.sign(v) * (5.0 + 20e-6 * p) * (0.6 + 0.4 * np.exp(-np.abs(v) / 0.01)) + 30.0 * v


def sweeps(seed, pressures=(1e5, 2e5, 4e5), one_sided=False, noise=0.2, n=600):
    """Rows as a rig gives them: sweeps of speed at some pressures, everything a little off and noisy."""
    rng = np.random.default_rng(seed)
    rows = []
    for p in pressures:
        v = 0.15 * np.sin(np.arange(n))
        v = np.abs(v) if one_sided else v
        rows.append([v + 2e-4 * rng.normal(size=n), p + 1e3 * rng.normal(size=n), 300 + 0.3 * rng.normal(size=n)])
        rows[-1].append(law(v, p) + noise * rng.normal(size=n))
    return np.concatenate([np.array(part).T for part in rows])


def from_rows(tmp_path, rows):
    return TableCurve(read_table(write(tmp_path, *(",".join(map(repr, row)) for row in rows.tolist()))), 0.0, 26.85)


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("one_sided", [False, True])
def test_noisy_sweeps_at_some_pressures_become_their_curve(tmp_path, seed, one_sided):
    curve = from_rows(tmp_path, sweeps(seed, one_sided=one_sided))
    rng = np.random.default_rng(seed + 10)
    v = rng.uniform(0.003, 0.145, 500) * rng.choice([-1.0, 1.0], 500)
    for p in (1e5, 2e5, 4e5):
        found = curve.evaluate(v, np.full(500, p), np.full(500, 26.85))
        assert np.sqrt(np.mean((found - law(v, p)) ** 2)) < 0.15  # the rows carry noise of 0.2 N
    between = curve.evaluate(v, np.full(500, 3e5), np.full(500, 26.85))
    assert np.sqrt(np.mean((between - law(v, 3e5)) ** 2)) < 0.2


def test_a_curve_of_scattered_rows_keeps_to_what_was_measured(tmp_path):
    rows = sweeps(4)
    curve = from_rows(tmp_path, rows)
    rng = np.random.default_rng(0)
    v, p, t = rng.uniform(-1, 1, 3000), rng.uniform(-1e5, 2e6, 3000), rng.uniform(-30, 140, 3000)
    found = curve.evaluate(v, p, t)
    assert rows[:, 3].min() <= found.min() <= found.max() <= rows[:, 3].max()
    assert curve.held > 2000


def test_an_asymmetric_measurement_stays_asymmetric(tmp_path):
    rows = sweeps(5)
    rows[:, 3] = np.where(rows[:, 0] > 0, rows[:, 3], 2.0 * rows[:, 3])
    curve = from_rows(tmp_path, rows)
    assert at(curve, -0.1, 2e5, 26.85) == pytest.approx(-2.0 * at(curve, 0.1, 2e5, 26.85), rel=0.03)


def test_a_speed_that_one_pressure_lacks_comes_from_the_next_pressure(tmp_path):
    rows = sweeps(6)
    rows = rows[(rows[:, 0] < 0.05) | (rows[:, 1] < 3e5)]
    curve = from_rows(tmp_path, rows)
    assert at(curve, 0.12, 4e5, 26.85) == pytest.approx(law(0.12, 2e5), abs=2.0)


def test_one_sample_and_many_give_the_same_bits(tmp_path):
    curve = from_rows(tmp_path, sweeps(7, n=100))
    rng = np.random.default_rng(0)
    v, p, t = rng.uniform(-0.2, 0.2, 200), rng.uniform(0, 5e5, 200), rng.uniform(0, 60, 200)
    single = [at(curve, *point) for point in zip(v, p, t, strict=True)]
    np.testing.assert_array_equal(curve.evaluate(v, p, t), single)


@pytest.mark.parametrize("n", [300, 2000])
def test_rows_on_a_line_through_all_three_axes_need_little_memory(tmp_path, n):
    k = np.arange(float(n))
    path = write(tmp_path, *(f"{0.001 * i},{100 * i},{290 + 20 * i / n},{i}" for i in k))
    tracemalloc.start()
    curve = TableCurve(read_table(path), 0.0, 20.0)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 60e6
    found = curve.evaluate(0.001 * k, 100 * k, 290 + 20 * k / n - 273.15)
    assert np.sqrt(np.mean((found - k) ** 2)) < 0.03 * n


def test_few_scattered_rows_are_refused_with_what_is_needed(tmp_path):
    path = write(tmp_path, *(f"{i},{i},{300 + i},{i}" for i in range(10)))
    with pytest.raises(ConfigError, match=r"lacks 990 of the 1000 points .*; scattered .* from 30 rows on"):
        read_table(path)


def test_a_table_that_is_too_large_is_refused(tmp_path):
    path = write(tmp_path, "0,0,300,1\n" * 200_001)
    with pytest.raises(ConfigError, match="has more than 200000 rows: thin them out"):
        read_table(path)
