"""The recordings of one diagnosis as one set of arrays: features, measured force, blocks."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from friction_estimator.core.errors import UnanswerableError
from friction_estimator.core.sample import NS_PER_S, Bools, Floats, Ints, Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.effects.extension import sign_velocity
from friction_estimator.effects.features import Context, FeatureMaker, Features

FEWEST_SAMPLES = 400
FEWEST_BLOCKS = 12
USUAL_BLOCKS = 40
SHORTEST_BLOCK = 64
"""Samples; shorter blocks would not be independent of each other."""

REVERSAL_SPEED = 1e-3
"""Share of the top speed that a stroke must reach to count between two reversals."""


@dataclass(frozen=True)
class Record:
    """Everything that is fitted, in order of time.

    Attributes
    ----------
    samples : all recordings in one, their stamps made increasing.
    features : of the samples.
    friction_N : (n,), measured, repaired where a repair was needed.
    used : (n,) bool, False for samples that are masked.
    restart : (n,) bool.
    block : (n,) int, number of the block, increasing.
    recording : (n,) int, number of the recording.
    periods_s : periods of the drive that were found, s; empty where it is not periodic.
    """

    samples: Samples
    features: Features
    friction_N: Floats
    used: Bools
    restart: Bools
    block: Ints
    recording: Ints
    periods_s: tuple[float, ...]
    reversals: int
    cycles: int

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return int(self.block[-1]) + 1

    def with_force(self, friction_N: Floats, used: Bools) -> "Record":
        """Return the record with a repaired force."""
        return replace(self, friction_N=friction_N, used=used)

    def context(self, config: Config, force_top_N: float) -> Context:
        """Return the facts that grids depend on."""
        f = self.features
        inside = f.step_s[f.step_s > 0.0]
        channels = [
            name
            for name, values in (
                ("position", self.samples.position_m),
                ("pressure", self.samples.pressure_Pa),
                ("temperature", self.samples.temperature_degC),
            )
            if values is not None and np.isfinite(values).mean() > 0.5
        ]
        low, high = float(f.position_m.min()), float(f.position_m.max())
        return Context(
            duration_s=float(f.time_s[-1]),
            step_s=float(np.median(inside)),
            distance_m=float(f.distance_m[-1]),
            stroke_m=high - low,
            centre_m=0.5 * (low + high),
            top_speed_m_s=float(np.abs(f.velocity_m_s).max()),
            force_rms_N=float(np.sqrt(np.mean(np.square(self.friction_N[self.used])))),
            force_top_N=force_top_N,
            pressure_mean_Pa=float(f.pressure_Pa.mean()),
            pressure_span_Pa=float(np.ptp(f.pressure_Pa)),
            sign_velocity_m_s=sign_velocity(config, float(np.abs(f.velocity_m_s).max())),
            pressure_levels=int(np.count_nonzero(np.histogram(f.pressure_Pa, 10)[0] > 0.02 * f.size)),
            periods_s=self.periods_s,
            channels=tuple(channels),
        )


def joined(recordings: Sequence[Samples]) -> tuple[Samples, Ints]:
    """Return all recordings as one, and the number of the recording of each sample.

    Recordings that begin before the one before them ended (each with its own time zero) are shifted to begin one
    second after it.
    """
    parts = []
    end: int | None = None
    for part in recordings:
        stamps = part.stamp_ns.astype(np.int64)
        if end is not None and stamps[0] <= end:
            stamps = stamps - stamps[0] + end + NS_PER_S
        end = int(stamps[-1])
        restart = part.restart.copy()
        restart[0] = True
        parts.append(replace(part, stamp_ns=stamps, restart=restart))

    def stacked(name: str) -> Floats | None:
        values = [getattr(p, name) for p in parts]
        if all(v is None for v in values):
            return None
        return np.concatenate([np.full(len(p), np.nan) if v is None else v for p, v in zip(parts, values, strict=True)])

    whole = Samples(
        stamp_ns=np.concatenate([p.stamp_ns for p in parts]),
        velocity_m_s=np.concatenate([p.velocity_m_s for p in parts]),
        friction_N=np.concatenate([p.friction_N for p in parts]),
        restart=np.concatenate([p.restart for p in parts]),
        pressure_Pa=stacked("pressure_Pa"),
        temperature_degC=stacked("temperature_degC"),
        position_m=stacked("position_m"),
    )
    number = np.concatenate([np.full(len(p), i) for i, p in enumerate(parts)])
    return whole, number


def build_record(recordings: Sequence[Samples], config: Config) -> Record:
    """Return the record of a diagnosis.

    Raises
    ------
    UnanswerableError : too few samples, or the shaft does not move.
    """
    recordings = [part for part in recordings if len(part)]
    if sum(len(part) for part in recordings) < FEWEST_SAMPLES:
        raise UnanswerableError(
            f"{sum(len(p) for p in recordings)} usable samples are too few for a diagnosis: record at least "
            f"{FEWEST_SAMPLES}, over {FEWEST_BLOCKS} strokes or more"
        )
    samples, number = joined(recordings)
    if float(np.ptp(samples.velocity_m_s)) <= 0.0:
        raise UnanswerableError("the velocity never changes: a diagnosis needs strokes in both directions")
    theory = config.theory
    maker = FeatureMaker(theory.ambient_pressure, theory.default_pressure, theory.default_temperature)
    features = maker(samples)
    turns = reversals(samples.velocity_m_s, samples.restart)
    n = len(samples)
    count = int(min(USUAL_BLOCKS, max(FEWEST_BLOCKS, turns.size // 2), max(2, n // SHORTEST_BLOCK)))
    edges = np.linspace(0, n, count + 1).astype(np.int64)
    block = np.repeat(np.arange(count), np.diff(edges))
    return Record(
        samples=samples,
        features=features,
        friction_N=samples.friction_N.copy(),
        used=np.ones(n, np.bool_),
        restart=samples.restart,
        block=block,
        recording=number,
        periods_s=periods(features.time_s, turns),
        reversals=int(turns.size),
        cycles=int(turns.size // 2),
    )


def reversals(velocity_m_s: Floats, restart: Bools) -> Ints:
    """Return the samples that begin a stroke: sign changes between strokes that reach a thousandth of the top speed."""
    floor = REVERSAL_SPEED * float(np.abs(velocity_m_s).max())
    moving = np.flatnonzero(np.abs(velocity_m_s) > floor)
    if moving.size < 2:
        return np.zeros(0, np.int64)
    sign = np.sign(velocity_m_s[moving])
    piece = np.cumsum(restart)[moving]
    change = (sign[1:] != sign[:-1]) & (piece[1:] == piece[:-1])
    return np.asarray(moving[1:][change], np.int64)


def periods(time_s: Floats, turns: Ints) -> tuple[float, ...]:
    """Return the drive's periods: lengths of two strokes that at least three cycles share within 2 %, longest first."""
    if turns.size < 4:
        return ()
    spans = time_s[turns[2:]] - time_s[turns[:-2]]
    fewest = max(4, spans.size // 12)
    found: list[float] = []
    left = spans
    while left.size:
        middle = float(np.median(left))
        near = np.abs(left - middle) < 0.02 * middle
        if near.sum() < fewest:
            counts = np.array([np.sum(np.abs(left - s) < 0.02 * s) for s in left[:400]])
            if counts.max() < fewest:
                break
            middle = float(left[int(np.argmax(counts))])
            near = np.abs(left - middle) < 0.02 * middle
        found.append(float(np.median(left[near])))
        left = left[~near]
    return tuple(sorted(found, reverse=True))
