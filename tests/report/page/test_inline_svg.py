"""SVG files within a page."""

import re

import pytest

from rmpc_bench.report.page.inline_svg import inline_svg

FILE = """<?xml version="1.0" encoding="utf-8" standalone="no"?>
<!DOCTYPE svg PUBLIC "-//W3C//DTD SVG 1.1//EN" "http://www.w3.org/Graphics/SVG/1.1/DTD/svg11.dtd">
<svg xmlns:xlink="http://www.w3.org/1999/xlink" width="252pt" height="180pt" viewBox="0 0 252 180"
 xmlns="http://www.w3.org/2000/svg" version="1.1">
 <metadata><x xlink:href="http://purl.org/dc"/></metadata>
 <!-- a comment -->
 <defs><path id="m1" d="M 0 0"/></defs>
 <g id="method-2-line"><use xlink:href="#m1" clip-path="url(#p1)"/></g>
</svg>
"""


def test_ids_are_those_of_the_figure_and_references_follow():
    svg = inline_svg(FILE, "figure-a", "A & b", "<desc>")
    assert 'id="figure-a-m1"' in svg and 'href="#figure-a-m1"' in svg and "url(#figure-a-p1)" in svg
    assert 'data-method="2"' in svg and "method-2" not in svg


def test_nothing_points_to_a_network():
    svg = inline_svg(FILE, "figure-a", "A", "b")
    assert "http" not in svg and "<!--" not in svg and "metadata" not in svg and "<?xml" not in svg


def test_title_and_description():
    svg = inline_svg(FILE, "figure-a", "A & b", "<desc>")
    assert '<title id="figure-a-title">A &amp; b</title><desc id="figure-a-desc">&lt;desc&gt;</desc>' in svg
    assert re.match(r'<svg [^>]*viewBox="0 0 252 180" version="1.1" role="img" aria-labelledby="figure-a-title', svg)


def test_the_width_stands_beside_the_font_in_one_attribute():
    svg = inline_svg(FILE.replace("<svg ", '<svg style="font-size: 8px" '), "figure-a", "A", "b")
    assert svg.count("style=") == 1 and 'style="font-size: 8px; --width: 252pt"' in svg


def test_a_text_without_a_picture_is_refused():
    with pytest.raises(ValueError, match="figure-a: not an SVG"):
        inline_svg("<html>", "figure-a", "A", "b")
