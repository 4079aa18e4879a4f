"""The estimator over recordings, what it says of others without learning, and the figures that `replay` reports."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Any

import numpy as np

from friction_estimator.core import metrics, sums
from friction_estimator.core.errors import UnanswerableError
from friction_estimator.core.fit.band import POINTS, Curve
from friction_estimator.core.fit.baselines import StaticCurve
from friction_estimator.core.fit.batch import BatchFit, predict
from friction_estimator.core.fit.frozen_score import FrozenScore, curves_learned, frozen_score
from friction_estimator.core.fit.load_report import LearnedLoad
from friction_estimator.core.model.structure import Extension, Model, Parameters
from friction_estimator.core.online.estimator import Estimator, Health
from friction_estimator.core.online.first_contact import Contact
from friction_estimator.core.online.record_figures import RecordFigures
from friction_estimator.core.online.run import Run
from friction_estimator.core.online.shortcomings import InMotion, Judgement, Shortcoming, in_motion, shortcomings
from friction_estimator.core.quantities import FORCE, Quantities
from friction_estimator.core.sample import NS_PER_S, Bools, Floats, Samples, joined
from friction_estimator.core.series import RunningTime, Series, difference
from friction_estimator.core.settings.config import Config
from friction_estimator.core.settings.setting import Value

OUTLOOK = 1.25
"""The curve is also given over this many times the velocities learned, to show what it says where it has not been."""

DIVERGED = 2.0
"""An error rms over the last fifth above this many standard deviations of the whole record is divergence."""


@dataclass(frozen=True)
class Judged:
    """Another recording, predicted with what was learned and without learning.

    Attributes
    ----------
    name : the recording.
    samples : its admitted samples.
    predicted_N : (n,), N.
    score : over all samples but those that follow a restart (the first sample is one) within the model's memory.
    in_motion : over those of them at which the shaft does not stand.
    """

    name: str
    samples: Samples
    predicted_N: Floats
    score: FrozenScore
    in_motion: InMotion


@dataclass(frozen=True)
class Replay:
    """Recordings with what the estimator made of them.

    Attributes
    ----------
    config : the configuration that was run, range and units as the first contact chose them.
    record : the samples of all recordings that were predicted, and what does not depend on the prediction.
    predicted_N : (n,), friction predicted before each measurement was used.
    snapshot_index : (k,) and snapshots : the parameters after the sample of that index.
    health : the estimator's own counters.
    seconds : wall-clock time of prediction and learning, without that of a first compilation.
    curve : the static curve learned, with its 95 % band, over the velocities learned.
    outlook : the same curve over `OUTLOOK` times those velocities, and all others that occurred.
    others : recordings that were predicted with what was learned.
    contact : how range and units were met; None where the whole record chose them.
    loads : what was learned of the unknown load terms.
    deviation_N : (n,), standard deviation of each prediction, N; None where it was not asked for, and for a fit, which
        predicts nothing beforehand.
    """

    config: Config
    record: RecordFigures
    predicted_N: Floats
    snapshot_index: list[int]
    snapshots: list[Parameters]
    health: Health
    seconds: float
    estimator: Estimator
    curve: Curve
    outlook: Curve
    others: tuple[Judged, ...] = ()
    contact: Contact | None = None
    loads: Sequence[LearnedLoad] = ()
    deviation_N: Floats | None = None

    @property
    def samples(self) -> Samples:
        """The samples that were predicted, n."""
        return self.record.samples

    @property
    def learned(self) -> Bools:
        """Where the estimator was allowed to learn, (n,)."""
        return self.record.learned

    @property
    def starts(self) -> tuple[int, ...]:
        """Index of the first sample of each recording."""
        return self.record.starts

    @property
    def parts(self) -> list[slice]:
        """The samples of each recording."""
        return self.record.parts

    @property
    def theory_in(self) -> metrics.Prediction | None:
        """Gives the theoretical curve at the samples of a part, N; None for Hammerstein."""
        return self.record.theory_in

    @property
    def one_way(self) -> int:
        """The only direction that was learned from, 1 or -1; 0 where both were, or nothing."""
        return self.record.one_way

    @property
    def parameters(self) -> Parameters:
        """The values learned at the end."""
        return self.estimator.parameters

    @property
    def residual_N(self) -> Series:
        """Measured minus predicted, (n,), N."""
        return difference(self.samples.friction_N, self.predicted_N)

    @cached_property
    def time_s(self) -> Series:
        """Running time, (n,), s: each recording follows the one before after a usual step; no clock jump counts."""
        rate = self.record.sample_rate_hz
        return RunningTime(self.samples.stamp_ns, self.starts, round(NS_PER_S / rate) if np.isfinite(rate) else 0)

    @cached_property
    def baseline_curves(self) -> dict[str, StaticCurve]:
        """The textbook's curves fitted to what was learned from; empty where that does not do for a curve."""
        return curves_learned(self.samples.velocity_m_s, self.samples.friction_N, self.learned)

    @cached_property
    def frozen_score(self) -> FrozenScore | None:
        """The model and its rivals over the samples not learned from; None where there are none.

        Samples that follow a restart within the model's memory are left out: they are predicted, but from delay lines
        that nothing measured has filled yet.
        """
        if self.learned.all():
            return None
        return frozen_score(self.samples, self.predicted_N, self.theory_in, self.record.scored, self.baseline_curves)

    @cached_property
    def _judgement(self) -> Judgement:
        """What was predicted without learning; all of it where everything was learned."""
        model = self.estimator.model
        nothing = np.broadcast_to(0.0, (len(self.samples),))
        given = model.load.known_N(self.samples) if model.load.known else nothing
        learned = model.load.force_N(self.samples, self.parameters.load_weights) if model.load.size else nothing
        return Judgement(
            figures=self.record,
            predicted_N=self.predicted_N,
            has_loads=frozenset(part.name for part in (*model.load.known, *model.load.unknown)),
            given_N=given,
            load_N=given + learned if given is not nothing or learned is not nothing else nothing,
        )

    @cached_property
    def in_motion(self) -> InMotion:
        """The score of what was predicted without learning (or of all) over the samples in motion."""
        return in_motion(self._judgement)

    @cached_property
    def shortcomings(self) -> tuple[Shortcoming, ...]:
        """What in the record the model cannot follow, and what helps."""
        return shortcomings(self._judgement)

    def predict(self, samples: Samples, extension: Extension | None = None) -> Floats:
        """Predict another recording with the values learned, frozen, (n,) N; see `judge`."""
        parameters = self.parameters
        if extension is not None:
            weights = np.where(extension.phases, 0.0, parameters.extension_weights)
            parameters = replace(parameters, extension_weights=weights)
        return predict(samples, self.estimator.config, parameters, extension)

    def judge(self, name: str, samples: Samples, extension: Extension | None = None) -> Judged:
        """Predict another recording with the values learned, frozen; delay lines start afresh, nothing changes here.

        Waves in time are left out: which phase they have there, nobody knows.

        Parameters
        ----------
        samples : its admitted samples.
        extension : of the same terms as in the replay, an instance of its own.

        Raises
        ------
        UnanswerableError : fewer than two samples outlast the model's memory, or their friction is constant.
        """
        config = self.estimator.config
        scored = metrics.settled(samples.restart, config.fir.order)
        count = int(np.count_nonzero(scored))
        if count < 2:
            raise UnanswerableError(
                f"{name}: {count} usable samples follow the model's memory of {config.fir.order} samples: too few to "
                "judge by"
            )
        if not metrics.spread(samples.friction_N[scored]) > 0.0:
            raise UnanswerableError(
                f"{name}: friction is constant at {self.config.quantities.text(samples.friction_N[scored][0], FORCE)} "
                f"in all {count} samples: there is nothing to judge by; is it the right topic, axis or joint?"
            )
        predicted = self.predict(samples, extension)
        theory = None if self.theory_in is None else self.estimator.model.theory_over(samples)
        score = frozen_score(samples, predicted, theory, scored, self.baseline_curves)
        return Judged(name, samples, predicted, score, self._in_motion_of(samples, predicted))

    def _in_motion_of(self, samples: Samples, predicted_N: Floats) -> InMotion:
        """Return the score of another recording over its samples in motion, beside curves fitted to what moved here."""
        nothing = np.broadcast_to(np.bool_(False), (len(samples),))
        there = RecordFigures(samples, nothing, self.record.top_speed_m_s, self.record.memory)
        velocity, moves, spread = samples.velocity_m_s, there.in_motion, there.spread_in_motion_N
        curves = self.record.curves_in_motion if np.count_nonzero(moves) > 1 else {}
        return InMotion(
            samples=int(np.count_nonzero(moves)),
            standing_share=there.standing_share,
            nrmse=metrics.nrmse(samples.friction_N, predicted_N, moves, spread),
            baselines={
                name: metrics.nrmse(samples.friction_N, curve.over(velocity), moves, spread)
                for name, curve in curves.items()
            },
        )

    def figures(self) -> dict[str, Any]:
        """Return the figures of merit of `replay --json`, under its names."""
        measured, predicted = self.samples.friction_N, self.predicted_N
        count = max(2, len(self.samples) // 5)
        late, guessed = measured[-count:], predicted[-count:]
        final = metrics.nrmse(late, guessed)
        end_rms = float(np.sqrt(sums.mean_square(lambda part: late[part] - guessed[part], late.size)))
        frozen = self.frozen_score
        record, scale = self.record, self.record.spread_N
        finite = all(np.isfinite(predicted[part]).all() for part in sums.parts(predicted.size))
        return {
            "sample_rate_hz": record.sample_rate_hz,
            "duration_s": record.duration_s,
            "nrmse": metrics.nrmse(measured, predicted, scale=scale),
            "nrmse_persistence": record.persistence,
            "nrmse_final": final,
            "nrmse_by_cycle": metrics.by_cycle(measured, predicted, record.cycles, scale),
            "nrmse_frozen": None if frozen is None else frozen.nrmse,
            "fit_percent": 100.0 * (1.0 - final),
            "theory_nrmse": record.theory_nrmse,
            "diverged": bool(not finite or end_rms > DIVERGED * scale),
            "samples_per_second": len(self.samples) / self.seconds if self.seconds > 0.0 else None,
            "units": self.config.quantities.names,
            "baselines": None if frozen is None else frozen.baselines,
            "in_motion": self.in_motion,
            "shortcomings": self.shortcomings,
            "curve": self.curve,
            "load": list(self.loads),
            "test": [
                {
                    "bag": other.name,
                    "samples": len(other.samples),
                    "nrmse": other.score.nrmse,
                    "baselines": other.score.baselines,
                    "in_motion": other.in_motion,
                }
                for other in self.others
            ],
            "parameters": parameters_of(self.estimator.model, self.parameters),
        }


def replay(
    samples: Samples,
    config: Config,
    *,
    extension: Extension | None = None,
    freeze_after: float | None = None,
    starts: Sequence[int] = (0,),
    deviation: bool = True,
    advance: Callable[[int], None] = lambda _: None,
) -> Replay:
    """Run the estimator over samples in order.

    Parameters
    ----------
    samples : of one recording, or of several joined (`sample.joined`).
    config : where range or units are open the first contact chooses them, as in the live node (`settings.units`).
    freeze_after : learn on this first fraction of the samples only, [0, 1]: at 0 the configuration's values are judged
        as they are; None learns throughout.
    starts : index of the first sample of each recording.
    deviation : keep the standard deviation of each prediction.
    advance : told the number of samples just done.

    Raises
    ------
    UnanswerableError : fewer than two samples, or constant friction.
    ConfigError : `freeze_after` outside [0, 1].
    """
    check_answerable(samples, config.quantities)
    run = Run(
        config, extension=extension, deviation=deviation, freeze_after=freeze_after, total=len(samples), advance=advance
    )
    for first, end in pairwise([*starts, len(samples)]):
        run.begin()
        run.push(samples[first:end])
    return concluded(run, samples)


def foreseen(run: Run, parts: Sequence[Samples]) -> RecordFigures | None:
    """Return the figures of samples of which a run has not taken all yet; None before their first contact.

    `parts` : the samples of each recording, all of them. A thread beside that of the run may ask.
    """
    contact = run.known_contact
    if contact is None or run.learned_until is not None:
        return None
    samples = joined(parts)[contact.dropped :]
    starts = accumulate((len(part) for part in parts[:-1]), initial=0)
    begins = tuple(max(0, start - contact.dropped) for start in starts)
    return RecordFigures.of(samples, _throughout(samples), begins, run.estimator.model)


def _throughout(samples: Samples, learned: bool = True) -> Bools:
    return np.broadcast_to(np.bool_(learned), (len(samples),))


def concluded(
    run: Run,
    samples: Samples,
    heard: Mapping[str, Value] | None = None,
    figures: RecordFigures | None = None,
) -> Replay:
    """Return what a run that has taken all of the samples made of them.

    Parameters
    ----------
    heard : settings that say how the inputs were found, which the run was not told.
    figures : as `foreseen` gave them; formed anew where the model's range has grown since.
    """
    predicted, spread = run.finish()
    contact, estimator = run.contact, run.estimator
    if heard:
        contact = replace(contact, config=contact.config.updated(heard))
        estimator.config = estimator.config.updated(heard)
    if figures is None or figures.model is not estimator.model:
        samples = samples[contact.dropped :]
        learn = _throughout(samples, run.learned_until is None)
        if run.learned_until:
            learn = learn.copy()
            learn[: run.learned_until] = True
        figures = RecordFigures.of(samples, learn, tuple(run.starts), estimator.model)
    curve, outlook = curves_of(estimator, figures.samples, figures.learned)
    return Replay(
        config=contact.config,
        record=figures,
        predicted_N=predicted,
        snapshot_index=list(run.snapshots),
        snapshots=list(run.snapshots.values()),
        health=estimator.health,
        seconds=run.seconds,
        estimator=estimator,
        curve=curve,
        outlook=outlook,
        contact=contact,
        loads=estimator.loads,
        deviation_N=spread,
    )


def curves_of(source: Estimator | BatchFit, samples: Samples, learned: Bools) -> tuple[Curve, Curve]:
    """Return curve and outlook of a `Replay`, at the conditions learned in.

    The conditions are the medians of the first samples, as many as were learned from; of all where none was.
    """
    count = int(np.count_nonzero(learned))
    known = samples[:count] if count else samples
    curve = source.curve(known)
    low, high = float(curve.velocity_m_s[0]), float(curve.velocity_m_s[-1])
    more = 0.5 * (OUTLOOK - 1.0) * (high - low)
    velocity = samples.velocity_m_s
    wide = np.linspace(min(low - more, velocity.min()), max(high + more, velocity.max()), POINTS)
    return curve, source.curve(known, wide)


def check_answerable(samples: Samples, quantities: Quantities) -> None:
    """Raise UnanswerableError where no figure of merit exists: fewer than two samples, or constant friction."""
    if len(samples) < 2:
        raise UnanswerableError(f"{len(samples)} usable samples: at least two are needed")
    if not metrics.spread(samples.friction_N) > 0.0:
        raise UnanswerableError(
            f"friction is constant at {quantities.text(samples.friction_N[0], FORCE)} in all {len(samples)} samples: "
            "there is nothing to predict; is it the right topic, axis or joint?"
        )


def parameters_of(model: Model, parameters: Parameters) -> dict[str, Any]:
    """Return learned values and the basis that they belong to, as JSON has them."""
    config = model.config
    return {
        "fir_taps": parameters.fir_taps,
        "theory_taps": parameters.theory_taps if parameters.theory_taps.size else None,
        "wavelet_weights": parameters.wavelet_weights,
        "load_weights": parameters.load_weights if parameters.load_weights.size else None,
        "extension_weights": parameters.extension_weights if parameters.extension_weights.size else None,
        "force_unit_N": config.unit_N,
        "basis": {
            "wavelet": config.basis.wavelet,
            "finest_level": config.basis.finest_level,
            "coarsest_level": config.basis.coarsest_level,
            "velocity_range_m_s": config.reach,
            "velocity_unit_m_s": model.basis.unit,
            "companding": config.basis.companding,
        },
    }
