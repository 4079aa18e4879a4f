"""A candidate for a cause, and how two of them compare."""

from collections.abc import Sequence
from dataclasses import dataclass

from friction_estimator.core.sample import Bools, Floats
from friction_estimator.diagnosis.held_out import error_of_sum
from friction_estimator.diagnosis.joint import Joint
from friction_estimator.diagnosis.own_columns import Term
from friction_estimator.effects.base import REVERSAL, Effect

MEMORY_EVIDENCE = 20.0
"""Prior energy of the base's memory that a delay of the whole force must save to be named by evidence alone: a
probability ratio of exp(10)."""

PLAIN = 10.0
"""Times the noise power: surplus of gain that one more parameter must bring."""

SET_ERRORS = 2.0
SET_SHARE = 0.03
"""Standard errors of the paired loss, and share of the gain, within which two effects explain the record as well."""


@dataclass(frozen=True, eq=False)
class Model:
    """A fitted model and its held-out loss on each block, (blocks,), N^2; it equals itself alone, as a key."""

    joint: Joint
    loss: Floats


def gain_parts(fewer: Model, more: Model) -> tuple[float, float]:
    """Return the held-out decrease of the error power by further terms, and what the memory's prior saves, N^2 each."""
    before, after = fewer.joint.coefficients, more.joint.coefficients
    saved = after.variance * (before.memory_energy - after.memory_energy)
    return float((fewer.loss - more.loss).sum()), saved


@dataclass(frozen=True)
class Candidate:
    """An effect fitted jointly with the model that it is added to.

    Attributes
    ----------
    name, effect : which. model : with the effect as its last term.
    held_N2 : held-out decrease of the error power, summed. saved_N2 : what the prior of the base's memory saves.
    belied : whether the functional form that the data ask for is another cause's: it looks like this one only.
    """

    name: str
    effect: type[Effect]
    model: Model
    held_N2: float
    saved_N2: float
    belied: bool = False

    @property
    def gain(self) -> float:
        """Both together, N^2."""
        return self.held_N2 + self.saved_N2

    @property
    def term(self) -> Term:
        """The effect as it was fitted."""
        return self.model.joint.terms[-1]

    @property
    def freedom(self) -> int:
        """Parameters of the effect."""
        return (0 if self.effect.fixed_gain else self.term.weights.size) + len(self.term.refined)

    @property
    def by_evidence(self) -> bool:
        """Whether what the memory saves alone would name it."""
        return self.effect.delays and self.saved_N2 > MEMORY_EVIDENCE * self.model.joint.coefficients.variance

    @property
    def samples_N2(self) -> float:
        """Error power that is left, per sample."""
        return float(self.model.loss.sum()) / self.model.joint.coefficients.count


def as_sharp(best: type[Effect], other: type[Effect]) -> bool:
    """Return whether another effect is a time of the whole force as the best one is, or jumps where that one acts."""
    if best.delays and other.delays:
        return True
    return best.acts == REVERSAL == other.acts and other.fixed_gain and bool(other.steps)


def signs_kept(joint: Joint) -> bool:
    """Return whether the coefficients have the signs that physics gives them."""
    return all(
        sign * weight >= 0.0
        for term in joint.terms
        if len(term.effect.signs) == term.weights.size
        for sign, weight in zip(term.effect.signs, term.weights, strict=True)
    )


def beyond_chance(one: Candidate, other: Candidate) -> float:
    """Return the surplus of gain that the other one's further parameters, one at least, must bring, N^2."""
    return PLAIN * max(other.freedom - one.freedom, 1) * one.samples_N2


def plainest(best: Candidate, others: Sequence[Candidate]) -> Candidate:
    """Return one with fewer parameters where the best one's surplus is what its further ones bring by chance."""
    noise_N2 = best.samples_N2
    close = [c for c in others if best.gain - c.gain < PLAIN * noise_N2 * max(best.freedom - c.freedom, 0)]
    return min([best, *close], key=lambda c: (c.freedom, -c.gain))


def equals(best: Candidate, others: Sequence[Candidate]) -> list[Candidate]:
    """Return the candidates that explain the record as well as the best one does, best first."""
    out = []
    for other in sorted(others, key=lambda c: -c.gain):
        if other.name == best.name or needs_memory(best, other):
            continue
        if within_errors(best, other) or best.gain - other.gain < SET_SHARE * best.gain:
            out.append(other)
    return out


def equals_on(blocks: Bools, model: Model, best: Candidate, other: Candidate) -> bool:
    """Return whether another candidate beside a model explains some blocks (blocks,) as well as the best one does."""
    behind = (other.model.loss - best.model.loss)[blocks]
    gain = float((model.loss - best.model.loss)[blocks].sum())
    return float(behind.sum()) < max(SET_ERRORS * error_of_sum(behind), SET_SHARE * gain)


def needs_memory(best: Candidate, other: Candidate) -> bool:
    """Return whether beside the other one the base's memory would have to do what the best one does alone.

    What the memory takes is in the gain: one that explains more for all that is no worse.
    """
    energy = [c.model.joint.coefficients.memory_energy for c in (other, best)]
    return other.gain <= best.gain and energy[0] - energy[1] > MEMORY_EVIDENCE


def within_errors(best: Candidate, other: Candidate) -> bool:
    """Return whether the record does not say which of two explains it better."""
    return best.gain - other.gain < SET_ERRORS * error_of_sum(other.model.loss - best.model.loss)
