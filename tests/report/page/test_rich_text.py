"""Labels and captions as HTML and Markdown."""

import pytest

from rmpc_bench.report.mathml import FormulaError, mathml
from rmpc_bench.report.rich_text import plain_text, to_html, to_markdown

HOSTILE = "<script>alert(1)</script> \"x\" 'y' & [a](javascript:b) ![c](http://d) `e` | *f* _g_ $<img src=x>$"


@pytest.mark.parametrize(
    ("formula", "expected"),
    [
        ("x_0", "<msub><mi>x</mi><mn>0</mn></msub>"),
        (r"\hat{x}", '<mover accent="true"><mi>x</mi><mo>^</mo></mover>'),
        ("a_i^2", "<msubsup><mi>a</mi><mi>i</mi><mn>2</mn></msubsup>"),
        (r"\sigma \leq 0.5", "<mi>\u03c3</mi><mo>\u2264</mo><mn>0.5</mn>"),
        (r"\frac{1}{n}", "<mfrac><mn>1</mn><mi>n</mi></mfrac>"),
        (r"\mathrm{rad}", '<mi mathvariant="normal">rad</mi>'),
        ("a<b", "<mi>a</mi><mo>&lt;</mo><mi>b</mi>"),
    ],
)
def test_formulas(formula, expected):
    assert mathml(formula) == f"<math>{expected}</math>"


@pytest.mark.parametrize("formula", [r"\href{x}", "a_", "_a", "{a", "a}", "a_1_2", r"\mathrm{a", r"\mathrm{\x}"])
def test_what_is_not_covered_stays_text(formula):
    """As matplotlib does: the text with its dollar signs."""
    with pytest.raises(FormulaError):
        mathml(formula)
    assert "<math>" not in to_html(f"a ${formula}$") and "$" in to_html(f"a ${formula}$")


def test_hostile_text_is_escaped_in_html():
    html = to_html(HOSTILE)
    assert "<script" not in html and "<img" not in html and "&lt;script&gt;" in html and '"' not in html


def test_hostile_text_is_escaped_in_markdown():
    text = to_markdown(HOSTILE)
    assert r"\<script\>" in text and r"\[a\](" in text and r"!\[c\]" in text and r"\|" in text and r"\`e\`" in text


@pytest.mark.parametrize("text", ["# head", "- item", "1. item", "+ item", "> quote", "a\n\n# b"])
def test_no_text_begins_a_block_of_markdown(text):
    line = to_markdown(text)
    assert line[0] == "\\" or line[:2] in ("1\\", "a ") and "\n" not in line


def test_dollar_signs_without_a_formula():
    assert to_html(r"5 \$ and 6 $") == "5 $ and 6 $"


def test_plain_text_has_no_marks():
    assert plain_text(r"$c=10^{-1}$, $\theta$ and \$") == "c=10^-1, theta and $"
