"""What the last line of a cell shows: one line of text, tables as HTML, figures as SVG; tables alike; the logger."""

import logging
import re

import numpy as np
import pandas as pd
import pytest
from small_experiment import write

import rmpc_bench
from rmpc_bench import compare, figure, filter_data, load_config, run, run_one, summarise
from rmpc_bench.report.point_tables import html_table

MOST = 3000
SWEEP = "{grid: {controller.Hp: [8, 10]}}"


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    path = write(tmp_path_factory.mktemp("shown"), sweep=SWEEP, statistics="{ranks: true, requirement: mse < 1}")
    return load_config(path)


@pytest.fixture(scope="module")
def results(config, tmp_path_factory):
    return run(config, directory=tmp_path_factory.mktemp("results"), jobs=1)


@pytest.fixture(scope="module")
def shown(config, results):
    """Everything that a public function returns and that a cell may end with."""
    model = rmpc_bench.LinearModel(0.9, [[1]], [[1]], 0.01, 0.04)
    estimates = filter_data(rmpc_bench.estimator("kalman", model, x0=0, P0=1), np.zeros((500, 1)), np.zeros((500, 1)))
    tables = [compare(results), results.comparison, summarise(results), rmpc_bench.drivers(results)]
    tables += [rmpc_bench.requirements(results), rmpc_bench.ranks(results), rmpc_bench.tuning(results)]
    others = [config, results, results.trials, run_one(config, "S-MPC"), estimates, figure(results, "boxplot")]
    others += [rmpc_bench.publish(results), rmpc_bench.compare_results(results, results)]
    return [*tables, *others, rmpc_bench.compare_improvements(results, results, "R-MPC")]


def test_everything_has_a_line_of_text(shown):
    for each in shown:
        assert "\n" not in repr(each) and len(repr(each)) < 200, type(each)
        assert re.match(rf"<({type(each).__name__}|run 0)\b", repr(each))


def test_tables_are_html_and_figures_svg_of_limited_length(shown):
    kinds = {type(each).__name__: each for each in shown}
    for name in ("Results", "Summary", "ComparisonTable", "DriversTable", "RequirementsTable", "RanksTable"):
        html = kinds[name]._repr_html_()
        assert html.startswith("<table>") and len(html) < MOST, name
    assert "<table>" not in kinds["TuningTable"]._repr_html_()
    assert kinds["FigureResult"]._repr_svg_().lstrip().startswith(("<?xml", "<svg"))


def test_the_table_is_that_of_the_page(results):
    """Oracle: the pages of tables in Markdown."""
    html = results._repr_html_()
    assert html == results.comparison._repr_html_() == summarise(results)._repr_html_()
    html, _, note = html.partition("</table><p>")
    rows = [re.split("<t[dh]>", row)[1:] for row in html.split("<tr>")[1:]]
    assert rows[0][:2] == ["point", "method"] and len(rows) == 5
    assert [row[:2] for row in rows[1:]] == [
        [f"controller.Hp={Hp}", name] for Hp in (8, 10) for name in ("S-MPC", "R-MPC")
    ]
    markdown = summarise(results).to_markdown()
    for row in rows[1:]:
        for text in row[2:]:
            assert text.replace("\N{MINUS SIGN}", "-") in markdown.replace("\N{MINUS SIGN}", "-")
    assert re.match(r".* against S-MPC\. \d+ runs per point and method on the same draws\.", note)


def test_a_long_table_is_cut_and_says_so():
    columns = {"method": [f"M{i}" for i in range(300)], "value": ["<b>x</b>"] * 300}
    html = html_table(columns)
    shown = html.count("<tr><td>")
    assert len(html) < MOST and f"{300 - shown} more rows: to_frame()" in html
    assert "<b>" not in html and "&lt;b&gt;" in html


def test_tables_are_written_alike(results):
    for table in (summarise(results), compare(results), results.comparison):
        assert isinstance(table.to_frame(), pd.DataFrame) and len(table.to_frame())
        assert table.to_markdown().startswith(("#", "|")) and r"\begin{tabular}" in table.to_latex()
    assert results.comparison.to_latex() == summarise(results).to_latex()
    assert compare(results, "mse").to_frame().equals(results.comparison.to_frame())
    assert compare(results, "input_power").to_latex() == summarise(results).to_latex("input_power")
    assert summarise(str(results.directory)).to_frame().equals(summarise(results).described)


def test_a_narrow_table_for_a_paper_says_what_is_left_out(results):
    head = results.comparison.to_latex(width=100).splitlines()[0]
    assert re.fullmatch(r"% needs \\usepackage\{booktabs\}; wider than 100 pt with .*verdict \(choose columns\)", head)
    asked = results.comparison.to_latex(width=100, columns=["mean"])
    wide = results.comparison.to_latex(width=1000)
    assert asked.splitlines()[0] == wide.splitlines()[0] == r"% needs \usepackage{booktabs}"


def test_the_logger_gets_what_goes_to_stderr(tmp_path, capsys, caplog):
    config = load_config(write(tmp_path, runs=2))
    run(config, directory=tmp_path / "a", jobs=1, progress=True)
    on_stderr = capsys.readouterr().err
    assert "tiny: 4 trials" in on_stderr and not caplog.records
    with caplog.at_level(logging.INFO, "rmpc_bench"):
        run(config, directory=tmp_path / "b", jobs=1, progress=True)
    assert not capsys.readouterr().err
    assert [each.getMessage() for each in caplog.records if "trials" in each.getMessage()]
    assert {each.name for each in caplog.records} == {"rmpc_bench"} and not logging.getLogger("rmpc_bench").handlers
