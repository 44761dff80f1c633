"""SVG files: the same bytes where coordinates differ by rounding errors, and the same picture."""

import io
import re

import numpy as np

from rmpc_bench.figures.style import style
from rmpc_bench.figures.svg_text import stable_svg


def drawn(noise):
    """SVG of a picture with lines, markers, text and clipping, as matplotlib writes it."""
    from matplotlib.figure import Figure

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
    assert drawn(0.0) != drawn(3e-13)
    assert stable_svg(drawn(0.0)) == stable_svg(drawn(3e-13)) == stable_svg(drawn(-3e-13))


def test_no_coordinate_moves_by_more_than_half_a_tenth():
    """Every number stays in its place; factors and comments keep all their digits."""
    before, after = drawn(0.0), stable_svg(drawn(0.0))
    number = re.compile(r"-?\d+\.\d+|-?\d+")
    names = re.compile(r'(?<=["#])[a-z][0-9a-f]{10}(?=["\)])|(?<=["#])[a-z]\d+(?=["\)])')
    before, after = names.sub("", before), names.sub("", after)
    assert number.sub("#", before) == number.sub("#", after)
    numbers = [np.array([float(text) for text in number.findall(svg)]) for svg in (before, after)]
    assert np.abs(numbers[0] - numbers[1]).max() <= 5e-2 + 1e-9
    assert "0.1234567" in after


def test_names_are_used_where_they_are_defined():
    """Every reference has its definition."""
    text = stable_svg(drawn(0.0))
    defined = set(re.findall(r'id="([^"]+)"', text))
    used = set(re.findall(r'href="#([^"]+)"', text)) | set(re.findall(r"url\(#([^)]+)\)", text))
    assert used and used <= defined
    assert not re.search(r'"#?[a-z][0-9a-f]{10}"', text)


def test_by_hand():
    """Halves go to the even digit, zeros lose their sign, and short numbers stay."""
    text = (
        '<path d="M 1.005000 -0.0010 L 2.25 3.123456"/><use x="7.2000" transform="translate(1.23456 5) scale(0.0156)"/>'
    )
    assert stable_svg(text) == (
        '<path d="M 1 0 L 2.25 3.12"/><use x="7.2" transform="translate(1.23 5) scale(0.0156)"/>'
    )
