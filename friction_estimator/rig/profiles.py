"""Motion profiles of the drive: one cycle as a function of phase, from the lower dead centre and back to it.

Every profile starts and ends a cycle at position -r at rest, so that segments of different period, pressure or
profile follow each other with continuous position and velocity.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.registry import Registry
from friction_estimator.core.sample import Floats, Ints

MULTISINE_HARMONICS = (1, 2, 3, 5, 7)
TRIANGLE_TURN = 0.04
"""Share of the cycle that each turn of the triangle takes: its acceleration is finite."""
SPEED_LEVELS = (0.25, 1.0, 0.1, 0.5, 0.05, 0.75)
SPEED_RAMP = 0.01
"""Share of the cycle that each change of speed takes."""
DWELL_STROKE = 0.25
"""Share of the cycle that each stroke of `dwell` takes; the rest is standstill."""
DWELL_SPLIT = (0.5, 0.2, 0.8, 0.35, 0.65, 0.05, 0.95)
"""How the standstill of successive cycles is split between the two ends."""


class Motion(NamedTuple):
    """Position (n,) and its first and second derivative with respect to the cycle's phase in cycles."""

    position: Floats
    rate: Floats
    curvature: Floats


@dataclass(frozen=True)
class Geometry:
    """The drive.

    Attributes
    ----------
    eccentric_m : r, half the stroke, m.
    rod_m : length of the connecting rod of the crank, m.
    """

    eccentric_m: float = 0.020
    rod_m: float = 0.100

    def __post_init__(self) -> None:
        if not 1e-5 <= self.eccentric_m <= 10.0:
            raise ConfigError(f"the eccentric is {self.eccentric_m:g} m: give 1e-5 to 10 m")
        if not self.rod_m >= 1.05 * self.eccentric_m:
            raise ConfigError(
                f"the rod of {self.rod_m:g} m is too short for an eccentric of {self.eccentric_m:g} m: the crank "
                f"cannot turn over; give at least {1.05 * self.eccentric_m:g} m"
            )


Profile = Callable[[Floats, Ints, Geometry], Motion]
"""(phase in [0, 1), number of the cycle, geometry) -> motion, elementwise."""

PROFILES: Registry[Profile] = Registry("profile")

_TURN = 2.0 * np.pi


@PROFILES.named("sine")
def sine(phase: Floats, cycle: Ints, geometry: Geometry) -> Motion:  # noqa: ARG001
    """x = -r cos(theta): an eccentric with a long rod, or a Scotch yoke."""
    r, theta = geometry.eccentric_m, _TURN * phase
    return Motion(-r * np.cos(theta), _TURN * r * np.sin(theta), _TURN**2 * r * np.cos(theta))


@PROFILES.named("crank")
def crank(phase: Floats, cycle: Ints, geometry: Geometry) -> Motion:  # noqa: ARG001
    """Slider-crank: x = -r cos(theta) + sqrt(l^2 - r^2 sin^2(theta)) - l."""
    r, rod, theta = geometry.eccentric_m, geometry.rod_m, _TURN * phase
    sin, cos = np.sin(theta), np.cos(theta)
    root = np.sqrt(rod**2 - (r * sin) ** 2)
    position = -r * cos - (r * sin) ** 2 / (root + rod)  # root - rod without cancellation
    rate = r * sin - r**2 * sin * cos / root
    curvature = r * cos - r**2 * ((cos**2 - sin**2) / root + (r * sin * cos) ** 2 / root**3)
    return Motion(position, _TURN * rate, _TURN**2 * curvature)


@PROFILES.named("triangle")
def triangle(phase: Floats, cycle: Ints, geometry: Geometry) -> Motion:  # noqa: ARG001
    """Constant speed out and back, with turns of constant deceleration."""
    half = 0.5 * TRIANGLE_TURN
    knots = np.array([0.0, half, 0.5 - half, 0.5, 0.5 + half, 1.0 - half, 1.0])
    return _piecewise(phase, knots, np.array([0.0, 1.0, 1.0, 0.0, -1.0, -1.0, 0.0]), geometry)


@PROFILES.named("multisine")
def multisine(phase: Floats, cycle: Ints, geometry: Geometry) -> Motion:  # noqa: ARG001
    """Harmonics 1, 2, 3, 5, 7 of equal speed with Schroeder phases, shifted to start at the lowest position.

    Source of the phases: M. R. Schroeder, IEEE Trans. Inf. Theory 16 (1970) 85 (flat spectrum: -pi k (k-1)/K).
    """
    start, offset, scale = _MULTISINE
    x, rate, curvature = _harmonics(_TURN * phase + start)
    r = geometry.eccentric_m * scale
    return Motion(r * (x - offset), _TURN * r * rate, _TURN**2 * r * curvature)


@PROFILES.named("dwell")
def dwell(phase: Floats, cycle: Ints, geometry: Geometry) -> Motion:
    """Cosine strokes with standstill at both ends, of a length that differs from cycle to cycle."""
    rest = 1.0 - 2.0 * DWELL_STROKE
    far = DWELL_STROKE + rest * np.array(DWELL_SPLIT)[cycle % len(DWELL_SPLIT)]
    out, back = phase / DWELL_STROKE, (phase - far) / DWELL_STROKE
    moving_back = phase >= far
    stroke = np.clip(np.where(moving_back, back, out), 0.0, 1.0)
    sign = np.where(moving_back, -1.0, 1.0)
    moving = (stroke > 0.0) & (stroke < 1.0)
    r, omega = geometry.eccentric_m, np.pi / DWELL_STROKE
    angle = np.pi * stroke
    return Motion(
        -sign * r * np.cos(angle),
        np.where(moving, sign * r * omega * np.sin(angle), 0.0),
        np.where(moving, sign * r * omega**2 * np.cos(angle), 0.0),
    )


@PROFILES.named("speed_steps")
def speed_steps(phase: Floats, cycle: Ints, geometry: Geometry) -> Motion:  # noqa: ARG001
    """Out and back, each stroke at a series of speeds without reversal between them."""
    length = 0.5 / len(SPEED_LEVELS)
    half = 0.5 * SPEED_RAMP
    knots, speeds = [0.0], [0.0]
    for side in (1.0, -1.0):
        start = 0.0 if side > 0.0 else 0.5
        for i, level in enumerate(SPEED_LEVELS):
            knots += [start + i * length + half, start + (i + 1) * length - half]
            speeds += [side * level, side * level]
        knots.append(start + 0.5)
        speeds.append(0.0)
    return _piecewise(phase, np.array(knots), np.array(speeds), geometry)


def _piecewise(phase: Floats, knots: Floats, speeds: Floats, geometry: Geometry) -> Motion:
    """Motion of a speed that is linear between knots, scaled to the stroke 2 r."""
    travelled = np.concatenate([[0.0], np.cumsum(0.5 * (speeds[1:] + speeds[:-1]) * np.diff(knots))])
    scale = 2.0 * geometry.eccentric_m / travelled.max()
    piece = np.clip(np.searchsorted(knots, phase, side="right") - 1, 0, knots.size - 2)
    since = phase - knots[piece]
    slope = (np.diff(speeds) / np.diff(knots))[piece]
    rate = speeds[piece] + slope * since
    position = travelled[piece] + (speeds[piece] + 0.5 * slope * since) * since
    return Motion(scale * position - geometry.eccentric_m, scale * rate, scale * slope)


def _harmonics(theta: Floats) -> Motion:
    k = np.array(MULTISINE_HARMONICS, np.float64)[:, None]
    n = np.arange(k.size, dtype=np.float64)[:, None]
    angle = k * theta - np.pi * n * (n - 1.0) / k.size
    return Motion(np.sum(np.cos(angle) / k, axis=0), -np.sum(np.sin(angle), axis=0), -np.sum(k * np.cos(angle), axis=0))


def _multisine_start() -> tuple[float, float, float]:
    """Phase of the lowest position, centre, and scale to unit half stroke."""
    theta = np.linspace(0.0, _TURN, 4096, endpoint=False)
    ends = []
    for place in (_harmonics(theta).position.argmin(), _harmonics(theta).position.argmax()):
        turn = theta[place : place + 1]
        for _ in range(6):  # Newton on the rate
            motion = _harmonics(turn)
            turn = turn - motion.rate / motion.curvature
        ends.append((float(turn[0]), float(_harmonics(turn).position[0])))
    (start, low), (_, high) = ends
    return start, 0.5 * (low + high), 2.0 / (high - low)


_MULTISINE = _multisine_start()
