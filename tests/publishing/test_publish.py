"""publish, compare, judge and figure: all that the command line writes, from Python."""

import csv
import html
import json
import re
import shlex
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from pypdf import PdfReader
from small_experiment import cli, write

from rmpc_bench import compare, figure, judge, load_config, load_results, publish, run, summarise
from rmpc_bench.store.store import Store
from rmpc_bench.types import DesignError

CLAIMS = "[{says: small, check: 'mean(mse[S-MPC]) < 1000', finding: confirmed}, {says: not testable here}]"
FIGURES = "[boxplot, {kind: signals, signals: [y]}, {kind: boxplot, metric: input_power}]"
KEYS = {
    "claims": CLAIMS.replace("[S-MPC]", "[S-MPC, seed=7]"),
    "figures": FIGURES,
    "record": "{runs: 2}",
    "sweep": "{grid: {seed: [7, 8]}}",
}
NOT_DERIVED = {
    "config.yaml",
    "config.resolved.yaml",
    "manifest.json",
    "progress.json",
    "published.json",
    "trials.sqlite",
}
SCRIPT = """
import sys
from contextlib import closing
import rmpc_bench
written = rmpc_bench.publish(rmpc_bench.load_results("out"), to="again")
assert all(path.is_file() for path in written.paths)
print(*sorted(name for name in sys.modules if name.startswith(("rmpc_bench.cli", "click"))))
"""


def tree(directory):
    """Every file of a directory with its bytes."""
    return {
        path.relative_to(directory).as_posix(): path.read_bytes() for path in directory.rglob("*") if path.is_file()
    }


@pytest.fixture(scope="module")
def directory(tmp_path_factory):
    """Return a directory that the command line has filled."""
    here = tmp_path_factory.mktemp("publish")
    result = cli("run", write(here, **KEYS), "-o", here / "out", "-j", 1, "--progress", "none")
    assert result.exit_code == 0, result.output
    return here / "out"


@pytest.fixture(scope="module")
def results(directory):
    """Return the results in it."""
    return load_results(directory)


def test_publish_writes_every_file_of_the_command_line_without_it(directory):
    """The same bytes, from another process that imports neither `rmpc_bench.cli` nor click."""
    command = [sys.executable, "-c", SCRIPT]
    done = subprocess.run(command, cwd=directory.parent, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == ""
    expected = {name: data for name, data in tree(directory).items() if name not in NOT_DERIVED}
    again = tree(directory.parent / "again")
    assert set(again) == set(expected)
    assert {name for name in expected if again[name] != expected[name]} == set()


def test_publication_names_its_files(results, tmp_path):
    """Every file is listed, and nothing else is written."""
    written = publish(results, to=tmp_path / "out")
    assert {path.relative_to(tmp_path / "out").as_posix() for path in written.paths} == set(tree(tmp_path / "out"))
    assert written.left_out == () and written.differing == ()
    assert [verdict.finding for verdict in written.verdicts] == ["confirmed", "not-testable"]


def test_no_file_outside_the_directory_is_written(results, tmp_path):
    """A directory of somebody else may hold symbolic links; a link to a directory is refused before anything is."""
    mine, there = tmp_path / "mine.txt", tmp_path / "there"
    mine.write_text("mine", encoding="utf-8")
    (there / "tables").mkdir(parents=True)
    names = ("report.html", "report.md", "summary.csv", "traces.npz", "claims.json", "tables/summary.md")
    for name in names:
        (there / name).symlink_to(mine)
    publish(results, to=there)
    assert mine.read_text(encoding="utf-8") == "mine"
    assert not any((there / name).is_symlink() for name in names)
    refused = tmp_path / "refused"
    refused.mkdir()
    (refused / "figures").symlink_to(tmp_path, target_is_directory=True)
    with pytest.raises(OSError, match="figures is a symbolic link"):
        publish(results, to=refused)
    assert not list(refused.glob("*.csv"))


def test_summary_of_a_publication(results, directory, tmp_path):
    """The text of `report`, but for the directory."""
    shown = cli("report", directory).stdout
    # Of a path as long, as commands of long paths leave less room for notes.
    other = directory.with_name(directory.name[:-1] + "_")
    text = publish(results, to=other).summary()
    assert text.replace(str(other), str(directory)).strip() == shown.strip()
    assert str(publish(results, to=other)) == text


def test_results_of_run_and_of_load_results_agree(tmp_path):
    """`run` returns what `load_results` finds."""
    config = load_config(write(tmp_path))
    there = run(config, directory=tmp_path / "out", jobs=1)
    again = load_results(tmp_path / "out")
    assert there.trials.frame.equals(again.trials.frame) and there.series.equals(again.series)
    assert there.uncertainty.equals(again.uncertainty) and there.is_final and again.is_final


@pytest.mark.parametrize(
    ("options", "overrides"),
    [
        ({}, ()),
        ({"runs": 6}, ()),
        ({"runs": 3}, ("--runs 3",)),
        ({"overrides": ["execution.block=3"]}, ()),
        ({"overrides": ["seed=8"], "smoke": True}, ("-s seed=8", "--smoke")),
    ],
)
def test_an_overridden_configuration_is_not_final(tmp_path, options, overrides):
    """Findings are those of the file at full size; a directory remembers what was overridden."""
    config = load_config(write(tmp_path, smoke="{runs: 2, steps: 5}"), **options)
    results = run(config, directory=tmp_path / "out", jobs=1)
    assert results.overrides == load_results(tmp_path / "out").overrides == overrides
    assert results.is_final == (not overrides)


def test_a_smoke_run_shows_sizes_only(tmp_path):
    """Its first line says so; no verdict, no finding and no size of a difference on the screen, none in the tables."""
    config = load_config(write(tmp_path, claims=CLAIMS, smoke="{runs: 2, steps: 5}"), smoke=True)
    written = publish(run(config, directory=tmp_path / "out", jobs=1))
    lines = written.summary().splitlines()
    assert lines[0] == "tiny   smoke run: 2 of 2 runs, 0 failed"
    assert [line.split() for line in lines if line.startswith((" S-MPC", " R-MPC"))] == [
        ["S-MPC", "ran"],
        ["R-MPC", "ran"],
    ]
    assert " claims: not evaluated, a smoke run is too short" in lines
    page = (tmp_path / "out" / "tables" / "summary.md").read_text()
    for text in (*lines, page):
        for word in ("better", "worse", "inconclusive", "equivalent", "confirmed", "%"):
            assert word not in text.replace("intervals at 95 %", "").replace("lower is better", "")
    assert written.tables.compared["verdict"].eq("").all()


def test_default_directory_of_run(tmp_path, monkeypatch):
    """results/<paper>/<name>, as the command line."""
    monkeypatch.chdir(tmp_path)
    results = run(load_config(write(tmp_path, paper="p")), jobs=1)
    assert results.directory == Path.cwd() / "results/p/tiny" and (results.directory / "trials.sqlite").exists()


def test_an_incomplete_experiment_is_not_final(tmp_path):
    """A method that is missing is named, and findings are information."""
    config = load_config(write(tmp_path, claims=CLAIMS, figures="[{kind: boxplot, order: [R-MPC]}]"))
    results = run(config, directory=tmp_path / "out", jobs=1, only=["S-MPC"])
    assert not results.is_final and results.incomplete == ("R-MPC: 0 of 6 runs",)
    written = publish(results)
    assert " claims: not evaluated, runs are missing (R-MPC: 0 of 6 runs)" in written.summary()
    assert len(written.left_out) == 1 and written.left_out[0].startswith("boxplot: ")
    assert "information" in (tmp_path / "out" / "claims.md").read_text()


def test_compare(results):
    """One row per point, metric and method, with the numbers of comparisons.csv."""
    table = compare(results)
    assert table.to_frame().equals(summarise(results).compared)
    one = compare(results, metric="mse", methods=["R-MPC"], baseline="S-MPC").to_frame()
    frame = table.to_frame()
    assert one.equals(frame[frame["metric"] == "mse"].reset_index(drop=True))
    assert set(frame.columns[:1]) == {"seed"} and len(frame) == 4


def test_compare_with_another_baseline(results):
    """The methods exchange their places, and so do won and lost."""
    forth = compare(results, metric="mse").to_frame()
    back = compare(results, metric="mse", baseline="R-MPC").to_frame()
    assert list(back["method"]) == ["S-MPC", "S-MPC"] and list(back["baseline"]) == ["R-MPC", "R-MPC"]
    assert list(forth["won"] + forth["tied"]) == list(back["lost"] + back["tied"])


def test_compare_in_other_forms(results):
    """Sentences, Markdown and plain data have the same rows."""
    table = compare(results, metric="mse", relevant=0.02, confidence=0.9)
    sentences, text = str(table).splitlines(), table.to_markdown()
    assert sum("R-MPC" in line and "S-MPC" in line and "90 %" in line for line in sentences[:2]) == 2
    assert text.count("| R-MPC |") == 2 and "within 2 %" in text and text.endswith("\n")
    assert [row["method"] for row in table.to_dict()] == ["R-MPC", "R-MPC"]


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"metric": "mes"}, "metric: 'mes' is not a known metric; did you mean 'mse'"),
        ({"methods": ["R"]}, "methods: 'R' is not a known method"),
        ({"baseline": "R"}, "baseline: 'R' is not a known method"),
        ({"confidence": 95}, "between 0 and 1"),
        ({"relevant": -1}, "at least 0"),
    ],
)
def test_compare_refuses_what_it_does_not_know(results, keys, message):
    """By a message that names the mistake."""
    with pytest.raises(DesignError, match=message):
        compare(results, **keys)


def test_judge(results):
    """One verdict per claim, in the order of the file."""
    verdicts = judge(results)
    assert [verdict.claim.says for verdict in verdicts] == ["small", "not testable here"]
    assert not any(verdict.differs for verdict in verdicts)


def test_figure_is_the_published_one(results, directory, tmp_path):
    """The same bytes as the file that `publish` has written; keys are those of the YAML."""
    picture = figure(results, "boxplot", metric="input_power")
    file = picture.save(tmp_path / "mine.svg")
    assert file.read_bytes() == (directory / "figures" / "boxplot-2.svg").read_bytes()
    assert len(picture.axes) == 2
    window = figure(results, "signals", signals=["y"], from_=0.2, to="1/2")
    assert window.axes[0].get_xlim()[0] >= 0.1


@pytest.mark.parametrize(
    ("kind", "keys", "message"),
    [
        ("boxplott", {}, "did you mean 'boxplot'"),
        ("boxplot", {"widht": 3}, "did you mean 'width'"),
        ("boxplot", {"width": 0.1}, "width: must be >= 1"),
        ("boxplot", {"metric": "mes"}, "mes"),
        ("signals", {"signals": ["x"]}, "x"),
    ],
)
def test_figure_refuses_what_the_yaml_refuses(results, kind, keys, message):
    """A key that is unknown, out of its range, or names what is not there."""
    with pytest.raises(DesignError, match=message):
        figure(results, kind, **keys)


def test_an_unknown_ending_is_refused(results, tmp_path):
    """The message lists the formats."""
    with pytest.raises(ValueError, match=r"one of \.svg, \.png, \.pdf"):
        figure(results, "boxplot").save(tmp_path / "figure.txt")


@pytest.mark.parametrize("lost", ["damaged", "fresh and deleted", "store damaged"])
def test_looks_stay_where_the_manifest_is_lost(tmp_path, lost):
    """A third number of runs is look 3, with the level of look 3; another experiment begins with look 1."""
    path, out = write(tmp_path), tmp_path / "out"

    def look(n_runs, *options):
        result = cli("run", path, "-o", out, "-j", 1, "--progress", "none", "--runs", n_runs, *options)
        assert result.exit_code == 0, result.output
        row = next(csv.DictReader((out / "comparisons.csv").read_text().splitlines()))
        return int(row["look"]), float(row["ci_level"])

    assert look(6)[0] == 1 and look(8)[0] == 2
    assert json.loads((out / "manifest.json").read_text())["looks"] == [6, 8]
    if "store" in lost:
        (out / "trials.sqlite").write_bytes(b"x")
    elif "damaged" in lost:
        (out / "manifest.json").write_text("{")
        assert "remove the file" in cli("run", path, "-o", out, "--runs", 10).stderr
    if "deleted" in lost or "damaged" == lost:
        (out / "manifest.json").unlink()
    options = ["--fresh"] if "fresh" in lost or "store" in lost else []
    assert look(10, *options) == (3, pytest.approx(1 - 0.05 / 12, abs=1e-6))
    assert json.loads((out / "manifest.json").read_text())["looks"] == [6, 8, 10]
    if lost == "fresh and deleted":
        assert look(12, "--fresh", "-s", "seed=9")[0] == 1


def test_the_looks_of_a_store_without_them_are_those_of_its_manifest(tmp_path):
    """An earlier version kept them there alone; a look that is noted from now on is in the store."""
    path, out = write(tmp_path), tmp_path / "out"
    assert cli("run", path, "-o", out, "-j", 1, "--progress", "none", "--runs", 6).exit_code == 0
    with closing(sqlite3.connect(out / "trials.sqlite")) as connection:
        connection.execute("DELETE FROM meta WHERE key = 'looks'")
        connection.commit()
    assert cli("run", path, "-o", out, "-j", 1, "--progress", "none", "--runs", 8).exit_code == 0
    with Store(out, writable=False) as store:
        assert store.data("looks") == {"runs": [6, 8]}
    with closing(sqlite3.connect(out / "trials.sqlite")) as connection:
        connection.execute("UPDATE meta SET value = '{\"runs\": [-1]}' WHERE key = 'looks'")
        connection.commit()
    result = cli("report", out)
    assert result.exit_code == 2 and "looks: runs" in result.stderr


def test_commands_of_the_page_name_files_that_exist(tmp_path, monkeypatch):
    """A file and a directory with a blank, below the present directory; from elsewhere the file has its old name."""
    (tmp_path / "my configs").mkdir()
    write(tmp_path / "my configs", runs=2)
    monkeypatch.chdir(tmp_path)
    file, out = "my configs/tiny.yaml", "sub/the results"
    assert cli("run", file, "-o", out, "-j", 1, "--progress", "none").exit_code == 0

    def commands():
        page = html.unescape((tmp_path / out / "report.html").read_text())
        found = re.findall("<code>(rmpc-bench (?:run|check|report|show) [^<]*)</code>", page)
        return {tuple(shlex.split(text)[1:3]) for text in found}

    assert commands() == {("run", file), ("show", out)}
    monkeypatch.chdir(tmp_path / "sub")
    assert cli("report", "the results").exit_code == 0
    assert commands() == {("run", "tiny.yaml"), ("show", "the results")}
    monkeypatch.chdir(tmp_path)
    assert cli("report", out).exit_code == 0 and ("run", file) in commands()


def test_raising_the_runs_after_a_verdict_is_a_look(tmp_path):
    """Intervals at alpha / 6 in the second one; the first one stays as it is, also when it is published again."""
    file, out = write(tmp_path, runs=6), tmp_path / "out"
    looks = []
    for n_runs in (6, 6, 12, 6):
        result = cli("run", file, "-o", out, "--runs", n_runs, "-j", 1, "--progress", "none")
        assert result.exit_code == 0, result.output
        with open(out / "comparisons.csv", encoding="utf-8") as lines:
            row = next(csv.DictReader(lines))
        looks.append((int(row["look"]), row["n_pairs"], float(row["ci_level"])))
        assert ("look 2" in result.stdout) == (n_runs == 12)
    assert looks == [(1, "6", 0.95), (1, "6", 0.95), (2, "12", 0.991667), (1, "6", 0.95)]


def test_files_for_papers_have_the_labels_of_methods_and_all_others_their_keys(tmp_path):
    """PDF and its caption; SVG for file and page, and the caption of the page."""
    methods = "{S-MPC: {estimator: {kind: kalman}, label: standard control}}"
    path = write(tmp_path, methods=methods, statistics="{}", record="{runs: 1}", figures="[signals]", runs="2")
    written = publish(run(load_config(path), directory=tmp_path / "out", jobs=1))
    (figure_,) = written.figures
    files = {file.suffix: file for file in figure_.paths}
    assert "standard control" in PdfReader(files[".pdf"]).pages[0].extract_text()
    assert "standard control" in files[".tex"].read_text() and "standard control" not in figure_.caption
    for svg in (files[".svg"].read_text(), figure_.svg):
        assert ">S-MPC</text>" in svg and 'data-method="S-MPC"' in svg and "standard control" not in svg
