"""The adaptation laws: `lms`, `nlms` and `rls` are one file each, with the compiled step and a class that sets it up.

All laws predict before they learn and use the same gradient regressor x; they differ in the step they take along it.
"""

from typing import ClassVar, Protocol

import numpy as np

from friction_estimator.core.model.basis import Basis
from friction_estimator.core.model.prior import Prior
from friction_estimator.core.registry import Registry
from friction_estimator.core.sample import Floats
from friction_estimator.core.settings.config import Config


class Law(Protocol):
    """One adaptation law."""

    number: ClassVar[int]
    """Its number in the dispatch of `kernels.run`."""

    @staticmethod
    def constants(config: Config) -> tuple[float, float, float, float]:
        """Return the constants of the compiled rule: the first in the places that workspace.py names."""

    keeps_covariance: ClassVar[bool]
    """Whether it starts from the prior's covariance and keeps one."""

    @staticmethod
    def metric(prior: Prior) -> Floats:
        """Return the metric of its steps, (n,), or (0,) where it has none."""


LAWS: Registry[type[Law]] = Registry("law")

MOTION = 0.02
"""Share of the velocity scale above which the shaft moves: errors at rest say nothing of the usual error."""


def constants(law: type[Law], config: Config, basis: Basis) -> Floats:
    """Return `Workspace.law`: the law's own constants, then those of any law.

    These are the speed above which running errors are averaged, the top speed known so far (it grows with the range: a
    first contact that saw little motion must not make standstill too fine), m/s, and the largest Psi' Psi.
    """
    top = max((config.velocity_scale, *map(abs, config.reach or ())))
    return np.array([*law.constants(config), MOTION * config.velocity_scale, top, basis.row_power])
