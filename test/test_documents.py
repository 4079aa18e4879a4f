"""The border for YAML and JSON: what is hostile or mistaken is refused in one line, within bounds."""

import os
import re
import socket

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from friction_estimator.core.errors import ConfigError, InputError
from friction_estimator.core.model.theory_table_file import read_table
from friction_estimator.core.regular_file import open_regular, read_regular
from friction_estimator.core.settings.config import PARAMETERS, Config
from friction_estimator.documents.configuration import parameter_text, read_config, read_parameters, write_config
from friction_estimator.documents.load import CONFIGURATION, Limits, parse_json, parse_yaml


def parameters(*lines):
    return "/**:\n  ros__parameters:\n" + "".join(f"    {line}\n" for line in lines)


def doubling(levels, unit, form):
    return [f"a0: &a0 {unit}", *(f"a{n}: &a{n} {form.format(n - 1)}" for n in range(1, levels))]


def refusal(call, *arguments):
    """Return the line with which something is refused, None where it is taken."""
    try:
        call(*arguments)
    except InputError as error:
        return str(error)
    return None


HOSTILE = {
    "a date that is none": ("unknown parameter x", parameters("x: 2001-99-99")),
    "a tag of another type": ("line 3: x is no integer", parameters('x: !!int "x"')),
    "a tag that is not read": ("line 3: the tag", parameters("x: !!timestamp x")),
    "a tag of Python": ("line 3: the tag", parameters("x: !!python/object/apply:os.getcwd []")),
    "no boolean": ("line 3: x is neither true nor false", parameters('x: !!bool "x"')),
    "no number": ("line 3: x is no number", parameters('x: !!float "x"')),
    "an integer of 400 digits": ("line 3: 999", parameters(f"force_unit: {'9' * 400}")),
    "an integer of 5000 digits": ("more than 64 bits", parameters(f"force_unit: {'9' * 5000}")),
    "a hexadecimal one": ("more than 64 bits", parameters(f"force_unit: 0x{'f' * 90000}")),
    "times of 90,000 parts": ("force_unit", parameters(f"force_unit: {'1:' * 45000}1")),
    "6000 lists in one another": ("line 1: it is nested deeper than 32", "[" * 6000),
    "sections in one another": ("nested deeper than 32", "\n".join(" " * n + "a:" for n in range(100))),
    "a reference to itself": ("line 3: a refers to itself", parameters("a: &a {b: *a}")),
    "a list that holds itself": ("line 3: a refers to itself", parameters("a: &a [*a]")),
    "an anchor given anew": ("line 4: found duplicate anchor 'a'", parameters("a: &a 1", "b: &a [*a]")),
    "doubling sections": ("more than 50000 values", parameters(*doubling(30, "{x: 1}", "{{x: *a{0}, y: *a{0}}}"))),
    "doubling lists": ("more than 50000 values", parameters(*doubling(30, "[x]", "[*a{0}, *a{0}]"))),
    "doubling merges": ("more than 50000 values", parameters(*doubling(30, "{x: 1}", "{{<<: [*a{0}, *a{0}]}}"))),
    "too many values": ("more than 50000 values", parameters(f"a: [{'1,' * 60000}]")),
    "too large": ("larger than 1 MiB", "#" * 2**20 + "#"),
    "a NUL in a path": ("line 3: text with a NUL", parameters(r'theory: {kind: table, table: "a\0b"}')),
    "half a surrogate pair": ("line 3: text with a NUL or half a sur", parameters(r'theory: {table: "\ud800"}')),
    "a NUL in a name": ("line 3: text with a NUL", parameters(r'"a\0b": 1')),
    "a section where a number goes": ("fir.order is an empty section, expected a value", parameters("fir.order: {}")),
    "a list in a list": ("velocity_range[0] is a list", parameters("basis.velocity_range: [[1, 2]]")),
    "a list where a word goes": ("theory.table: ['a'] is of type list", parameters("theory.table: [a]")),
    "a list for a name": ("line 3: a name is expected", parameters("[1, 2]: 3")),
    "a word where a list goes": ("velocity_range: 'wide' is no array", parameters("basis.velocity_range: wide")),
    "a list where parameters go": ("ros__parameters is a list, expected NAME: VALUE", "/**: {ros__parameters: [1]}"),
    "a word alone": ("it is 'word', expected the name of a node", "word"),
    "absurd velocities": ("out of range [-1e+09, 1e+09]", parameters("basis.velocity_range: [-1e308, 1e308]")),
    "an absurd unit": ("neither 0 nor at least 1e-12", parameters("basis.velocity_unit: 1e-320")),
    "an absurd force": ("neither 0 nor at least 1e-12", parameters("force_unit: 1e-320")),
    "absurd weights": ("out of range [-1e+06, 1e+06]", parameters("learned.fir_taps: [1e308]")),
    "two documents": ("line 2: expected a single document", "a: 1\n---\nb: 2\n"),
    "an end in the middle": ("line 4: while parsing a flow sequence, expected", parameters("a: [1, 2")),
    "control characters": ("line 2: unacceptable character", "a:\n  b\x07"),
    "no text": ("byte 3 is no UTF-8", b"a: \xff"),
}


@pytest.mark.parametrize(("words", "content"), HOSTILE.values(), ids=HOSTILE)
def test_a_hostile_configuration_is_one_line_with_its_name(tmp_path, words, content):
    file = tmp_path / "c.yaml"
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputError) as caught:
        read_config(file)
    line = str(caught.value)
    assert words in line
    assert str(file) in line
    assert line.isprintable()
    assert len(line) < 600


def test_the_collected_configurations_are_refused_or_read(shared_data):
    """Those that are read name a table or a joint that is judged where it is used."""
    read = []
    files = sorted((shared_data.parent / "hostile").glob("y_*.yaml"))
    assert len(files) >= 20
    for file in files:
        line = refusal(read_config, file)
        if line is None:
            read.append(file.stem)
        else:
            assert str(file) in line
            assert line.isprintable()
    assert set(read) <= {"y_joint", "y_listpath", "y_theory300", "y_theory2000"}


def test_only_regular_files_are_read_and_nothing_waits(tmp_path):
    pipe, folder, link, sock = (tmp_path / name for name in ("pipe", "folder", "link", "socket"))
    os.mkfifo(pipe)
    folder.mkdir()
    link.symlink_to("/dev/zero")
    (tmp_path / "loop").symlink_to("loop")
    with socket.socket(socket.AF_UNIX) as open_socket:
        open_socket.bind(str(sock))
        for path, words in (
            (pipe, "a named pipe"),
            (folder, "a folder"),
            (link, "a device"),
            ("/dev/zero", "a device"),
            (sock, "a socket"),
            (tmp_path / "none", "No such file"),
            (tmp_path / "loop", "symbolic links"),
            ("a\0b", "no file name"),
            ("\ud800", "no file name"),
            ("x" * 5000, "File name too long"),
        ):
            for read in (open_regular, read_config, lambda p: read_regular(p, 100), read_table):
                with pytest.raises(InputError, match=words) as caught:
                    read(path)
                assert "cannot read" in str(caught.value)
                assert str(caught.value).isprintable()


def test_a_file_is_read_to_its_limit(tmp_path):
    file = tmp_path / "f"
    file.write_bytes(b"x" * 100)
    (tmp_path / "link").symlink_to(file)
    assert read_regular(tmp_path / "link", 100) == b"x" * 100
    with pytest.raises(InputError, match="larger than"):
        read_regular(file, 99)
    assert read_regular("/proc/self/status", 2**20)  # its size is 0
    with pytest.raises(InputError, match="larger than"):
        read_regular("/proc/self/status", 10)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 1e-3), ("-2E-1", -0.2), (".5", 0.5), ("1.", 1.0), ("08", 8.0), ("010", 8), ("0x1F", 31), ("-7", -7),
        ("+3", 3), ("on", True), ("No", False), ("y", "y"), ("2001-01-01", "2001-01-01"), ("1:30", "1:30"), ("=", "="),
        ("1_000", "1_000"), ("~", None), ("''", ""), (".inf", float("inf")), ("0", 0), ("- -1", [-1]), ("!!str 3", "3"),
    ],
)  # fmt: skip
def test_scalars_are_read_as_ros_reads_them(text, value):
    read = parse_yaml(text, "text")
    assert read == value
    assert type(read) is type(value)


def test_keys_are_words_and_aliases_unfold():
    assert parse_yaml("{on: &a [1, 2], 3: *a, b: &c {x: 1}, d: {<<: *c, y: 2}}", "text") == {
        "on": [1, 2],
        "3": [1, 2],
        "b": {"x": 1},
        "d": {"x": 1, "y": 2},
    }


values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63) + 1, 2**63 - 1)
    | st.floats(allow_nan=False)
    | st.text(st.characters(codec="utf-8", exclude_categories=("Cc", "Cs")), max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text("abcxyz._/*", min_size=1), inner, max_size=4),
    max_leaves=20,
)


@given(values)
def test_what_is_written_is_read_back(value):
    assert parse_yaml(parameter_text(value), "text") == value


@given(st.text(max_size=200))
def test_any_text_is_read_or_refused_in_one_line(text):
    line = refusal(parse_yaml, text, "text")
    assert line is None or (line.startswith("text") and line.isprintable())


@pytest.mark.parametrize(
    ("words", "content"),
    [
        ("nested deeper than 4", b"[" * 10 + b"]" * 10),
        ("nested deeper than 4", b'{"a":' * 15 + b"1" + b"}" * 15),
        ("more than 20 values", b"[" + b"[]," * 100000 + b"1]"),
        ("line 1 is no JSON", b"[1,"),
        ("more than 64 bits", b"[" + b"9" * 5000 + b"]"),
        ("no number of JSON", b"[NaN]"),
        ("no JSON", b"\xff\xfe{"),
        ("half a surrogate pair", b'["\\ud800"]'),
        ("half a surrogate pair", b'{"a\\u0000": 1}'),
    ],
)
def test_hostile_json_is_refused_in_one_line(words, content):
    with pytest.raises(InputError) as caught:
        parse_json(content, "s.json", Limits(size=10**6, depth=4, nodes=20))
    assert words in str(caught.value)
    assert str(caught.value).startswith("s.json")
    assert str(caught.value).isprintable()


def test_100000_lists_in_one_another_are_no_crash():
    limits = Limits(size=10**6, depth=50, nodes=10**6)
    with pytest.raises(InputError, match="nested deeper"):
        parse_json(b"[" * 100_000 + b"]" * 100_000, "deep.json", limits)


def test_the_largest_configuration_is_written_and_read_back(tmp_path):
    """4096 weights, the most that a basis may have."""
    rng = np.random.default_rng(1)
    config = Config.from_mapping(
        {
            "learned.velocity_range": [-0.1, 0.1],
            "learned.force_unit": 3.0,
            "learned.wavelet_weights": rng.standard_normal(4096).tolist(),
        }
    )
    file = tmp_path / "warm.yaml"
    write_config(file, config)
    assert read_config(file) == config
    assert file.stat().st_size < CONFIGURATION.size / 4


@pytest.mark.parametrize("item", PARAMETERS.values(), ids=PARAMETERS)
@pytest.mark.parametrize(
    "value",
    ["\ud800", "a\0b", "x" * 5000, 10**400, -(10**20), 1e308, -1e308, 5e-324, float("nan"), {}, b"x", {"a": 1}, [[1]]],
    ids=lambda v: repr(v)[:12],
)
def test_no_setting_takes_what_no_setting_can_be(item, value):
    """Alone or as the element of an array; what is of the right type is within its range."""
    for given_ in (value, [value]) if item.is_array else (value,):
        line = refusal(item.checked, given_)
        if line is None:
            assert item.element is float
            assert np.ravel(given_) == 5e-324, "a small number may be as good as zero, a large one is absurd"
        else:
            assert item.name in line
            assert line.isprintable()
            assert len(line) < 600


@pytest.mark.parametrize(
    ("content", "line", "name"),
    [
        ("/**: {ros__parameters: {model.law: lms}}\n/**: {ros__parameters: {force_unit: 2.0}}\n", 2, "/**"),
        ("/**:\n  ros__parameters:\n    model: {law: lms}\n    model: {type: hammerstein}\n", 4, "model"),
    ],
)
def test_no_section_is_lost_beside_a_second_of_its_name(tmp_path, content, line, name):
    """As it was, the first was passed over in silence; rcl, and so the node, takes both."""
    path = tmp_path / "twice.yaml"
    path.write_text(content)
    with pytest.raises(ConfigError, match=re.escape(f"twice.yaml line {line}: {name} stands here a second time")):
        read_config(path)


def test_what_is_merged_may_be_replaced():
    assert parse_yaml("{a: &a {x: 1, y: 2}, b: &b {<<: *a, x: 3}, c: {<<: *b, y: 4}}", "text")["c"] == {"x": 3, "y": 4}


def test_a_file_for_several_nodes_may_name_them_below_their_namespace(tmp_path):
    file = tmp_path / "several.yaml"
    file.write_text(parameters("fir.order: 3") + "left:\n  camera: {ros__parameters: {a: [x, y]}}\n")
    assert read_parameters(file) == {"fir.order": 3}


def test_comments_alone_are_the_defaults(tmp_path):
    file = tmp_path / "empty.yaml"
    file.write_text("# nothing\n")
    assert read_config(file) == Config()


def test_yaml_is_read_by_one_loader_only():
    """Another one would have other limits."""
    from pathlib import Path

    import friction_estimator

    package = Path(friction_estimator.__file__).parent
    for path in package.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        # bag/apart.py speaks JSON with a process of its own, output/journal.py reads back what it wrote.
        if path.relative_to(package) not in map(Path, ("documents/load.py", "bag/apart.py", "output/journal.py")):
            assert not any(word in text for word in ("yaml.load", "yaml.safe_load", "json.load")), path
