"""Faults of the data: what a detector sees of a record, and what it says of it.

An effect that is a fault of the data carries its own test (`Effect.detect`). The diagnosis asks the effects in the
order of `ORDER`, repairs or masks what they find, and shows each the data as repaired so far.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from friction_estimator.core.sample import Bools, Floats, Ints, Samples
from friction_estimator.effects.features import Context, Features

ORDER = ("", "motion", "force", "residual", "variance")
"""Values of `Effect.detects_at`: no detector; the motion channels; the force channel; the residual of the base model;
the residual of the last model, whose scatter is judged."""

COMPLETELY = "completely"
MASKED = "masked"
SMOOTHED = "smoothed"
DIVIDED = "divided by the gain"
NOT_REPAIRED = "not repaired"

Quantity = tuple[float, str, float, float]
"""Value, unit and the ends of its 95 % interval."""


@dataclass(frozen=True)
class Fault:
    """A fault of the data.

    Attributes
    ----------
    name : effect id. evidence : what it was seen in, in words.
    parameters : name -> (value, unit, low, high).
    repaired : COMPLETELY, MASKED, SMOOTHED, DIVIDED or NOT_REPAIRED.
    p_value : of the test that found it; None where none was computed.
    used : (n,) bool, samples that remain after masking, or None.
    velocity_m_s, position_m, pressure_Pa : (n,) repaired channel (the pressure absolute, as recorded), or None.
    offset_N : to be taken off the force, N: the shift of a lattice that cuts off instead of rounding.
    scatter_m_s : deviation of the noise of the velocity, m/s; 0 where it has none.
    power_N2 : power of the error that it makes, N^2; 0 where it makes none in the force.
    lattice_N : distance of the values that the force can take, N; 0 where it can take any.
    conceals : whether most of the error is its own, so that spikes and scatter cannot be told from it.
    """

    name: str
    evidence: str
    parameters: Mapping[str, Quantity]
    repaired: str
    p_value: float | None = None
    used: Bools | None = None
    velocity_m_s: Floats | None = None
    position_m: Floats | None = None
    pressure_Pa: Floats | None = None
    offset_N: float = 0.0
    scatter_m_s: float = 0.0
    power_N2: float = 0.0
    lattice_N: float = 0.0
    conceals: bool = False


@dataclass(frozen=True)
class DataView:
    """What a detector sees of a record, arrays of one length n.

    Attributes
    ----------
    samples, features, context : of the record, as repaired so far.
    force_N : (n,), measured force, as repaired so far, N.
    used : (n,) bool, False for masked samples. restart : (n,) bool, first sample after a gap.
    recording, block : (n,) int, number of the recording and of the block of time.
    residual_N : (n,), of the base model ("residual") or of the last model ("variance"), N; None before a fit.
    force_slope, pressure_slope : (n,), dF/dv and dF/dp of the base model's static curve, N s/m and N/Pa; None before.
    lattice_N : step of the lattice that the force lies on, N; 0 where it lies on none.
    pairs : samples that a deterministic system would make equal, (m,), (m,); None where they were not sought.
    found : faults found so far, in their order.
    """

    samples: Samples
    features: Features
    context: Context
    force_N: Floats
    used: Bools
    restart: Bools
    recording: Ints
    block: Ints
    residual_N: Floats | None = None
    force_slope: Floats | None = None
    pressure_slope: Floats | None = None
    lattice_N: float = 0.0
    pairs: tuple[Ints, Ints] | None = None
    found: tuple[Fault, ...] = ()
