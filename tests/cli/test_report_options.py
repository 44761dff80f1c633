"""Options of `report`: what they change, what they leave alone, and what they refuse before anything is written."""

import re
import shutil

import pytest
from small_experiment import cli, ran, write

from rmpc_bench.config.load import load_config
from rmpc_bench.figures.style import Rendering
from rmpc_bench.publishing.publish import choose, publish
from rmpc_bench.results.results import load_results
from rmpc_bench.types import ConfigError, DesignError


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """A finished experiment with a boxplot."""
    place = tmp_path_factory.mktemp("stored")
    ran(write(place, figures="[boxplot]"), place / "out")
    return place / "out"


def tree(directory):
    """Every file of a directory with its bytes and the time of its last change."""
    return {
        path.relative_to(directory).as_posix(): (path.read_bytes(), path.stat().st_mtime_ns)
        for path in directory.rglob("*")
        if path.is_file()
    }


def test_another_directory(stored, tmp_path):
    """Everything is written there, and nothing to the directory of the results."""
    before = tree(stored)
    options = ["--width", "252pt", "--order", "R-MPC,S-MPC", "--metric", "input_power", "--format", "pdf,svg"]
    result = cli("report", stored, "--to", tmp_path / "new", *options, "--columns", "mean,n")
    assert result.exit_code == 0, result.output
    assert tree(stored) == before
    written = {path.name for path in (tmp_path / "new").rglob("*")}
    assert {
        "boxplot.pdf",
        "boxplot.svg",
        "boxplot.caption.tex",
        "input_power.tex",
        "input_power.caption.tex",
    } <= written
    assert not {"boxplot.png", "mse.tex"} & written
    table = (tmp_path / "new" / "tables" / "input_power.tex").read_text()
    assert table.index("R-MPC") < table.index("S-MPC") and "Won" not in table
    markdown = (tmp_path / "new" / "tables" / "summary.md").read_text()
    assert "## mse" not in markdown and markdown.index("| R-MPC") < markdown.index("| S-MPC")
    assert "mean input power" in result.stdout
    svg = (tmp_path / "new" / "figures" / "boxplot.svg").read_text()
    assert 'viewBox="0 0 251.1 ' in svg and svg.index(">R-MPC") < svg.index(">S-MPC") and "input" in svg
    assert re.match(r"% written by rmpc-bench, version .*\n% experiment tiny, hash \w{64}\n% seed 7, n = 6 runs", table)


@pytest.mark.parametrize("given", [True, False])
def test_rows_are_no_part_of_the_experiment(tmp_path, given):
    """The key belongs to the resolved configuration, and not to the hash."""
    config, other = (load_config(write(tmp_path), overrides=keys) for keys in ([], [f"report.trials={given}"]))
    assert config.hash == other.hash and config.points[0].method_keys == other.points[0].method_keys
    assert [each.resolved["report"].get("trials") for each in (config, other)] == [None, given]


def test_only_figures_that_are_asked_for_are_files(stored, tmp_path):
    """In the formats that are asked for; what only the page shows is no file."""
    for formats, there in (("pdf", False), ("pdf,svg", True)):
        result = cli("report", stored, "--to", tmp_path / formats, "--format", formats)
        assert result.exit_code == 0, result.output
        names = {path.name for path in (tmp_path / formats / "figures").iterdir()}
        assert names == {"boxplot.caption.tex", *(f"boxplot.{ending}" for ending in formats.split(","))}
        # What Markdown cannot show is linked.
        markdown = (tmp_path / formats / "report.md").read_text()
        link = "![boxplot](figures/boxplot.svg)" if there else "\n[boxplot](figures/boxplot.pdf)"
        assert link in markdown


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--width", "252px"], "--width: must be a length such as '252pt', '88mm' or '3.5in'; the units are pt, bp"),
        (["--width", "2mm"], "--width: the width must be between 1 in and 100 in"),
        (["--font", "tmies"], "--font: must be one of dejavu, stix, times (got 'tmies')"),
        (["--style", "journal"], "--style: must be one of bench, paper"),
        (["--format", "png,jpg"], "--format: must be one of svg, pdf, png, pgf (got 'jpg')"),
        (["--columns", "men"], "--columns: must be one of mean, lost, median,"),
        (["--metric", "msee"], "--metric: 'msee' is not a known metric of this experiment; did you mean 'mse'?"),
        (["--order", "S-MCP"], "--order: 'S-MCP' is not a known method; did you mean 'S-MPC'?"),
        (["--order", "R-MPC,R-MPC"], "--order: order must name each entry once"),
        (["--order", ","], "--order: must name at least one of S-MPC, R-MPC"),
        (["--format", ""], "--format: must name at least one of svg, pdf, png, pgf"),
    ],
)
def test_wrong_options(stored, tmp_path, options, message):
    """Exit 2 with the choices, and no file; all errors at once."""
    result = cli("report", stored, "--to", tmp_path / "new", *options)
    assert result.exit_code == 2 and message in result.stderr and "Traceback" not in result.stderr
    assert not (tmp_path / "new").exists()


def test_all_errors_at_once(stored, tmp_path):
    """One line each."""
    result = cli("report", stored, "--to", tmp_path / "new", "--font", "x", "--order", "y", "--width", "z")
    assert result.exit_code == 2 and all(f"--{key}:" in result.stderr for key in ("font", "order", "width"))


def test_pgf_without_latex(stored, tmp_path, monkeypatch):
    """Exit 2 which says so before anything is written."""
    monkeypatch.setattr(shutil, "which", lambda name: None)
    result = cli("report", stored, "--to", tmp_path / "new", "--format", "pgf")
    assert result.exit_code == 2 and "pgf needs a LaTeX" in result.stderr
    assert not (tmp_path / "new").exists()


def test_section_of_the_configuration(tmp_path):
    """It says what the options say, belongs to no hash, and an option has precedence."""
    report = "{order: [R-MPC, S-MPC], width: 88mm, metrics: [input_power], format: svg, style: paper, font: stix}"
    path = write(tmp_path, figures="[boxplot]", report=report)
    plain = load_config(write(tmp_path, file="plain.yaml", figures="[boxplot]"))
    config = load_config(path)
    assert (config.hash, config.full_hash) == (plain.hash, plain.full_hash)
    ran(path, tmp_path / "out")
    assert {file.suffix for file in (tmp_path / "out" / "figures").iterdir()} == {".svg"}
    svg = (tmp_path / "out" / "figures" / "boxplot.svg").read_text()
    assert 'viewBox="0 0 249.4 ' in svg and "STIXGeneral" in svg and svg.index(">R-MPC") < svg.index(">S-MPC")
    assert cli("report", tmp_path / "out", "--width", "3.5in", "--font", "dejavu").exit_code == 0
    again = (tmp_path / "out" / "figures" / "boxplot.svg").read_text()
    assert 'viewBox="0 0 252 ' in again and "STIXGeneral" not in again
    assert load_config(tmp_path / "out" / "config.resolved.yaml").report == config.report


@pytest.mark.parametrize(
    ("report", "message"),
    [
        ("{order: [S-MCP]}", "report.order.0: 'S-MCP' is not a known method; did you mean 'S-MPC'?"),
        ("{metrics: [msee]}", "did you mean 'mse'?"),
        ("{width: 252}", "report.width"),
        ("{width: 252px}", "must be a length such as '252pt'"),
        ("{font: tmies}", "report.font: must be 'dejavu', 'stix' or 'times'"),
        ("{format: [jpg]}", "report.format"),
        ("{colour: red}", "'colour' is not a known key"),
    ],
)
def test_wrong_section(tmp_path, report, message):
    """Each error has its place."""
    with pytest.raises(ConfigError) as caught:
        load_config(write(tmp_path, report=report))
    assert message in str(caught.value) and "tiny.yaml:" in str(caught.value)


def test_python(stored, tmp_path):
    """The same from a notebook."""
    results = load_results(stored)
    written = publish(results, to=tmp_path / "new", rendering=Rendering(formats=("pdf",), width=4.0))
    assert {path.name for path in written.paths} >= {"boxplot.pdf", "mse.tex"}
    assert not [path for path in written.paths if path.suffix == ".png"]
    with pytest.raises(DesignError, match="did you mean 'mse'"):
        choose(results, metrics=["msee"])


def test_files_of_the_user_stay(stored, tmp_path):
    """A table of an earlier choice goes, a file that somebody else wrote does not."""
    place = tmp_path / "new"
    assert cli("report", stored, "--to", place).exit_code == 0
    (place / "tables" / "own.tex").write_text("my table")
    assert cli("report", stored, "--to", place, "--metric", "mse").exit_code == 0
    names = {path.name for path in (place / "tables").glob("*.tex")}
    assert names == {"mse.tex", "mse.caption.tex", "mse.note.tex", "own.tex"}
