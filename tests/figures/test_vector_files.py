"""SVG and PDF from one draw show what a draw of their own shows; fonts of a PDF are small."""

import io
import logging
import re
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from fontTools import subset
from fontTools.ttLib import TTFont
from matplotlib.figure import Figure
from pypdf import PdfReader

from rmpc_bench.figures.files import UNUSED_TABLES, can_be_drawn_once, save, small_fonts, svg_of
from rmpc_bench.figures.style import Rendering, style

FONTS = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
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


def test_fonts_of_a_pdf_have_the_outlines_of_their_letters_only(tmp_path):
    """Oracle: the glyphs of a whole font."""
    (file,) = save(picture(), tmp_path, "a", Rendering(formats=("pdf",)))
    page = PdfReader(file).pages[0]
    assert "upper end" in page.extract_text()
    found = [each for font in page["/Resources"]["/Font"].values() for each in _files(font.get_object())]
    assert len(found) >= 2
    for name, data in found:
        small = TTFont(io.BytesIO(data), lazy=False)
        assert {"glyf", "head", "hhea", "hmtx", "loca", "maxp"} <= set(small.keys())
        assert not {"fpgm", *UNUSED_TABLES} & set(small.keys())
        whole = TTFont(FONTS / f"{name}.ttf")
        assert 1 < len(small.getGlyphOrder()) < 100 < len(whole.getGlyphOrder())
        # The box in place of a missing character has no outline.
        drawn, every = ({_outline(font, glyph) for glyph in font.getGlyphOrder()[1:]} for font in (small, whole))
        assert drawn <= every and len(drawn) > 1


def _outline(font, glyph):
    """Points of a glyph and its metrics."""
    return tuple(map(tuple, font["glyf"][glyph].getCoordinates(font["glyf"])[0])), font["hmtx"][glyph]


@pytest.mark.parametrize("name", ["DejaVuSans", "DejaVuSerif", "STIXGeneral", "cmr10"])
def test_a_small_font_has_the_tables_that_fonttools_makes(name):
    """Oracle: the same tables, left out later; kerning is dropped beside GPOS only."""

    def made(**settings):
        options = subset.Options(glyph_names=True, recommended_glyphs=True, **settings)
        content = io.BytesIO()
        with subset.load_font(FONTS / f"{name}.ttf", options) as font:
            subsetter = subset.Subsetter(options)
            subsetter.populate(gids=range(3, 90))
            subsetter.subset(font)
            kept = subsetter.glyph_index_map
            for table in {*UNUSED_TABLES} & {*font.keys()}:
                del font[table]
            font.save(content, reorderTables=False)
        return kept, TTFont(content, lazy=False)

    layout = [name for name in UNUSED_TABLES if name.isupper() and name.isalpha()]
    kept, usual = made(hinting=False, drop_tables=[*subset.Options().drop_tables, *layout])
    with small_fonts():
        same, small = made()
    assert same == kept and {*small.keys()} == {*usual.keys()}
    for table in {*usual.keys()} - {"GlyphOrder", "head"}:
        assert small.getTableData(table) == usual.getTableData(table), table


def test_what_a_library_logs_of_a_font_is_not_shown(tmp_path, caplog):
    """The symbols of TeX have a date that fontTools remarks on."""
    figure = Figure()
    figure.text(0.5, 0.5, "abc", fontfamily="cmsy10")
    with style(), small_fonts():
        figure.savefig(tmp_path / "a.pdf")
    assert b"Cmsy10" in (tmp_path / "a.pdf").read_bytes() and not caplog.records
    assert logging.getLogger("fontTools").level == logging.NOTSET


def _files(font):
    """Yield name and bytes of the file of a font of a PDF."""
    for each in font.get("/DescendantFonts", [font]):
        descriptor = each.get_object().get("/FontDescriptor", {}).get_object()
        if "/FontFile2" in descriptor:
            yield descriptor["/FontName"].rpartition("+")[2].lstrip("/"), descriptor["/FontFile2"].get_data()
