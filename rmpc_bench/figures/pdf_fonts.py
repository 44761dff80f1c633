"""Fonts in PDF files: only the glyphs that are shown, without the tables that a PDF has no use for.

Format  OpenType specification 1.9: the tables cvt, fpgm and prep and the instructions of the glyphs, which only coarse
        screens use, are left out, and so are all tables that a PDF has no use for.
Reason  fontTools reads every table of a font and takes 0.1 s for each font of each picture; this takes 2 ms.
"""

from __future__ import annotations

import struct
import sys
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache
from importlib import util
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from rmpc_bench.types import Array

_COPIED = (b"head", b"hhea", b"maxp")
_NEEDED = (*_COPIED, b"glyf", b"hmtx", b"loca")
_TRUE_TYPE = (b"\x00\x01\x00\x00", b"true")
_WORDS, _SCALE, _MORE, _TWO_SCALES, _TWO_BY_TWO, _INSTRUCTIONS = 0x1, 0x8, 0x20, 0x40, 0x80, 0x100
"""Flags of a component of a glyph that consists of others."""
_CHECKSUM = 0xB1B0AFBA


class Tables(NamedTuple):
    """The tables of a font that are used."""

    data: Mapping[bytes, bytes]
    offsets: Array
    """Of the glyphs in the table glyf, and the end of the last one."""
    n_metrics: int
    """Number of glyphs with an advance width of their own."""


def subset_of(file: str, glyphs: Collection[int]) -> tuple[bytes, dict[int, int]] | None:
    """Return a font with some glyphs of another one, and its index of each; None for a font without TrueType."""
    tables = _tables(file)
    if tables is None:
        return None
    chosen = _with_components(tables, {0, *glyphs})
    index = {glyph: place for place, glyph in enumerate(chosen)}
    outlines = [_renumbered(_outline(tables, glyph), index) for glyph in chosen]
    ends = np.cumsum([0, *map(len, outlines)]).astype(">u4")
    head, hhea, maxp = (bytearray(tables.data[name]) for name in _COPIED)
    struct.pack_into(">I", head, 8, 0)
    # Offsets of four bytes; every glyph has a width of its own.
    struct.pack_into(">h", head, 50, 1)
    struct.pack_into(">H", hhea, 34, len(chosen))
    struct.pack_into(">H", maxp, 4, len(chosen))
    made = {b"head": bytes(head), b"hhea": bytes(hhea), b"maxp": bytes(maxp), b"loca": ends.tobytes()}
    made |= {b"glyf": b"".join(outlines), b"hmtx": b"".join(_metric(tables, glyph) for glyph in chosen)}
    return _assembled(made), {glyph: index[glyph] for glyph in glyphs}


@lru_cache(maxsize=16)
def _tables(file: str) -> Tables | None:
    """Read the tables of a font; None where it has no TrueType outlines."""
    data = Path(file).read_bytes()
    if data[:4] not in _TRUE_TYPE:
        return None
    found = {}
    for entry in range(struct.unpack_from(">H", data, 4)[0]):
        name, _, start, length = struct.unpack_from(">4sIII", data, 12 + 16 * entry)
        found[name] = data[start : start + length]
    if not set(_NEEDED) <= set(found):
        return None
    is_long = struct.unpack_from(">h", found[b"head"], 50)[0]
    raw = np.frombuffer(found[b"loca"], ">u4" if is_long else ">u2").astype(np.int64)
    n_metrics = struct.unpack_from(">H", found[b"hhea"], 34)[0]
    return Tables(found, raw if is_long else 2 * raw, n_metrics)


def _outline(tables: Tables, glyph: int) -> bytes:
    return tables.data[b"glyf"][tables.offsets[glyph] : tables.offsets[glyph + 1]]


def _metric(tables: Tables, glyph: int) -> bytes:
    """Return advance width and left bearing; the last glyphs share the width of the last one that has its own."""
    data, last = tables.data[b"hmtx"], tables.n_metrics - 1
    if glyph <= last:
        return data[4 * glyph : 4 * glyph + 4]
    bearing = 4 * tables.n_metrics + 2 * (glyph - tables.n_metrics)
    return data[4 * last : 4 * last + 2] + data[bearing : bearing + 2]


def _components(outline: bytes) -> list[tuple[int, int, int]]:
    """Return flags, place and glyph of the components of a glyph; none of a simple one."""
    found: list[tuple[int, int, int]] = []
    if len(outline) < 10 or struct.unpack_from(">h", outline, 0)[0] >= 0:
        return found
    place, flags = 10, _MORE
    while flags & _MORE:
        flags, glyph = struct.unpack_from(">HH", outline, place)
        found.append((flags, place, glyph))
        place += 4 + (4 if flags & _WORDS else 2)
        place += 2 if flags & _SCALE else 4 if flags & _TWO_SCALES else 8 if flags & _TWO_BY_TWO else 0
    return [*found, (0, place, -1)]


def _with_components(tables: Tables, glyphs: Collection[int]) -> list[int]:
    """Return glyphs with all that they consist of, in the order of the font."""
    found, left = set(glyphs), list(glyphs)
    while left:
        parts = {glyph for _, _, glyph in _components(_outline(tables, left.pop())) if glyph >= 0} - found
        found |= parts
        left += parts
    return sorted(found)


def _renumbered(outline: bytes, index: Mapping[int, int]) -> bytes:
    """Return an outline without instructions and with the new numbers of its components, padded to four bytes."""
    components = _components(outline)
    if components:
        *parts, (_, end, _) = components
        changed = bytearray(outline[:end])
        for flags, place, glyph in parts:
            struct.pack_into(">HH", changed, place, flags & ~_INSTRUCTIONS, index[glyph])
        outline = bytes(changed)
    elif len(outline) >= 10:
        n_contours = struct.unpack_from(">h", outline, 0)[0]
        place = 10 + 2 * n_contours
        n_instructions = struct.unpack_from(">H", outline, place)[0]
        outline = outline[:place] + b"\0\0" + outline[place + 2 + n_instructions :]
    return outline + b"\0" * (-len(outline) % 4)


def _assembled(tables: Mapping[bytes, bytes]) -> bytes:
    """Write tables with their directory and checksums."""
    power = len(tables).bit_length() - 1
    header = struct.pack(">4s4H", b"\0\1\0\0", len(tables), 16 << power, power, 16 * (len(tables) - (1 << power)))
    first, directory, body = 12 + 16 * len(tables), b"", b""
    starts = {}
    for name, data in sorted(tables.items()):
        starts[name] = first + len(body)
        directory += struct.pack(">4sIII", name, _sum(data), starts[name], len(data))
        body += data + b"\0" * (-len(data) % 4)
    font = bytearray(header + directory + body)
    struct.pack_into(">I", font, starts[b"head"] + 8, (_CHECKSUM - _sum(bytes(font))) % 2**32)
    return bytes(font)


def _sum(data: bytes) -> int:
    padded = data + b"\0" * (-len(data) % 4)
    return int(np.frombuffer(padded, ">u4").sum(dtype=np.uint64)) % 2**32


LAYOUT_TABLES = ("GDEF", "GPOS", "GSUB")
"""Tables of a font for the composition of texts, which take fontTools most of its time."""
_SLOW = "fontTools.subset"
"""Module that takes 0.1 s to import; matplotlib imports it for every PDF, and most PDF files do not need it."""


@contextmanager
def small_fonts() -> Iterator[None]:
    """Let matplotlib embed small fonts inside the block: by `subset_of`, and by fontTools what that does not read."""
    _import_when_used(_SLOW)
    from matplotlib.backends import _backend_pdf_ps

    module: Any = _backend_pdf_ps
    found, written = module.get_glyphs_subset, module.font_as_file

    @contextmanager
    def chosen(file: Any, glyphs: Collection[int]) -> Iterator[Any]:
        small = subset_of(str(file), frozenset(glyphs)) if hasattr(module, "SubsetResults") else None
        if small is not None:
            yield module.SubsetResults(BytesIO(small[0]), small[1])
            return
        with _without_layout_tables(), found(file, glyphs) as result:
            yield result

    module.get_glyphs_subset = chosen
    module.font_as_file = lambda font: font if isinstance(font, BytesIO) else written(font)
    try:
        yield
    finally:
        module.get_glyphs_subset, module.font_as_file = found, written


@contextmanager
def _without_layout_tables() -> Iterator[None]:
    """Let fontTools leave out what only a text processor and a coarse screen use."""
    from fontTools import subset

    usual = subset.Options

    def smaller(**settings: Any) -> Any:
        made = usual(**{**settings, "hinting": False})
        made.drop_tables = [*made.drop_tables, *LAYOUT_TABLES]
        return made

    subset.Options = smaller
    try:
        yield
    finally:
        subset.Options = usual


def _import_when_used(name: str) -> None:
    """Put a module in its place that is executed when an attribute of it is used."""
    if name in sys.modules:
        return
    spec = util.find_spec(name)
    if spec is None or spec.loader is None:
        return
    loader = util.LazyLoader(spec.loader)
    spec.loader = loader
    module = util.module_from_spec(spec)
    sys.modules[name] = module
    loader.exec_module(module)
    # Without the attribute `from package import module` would execute it.
    package, _, own = name.rpartition(".")
    setattr(sys.modules[package], own, module)
