"""The groups of settings: type, default, unit, bounds and meaning of each, once.

The dataclasses below are the single source of the ROS parameters, of the YAML files that every verb reads, and of their
documentation; `config` puts them together.
"""

from dataclasses import dataclass

from friction_estimator.core.quantities import LINEAR, ROTARY
from friction_estimator.core.settings.setting import setting

AUTO = "auto"
"""Value of a setting that what is met decides."""

LARGEST_SPEED, LEAST_SPEED = 1e9, 1e-12
"""Speeds, m/s or rad/s, that are no slip of the pen: squares and ratios of them stay numbers."""

LARGEST_FORCE_N, LEAST_FORCE_N = 1e12, 1e-12

LARGEST_PARAMETER = 1e6
"""Guard: the norm of the normalised parameters stays below this, so each of them does."""


@dataclass(frozen=True)
class ModelConfig:
    """Which model and which law."""

    type: str = setting(
        "parallel",
        "Model structure: hammerstein (f = H g) or parallel (f = H1 d + H2 g, d the theoretical curve).",
        choices=("hammerstein", "parallel"),
    )
    law: str = setting(
        "rls",
        "Adaptation law: lms (the paper's), nlms (joint normaliser) or rls (recursive prediction error).",
        choices=("lms", "nlms", "rls"),
    )
    adapt: bool = setting(True, "Learn from every sample; false predicts with the present values.", live=True)


@dataclass(frozen=True)
class BasisConfig:
    """The static nonlinearity g(v)."""

    wavelet: str = setting(
        "db3",
        "Daubechies wavelet of g: db1 to db8.",
        choices=tuple(f"db{order}" for order in range(1, 9)),
    )
    finest_level: int = setting(-1, "Finest wavelet level m: features of 2^m basis units are resolved.", low=-8, high=8)
    coarsest_level: int = setting(
        3, "Coarsest level; its scaling functions carry constants and slopes.", low=-8, high=12
    )
    velocity_range: tuple[float, ...] = setting(
        (),
        "Velocities that g covers, [lowest, highest]: fixed. Outside, g is held at the edge, nothing is learned, and "
        "the diagnostics say so. Empty: those of the first contact, and it grows with the speeds that follow.",
        unit="m/s",
        of_drive=True,
        low=-LARGEST_SPEED,
        high=LARGEST_SPEED,
        least=LEAST_SPEED,
    )
    velocity_unit: float = setting(
        0.0,
        "Velocity of one basis unit (at standstill, where velocity is companded). 0: the range of the first contact, "
        "or the one given, divided into 16 units.",
        unit="m/s per basis unit",
        of_drive=True,
        low=0.0,
        high=LARGEST_SPEED,
        least=LEAST_SPEED,
    )
    companding: float = setting(
        16.0,
        "Strength c of the companding of velocity, v -> asinh(c v / v_max) v_max / c: finer near standstill, coarser "
        "at speed. 0: none, as in the paper.",
        low=0.0,
        high=1e4,
    )


@dataclass(frozen=True)
class FirConfig:
    """The linear part."""

    order: int = setting(8, "Order N of each FIR filter; it has N + 1 taps.", low=0, high=64)


@dataclass(frozen=True)
class LmsConfig:
    """The paper's law."""

    step_size: float = setting(0.005, "Step size mu of lms, in normalised units.", low=0.0, high=1.0, live=True)
    guard: bool = setting(
        True, "Shorten steps that would overshoot their own sample; false is the paper's law to the letter.", live=True
    )


@dataclass(frozen=True)
class NlmsConfig:
    """Normalised LMS with one joint normaliser."""

    step_size: float = setting(0.2, "Step size mu of nlms.", low=0.0, high=1.0, live=True)
    regularisation: float = setting(
        1e-3, "Floor eps of the normaliser, in normalised units.", low=1e-12, high=1e3, live=True
    )


@dataclass(frozen=True)
class PriorConfig:
    """What is believed before any sample: the same for rls, for the batch fit and, as its metric, for nlms.

    Deviations are relative to `force_unit`; docs/decisions/0003-one-prior.md has the study that chose them.
    """

    weight_deviation: float = setting(
        1.0, "Prior standard deviation of a weight of the coarsest level, in force units.", low=1e-6, high=1e6
    )
    weight_slope: float = setting(
        1.5,
        "A weight of level m has the deviation of the coarsest level M times 2^(slope (m - M)): the larger, the "
        "smoother g.",
        low=0.0,
        high=8.0,
    )
    tap_deviation: float = setting(
        0.15,
        "Prior standard deviation of the first tap behind g about 1, and of the second about 0; 0.4 of it in the "
        "parallel model.",
        low=1e-6,
        high=1e3,
    )
    gain_deviation: float = setting(
        0.03,
        "Prior standard deviation of the static gain of H about 1 in the parallel model: the scale of the curve "
        "belongs to g, and what is left open here is learned at fast reversals and wrong at slow ones.",
        low=1e-6,
        high=1e3,
    )
    theory_gain_deviation: float = setting(
        0.3, "The same for the filter behind the theoretical curve, about 1.", low=1e-6, high=1e3
    )
    tap_decay: float = setting(
        0.9,
        "The covariance of taps i and j is deviation^2 decay^max(i, j): impulse responses die out, smoothly.",
        low=0.01,
        high=0.9999,
    )
    rest_deviation: float = setting(
        0.003,
        "Prior standard deviation of g at standstill, in force units: steady friction is odd enough to vanish there.",
        low=1e-6,
        high=1e6,
    )
    residual_deviation: float = setting(
        0.1,
        "What one sample is taken to err by, in force units: noise and, since it repeats with the drive, several times "
        "the model's error. The larger, the more the prior weighs.",
        low=1e-6,
        high=1e3,
    )


@dataclass(frozen=True)
class RlsConfig:
    """Recursive prediction error method."""

    forgetting_factor: float = setting(
        0.999,
        "1 - lambda is the least share of each error that a step removes, however much is known: lambda = 0.997 "
        "follows slow changes over some hundred samples at each velocity. 1: all samples count alike, nothing is "
        "followed.",
        low=0.9,
        high=1.0,
        live=True,
    )


@dataclass(frozen=True)
class InputConfig:
    """Where the samples come from."""

    mode: str = setting(
        "stamped",
        "stamped (TwistStamped and WrenchStamped, paired by stamp), joint_state (one JointState) or float64 "
        "(two Float64, paired by receive time).",
        choices=("stamped", "joint_state", "float64"),
        live=True,
    )
    motion: str = setting(
        AUTO,
        "What moves: linear (m/s, N; twist.linear and wrench.force of stamped inputs) or rotary (rad/s, N m; "
        "twist.angular and wrench.torque). auto: of stamped inputs the first message that tells, with one of the two "
        "at zero; of a JointState rotary, unless /robot_description has its joint as prismatic; else linear.",
        choices=(AUTO, LINEAR, ROTARY),
        live=True,
    )
    axis: str = setting("x", "Axis of twist and wrench.", choices=("x", "y", "z"), live=True)
    joint: str = setting("", "Joint name in JointState messages; empty: the only joint.", live=True)
    joints: tuple[str, ...] = setting(
        (),
        "Several joints of one JointState topic, an estimator each, with outputs and services under ~/JOINT/ "
        "(characters outside [A-Za-z0-9_] become _); input.joint then is of no meaning. Needs input.mode joint_state. "
        "What one joint has learned is named JOINT.learned.*.",
        at_start=True,
    )
    velocity_from: str = setting(
        "auto",
        "Where the velocity comes from: topic; position (a tracking filter without delay at constant acceleration, its "
        "memory chosen by the encoder's counts and noise); auto: position as long as no velocity has come.",
        choices=("auto", "topic", "position"),
        live=True,
    )
    velocity_gain: float = setting(
        1.0,
        "Reported velocity over the true one: a velocity of the topic is divided by it, one that is made of the "
        "position is not. For a channel of a wrong scale; a diagnosis tells it (velocity_mismatch).",
        low=1e-6,
        high=1e6,
        live=True,
    )
    friction_sign: int = setting(
        1,
        "-1 for a sensor wired the other way (friction must be positive at positive velocity).",
        low=-1,
        high=1,
        live=True,
    )


@dataclass(frozen=True)
class SyncConfig:
    """Pairing and time."""

    slop: float = setting(
        0.0,
        "Largest difference between paired stamps; 0: exact. Keep below half the sample period.",
        unit="s",
        low=0.0,
        high=1.0,
        live=True,
    )
    queue: int = setting(1000, "Unpaired messages kept per input.", low=1, high=100000, live=True)
    gap_factor: float = setting(
        5.0,
        "A step of more than this many sample periods is a gap: the delay lines restart.",
        low=1.5,
        high=1e6,
        live=True,
    )
    jump_back: float = setting(
        1.0,
        "A stamp earlier by at least this is a jump of the clock (bag loop): the delay lines restart, the "
        "parameters stay. Smaller steps back are late samples and are dropped.",
        unit="s",
        low=0.0,
        high=1e6,
        live=True,
    )


@dataclass(frozen=True)
class PublishConfig:
    """What the node publishes."""

    parameters_rate: float = setting(
        1.0, "Rate of ~/parameters/*; 0: every sample.", unit="Hz", low=0.0, high=1e4, live=True
    )


@dataclass(frozen=True)
class StateConfig:
    """The learned state on disk."""

    file: str = setting("", "State file of ~/save and ~/load; empty: none.", live=True, path=True)
    period: float = setting(
        60.0, "Time between periodic saves; 0: only on ~/save and at exit.", unit="s", low=0.0, high=1e6, live=True
    )


@dataclass(frozen=True)
class FilesConfig:
    """What clients elsewhere may do with files of this machine."""

    remote: bool = setting(
        False,
        "Let parameters that name files (theory.table, state.file) be changed on the running node: any client of the "
        "graph may then have the node read and write files.",
        at_start=True,
    )


@dataclass(frozen=True)
class LoadConfig:
    """What the measured effort holds beside friction."""

    terms: tuple[str, ...] = setting(
        (),
        "What the effort holds beside friction: inertia, gravity (sin and cos of the position), spring, constant; "
        "load_dependence, friction that follows these. NAME is learned; what has a value is known and taken off: "
        "inertia=0.02, gravity:sin=1.2,cos=0, spring:centre=0,stiffness=3.",
    )
    half_width: float = setting(
        0.025,
        "Time on either side of a sample from whose velocities its acceleration is taken: with inertia in load.terms "
        "a sample is predicted that much later. Shorter follows faster motion, longer is less noisy.",
        unit="s",
        low=1e-4,
        high=10.0,
    )


@dataclass(frozen=True)
class ExtensionConfig:
    """Terms that a diagnosis added to the model."""

    terms: tuple[str, ...] = setting((), "Terms as NAME:key=value,key=value (effect ids and their fixed parameters).")


@dataclass(frozen=True)
class LearnedConfig:
    """Learned values: empty for a cold start, written by the running estimator."""

    velocity_range: tuple[float, ...] = setting(
        (),
        "Velocities that g covers by what was seen, where basis.velocity_range is empty.",
        unit="m/s",
        of_drive=True,
        low=-LARGEST_SPEED,
        high=LARGEST_SPEED,
        least=LEAST_SPEED,
        live=True,
        learned=True,
    )
    velocity_scale: float = setting(
        0.0,
        "Largest speed of the first contact: it sets basis unit and companding. 0: not met yet.",
        unit="m/s",
        of_drive=True,
        low=0.0,
        high=LARGEST_SPEED,
        least=LEAST_SPEED,
        live=True,
        learned=True,
    )
    force_unit: float = setting(
        0.0,
        "Usual friction of the first contact, where force_unit is 0. 0: not met yet.",
        unit="N",
        of_drive=True,
        low=0.0,
        high=LARGEST_FORCE_N,
        least=LEAST_FORCE_N,
        live=True,
        learned=True,
    )
    theory: str = setting(
        "",
        "Theoretical curve that theory.kind auto has come to. Empty: not met yet.",
        choices=("", "seal", "stribeck"),
        live=True,
        learned=True,
    )
    stribeck: tuple[float, ...] = setting(
        (),
        "Stribeck curve that was found where stribeck.* is empty: Coulomb, breakaway and viscous friction, each at "
        "negative and positive velocity, sign velocity, Stribeck velocity, exponent, and the velocities beyond which "
        "it is held.",
        low=-LARGEST_FORCE_N,
        high=LARGEST_FORCE_N,
        live=True,
        learned=True,
    )
    fir_taps: tuple[float, ...] = setting(
        (),
        "Taps of the FIR behind g.",
        low=-LARGEST_PARAMETER,
        high=LARGEST_PARAMETER,
        live=True,
        learned=True,
    )
    theory_taps: tuple[float, ...] = setting(
        (),
        "Taps of the FIR behind the theoretical curve.",
        low=-LARGEST_PARAMETER,
        high=LARGEST_PARAMETER,
        live=True,
        learned=True,
    )
    wavelet_weights: tuple[float, ...] = setting(
        (), "Weights of g.", low=-LARGEST_PARAMETER, high=LARGEST_PARAMETER, live=True, learned=True
    )
    load_weights: tuple[float, ...] = setting(
        (),
        "Coefficients of the unknown load terms, in force units, in the order of load.terms.",
        low=-LARGEST_PARAMETER,
        high=LARGEST_PARAMETER,
        live=True,
        learned=True,
    )
    extension_weights: tuple[float, ...] = setting(
        (),
        "Coefficients of the extension terms, in the order of extension.terms.",
        low=-LARGEST_PARAMETER,
        high=LARGEST_PARAMETER,
        live=True,
        learned=True,
    )
