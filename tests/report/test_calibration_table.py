"""Calibration from the YAML to words, files, page and screen; long names, sweeps, ranks and stored results."""

import csv
import json
import re
import sqlite3
from contextlib import closing
from dataclasses import replace
from html import unescape
from types import SimpleNamespace

import numpy as np
import pytest
from calibrated import coverage_trials, errors, of_squares
from calibrated_experiment import LINEAR, model, write
from small_experiment import cli

from rmpc_bench import load_results
from rmpc_bench.report.calibration_table import calibration_table
from rmpc_bench.report.ranks_table import RanksTable
from rmpc_bench.types.texts import width_of

OWN = '''
import numpy as np

from rmpc_bench import single_run


@single_run
class Filter:
    """Observer with a constant gain, which reports P at every second sample and calls it a bound."""

    P_is = "bound"

    def __init__(self, model, gaps: bool = True):
        self.model, self.gaps = model, gaps

    def start(self, x0):
        self.x_pred = x0

    def update(self, y, u_previous, k):
        x_hat = self.x_pred + np.array([0.4, 0.3]) * (y[0] - self.x_pred[0])
        self.x_pred = self.model.A @ x_hat
        return x_hat if self.gaps and k % 2 else (x_hat, 9.0 * np.eye(2))
'''


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """Return a directory of results of 150 runs, and the text on the screen."""
    place = tmp_path_factory.mktemp("calibrated")
    (place / "mine.py").write_text(OWN, encoding="utf-8")
    own = {"gappy": {"estimator": {"file": "mine.py:Filter"}}}
    methods = {
        "KF": {"estimator": {"kind": "kalman"}},
        "small": {"model": model(1 / 2.25), "estimator": {"kind": "kalman"}},
        "none": {"estimator": {"kind": "h-infinity", "theta": 0.01}},
    } | own
    path = write(place, runs=150, methods=methods, figures=["coverage"], calibration={"from": 20})
    result = cli("run", path, "-o", place / "out", "-j", 1, "--progress", "none")
    assert result.exit_code == 0, result.output
    return place / "out", result.stdout


def rows_of(directory, **wanted):
    """Rows of calibration.csv with some values."""
    with (directory / "calibration.csv").open(newline="", encoding="utf-8") as file:
        return [row for row in csv.DictReader(file) if wanted.items() <= row.items()]


def test_from_the_configuration_to_words(ran):
    """Oracle: a filter on its own model is right, one with all covariances over 1.5^2 has errors of 1.5 times."""
    directory, _ = ran
    found = {row["method"]: row for row in rows_of(directory, of="joint", level="0.9")}
    words = {name: row["verdict"] for name, row in found.items()}
    assert words["KF"].startswith("calibrated") and words["small"] == "overconfident"
    assert words["none"] == "reports no covariance" and words["gappy"] == "conservative (reports a bound)"
    assert float(found["small"]["factor_low"]) < 1.5 < float(found["small"]["factor_high"])
    head = ["method", "of", "level", "covered", "low", "high", "n", "factor", "factor_low", "factor_high", "verdict"]
    assert list(found["KF"]) == head
    assert len(rows_of(directory, method="KF")) == 9 and len(rows_of(directory, method="none")) == 1


def test_numbers_are_those_of_the_trials(ran):
    """Oracle: plain means over trials.csv."""
    directory, _ = ran
    with (directory / "trials.csv").open(newline="", encoding="utf-8") as file:
        trials = [row for row in csv.DictReader(file) if row["method"] == "KF"]
    for of, column in (("joint", "coverage_90"), ("x.1", "coverage_90_x_1")):
        (row,) = rows_of(directory, method="KF", of=of, level="0.9")
        mean = np.mean([float(each[column]) for each in trials])
        np.testing.assert_allclose(float(row["covered"]), mean, atol=1e-6)  # six digits of the file
        assert row["n"] == "150"


def test_tables_page_and_screen(ran):
    """Oracle: inference.md, C2: heads, the fold after Failures with its title, and lines of at most 80 columns."""
    directory, screen = ran
    text = (directory / "tables" / "calibration.md").read_text(encoding="utf-8")
    head = "| method | covers 90 % | errors / reported std | 50 % | 95 % | n/n_failed | verdict |"
    assert text.startswith(head) and "| 150/0 | overconfident |" in text
    latex = (directory / "tables" / "calibration.tex").read_text(encoding="utf-8")
    assert r"Covers 90 \% [\%] & Errors / reported std" in latex and "overconfident" in latex
    assert (directory / "tables" / "calibration.note.tex").exists()
    page = (directory / "report.html").read_text(encoding="utf-8")
    folds = re.findall(r"<summary><b>([^<]*)</b><span>([^<]*)</span>", page)
    assert folds[0][0] == "Calibration"
    assert re.fullmatch(
        r"KF calibrated; small overconfident 1\.[45]x; none reports no covariance; gappy conservative < 0\.\d+x",
        unescape(folds[0][1]),
    )
    assert max(map(width_of, screen.splitlines())) <= 80
    assert re.search(
        r"^ small  covers \d\d % of 90 % \[\d\d, \d\d\]  errors 1\.\d+ x std  overconfident$", screen, re.M
    )
    assert re.search(r"^ none  reports no covariance$", screen, re.M)


def test_shares_are_in_the_csv_files_but_not_in_other_tables(ran):
    """Oracle: the table of calibration shows them; summary.csv and trials.csv have every metric."""
    directory, _ = ran
    assert "coverage_90" in (directory / "summary.csv").read_text(encoding="utf-8")
    assert "coverage" not in (directory / "tables" / "summary.md").read_text(encoding="utf-8")
    assert not [path.name for path in (directory / "tables").iterdir() if path.name.startswith("coverage")]
    assert "coverage 90" not in (directory / "report.html").read_text(encoding="utf-8")
    assert (directory / "figures" / "coverage.svg").exists()


def test_a_report_of_stored_results_writes_the_same(ran, tmp_path):
    """Oracle: bytes; nothing but the directory is read."""
    directory, _ = ran
    results = load_results(directory)
    table = calibration_table(results.trials)
    assert table.to_markdown() == (directory / "tables" / "calibration.md").read_text(encoding="utf-8")
    assert table.frame.shape == (28, 11)
    assert results.trials.bounds == {"gappy"}


def test_a_record_with_levels_that_have_no_metric_is_refused(ran, tmp_path):
    """Oracle: what no configuration could have is damage, not a traceback."""
    directory, _ = ran
    changed = tmp_path / "changed"
    changed.mkdir()
    for wrong in ({"levels": [0.7]}, {"verdict": 0.5}, {"levels": [0.9, 2.0]}, {"margin": -1}, {"levels": []}):
        (changed / "trials.sqlite").write_bytes((directory / "trials.sqlite").read_bytes())
        with closing(sqlite3.connect(changed / "trials.sqlite")) as connection, connection:
            [(text,)] = connection.execute("SELECT value FROM meta WHERE key = 'layout'").fetchall()
            data = json.loads(text)
            data["calibration"] |= wrong
            connection.execute("UPDATE meta SET value = ? WHERE key = 'layout'", (json.dumps(data),))
        result = cli("report", changed)
        if wrong == {"verdict": 0.5}:
            assert result.exit_code == 0
            continue
        assert result.exit_code not in (0, 70) and "layout" in result.output, result.output


def test_failed_runs_are_left_out_and_counted(tmp_path):
    """Oracle: a state range that some runs leave."""
    path = write(tmp_path, plant={**LINEAR, "diverged": 3.2}, methods={"KF": {"estimator": {"kind": "kalman"}}})
    result = cli("run", path, "-o", tmp_path / "out", "-j", 1, "--progress", "none")
    trials = load_results(tmp_path / "out").trials
    failed = trials.n_failed("KF")
    assert 0 < failed < 60, result.output
    (row,) = rows_of(tmp_path / "out", of="joint", level="0.9")
    assert row["n"] == str(60 - failed)
    text = (tmp_path / "out" / "tables" / "calibration.md").read_text(encoding="utf-8")
    assert f"| {60 - failed}/{failed} |" in text


def test_a_sweep_with_ranks_has_a_row_per_point_and_a_column_of_the_ranks(tmp_path):
    """Oracle: means over the points; ranks do not depend on the key."""
    noise = {"process": {"gaussian": {"cov": [0.01, 0.05]}}, "measurement": {"gaussian": {"cov": 0.1}}}
    others = {"sweep": {"grid": {"model.P_v": [0.1, 0.005]}}, "noise": noise, "statistics": {"ranks": True}, "runs": 20}
    methods = {name: {"estimator": {"kind": kind}} for name, kind in (("KF", "kalman"), ("P", "kalman-predictor"))}
    stored = {}
    for name, given in (("with", True), ("without", None)):
        path = write(tmp_path, methods=methods, calibration=given, **others)
        result = cli("run", path, "-o", tmp_path / name, "-j", 1, "--progress", "none")
        assert result.exit_code == 0, result.output
        stored[name] = (tmp_path / name / "ranks.csv").read_bytes()
    assert stored["with"] == stored["without"]
    assert not (tmp_path / "without" / "calibration.csv").exists()
    rows = rows_of(tmp_path / "with", of="joint", level="0.9", method="KF")
    assert len(rows) == 2 and {*rows[0]} >= {"model.P_v", "covered"}
    text = (tmp_path / "with" / "tables" / "ranks.md").read_text(encoding="utf-8")
    mean = np.mean([float(row["covered"]) for row in rows])
    assert "| covers 90 % |" in text.splitlines()[2] and f"| {100 * mean:.0f} % (" in text
    assert "ranks do not use it" in text
    assert "covers" not in (tmp_path / "without" / "tables" / "ranks.md").read_text(encoding="utf-8")
    page = (tmp_path / "with" / "report.html").read_text(encoding="utf-8")
    assert "<b>Calibration</b><span>KF overconfident at 1 of 2 points" in page


def test_a_smoke_run_has_no_verdict(tmp_path):
    """Oracle: as of comparisons."""
    path = write(tmp_path)
    result = cli("run", path, "-o", tmp_path / "out", "-j", 1, "--progress", "none", "--smoke")
    assert result.exit_code == 0 and "covers" not in result.stdout
    assert {row["verdict"] for row in rows_of(tmp_path / "out")} <= {"", "reports no covariance"}
    assert "<b>Calibration</b>" not in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


def shares(s, runs=80, seed=1, **others):
    """Shares of a covariance s^2 I."""
    return of_squares(errors(np.random.default_rng(seed), runs, **others), s)


def test_lines_of_the_screen_fit():
    """Oracle: at most 80 columns with any names and words; further methods are counted."""
    names = ["n" * 70, "a name with a\U0001f600wide sign " * 3, "KF", "fourth", "fifth"]
    values = [shares(1 / 1.36), shares(1.0, rho=0.999), shares(1.0, runs=80, seed=4), shares(3.0), shares(1.0)]
    table = calibration_table(coverage_trials(dict(zip(names, values, strict=True))))
    lines = table.lines(80)
    assert len(lines) == 5 and lines[-1] == "calibration of 1 more: calibration.csv"
    assert all(width_of(line) < 80 for line in lines)
    assert lines[0].endswith("x std  overconfident") and "inconclusive" in lines[1]
    assert table.gist.endswith("; 1 more") and "overconfident 1.3x" in table.gist and "conservative < 0." in table.gist
    short = calibration_table(coverage_trials({"KF": shares(1 / 1.36)})).lines(80)
    assert re.fullmatch(r"KF  covers \d\d % of 90 % \[\d\d, \d\d\]  errors 1\.\d+ x std  overconfident", short[0])
    assert calibration_table(replace(coverage_trials({"KF": shares(1.0)}), calibration=None)).lines(80) == []


def test_cells_of_ranks_are_means_over_points():
    """Oracle: plain means; a method without a covariance has none."""
    tables = []
    for k, s in enumerate((1.0, 0.5)):
        none = dict.fromkeys(shares(s), np.full(80, np.nan))
        made = coverage_trials({"KF": shares(s, seed=k), "none": none})
        tables.append(replace(made, point={"x": str(k)}, title=f"x={k}"))
    whole = replace(tables[0], paths=("x",), points=tuple(tables), point={}, title="")
    found = RanksTable(whole, SimpleNamespace(rows=[SimpleNamespace(method=name) for name in ("none", "KF")]))._coverage
    means = [point.column("coverage_90", "KF").mean() for point in tables]
    assert found["covers 90 %"][0] == "-" and found["covers 90 %"][1].startswith(f"{100 * np.mean(means):.0f} % (")
