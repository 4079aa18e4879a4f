"""What every theoretical curve keeps: the same bits for one sample and many, and no trouble from bad samples."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.model.theory import THEORIES, theory_from_config
from friction_estimator.core.model.theory_seal import SealCurve
from friction_estimator.core.model.theory_stribeck import StribeckCurve
from friction_estimator.core.model.theory_table_file import COLUMNS
from friction_estimator.core.settings.config import PARAMETERS, Config
from friction_estimator.core.settings.theory_groups import SealConfig

anything = arrays.arrays(np.float64, 7, elements=st.floats(-1e9, 1e9) | st.sampled_from([math.nan, math.inf, 0.1]))


@pytest.fixture(scope="module")
def table_file(tmp_path_factory):
    """The seal curve itself, tabulated."""
    curve = SealCurve(SealConfig())
    points = list(itertools.product(np.linspace(-0.1, 0.1, 9), (0.0, 5e5, 1e6), (20.0, 60.0, 100.0)))
    friction = curve.evaluate(*np.array(points).T.copy())
    path = tmp_path_factory.mktemp("table") / "curve.csv"
    rows = [f"{v},{p},{t + 273.15},{f}" for (v, p, t), f in zip(points, friction, strict=True)]
    path.write_text("\n".join([",".join(COLUMNS), *rows]), encoding="utf-8")
    return path


STRIBECK = {
    "stribeck.coulomb": [2.0, 3.0],
    "stribeck.breakaway": [1.0],
    "stribeck.viscous": [0.0, 5.0],
    "basis.velocity_range": [-0.1, 0.1],
}


@pytest.fixture(params=[kind for kind in THEORIES if kind != "none"], scope="module")
def build(request, table_file):
    values = {"theory.kind": request.param, "theory.table": str(table_file), **STRIBECK}
    return lambda: theory_from_config(Config.from_mapping(values))


def test_the_registry_and_the_setting_name_the_same_curves():
    assert {*THEORIES, "auto"} == set(PARAMETERS["theory.kind"].choices)


def test_none_is_no_curve():
    assert theory_from_config(Config.from_mapping({"theory.kind": "none", "model.type": "hammerstein"})) is None


@pytest.mark.parametrize("value", [-40.5, 151.0, math.nan])
def test_a_default_temperature_outside_the_law_is_refused(value):
    with pytest.raises(ConfigError, match=r"theory\.default_temperature"):
        Config.from_mapping({"theory.default_temperature": value})


def test_one_sample_and_many_agree_to_the_bit(build):
    rng = np.random.default_rng(1)
    curve = build()
    n = 1000
    inputs = rng.normal(0, 0.1, n), rng.normal(5e5, 5e5, n), rng.normal(50, 40, n)
    whole = curve.evaluate(*inputs)
    single = np.concatenate([curve.evaluate(*(x[k : k + 1] for x in inputs)) for k in range(n)])
    assert whole.tobytes() == single.tobytes()
    steady = (inputs[0], np.full(n, 4e5), np.full(n, 50.0))
    split = [curve.evaluate(*(x[k : k + 13] for x in steady)) for k in range(0, n, 13)]
    assert curve.evaluate(*steady).tobytes() == np.concatenate(split).tobytes()


def test_layout_and_write_protection_of_the_inputs_do_not_matter(build):
    curve = build()
    inputs = np.stack([np.linspace(-0.1, 0.1, 20), np.linspace(0, 1e6, 20), np.linspace(20, 100, 20)])
    wanted = curve.evaluate(*inputs)
    inputs.flags.writeable = False
    np.testing.assert_array_equal(curve.evaluate(*inputs), wanted)
    np.testing.assert_array_equal(curve.evaluate(*np.asfortranarray(inputs)), wanted)


@given(anything, anything, anything)
def test_whatever_the_samples_the_friction_is_finite_and_the_inputs_stay(build, v, p, t):
    copies = v.copy(), p.copy(), t.copy()
    d = build().evaluate(v, p, t)
    assert np.isfinite(d).all()
    for now, before in zip((v, p, t), copies, strict=True):
        np.testing.assert_array_equal(now, before)


def test_missing_values_take_the_defaults_and_are_counted(build):
    curve = build()
    if isinstance(curve, StribeckCurve):
        pytest.skip("needs neither pressure nor temperature")
    settings = Config().theory
    v, nan = np.linspace(-0.1, 0.1, 5), np.full(5, math.nan)
    p, t = np.full(5, settings.default_pressure), np.full(5, settings.default_temperature)
    wanted = curve.evaluate(v, p, t)
    assert (curve.defaulted, curve.held) == (0, 0)
    for pressure, temperature in ((nan, t), (p, nan), (nan, nan)):
        np.testing.assert_array_equal(curve.evaluate(v, pressure, temperature), wanted)
    assert (curve.defaulted, curve.held) == (15, 0)


def test_values_out_of_range_are_held_at_the_limit_and_counted(build):
    curve = build()
    if isinstance(curve, StribeckCurve):
        pytest.skip("has a test of its own in test_theory_stribeck")
    v, p, t = np.full(1, 0.05), np.full(1, 4e5), np.full(1, 50.0)
    hot, hotter = curve.evaluate(v, p, np.full(1, 1e3)), curve.evaluate(v, p, np.full(1, math.inf))
    assert hot == hotter
    high, higher = curve.evaluate(v, np.full(1, 2e9), t), curve.evaluate(v, np.full(1, math.inf), t)
    assert high == higher
    assert curve.evaluate(np.full(1, math.nan), p, t) == 0.0
    assert (curve.defaulted, curve.held) == (0, 5)


def test_arrays_of_different_length_are_a_fault_of_the_caller(build):
    with pytest.raises(ValueError, match="differ in shape"):
        build().evaluate(np.zeros(3), np.zeros(3), np.zeros(2))
