"""Fonts of a PDF: the outlines and widths of the glyphs are those of the whole font."""

import io
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from fontTools.ttLib import TTFont
from matplotlib.ft2font import FT2Font, LoadFlags

from rmpc_bench.figures.pdf_fonts import subset_of

FONTS = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
FLAGS = LoadFlags.NO_SCALE | LoadFlags.NO_HINTING


@pytest.mark.parametrize(
    "name", ["DejaVuSans.ttf", "DejaVuSans-Oblique.ttf", "STIXGeneral.ttf", "DejaVuSansMono.ttf", "cmr10.ttf"]
)
def test_glyphs(name):
    """Oracle: FreeType reads every glyph of the whole font; accented letters consist of others."""
    font = FT2Font(FONTS / name)
    letters = font.get_charmap()
    glyphs = {letters[code] for code in map(ord, "aäÄgé−0.5[]αµ") if code in letters} | set(
        list(letters.values())[:300]
    )
    data, index = subset_of(str(FONTS / name), glyphs)
    assert set(index) == glyphs and len(data) < (FONTS / name).stat().st_size
    small = FT2Font(io.BytesIO(data))
    for glyph in glyphs:
        expected = font.load_glyph(glyph, flags=FLAGS)
        path = font.get_path()
        found = small.load_glyph(index[glyph], flags=FLAGS)
        assert found.horiAdvance == expected.horiAdvance and found.bbox == expected.bbox
        assert all(np.array_equal(one, other) for one, other in zip(small.get_path(), path, strict=True))


def test_tables():
    """fontTools finds the checksums right and every glyph readable."""
    data, index = subset_of(str(FONTS / "DejaVuSans.ttf"), {36, 37, 200})
    font = TTFont(io.BytesIO(data), checkChecksums=2, lazy=False)
    assert {"glyf", "head", "hhea", "hmtx", "loca", "maxp"} <= set(font.keys()) and "fpgm" not in font
    assert font["maxp"].numGlyphs == len(font.getGlyphOrder()) >= 4
    assert all(not getattr(glyph, "program", None) for glyph in map(font["glyf"].__getitem__, font.getGlyphOrder()))
    assert sorted(index) == [36, 37, 200]


def test_other_fonts(tmp_path):
    """A file without TrueType outlines is left to fontTools."""
    file = tmp_path / "a.otf"
    file.write_bytes(b"OTTO" + bytes(100))
    assert subset_of(str(file), {1}) is None
    file = tmp_path / "b.ttf"
    file.write_bytes(b"\x00\x01\x00\x00" + bytes(100))
    assert subset_of(str(file), {1}) is None
