"""run: where results go, what is kept, and the exit codes."""

import csv
import gc
import re

import pytest
from small_experiment import cli, ran, write

FAILING = {"uncertainty": "{eps: +-150%}", "runs": "20"}
HOLDS = "{says: small, check: 'mean(mse[S-MPC]) < 1000', finding: confirmed}"
FAILS = "{says: large, check: 'mean(mse[S-MPC]) > 1000', finding: confirmed}"
FILES = {
    *(
        "config.yaml",
        "config.resolved.yaml",
        "published.json",
        "manifest.json",
        "trials.sqlite",
        "trials.csv",
        "uncertainty.csv",
    ),
    *("series.csv", "summary.csv", "comparisons.csv", "tables", "progress.json"),
}


PAGES = ("report.html", "report.md")


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """Stand in an empty directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def go(path, *options):
    """Run with one process; nothing but results on stdout."""
    return cli("run", path, "-j", 1, "--progress", "none", *options)


def tree(directory):
    """Every file of a directory with its bytes."""
    return {path.relative_to(directory): path.read_bytes() for path in directory.rglob("*") if path.is_file()}


def test_what_a_run_leaves_behind(here):
    """The files of product.md section 5 that this version knows, and the screen of section 10."""
    result = go(write(here, paper="p", claims=f"[{HOLDS}]", figures="[boxplot]"))
    directory = here / "results" / "p" / "tiny"
    assert result.exit_code == 0 and result.stderr == ""
    assert {each.name for each in directory.iterdir()} == FILES | {
        "claims.json",
        "claims.md",
        "figures",
        *PAGES,
        "drivers.csv",
    }
    assert (directory / "config.yaml").read_text() == (here / "tiny.yaml").read_text()
    first, *rest = result.stdout.splitlines()
    assert re.fullmatch(r"p/tiny   6 of 6 runs, 0 failed, [\d.]+ s", first)
    shown = "\n".join(rest)
    assert "mean MSE [rad^2]" in shown and "change against S-MPC" in shown
    assert " confirmed: 1 statement of the paper (claims.md)" in shown
    assert rest[-1] == " results/p/tiny/report.html"
    assert not list(here.rglob("*.part"))


def test_trials_csv_is_a_plain_table(here):
    """Sorted, shortest repr, empty for missing."""
    ran(write(here, **FAILING), here / "out", "-s", "execution.max_failures=40")
    with (here / "out" / "trials.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [*rows[0]] == ["method", "run", "status", "mse", "input_power"]
    assert [(row["method"], int(row["run"])) for row in rows] == [(m, i) for m in ("S-MPC", "R-MPC") for i in range(20)]
    for row in rows:
        assert (row["status"] == "ok") == (row["mse"] != "") == (row["input_power"] != "")
        assert row["mse"] in ("", repr(float(row["mse"] or 0)))
    assert {row["status"] for row in rows} == {"ok", "out-of-range"}


def test_never_is_inf(here):
    """A run that does not settle has a value."""
    csv_bytes = ran(write(here, metrics="[settling_time]"), here / "out")
    assert {line.split(b",")[3] for line in csv_bytes.splitlines()[1:]} == {b"inf"}


def test_too_many_failures(here):
    """Exit 3, with everything written and the failures counted."""
    path = write(here, **FAILING)
    result = go(path, "-o", "out")
    assert result.exit_code == 3
    with (here / "out" / "summary.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    failed = {(row["method"], row["metric"]): int(row["n_failed"]) for row in rows}
    assert len(set(failed.values())) == 1 and 0 < failed["S-MPC", "mse"] < 20
    assert all(int(row["n"]) == 20 - int(row["n_failed"]) for row in rows)
    assert f"20 of 20 runs, {2 * failed['S-MPC', 'mse']} failed" in result.stdout
    assert go(path, "-o", "out", "-s", f"execution.max_failures={2 * failed['S-MPC', 'mse']}").exit_code == 0
    assert go(path, "-o", "out", "-s", f"execution.max_failures={2 * failed['S-MPC', 'mse'] - 1}").exit_code == 3


def test_expressions_without_a_value_are_failed_runs(here):
    """A run may fail, an experiment may not: sqrt of a negative number is a parameter out of range."""
    path = write(here, uncertainty="{eps: +-20%}", plant="{kind: servo-linear, perturb: {J_l: 1 + sqrt(eps)}}")
    result = go(path, "-o", "out")
    assert result.exit_code == 3, result.output
    assert b",out-of-range,," in (here / "out" / "trials.csv").read_bytes()


@pytest.mark.parametrize(
    ("claims", "options", "code"),
    [
        ([HOLDS], [], 0),
        ([HOLDS], ["--strict"], 0),
        ([FAILS], [], 0),
        ([FAILS], ["--strict"], 1),
        ([HOLDS, FAILS], ["--strict"], 1),
        ([FAILS.replace("confirmed}", "not-confirmed}")], ["--strict"], 0),
        ([FAILS.replace(", finding: confirmed", "")], ["--strict"], 0),
        ([FAILS], ["--strict", "--runs", "3"], 0),
        ([FAILS], ["--strict", "--runs", "6"], 1),
        ([FAILS], ["--strict", "-s", "seed=8"], 0),
        ([FAILS], ["--strict", "--smoke"], 0),
        ([FAILS], ["--strict", "--only", "S-MPC"], 0),
    ],
)
def test_strict(here, claims, options, code):
    """Exit 1 when a finding differs from its record; what is not the configuration as it stands is not evaluated."""
    path = write(here, claims=f"[{', '.join(claims)}]", smoke="{runs: 2, steps: 5}")
    result = go(path, "-o", "out", *options)
    assert result.exit_code == code, result.output
    modified = len(options) > 1 and options[-1] != "6"
    assert ("not evaluated" in result.stdout) == modified
    assert ("recorded confirmed, now not confirmed: large" in result.stdout) == (claims[-1] == FAILS and not modified)
    assert (here / "out" / "claims.md").exists()


def test_failures_come_before_findings(here):
    """Exit 3 is the graver one."""
    assert go(write(here, **FAILING, claims=f"[{FAILS}]"), "--strict").exit_code == 3


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("seed", "expected PATH=VALUE; there is no '='"),
        ("=3", "is not a path"),
        ("a..b=3", "is not a path"),
        ("sead=3", "sead: 'sead' is not a known key; did you mean 'seed'?"),
        ("seed=-1", "1:6: seed: must be >= 0 (got -1)"),
        ("seed.x=1", "seed: is 7; seed.x can be set only if this is a mapping or a list"),
        ("metrics.7=mae", "metrics.7: no such entry in a list of 2"),
        ("controller.Hu=11", "1:15: controller.Hu: must be at most Hp = 10 (got 11)"),
        ("methods.R-MPC.estimator.c={", "while parsing"),
    ],
)
def test_bad_overrides(here, override, message):
    """Exit 2, shown as what was typed with the column in it."""
    result = go(write(here), "-s", override)
    assert result.exit_code == 2
    [line] = result.stderr.splitlines()
    assert line.startswith(f"-s {override}:1:") and message in line


def test_good_overrides(here):
    """Each replaces one value, in order; what they leave is in the resolved configuration."""
    ran(write(here), here / "out", *("-s", "seed=8", "-s", "seed=9", "-s", "metrics.0=mae", "-s", "runs=2*2"))
    lines = (here / "out" / "trials.csv").read_text().splitlines()
    assert lines[0] == "method,run,status,mae,input_power" and len(lines) == 9
    assert "\nseed: 9\n" in (here / "out" / "config.resolved.yaml").read_text()


@pytest.mark.parametrize("jobs", ["0", "-1", "two"])
def test_wrong_number_of_workers(here, jobs):
    """Exit 2."""
    result = cli("run", write(here), "-j", jobs)
    assert result.exit_code == 2 and "neither a number of processes" in result.stderr


@pytest.mark.parametrize("how", ["bar", "plain"])
def test_progress_goes_to_stderr(here, how):
    """Stdout has the result alone."""
    result = cli("run", write(here), "-j", 1, "--progress", how)
    assert result.exit_code == 0 and result.stdout.startswith("tiny   6 of 6 runs, 0 failed")


@pytest.mark.parametrize("option", ["--quiet", "--no-report"])
def test_cycles_of_components_are_collected_as_usual(here, monkeypatch, option):
    """The command does not look for cycles, but while it simulates: they may hold large arrays."""
    from rmpc_bench.cli import run as command
    from rmpc_bench.engines import tasks

    seen, simulate, load = [], tasks.simulate_block, command.configured
    monkeypatch.setattr(command, "configured", lambda request: (seen.append(gc.isenabled()), load(request))[1])
    monkeypatch.setattr(
        tasks, "simulate_block", lambda *given: (seen.append((gc.isenabled(), gc.get_threshold())), simulate(*given))[1]
    )
    usual = gc.get_threshold()
    assert go(write(here), option).exit_code == 0
    assert seen[0] is False and {*seen[1:]} == {(True, usual)}
    assert gc.isenabled() and gc.get_threshold() == usual


def test_an_internal_error(here, monkeypatch):
    """Exit 70 with the traceback; finished blocks are kept."""
    from rmpc_bench.store.store import Store

    monkeypatch.setattr(Store, "add_block", lambda *args: 1 / 0)
    result = go(write(here), "-o", "out")
    assert result.exit_code == 70
    assert "ZeroDivisionError" in result.stderr and "please report it" in result.stderr
