"""What a state may hold: shapes of the model's arrays, magnitudes that arithmetic survives, counts that can be.

A checksum says that a state is what was written, not that it is sound. With values within these bounds every
prediction is a number; beyond them a state is refused before it is used, and not saved over a sound one.
"""

from collections.abc import Iterator, Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.fit.band import COUNT, POWER
from friction_estimator.core.intake import standstill
from friction_estimator.core.model.structure import Model
from friction_estimator.core.online import workspace as at
from friction_estimator.core.online.workspace import Workspace
from friction_estimator.core.sample import Floats
from friction_estimator.core.settings.groups import LARGEST_PARAMETER

LARGEST_COUNT = 2**53
"""Counters are below; as floats they would lose ones from here on."""

LARGEST = {
    "theta": LARGEST_PARAMETER,
    "owed": 2.0 * LARGEST_PARAMETER,
    "ring": 1e3,
    "ring_theory": 1e12,
    "rest": 1e18,
    "status": float(LARGEST_COUNT),
}
"""Largest magnitude in each array: parameters are guarded, rows of the basis are below 64 by construction, the
theoretical curve is brought to the scale of the force unit, and speeds and counts have bounds of their own."""

LARGEST_POWER = 1e60
"""Largest magnitude elsewhere: forces and units are within 1e12, so squared errors in units of force within 1e48."""

LARGEST_RISE = 100.0
"""Factor by which a standard deviation may exceed the prior's. None does by much: information is only
gained, and only rounding and a range that grew over standstill change the rest."""


def arrays_of(state: Mapping[str, Any], model: Model, covariance: bool) -> Mapping[str, Any]:
    """Return a state's arrays where those that grow with the model are of its size; they decide what it costs to try.

    Parameters
    ----------
    covariance : whether the law keeps one.

    Raises ConfigError.
    """
    arrays = state.get("arrays")
    if not isinstance(arrays, Mapping):
        raise ConfigError("state holds no arrays")
    size = model.size
    for name, shape in (("theta", (size,)), ("root", (size, size) if covariance else (0, 0))):
        _check_array(name, arrays.get(name), np.zeros(0), shape)
    return arrays


def take_over(work: Workspace, arrays: Mapping[str, Any]) -> None:
    """Put a state's arrays into a workspace of the same model.

    Raises ConfigError naming an array of another shape or type, or with values that no estimator holds.
    """
    for item in fields(Workspace):
        if item.name in at.CONSTANTS:
            continue
        ours, theirs = getattr(work, item.name), arrays.get(item.name)
        _check_array(item.name, theirs, ours, ours.shape)
        setattr(work, item.name, np.array(theirs))
    check(work)


def check(work: Workspace) -> None:
    """Raise ConfigError, naming the array, where a workspace holds what no estimator comes to hold."""
    for item in fields(Workspace):
        if item.name in at.CONSTANTS:
            continue
        values = np.asarray(getattr(work, item.name), np.float64)  # the least integer has no magnitude of its own
        if not np.all(np.isfinite(values)):
            raise ConfigError(f"state array {item.name} holds values that are not finite")
        if not np.all(np.abs(values) <= LARGEST.get(item.name, LARGEST_POWER)):
            raise ConfigError(f"state array {item.name} holds absurd values, up to {np.max(np.abs(values)):g}")
    for name, sound in _sound(work):
        if not sound:
            raise ConfigError(f"state array {name} holds impossible counts, powers or flags")
    _check_root(work.root, work.prior_root)


def _check_array(name: str, theirs: Any, like: np.ndarray[Any, Any], shape: tuple[int, ...]) -> None:
    if not isinstance(theirs, np.ndarray):
        raise ConfigError(f"state lacks the array {name}")
    if theirs.shape != shape or theirs.dtype != like.dtype:
        raise ConfigError(f"state array {name} is {theirs.dtype}{theirs.shape}, expected {like.dtype}{shape}")


def _sound(work: Workspace) -> Iterator[tuple[str, bool]]:
    """Yield the name of an array and whether one of its rules holds."""
    status, moments = work.status, work.moments
    counts = np.delete(status, [at.HEAD, at.BEYOND, at.MAY_GROW, at.FOLLOWS])
    yield "status", bool(np.all(counts >= 0) and status[at.HEAD] >= -1)
    yield "status", all(status[flag] in (0, 1) for flag in (at.MAY_GROW, at.FOLLOWS))
    powers = [at.ERROR_POWER, at.QUIET_POWER, at.NEWS_POWER, at.MISFIT_POWER, at.TOLERANCE, at.ABSORBED]
    yield "moments", bool(np.all(moments[powers] >= 0.0) and np.all(moments[powers[:2]] > 0.0))
    yield "moments", moments[at.ALARM] in (0.0, 1.0)
    yield "moments", bool(0.0 < moments[at.BACKOFF] <= 1.0 and moments[at.TOLERANCE] > 0.0)
    yield "moments", bool(0.0 <= moments[at.OWED] <= 1.0)
    yield (
        "errors",
        bool(np.all(work.errors[:, [COUNT, POWER]] >= 0.0) and np.all(work.errors[:, COUNT] <= LARGEST_COUNT)),
    )
    signed = [standstill.PREVIOUS, standstill.BEFORE, standstill.MEAN]
    yield "rest", bool(np.all(np.delete(work.rest, signed) >= 0.0))


def _check_root(root: Floats, prior_root: Floats) -> None:
    """Raise ConfigError where P = S S' is no covariance that data can leave of the prior's.

    S S' is positive semidefinite whatever S is; a variance that is zero or above the prior's is not what it can become.
    """
    after, before = (np.sqrt(np.sum(np.square(part), axis=1)) for part in (root, prior_root))
    if not np.all((after > 0.0) & (after <= LARGEST_RISE * before)):
        raise ConfigError("state array root is no covariance: a variance in it is zero, or far above the prior's")
