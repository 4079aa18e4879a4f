"""The terms that a diagnosis added to a model; what makes them is loaded where there are any: 0.2 s of a start."""

from friction_estimator.core.model.structure import Extension
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config


def added_terms(config: Config) -> Extension | None:
    """Return the terms of `extension.terms`, None where there are none; see `effects.extension.extension_from_config`.

    >>> added_terms(Config()) is None
    True
    """
    if not config.extension.terms:
        return None
    from friction_estimator.effects.extension import extension_from_config  # noqa: PLC0415 - see the module

    return extension_from_config(config)


def added_terms_as_met(config: Config, samples: Samples) -> Extension | None:
    """Return them beside the model that these samples open with; see `effects.extension.extension_as_met`.

    >>> added_terms_as_met(Config(), []) is None
    True
    """
    if not config.extension.terms:
        return None
    from friction_estimator.effects.extension import extension_as_met  # noqa: PLC0415 - see the module

    return extension_as_met(config, samples)
