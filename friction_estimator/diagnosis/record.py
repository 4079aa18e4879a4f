"""The recordings of one diagnosis as one set of arrays: features, measured force, blocks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from friction_estimator.core.errors import UnanswerableError
from friction_estimator.core.intake.encoder import Encoder
from friction_estimator.core.intake.kinks import at_kinks
from friction_estimator.core.intake.periods import drive_periods, is_harmonic
from friction_estimator.core.intake.standstill import standstill
from friction_estimator.core.intake.strokes import reversal_speed, reversals
from friction_estimator.core.metrics import spread
from friction_estimator.core.quantities import FORCE
from friction_estimator.core.sample import NS_PER_S, Bools, Floats, Ints, Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.units import MARGIN, robust_top
from friction_estimator.diagnosis.pairs import paired
from friction_estimator.effects.extension import sign_velocity
from friction_estimator.effects.features import Context, FeatureMaker, Features, stroke_ends
from friction_estimator.effects.grids import LONGEST_LENGTH
from friction_estimator.effects.moments import features_at

FEWEST_SAMPLES = 400
FEWEST_BLOCKS = 12
USUAL_BLOCKS = 40
SHORTEST_BLOCK = 64
"""Samples; shorter blocks would not be independent of each other."""

LEAST_RANGE = 0.05
"""Of the largest pressure: a range below which there is one pressure."""

STEEPEST = 0.999
"""Quantile of the acceleration that counts as the largest: what turns the shaft within a gap."""

MOST_FORGOTTEN = 0.5
"""Share of the way from one turn that nobody saw to the next one that is left out at the most."""


@dataclass(frozen=True)
class Record:
    """Everything that is fitted, in order of time.

    Attributes
    ----------
    samples : all recordings in one, their stamps made increasing.
    features : of the samples.
    friction_N : (n,), measured, repaired where a repair was needed.
    used : (n,) bool, False for samples that are masked: at standstill, at kinks of the velocity, after gaps that
        hide a reversal, and by faults of the data.
    restart : (n,) bool.
    block : (n,) int, number of the block, increasing; none reaches over two recordings.
    recording : (n,) int, number of the recording, from 0. Encoders may have another origin in each.
    periods_s : periods of the drive that were found, s, longest first; empty where it is not periodic.
    turns : (m,) int, samples that begin a stroke after a reversal.
    standstill : (n,) bool, where the shaft stands: its force is below breakaway and no sample of F(v).
    reversal_speed_m_s : speed that strokes about a reversal reach.
    """

    samples: Samples
    features: Features
    friction_N: Floats
    used: Bools
    restart: Bools
    block: Ints
    recording: Ints
    periods_s: tuple[float, ...]
    turns: Ints
    standstill: Bools
    reversal_speed_m_s: float

    @property
    def reversals(self) -> int:
        """Number of reversals."""
        return int(self.turns.size)

    @property
    def cycles(self) -> int:
        """Number of cycles of two strokes."""
        return int(self.turns.size // 2)

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return int(self.block[-1]) + 1

    @cached_property
    def pairs(self) -> tuple[Ints, Ints]:
        """Pairs of samples that a deterministic system would make equal, (m,), (m,): see `paired`."""
        return paired(self)

    def with_force(self, friction_N: Floats, used: Bools) -> "Record":
        """Return the record with a repaired force."""
        return replace(self, friction_N=friction_N, used=used)

    def with_channels(self, config: Config, **channels: Floats) -> "Record":
        """Return the record with repaired channels of its samples: features, strokes, standstill anew; masks stay."""
        samples = replace(self.samples, **channels)  # type: ignore[arg-type]
        new = described(samples, self.recording, config)
        return replace(new, block=self.block).with_force(self.friction_N, new.used & (self.used | self.standstill))

    def features_at(self, config: Config, seen: Callable[[str, Floats], Floats]) -> Features:
        """Return the features of other motion and pressure; `seen` makes of a channel (n,), by name, what it was."""
        return features_at(feature_maker(config, self.reversal_speed_m_s), self.samples, self.features, seen)

    def is_harmonic(self, frequency_hz: float) -> bool:
        """Return whether a line may be the trajectory's own (`core.intake.periods`)."""
        return is_harmonic(frequency_hz, self.periods_s, float(self.features.active_time_s[-1]))

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
        low, high = stroke_ends(f.position_m, self.recording)
        count = int(self.recording[-1]) + 1
        forward, backward = (
            np.bincount(self.recording[self.used & (way * f.direction > 0.0)], minlength=count).tolist()
            for way in (1.0, -1.0)
        )
        speed = np.abs(f.velocity_m_s)
        moving = speed[self.used & (speed > 0.0)]
        return Context(
            motion=config.quantities.motion,
            duration_s=float(f.time_s[-1]),
            step_s=float(np.median(inside)),
            distance_m=float(f.distance_m[-1]),
            stroke_m=high - low,
            centre_m=0.5 * (low + high),
            top_speed_m_s=float(speed.max()),
            force_rms_N=float(np.sqrt(np.mean(np.square(self.friction_N[self.used])))),
            force_top_N=force_top_N,
            pressure_mean_Pa=float(f.pressure_Pa.mean()),
            pressure_span_Pa=float(np.ptp(f.pressure_Pa)),
            sign_velocity_m_s=sign_velocity(config, float(speed.max())),
            pressure_levels=int(np.count_nonzero(np.histogram(f.pressure_Pa, 10)[0] > 0.02 * f.size)),
            periods_s=self.periods_s,
            channels=tuple(channels),
            longest_piece_s=float(np.bincount(f.piece, weights=f.step_s).max()),
            held=tuple(zip(forward, backward, strict=True)),
            # At one pressure any curve of the speed may be the theory's part or the learned one's.
            theory_told=config.theory_kind == "seal" and spans_pressures(f.pressure_Pa, self.block),
            slow_share=float(np.quantile(moving, 0.01) / speed.max()) if moving.size else 0.0,
        )


def pressure_range(pressure_Pa: Floats) -> tuple[float, float]:
    """Return the lowest and the highest pressure, Pa, but for a few samples: one spike is no pressure."""
    low, high = np.quantile(pressure_Pa, [0.005, 0.995])
    return float(low), float(high)


def spans_pressures(pressure_Pa: Floats, block: Ints) -> bool:
    """Return whether there is more than one pressure in blocks of samples (n,); noise of the channel is none."""
    samples = np.bincount(block)
    low, high = pressure_range(np.bincount(block, weights=pressure_Pa)[samples > 0] / samples[samples > 0])
    return high - low >= LEAST_RANGE * max(abs(low), abs(high), 1.0)


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
        position_shift_m=stacked("position_shift_m"),
    )
    number = np.concatenate([np.full(len(p), i) for i, p in enumerate(parts)])
    return whole, number


def build_record(recordings: Sequence[Samples], config: Config) -> Record:
    """Return the record of a diagnosis.

    Raises
    ------
    UnanswerableError : too few samples, or the shaft does not move.
    """
    recordings = [_unwrapped(part) for part in recordings if len(part)]
    if sum(len(part) for part in recordings) < FEWEST_SAMPLES:
        raise UnanswerableError(
            f"{sum(len(p) for p in recordings)} usable samples are too few for a diagnosis: record at least "
            f"{FEWEST_SAMPLES}, over {FEWEST_BLOCKS} strokes or more"
        )
    samples, number = joined(recordings)
    if float(np.ptp(samples.velocity_m_s)) <= 0.0:
        raise UnanswerableError("the velocity never changes: a diagnosis needs strokes in both directions")
    if not spread(samples.friction_N) > 0.0:
        raise UnanswerableError(
            f"friction is constant at {config.quantities.text(samples.friction_N[0], FORCE)} in all {len(samples)} "
            "samples: there is nothing to explain; is it the right topic, axis or joint?"
        )
    record = described(samples, number, config)
    # Asked of the velocity as it was recorded: one that is smoothed later has kinks where the windows change.
    return record.with_force(record.friction_N, record.used & ~at_kinks(samples.velocity_m_s, samples.restart))


def described(samples: Samples, recording: Ints, config: Config) -> Record:
    """Return the record of samples that are one, all of them in use but those at standstill.

    Parameters
    ----------
    samples : of all recordings, stamps increasing (`joined`). recording : (n,), number of the recording.
    """
    velocity, restart = samples.velocity_m_s, samples.restart
    level = reversal_speed(samples)
    features = replace(feature_maker(config, level)(samples), recording=recording)
    turns = reversals(velocity, restart, level)
    stands = standstill(samples, config.velocity_scale or MARGIN * robust_top([np.abs(velocity)]))
    # Which way the shaft came before it first moves nobody knows: one such sample can weigh more than all the noise.
    stands |= features.direction == 0.0
    n = len(samples)
    count = int(min(USUAL_BLOCKS, max(FEWEST_BLOCKS, turns.size // 2), max(2, n // SHORTEST_BLOCK)))
    return Record(
        samples=samples,
        features=features,
        friction_N=samples.friction_N.copy(),
        used=~(stands | _forgotten(features)),
        restart=restart,
        block=blocks(recording, count),
        recording=recording,
        periods_s=drive_periods(features.time_s, velocity, restart) or stroke_periods(features.time_s, turns),
        turns=turns,
        standstill=stands,
        reversal_speed_m_s=level,
    )


def _forgotten(features: Features) -> Bools:
    """Return which samples follow a turn that nobody saw, (n,), until the shaft has run a length of memory.

    It may have turned before a recording begins, and in a gap, unless no acceleration of the record turns it there.
    Where bristles or a gap stand after it nobody knows; a few such samples can weigh more than all the noise. Where it
    runs a few of those lengths only until the next one, a share of that way is left out: the rest is all that there is.
    """
    v, first = features.velocity_m_s, np.flatnonzero(features.step_s == 0.0)
    begins = first[np.diff(features.recording[first], prepend=-1) != 0]
    after = first[1:]
    top = float(np.quantile(np.abs(features.acceleration_m_s2), STEEPEST))
    gone = features.time_s[after] - features.time_s[after - 1]
    turned = (np.abs(v[after]) + np.abs(v[after - 1]) < top * gone) | (v[after] * v[after - 1] < 0.0)
    hidden = np.union1d(begins, after[turned])
    at = features.distance_m[hidden]
    run = np.diff(at, append=features.distance_m[-1])
    low, high = stroke_ends(features.position_m, features.recording)
    length = np.minimum(LONGEST_LENGTH * (high - low), MOST_FORGOTTEN * run)
    last = np.searchsorted(hidden, np.arange(v.size), side="right") - 1
    return np.asarray(features.distance_m - at[last] < length[last])


def feature_maker(config: Config, reversal_speed_m_s: float) -> FeatureMaker:
    """Return the maker of features for a configuration."""
    theory = config.theory
    return FeatureMaker(
        theory.ambient_pressure, theory.default_pressure, theory.default_temperature, reversal_speed_m_s
    )


def _unwrapped(samples: Samples) -> Samples:
    """Return samples with the position unwrapped, where the intake has not done it."""
    if samples.position_m is None or samples.position_shift_m is not None:
        return samples
    position, encoder = samples.position_m.copy(), Encoder()
    shift = encoder.push(samples.stamp_ns, samples.velocity_m_s, samples.restart, position)
    return replace(samples, position_m=position, position_shift_m=shift) if encoder.wraps.count else samples


def blocks(recording: Ints, count: int) -> Ints:
    """Return the number of the block of each sample, (n,): `count` of about equal length, none over two recordings.

    A recording has two at the least: what is its own (the phase of a ripple) is fitted on one and judged on the other.

    >>> blocks(np.array([0, 0, 0, 0, 0, 0, 1, 1]), 4).tolist()
    [0, 0, 1, 1, 2, 2, 3, 3]
    """
    sizes = np.bincount(recording)
    number: list[Ints] = []
    first = 0
    for size in sizes[sizes > 0]:
        own = max(2 if size >= 2 * SHORTEST_BLOCK else 1, round(count * float(size) / recording.size))
        edges = np.linspace(0, size, own + 1).astype(np.int64)
        number.append(np.repeat(np.arange(first, first + own), np.diff(edges)))
        first += own
    return np.concatenate(number)


def stroke_periods(time_s: Floats, turns: Ints) -> tuple[float, ...]:
    """Return lengths of two strokes that at least three cycles share within 2 %, longest first.

    For drives that keep a rhythm and do not repeat within it, such as strokes with pauses of changing length.
    """
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
