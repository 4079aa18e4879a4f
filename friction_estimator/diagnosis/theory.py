"""The theoretical curve of a diagnosis: that of the estimator, alike in both directions where samples say it."""

from friction_estimator.core.model.theory_stribeck import Stribeck
from friction_estimator.core.online.first_contact import chosen
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config


def theory_chosen(config: Config, samples: Samples) -> Config:
    """Return the configuration with range, units and theoretical curve as the first contact chooses them."""
    # Whatever model.type is, a diagnosis has a base of its own.
    asked = config.updated({"model.type": "parallel"})
    return chosen(asked, samples) if asked.is_parallel else asked


def with_theory(config: Config, samples: Samples) -> Config:
    """Return the configuration with its theoretical curve known, by the rule of the first contact over all samples.

    A Stribeck curve that was found becomes the mean of its directions: what they differ by is a finding
    (direction_asymmetry, sensor_bias), and a base that had learned it would hide it. Range and units stay open.
    """
    learned = theory_chosen(config, samples).learned
    values: dict[str, object] = {"learned.theory": learned.theory}
    if learned.stribeck:
        values["learned.stribeck"] = Stribeck.of(learned.stribeck, "learned.stribeck").odd.values
    return config.updated(values)
