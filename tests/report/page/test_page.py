"""The page of an experiment: valid, self-contained, in its order, and safe with any text."""

import re
from base64 import b64encode
from collections import Counter
from dataclasses import replace
from hashlib import sha256

import html5lib
import pytest
from page_sources import HOSTILE, headings
from tuned_searches import constant, search, tuning

from rmpc_bench.report.page.context import page_context
from rmpc_bench.report.page.headline import _counted
from rmpc_bench.report.page.rendering import TEMPLATES, render_html, render_markdown
from rmpc_bench.report.page.result_tables import result_blocks
from rmpc_bench.report.requirements_table import requirements_table
from rmpc_bench.report.summary import summarise
from rmpc_bench.report.tuning_table import TuningTable
from rmpc_bench.types.requirement import Limit, Requirement

SECTIONS = [
    "summary",
    "result",
    "table",
    "claims",
    "trajectories",
    "methods",
    "limitations",
    "failures",
    "trust",
    "files",
]


def parsed(text):
    """Parse a page; an error of the parser fails the test.  The namespace of MathML and SVG is kept."""
    parser = html5lib.HTMLParser(strict=True, namespaceHTMLElements=False)
    return parser.parse(text)


def test_the_page_is_valid_html(html):
    tree = parsed(html)
    ids = [element.get("id") for element in tree.iter() if element.get("id")]
    assert len(ids) == len(set(ids)) > 10
    targets = {element.get("href")[1:] for element in tree.iter("a") if element.get("href", "").startswith("#")}
    named = {word for element in tree.iter() for word in (element.get("aria-labelledby") or "").split()}
    assert targets | named <= set(ids)


def test_sections_stand_in_their_order_and_headings_have_no_gap(html):
    assert re.findall(r'<section id="(\w+)"', html) == SECTIONS
    levels = [level for level, _ in headings(html)]
    assert levels[0] == 1 and levels.count(1) == 1
    assert all(after - before <= 1 for before, after in zip(levels, levels[1:], strict=False))


def test_a_section_without_content_is_left_out(make_source):
    source = make_source(verdicts=[], figures=[], differences={}, shared={})
    found = re.findall(r'<section id="(\w+)"', render_html("page.html", page_context(source)))
    # Without differences the section of the methods still says where their parameters come from.
    assert found == [name for name in SECTIONS if name not in ("result", "claims")]


def test_markdown_has_the_same_sections(html, markdown):
    titles = [text for level, text in headings(html) if level == 2]
    assert re.findall(r"^## (.*)$", markdown, re.MULTILINE) == titles
    assert "![boxplot](figures/boxplot.svg)" in markdown and "<svg" not in markdown and "<style" not in markdown


def test_the_policy_allows_this_script_alone(html):
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]*)"', html)[1].replace("&#39;", "'")
    script = re.search(r"<script>(.*?)</script>", html, re.DOTALL)[1]
    digest = b64encode(sha256(script.encode()).digest()).decode()
    assert policy.startswith(f"default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-{digest}'")
    assert html.count("<script") == 1


def test_the_page_loads_nothing(html):
    """No element has a source, links are those of anchors, and no style refers to a file."""
    tree = parsed(html)
    for element in tree.iter():
        assert not {"src", "srcset", "data", "poster", "background", "action"} & set(element.attrib), element.tag
        assert element.tag not in ("link", "iframe", "object", "embed", "img", "base"), element.tag
        href = element.get("href", "") + element.get("{http://www.w3.org/1999/xlink}href", "")
        assert element.tag == "a" or not href or href.startswith("#"), href
    assert not re.search(r"@import|url\((?!#)", html)


@pytest.mark.parametrize("name", ["html", "markdown"])
def test_texts_of_a_user_are_escaped(request, name):
    """They stand on the page as they are, and none of them becomes an element, a link or a cell of its own."""
    text = request.getfixturevalue(name)
    assert "alert(" in text and "<script>alert" not in text.split("```")[0]
    if name == "html":
        assert "<b>" not in text.split("<pre")[1].split("</pre>")[0] and 'href="http://evil' not in text
    else:
        prose = text.split("````")[0]
        assert "](http://evil" not in prose.replace("\\](http", "")
        assert not re.search(r"(?<!\\)<script", prose)


def test_tables_of_markdown_have_one_number_of_cells(markdown):
    """A bar in a label does not add a cell."""
    prose = re.sub(r"\\\|", "", markdown.split("````")[0])
    for block in re.findall(r"(?:^\|.*\n)+", prose, re.MULTILINE):
        assert len({line.count("|") for line in block.splitlines()}) == 1, block


def test_the_same_source_gives_the_same_bytes(make_source):
    pages = [render_html("page.html", page_context(make_source())) for _ in range(2)]
    assert pages[0] == pages[1]


def test_tables_have_captions_and_scopes(html):
    tree = parsed(html)
    for table in tree.iter("table"):
        assert table.find("caption") is not None
        assert {cell.get("scope") for cell in table.find("thead").iter("th")} == {"col"}
        assert {row.find("th").get("scope") for row in table.find("tbody").iter("tr")} == {"row"}
    assert {row.get("data-method") for row in tree.iter("tr")} >= {"0", "1"}


def test_figures_have_a_text_and_groups_of_methods(html):
    tree = parsed(html)
    pictures = [element for element in tree.iter() if str(element.tag).endswith("svg")]
    assert len(pictures) == 3
    for picture in pictures:
        assert picture.get("role") == "img" and picture.get("aria-labelledby")
    assert html.count('data-method="1"') > 3 and '<a class="skip" href="#content">' in html


def test_claims_name_the_figure_and_the_numbers(html):
    claim = html[html.index('<article class="claim') :]
    assert '<a href="#figure-boxplot">boxplot</a>' in claim and "interval of the difference" in claim
    assert "2 assumptions" in claim and "Additional results" in claim


def test_limits_name_failures_and_the_working_tree(make_source):
    source = make_source(overrides=("--runs 3",), left_out=("boxplot: too small",), confounded=("B",))
    text = render_markdown("page.md", page_context(source))
    limits = text[text.index("## Known limitations") : text.index("## Failures")]
    for words in ("overridden", "figure is missing", "uncommitted changes", "Both the estimator and the controller"):
        assert words in limits
    assert "For information only" in text


def test_limits_of_a_clean_experiment(make_source):
    """Failed runs, tuning, assumptions and the machine are named even where nothing went wrong."""
    text = render_markdown("page.md", page_context(make_source()))
    limits = text[text.index("## Known limitations") : text.index("## Failures")]
    for words in (
        "No run failed",
        "No method is tuned: all parameters are as published",
        "2 assumptions",
        "one machine",
    ):
        assert words in limits


def test_runs_that_are_not_computed_are_named_apart_from_failed_ones(make_source):
    """An interrupted experiment whose last run of B is missing: no run failed, and a comparison leaves one out."""
    plain = make_source(incomplete=("B",))
    last = plain.trials.frame[plain.trials.frame["method"] == "B"].index[-1]
    trials = replace(plain.trials, frame=plain.trials.frame.drop(last))
    text = render_markdown("page.md", page_context(replace(plain, trials=trials, tables=summarise(trials))))
    assert "Comparisons leave out the runs that are not computed for both methods" in text
    assert "no average leaves a run out" not in text and "in which a method failed" not in text


@pytest.mark.parametrize(
    ("words", "n_points", "text"),
    [
        ({"better": 3}, 3, "better at all 3 points"),
        ({"better": 1}, 1, "better at 1 point"),
        ({"better": 2}, 3, "better at 2 points"),
        ({"better": 2, "worse": 1}, 3, "better at 2 points, worse at 1"),
    ],
)
def test_all_points_are_named_where_all_have_the_verdict(words, n_points, text):
    """A point that is not computed has no verdict."""
    assert _counted(Counter(words), n_points) == text


def test_every_method_says_where_its_parameters_come_from(make_source):
    """In the summary for a baseline that is not tuned, in the table of the methods and among the limitations."""
    plain = make_source()
    words = {"A": "default", "B": "tuned (budget 16, 40 runs)"}
    trials = replace(plain.trials, parameters=words)
    source = replace(plain, trials=trials, tables=summarise(trials), verdicts=[])
    text = render_markdown("page.md", page_context(source))
    parts = dict(re.findall(r"^## (.*)\n((?:(?!## ).*\n)*)", text, re.MULTILINE))
    assert "Compared with A (default, not tuned) in MSE" in parts["Summary"]
    methods = parts["What differs between the methods, and what was assumed"]
    assert "| A | default, not tuned |" in methods and "| B | tuned (budget 16, 40 runs) |" in methods
    limits = parts["Known limitations of this comparison"]
    assert "- A: default, not tuned; other parameters may change a verdict." in limits and "- B: " not in limits


def test_worst_runs_and_requirements_stand_beside_the_means(make_source):
    """In the section of the table: those of the primary metric open, those of the others folded."""
    requirement = Requirement("mse < 1", "mse", (Limit("<", 1.0),))
    plain = make_source(n=80)
    trials = replace(plain.trials, requirements=(requirement,))
    source = replace(plain, trials=trials, requirements=requirements_table(trials))
    (section,) = [part for part in page_context(source)["sections"] if part["id"] == "table"]
    captions = [block.get("caption", "") for block in section["blocks"]]
    assert any(text.startswith("Worst runs, mse") for text in captions)
    assert "Runs that meet the requirements" in captions
    folded = [block["title"] for block in section["blocks"] if block["kind"] == "folded"]
    assert "Worst runs in the other metrics" in folded
    (worst,) = [block for block in section["blocks"] if block.get("caption", "").startswith("Worst runs")]
    assert [row["method"] for row in worst["rows"]] == [0, 1] and "[" in worst["rows"][0]["cells"][2]


def test_failed_runs_have_a_command(make_trials, make_source):
    """Counted with the meaning of the status, the first ones with the command that replays them."""
    values = [1.0] * 25
    trials = make_trials({"mse": {"A": values, "B": [*values[:-1], "diverged"]}})
    source = replace(make_source(), trials=trials, tables=summarise(trials), verdicts=[])
    text = render_markdown("page.md", page_context(source))
    failures = text[text.index("## Failures") :]
    assert "B: 1 run diverged" in failures
    assert "`rmpc-bench show results/zenere2018/tiny --run 24 --method B`" in failures


def luminance(colour):
    """Relative luminance of WCAG 2."""
    parts = [int(colour[place : place + 2], 16) / 255 for place in (1, 3, 5)]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(a, b):
    low, high = sorted([luminance(a), luminance(b)])
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("theme", [0, 1, 2], ids=["light", "dark", "print"])
def test_contrast(theme):
    """At least 4.5 to 1 for every colour of a text on every colour that is behind it."""
    style = (TEMPLATES / "page.css").read_text(encoding="utf-8")
    blocks = re.findall(r":root \{(.*?)\}", style, re.DOTALL)
    assert len(blocks) == 3
    colours = dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6})", blocks[theme]))
    pairs = [(text, back) for text in ("text", "muted", "link") for back in ("page", "raised")]
    pairs += [(word, f"{word}-back") for word in ("yes", "no", "open")]
    for text, back in pairs:
        assert contrast(colours[text], colours[back]) >= 4.5, (text, back)


def test_hostile_text_is_what_it_says():
    assert contrast("#000000", "#ffffff") == 21 and "<script>" in HOSTILE


def test_the_table_of_a_large_sweep_says_where_parameters_come_from(make_trials, make_sweep):
    """A column where methods differ, and the word of a baseline that is not tuned in the note."""
    words = {"A": "default", "B": "tuned (budget 16, 40 runs)"}
    table = replace(make_trials({"mse": {"A": [1.0, 2.0, 3.0], "B": [1.1, 1.9, 3.3]}}), parameters=words)
    sweep = make_sweep(*[({"s": str(i)}, replace(table, title=f"s={i}")) for i in range(8)])
    (block,) = [each for each in result_blocks(summarise(sweep), ["A", "B"]) if each["kind"] == "table"]
    heads = [head["text"] for head in block["heads"]]
    assert heads[:3] == ["point", "method", "parameters"] and heads[-1] == "verdict"
    assert [row["cells"][2] for row in block["rows"]] == ["default", "tuned"] * 8
    assert block["notes"] == ["tuned = budget 16, 40 runs; A: default, not tuned"]


def test_tuning_has_a_section_with_values_ranks_and_cost(make_source):
    """Valid HTML with a row per method, and what it leaves open among the limitations."""
    plain = make_source()
    first = search("B", constant([2, 1]), constant([2, 1, 9], 40), values=[1.0, 10.0], seconds=12.0)
    found = tuning(first)
    trials = replace(plain.trials, parameters={"A": "default", **found.parameters})
    source = replace(plain, trials=trials, tuning=TuningTable(trials, found))
    context = page_context(source)
    (section,) = [part for part in context["sections"] if part["id"] == "tuning"]
    tables = [block for block in section["blocks"] if block["kind"] == "table"]
    assert [[row["method"] for row in each["rows"]] for each in tables] == [[1], [0, 1]]
    text = render_markdown("page.md", context)
    # 2 values in 3 tuning runs, and these and the default in 40 runs.
    assert "Cost: 126 trials, 12 s of computing time." in text and "| A | default, not tuned |" in text
    limits = text[text.index("## Known limitations of this") : text.index("## Failures")]
    assert "Tuned values at the end of their range: B" in limits and "A larger budget, more tuning runs" in limits
    parsed(render_html("page.html", context))
