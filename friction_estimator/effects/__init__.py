"""Effects that a rig can hide in its data: one class an effect, a file a family."""

from friction_estimator.effects import (  # noqa: F401 - they register
    channels,
    drift,
    dynamics,
    film,
    load,
    patterns,
    reversal,
    sensor,
    spoiled,
    stamps,
    static,
    steps,
    stick_slip,
    timing,
)
from friction_estimator.effects.base import EFFECTS, Effect
from friction_estimator.effects.catalogue import list_effects, parse_effect
from friction_estimator.effects.compose import compose
from friction_estimator.effects.extension import ExtensionTerms, extension_from_config
from friction_estimator.effects.trace import STAGES, Trace

__all__ = [
    "EFFECTS",
    "STAGES",
    "Effect",
    "ExtensionTerms",
    "Trace",
    "compose",
    "extension_from_config",
    "list_effects",
    "parse_effect",
]
