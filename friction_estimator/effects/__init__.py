"""Effects that a rig can hide in its data: one class an effect, a file a family."""

from friction_estimator.effects import drift, dynamics, faults, reversal, sensor, static  # noqa: F401 - register
from friction_estimator.effects.base import EFFECTS, Effect, list_effects, parse_effect
from friction_estimator.effects.compose import compose
from friction_estimator.effects.trace import STAGES, Trace

__all__ = ["EFFECTS", "STAGES", "Effect", "Trace", "compose", "list_effects", "parse_effect"]
