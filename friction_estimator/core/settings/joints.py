"""Settings of several joints: what they share, once, and what is one joint's alone."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from friction_estimator.core.errors import ConfigError
from friction_estimator.core.settings.config import PARAMETERS, RETIRED, Config, parameter
from friction_estimator.core.settings.joint_names import plain_names
from friction_estimator.core.settings.setting import Parameter, Value

SHARED_ONLY = ("input.mode", "input.axis", "input.joint", "input.joints", "state.file", "files.remote")
"""What no joint can have for itself: they share one topic, and the name of the state file tells them apart."""

Own = Mapping[str, Mapping[str, Value]]


@dataclass(frozen=True)
class Settings:
    """Everything that is set, for one joint or for several (`input.joints`).

    A setting is addressed by its dotted name. With several joints JOINT.SETTING, where JOINT is `plain_name` of the
    joint, wins over SETTING for that joint; what is learned is always the joint's own: JOINT.learned.fir_taps.

    Attributes
    ----------
    shared : what all joints share, or all settings of the only one.
    own : by plain name of the joint, what is its own.

    Examples
    --------
    >>> settings = Settings().updated({"input.mode": "joint_state", "input.joints": ["left arm", "b"], "fir.order": 8})
    >>> settings = settings.updated({"left_arm.fir.order": 4})
    >>> settings.of("left_arm").fir.order, settings.of("b").fir.order, settings.of("b").input.joint
    (4, 8, 'b')
    """

    shared: Config = field(default_factory=Config)
    own: Own = field(default_factory=dict)

    @property
    def joints(self) -> dict[str, str]:
        """Names of the joints by their plain names; the only one of a single drive is under the empty name."""
        names = plain_names(self.shared.input.joints)
        return {plain: joint for joint, plain in names.items()} if names else {"": self.shared.input.joint}

    @property
    def several(self) -> bool:
        """Whether joints are told apart by name, be it only one."""
        return bool(self.shared.input.joints)

    def split(self, name: str) -> tuple[str, str]:
        """Return whose setting a dotted name is, by plain name, and which; "" is what all share, or the only joint.

        Raises ConfigError where there is no such setting.
        """
        head, _, rest = name.partition(".")
        if self.several and head in self.joints and rest in PARAMETERS:
            if rest in SHARED_ONLY:
                raise ConfigError(f"{name}: all joints share {rest}: set that")
            return head, rest
        parameter(name)
        if self.several and PARAMETERS[name].learned:
            raise ConfigError(f"{name}: each of several joints learns for itself: name it JOINT.{name}")
        return "", name

    def declaration(self, name: str) -> Parameter:
        """Return the declaration of a dotted name, under that name. Raises ConfigError where there is none."""
        return replace(PARAMETERS[self.split(name)[1]], name=name)

    def updated(self, values: Mapping[str, object]) -> "Settings":
        """Return a copy with the named values replaced, checked as a whole. Raises ConfigError, naming the culprit."""
        shared = {name: value for name, value in values.items() if name in PARAMETERS or name in RETIRED}
        new = Settings(self.shared.updated(shared), {plain: dict(own) for plain, own in self.own.items()})
        own = {plain: dict(settings) for plain, settings in self.own.items()}
        for name, value in values.items():
            if name in RETIRED:
                continue
            plain, setting = new.split(name)
            if plain:
                own.setdefault(plain, {})[setting] = new.declaration(name).checked(value)
        new = replace(new, own=own)
        for plain in new.joints:
            new.of(plain)
        return new

    def of(self, plain: str) -> Config:
        """Return the configuration of one joint; raises ConfigError where its own settings do not go together."""
        if not self.several:
            return self.shared
        file = self.shared.state.file
        alone: dict[str, object] = {"input.joint": self.joints[plain], "input.joints": ()}
        if file:
            alone["state.file"] = f"{file}.{plain}"
        try:
            return self.shared.updated({**self.own.get(plain, {}), **alone})
        except ConfigError as error:
            error.where = error.where or self.joints[plain]
            raise

    def of_joint(self, joint: str) -> Config:
        """Return the configuration for a joint by its name, one of `joints` or not; what is shared for no name."""
        if not joint:
            return self.shared
        plain = next((plain for plain, name in self.joints.items() if name == joint), None)
        if self.several and plain is not None:
            return self.of(plain)
        return self.shared.updated({"input.joint": joint, "input.joints": ()})

    def value(self, name: str) -> Value:
        """Return a value by its dotted name; raises ConfigError as `split`."""
        plain, setting = self.split(name)
        return PARAMETERS[setting].of(self.of(plain) if plain else self.shared)

    def names(self) -> list[str]:
        """Return the dotted name of every setting: of several joints each has what it learns, and what it was given."""
        if not self.several:
            return list(PARAMETERS)
        learned = [name for name, item in PARAMETERS.items() if item.learned]
        names = [name for name in PARAMETERS if name not in learned]
        for plain in self.joints:
            names += [f"{plain}.{name}" for name in dict.fromkeys([*self.own.get(plain, {}), *learned])]
        return names

    def concerning(self, plain: str, names: Iterable[str]) -> list[str]:
        """Return which settings of one joint some dotted names are; what it has for itself is not the shared one."""
        found = [self.split(name) for name in names]
        own = self.own.get(plain, {})
        return [setting for whose, setting in found if whose == plain or (not whose and setting not in own)]

    def without_learned(self) -> "Settings":
        """Return the settings for a cold start."""
        own = {
            plain: {name: value for name, value in settings.items() if not PARAMETERS[name].learned}
            for plain, settings in self.own.items()
        }
        return Settings(replace(self.shared, learned=type(self.shared.learned)()), own)
