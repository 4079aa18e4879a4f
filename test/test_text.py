"""Text from outside, made safe to show: `core/text.py`."""

import unicodedata

from hypothesis import given
from hypothesis import strategies as st

from friction_estimator.core.text import LONGEST, LONGEST_NAME, shown

ANY_TEXT = st.text(st.characters(exclude_categories=()))


@given(ANY_TEXT, st.integers(40, 300))
def test_one_printable_line_of_bounded_length(text: str, limit: int) -> None:
    line = shown(text, limit)
    assert line.isprintable()
    assert len(line) <= limit
    line.encode("utf-8")  # no lone surrogate


@given(ANY_TEXT, st.integers(40, 300))
def test_showing_twice_changes_nothing(text: str, limit: int) -> None:
    line = shown(text, limit)
    assert shown(line, limit) == line
    assert shown(line, LONGEST) == line


@given(st.text(st.characters(codec="utf-8", categories=("L", "N", "P", "S", "M")), max_size=40))
def test_what_is_printable_stays(text: str) -> None:
    kept = "".join(c for c in text if c.isprintable())  # a younger Unicode than Python's own
    assert shown(kept) == kept


def test_every_control_format_and_surrogate_character_is_escaped() -> None:
    for code in (
        *range(0x20),
        *range(0x7F, 0xA0),
        0x2028,
        0x2029,
        0x202E,
        0x2066,
        0x200B,
        0xFEFF,
        0xD800,
        0xDFFF,
        0xE0001,
    ):
        assert unicodedata.category(chr(code)) in {"Cc", "Cf", "Cs", "Zl", "Zp"}
        line = shown(f"a{chr(code)}b")
        assert line.isascii()
        assert line.startswith("a\\")
        assert line.endswith("b")


def test_long_text_keeps_both_ends() -> None:
    line = shown("cannot read " + "x" * 1_000_000 + ": give another file", LONGEST_NAME)
    assert line.startswith("cannot read x")
    assert line.endswith("x: give another file")
    assert "of 1000031 characters" in line


def test_no_escape_is_cut_in_two() -> None:
    line = shown("\x1b" * 1000, 101)
    assert set(line.partition(" [")[0].split("\\")) == {"", "x1b"}
    assert set(line.partition("] ")[2].split("\\")) == {"", "x1b"}
