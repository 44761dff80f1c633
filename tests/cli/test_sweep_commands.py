"""The commands on a sweep: what they leave behind, count and say."""

import json
import re
import signal

import numpy as np
import pandas as pd
import pytest
from small_experiment import cli, ran, spied, write

from rmpc_bench.analysis.rounding import significant
from rmpc_bench.engines import tasks

HP, C = "controller.Hp", "methods.R-MPC.estimator.c"
SWEEP = f"{{grid: {{{HP}: [10, 12], {C}: [0.1, 1]}}}}"
CLAIMS = (
    "{says: longer is better, source: Fig. 8, check: 'mean(mse[S-MPC, controller.Hp=12]) < "
    "mean(mse[S-MPC, controller.Hp=10])', finding: confirmed}",
    "{says: small, source: Fig. 9, at: [{controller.Hp: 10}, {controller.Hp: 12}], "
    "check: 'mean(mse[S-MPC]) < 1.72', finding: depends-on-assumptions}",
)
DERIVED = ("trials.csv", "uncertainty.csv", "series.csv", "summary.csv", "comparisons.csv", "traces.npz")


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """Stand in an empty directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def go(path, *options):
    """Run with one process."""
    return cli("run", path, "-j", 1, "--progress", "none", *options)


def plan(path, *options):
    """Return (left, total) of a dry run."""
    result = go(path, "-o", "out", "--dry-run", *options)
    assert result.exit_code == 0, result.output
    return tuple(map(int, re.search(r"tiny: (\d+) of (\d+) trials to compute", result.stdout).groups()))


def test_what_a_sweep_leaves_behind(here):
    """One row per point, method and metric or comparison; the screen has each point under its name."""
    path = write(here, sweep=SWEEP, record="{runs: 1}", claims=f"[{', '.join(CLAIMS)}]", statistics="{relevant: 0}")
    result = go(path, "-o", "out")
    assert result.exit_code == 0, result.output
    for name, n_rows in (("trials", 4 * 2 * 6), ("summary", 4 * 2 * 2), ("comparisons", 4 * 2), ("uncertainty", 4 * 6)):
        frame = pd.read_csv(here / "out" / f"{name}.csv")
        assert [*frame.columns[:2]] == [HP, C] and len(frame) == n_rows
        assert frame[[HP, C]].drop_duplicates().values.tolist() == [[10, 0.1], [10, 1], [12, 0.1], [12, 1]]
    page = (here / "out" / "tables" / "summary.md").read_text()
    titles = [f"{HP}={hp}, {C}={c}" for hp in (10, 12) for c in ("0.1", "1")]
    assert [line for line in page.splitlines() if line.startswith("# ")] == [f"# tiny: {title}" for title in titles]
    assert "6 of 6 runs at each of 4 points, 0 failed" in result.stdout
    assert "change of the MSE against S-MPC\n point" in result.stdout
    with np.load(here / "out" / "traces.npz") as traces:
        assert len(traces.files) == 4 * 2 * 5


def test_claims_at_points_from_file_to_file(here):
    """The numbers are those of the points; what was said of them stands in claims.json and claims.md."""
    path = write(here, sweep=SWEEP, runs=12, uncertainty="{eps: +-2%}", claims=f"[{', '.join(CLAIMS)}]")
    result = go(path, "-o", "out", "--strict")
    first, second = json.loads((here / "out" / "claims.json").read_text())["claims"]
    frame = pd.read_csv(here / "out" / "trials.csv").query("method == 'S-MPC'")
    means = frame.groupby(HP)["mse"].mean().map(significant)
    assert first["finding"] == "confirmed" and first["at"] == []
    assert [first["numbers"][0][side] for side in ("left", "right")] == [means[12], means[10]]
    assert first["numbers"][0]["n"] == 12
    assert second["at"] == [{HP: "10"}, {HP: "12"}]
    assert [(row["at"], row["left"]) for row in second["numbers"]] == [
        (f"{HP}=10", means[10]),
        (f"{HP}=12", means[12]),
    ]
    assert second["finding"] == "depends-on-assumptions" and result.exit_code == 0
    assert "1 confirmed, 1 dependent on unstated assumptions" in " ".join(result.stdout.split())
    assert f"` at {HP}=12: holds; " in (here / "out" / "claims.md").read_text()


def test_all_points_in_a_claim(here):
    """As many runs as there are at all points."""
    claim = "{says: s, at: all, check: ['mean(mse[R-MPC]) < 1000', 'n_failed[R-MPC] == 0'], finding: confirmed}"
    path = write(here, sweep=SWEEP, runs=12, uncertainty="{eps: +-2%}", claims=f"[{claim}]")
    assert go(path, "-o", "out", "--strict").exit_code == 0
    [row] = json.loads((here / "out" / "claims.json").read_text())["claims"]
    assert row["at"] == "all" and row["numbers"][0]["n"] == 48
    assert "all points of the sweep together" in (here / "out" / "claims.md").read_text()


def test_a_dry_run_counts_what_is_computed(here):
    """What points share counts once: S-MPC at two horizons, R-MPC at four points."""
    path = write(here, sweep=SWEEP)
    assert plan(path) == (36, 36)
    assert plan(path, "--only", "S-MPC") == (12, 12)
    assert plan(path, "--only", "R-MPC", "--runs", "2") == (8, 8)
    assert plan(path, "-s", f'sweep.grid."{C}"=[0.1]') == (24, 24)
    assert not (here / "out").exists()
    ran(path, here / "out", "--runs", 4, "--only", "R-MPC")
    assert plan(path) == (20, 36) and plan(path, "--runs", "4") == (8, 24)
    assert plan(path, "-s", "record.runs=3") == (20 + 3 * 4, 36)
    ran(path, here / "out")
    assert plan(path) == (0, 36) and plan(path, "-s", "sweep=") == (0, 12)
    assert plan(path, "-s", f'sweep.grid."{C}"=[1, 0.1, 5]') == (12, 48)


def test_a_dry_run_of_what_computes_is_true(here, monkeypatch):
    """Oracle: the blocks that are computed."""
    path, blocks = write(here, sweep=SWEEP), spied(monkeypatch)
    left, _ = plan(path)
    ran(path, here / "out")
    assert sum(len(runs) for _, runs in blocks) == left == 36


def test_a_smoke_run_of_a_sweep(here):
    """Every point at its small size; claims are for information."""
    path = write(here, sweep=SWEEP, smoke="{runs: 2, steps: 4}", claims=f"[{CLAIMS[0]}]")
    result = go(path, "--smoke", "--strict")
    assert result.exit_code == 0 and "not evaluated" in result.stdout
    frame = pd.read_csv(here / "results" / "smoke" / "tiny" / "trials.csv")
    assert len(frame) == 4 * 2 * 2 and "2 of 2 runs at each of 4 points" in result.stdout


@pytest.mark.parametrize(
    "options", [[], ["--smoke"], ["--only", "R-MPC"], ["--runs", "3", "-s", f'sweep.grid."{HP}"=[8, 9]']], ids=" ".join
)
@pytest.mark.long
def test_report_writes_the_same_bytes(here, monkeypatch, options):
    """From what is stored and the configuration that was kept; nothing is simulated."""
    path = write(here, sweep=SWEEP, record="{runs: 2}", claims=f"[{CLAIMS[0]}]", smoke="{runs: 2, steps: 5}")
    if any(HP in option for option in options):
        path = write(here, sweep=SWEEP, record="{runs: 2}")
    shown = go(path, "-o", "out", *options).stdout.splitlines()
    before = {name: (here / "out" / name).read_bytes() for name in DERIVED}
    for name in DERIVED:
        (here / "out" / name).unlink()
    path.unlink()
    monkeypatch.setattr(tasks, "simulate_block", lambda *args: pytest.fail("report simulates"))
    result = cli("report", "out")
    assert result.exit_code == 0, result.output
    assert {name: (here / "out" / name).read_bytes() for name in DERIVED} == before
    assert result.stdout.splitlines()[1:] == shown[1:]


def test_a_report_of_an_interrupted_sweep(here, monkeypatch):
    """What is there is shown, with what is missing: a point without trials, and one where a method has none."""
    keys = {"sweep": f"{{grid: {{{HP}: [10, 12, 8]}}}}", "record": "{runs: 2}", "figures": "[boxplot, signals]"}
    path, simulate, done = write(here, **keys, claims=f"[{', '.join(CLAIMS)}]"), tasks.simulate_block, []

    def interrupted(*args):
        if len(done) == 3:
            signal.raise_signal(signal.SIGINT)
        done.append(simulate(*args))
        return done[-1]

    monkeypatch.setattr(tasks, "simulate_block", interrupted)
    assert go(path, "-o", "out").exit_code == 130
    result = cli("report", "out")
    assert result.exit_code == 0, result.output
    frame = pd.read_csv(here / "out" / "trials.csv")
    counts = frame.groupby([HP, "method"]).size()
    assert len(counts) == 3 and set(counts) == {6}
    assert "not evaluated" in result.stdout and "0 of 6 runs" in result.stdout


@pytest.mark.parametrize("kind", ["input_roughness", "settling_time"])
def test_a_report_of_a_smoke_run_that_cuts_a_window(here, kind):
    """What the run took, the report takes: a window beyond the smoke size is its last sample."""
    metrics = f"[mse, {{kind: {kind}, name: late, from: 7, to: 9}}]"
    assert go(write(here, metrics=metrics, smoke="{runs: 2, steps: 5}"), "--smoke", "-o", "out").exit_code == 0
    before = (here / "out" / "trials.csv").read_bytes()
    result = cli("report", "out")
    assert result.exit_code == 0, result.output
    assert (here / "out" / "trials.csv").read_bytes() == before


def test_many_points_on_the_screen(here):
    """A sweep over the truth with a run at every point is shown as one, without tests; the page has every point."""
    result = go(write(here, sweep="{grid: {plant.J_l: [20, 21, 22, 23, 24, 25, 26]}}", runs="1"), "-o", "out")
    assert "(7 runs)." in result.stdout and "change" not in result.stdout and "J_l" not in result.stdout
    assert (here / "out" / "tables" / "summary.md").read_text().count("# tiny: ") == 8


def test_failures_are_counted_at_every_point(here):
    """But a trial that points share has failed once: on the screen, and for exit 3."""
    keys = {"uncertainty": "{eps: +-150%}", "runs": 10, "sweep": f"{{grid: {{{C}: [0.1, 1]}}}}"}
    result = go(write(here, **keys), "-o", "out")
    summary = pd.read_csv(here / "out" / "summary.csv")
    [n_failed] = set(summary["n_failed"])
    assert 0 < n_failed < 10 and set(summary["n"]) == {10 - n_failed} and len(summary) == 2 * 2 * 2
    n_trials = 3 * n_failed  # S-MPC, and R-MPC at two points
    assert result.exit_code == 3 and f", {n_trials} failed" in result.stdout
    assert go(here / "tiny.yaml", "-o", "out", "-s", f"execution.max_failures={n_trials}").exit_code == 0
    assert go(here / "tiny.yaml", "-o", "out", "-s", f"execution.max_failures={n_trials - 1}").exit_code == 3


def test_check_shows_the_sweep(here):
    """Its paths and values, how many points there are and what they cost together."""
    result = cli("check", write(here, sweep=SWEEP))
    assert result.exit_code == 0
    shown = " ".join(result.stdout.split())
    assert f"sweep {HP}: 10, 12; {C}: 0.1, 1" in shown
    assert "is valid: 4 points x 6 runs x 2 methods x 10 steps, about" in shown
    assert "36 trials; those that points share count once" in cli("check", write(here, sweep=SWEEP), "--full").stdout
    plain = " ".join(cli("check", write(here)).stdout.split())
    assert "is valid: 6 runs x 2 methods x 10 steps" in plain and " sweep " not in plain


def test_overrides_of_a_sweep_get_a_directory_of_their_own(here):
    """Another sweep is another experiment; one that is taken away, too."""
    path = write(here, sweep=SWEEP)
    names = set()
    for override in (f'sweep.grid."{HP}"=[9]', "sweep=", f'sweep.grid."{C}".0=2'):
        result = go(path, "-s", override, "--dry-run")
        names.add(re.search(r"results/(tiny~[0-9a-f]{6})", result.stderr)[1])
    assert len(names) == 3
    assert "~" not in go(path, "--dry-run").output


def test_a_mistake_in_an_override_of_the_sweep(here):
    """Exit 2, shown as what was typed."""
    result = go(write(here, sweep=SWEEP), "-s", f'sweep.grid."{HP}"=[10, -1]')
    assert result.exit_code == 2
    [line] = result.stderr.splitlines()
    assert line == f'-s sweep.grid."{HP}"=[10, -1]:1:33: {HP}: must be >= 1 (got -1)'
