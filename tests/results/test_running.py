"""The comparison of the runs so far, against that of the finished table."""

import json

import numpy as np
import pandas as pd
import pytest
from data_frames import arrays
from small_experiment import cli, ran, write

from rmpc_bench import compare, load_config, run
from rmpc_bench.analysis.comparison import compared, levels
from rmpc_bench.analysis.intervals import student
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.execution.progress import Progress
from rmpc_bench.results.running import RunningComparison
from rmpc_bench.types import MetricInfo, Status

METHODS = ("A", "B", "C")
KEYS = {name: f"key of {name}" for name in METHODS}
N = 173
NOISY = {"noise": "{measurement: {gaussian: {std: 0.05}}}", "initial": "{x: {gaussian: {std: 0.1}}}"}
MSE = MetricInfo("m", "rad", "lower")


def columns(rng):
    """Metrics of three methods in the same runs, some of which failed."""
    common = rng.lognormal(0.0, 0.5, N)
    values = {
        name: common * rng.lognormal(shift, 0.05, N) for name, shift in zip(METHODS, (0, -0.1, 0.02), strict=True)
    }
    status = {name: np.where(rng.random(N) < 0.05, Status.DIVERGED, Status.OK) for name in METHODS}
    return values, status


def blocks(rng):
    """Random blocks of all methods in random order."""
    found = []
    for name in METHODS:
        ends = [0, *sorted(rng.choice(np.arange(1, N), 12, replace=False)), N]
        found += [(name, low, high) for low, high in zip(ends, ends[1:], strict=False)]
    return [found[i] for i in rng.permutation(len(found))]


def filled(values, status, order, *, info=MSE, points=(("", KEYS),)):
    """Add blocks in an order."""
    running = RunningComparison(info, points, "A", 0.95)
    for name, low, high in order:
        running.add(KEYS[name], range(low, high), values[name][low:high], status[name][low:high])
    return running


def table(values, status, info):
    """The table of the same runs."""
    frame = pd.concat(
        pd.DataFrame(
            {"method": name, "run": range(N), "status": [Status(int(i)).word for i in status[name]], "m": values[name]}
        )
        for name in METHODS
    )
    frame.loc[frame["status"] != "ok", "m"] = np.nan
    return Trials("t", METHODS, {}, (info,), arrays(frame), (), "A", 0.95, 0.0, 1)


@pytest.mark.parametrize("direction", ["lower", "higher", "zero", "one"])
def test_blocks_in_any_order_give_the_comparison_of_the_table(rng, direction):
    """Oracle: the geometric mean of the ratios and the mean difference of the finished table."""
    values, status = columns(rng)
    if direction == "zero":
        values = {name: each - 1 for name, each in values.items()}
    info = MetricInfo("m", "rad", direction)
    trials = table(values, status, info)
    rows = filled(values, status, blocks(rng), info=info).rows()
    for (_, wanted), row in zip(compared(trials, info, levels(trials)), rows, strict=True):
        assert (row.method, row.baseline, row.n) == (wanted["method"], "A", wanted["n_pairs"])
        size = wanted["difference"] if direction == "zero" else wanted["geometric_pct"]
        assert row.kind == ("difference" if direction == "zero" else "change")
        assert row.value == pytest.approx(size, rel=1e-8)
        assert row.n_failed == int(((status[row.method] != 0) | (status["A"] != 0)).sum())


def test_the_interval_is_that_of_student(rng):
    """Of the logarithms of the ratios."""
    values, _ = columns(rng)
    ok = dict.fromkeys(METHODS, np.zeros(N, dtype=np.int8))
    row = filled(values, ok, blocks(rng)).rows()[0]
    ends = 100 * np.expm1(student(np.log(values["B"] / values["A"]), 0.95))
    assert (row.low, row.high) == pytest.approx(tuple(ends), rel=1e-9)


def test_runs_without_partner_wait(rng):
    """A method that is ahead changes nothing until its baseline has the same runs."""
    values, status = columns(rng)
    running = filled(values, status, [("B", 0, 100)])
    assert [row.n for row in running.rows()] == [0, 0]
    assert running.text() == ""
    running.add(KEYS["A"], range(40, 60), values["A"][40:60], np.zeros(20, dtype=np.int8))
    both = status["B"][40:60] == 0
    assert [row.n for row in running.rows()] == [both.sum(), 0]
    assert "B" in running.text() and "C" not in running.text()


def test_a_look_computes_what_has_got_runs(rng, monkeypatch):
    """The baseline changes every row of its point; the other points stay as they are."""
    points = [(title, {name: f"{title}{name}" for name in "ABC"}) for title in ("one", "two")]
    running, computed = RunningComparison(MSE, points, "A", 0.95), []
    usual = running._compared
    monkeypatch.setattr(running, "_compared", lambda pair: computed.append(pair.key) or usual(pair))
    for key in ("oneA", "oneB", "oneC", "twoA", "twoB", "twoC", "twoC"):
        before, n = running.rows(), len(running._values[key])
        running.add(key, range(n, n + 5), rng.lognormal(size=5), np.zeros(5))
        computed.clear()
        after = running.rows()
        expected = {"A": ["B", "C"]}.get(key[-1], [key[-1]])
        assert computed == [key[:-1] + name for name in expected]
        assert [row for row in after if row.point != key[:-1]] == [row for row in before if row.point != key[:-1]]
    fresh = RunningComparison(MSE, points, "A", 0.95)
    for key, values in running._values.items():
        there = np.flatnonzero(running._there[key])
        fresh.add(key, there, values[there], np.zeros(len(there)))
    assert [row.n for row in fresh.rows()] == [5] * 4 and fresh.rows() == running.rows()


def test_an_event_that_may_not_occur_has_wins(rng):
    """Ties count half; a failed run loses."""
    info = MetricInfo("m", "s", "lower", may_not_occur=True)
    running = RunningComparison(info, [("", {"A": "a", "B": "b"})], "A", 0.95)
    running.add("a", range(4), np.array([1.0, np.inf, np.inf, 2.0]), np.array([0, 0, 0, 9]))
    running.add("b", range(4), np.array([2.0, np.inf, 3.0, 9.0]), np.array([0, 0, 0, 0]))
    (row,) = running.rows()
    assert (row.kind, row.value, row.n) == ("wins", pytest.approx(100 * (0 + 0.5 + 1 + 1) / 4), 4)


def test_points_share_trials(rng):
    """A baseline that does not depend on the swept value is computed once and counts at every point."""
    values, status = columns(rng)
    points = [("p=1", {"A": KEYS["A"], "B": KEYS["B"]}), ("p=2", {"A": KEYS["A"], "B": KEYS["C"]})]
    rows = filled(values, status, blocks(rng), points=points).rows()
    assert [(row.point, row.method) for row in rows] == [("p=1", "B"), ("p=2", "B")]
    assert min(row.n for row in rows) > 0


def test_one_method_has_its_mean(rng):
    """Without a comparison the Monte Carlo error is that of the mean."""
    running = RunningComparison(MetricInfo("m", "rad", "lower"), [("", {"A": "a"})], "A", 0.95)
    values = rng.normal(3.0, 1.0, 50)
    running.add("a", range(50), values, np.zeros(50, dtype=np.int8))
    (row,) = running.rows()
    assert (row.kind, row.baseline) == ("mean", "")
    assert (row.low, row.high) == pytest.approx(student(values, 0.95))
    assert running.text().startswith("m: A ")


def test_values_whose_squares_are_no_numbers():
    """A run that is nearly diverged ends no computation; the interval has no finite end."""
    running = RunningComparison(MetricInfo("m", "", "zero"), [("", {"A": "a", "B": "b"})], "A", 0.95)
    for place, value in enumerate((1e200, 3e200, 2e200)):
        running.add("a", [place], np.zeros(1), np.zeros(1))
        running.add("b", [place], np.array([value]), np.zeros(1))
    (row,) = running.rows()
    assert (row.n, row.low, row.high) == (3, -np.inf, np.inf) and row.value == pytest.approx(2e200, rel=1e-12)


def test_text_has_the_digits_of_its_error():
    """Two digits of half the interval."""
    running = RunningComparison(MetricInfo("mse", "rad^2", "lower"), [("", {"A": "a", "B": "b"})], "A", 0.95)
    running.add("a", range(4), np.array([1.0, 1.0, 1.0, 1.0]), np.zeros(4))
    running.add("b", range(4), np.array([0.89, 0.9, 0.91, 0.88]), np.zeros(4))
    assert running.text() == "mse vs A: B -10.5 % [-12.5, -8.4]"


class Kept(Progress):
    """Keeps the comparison at the start, as text, and the object that goes on."""

    def start(self, title, total, done, running=None):
        self.before, self.running = [row.n for row in running.rows()], running


def test_a_resumed_experiment_counts_what_is_stored(tmp_path):
    """Oracle: the published comparison of all runs."""
    path = write(tmp_path, **NOISY, runs=30)
    ran(path, tmp_path / "a", "--runs", 11)
    shown = Kept()
    results = run(load_config(path), directory=tmp_path / "a", jobs=1, progress=shown)
    assert shown.before == [11]
    (row,) = shown.running.rows()
    wanted = compare(results).to_frame().iloc[0]
    assert row.n == 30 == wanted["n_pairs"] and row.method == wanted["method"]
    assert row.value == pytest.approx(wanted["geometric_pct"], rel=1e-6)


def test_json_lines_of_a_run(tmp_path):
    """The last line counts all trials and has all pairs."""
    path = write(tmp_path, **NOISY, runs=12)
    result = cli("run", path, "-o", tmp_path / "a", "-j", 1, "--progress", "json")
    assert result.exit_code == 0, result.output
    lines = [json.loads(line) for line in result.stderr.splitlines() if line.startswith("{")]
    assert [lines[0]["event"], lines[-1]["event"]] == ["start", "stop"]
    assert (lines[0]["trials"], lines[-1]["done"], lines[-1]["comparison"][0]["n"]) == (24, 24, 12)
