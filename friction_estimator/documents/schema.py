"""Types and shapes of a document: a JSON Schema, checked by the library `jsonschema`, told in one line.

A schema says what a document looks like. What a value of the configuration may be is said where it is declared
(`core.settings`), since the same declaration judges what arrives over the graph, where there is no document.
"""

from collections.abc import Iterable, Mapping
from functools import cached_property
from typing import Any

from friction_estimator.core.errors import InputError
from friction_estimator.core.text import LONGEST_NAME, shown


class Schema:
    """What documents of one kind look like.

    Parameters
    ----------
    rules : JSON Schema, draft 2020-12. A `description` in it says what is expected there, for messages.

    Examples
    --------
    >>> schema = Schema({"properties": {"a": {"items": {"type": "integer", "description": "a count"}}}})
    >>> schema.check({"a": [3]}, "x.json")
    >>> schema.check({"a": [3, "4"]}, "x.json")
    Traceback (most recent call last):
    friction_estimator.core.errors.InputError: x.json: a[1] is '4', expected a count
    >>> schema.check({"a": [3.0]}, "x.json")
    Traceback (most recent call last):
    friction_estimator.core.errors.InputError: x.json: a[0] is 3.0, expected a count
    """

    def __init__(self, rules: Mapping[str, Any]) -> None:
        self._rules = rules

    @cached_property
    def _validator(self) -> Any:
        from jsonschema import Draft202012Validator, validators  # noqa: PLC0415 - 60 ms, most runs read no document

        # To JSON Schema 3.0 is an integer; to whoever counts by it, it is none.
        types = Draft202012Validator.TYPE_CHECKER.redefine("integer", lambda _, value: type(value) is int)
        checked = validators.extend(Draft202012Validator, type_checker=types)  # type: ignore[no-untyped-call]
        return checked(self._rules)

    def check(self, document: Any, source: str, kind: type[InputError] = InputError) -> None:
        """Raise `kind` where `document` breaks a rule; one line with `source`, the place and what is expected there."""
        broken = next(self._validator.iter_errors(document), None)
        if broken is not None:
            raise kind(f"{source}: {_sentence(broken)}")


def _sentence(broken: Any) -> str:
    place = _place(broken.absolute_path)
    if broken.validator == "required":
        lacking = next(name for name in broken.validator_value if name not in broken.instance)
        return f"{place or 'it'} lacks {lacking}"
    if broken.validator == "additionalProperties":
        known = broken.schema.get("properties", {})
        unknown = next(name for name in broken.instance if name not in known)
        return f"{place or 'it'} holds {shown(unknown, LONGEST_NAME)}, which is not known here"
    expected = broken.schema.get("description") or f"{broken.validator} {broken.validator_value}"
    return f"{place or 'it'} is {_value(broken.instance)}, expected {shown(expected, LONGEST_NAME)}"


def _place(path: Iterable[str | int]) -> str:
    words = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path)
    return shown(words.removeprefix("."), LONGEST_NAME)


def _value(value: Any) -> str:
    if isinstance(value, dict):
        return "a section" if value else "an empty section"
    if isinstance(value, list):
        return "a list" if value else "an empty list"
    return "empty" if value is None else shown(repr(value), LONGEST_NAME)
