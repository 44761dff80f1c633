"""report: tables and figures again, from what is stored."""

import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from small_experiment import cli, ran, write

from rmpc_bench.engines import tasks

CLAIMS = "[{says: small, check: 'mean(mse[S-MPC]) < 1000', finding: confirmed}]"
DERIVED = {
    *("trials.csv", "uncertainty.csv", "series.csv", "summary.csv", "comparisons.csv", "claims.json", "claims.md"),
    *("tables/summary.md", "figures/boxplot.svg", "figures/boxplot.pdf"),
}


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """Stand in an empty directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def tree(directory):
    """Every file of a directory with its bytes."""
    return {
        path.relative_to(directory).as_posix(): path.read_bytes() for path in directory.rglob("*") if path.is_file()
    }


@pytest.mark.parametrize(
    "options",
    [
        [],
        ["--runs", "3"],
        ["--only", "R-MPC"],
        ["-s", "seed=8", "-s", "metrics.1=settling_time"],
        ["--smoke", "-s", "metrics.1={kind: mae, from: 0.5, to: 1}", "-s", "time={step: 0.1, duration: 1}"],
    ],
    ids=" ".join,
)
def test_report_writes_the_same_bytes_without_simulating(here, monkeypatch, options):
    """Every derived file is lost and comes back; nothing else is touched."""
    path = write(here, claims=CLAIMS, figures="[boxplot]", smoke="{runs: 2, steps: 7}")
    ran(path, here / "out", *options)
    before = tree(here / "out")
    assert set(before) > DERIVED
    for name in DERIVED:
        (here / "out" / name).unlink()
    path.unlink()
    monkeypatch.setattr(tasks, "simulate_block", lambda *args: pytest.fail("report simulates"))
    result = cli("report", "out")
    assert result.exit_code == 0, result.output
    assert {name for name in before if tree(here / "out").get(name) != before[name]} == set()


def test_report_shows_the_screen_of_the_run(here):
    """Without the time that it took."""
    path = write(here, claims=CLAIMS)
    shown = cli("run", path, "-o", "out", "-j", 1, "--progress", "none").stdout.splitlines()
    again = cli("report", "out").stdout.splitlines()
    assert again[1:] == shown[1:]
    assert re.fullmatch(re.escape(again[0]) + r", [\d.]+ s", shown[0])


def test_report_remembers_that_the_run_was_modified(here):
    """Claims stay informational."""
    ran(write(here, claims=CLAIMS), here / "out", "--runs", 3)
    result = cli("report", "out")
    assert "not evaluated" in result.stdout and "--runs 3" in result.stdout
    assert "information" in (here / "out" / "claims.md").read_text()


def test_report_counts_failures(here):
    """Exit 3 as the run."""
    path = write(here, uncertainty="{eps: +-150%}", runs=20)
    assert cli("run", path, "-o", "out", "-j", 1, "--progress", "none").exit_code == 3
    assert cli("report", "out").exit_code == 3


def test_report_of_several_directories(here):
    """One screen each."""
    path = write(here)
    for name in "ab":
        ran(path, here / name)
    result = cli("report", "a", "b")
    assert result.exit_code == 0
    assert [line for line in result.stdout.splitlines() if "report.html" in line] == [
        " a/report.html",
        " b/report.html",
    ]


def test_report_of_nothing(here):
    """A directory without results says how to fill it; one that is not there is wrong usage."""
    (here / "empty").mkdir()
    result = cli("report", "empty")
    assert result.exit_code in (2, 5) and "rmpc-bench run" in result.stderr and "Traceback" not in result.stderr
    assert cli("report", "nowhere").exit_code == 2
    assert cli("report").exit_code == 2


def test_report_of_an_interrupted_first_run(here, monkeypatch):
    """What is stored can be looked at."""
    simulate = tasks.simulate_block

    def interrupted(experiment, method, runs, *draws):
        if runs.start >= 3:
            signal.raise_signal(signal.SIGINT)
        return simulate(experiment, method, runs, *draws)

    monkeypatch.setattr(tasks, "simulate_block", interrupted)
    path = write(here)
    assert cli("run", path, "-o", "out", "-j", 1, "-s", "execution.block=3").exit_code == 130
    result = cli("report", "out")
    assert result.exit_code == 0, result.output
    assert "3 of 6 runs" in result.stdout
    assert len((here / "out" / "trials.csv").read_bytes().splitlines()) == 7


def test_no_figures_are_no_files(here):
    """The page shows the boxes all the same; the default is one figure in two formats."""
    ran(write(here, figures="[]"), here / "out")
    assert not (here / "out" / "figures").exists()
    ran(write(here, figures=None), here / "out")
    names = {path.name for path in (here / "out" / "figures").iterdir()}
    assert names == {"boxplot.svg", "boxplot.pdf", "boxplot.caption.tex"}


def test_two_figures_of_a_kind_are_two_files(here):
    """The second does not replace the first."""
    figures = "[boxplot, {kind: boxplot, metric: input_power}]"
    ran(write(here, figures=figures), here / "out")
    assert len([*(here / "out" / "figures").glob("*.svg")]) == 2


def test_reader_that_stops_reading(here):
    """`rmpc-bench describe mpc | head -1` is no failure to write results."""
    command = f"{Path(sys.executable).with_name('rmpc-bench')} describe mpc | head -1"
    done = subprocess.run(command, shell=True, capture_output=True, text=True, check=False, timeout=60)
    assert done.stdout == "controllers/mpc\n" and "cannot be written" not in done.stderr
