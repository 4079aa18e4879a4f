"""Which experiment would tell two effects apart: drives are simulated before anyone records them.

Each candidate drive goes on from the drive of the record (its period, stroke, pressures) and changes one thing. The
fitted base model is its friction, the record's residual its noise; on it the share R^2 of `rivals` says how well the
rival would do what the named effect does there.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from friction_estimator.core.errors import ConfigError, UnanswerableError
from friction_estimator.core.sample import NS_PER_S, Floats, Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.base import BaseFit, reference_of
from friction_estimator.diagnosis.base_problem import BaseProblem
from friction_estimator.diagnosis.evidence import Evidence
from friction_estimator.diagnosis.joint import Joint
from friction_estimator.diagnosis.library import built, with_running_force
from friction_estimator.diagnosis.own_columns import Term
from friction_estimator.diagnosis.record import Record, build_record
from friction_estimator.diagnosis.rivals import alike
from friction_estimator.effects.base import SLOW, Effect
from friction_estimator.effects.features import Context, Features
from friction_estimator.effects.reference import Reference
from friction_estimator.rig.drive import Segment, run_drive
from friction_estimator.rig.profiles import Geometry

SEPARATES = 0.8
"""Largest R^2 on a drive that separates two effects: a fifth of the effect's power tells them apart."""

LONGER, SHORTER = 3.0, 0.5
"""Factors of the second period and of the other stroke."""

CYCLES = 3
"""Of each setting of a candidate drive."""

SAMPLES, FINEST = 2500.0, 60.0
"""Samples of a candidate drive, where its shortest period then has this many at least."""

ROD = 5.0
"""Length of the connecting rod over the eccentric; no candidate is a crank."""

SAME_PRESSURE = 0.03
"""Share of the mean pressure by which pressures that count as one differ."""


@dataclass(frozen=True)
class Drive:
    """A drive that may be recorded next.

    Attributes
    ----------
    words : what to do. hints : words of an effect's own sentence that mean this drive.
    runs : recordings that it consists of: segments, and the stroke over that of the record.
    """

    words: str
    hints: tuple[str, ...]
    runs: tuple[tuple[tuple[Segment, ...], float], ...]


@dataclass(frozen=True)
class Outcome:
    """What a drive tells about two effects: R^2, and the error power a sample that a wrong name would leave, N^2."""

    drive: Drive
    share: float
    lost_N2: float


def drives(record: Record, context: Context) -> tuple[Drive, ...]:
    """Return the candidate drives.

    Raises
    ------
    ConfigError : the drive of the record cannot be simulated.
    """
    usual = (2.0 * context.duration_s / max(record.reversals, 1),)
    periods = (context.periods_s or usual)[:2]
    pressure = record.features.pressure_Pa
    low, high = (float(p) for p in np.quantile(pressure, [0.05, 0.95]))
    levels = (low,) if high - low <= SAME_PRESSURE * max(abs(high), 1.0) else (low, high)
    now = tuple(Segment(t, p, CYCLES) for p in levels for t in periods)
    one, first = periods[0], levels[0]
    other = levels[-1] if len(levels) > 1 else 2.0 * max(abs(first), 1e5)

    def changed(profile: str) -> tuple[tuple[tuple[Segment, ...], float], ...]:
        return (((*now, Segment(one, first, 2 * CYCLES, profile)), 1.0),)

    mixed = tuple(Segment(t, p, CYCLES) for p in (first, other, other, first) for t in (one, LONGER * one))
    return (
        Drive(
            f"a second period, {LONGER:g} times as long",
            ("period", "slower", "another speed", "another acceleration", "the speed", "drive's speed", "high speed"),
            (((*now, Segment(LONGER * one, first, CYCLES)), 1.0),),
        ),
        Drive("a second stroke, half as long", ("stroke",), ((now, 1.0), (now, SHORTER))),
        Drive(
            "pauses of changing length at both ends of the stroke",
            ("hold", "dwell", "rest "),
            changed("dwell"),
        ),
        Drive("speed steps without reversal", ("speed steps", "sharp step"), changed("speed_steps")),
        Drive("strokes of constant speed with sharp turns", ("sharp step",), changed("triangle")),
        Drive("two periods and two pressures in mixed order", ("pressures", "first pressure"), ((mixed, 1.0),)),
    )


class Trials:
    """The candidate drives of a diagnosis, simulated once they are asked for.

    Parameters
    ----------
    model : the last model. record, config, context : of the diagnosis. seed : of the noise.
    """

    def __init__(self, model: Joint, record: Record, config: Config, context: Context, seed: int) -> None:
        self._model, self._record, self._config, self._context, self._seed = model, record, config, context, seed

    def separation(self, term: Term, rival: type[Effect], params: dict[str, float] | None = None) -> list[Outcome]:
        """Return how well each drive tells a fitted effect from another one, the clearest first.

        Empty where no drive can say it: what depends on the time or the distance run happens once.

        Parameters
        ----------
        term : the named effect, fitted. rival : the other one. params : its best point on the record.
        """
        if SLOW in (term.effect.acts, rival.acts):
            return []
        out = []
        for made in self._made:
            part = term.columns(made.features, made.reference) @ term.weights
            points = [*rival.grid(made.context), *rival.peaks(part, made.features, made.context)]
            points += [params] if params is not None else []
            if not points:
                continue
            library = built({rival: points}, made.features, made.reference, made.evidence)
            found = alike(made.evidence, library, part)
            if found:
                one = found[rival.name]
                out.append(Outcome(made.drive, one.share, one.lost_N2 / made.features.size))
        return sorted(out, key=lambda o: -o.lost_N2)

    @cached_property
    def _made(self) -> "list[_Made]":
        """The drives with what regressors see of them; none where the record's drive cannot be simulated."""
        try:
            return list(self._simulated(drives(self._record, self._context)))
        except (ConfigError, UnanswerableError):
            return []

    def _simulated(self, candidates: Sequence[Drive]) -> Iterator["_Made"]:
        model, config = self._model, self._config
        noise_N = float(np.sqrt(np.mean(np.square(model.residual_N[self._record.used]))))
        warm = float(self._record.features.temperature_degC.mean())
        for number, drive in enumerate(candidates):
            rng = np.random.default_rng([self._seed, number])
            samples = [
                _recorded(segments, share, self._context, model.reference, config, warm, noise_N, rng)
                for segments, share in drive.runs
            ]
            record = build_record(samples, config)
            problem = BaseProblem(record, config, model.base.problem.capacity)
            fit = BaseFit.of(problem, problem.fit())
            context = record.context(config, float(np.abs(fit.fitted_N).max()))
            reference = reference_of(fit, context.sign_velocity_m_s)
            features = with_running_force(record.features, reference)
            evidence = Evidence(fit.tangent, fit.penalty, fit.residual_N, record.used, record.block, self._seed)
            yield _Made(drive, features, reference, context, evidence)


@dataclass(frozen=True)
class _Made:
    drive: Drive
    features: Features
    reference: Reference
    context: Context
    evidence: Evidence


def _recorded(
    segments: tuple[Segment, ...],
    share: float,
    context: Context,
    reference: Reference,
    config: Config,
    warm_degC: float,
    noise_N: float,
    rng: np.random.Generator,
) -> Samples:
    """Return a simulated recording: the base model's friction, and noise."""
    eccentric = 0.5 * share * context.stroke_m
    duration, shortest = sum(s.duration_s for s in segments), min(s.period_s for s in segments)
    rate = min(max(SAMPLES / duration, FINEST / shortest), 1.0 / context.step_s)
    drive = run_drive(segments, Geometry(eccentric, ROD * eccentric), rate)
    n = drive.time_s.size
    noise: Floats = noise_N * rng.standard_normal(n)
    restart = np.zeros(n, np.bool_)
    restart[0] = True
    return Samples(
        stamp_ns=np.round(drive.time_s * NS_PER_S).astype(np.int64),
        velocity_m_s=drive.velocity_m_s,
        friction_N=reference.force(drive.velocity_m_s, drive.pressure_Pa) + noise,
        restart=restart,
        pressure_Pa=drive.pressure_Pa + config.theory.ambient_pressure,
        temperature_degC=np.full(n, warm_degC),
        position_m=drive.position_m + context.centre_m,
    )
