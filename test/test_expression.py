"""Arithmetic over columns: what it comes to, and that nothing else can be spelt."""

from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from friction_estimator.bag.expression import Expression
from friction_estimator.bag.expression_text import FUNCTIONS, parts
from friction_estimator.core.errors import InputError

COLUMNS = {
    "tau": np.array([1.0, 2.0, 3.0]),
    "acc": np.array([0.5, -1.0, 2.0]),
    "q": np.array([0.1, 0.2, 0.4]),
    "v": np.array([10.0, -20.0, 0.0]),
    "v [mm/s]": np.array([1.0, 2.0, 4.0]),
    "Motor Speed (rpm)": np.array([60.0, 120.0, 0.0]),
    "T [degF]": np.array([32.0, 212.0, 130.0]),
    "rig.log[1]": np.array([7.0, 8.0, 9.0]),
    "2": np.array([4.0, 5.0, 6.0]),
    "v-1": np.array([1.0, 1.0, 1.0]),
    "a b": np.array([1.0, 2.0, 3.0]),
    "sin": np.array([5.0, 6.0, 7.0]),
}


def value(text, inputs=()):
    return Expression.parse(text, COLUMNS, inputs).value(COLUMNS.__getitem__, derivative=np.gradient)


def failure(text, inputs=()):
    with pytest.raises(InputError) as caught:
        value(text, inputs)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("tau-0.0189*acc-1.2*sin(q)", COLUMNS["tau"] - 0.0189 * COLUMNS["acc"] - 1.2 * np.sin(COLUMNS["q"])),
        ("-tau**2", -(COLUMNS["tau"] ** 2)),
        ("2**3**2*tau", 512.0 * COLUMNS["tau"]),
        ("tau / acc / 2", COLUMNS["tau"] / COLUMNS["acc"] / 2.0),
        ("(tau+acc)*-1e-3", -1e-3 * (COLUMNS["tau"] + COLUMNS["acc"])),
        ("atan2(tau, acc) + min(tau, 2) - max(acc, 0)", None),
        ("q*180/pi", np.degrees(COLUMNS["q"])),
        ("rig.log[1]*1e-3", 1e-3 * COLUMNS["rig.log[1]"]),
        ("v-1", COLUMNS["v-1"]),  # a column of that very name comes first
        ("v - 1", COLUMNS["v"] - 1.0),
        ('"v"-1', COLUMNS["v"] - 1.0),
        ("2", COLUMNS["2"]),
        ("tau*2", 2.0 * COLUMNS["tau"]),
        ("tau*'2'", COLUMNS["tau"] * COLUMNS["2"]),
        ("a b*a b", COLUMNS["a b"] ** 2),
        ("sin", COLUMNS["sin"]),
        ("sin(sin)", np.sin(COLUMNS["sin"])),
        ("d(tau*3)", np.full(3, 3.0)),
    ],
)
def test_what_an_expression_comes_to(text, expected):
    if expected is None:
        expected = (
            np.arctan2(COLUMNS["tau"], COLUMNS["acc"]) + np.minimum(COLUMNS["tau"], 2) - np.maximum(COLUMNS["acc"], 0)
        )
    np.testing.assert_allclose(value(text).data, expected, rtol=1e-15)


@pytest.mark.parametrize(
    ("text", "expected", "kind"),
    [
        ("v[mm/s]", 1e-3 * COLUMNS["v"], "a linear velocity"),
        ("v [mm/s]", 1e-3 * COLUMNS["v [mm/s]"], "a linear velocity"),
        ('"v [mm/s]"[m/s]', COLUMNS["v [mm/s]"], "a linear velocity"),  # the map knows better than the header
        ("Motor Speed", 2 * np.pi / 60 * COLUMNS["Motor Speed (rpm)"], "a rotary velocity"),
        ("-q[deg]", -np.radians(COLUMNS["q"]), "a rotary position"),
        ("d(q[deg])", np.gradient(np.radians(COLUMNS["q"])), "a rotary velocity"),
        ("tau[mN m]-0.1*acc", 1e-3 * COLUMNS["tau"] - 0.1 * COLUMNS["acc"], "a torque"),
        ("(tau+acc)[kN]", 1e3 * (COLUMNS["tau"] + COLUMNS["acc"]), "a linear force"),
        ("T", np.array([0.0, 100.0, 54.4444444444]), "a temperature"),
        ("tau[bar]+101325", 1e5 * COLUMNS["tau"] + 101325.0, "a pressure"),
        ("0.05*tau[N]", 0.05 * COLUMNS["tau"], "None"),  # a lever may make a torque of it
    ],
)
def test_units(text, expected, kind):
    found = value(text)
    np.testing.assert_allclose(found.data, expected, rtol=1e-9)
    assert str(found.kind) == kind


@pytest.mark.parametrize("text", ["tau/(acc-acc)", "log(tau-tau)", "sqrt(-tau)", "10.0**(300*tau)*1e300", "0/(q-q)"])
def test_what_has_no_answer_is_no_number_and_no_failure(text):
    assert not np.isfinite(value(text).data).any()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("tua", "no column 'tua'; nearest: tau"),
        ("2*Motor Sped", "no column 'Motor Sped'; nearest: Motor Speed"),
        ("xyzzy", "no column 'xyzzy'; columns: tau, acc, q,"),
        ("sinn(q)", "no function 'sinn'; nearest: sin"),
        ("eval(q)", "no function 'eval'; functions: abs, sqrt"),
        ("sin(q, 2)", "sin takes 1 argument, 2 are given"),
        ("min(q)", "min takes 2 arguments, 1 are given"),
        ("tau^2", "a power is written **"),
        ("tau acc", "an operator is expected at 'acc'"),
        ("tau*", "are brackets and operators complete?"),
        ("(tau", "are brackets and operators complete?"),
        ("tau)", "are brackets and operators complete?"),
        ("tau,acc", "a comma stands between the arguments of a function only"),
        ("'tau", "'tau has no closing quote"),
        ("tau*0", "a factor of zero leaves nothing of tau"),
        ("tau/0", "a division by zero leaves nothing of tau"),
        ("1e999*tau", "1e999 is too large for a number"),
        ("d(3)", "the derivative of a constant"),
        ("v[lightyear]", "[lightyear] is no unit"),
        ("tau[N m]+v[m/s]", "a torque and a linear velocity cannot be added"),
        ("v [mm/s]*1e-3", "column v [mm/s] is in mm/s by its own name"),
        ("v [mm/s]/1000", "would convert it twice"),
        ("Motor Speed*2*pi/60", "the factor 0.1047 would convert it twice"),
        ("(T-32)/1.8", "the offset 32 would convert it twice"),
        ("-" * 1500 + "tau", "is nested too deeply"),
        ("(" * 900 + "tau" + ")" * 900, "cannot be read"),
        ("tau+" * 600 + "tau", "more than 2000 characters"),
    ],
)
def test_what_cannot_be_read_is_said_in_one_line(text, words):
    assert words in failure(text)


# What a reader of Python's own text would have run. Nothing of it can even be spelt.
@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('true')",
        "().__class__.__bases__[0].__subclasses__()",
        "tau.tofile('x')",
        "tau.dump('x')",
        "open('/etc/passwd').read()",
        "lambda: 1",
        "[q for q in tau]",
        "tau if acc else q",
        "tau := 1",
        "tau; acc",
        "f'{tau}'",
        "tau @ acc",
        "tau[0]",
        "tau[:]",
        "{tau: 1}",
        "tau == acc",
        "sin(*tau)",
        "sin(x=tau)",
        "0x10*tau",
        "1_000*tau",
        "tau+acc import os",
    ],
)
def test_python_is_no_arithmetic(text):
    assert failure(text)


def test_a_large_power_is_infinite_at_once():
    assert np.isinf(value("9**9**9**9*tau").data).all()


def test_other_inputs_by_their_names():
    found = Expression.parse("d(position)-v", COLUMNS, {"position"})
    assert (found.columns, found.inputs) == (("v",), ("position",))
    said = failure("q*2", {"q"})
    assert 'q is a column and an input of this map that is something else: write the column in quotes ("q")' in said
    assert Expression.parse('"q"*2', COLUMNS, {"q"}).columns == ("q",)


@settings(derandomize=True, max_examples=300, deadline=None)
@given(st.text("taucqv0123.eE+-*/()[],'\" \n_é", max_size=30) | st.text(max_size=20))
def test_any_text_is_a_value_or_one_line(text):
    with suppress(InputError):  # nothing else may come
        Expression.parse(text, COLUMNS).value(COLUMNS.__getitem__, derivative=np.gradient)


def test_every_function_is_numpy_s_on_arrays():
    for name, (function, arguments) in FUNCTIONS.items():
        text = f"{name}({', '.join(['q'] * arguments)})"
        np.testing.assert_array_equal(value(text).data, function(*[COLUMNS["q"]] * arguments))


def test_commas_within_brackets_and_quotes_separate_nothing():
    assert parts("a=min(f,9),b='x,y',c=q[N,m]") == ["a=min(f,9)", "b='x,y'", "c=q[N,m]"]
