"""ROS parameters by reflection: every setting of core/settings/config.py, declared, checked and explained.

rclpy's own rules would end the node for an integer where a double is declared, let NaN into arrays, ignore a
misspelt name and answer a service call without naming the culprit. `ConfiguredNode` judges every value with
`Parameter.checked` of core/settings instead, at start-up and in the parameter services, and goes on living.
"""

import sys
from collections.abc import Mapping, Sequence
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from friction_estimator.core.errors import ConfigError, sentence
from friction_estimator.core.quantities import Quantities
from friction_estimator.core.settings.config import RETIRED, retired
from friction_estimator.core.settings.joints import Settings
from friction_estimator.core.settings.setting import Parameter, Value
from friction_estimator.core.text import shown
from friction_estimator.documents.configuration import is_ros_own
from friction_estimator.ros.log import SafeLogger

_TYPES = {
    bool: RosParameter.Type.BOOL,
    int: RosParameter.Type.INTEGER,
    float: RosParameter.Type.DOUBLE,
    str: RosParameter.Type.STRING,
}
_ARRAY_TYPES = {float: RosParameter.Type.DOUBLE_ARRAY, str: RosParameter.Type.STRING_ARRAY}


def descriptor(item: Parameter, quantities: Quantities | None = None) -> ParameterDescriptor:
    """Return what the parameter services tell about a setting: type, range, unit, choices, when it acts.

    `quantities` are the drive's; None where it is not known what moves.
    """
    notes = []
    if item.unit:
        notes.append(f"unit: {item.units if quantities is None else item.unit_in(quantities)}")
    if item.choices:
        notes.append(f"one of: {', '.join(item.choices)}")
    if item.is_array:
        notes.append("array" if item.element is str else "array of finite numbers, the range holds for each")
    if item.learned:
        notes.append("written by the estimator; setting it replaces what was learned")
    notes.append(f"acts {item.acts}")
    result = ParameterDescriptor(description=item.description, additional_constraints="; ".join(notes))
    limits = sys.float_info.max
    if item.element is float and max(item.low, -item.high) > -float("inf"):
        low, high = max(item.low, -limits), min(item.high, limits)
        result.floating_point_range = [FloatingPointRange(from_value=low, to_value=high, step=0.0)]
    if item.element is int:
        result.integer_range = [IntegerRange(from_value=int(item.low), to_value=int(item.high), step=1)]
    return result


def to_ros(item: Parameter, value: Value) -> RosParameter:
    """Return a checked value as a ROS parameter of the declared type."""
    if isinstance(value, tuple):
        return RosParameter(item.name, _ARRAY_TYPES[item.element], list(value))
    return RosParameter(item.name, _TYPES[item.kind], value)


def from_ros(item: Parameter, given: RosParameter) -> Value:
    """Return the value of a ROS parameter in the setting's type.

    Raises ConfigError with name and reason. A value without type is an empty array (rcl reads `[]` so).
    """
    if given.type_ == RosParameter.Type.NOT_SET:
        if item.is_array:
            return ()
        raise ConfigError(f"{item.name}: no value given, expected {item.element.__name__}")
    if item.is_array and given.type_ == RosParameter.Type.BYTE_ARRAY and not given.value:
        return ()
    return item.checked(given.value)


def accepted(settings: Settings, values: Mapping[str, Value]) -> tuple[Settings, list[str]]:
    """Return `settings` with as many of `values` as are consistent, and the reasons for the others."""
    try:
        return settings.updated(values), []
    except ConfigError:
        pass
    waiting = dict(values)
    while True:
        reasons, before = {}, len(waiting)
        for name in list(waiting):
            try:
                settings = settings.updated({name: waiting[name]})
            except ConfigError as error:
                reasons[name] = f"{name}: {error}"
            else:
                del waiting[name]
        if len(waiting) in (0, before):  # else what was refused may go with what was taken after it
            return settings, list(reasons.values())


class ConfiguredNode(Node):  # type: ignore[misc]
    """A node whose parameters are the settings of `Settings`.

    Parameters
    ----------
    name : of the node.
    options : what rclpy's Node takes: namespace, context, parameter_overrides, ...

    Attributes
    ----------
    settings : as the parameters now read; what acts at ~/reset may not act yet.
    refused : one line for each start-up value that was not accepted.
    retired : one line for each start-up value of an earlier version, which is passed over.
    """

    _safe_logger: SafeLogger | None = None

    def __init__(self, name: str, **options: Any) -> None:
        self.settings = Settings()
        self.refused: list[str] = []
        self.retired: list[str] = []
        self._declarations: dict[str, Parameter] = {}
        try:
            super().__init__(name, **options)
        except InvalidParameterTypeException as error:
            # Only use_sim_time is declared in there.
            self.refused.append(str(error))
            overrides = [item for item in options.pop("parameter_overrides", None) or () if not is_ros_own(item.name)]
            overrides.append(RosParameter("use_sim_time", RosParameter.Type.BOOL, False))
            super().__init__(name, **options, parameter_overrides=overrides)
        self._declare()

    def _declare(self) -> None:
        self.retired = retired(self._parameter_overrides)
        # rclpy offers no public way to read overrides that it cannot declare, such as an empty array.
        overrides = self._parameter_overrides
        given = {name: overrides[name] for name in overrides if not is_ros_own(name) and name not in RETIRED}
        # Which joints there are decides which parameters there are.
        first = [name for name in given if name in ("input.mode", "input.joints")]
        self._take(given, first)
        self._take(given, [name for name in given if name not in first])
        self._declarations = {name: self.settings.declaration(name) for name in self.settings.names()}
        empty = []
        for item in self._declarations.values():
            value = to_ros(item, self.settings.value(item.name))
            dummy = ["-"] if item.element is str else [min(max(0.0, item.low), item.high)]
            if value.value == []:
                empty.append(value)  # rclpy cannot infer the type of an empty list
            self.declare_parameter(item.name, value.value if value.value != [] else dummy, descriptor(item), True)
        if empty:
            super().set_parameters_atomically(empty)

    def describe_units(self, quantities: Mapping[str, Quantities]) -> None:
        """Let the descriptors say the units of the joints, by plain name; what unlike joints share has none."""
        kinds = set(quantities.values())
        for name, item in self._declarations.items():
            if item.of_drive:
                whose = self.settings.split(name)[0]
                known = quantities.get(whose) or (next(iter(kinds)) if len(kinds) == 1 else None)
                declared = self.describe_parameter(name)  # rclpy has put the type into it
                declared.additional_constraints = descriptor(item, known).additional_constraints
                self.set_descriptor(name, declared)

    def _take(self, given: Mapping[str, RosParameter], names: Sequence[str]) -> None:
        """Take start-up values, each unless it cannot be used."""
        values: dict[str, Value] = {}
        for name in names:
            try:
                values[name] = self.localised(name, from_ros(self.settings.declaration(name), given[name]))
            except ConfigError as error:
                self.refused.append(str(error))
        self.settings, reasons = accepted(self.settings, values)
        self.refused += reasons

    def get_logger(self) -> SafeLogger:
        """Return the node's logger; whatever it is given becomes one safe line."""
        if self._safe_logger is None:  # rclpy may ask during construction
            self._safe_logger = SafeLogger(super().get_logger().name)
        return self._safe_logger

    def localised(self, name: str, value: Value) -> Value:
        """Return a start-up value as this machine understands it (relative paths)."""
        del name
        return value

    def check_change(self, settings: Settings, changed: Sequence[str]) -> None:
        """Raise ConfigError where the running estimator cannot take the change."""

    def apply_change(self, settings: Settings, changed: Sequence[str]) -> None:
        """Let live changes act; the parameters already have their new values."""

    def _check_fixed(self, item: Parameter) -> None:
        """Raise ConfigError for what cannot be changed any more now that the node runs."""
        if item.at_start:
            raise ConfigError(f"{item.name} is read when the node starts: set it in its parameter file and start again")
        if item.path and not self.settings.shared.files.remote:
            raise ConfigError(
                f"{item.name} names a file and is read-only on a running node: set it in the parameter file and start "
                "again, or start with files.remote true"
            )

    def set_parameters_atomically(self, parameter_list: Sequence[RosParameter]) -> SetParametersResult:
        """Check the whole list, set all of it or nothing; the answer names the culprit and the reason."""
        declared = self._declarations
        values: dict[str, Value] = {}
        passed: list[RosParameter] = []
        try:
            for given in parameter_list:
                if given.name not in declared and self.has_parameter(given.name):
                    passed.append(given)
                    continue
                if given.name in RETIRED:
                    raise ConfigError(retired([given.name])[0])
                item = self._declared(given.name)
                values[item.name] = from_ros(item, given)
                passed.append(to_ros(item, values[item.name]))
            settings = self.settings.updated(values)
            # A learned value is what the estimator holds, so setting one always is a change.
            changed = [
                name for name, value in values.items() if declared[name].learned or value != self.settings.value(name)
            ]
            for name in changed:
                self._check_fixed(declared[name])
            self.check_change(settings, changed)
        except ConfigError as error:
            return SetParametersResult(successful=False, reason=sentence(error))
        result = super().set_parameters_atomically(passed)
        if not result.successful:
            names = ", ".join(given.name for given in passed)
            result.reason = shown(f"{names}: {result.reason}")
            return result
        self.settings = settings
        self.apply_change(settings, changed)
        later = [name for name in changed if not declared[name].live]
        if later:
            result.reason = f"{', '.join(later)}: set; takes effect at ~/reset"
        return result

    def _declared(self, name: str) -> Parameter:
        """Return a declared parameter; raises ConfigError where there is none."""
        if name not in self._declarations:
            self.settings.declaration(name)  # says why, where it knows
            raise ConfigError(f"{name} can be given at the start only, in the parameter file")
        return self._declarations[name]
