"""The screen at the end of a run, from small tables of trials: what it shows, how wide and how long it is."""

import re
import shlex
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from comparison_tables import extent_of
from comparison_tables import table as trials_of

from rmpc_bench.analysis.runs import RunNotes
from rmpc_bench.claims.claim import Finding
from rmpc_bench.report.calibration_table import CalibrationTable
from rmpc_bench.report.ranks_table import ranks_table
from rmpc_bench.report.run_tables import DriversTable, requirements_table
from rmpc_bench.report.screen import MOST_LINES, Screen
from rmpc_bench.report.summary import summarise
from rmpc_bench.report.tuning_table import TuningTable
from rmpc_bench.types import RunFailure
from rmpc_bench.types.texts import width_of

N = 40
RNG = np.random.default_rng(5)
BASE = np.exp(0.3 * RNG.normal(size=N))


def noisy(factor, k=0):
    return factor * BASE * np.exp(0.02 * np.random.default_rng(k).normal(size=N))


def methods(n, name="method-"):
    return {"KF": BASE} | {f"{name}{k}": noisy(0.8 + k / 40, k) for k in range(n)}


TWO = {"KF": BASE, "WKF": noisy(0.8)}
LOST = {"KF": BASE, "WKF": np.where(np.arange(N) == 3, np.nan, noisy(0.9))}


def one(values, **others):
    """Return trials at one point; the metric is an MSE."""
    return trials_of(values, metric="estimation_mse", **others)


def sweep(make, points, path="x"):
    """Return a sweep over a path from a function that makes the trials of a number."""
    tables = tuple(replace(make(k), point={path: point}, title=f"{path}={point}") for k, point in enumerate(points))
    return replace(tables[0], paths=(path,), points=tables, point={}, title="")


def screen_of(trials, **others):
    """Return the screen of trials whose page is in results/tiny."""
    made = {
        "name": "tiny",
        "trials": trials,
        "tables": summarise(trials),
        "metric": trials.metrics[0].name,
        "page": Path("results/tiny/report.html"),
        "stored": Path("results/tiny"),
        "extent": extent_of(trials),
        "verdicts": (),
        "drivers": DriversTable([]),
        "requirements": requirements_table(trials),
        "ranks": ranks_table(trials),
        "tuning": TuningTable(trials, None),
        "calibration": CalibrationTable([]),
    }
    return Screen(**made | others)


def shown(trials, width=80, **others):
    """Return the lines of the screen; none is wider than the terminal."""
    lines = screen_of(trials, **others).text(width).split("\n")
    assert max(map(width_of, lines)) <= width, "\n".join(lines)
    assert lines == [line.rstrip() for line in lines]
    return lines


def test_the_rows_of_one_point_and_marks_that_are_explained():
    lines = shown(one(TWO, parameters=dict.fromkeys(TWO, "default")))
    assert lines[0] == "tiny   40 of 40 runs, 0 failed" and lines[1] == ""
    assert lines[2].startswith("WKF is better than KF: its estimation MSE is 2") and lines[2].endswith("lower.")
    assert lines[4].split() == "method mean estimation MSE change against KF verdict".split()
    assert lines[5].split()[0] == "KF" and lines[5].endswith("baseline") and lines[6].endswith("better")
    assert lines[8] == " same draws for all; [ ] and \u00b1: 95 %; change: geometric mean; default parameters"
    worst = int(BASE.argmax())
    assert lines[9] == f" worst run: rmpc-bench show results/tiny --run {worst} --method KF"
    assert lines[10:] == [" results/tiny/report.html"]
    trials = sweep(lambda k: one({"KF": BASE, "A": noisy(0.8), "B": BASE[::-1]}), ["1", "2"])
    text = "\n".join(shown(trials))
    assert " ? inconclusive; intervals: tables/summary.md" in text and "equivalent" not in text
    # The sign of equality of a title is no mark, and the brackets of a unit are no interval.
    long = sweep(lambda k: one({"KF": BASE, "A": noisy(0.8), "B": BASE[::-1]}), ["1", "2"], path="plant.value.x")
    assert "x = plant.value.x" in "\n".join(shown(long)) and "equivalent" not in "\n".join(shown(long))
    assert " \u00b1: 95 %" in shown(one({"KF": BASE}, unit="rad^2"))


@pytest.mark.parametrize("width", [80, 60, 40])
@pytest.mark.parametrize("n", [2, 3, 6, 7, 30, 100])
def test_any_number_of_methods_fits(n, width):
    lines = shown(one(methods(n - 1)), width)
    rows = [line for line in lines if line.startswith((" KF ", " method-"))]
    assert len(rows) == (n if n <= 40 else 30)
    assert (" and 70 more methods" in lines) == (n == 100)
    assert n > 6 or len(lines) <= MOST_LINES


def test_the_mean_goes_first_then_names_are_cut_but_not_broken():
    name = "a-method-with-a-name-of-sixty-characters-as-nobody-writes-them"
    trials = one({"KF": BASE, name: noisy(0.8), f"{name}2": noisy(0.9)})
    assert any("mean" in line for line in shown(one(TWO)))
    text = "\n".join(shown(one({"KF": BASE, "a-method-of-26-characters..": noisy(0.8)}), 72))
    assert "mean estimation" not in text and "a-method-of-26-characters.. " in text
    # A line above the table names the metric in place of the head.
    assert "\nestimation MSE\n method" in text and "\nestimation MSE\n" not in "\n".join(shown(one(TWO)))
    assert [line.split()[0] for line in shown(trials) if line.startswith(" a-m")] == ["a-met..-them", "a-met..them2"]
    assert any(line.split()[:4] == ["method", "mean", "estimation", "MSE"] for line in shown(trials))
    names = [f"S exact {k}" for k in range(6)]
    text = "\n".join(shown(one({"KF": BASE} | {name: noisy(0.8, k) for k, name in enumerate(names)}), 60))
    assert all(name in text.split("\n method")[0] for name in names)


@pytest.mark.parametrize("name", ["100 %", "$Q'Q$", "<b>KF</b>", "漢字漢字漢字漢字漢字", "S + input", "é\u0301" * 20])
def test_names_of_any_kind(name):
    for width in (80, 60):
        lines = shown(one({"KF": BASE, name: noisy(0.8)}), width)
        assert any(line.startswith(f" {name[:4]}") for line in lines)


@pytest.mark.parametrize("width", [80, 60])
@pytest.mark.parametrize("n", [1, 2, 6, 7, 12])
def test_a_sweep_of_a_number_has_the_points_below_each_other(n, width):
    points = [str(k) for k in range(n)]
    lines = shown(sweep(lambda k: one(methods(4)), points), width)
    assert len(lines) <= MOST_LINES
    if n > 1:
        head = next(k for k, line in enumerate(lines) if line.split()[:3] == ["x", "KF,", "mean"])
        assert [line.split()[0] for line in lines[head + 1 : head + 1 + n]] == points
        assert lines[head - 1] == "change of the estimation MSE against KF by x"


def test_many_methods_of_a_sweep_go_down_or_are_counted():
    lines = shown(sweep(lambda k: one(methods(30)), ["1", "2", "3"]))
    assert sum(line.startswith(" method-") for line in lines) == 30
    assert any(line.split() == ["x", "1", "2", "3"] for line in lines)
    lines = shown(sweep(lambda k: one(methods(9)), [str(k) for k in range(12)]))
    assert "verdicts at 12 points, estimation MSE against KF" in lines and len(lines) <= MOST_LINES
    names = [f"a point with a long name {k}" for k in range(6)]
    lines = shown(sweep(lambda k: one(methods(8, "M")), names))
    assert " ".join(" ".join(lines).split()).count("3 a point with a long name 2") == 1
    assert any(line.split() == ["x", *map(str, range(1, 7))] for line in lines)


@pytest.mark.parametrize("n", [6, 30])
def test_several_paths_have_a_line_per_point_or_counts(n):
    trials = sweep(lambda k: one({"KF": BASE, "WKF": noisy(0.8, k)}), range(n))
    made = [replace(t, point={"a": f"{k}", "b": "1"}, title=f"a={k}, b=1") for k, t in enumerate(trials.points)]
    lines = shown(replace(trials, points=tuple(made), paths=("a", "b")))
    assert sum(line.startswith(" a=") for line in lines) == (6 if n == 6 else 0)
    assert ("verdicts at 30 points, estimation MSE against KF" in lines) == (n == 30)
    assert any(line.split()[:2] == ["WKF", "30"] for line in lines) == (n == 30)


def test_failures_have_one_command():
    bad = np.where((np.arange(N) >= 3) & (np.arange(N) < 13), np.nan, noisy(0.9))
    kind = {"status": 1, "component": "estimator", "k": 33, "message": "Matrix is not positive definite"}
    failures = tuple(RunFailure(run=run, **kind) for run in range(3, 13))
    trials = one({"KF": BASE, "Sage-Husa": bad})
    lines = shown(replace(trials, notes={"Sage-Husa": RunNotes(100, failures=failures)}))
    assert " failed: Sage-Husa, 10 runs, 'Matrix is not positive definite'; the first again:" in lines
    assert " rmpc-bench show results/tiny --run 3 --method Sage-Husa" in lines
    assert any(line.startswith(" Sage-Husa") and line.endswith("fails more 10/40") for line in lines)
    lines = shown(one({"KF": BASE, "A": np.full(N, np.nan), "B": noisy(0.8)}))
    assert ["A", "fails", "more", "40/40"] in [line.split() for line in lines]


def test_a_replay_command_and_the_page_are_copied_whole():
    """Lines end between arguments of the shell only: not within a path, whatever its length and its blanks."""
    method, directory = "Sage Husa", Path("results") / "long  name" / ("x" * 90)
    trials = one({"KF": BASE, method: np.where(np.arange(N) == 3, np.nan, BASE)})
    lines = screen_of(trials, page=directory / "report.html", stored=directory).text(80).split("\n")
    start = next(i for i, line in enumerate(lines) if line.endswith("the first again:")) + 1
    end = next(i for i in range(start, len(lines)) if not lines[i].endswith("\\")) + 1
    command = shlex.split("\n".join(lines[start:end]).replace("\\\n", ""))
    assert command == ["rmpc-bench", "show", str(directory), "--run", "3", "--method", method]
    assert f" {directory / 'report.html'}" in lines and end - start == 3


def test_a_verdict_that_contradicts_its_interval_has_a_reason():
    """With few untied pairs counts decide."""
    factors = np.where(np.arange(12) == 0, 0.1, 0.97)
    lines = shown(one({"KF": BASE[:12], "A": BASE[:12] * factors}))
    row = next(line for line in lines if line.startswith(" A "))
    assert re.search(r"\[-\d+, \+\d+\]  better, by counts of the runs$", row), row


def test_all_runs_of_every_method_failed():
    lines = shown(one({"KF": np.full(N, np.nan), "A": np.full(N, np.nan)}))
    row = next(line for line in lines if line.startswith(" A "))
    assert row.split() == ["A", "inconclusive,", "40", "of", "40", "failed"]
    values = {"KF": np.full(N, np.nan), "A": np.full(N, np.nan)}
    lines = shown(one(values, parameters=dict.fromkeys(values, "default")))
    assert any(line.endswith("default parameters") for line in lines) and not any(";" in line[:2] for line in lines)


def test_unfinished_experiments_one_method_and_one_run():
    trials = one(TWO)
    lines = shown(trials, extent=extent_of(trials, 1000))
    assert lines[0] == "tiny   INTERRUPTED at 40 of 1000 runs, 0 failed; run it again to go on"
    assert lines[2].startswith("So far WKF is better")
    assert "The mean estimation MSE is" in shown(one({"KF": BASE}))[2]
    assert shown(one({"KF": BASE[:1], "A": BASE[:1]}))[2]


def test_a_smoke_run_says_what_ran():
    trials = one(LOST, with_verdicts=False)
    text = "\n".join(shown(trials))
    assert text.startswith("tiny   smoke run: 40 of 40 runs, 1 failed\n\nA smoke run shows that everything works")
    assert "\n KF   ran\n WKF  failed 1 of 40 runs\n" in text and "%" not in text
    assert "\n KF   ran\n WKF  failed 2 of 80 runs\n" in "\n".join(shown(sweep(lambda k: trials, ["1", "2"])))


def verdict(finding, of_paper=True, recorded=None):
    claim = SimpleNamespace(of_paper=of_paper, finding=recorded, says="a statement " + "of words " * 30)
    return SimpleNamespace(finding=finding, joined=finding, claim=claim, differs=recorded not in (None, finding))


TWO_CLAIMS = [verdict(Finding.CONFIRMED), verdict(Finding.NOT_CONFIRMED, recorded=Finding.CONFIRMED)]


def test_claims_have_a_line():
    found = [verdict(Finding.CONFIRMED)] * 3 + [verdict(Finding.NOT_TESTABLE), verdict(Finding.CONFIRMED, False)]
    assert " confirmed: 3 statements of the paper, 1 additional (claims.md)" in shown(one(TWO), verdicts=found)
    mixed = shown(one(TWO), verdicts=TWO_CLAIMS)
    assert " statements of the paper: 1 confirmed, 1 not confirmed (claims.md)" in mixed
    assert any(line.startswith(" recorded confirmed, now not confirmed: a statement of") for line in mixed)
    lines = shown(one(TWO), verdicts=found, overrides=["--runs 3"])
    assert " claims: not evaluated, the configuration was overridden (--runs 3)" in lines
    assert not any("statements of the paper that were tested" in line for line in lines)


@pytest.mark.parametrize("width", [80, 60])
def test_at_most_seven_lines_of_notes(width):
    lines = shown(one(LOST), width, verdicts=TWO_CLAIMS, stop="decide: claims: not met at look 4 of 4, 40 runs; " * 2)
    notes = lines[len(lines) - lines[::-1].index("") :]
    assert len(notes) <= 7 and notes[-1] == " results/tiny/report.html"
    assert any(line.startswith(" recorded") for line in notes) and any("failed: WKF" in line for line in notes)


def test_higher_is_better_a_difference_and_an_event():
    assert " 1 better" not in "\n".join(shown(one({"KF": BASE, "A": noisy(1.4)}, direction="higher")))
    signed = shown(one({"KF": BASE - BASE.mean(), "A": 0.1 * (BASE - BASE.mean())}, direction="zero", unit="rad"))
    assert "its |estimation MSE| is 0." in " ".join(signed) and " rad [" in " ".join(signed)
    never = np.where(np.arange(N) < 30, np.inf, 5.0)
    event = shown(one({"KF": never, "A": BASE}, may_not_occur=True, unit="s"))
    assert any("occurred; median estimation MSE [s]" in line and "better than KF in" in line for line in event)
    assert any(line.split()[:5] == ["KF", "10", "of", "40;", "-"] for line in event)
    assert any("ties count half" in line for line in event)
    points = shown(sweep(lambda k: one({"KF": never, "A": BASE}, may_not_occur=True), ["1", "2"]))
    assert any(line.split()[:3] == ["x", "KF,", "occurred"] for line in points)
    assert [line.split()[:4] for line in points if "10 of 40" in line] == [[x, "10", "of", "40"] for x in "12"]
