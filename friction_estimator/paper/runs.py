"""One recording run by every learner: errors while learning, frozen on the rest, and frozen on other drives."""

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from friction_estimator.core.fit.baselines import fit_baselines
from friction_estimator.core.fit.batch import fit_batch
from friction_estimator.core.metrics import drive_cycles, nrmse, nrmse_persistence
from friction_estimator.core.model.prediction import delay_lines, predict_fixed
from friction_estimator.core.model.structure import Model, Parameters
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.sample import Floats, Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.paper.claims import FROZEN
from friction_estimator.paper.study import (
    BATCH,
    COMPANDED,
    CYCLES_LEARNED,
    FROZEN_SHARE,
    LAST_CYCLES,
    LEARNERS,
    MODELS,
    Outcome,
    Plan,
    Recorded,
    Shown,
    derived,
    other_drives,
    outcome,
    record,
)

STATIC_CURVE = "stribeck_asymmetric"


class HeldOut:
    """Samples on which parameters are judged without learning; prepared once for many parameters.

    The first samples, whose past is not in the delay lines, are left out.
    """

    def __init__(self, model: Model, samples: Samples) -> None:
        restart = samples.restart.copy()
        restart[0] = True
        self._model = model
        self._inputs = model.inputs(replace(samples, restart=restart))
        self._measured_N = samples.friction_N
        self._from = int(model.shape[0]) - 1

    def predicted(self, parameters: Parameters) -> Floats:
        """Return what fixed parameters predict, (n,), N."""
        inputs, shape = self._inputs, self._model.shape
        predicted = np.empty(self._measured_N.size)
        load = (inputs.extension, inputs.known, self._model.load.size - 1)
        arrays = (inputs.index, inputs.value, inputs.theory, *load, inputs.restart)
        predict_fixed(*arrays, predicted, shape, self._model.checked(parameters), *delay_lines(shape))
        return predicted * self._model.unit_N

    def error(self, parameters: Parameters) -> float:
        """Return the nrmse of fixed parameters."""
        return nrmse(self._measured_N[self._from :], self.predicted(parameters)[self._from :])


def learn(samples: Samples, config: Config, stops: Iterable[int] = ()) -> tuple[Floats, dict[int, Parameters]]:
    """Learn from a recording in order; return what was predicted, and the parameters after each of `stops` samples.

    The bits do not depend on the stops. Those of the end are always among them.
    """
    estimator = Estimator(config)
    predicted, kept, begin = np.empty(len(samples)), {}, 0
    for stop in sorted({*stops, len(samples)}):
        predicted[begin:stop] = estimator.run(samples[begin:stop])
        kept[stop], begin = estimator.parameters, stop
    return predicted, kept


def run_recording(plan: Plan, condition: str, seed: int, companding: float = COMPANDED) -> Recorded:
    """Simulate one recording and run both models over it: every learner, and the batch fit.

    Frozen is judged after `FROZEN_SHARE` of it; the batch fit's errors while learning are those of its fit to all.
    """
    samples, others = record(plan, condition, seed), other_drives(plan, condition, seed)
    half = round(FROZEN_SHARE * len(samples))
    cycles = drive_cycles(samples.velocity_m_s)
    length = int(np.median([part.stop - part.start for part in cycles]))
    counts = [count for count in CYCLES_LEARNED if count * length <= half]
    outcomes: dict[tuple[str, str], Outcome] = {}
    predictions: dict[tuple[str, str], Floats] = {}
    frozen: dict[tuple[str, str], Floats] = {}
    config = derived(samples, MODELS[0], basis__companding=companding)
    for name in MODELS:
        config = derived(samples, name, basis__companding=companding)
        model = Model(config)
        rest, last = HeldOut(model, samples[half:]), HeldOut(model, samples[-LAST_CYCLES * length :])
        elsewhere = {profile: HeldOut(model, other) for profile, other in others.items()}
        fit, first = fit_batch(samples, config), fit_batch(samples[:half], config)
        predictions[name, BATCH] = fit.predicted_N
        outcomes[name, BATCH] = replace(
            outcome(samples, fit.predicted_N, fit.parameters),
            frozen=rest.error(first.parameters),
            elsewhere=errors_of(first.parameters, elsewhere),
            frozen_parameters=first.parameters,
        )
        frozen[name, BATCH] = rest.predicted(first.parameters)
        for learner, settings in LEARNERS.items():
            predicted, kept = learn(samples, config.updated(settings), [*(count * length for count in counts), half])
            predictions[name, learner], frozen[name, learner] = predicted, rest.predicted(kept[half])
            outcomes[name, learner] = replace(
                outcome(samples, predicted, kept[len(samples)]),
                frozen=rest.error(kept[half]),
                elsewhere=errors_of(kept[half], elsewhere),
                by_cycles={count: errors_of(kept[count * length], {FROZEN: last} | elsewhere) for count in counts},
                frozen_parameters=kept[half],
            )
    shown = Shown(samples, config, predictions, frozen, half) if seed == 0 else None
    return Recorded(outcomes, _yardsticks(samples, others, half), shown)


def errors_of(parameters: Parameters, places: Mapping[str, HeldOut]) -> dict[str, float]:
    """Return the errors of fixed parameters by place."""
    return {name: place.error(parameters) for name, place in places.items()}


def _yardsticks(samples: Samples, others: Mapping[str, Samples], half: int) -> dict[str, float]:
    """Return the errors of what is no model: persistence, and a static curve fitted to the frozen share."""
    learned, rest = samples[:half], samples[half:]
    curve = fit_baselines(learned.velocity_m_s, learned.friction_N, (STATIC_CURVE,))[STATIC_CURVE]
    return {
        "persistence": nrmse_persistence(samples.friction_N, samples.restart),
        "static_curve_frozen": nrmse(rest.friction_N, curve.evaluate(rest.velocity_m_s)),
    } | {
        f"static_curve_on_{profile}": nrmse(other.friction_N, curve.evaluate(other.velocity_m_s))
        for profile, other in others.items()
    }
