"""The page of an experiment: its structure, its parts in their order, and safe with any text."""

import re
from base64 import b64encode
from dataclasses import replace
from hashlib import sha256

import html5lib
import numpy as np
import pytest
from comparison_tables import extent_of
from data_frames import arrays
from page_reader import Page, faults
from tuned_searches import constant, search, tuning

from rmpc_bench.report.page.context import ClaimItem, n_open, page_context
from rmpc_bench.report.page.rendering import render_html, render_markdown
from rmpc_bench.report.run_tables import requirements_table
from rmpc_bench.report.source import PageFigure
from rmpc_bench.report.summary import summarise
from rmpc_bench.report.tuning_table import TuningTable
from rmpc_bench.types import MetricInfo
from rmpc_bench.types.metric import Limit, Requirement

FOLDS = ["Other metrics", "Worst runs", "Signals", "Figure boxplot", "Settings", "Limits of this comparison"]


def page_of(source):
    return Page(render_html("page.html", page_context(source)))


@pytest.fixture
def with_trials(make_source, make_trials):
    """Return a function that makes a source of other trials, or of columns of MSEs, with more fields."""

    def make(trials, **fields):
        trials = make_trials({"mse": trials}) if isinstance(trials, dict) else trials
        usual = {"trials": trials, "tables": summarise(trials), "verdicts": [], "figures": [], "differences": {}}
        return make_source(**usual | fields)

    return make


def values(n, factor=1.0, seed=1):
    """Log-normal values whose ratios to those of another factor are random."""
    noise = np.random.default_rng(int(100 * factor)).normal(size=n)
    return (factor * np.exp(np.random.default_rng(seed).normal(size=n) + 0.1 * noise)).tolist()


@pytest.fixture
def sweep_of(make_trials, make_sweep):
    """Return a function that makes a sweep of points, each path -> value, over methods with factors."""

    def make(points, factors, n=30):
        tables = []
        for k, point in enumerate(points):
            columns = {name: values(n, 1 + (factor - 1) * (k + 1) / len(points), k) for name, factor in factors.items()}
            title = ", ".join(f"{path}={value}" for path, value in point.items())
            tables.append((point, replace(make_trials({"mse": columns}), title=title)))
        return make_sweep(*tables)

    return make


SWEEPS = {
    "number": [{"plant.a": text} for text in ("0", "0.1", "0.2")],
    "names": [{"noise": text} for text in ("biased", "white")],
    "two paths": [{"plant.a": a, "noise.b": b} for a in ("0", "1", "2") for b in ("x", "y")],
    "three paths": [{"plant.a": a, "noise.b": b, "t": c} for a in ("0", "1") for b in ("x", "y") for c in ("5", "6")],
}


@pytest.mark.parametrize("kind", SWEEPS)
def test_sweeps(with_trials, sweep_of, kind):
    """A matrix of methods against points, or a table per method for two paths; every number once in a tip."""
    trials = sweep_of(SWEEPS[kind], {"A": 1.0, "B": 0.8, "C-1": 1.3})
    page = page_of(with_trials(trials, drawings={"wide": "<svg></svg>"} if kind == "number" else {}))
    assert faults(page, trials.methods if kind != "two paths" else ()) == []
    rows = [page.rows(table) for table in page.tables]
    if kind == "two paths":
        assert [table.attributes["class"] for table in page.tables] == ["matrix"] * 2
        assert rows[0][0] == ["a", "x", "y"] and [row[0] for row in rows[0][1:]] == ["0", "1", "2"]
        assert [next(table.all("caption")).text for table in page.tables] == ["B, by b", "C-1, by b"]
    elif kind == "names":
        assert rows[0][0] == ["noise", "A, mean", "B", "C-1"] and rows[0][1][0] == "biased"
    else:
        assert rows[0][0] == ["a" if kind == "number" else "point", "A, mean", "B", "C-1"]
        assert len(rows[0]) == 1 + len(trials.points)
    cells = [cell for table in page.tables for cell in table.all("td") if cell.attributes.get("data-tip")]
    assert len(cells) == 2 * len(trials.points)
    for cell in cells:
        tip, style = cell.attributes["data-tip"], cell.classes
        word = tip.rpartition(": ")[2]
        assert word in ("better", "worse", "inconclusive", "equivalent")
        assert (word in style) == (word in ("better", "worse"))
        assert cell.text.endswith("?") == (word == "inconclusive") and re.match(r"(B|C-1) at ", tip)
    assert "Intervals and means of all points" in page.folds
    assert bool(page.of_class("two")) == (kind in ("number", "two paths"))


def test_the_longer_of_points_and_methods_goes_down_and_many_points_are_folded(with_trials, sweep_of):
    page = page_of(with_trials(sweep_of(SWEEPS["names"], {name: 1 + 0.1 * k for k, name in enumerate("ABCD")})))
    rows = page.rows(page.tables[0])
    assert rows[0] == ["method", "biased", "white"] and [row[0] for row in rows[1:]] == ["A, mean", "B", "C", "D"]
    points = [{"p": f"{a}", "q": f"{b}", "s": f"{c}"} for a in range(2) for b in range(4) for c in range(8)]
    page = page_of(with_trials(sweep_of(points, {"A": 1.0, "B": 0.7}, n=4)))
    groups = [each for each in page.root.all("details") if next(each.all("summary")).text in ("p 0", "p 1")]
    assert [len(page.rows(next(each.all("table")))) for each in groups] == [33, 33]


def test_one_point(make_source):
    """Answer, one table, note, claims and folds in their order; the interval of B in answer, table and nowhere else."""
    page = page_of(make_source(labels={"B": "B, $c=10^{-1}$"}))
    assert faults(page, ["A", "B"]) == [] and [*page.folds] == FOLDS
    heads, *rows = page.rows(page.tables[0])
    assert heads[0] == "method" and [row[0] for row in rows] == ["A", "B c = 10 \u22121"] and rows[1][5] == "better"
    assert page.folds["Other metrics"] == "lowest median power: A"
    assert re.fullmatch(r"run \d+ is the worst of every method", page.folds["Worst runs"])
    ticks = [each.text for each in page.of_class("s")[1].all("span")]
    assert "0" in ticks and any("%" in tick for tick in ticks)
    page = page_of(make_source())
    strip = next(each for each in page.of_class("s0") if each.tag == "td" and list(each.all("b")))
    left = {each.tag: float(re.search(r"left:([\d.]+)%", each.attributes["style"])[1]) for each in strip.all("b")}
    lines = page.of_class("s0")[0]
    ticks = {each.text: float(re.search(r"left:([\d.]+)%", each.attributes["style"])[1]) for each in lines.all("span")}
    assert left["b"] == pytest.approx(ticks["\u221220 %"], abs=0.01)


def test_more_than_ten_methods_are_sorted_and_low(with_trials, make_trials):
    columns = {f"M{k}": values(30, 0.5 + k / 8 if k else 1.0) for k in range(12)}
    trials = replace(make_trials({"mse": columns}, labels={"M3": "a label " * 9}), oracles=frozenset({"M11"}))
    page = page_of(with_trials(trials))
    assert faults(page, columns) == [] and "many" in page.tables[0].classes
    rows = [row for row in page.tables[0].all("tr") if row.attributes.get("data-method")]
    changes = [float(cell.attributes["data-v"]) for row in rows[:-1] for cell in row.all("td") if "c" in cell.classes]
    assert changes == sorted(changes) and rows[-1].attributes["data-method"] == "M11" and "oracle" in rows[-1].classes
    assert "Of 10 methods" in page.of_class("answer")[0].text


def test_a_method_far_away_is_an_arrow(with_trials):
    """It does not squeeze the others, and one in which every run failed has empty cells."""
    columns = {name: [factor * x for x in values(40)] for name, factor in (("A", 1), ("B", 0.9), ("far", 1000))}
    page = page_of(with_trials(columns | {"dead": ["diverged"] * 40}))
    assert faults(page, columns) == []
    rows = {row.attributes["data-method"]: row for row in page.tables[0].all("tr") if row.attributes.get("data-method")}
    assert [each.classes for each in rows["far"].all("b")][-1] == ["right"] and "\u00d71000" in rows["far"].text
    cells = [each.text for each in rows["dead"].all("th", "td") if "more" not in each.classes]
    assert cells == ["dead", "", "", "", "", "fails more 40 of 40 failed"] and not list(rows["dead"].all("b"))
    assert "Arrow: beyond the axis." in page.of_class("note")[0].text
    assert page.folds["Failures"] == "diverged (all 40, dead)"


def test_events_that_do_not_occur_and_differences(with_trials, make_trials):
    """Counts and median in place of the mean, shares of the runs in place of a change; differences have a unit."""
    info = MetricInfo("settling_time", "s", "lower", may_not_occur=True)
    columns = {"A": [np.inf] * 20 + [5.0] * 20, "B": np.linspace(1, 4, 40).tolist()}
    page = page_of(with_trials(make_trials({"settling_time": columns}, infos=(info,))))
    assert faults(page, ["A", "B"]) == []
    heads, first, second = page.rows(page.tables[0])
    assert heads[1] == "occurred; median settling time [s]" and heads[4] == "better in"
    assert first[1] == "20 of 40; -" and second[1].startswith("40 of 40; 2.5") and second[4].startswith("100 % [")
    assert "ties count half" in page.of_class("note")[0].text
    assert page.folds["Worst runs"] == "run 0 has no settling time with A"
    info = MetricInfo("bias", "rad", "lower")
    columns = {"A": np.linspace(-1, 1, 40).tolist(), "B": np.linspace(-2, 0.5, 40).tolist()}
    page = page_of(with_trials(make_trials({"bias": columns}, infos=(info,))))
    heads, _, row = page.rows(page.tables[0])
    assert any(head.startswith("difference from A [rad]") for head in heads) and " rad [" in row[4]


def test_a_smoke_run_and_moments_without_runs(with_trials, make_trials):
    """A smoke run says what ran; without runs the table of the error is the main one."""
    trials = replace(make_trials({"mse": {"A": [1.0, 2.0], "B": [1.0, "diverged"]}}), with_verdicts=False)
    page = page_of(with_trials(trials))
    assert faults(page, ["A", "B"]) == [] and page.of_class("banner")[0].text.startswith("Smoke run.")
    assert page.rows(page.tables[0])[1:] == [["A", "ran 2 runs"], ["B", "failed 1 of 2 runs failed"]]
    none = {name: np.zeros(0) for name in ("method", "run", "status", "mse")}
    page = page_of(with_trials(replace(make_trials({"mse": {"A": [], "B": []}}), columns=none)))
    assert page.of_class("answer")[0].text.startswith("Exact moments")


@pytest.mark.parametrize("failed", [False, True])
def test_an_unfinished_experiment(with_trials, make_trials, failed):
    """48 runs of A, 47 of B, of 60: a banner and no failure but the one that failed.

    A failure counts as a value at least 10 times worse.  One of 47 runs has the 95 % interval up to 11.3 % (Clopper and
    Pearson), and 0.887 ln 0.8 + 0.113 ln 10 is 0.06: above 0, so that the failure may hide that B is not better.
    """
    b = ["diverged" if failed and run == 5 else 0.8 * x for run, x in enumerate(values(48))]
    trials = make_trials({"mse": {"A": values(48), "B": b}})
    trials = replace(trials, columns=arrays(trials.frame.iloc[:-1])).common
    page = page_of(with_trials(trials, extent=extent_of(trials, 60), incomplete=("B",)))
    assert "Unfinished: 47 of 60 runs." in page.of_class("banner")[0].text
    found = "So far B is inconclusive with 47 runs." if failed else "So far B is better than A"
    assert page.of_class("answer")[0].text.startswith(found)
    assert ("Failures" in page.folds) == failed and "47 runs per method" in page.of_class("note")[0].text


def test_the_page_is_valid_html_and_the_policy_allows_its_script_alone(html, make_source):
    tree = html5lib.HTMLParser(strict=True, namespaceHTMLElements=False).parse(html)
    ids = [element.get("id") for element in tree.iter() if element.get("id")]
    assert len(ids) == len(set(ids)) and {"claims", "figure-boxplot"} <= set(ids)
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]*)"', html)[1].replace("&#39;", "'")
    script = re.search(r"<script>(.*?)</script>", html, re.DOTALL)[1]
    digest = b64encode(sha256(script.encode()).digest()).decode()
    assert policy.startswith(f"default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-{digest}'")
    assert html.count("<script") == 1 and len(script) < 4000 and not re.search(r"@import|url\((?!#)", html)
    one, other = (render_html("page.html", page_context(make_source())) for _ in range(2))
    assert one == other and len(one) < 40_000


@pytest.mark.parametrize("name", ["html", "markdown"])
def test_texts_of_a_user_are_escaped(request, name):
    """They stand on the page as they are, and none of them becomes an element, a link or a cell of its own."""
    text = request.getfixturevalue(name)
    assert "alert(" in text and "<script>alert" not in text
    if name == "html":
        assert 'href="http://evil' not in text and faults(Page(text), ["A", "B"]) == []
    else:
        assert "](http://evil" not in text.replace("\\](http", "") and not re.search(r"(?<!\\)<script", text)
        for block in re.findall(r"(?:^\|.*\n)+", re.sub(r"\\\|", "", text), re.MULTILINE):
            assert len({line.count("|") for line in block.splitlines()}) == 1, block


@pytest.mark.parametrize("name", ["$Q'Q$", "a % b", "<b>x</b>", 'say "so"', "x" * 60, "back\\slash", "$x_{k|k}$ & y"])
def test_a_name_is_text_and_a_label_may_have_formulas(with_trials, make_trials, name):
    columns = {"A": values(40), name: [0.8 * x for x in values(40)]}
    source = with_trials(make_trials({"mse": columns}, labels={name: r"$\delta_v^2$ and <i>"}))
    page = page_of(source)
    [row] = [each for each in page.tables[0].all("tr") if each.attributes.get("data-method") == name]
    assert row.inside[0].inside[0] == name
    assert "".join(name.split()) in "".join(page.of_class("answer")[0].shown.split())
    small = next(row.all("small"))
    assert small.text.replace(" ", "") == "\u03b4v2and<i>" and [each.tag for each in small.all()] == ["sub", "sup"]
    assert render_markdown("page.md", page_context(source)).count("\n| ") == 4


def test_claims_stand_open_with_their_assumptions_folded(html, markdown):
    """One ratio in all of 40 runs does not show what others may be.  Open are 100 words, fewer below a large table."""
    page = Page(html)
    [claims] = page.of_class("claims")
    items = [each for each in claims.inside if getattr(each, "tag", "") == "li"]
    assert len(items) == 2 and "additional, not in the paper" in items[1].text and "2 assumptions" in items[0].shown
    assert "One." not in items[0].shown and "One." in items[0].text and "**inconclusive**" in markdown
    items = [ClaimItem("confirmed", "word " * 18, "ours", "", [])] * 12
    assert [n_open(items, n_table) for n_table in (0, 140, 180, 1000)] == [5, 5, 3, 1]
    assert n_open([ClaimItem("confirmed", "Short", "ours", "", [])] * 12, 0) == 8 and n_open([], 0) == 0


def test_figures_of_one_kind_and_subject_are_one_fold(make_source):
    texts = {"boxplot": "Boxes of a", "boxplot-2": "Boxes of a", "boxplot-3": "Boxes of b"}
    figures = [PageFigure(name, "boxplot", f"{text}: quartiles.", "<svg></svg>", []) for name, text in texts.items()]
    folds = page_of(make_source(figures=figures)).folds
    assert folds["2 figures boxplot"] == "Boxes of a" and folds["Figure boxplot-3"] == "Boxes of b"


@pytest.mark.parametrize(("n", "n_tables"), [(6, 5), (7, 2)])
def test_heat_tables_of_more_than_six_methods_are_folded(with_trials, sweep_of, n, n_tables):
    """The baseline is one of them."""
    page = page_of(with_trials(sweep_of(SWEEPS["two paths"], {f"M{k}": 1 + 0.1 * k for k in range(n)})))
    folded = [each for each in page.root.all("details") if next(each.all("summary")).text == "4 more methods"]
    assert len(page.tables) == n_tables and [len([*each.all("table")]) for each in folded] == [4] * (n == 7)


def test_the_foot_has_what_is_needed_to_repeat(html, markdown):
    foot = next(Page(html).root.all("footer"))
    found = dict(zip([e.text for e in foot.all("dt")], [e.text for e in foot.all("dd")], strict=True))
    assert found["command"] == "rmpc-bench run configs/zenere2018/tiny.yaml" and found["seed"] == "7"
    assert found["hash"] == "0123456789ab" and found["computed"] == "2026-01-02"
    assert found["version"].startswith("rmpc-bench 0.1.0")
    assert {each.attributes["href"] for each in foot.all("a")} == {"trials.csv", "report.md", "tables/"}
    assert f"- command: `{found['command']}`" in markdown and "[report.html](report.html)" in markdown


def test_limits_requirements_and_the_worst_runs(make_source):
    page = page_of(make_source(overrides=("--runs 3",), left_out=("boxplot: too small",), confounded=("B",)))
    [fold] = [each for each in page.of_class("fold") if "Limits" in each.inside[0].text]
    for words in ("overridden", "figure is missing", "uncommitted changes", "Both the estimator and the controller"):
        assert words in fold.text
    assert "For information only" in page.root.text and "No parameter was tuned: all are as published" in fold.text
    requirement = Requirement("mse < 1", "mse", (Limit("<", 1.0),))
    plain = make_source(n=80)
    trials = replace(plain.trials, requirements=(requirement,))
    page = page_of(replace(plain, trials=trials, requirements=requirements_table(trials)))
    assert page.folds["Requirements"].startswith("mse < 1 in ") and [*page.folds][1] == "Requirements"
    [worst] = [each for each in page.of_class("fold") if "Worst" in each.inside[0].text]
    rows = page.rows(next(worst.all("table")))
    assert rows[0][3:] == ["95 % quantile", "mean of the worst 5 %"] and all("[" in row[3] for row in rows[1:])
    assert "rmpc-bench show results/zenere2018/tiny --run" in worst.text


def test_tuning_has_values_ranks_and_cost(make_source):
    plain = make_source()
    found = tuning(search("B", constant([2, 1]), constant([2, 1, 9], 40), values=[1.0, 10.0], seconds=12.0))
    trials = replace(plain.trials, parameters={"A": "default", **found.parameters})
    page = page_of(replace(plain, trials=trials, tuning=TuningTable(trials, found)))
    [fold] = [each for each in page.of_class("fold") if each.inside[0].text.startswith("Tuning")]
    assert [[row[0] for row in page.rows(each)[1:]] for each in fold.all("table")] == [["B"], ["A", "B"]]
    # 2 values in 3 tuning runs, and these and the default in 40 runs.
    assert "Cost: 126 trials, 12 s of computing time." in fold.text and "rank" in fold.text
    limits = next(each for each in page.of_class("fold") if "Limits" in each.inside[0].text)
    assert "Tuned values at the end of their range: B" in limits.text and "A: default, not tuned" in limits.text


def test_an_event_that_never_occurs(with_trials, make_trials):
    info = MetricInfo("settling_time", "s", "lower", may_not_occur=True)
    columns = {name: [np.inf] * 40 for name in "AB"}
    page = page_of(with_trials(make_trials({"settling_time": columns}, infos=(info,))))
    heads, first, second = page.rows(page.tables[0])
    assert heads[2] == "runs: 5 %, quartiles, 95 %" and first[1] == second[1] == "0 of 40"
    cells = [cell for cell in page.tables[0].all("td") if "d0" in cell.classes]
    assert [[each.classes for each in cell.all("u", "i", "b")] for cell in cells] == [[["right"]]] * 2
    assert "Arrow: runs without the event." in page.of_class("note")[0].text and "Worst runs" not in page.folds


@pytest.mark.parametrize(("n", "shape"), [(6, ["two"]), (9, ["two", "narrow"]), (13, ["one"])])
def test_a_matrix_with_many_columns_stands_beside_a_small_drawing(with_trials, sweep_of, n, shape):
    points = [{"plant.a": str(k)} for k in range(14)]
    trials = sweep_of(points, {f"M{k}": 1 + 0.01 * k for k in range(n)}, n=12)
    page = page_of(with_trials(trials, drawings={"wide": "<svg></svg>"}))
    assert [div.classes for div in page.root.all("div") if {"one", "two"} & {*div.classes}] == [shape]
