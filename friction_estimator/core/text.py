"""Text from outside (topics, frames, joints, columns, file names, values, messages of libraries) made safe to show."""

LONGEST = 2000
"""Characters that one line for a terminal, a log or diagnostics holds at most."""

LONGEST_PARAGRAPH = 20_000
"""Characters of a paragraph or a line of a result: it may hold a command with many recordings, which is copied."""

PLAIN_BELOW = 1e6
"""Numbers below this are told without an exponent (`number`)."""

LONGEST_NAME = 200
"""Characters of one name or value within such a line."""


def shown(text: object, limit: int = LONGEST) -> str:
    r"""Return text as one line of printable characters, for a terminal, a log or a diagnostics message.

    What is not printable (`str.isprintable`: control characters, so line ends and terminal escapes, marks that change
    the direction of writing, lone surrogates, spaces other than the plain one) is written as an escape; a byte of a
    file name that is no UTF-8 as that byte. Text that is too long loses its middle, since a sentence begins with what
    is wrong and ends with what to do.

    The result passes unchanged through the function, so whoever shows text may apply it without asking who did before.

    Parameters
    ----------
    text : anything with a `str`.
    limit : longest result, characters; at least 40.

    Examples
    --------
    >>> print(shown("shaft\n[FATAL] \x1b[31mforged"))
    shaft\n[FATAL] \x1b[31mforged
    >>> print(shown("r\udce4der.mcap"), len(shown("a" * 1_000_000)))
    r\xe4der.mcap 2000
    """
    whole = str(text)
    if len(whole) <= limit:
        line = _line(whole)
        if len(line) <= limit:
            return line
    left_out = f" [... of {len(whole)} characters] "
    head = (limit - len(left_out)) * 2 // 3
    tail = limit - len(left_out) - head
    return _fitting(whole[:head], head) + left_out + _fitting(whole[-tail:], tail, from_end=True)


def number(value: float, digits: str) -> str:
    """Return a number as `format` does, but in plain digits up to a million: 100, not 1e+02, for 104 in two digits.

    >>> number(104.2, ".2g"), number(446_083.0, ".4g"), number(0.0312, ".2g"), number(2.5e9, ".2g")
    ('100', '446100', '0.031', '2.5e+09')
    """
    text = f"{value:{digits}}"
    return f"{float(text):.0f}" if "e+" in text and abs(value) < PLAIN_BELOW else text


def counted(count: int, noun: str) -> str:
    """Return a number with its noun.

    >>> counted(1, "recording"), counted(3, "recording")
    ('1 recording', '3 recordings')
    """
    return f"{count} {noun}{'s' * (count != 1)}"


def is_utf8(text: str) -> bool:
    r"""Return whether text can be written as UTF-8: the name of a file may hold bytes that are none.

    >>> is_utf8("räder"), is_utf8("r\udce4der")
    (True, False)
    """
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def _line(text: str) -> str:
    return text if text.isprintable() else "".join(map(_escape, text))


def _escape(character: str) -> str:
    if character.isprintable():
        return character
    if "\udc80" <= character <= "\udcff":  # os.fsdecode's way to keep a byte
        return f"\\x{ord(character) - 0xDC00:02x}"
    return character.encode("unicode_escape").decode("ascii")


def _fitting(text: str, room: int, *, from_end: bool = False) -> str:
    """Return as much of an end of the text as fits escaped, no escape cut in two."""
    pieces = [_escape(character) for character in text]
    if from_end:
        pieces.reverse()
    taken: list[str] = []
    for piece in pieces:
        room -= len(piece)
        if room < 0:
            break
        taken.append(piece)
    return "".join(reversed(taken) if from_end else taken)
