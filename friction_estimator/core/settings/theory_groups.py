"""The groups of settings of the theoretical curves; see `groups`."""

from dataclasses import dataclass

from friction_estimator.core.settings.groups import LARGEST_FORCE_N, LARGEST_SPEED, LEAST_SPEED
from friction_estimator.core.settings.setting import setting


@dataclass(frozen=True)
class TheoryConfig:
    """The theoretical steady-state curve d(v; p, T)."""

    kind: str = setting(
        "auto",
        "Theoretical curve: seal (physics of a lip seal), stribeck (Coulomb, Stribeck and viscous friction, of "
        "stribeck.* or found from the first contact), table (CSV of your own) or none (parallel then is hammerstein). "
        "auto: the seal where a pressure is recorded, or seal.* or theory.default_pressure is set, and its friction is "
        "of the measured order; else stribeck.",
        choices=("auto", "seal", "stribeck", "table", "none"),
    )
    table: str = setting(
        "",
        "CSV file velocity_m_s,pressure_Pa,temperature_K,friction_N (gauge pressure): a full grid, or 30 scattered "
        "measurements and more; for kind table.",
        path=True,
    )
    ambient_pressure: float = setting(
        101325.0, "Taken off the recorded absolute pressure.", unit="Pa", low=0.0, high=1e9
    )
    default_pressure: float = setting(
        344737.8646584, "Gauge pressure where none is recorded (50 psi).", unit="Pa", low=-1.1e5, high=1e9
    )
    default_temperature: float = setting(
        54.444444444444, "Temperature where none is recorded (130 degF).", unit="degC", low=-40.0, high=150.0
    )


@dataclass(frozen=True)
class SealConfig:
    """Parameters of the seal curve (geometry, p0, mu_b and phi are assumptions, each good to a factor of two)."""

    shaft_diameter: float = setting(0.025, "Shaft diameter D.", unit="m", low=1e-4, high=10.0)
    contact_width: float = setting(2e-4, "Contact width b0 without pressure.", unit="m", low=1e-7, high=1.0)
    width_pressure: float = setting(8e6, "Pressure p_b that doubles the contact width.", unit="Pa", low=1e3, high=1e12)
    preload_pressure: float = setting(2e6, "Mean contact pressure p0 without pressure.", unit="Pa", low=1.0, high=1e10)
    boundary_friction: float = setting(0.20, "Boundary friction coefficient mu_b.", low=0.0, high=10.0)
    roughness: float = setting(8e-8, "Combined roughness sigma.", unit="m", low=1e-10, high=1e-3)
    rest_gap: float = setting(3e-8, "Film thickness h0 at rest.", unit="m", low=1e-12, high=1e-3)
    inlet_gradient: float = setting(6.0, "Shape factor k_w of the inlet pressure gradient.", low=1e-3, high=1e4)
    viscous_factor: float = setting(5.0, "Calibration phi of the viscous part.", low=0.0, high=1e4)
    viscosity_40: float = setting(35.0, "Kinematic viscosity at 40 degC.", unit="cSt", low=1.0, high=1e5)
    viscosity_100: float = setting(7.3, "Kinematic viscosity at 100 degC.", unit="cSt", low=0.5, high=1e4)
    density: float = setting(850.0, "Oil density rho.", unit="kg/m3", low=100.0, high=5000.0)
    pressure_viscosity: float = setting(
        1.8e-8, "Pressure-viscosity coefficient alpha.", unit="1/Pa", low=0.0, high=1e-6
    )
    sign_velocity: float = setting(
        2e-3, "Velocity v_s of the smooth sign tanh(v/v_s).", unit="m/s", low=1e-9, high=10.0
    )
    asymmetry: float = setting(0.0, "Film asymmetry asym between the directions.", low=-0.9, high=0.9)


@dataclass(frozen=True)
class StribeckConfig:
    """Parameters of the Stribeck curve; one value for both directions, or [at negative velocity, at positive]."""

    coulomb: tuple[float, ...] = setting(
        (),
        "Coulomb friction Fc. Empty: the whole curve is found from the first contact.",
        unit="N",
        low=-LARGEST_FORCE_N,
        high=LARGEST_FORCE_N,
    )
    breakaway: tuple[float, ...] = setting(
        (),
        "What friction at breakaway exceeds Coulomb's by, dF. Empty: nothing.",
        unit="N",
        low=0.0,
        high=LARGEST_FORCE_N,
    )
    viscous: tuple[float, ...] = setting(
        (), "Viscous friction Fv. Empty: none.", unit="N s/m", low=0.0, high=LARGEST_FORCE_N
    )
    velocity: float = setting(
        0.0,
        "Stribeck velocity vs: there the excess has fallen to 1/e. 0: a tenth of the velocity scale.",
        unit="m/s",
        low=0.0,
        high=LARGEST_SPEED,
        least=LEAST_SPEED,
    )
    exponent: float = setting(1.0, "Exponent p of that fall.", low=0.1, high=10.0)
    sign_velocity: float = setting(
        0.0,
        "Velocity w of the smooth sign tanh(v/w). 0: a hundredth of the velocity scale.",
        unit="m/s",
        low=0.0,
        high=LARGEST_SPEED,
        least=LEAST_SPEED,
    )
