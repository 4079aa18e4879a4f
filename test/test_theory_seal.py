"""Physics of the seal curve: limits, symmetries and scaling laws that hold whatever the parameters."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.model.oil import checked_temperature, kinematic_viscosity, walther_coefficients
from friction_estimator.core.model.theory import theory_from_config
from friction_estimator.core.model.theory_seal import SealCurve
from friction_estimator.core.settings.config import PARAMETERS, Config
from friction_estimator.core.settings.theory_groups import SealConfig

PSI = 6894.757293168
DEFAULT = SealConfig()
PAPER_TEMPERATURE = (130.0 - 32.0) / 1.8


def friction(velocity, pressure=50 * PSI, temperature=PAPER_TEMPERATURE, seal=DEFAULT):
    v, p, t = np.broadcast_arrays(*(np.asarray(x, float) for x in (velocity, pressure, temperature)))
    return SealCurve(seal).evaluate(v.ravel(), p.ravel(), t.ravel()).reshape(v.shape)


def within(name):
    """Any value of a seal parameter inside its bounds, each decade alike where it spans several."""
    item = PARAMETERS[f"seal.{name}"]
    if item.low > 0.0:
        return st.floats(math.log(item.low), math.log(item.high)).map(
            lambda x: min(max(math.exp(x), item.low), item.high)
        )
    return st.floats(item.low, item.high)


speeds = st.floats(1e-6, 1.0)
pressures = st.floats(-1e5, 2e7)
temperatures = st.floats(-40.0, 150.0)


@st.composite
def seals(draw):
    values = {name.removeprefix("seal."): draw(within(name[5:])) for name in PARAMETERS if name[:5] == "seal."}
    low, high = sorted((values["viscosity_40"], values["viscosity_100"]))
    return SealConfig(**values | {"viscosity_40": max(high, 1.0) * 1.01, "viscosity_100": max(low, 0.5)})


@given(speeds, pressures, temperatures)
def test_it_is_odd_without_asymmetry(v, p, t):
    assert friction(-v, p, t) == -friction(v, p, t)


@given(st.floats(0.05, 0.9), st.floats(0.01, 0.5))
def test_a_positive_asymmetry_thins_the_film_of_positive_velocity(asymmetry, v):
    seal = SealConfig(asymmetry=asymmetry)
    curve = SealCurve(seal)
    e = curve.entrainment(np.array([v, -v]))
    assert e[0] < v < e[1]


@given(pressures, temperatures)
def test_the_slope_at_standstill_is_that_of_dry_friction(p, t):
    """d = mu_b N tanh(v/v_s) + O(v^3): the viscous part (1 - chi) v grows like v^2 v."""
    seal = DEFAULT
    step = 1e-6 * seal.sign_velocity
    contact = seal.preload_pressure + p
    width = seal.contact_width * (1.0 + p / seal.width_pressure)
    normal = math.pi * seal.shaft_diameter * width * contact
    assert friction(step, p, t) / step == pytest.approx(seal.boundary_friction * normal / seal.sign_velocity, rel=1e-6)


@given(pressures, temperatures)
def test_it_grows_with_the_root_of_speed_in_full_film(p, t):
    v = np.array([1e3, 2e3])
    low, high = friction(v, p, t)
    assert math.log2(high / low) == pytest.approx(0.5, abs=2e-3)


@given(st.floats(0.02, 0.5), pressures, st.floats(20.0, 100.0), st.floats(20.0, 100.0))
def test_above_ten_sign_velocities_only_viscosity_times_speed_and_pressure_count(v, p, t, other):
    oil = DEFAULT.viscosity_40, DEFAULT.viscosity_100
    ratio = float(np.divide(*kinematic_viscosity(np.array([t, other]), *oil)))
    v, v_other = max(v, v / ratio), max(v, v / ratio) * ratio
    assert min(v, v_other) >= 10 * DEFAULT.sign_velocity * (1 - 1e-12)
    assert friction(v, p, t) == pytest.approx(friction(v_other, p, other), rel=1e-7)


@pytest.mark.parametrize("psi", [50, 200])
def test_the_stribeck_minimum_lies_at_one_product_of_viscosity_and_speed(psi):
    products = []
    for t in (20.0, 40.0, 60.0, 80.0):
        nu = kinematic_viscosity(np.array([t]), DEFAULT.viscosity_40, DEFAULT.viscosity_100)[0]
        v = np.linspace(0.5, 5.0, 20001) / nu  # round the minimum at nu v = 2.3 and 3.1 cSt m/s
        products.append(nu * v[friction(v, psi * PSI, t).argmin()])
    assert products == pytest.approx([products[0]] * 4, rel=1e-3)


@given(st.floats(1e-4, 0.5), st.floats(0.0, 1e7), st.floats(1e3, 1e7), st.floats(0.0, 150.0))
def test_it_grows_with_pressure_from_the_freezing_point_up(v, p, more, t):
    assert friction(v, p + more, t) > friction(v, p, t)


@given(st.floats(0.03, 0.3), st.sampled_from([50 * PSI, 200 * PSI]))
def test_it_falls_and_then_rises_with_temperature_at_a_fixed_speed(v, p):
    d = friction(v, p, np.linspace(0.0, 150.0, 301))
    lowest = d.argmin()
    assert 0 < lowest < 300
    assert (np.diff(d[: lowest + 1]) < 0).all()
    assert (np.diff(d[lowest:]) > 0).all()


@given(
    st.floats(1e-9, 0.5) | st.floats(-0.5, -1e-9),
    st.floats(0.0, 1e6),
    st.floats(-30.0, 140.0),
    st.integers(-1, 1),
    st.integers(-4, 4),
    st.floats(-0.5, 0.5),
)
def test_rescaling_the_units_rescales_the_force_to_the_bit(v, p, t, length_bits, mass_bits, asymmetry):
    """Units of 2^-a m, 2^-2a s (so that the cSt of the viscosity law stay) and 2^-b kg."""
    length, mass = 2.0**length_bits, 2.0**mass_bits
    time = length**2
    stress, speed = mass / (length * time**2), length / time
    seal = SealConfig(asymmetry=asymmetry)
    scaled = SealConfig(
        shaft_diameter=seal.shaft_diameter * length,
        contact_width=seal.contact_width * length,
        width_pressure=seal.width_pressure * stress,
        preload_pressure=seal.preload_pressure * stress,
        roughness=seal.roughness * length,
        rest_gap=seal.rest_gap * length,
        density=seal.density * mass / length**3,
        pressure_viscosity=seal.pressure_viscosity / stress,
        sign_velocity=seal.sign_velocity * speed,
        asymmetry=asymmetry,
    )
    force = mass * length / time**2
    assert friction(v * speed, p * stress, t, scaled) == friction(v, p, t, seal) * force


@given(seals(), st.floats(-1e5, 1e5), st.floats(allow_nan=True), st.floats(allow_nan=True))
def test_it_is_finite_with_the_sign_of_the_velocity_over_all_bounds(seal, v, p, t):
    d = float(friction(v, p, t, seal))
    assert math.isfinite(d)
    assert d * v >= 0.0


@given(seals(), st.floats(-1.0, 1.0), pressures, temperatures)
def test_the_friction_on_the_steady_film_is_the_steady_friction(seal, v, p, t):
    curve = SealCurve(seal)
    v, p, t = np.array([v]), np.array([p]), np.array([t])
    on_film = curve.on_film(v, curve.entrainment(v), p, t, np.ones(1), np.ones(1))
    np.testing.assert_allclose(on_film, curve.evaluate(v, p, t), rtol=1e-9)


@pytest.mark.parametrize(("psi", "peak", "lowest", "at"), [(50, 5.5, 1.2, 0.101), (200, 9.3, 1.8, 0.136)])
def test_peak_and_minimum_at_130_degF(psi, peak, lowest, at):
    v = np.linspace(0.0, 0.3, 30001)
    d = friction(v, psi * PSI)
    top = d[v < 0.02].argmax()
    bottom = top + d[top:].argmin()
    assert d[top] == pytest.approx(peak, abs=0.05)
    assert d[bottom] == pytest.approx(lowest, abs=0.05)
    assert v[bottom] == pytest.approx(at, abs=1e-3)


class TestViscosity:
    @given(st.floats(1.0, 1e5), st.floats(0.1, 0.99))
    def test_it_passes_through_both_given_viscosities(self, nu40, fraction):
        nu100 = max(0.5, nu40 * fraction)
        if not nu100 < nu40:
            return
        nu = kinematic_viscosity(np.array([40.0, 100.0]), nu40, nu100)
        # Below 4 cSt the standard's own inverse is an approximation.
        assert nu == pytest.approx([nu40, nu100], rel=2e-3 if nu100 < 4.0 else 1e-5)

    @given(st.floats(5.0, 1e3), st.floats(0.1, 0.9), temperatures)
    def test_it_is_straight_on_the_standard_s_chart(self, nu40, fraction, t):
        celsius = np.array([t, 40.0, 100.0])
        nu = kinematic_viscosity(celsius, nu40, max(4.0, nu40 * fraction))
        if not 4.0 <= nu[0] < 1e7:
            return  # above 4 cSt Z is nu + 0.7
        x, y = np.log10(celsius + 273.15), np.log10(np.log10(nu + 0.7))
        assert (y[0] - y[1]) * (x[2] - x[1]) == pytest.approx((y[2] - y[1]) * (x[0] - x[1]), abs=1e-5)

    @given(st.floats(-40.0, 149.0))
    def test_it_falls_with_temperature(self, t):
        low, high = kinematic_viscosity(np.array([t + 1.0, t]), 35.0, 7.3)
        assert low < high

    @pytest.mark.parametrize("t", [-40.1, 150.1, math.nan, math.inf])
    def test_temperatures_outside_the_law_are_refused(self, t):
        with pytest.raises(ConfigError, match="outside -40 to 150 degC"):
            kinematic_viscosity(np.array([t]), 35.0, 7.3)
        with pytest.raises(ConfigError, match=r"^theory\.x is"):
            checked_temperature(t, "theory.x")
        with pytest.raises(ConfigError, match="default_temperature"):
            SealCurve(DEFAULT, 0.0, t)

    def test_an_oil_must_thin_as_it_warms(self):
        with pytest.raises(ConfigError, match="thins"):
            walther_coefficients(10.0, 10.0)
        with pytest.raises(ConfigError, match=r"seal\.viscosity_100"):
            theory_from_config(Config.from_mapping({"theory.kind": "seal", "seal.viscosity_100": 40.0}))
