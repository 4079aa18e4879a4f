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
from friction_estimator.core.online.recovery import FORMER, HELD, NEWER, OLDER, Kept
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

MOMENTS_NO_MORE = (1, 2, 5)
"""Places in the moments of version 3 that no later version has."""

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
        if item.name == "rest" and isinstance(theirs, np.ndarray) and theirs.shape == (standstill.WITHOUT_POSITION,):
            theirs = np.append(theirs, ours[standstill.WITHOUT_POSITION :])
        if item.name == "kept_root" and isinstance(theirs, np.ndarray) and theirs.shape == (0, *ours.shape[1:]):
            theirs = ours  # left out where nothing depends on it
        _check_array(item.name, theirs, ours, ours.shape)
        ours[...] = theirs
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
    for root in (work.root, *(root for root in work.kept_root if root.any())):
        _check_root(root, work.prior_root)


def with_nothing_kept(arrays: Mapping[str, Any], work: Workspace) -> dict[str, Any]:
    """Return the arrays of a state of version 3 as they are now: models are kept again when all is calm.

    Parameters
    ----------
    work : of a new estimator.
    """
    now = dict(arrays) | {name: getattr(work, name) for name in ("kept", "kept_root", "trial", "hold")}
    moments = now.get("moments")
    if isinstance(moments, np.ndarray) and moments.shape == (at.MOMENTS_SIZE + len(MOMENTS_NO_MORE),):
        now["moments"] = np.delete(moments, MOMENTS_NO_MORE)
        now["moments"][at.TOLERANCE] = 1.0  # it referred to another alarm
    return now


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
    yield "moments", _sound_powers(moments)
    yield "moments", bool(0.0 < moments[at.BACKOFF] <= 1.0 and moments[at.TOLERANCE] > 0.0)
    yield "moments", bool(0.0 <= moments[at.OWED] <= 1.0)
    yield "noise", bool(np.all(work.noise >= 0.0))
    yield "residual", bool(np.all(work.residual >= 0.0))
    yield (
        "errors",
        bool(np.all(work.errors[:, [COUNT, POWER]] >= 0.0) and np.all(work.errors[:, COUNT] <= LARGEST_COUNT)),
    )
    signed = [standstill.PREVIOUS, standstill.BEFORE, standstill.MEAN, standstill.PLACE]
    yield "rest", bool(np.all(np.delete(work.rest, signed) >= 0.0))
    hold = work.hold
    yield "hold", bool(np.all(np.delete(hold, at.SIDE) >= 0.0) and hold[at.SIDE] in (-1.0, 0.0, 1.0))
    yield "hold", all(hold[flag] in (0.0, 1.0) for flag in (at.HOLDING, at.HAS_FORMER))
    yield "trial", bool(np.all(work.trial >= 0.0))
    yield "kept", all(_sound_model(row, work) for row in work.kept if row.any())
    # Rows are there from the first sample that an alarm could be raised at.
    in_use = {OLDER: hold[at.CALM], NEWER: hold[at.CALM], HELD: hold[at.HOLDING], FORMER: hold[at.HAS_FORMER]}
    needed = work.kept_root if work.root.size else np.ones((2, 1, 1))
    yield "kept_root", all(needed[row].any() for row in (HELD, FORMER) if in_use[row])
    yield "kept", all(work.kept[row].any() for row, used in in_use.items() if used)


def _sound_powers(moments: Floats) -> bool:
    powers = [at.ERROR_POWER, at.TOLERANCE, at.MISFIT_POWER, at.ABSORBED]
    return bool(np.all(moments[powers] >= 0.0) and np.all(moments[powers[:2]] > 0.0))


def _sound_model(row: Floats, work: Workspace) -> bool:
    model = Kept.of(row, work)
    return bool(
        np.all(np.abs(model.theta) <= LARGEST_PARAMETER)
        and np.all(np.abs(model.owed) <= 2.0 * LARGEST_PARAMETER)
        and np.all(model.errors[:, [COUNT, POWER]] >= 0.0)
        and _sound_powers(model.moments)
    )


def _check_root(root: Floats, prior_root: Floats) -> None:
    """Raise ConfigError where P = S S' is no covariance that data can leave of the prior's.

    S S' is positive semidefinite whatever S is; a variance that is zero or above the prior's is not what it can become.
    """
    after, before = (np.sqrt(np.sum(np.square(part), axis=1)) for part in (root, prior_root))
    if not np.all((after > 0.0) & (after <= LARGEST_RISE * before)):
        raise ConfigError("state array root is no covariance: a variance in it is zero, or far above the prior's")
