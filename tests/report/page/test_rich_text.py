"""Labels and captions as HTML and Markdown."""

import pytest

from rmpc_bench.report.page.rendering import FormulaError, formula_html, said, to_html, to_markdown, unbroken

HOSTILE = "<script>alert(1)</script> \"x\" 'y' & [a](javascript:b) ![c](http://d) `e` | *f* _g_ $<img src=x>$"


@pytest.mark.parametrize(
    ("formula", "expected"),
    [
        ("x_0", "x<sub>0</sub>"),
        (r"\hat{x}", "x\u0302"),
        ("x_{k|k}", "x<sub>k|k</sub>"),
        (r"\delta_v^2", "\u03b4<sub>v</sub><sup>2</sup>"),
        ("Q'Q", "Q\u2032Q"),
        (r"Q^{\prime}", "Q\u2032"),
        (r"\sigma \leq 0.5", "\u03c3 \u2264 0.5"),
        ("c=10^{-1}", "c = 10<sup>\u22121</sup>"),
        (r"\frac{1}{n+1}", "1/(n+1)"),
        (r"\mathrm{rad}", "rad"),
        (r"\sqrt{x}", "\u221ax"),
        ("a<b", "a &lt; b"),
    ],
)
def test_formulas(formula, expected):
    assert formula_html(formula) == expected


@pytest.mark.parametrize("formula", [r"\href{x}", "a_", "_a", "{a", "a}", "a_1_2", r"\mathrm{a", r"\mathrm{\x}"])
def test_what_is_not_covered_stays_text(formula):
    """As matplotlib does: the text with its dollar signs."""
    with pytest.raises(FormulaError):
        formula_html(formula)
    assert "<su" not in to_html(f"a ${formula}$") and "$" in to_html(f"a ${formula}$")


def test_hostile_text_is_escaped():
    html, text = to_html(HOSTILE), to_markdown(HOSTILE)
    assert "<script" not in html and "<img" not in html and "&lt;script&gt;" in html and '"' not in html
    assert all(part in text for part in (r"\<script\>", r"\[a\](", r"!\[c\]", r"\|", r"\`e\`"))


@pytest.mark.parametrize("text", ["# head", "- item", "1. item", "+ item", "> quote", "a\n\n# b"])
def test_no_text_begins_a_block_of_markdown(text):
    line = to_markdown(text)
    assert line[0] == "\\" or line[:2] in ("1\\", "a ") and "\n" not in line


@pytest.mark.parametrize(("unit", "html"), [("rad^2", "rad<sup>2</sup>"), ("(mol/l)^2", "(mol/l)<sup>2</sup>")])
def test_exponents_of_units_are_raised(unit, html):
    assert to_html(f"MSE [{unit}]") == f"MSE [{html}]"


@pytest.mark.parametrize("name", ["$a$", "a^2", "R<b>", "50 %", "a-b", "-1"])
def test_a_name_of_a_method_is_no_formula(name):
    """Also where a shorter name begins it, and a formula beside it holds the name of another one."""
    escaped = name.replace("<", "&lt;").replace(">", "&gt;")
    names = tuple(sorted([name, "c"], key=len, reverse=True))
    assert said(f"{name} is better, $c_1$", names) == f"{escaped} is better, c<sub>1</sub>"
    assert f'<span class="nb">{escaped}</span>' in unbroken(f"{name} is", names)


def test_an_interval_of_the_answer_is_not_broken():
    html = unbroken("by 10.2 % [7.9, 12.4], or \u00d72.6 [2.1, 3.3].", ())
    assert html == 'by <span class="nb">10.2 % [7.9, 12.4]</span>, or <span class="nb">\u00d72.6 [2.1, 3.3]</span>.'
    assert to_html(r"5 \$ and 6 $") == "5 $ and 6 $"
