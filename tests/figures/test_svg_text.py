"""SVG of figures: variables for colours, no font or size, formulas that can be read, bytes without rounding errors."""

import io
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.figure import Figure

import rmpc_bench.report
from rmpc_bench.figures.files import page_svg, svg_of
from rmpc_bench.figures.palette import DARK, LIGHT, METHODS, PRINT, in_css
from rmpc_bench.figures.style import style
from rmpc_bench.figures.svg_text import as_file, for_page, stable_svg, themed

LABELS = ("$Q'Q$", "$x_{k|k}'$", r"$\delta_v^2$", 'a "b" <b> & c', "x" * 60)


def picture(text="$Q'Q$", gid="method-A"):
    """A line of a method over a pale area, with a title."""
    with style():
        figure = Figure(figsize=(3, 2))
        axes = figure.subplots()
        axes.plot([1, 2, 3], color=METHODS[0], marker="o", gid=gid)
        axes.fill_between([0, 1], [1, 1], [2, 2], color=(METHODS[1], 0.2), lw=0)
        axes.set_title(text)
    return figure


def words(svg):
    """Texts of an SVG without the blanks that separate its elements."""
    root = ElementTree.fromstring(svg.replace("<svg", '<svg xmlns="http://www.w3.org/2000/svg"', 1))
    return ["".join(each.itertext()).replace("\n", "") for each in root.iter() if each.tag.endswith("}text")]


def test_a_page_gives_colours_font_and_size():
    svg = page_svg(picture(), "signals-2")
    assert not re.search(r"#[0-9a-f]{6}\b|font-family|<style|xmlns|<!--|metadata", svg)
    root = re.match(r"<svg[^>]*>", svg)[0]
    assert 'class="signals-2" aria-hidden="true"' in root and "width=" not in root and "height=" not in root
    assert {"var(--m1)", "var(--m2)"} <= set(re.findall(r"var\(--m\d\)", svg)) and "currentColor" in svg
    assert svg.count('data-method="A"') == 1
    ids, used = re.findall(r'\bid="([^"]*)"', svg), re.findall(r'(?:href="#|url\(#)([^")]+)', svg)
    assert ids and set(ids) == set(used) and len(ids) == len(set(ids)) and all(re.match("signals-2-", i) for i in ids)


def test_a_file_has_the_colours_of_both_grounds():
    svg = svg_of(picture())
    ElementTree.fromstring(svg)
    light, dark = svg.split("@media(prefers-color-scheme:dark)")
    assert f"--m1:{LIGHT['m1']}" in light and f"--m1:{DARK['m1']}" in dark and "--m3" not in svg
    assert "background:var(--bg)" in svg and "sans-serif" in svg
    assert for_page(svg, "a") == page_svg(picture(), "a")


@pytest.mark.parametrize("text", LABELS)
def test_labels_are_text(text):
    """Also as the name of a method; a prime is one, and not the 0 that stands in its place in the font."""
    figure = picture(text, f"method-{text}")
    shown = {"$Q'Q$": "Q\u2032Q", "$x_{k|k}'$": "xk\u2032|k", r"$\delta_v^2$": "\u03b4v2"}.get(text, text)
    for svg in (page_svg(figure, "a"), svg_of(figure).replace(' xmlns="http://www.w3.org/2000/svg"', "")):
        assert shown in words(svg)
        root = ElementTree.fromstring(svg.replace("<svg", '<svg xmlns:xlink="x"', 1) if "xlink:" not in svg else svg)
        assert text in {each.get("data-method") for each in root.iter()}


HOSTILE = (
    'A id="',
    'B\' id=" style=x onclick=alert(1) q="',
    'C d="M 1"',
    'D #0b5cad id="k" rotate(1.23456)',
    "E url(#k) xlink:href=#k",
    'F  xmlns="http://www.w3.org/2000/svg" &amp;',
    "G; font-family: x font-size: 8px",
    "H <style>x</style>",
    'I </text>--> "',
)


def test_a_name_is_no_markup():
    """Names with the words that the steps look for, in one picture: no attribute is theirs, each is whole."""
    figure = picture(HOSTILE[0], f"method-{HOSTILE[0]}")
    for place, name in enumerate(HOSTILE):
        figure.text(0, place / 10, name, gid=f"method-{name}")
    assert "#0b5cad" in page_svg(picture("$a$ #0b5cad"), "a")
    page = page_svg(figure, "a")
    for svg in (page, for_page(svg_of(figure), "a")):
        elements = list(ElementTree.fromstring(svg).iter())
        assert {name for each in elements if (name := each.get("data-method"))} == set(HOSTILE) and svg == page
        assert set(HOSTILE) <= set(words(svg))
        assert not {key for each in elements for key in each.attrib} & {"onclick", "q"}


def test_by_hand():
    """A picture without text stays as it is; a formula is not cut into characters, and an escape is one of them."""
    assert themed('<svg width="1" viewBox="0 0 1 1"><g id="a"><path d="M 0 0 \nL 1 1 \nL 2 0 \n"/></g></svg>') == (
        '<svg viewBox="0 0 1 1" fill="currentColor" stroke-linejoin="round"><path d="M0 0l1 1 1-1"/></svg>'
    )
    one = '<tspan x="{}" y="0" style="font-size: 8px; font-family: \'DejaVu Sans\'">{}</tspan>\n'
    text = "".join(one.format(x, each) for x, each in ((1, "a"), (3, "b"), (2, "&amp;")))
    assert '<tspan x="1 2 3" y="0">a&amp;b</tspan>' in themed(f"<svg ><text>{text}</text></svg>")
    assert "font-family:'STIX',serif}" in as_file("<svg >", ("STIX", "serif"))


def test_every_printed_colour_stands_for_one_variable_of_the_style_sheet():
    assert len(set(PRINT.values())) == len(PRINT) and set(LIGHT) == set(DARK) == set(PRINT)
    found = [in_css(colour) for colour in (PRINT["fg"], PRINT["band"], "#123456")]
    assert found == ["currentColor", "var(--band)", "#123456"]
    css = (Path(rmpc_bench.report.__file__).parent / "templates/page.css").read_text(encoding="utf-8")
    light, dark = re.split(r"@media ?\(prefers-color-scheme: ?dark\)", css)[:2]
    for ground, text in ((LIGHT, light), (DARK, dark)):
        for name, value in ground.items():
            short = "#" + value[1::2] if value[1::2] == value[2::2] else value
            assert re.search(rf"--{name}: ?({value}|{short})\b", text), name


def contrast(one, other):
    """Ratio of WCAG 2 of two colours."""
    lums = []
    for colour in (one, other):
        parts = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
        parts = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
        lums.append(0.2126 * parts[0] + 0.7152 * parts[1] + 0.0722 * parts[2])
    return (max(lums) + 0.05) / (min(lums) + 0.05)


@pytest.mark.parametrize("ground", [LIGHT, DARK])
def test_every_text_can_be_read(ground):
    for name in ("fg", "dim", "better", "worse", "fail", *(f"m{k}" for k in range(1, 8))):
        assert contrast(ground[name], ground["bg"]) >= 4.5, name


def loglog(noise):
    """SVG of a picture with lines, markers, text and clipping, as matplotlib writes it."""
    x = np.linspace(0.1, 1.0, 50)
    with style():
        picture = Figure(figsize=(3.5 * (1 + noise), 2.4))
        axes = picture.subplots()
        axes.loglog(x, x**2 * (1 + noise), marker="+")
        axes.set_title("x = 0.1234567, $\\theta$")
        buffer = io.StringIO()
        picture.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def test_rounding_errors_change_nothing():
    """Neither coordinates nor the names that matplotlib makes of unrounded numbers."""
    before, after = loglog(0.0), stable_svg(loglog(0.0))
    assert before != loglog(3e-13) and after == stable_svg(loglog(3e-13)) == stable_svg(loglog(-3e-13))


def test_no_coordinate_moves_by_more_than_half_a_tenth():
    """Every number stays in its place; factors and comments keep all their digits."""
    number = re.compile(r"-?\d+\.\d+|-?\d+")
    names = re.compile(r'(?<=["#])[a-z][0-9a-f]{10}(?=["\)])|(?<=["#])[a-z]\d+(?=["\)])')
    before, after = (names.sub("", text) for text in (loglog(0.0), stable_svg(loglog(0.0))))
    assert number.sub("#", before) == number.sub("#", after) and "0.1234567" in after
    numbers = [np.array([float(text) for text in number.findall(svg)]) for svg in (before, after)]
    assert np.abs(numbers[0] - numbers[1]).max() <= 5e-2 + 1e-9


def test_rounded_by_hand():
    """Halves go to the even digit, zeros lose their sign, and short numbers stay."""
    use = '<use x="7.20{}" transform="translate(1.23{} 5) scale(0.0156)"/>'
    text = '<path d="M 1.005000 -0.0010 L 2.25 3.123456"/>' + use.format("00", "456")
    assert stable_svg(text) == '<path d="M 1 0 L 2.25 3.12"/>' + use.format("", "").replace("7.20", "7.2")
