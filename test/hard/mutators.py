"""Changes to a file that an attack makes: of any bytes, and of what a format is made of.

A mutator takes a random generator and the bytes of a sound file, and returns other bytes. The same generator state
gives the same bytes, so the number of an input is enough to make it again.
"""

import io
import random
import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Sequence

Mutator = Callable[[random.Random, bytes], bytes]

_EDGES = [0, 1, 2, 7, 127, 128, 255, 256, 32767, 65535, 2**24, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1, 2**64 - 1]
"""Numbers at which lengths, counts and offsets break."""

_WORDS = [
    "", " ", "nan", "inf", "-inf", "1e308", "-1e308", "1e-300", "1e999", "0", "-1", "0x10", "1_000", "9" * 400, "1e18",
    "true", "null", "~", "[]", "{}", "&a [*a]", "*a", "!!int x", "!!python/name:os", "2001-99-99", "'", '"', ",", ";",
    "\t", "\n", "\r", "\0", "\x1b[31m", "\u202e", "é", "\ud800", "a" * 5000, "A:B:C", "- -", "?", "|", "%s", "../..",
    "/dev/zero", "-40", "150", "54.4", "1.7976931348623157e308",
]  # fmt: skip
"""Texts at which cells and scalars break."""


def _place(rng: random.Random, data: bytes, width: int = 1) -> int:
    """Return a place in the data; the ends, where heads and footers stand, come more often."""
    last = max(0, len(data) - width)
    pick = rng.random()
    if pick < 0.2:
        return min(last, rng.randrange(64))
    if pick < 0.35:
        return max(0, last - rng.randrange(64))
    return rng.randrange(last + 1)


def flip(rng: random.Random, data: bytes) -> bytes:
    """Change some bits."""
    changed = bytearray(data or b"\0")
    for _ in range(rng.choice((1, 1, 1, 2, 4, 16))):
        changed[_place(rng, changed)] ^= 1 << rng.randrange(8)
    return bytes(changed)


def overwrite(rng: random.Random, data: bytes) -> bytes:
    """Replace a stretch by noise, zeros or ones."""
    size = rng.choice((1, 4, 16, 64, 512))
    start = _place(rng, data)
    new = rng.choice((rng.randbytes(size), bytes(size), b"\xff" * size))
    return data[:start] + new[: max(0, len(data) - start)] + data[start + size :]


def truncate(rng: random.Random, data: bytes) -> bytes:
    """Cut off the end, or the beginning."""
    place = _place(rng, data)
    return data[:place] if rng.random() < 0.8 else data[place:]


def splice(rng: random.Random, data: bytes) -> bytes:
    """Remove a stretch, or repeat it, or put it elsewhere."""
    start = _place(rng, data)
    stretch = data[start : start + rng.choice((1, 8, 64, 1024))]
    rest = data[:start] + data[start + len(stretch) :]
    at = _place(rng, data)
    return rng.choice(
        (
            lambda: rest,
            lambda: data[:start] + stretch * rng.choice((2, 3, 100)) + data[start + len(stretch) :],
            lambda: rest[:at] + stretch + rest[at:],
        )
    )()


def number(rng: random.Random, data: bytes) -> bytes:
    """Write an awkward number over a field of 1 to 8 bytes."""
    width = rng.choice((1, 2, 4, 4, 8, 8))
    start = _place(rng, data, width)
    if rng.random() < 0.5:
        start -= start % width
    value = rng.choice(_EDGES) % 256**width
    if rng.random() < 0.4:
        value = (int.from_bytes(data[start : start + width], "little") + rng.choice((-1, 1, 8, 255))) % 256**width
    return data[:start] + value.to_bytes(width, rng.choice(("little", "little", "big"))) + data[start + width :]


GENERIC: tuple[Mutator, ...] = (flip, flip, overwrite, truncate, splice, number, number)


def inside(rng: random.Random, data: bytes, start: int, stop: int) -> bytes:
    """Change data[start:stop] by one of `GENERIC` and keep its length."""
    if start >= stop:
        return flip(rng, data)
    part = rng.choice((flip, overwrite, number))(rng, data[start:stop])
    return data[:start] + part[: stop - start].ljust(stop - start, b"\0") + data[stop:]


def mcap_record(rng: random.Random, data: bytes) -> bytes:
    """Change, drop, repeat or exchange whole records, those inside an uncompressed chunk too; checksums are removed."""
    places = [(at, end, code) for at, end, code in _mcap_places(data, 8, len(data) - 8)]
    if not places:
        return flip(rng, data)
    for at, end, code in places:
        if code == 6 and end - at > 60:  # a chunk's checksum would hide what is changed in it
            data = data[: at + 33] + bytes(4) + data[at + 37 :]
            inner = at + 9 + 40 + struct.unpack_from("<I", data, at + 37)[0]
            places += _mcap_places(data, inner, end)
            break
    start, stop, _ = rng.choice(places)
    pick = rng.random()
    if pick < 0.5:
        return inside(rng, data, min(start + 9, stop), stop)
    if pick < 0.65:
        return inside(rng, data, start, min(start + 9, stop))
    if pick < 0.8:
        return data[:start] + data[stop:]
    other, end, _ = rng.choice(places)
    return data[:start] + data[other:end] + data[stop if rng.random() < 0.5 else start :]


def _mcap_places(data: bytes, at: int, stop: int) -> list[tuple[int, int, int]]:
    places = []
    while at >= 0 and at + 9 <= min(stop, len(data)):
        code, size = struct.unpack_from("<BQ", data, at)
        if at + 9 + size > stop:
            break
        places.append((at, at + 9 + size, code))
        at += 9 + size
    return places


def sqlite_page(rng: random.Random, data: bytes, size: int = 4096) -> bytes:
    """Change the head or the cell places of a page, or exchange pages."""
    pages = [data[k : k + size] for k in range(0, len(data), size)] or [b""]
    k = rng.randrange(len(pages))
    if rng.random() < 0.2:
        pages[k] = rng.choice(pages)
        return b"".join(pages)
    head = 100 if k == 0 and rng.random() < 0.5 else 0
    stop = rng.choice((12, 40, 200, size))
    pages[k] = inside(rng, pages[k], head, min(head + stop, len(pages[k])))
    return b"".join(pages)


def ros1_field(rng: random.Random, data: bytes) -> bytes:
    """Change the value of a record's header field, or a length before it."""
    names = rb"op|conn|count|size|time|chunk_pos|ver|index_pos|compression|topic|type|offset"
    fields = [match.span(1) for match in re.finditer(rb"(?:" + names + rb")=(.{1,12})", data, re.DOTALL)]
    if not fields:
        return flip(rng, data)
    start, stop = rng.choice(fields)
    if rng.random() < 0.4:
        start = max(0, start - 12)
    return inside(rng, data, start, stop)


def npz_member(rng: random.Random, data: bytes) -> bytes:
    """Change the head or the numbers of a member, and pack it soundly again, plain or compressed."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
    except Exception:  # the bytes come from a corpus that the attack itself has changed
        return flip(rng, data)
    if not members:
        return flip(rng, data)
    name = rng.choice(list(members))
    content = members.pop(name)
    head = 10 + (struct.unpack_from("<H", content, 8)[0] if len(content) >= 10 else 0)
    pick = rng.random()
    if pick < 0.4:
        content = text_token(rng, content[:head]) + content[head:]
    elif pick < 0.7:
        content = inside(rng, content, 0, min(head, len(content)))
    else:
        content = rng.choice(GENERIC)(rng, content)
    members[rng.choice((name, name, name, "x.npy", "../x.npy", "\x1b[31m.npy"))] = content
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as archive:
        for other, body in members.items():
            archive.writestr(other, body)
    return packed.getvalue()


def mat_element(rng: random.Random, data: bytes) -> bytes:
    """Change a tag of eight bytes or what stands behind it; what is compressed is unpacked before and packed after."""
    if len(data) > 136 and struct.unpack_from("<I", data, 128)[0] == 15 and rng.random() < 0.8:
        size = struct.unpack_from("<I", data, 132)[0]
        try:
            inner = zlib.decompress(data[136 : 136 + size])
        except zlib.error:
            return flip(rng, data)
        packed = zlib.compress(_mat_tag(rng, inner, 0))
        return data[:128] + struct.pack("<II", 15, len(packed)) + packed + data[136 + size :]
    return _mat_tag(rng, data, min(128, len(data)))


def _mat_tag(rng: random.Random, data: bytes, start: int) -> bytes:
    words = max(1, (len(data) - start) // 8)
    at = start + 8 * min(rng.randrange(words), rng.randrange(words))
    kind = rng.choice((None, *range(1, 19)))
    if kind is None:
        return inside(rng, data, at, at + 8)
    half = at + 4 * rng.randrange(2)
    value = kind if half == at else rng.choice((*_EDGES[:14], kind, 8 * kind))
    return data[:half] + struct.pack("<I", value % 2**32) + data[half + 4 :]


def parquet_footer(rng: random.Random, data: bytes) -> bytes:
    """Change the thrift footer, or its length, or a page's head."""
    if len(data) < 12:
        return flip(rng, data)
    size = min(struct.unpack_from("<I", data, len(data) - 8)[0], len(data) - 12)
    start = len(data) - 8 - size
    if rng.random() < 0.75:
        return inside(rng, data, start, len(data) - rng.choice((8, 8, 8, 0)))
    return inside(rng, data, 4, max(5, start))


def text_token(rng: random.Random, data: bytes) -> bytes:
    """Replace a number or a word by another, awkward one."""
    tokens = [match.span() for match in re.finditer(rb"[\w.+-]+", data)]
    if not tokens:
        return data + rng.choice(_WORDS).encode("utf-8", "surrogatepass")
    start, stop = rng.choice(tokens)
    new = rng.choice(_WORDS).encode("utf-8", "surrogatepass")
    if rng.random() < 0.3:
        other = rng.choice(tokens)
        new = data[other[0] : other[1]]
    return data[:start] + new + data[stop:]


def text_line(rng: random.Random, data: bytes) -> bytes:
    """Drop, repeat, exchange, indent or nest lines."""
    lines = data.split(b"\n")
    k, j = rng.randrange(len(lines)), rng.randrange(len(lines))
    pick = rng.randrange(6)
    if pick == 0:
        del lines[k]
    elif pick == 1:
        lines[k:k] = [lines[j]] * rng.choice((1, 2, 300))
    elif pick == 2:
        lines[k], lines[j] = lines[j], lines[k]
    elif pick == 3:
        lines[k] = rng.choice((b" ", b"  ", b"\t", b"- ")) * rng.choice((1, 2, 50)) + lines[k]
    elif pick == 4:
        lines[k] = lines[k].lstrip()
    else:
        lines[k] = lines[k].replace(b":", b": " + rng.choice((b"[", b"{", b"&x ", b"*x ", b"!!set ")) * 30, 1)
    return b"\n".join(lines)


def table_cell(rng: random.Random, data: bytes) -> bytes:
    """Replace cells, a separator or a whole column's width."""
    lines = data.split(b"\n")
    k = rng.randrange(len(lines))
    cells = lines[k].split(b",")
    for _ in range(rng.choice((1, 1, 3))):
        cells[rng.randrange(len(cells))] = rng.choice(_WORDS).encode("utf-8", "surrogatepass")
    if rng.random() < 0.2:
        cells *= rng.choice((2, 100, 5000))
    lines[k] = rng.choice((b",", b",", b",", b";", b"\t", b"")).join(cells)
    return b"\n".join(lines)


def mutated(rng: random.Random, data: bytes, own: Sequence[Mutator]) -> bytes:
    """Return the data changed a few times, half of them by the format's own mutators."""
    for _ in range(rng.choice((1, 1, 1, 2, 3, 6))):
        data = rng.choice(own if own and rng.random() < 0.6 else GENERIC)(rng, data)
    return data
