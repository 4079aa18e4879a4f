"""Daubechies basis: orthonormal, vanishing moments, partition of unity, sparse, PyWavelets' own values."""

import numpy as np
import pytest
import pywt
from hypothesis import given, settings
from hypothesis import strategies as st

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.model.basis import BASES, WaveletBasis, basis_from_config, dyadic_table
from friction_estimator.core.settings.config import PARAMETERS, Config
from friction_estimator.core.settings.groups import BasisConfig

ORDERS = range(1, 9)


def wide_basis(order: int) -> WaveletBasis:
    return WaveletBasis(
        BasisConfig(
            wavelet=f"db{order}", velocity_range=(-64.0, 64.0), velocity_unit=1.0, coarsest_level=2, companding=0.0
        )
    )


def midpoints(low: float, high: float, level: int) -> tuple[np.ndarray, float]:
    step = 2.0**-level
    return np.arange(low + step / 2, high, step), step


def interior(basis: WaveletBasis, support: int, low: float, high: float) -> np.ndarray:
    """Functions whose whole support lies in the range."""
    scale = 2.0**basis.level_of
    return (basis.translation * scale >= low) & ((basis.translation + support) * scale <= high)


@pytest.mark.parametrize("order", ORDERS)
def test_gram_matrix_is_the_identity(order):
    basis = wide_basis(order)
    u, step = midpoints(-64.0, 64.0, 8)
    psi = basis.dense(u)[:, interior(basis, 2 * order - 1, -64.0, 64.0)]
    gram = psi.T @ psi * step
    assert np.abs(gram - np.eye(gram.shape[0])).max() < 1e-3


@pytest.mark.parametrize("order", ORDERS)
def test_wavelets_have_vanishing_moments(order):
    table = dyadic_table(f"db{order}")
    psi = table.values[1][:-1].T.ravel()
    x = np.arange(psi.size) / (table.values.shape[1] - 1)
    for moment in range(min(order, 3)):
        assert abs(np.mean(psi * (x / table.support) ** moment)) < 2e-4


@pytest.mark.parametrize("order", ORDERS)
def test_scaling_functions_sum_to_one(order):
    np.testing.assert_allclose(dyadic_table(f"db{order}").values[0][:-1].sum(axis=1), 1.0, atol=1e-13)


@pytest.mark.parametrize("order", ORDERS)
def test_table_agrees_with_pywavelets(order):
    """PyWavelets iterates its cascade where we solve for the exact values; the difference shrinks with its level."""

    def largest_difference(level: int) -> float:
        table = dyadic_table(f"db{order}", level).values
        phi, psi, _ = pywt.Wavelet(f"db{order}").wavefun(level)
        worst = 0.0
        for ours, theirs in ((table[0], phi), (table[1], psi)):
            flat = ours[:-1].T.ravel()
            n = min(flat.size, theirs.size) - 8
            worst = max(worst, min(float(np.sqrt(np.mean((flat[:n] - theirs[s : s + n]) ** 2))) for s in range(3)))
        return worst

    coarse, fine = largest_difference(8), largest_difference(12)
    assert fine < 1e-3
    assert fine <= max(coarse, 1e-12)


@pytest.mark.parametrize("order", ORDERS)
def test_at_most_the_support_is_nonzero_on_a_level(order):
    basis = wide_basis(order)
    u, _ = midpoints(-64.0, 64.0, 4)
    psi = basis.dense(u)
    for level in basis.levels:
        assert np.count_nonzero(psi[:, (basis.level_of == level) & ~basis.is_scaling], axis=1).max() <= 2 * order - 1
    assert np.count_nonzero(psi[:, basis.is_scaling], axis=1).max() <= 2 * order - 1


@pytest.mark.parametrize("order", [3, 4, 5])
def test_constants_and_slopes_are_in_the_span(order):
    basis = WaveletBasis(BasisConfig(wavelet=f"db{order}", velocity_range=(-0.2, 0.3)))
    v = np.linspace(-0.2, 0.3, 501)
    psi = basis.dense(v)
    for target in (np.ones_like(v), v / 0.3):
        weights = np.linalg.lstsq(psi, target, rcond=None)[0]
        assert np.abs(psi @ weights - target).max() < 1e-3


def test_every_velocity_in_and_outside_the_range_has_valid_entries():
    basis = WaveletBasis(BasisConfig(velocity_range=(-0.11, 0.07), velocity_unit=0.013))
    v = np.concatenate([np.linspace(-0.11, 0.07, 999), [-1e9, 1e9, 0.0, -0.11, 0.07]])
    index, value = basis.rows(v)
    assert index.min() >= 0
    assert index.max() < basis.size
    assert np.isfinite(value).all()
    np.testing.assert_array_equal(basis.dense(np.array([1e9])), basis.dense(np.array([0.07])))
    assert not basis.inside(np.array([0.071])).any()


@pytest.mark.parametrize("companding", [0.0, 16.0])
def test_no_velocity_falls_between_the_rows_of_the_table(companding):
    """Just below zero the fraction of a level's coordinate rounds to one."""
    basis = WaveletBasis(BasisConfig(velocity_range=(-1.0, 1.0), companding=companding))
    tiny = np.array([5e-324, 1e-300, 1e-17, 1e-16, 2.0**-53])
    for v in (tiny, -tiny, 0.125 - tiny, 0.5 - tiny):
        np.testing.assert_allclose(basis.dense(v), basis.dense(np.round(v, 12)), atol=1e-10)


@given(st.floats(-1.0, 1.0), st.sampled_from([0.0, 1.0, 16.0, 1000.0]))
def test_entries_are_finite_and_a_constant_is_kept(velocity, companding):
    basis = WaveletBasis(BasisConfig(velocity_range=(-1.0, 1.0), companding=companding))
    value = basis.dense(np.array([velocity]))[0]
    assert np.isfinite(value).all()
    amplitude = 2.0 ** (-0.5 * basis.levels[-1])
    assert value[basis.is_scaling].sum() == pytest.approx(amplitude, abs=1e-12)


def test_registered_names_are_those_of_the_setting():
    assert set(PARAMETERS["basis.wavelet"].choices) == set(BASES)


@pytest.mark.parametrize("name", BASES)
def test_every_basis_keeps_the_protocol(name):
    config = Config.from_mapping({"basis.wavelet": name, "basis.velocity_range": [-1.0, 1.0]})
    basis = basis_from_config(config)
    v = np.linspace(-1.5, 1.5, 101)
    index, value = basis.rows(v)
    assert index.shape == value.shape == (101, basis.width)
    for slope in (0.0, 1.5):
        scale = basis.prior_scale(slope)
        assert scale.shape == (basis.size,)
        assert scale.min() > 0.0
        assert scale.max() == 1.0
    one_index, one_value = basis.rows(v[50:51])
    np.testing.assert_array_equal(one_index[0], index[50])
    np.testing.assert_array_equal(one_value[0], value[50])
    located = basis.located(v)
    for ours, theirs in zip(located, (index, value, basis.cells(v)), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    cells = located[2]
    assert cells[0] == cells.min() == 0
    assert cells[-1] == cells.max() == basis.cell_count - 1
    assert np.all(np.diff(cells) >= 0)
    np.testing.assert_array_equal(basis.inside(v), np.abs(v) <= 1.0)


LIMIT = 3.0
within = st.floats(0.05, LIMIT)


@pytest.mark.parametrize("companding", [0.0, 16.0])
@settings(max_examples=30, deadline=None)
@given(st.integers(1, 8), within, within, st.floats(1.0, 3.0), st.floats(1.0, 3.0))
def test_a_larger_range_of_the_same_scale_holds_the_same_functions(companding, order, low, high, down, up):
    """Unit and companding follow from the scale, so growing appends functions and moves none."""
    settings_ = BasisConfig(wavelet=f"db{order}", companding=companding)
    small = WaveletBasis(settings_, (-low, high), LIMIT)
    large = WaveletBasis(settings_, (-low * down, high * up), LIMIT)
    assert (small.unit, small.bend) == (large.unit, large.bend)
    place = large.places_of(small)
    assert np.unique(place).size == small.size
    v = np.linspace(-low, high, 201)
    dense = large.dense(v)
    np.testing.assert_array_equal(dense[:, place], small.dense(v))
    dense[:, place] = 0.0
    assert not dense.any()  # what is appended does not reach into the former range
    np.testing.assert_array_equal(large.cells(v) + large.first_cell, small.cells(v) + small.first_cell)


@given(st.floats(1e-4, 1e3), st.sampled_from([0.0, 1.0, 16.0, 1000.0]))
def test_the_middle_of_a_cell_lies_in_it(reach, companding):
    basis = WaveletBasis(BasisConfig(companding=companding), (-0.3 * reach, reach))
    middle = basis.cell_velocities()
    assert middle.shape == (basis.cell_count,)
    assert np.all(basis.inside(middle))
    inner = slice(1, -1)  # the outermost cells may be cut off by the range
    np.testing.assert_array_equal(basis.cells(middle[inner]), np.arange(basis.cell_count)[inner])


def test_a_scale_that_is_given_sets_unit_and_companding_but_not_the_range():
    basis = WaveletBasis(BasisConfig(), (-0.1, 0.3), 0.2)
    usual = WaveletBasis(BasisConfig(), (-0.2, 0.2))
    assert (basis.unit, basis.bend) == (usual.unit, usual.bend)
    assert basis.reach == (-0.1, 0.3)


def test_no_range_is_refused():
    for reach in ((0.1, 0.1), (0.2, 0.1)):
        with pytest.raises(ConfigError, match="no range"):
            WaveletBasis(BasisConfig(), reach)
    with pytest.raises(ConfigError, match="no first contact"):
        basis_from_config(Config())


def test_a_wrong_unit_is_refused_with_the_remedy():
    with pytest.raises(ConfigError, match="velocity_unit"):
        WaveletBasis(BasisConfig(velocity_range=(-1.0, 1.0), velocity_unit=1e-6))
    with pytest.raises(ConfigError, match="velocity_range"):
        WaveletBasis(BasisConfig())
