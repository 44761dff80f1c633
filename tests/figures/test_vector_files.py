"""SVG and PDF from one draw show what a draw of their own shows, and the small fonts of a PDF what whole ones show."""

import io
import re
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from fontTools.ttLib import TTFont
from matplotlib.figure import Figure
from matplotlib.ft2font import FT2Font, LoadFlags
from pypdf import PdfReader

from rmpc_bench.figures.files import can_be_drawn_once, save, svg_of
from rmpc_bench.figures.pdf_fonts import subset_of
from rmpc_bench.figures.style import Rendering, style

BOTH = Rendering(formats=("svg", "pdf"))


def picture():
    """Lines, areas, markers, points of several sizes, hatches, texts of several angles, formulas, clipped parts."""
    rng = np.random.default_rng(1)
    with style():
        figure = Figure(figsize=(4, 3))
        one, other = figure.subplots(1, 2)
        one.plot(rng.normal(size=9), "o--", label="R-MPC, $c=10^{-1}$")
        one.fill_between(range(9), -1, 1, alpha=0.3, hatch="//")
        one.legend(title="upper end")
        other.scatter(rng.normal(size=30), rng.normal(size=30), s=rng.uniform(1, 20, 30), c="C1")
        other.set_xlim(-0.5, 0.5)
        other.set_ylabel("turned [rad$^2$]")
        other.annotate("lower end", (0, 0), rotation=30)
    return figure


def positions(file):
    """Word -> (x, y) of its start in points from the lower left corner."""
    found = {}

    def visit(text, cm, tm, font, size):
        if text.strip():
            found[text.strip()] = (cm[0] * tm[4] + cm[2] * tm[5] + cm[4], cm[1] * tm[4] + cm[3] * tm[5] + cm[5])

    PdfReader(file).pages[0].extract_text(visitor_text=visit)
    return found


def test_the_same_svg(tmp_path):
    figure = picture()
    expected = svg_of(figure)
    svg, _ = save(figure, tmp_path, "a", BOTH)
    assert svg.read_text() == expected and svg_of(figure) == expected


def test_the_same_pdf(tmp_path):
    """Oracle: a PDF from a draw of its own has the same paths; texts are within half a point of their places."""
    together = save(picture(), tmp_path, "a", BOTH)[1]
    (alone,) = save(picture(), tmp_path, "b", Rendering(formats=("pdf",)))
    found, expected = positions(together), positions(alone)
    assert set(found) == set(expected) and {"upper end", "lower end"} <= set(found)
    for word, place in expected.items():
        assert found[word] == pytest.approx(place, abs=0.5), word
    (words, numbers), (other_words, other_numbers) = (_operations(file) for file in (together, alone))
    assert words == other_words and len(words) > 100
    # The legend is as wide as its texts.
    np.testing.assert_allclose(numbers, other_numbers, atol=0.7)


def _operations(file):
    """Names of all operations but those of texts, and their numbers."""
    content = PdfReader(file).pages[0].get_contents().get_data().decode("latin-1")
    parts = re.sub(r"BT.*?ET", "", content, flags=re.S).split()
    numbers = [part for part in parts if re.fullmatch(r"-?[\d.]+", part)]
    return [part for part in parts if part not in numbers], np.array(numbers, dtype=float)


def test_pictures_with_images_are_drawn_for_each_format():
    """Their resolution depends on the format."""
    figure = Figure()
    axes = figure.subplots()
    assert can_be_drawn_once(figure)
    axes.plot([1, 2], rasterized=True)
    assert not can_be_drawn_once(figure)
    for draw in ("imshow", "pcolormesh"):
        figure = Figure()
        getattr(figure.subplots(), draw)([[1, 2], [3, 4]])
        assert not can_be_drawn_once(figure)


FONTS = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
FLAGS = LoadFlags.NO_SCALE | LoadFlags.NO_HINTING


@pytest.mark.parametrize("name", ["DejaVuSans", "DejaVuSans-Oblique", "STIXGeneral", "DejaVuSansMono", "cmr10"])
def test_glyphs(name):
    """Oracle: FreeType reads every glyph of the whole font; accented letters consist of others."""
    file = FONTS / f"{name}.ttf"
    font = FT2Font(file)
    letters = font.get_charmap()
    accented = {letters[code] for code in map(ord, "aäÄgé−0.5[]αµ") if code in letters}
    glyphs = accented | set(list(letters.values())[:300])
    data, index = subset_of(str(file), glyphs)
    assert set(index) == glyphs and len(data) < file.stat().st_size
    small = FT2Font(io.BytesIO(data))
    for glyph in glyphs:
        expected = font.load_glyph(glyph, flags=FLAGS)
        path = font.get_path()
        found = small.load_glyph(index[glyph], flags=FLAGS)
        assert found.horiAdvance == expected.horiAdvance and found.bbox == expected.bbox
        assert all(np.array_equal(one, other) for one, other in zip(small.get_path(), path, strict=True))


def test_tables(tmp_path):
    data, index = subset_of(str(FONTS / "DejaVuSans.ttf"), {36, 37, 200})
    font = TTFont(io.BytesIO(data), checkChecksums=2, lazy=False)
    assert {"glyf", "head", "hhea", "hmtx", "loca", "maxp"} <= set(font.keys()) and "fpgm" not in font
    assert font["maxp"].numGlyphs == len(font.getGlyphOrder()) >= 4
    assert all(not getattr(glyph, "program", None) for glyph in map(font["glyf"].__getitem__, font.getGlyphOrder()))
    assert sorted(index) == [36, 37, 200]
    file = tmp_path / "a.otf"
    for head in (b"OTTO", b"\x00\x01\x00\x00"):
        file.write_bytes(head + bytes(100))
        assert subset_of(str(file), {1}) is None
