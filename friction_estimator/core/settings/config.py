"""The whole configuration: the groups of settings together, checked, with what follows from them.

A setting is addressed by its dotted name: `fir.order` is ``config.fir.order``; `groups` declares them.
"""

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.quantities import LINEAR, ROTARY, Quantities
from friction_estimator.core.settings.groups import (
    AUTO,
    LARGEST_FORCE_N,
    LEAST_FORCE_N,
    BasisConfig,
    ExtensionConfig,
    FilesConfig,
    FirConfig,
    InputConfig,
    LearnedConfig,
    LmsConfig,
    LoadConfig,
    ModelConfig,
    NlmsConfig,
    PriorConfig,
    PublishConfig,
    RlsConfig,
    StateConfig,
    SyncConfig,
)
from friction_estimator.core.settings.joint_names import plain_names
from friction_estimator.core.settings.setting import Parameter, Value, setting, walk
from friction_estimator.core.settings.theory_groups import SealConfig, StribeckConfig, TheoryConfig


@dataclass(frozen=True)
class Config:
    """The whole configuration; immutable, validated at construction through `from_mapping` or `validated`."""

    force_unit: float = setting(
        0.0,
        "Force of one normalised unit (the expected rms of friction). 0: that of the first contact.",
        unit="N",
        of_drive=True,
        low=0.0,
        high=LARGEST_FORCE_N,
        least=LEAST_FORCE_N,
    )
    model: ModelConfig = ModelConfig()
    basis: BasisConfig = BasisConfig()
    fir: FirConfig = FirConfig()
    lms: LmsConfig = LmsConfig()
    nlms: NlmsConfig = NlmsConfig()
    prior: PriorConfig = PriorConfig()
    rls: RlsConfig = RlsConfig()
    theory: TheoryConfig = TheoryConfig()
    seal: SealConfig = SealConfig()
    stribeck: StribeckConfig = StribeckConfig()
    input: InputConfig = InputConfig()
    sync: SyncConfig = SyncConfig()
    publish: PublishConfig = PublishConfig()
    state: StateConfig = StateConfig()
    files: FilesConfig = FilesConfig()
    load: LoadConfig = LoadConfig()
    extension: ExtensionConfig = ExtensionConfig()
    learned: LearnedConfig = LearnedConfig()

    @classmethod
    def from_mapping(cls, values: Mapping[str, object]) -> "Config":
        """Build from dotted names.

        Raises ConfigError for an unknown name, a wrong type, a value out of range or a NaN, naming it.

        >>> Config.from_mapping({"fir.order": 4}).fir.order
        4
        >>> Config.from_mapping({"rls.forgetting": 0.9})
        Traceback (most recent call last):
        friction_estimator.core.errors.ConfigError: unknown parameter rls.forgetting; nearest: rls.forgetting_factor
        """
        return cls().updated(values)

    def updated(self, values: Mapping[str, object]) -> "Config":
        """Return a copy with the named values replaced, checked as a whole."""
        tree: dict[str, dict[str, Value]] = {}
        for name, value in values.items():
            if name in RETIRED:
                continue
            item = parameter(name)
            group, _, leaf = item.name.rpartition(".")
            tree.setdefault(group, {})[leaf] = item.checked(value)
        new = self
        for group, leaves in tree.items():
            changes: dict[str, Any] = {group: replace(getattr(new, group), **leaves)} if group else leaves
            new = replace(new, **changes)
        new._check_consistency()
        return new

    def _check_consistency(self) -> None:
        if self.basis.coarsest_level < self.basis.finest_level:
            raise ConfigError(
                f"basis.coarsest_level is {self.basis.coarsest_level}, below basis.finest_level "
                f"{self.basis.finest_level}: levels grow coarser with their number"
            )
        for room, ends in (("basis", self.basis.velocity_range), ("learned", self.learned.velocity_range)):
            if ends and (len(ends) != 2 or not ends[0] < ends[1]):
                raise ConfigError(f"{room}.velocity_range is {list(ends)}: give [lowest, highest], lowest first")
        if self.learned.wavelet_weights and not self.is_met:
            raise ConfigError(
                "learned.wavelet_weights come without the range and unit that they were learned in: give "
                "learned.velocity_range, learned.velocity_scale and learned.force_unit with them, and learned.stribeck "
                "where theory.kind is stribeck, or leave them out"
            )
        if plain_names(self.input.joints) and self.input.mode != "joint_state":
            raise ConfigError(
                f"input.joints is given and input.mode is {self.input.mode}: set input.mode to joint_state"
            )
        if self.input.friction_sign == 0:
            raise ConfigError("input.friction_sign is 0: give 1 or -1")
        if (self.stribeck.breakaway or self.stribeck.viscous) and not self.stribeck.coulomb:
            raise ConfigError("stribeck.coulomb is empty: give it with the rest of stribeck.* (0 for none), or nothing")
        for name in ("coulomb", "breakaway", "viscous"):
            if len(getattr(self.stribeck, name)) > 2:
                raise ConfigError(f"stribeck.{name}: give one value, or [at negative velocity, at positive velocity]")
        if self.theory.kind == "table" and not self.theory.table:
            raise ConfigError("theory.kind is table and theory.table is empty: name the CSV file")

    @property
    def reach(self) -> tuple[float, float] | None:
        """Velocities that g covers, (lowest, highest) m/s; None before the first contact."""
        given = self.basis.velocity_range or self.learned.velocity_range
        return (given[0], given[1]) if given else None

    @property
    def velocity_scale(self) -> float:
        """Speed that basis unit and companding derive from, m/s; 0 before the first contact."""
        if self.basis.velocity_range or not self.learned.velocity_scale:
            return max(map(abs, self.reach)) if self.reach else 0.0
        return self.learned.velocity_scale

    @property
    def unit_N(self) -> float:
        """Force of one normalised unit, N; 0 before the first contact."""
        return self.force_unit or self.learned.force_unit

    @property
    def quantities(self) -> Quantities:
        """What the drive's numbers are; where `input.motion` is auto, by the inputs' mode."""
        rotary = self.input.mode == "joint_state" if self.input.motion == AUTO else self.input.motion == ROTARY
        return Quantities(ROTARY if rotary else LINEAR)

    @property
    def theory_kind(self) -> str:
        """Kind of the theoretical curve: `theory.kind`, or what auto has come to; auto before the first contact."""
        if self.theory.kind != "auto":
            return self.theory.kind
        # Files of versions whose default was the seal do not say so.
        return self.learned.theory or ("seal" if self.learned.wavelet_weights else "auto")

    @property
    def is_parallel(self) -> bool:
        """Whether the model has a theoretical curve: `model.type` parallel, and a theory of any kind but none."""
        return self.model.type == "parallel" and self.theory.kind != "none"

    @property
    def structure(self) -> str:
        """The structure that is run, parallel or hammerstein."""
        return "parallel" if self.is_parallel else "hammerstein"

    @property
    def finds_stribeck(self) -> bool:
        """Whether the theoretical curve is a Stribeck curve that samples say."""
        return self.theory_kind == "stribeck" and not self.stribeck.coulomb

    @property
    def has_theory(self) -> bool:
        """Whether the theoretical curve is known: chosen, and found where it is the samples that say it."""
        return self.theory_kind != "auto" and bool(self.learned.stribeck or not self.finds_stribeck)

    @property
    def has_units(self) -> bool:
        """Whether range and units are known."""
        return self.reach is not None and self.unit_N > 0.0

    @property
    def is_met(self) -> bool:
        """Whether range, units and the theory of a parallel model are known, so that a model can be built."""
        return self.has_units and (self.has_theory or not self.is_parallel)

    def to_mapping(self) -> dict[str, Value]:
        """Return every value under its dotted name."""
        return {item.name: item.of(self) for item in PARAMETERS.values()}


RETIRED = {
    "rls.initial_variance": "prior.residual_deviation",
    "rls.relinearise": "rls.forgetting_factor",
}
"""Parameters of earlier versions, which are passed over, and what sets the same today; see `retired`."""

PARAMETERS: dict[str, Parameter] = {item.name: item for item in walk(Config)}

PATHS = tuple(name for name, item in PARAMETERS.items() if item.path)
"""Parameters that name a file: relative to the parameter file that holds them; of one joint they end so."""


def retired(names: Iterable[str]) -> list[str]:
    """Return one line for each parameter of an earlier version among `names`; readers of files show them.

    >>> retired(["fir.order", "rls.relinearise"])
    ['rls.relinearise is retired and passed over: see rls.forgetting_factor']
    """
    return [f"{name} is retired and passed over: see {RETIRED[name]}" for name in names if name in RETIRED]


def parameter(name: str) -> Parameter:
    """Return the declaration of a dotted name; ConfigError names the nearest one where it is unknown."""
    try:
        return PARAMETERS[name]
    except KeyError:
        near = difflib.get_close_matches(name, PARAMETERS, n=1, cutoff=0.5)
        hint = f"; nearest: {near[0]}" if near else ""
        raise ConfigError(f"unknown parameter {name}{hint}") from None
