"""Tables of the user's own: what they mean and how they are refused."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.model.theory import theory_from_config
from friction_estimator.core.model.theory_table import COLUMNS, Grid, TableCurve, read_table
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
