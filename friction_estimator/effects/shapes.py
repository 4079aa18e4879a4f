"""Free shapes over speed, for causes whose dependence on speed no formula tells: hat functions of |v|.

hat_j(|v|),  j = 0 ... HATS - 1,  sum_j hat_j = 1,  nodes evenly spaced in asinh(|v| / bend)
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from friction_estimator.core.sample import Floats
from friction_estimator.effects.axis import BEND, REACH
from friction_estimator.effects.features import Features
from friction_estimator.effects.reference import Reference

HATS = 6
"""Nodes from standstill to the top speed, closest at low speed."""

FREE = 2.0
"""Value of a regressor's key `shape` that asks for the free shape."""


TWICE = 3.0
"""And for the free shape with two dependences on the pressure."""


LOW_SPEED = 0.03
"""Share of the top speed at which the level of a free shape is stated: the boundary level, not the viscous part."""


def is_free(params: Mapping[str, float]) -> bool:
    """Return whether a regressor of these parameters has a free shape."""
    return params.get("shape", 0.0) >= FREE


def hats(velocity_m_s: Floats, reference: Reference) -> Floats:
    """Return the hat functions of the speed, (n, HATS)."""
    place = np.arcsinh(np.abs(velocity_m_s) / reference.bend_m_s) / REACH
    return weights_at(place)


def weights_at(place: Floats) -> Floats:
    """Return the hat functions at places from 0 (standstill) to 1 (top speed), (n, HATS).

    >>> weights_at(np.array([0.0, 0.5])).sum(axis=1).tolist()
    [1.0, 1.0]
    """
    nodes = np.arange(HATS)
    return np.asarray(np.maximum(0.0, 1.0 - np.abs(np.clip(place, 0.0, 1.0)[:, None] * (HATS - 1) - nodes)))


def place_of(share: float) -> Floats:
    """Return the place of a share of the top speed, (1,)."""
    return np.array([np.arcsinh(share * BEND) / REACH])


def sliding(features: Features, reference: Reference) -> Features:
    """Return the features of a forward motion at the same speeds, none of them too slow for the level."""
    moving = reference.moving(features.velocity_m_s)
    return replace(features, velocity_m_s=moving, previous_m_s=moving)
