"""What the pages show: fenced blocks of shell commands with the output that they promise, of programs and of settings.

A block of `sh` holds commands. A block without a language that follows one, with nothing but empty lines between, is
what the commands print: `...` alone on a line stands for any lines, and numbers may differ by `TOLERANCE`.
"""

import re
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

PAGES = (
    "README.md",
    "CONTRIBUTING.md",
    "bags/README.md",
    *sorted(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md")),
)

TOLERANCE = 0.05
"""Relative difference of a printed number: compilers and libraries round differently, and a fit stops elsewhere."""

_FENCE = re.compile(r"^(?P<fence>`{3,})(?P<language>[^`\n]*)\n(?P<text>.*?)^(?P=fence)$", re.MULTILINE | re.DOTALL)
_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w.]*\w)")
_PLAIN = re.compile(r"friction_estimator [^|<>&;$`*]*")


@dataclass(frozen=True)
class Block:
    """A fenced block: language, text, the line after the fence, and whether it follows the block before it at once."""

    language: str
    text: str
    line: int
    follows: bool


@dataclass(frozen=True)
class Command:
    """A command of a page, with the output that the page promises of its block."""

    page: str
    line: int
    text: str
    output: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.page}:{self.line}: {self.text}"

    @property
    def words(self) -> list[str]:
        """The words of a command of ours that asks nothing of the shell, without the program; empty for others."""
        words = shlex.split(self.text.replace("\\\n", " "), comments=True)
        return words[1:] if _PLAIN.fullmatch(shlex.join(words).replace("'", "")) else []


def blocks(page: str, root: Path = ROOT) -> list[Block]:
    """Return the fenced blocks of a page, in order."""
    text = (root / page).read_text(encoding="utf-8")
    found, end = [], 0
    for match in _FENCE.finditer(text):
        line = text.count("\n", 0, match.start()) + 2
        found.append(Block(match["language"].strip(), match["text"], line, not text[end : match.start()].strip()))
        end = match.end()
    return found


def commands(page: str) -> list[Command]:
    """Return the commands of a page, in order; the last one of a block has the output that is promised of the block."""
    found: list[Command] = []
    for block in blocks(page):
        if block.language == "sh":
            found += [Command(page, line, text) for line, text in _logical(block)]
        elif not block.language and block.follows and found:
            found[-1] = Command(page, found[-1].line, found[-1].text, tuple(block.text.splitlines()))
    return found


def missing(promised: Sequence[str], printed: str) -> list[str]:
    """Return the promised lines that were not printed in that order.

    >>> missing(["nrmse 0.100", "...", "found: inertia"], "nrmse 0.102\\nmore\\nfound: inertia\\n")
    []
    >>> missing(["nrmse 0.100"], "nrmse 0.2")
    ['nrmse 0.100']
    """
    lines = iter(printed.splitlines())
    return [
        want for want in promised if want.strip() not in ("", "...") and not any(_alike(want, got) for got in lines)
    ]


def _alike(want: str, got: str) -> bool:
    shape = [" ".join(_NUMBER.sub("#", text).split()) for text in (want, got)]
    if shape[0] != shape[1]:
        return False
    pairs = zip(_NUMBER.findall(want), _NUMBER.findall(got), strict=True)
    return all(abs(float(a) - float(b)) <= max(TOLERANCE * abs(float(a)), 1e-9) for a, b in pairs)


def _logical(block: Block) -> Iterator[tuple[int, str]]:
    """Return the commands of a block with their lines; a backslash or a here-document carries one on."""
    kept: list[str] = []
    ending, start = "", 0
    for number, text in enumerate(block.text.splitlines()):
        if not kept and (not text.strip() or text.lstrip().startswith("#")):
            continue
        start = start if kept else number
        kept.append(text)
        document = re.search(r"<<-?\s*'?(\w+)'?", text)
        ending = document[1] if document and not ending else ending
        if (ending and text != ending) or text.endswith("\\"):
            continue
        yield block.line + start, "\n".join(kept)
        kept, ending = [], ""
