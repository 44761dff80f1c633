"""Results are read from the store alone: without designs, a user's code, numba and joblib, and from any place."""

import json
import shutil
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from small_experiment import cli, ran, spied, text, write
from uncertain_experiment import write_estimation

from rmpc_bench import compare, load_config, load_results, load_trials, publish, registry, run
from rmpc_bench.execution.layout import _limits as limits_of_controller
from rmpc_bench.received.store import MissingError
from rmpc_bench.types import ConfigError

KEPT = ("trials.sqlite", "manifest.json")
PARTS = '''
from dataclasses import dataclass, fields
from matplotlib.figure import Figure as Picture
from rmpc_bench.estimators.gain_schedule import GainScheduleFilter
from rmpc_bench.estimators.kalman import design
from rmpc_bench.types import Figure, Metric


class Slow(GainScheduleFilter):
    """A filter that is not consistent."""

    expected_failures = {"consistent": "starts with another covariance"}


def slow(model, n_steps, x0, P0, factor: float = 2.0):
    """Kalman filter that starts with another covariance."""
    made = design(model, n_steps, x0=x0, P0=factor * P0)
    return Slow(**{each.name: getattr(made, each.name) for each in fields(GainScheduleFilter)})


@dataclass(frozen=True)
class Wordy(GainScheduleFilter):
    """A filter that reports a text."""

    def series(self):
        return {"note": "fast"}


def wordy(model, n_steps, x0, P0):
    """Kalman filter that reports a text."""
    made = design(model, n_steps, x0=x0, P0=P0)
    return Wordy(**{each.name: getattr(made, each.name) for each in fields(GainScheduleFilter)})


@dataclass(frozen=True, kw_only=True)
class Peak(Metric):
    """Largest output."""

    name: str = "peak"

    def evaluate(self, record):
        return record.y[:, :, 0].max(axis=1)


@dataclass(frozen=True, kw_only=True)
class Dots(Figure):
    """Nothing but axes."""

    def draw(self, results):
        picture = Picture()
        picture.add_subplot().plot([1.0, 2.0])
        return picture


@dataclass(frozen=True, kw_only=True)
class Torn(Figure):
    """A figure with a mistake."""

    def draw(self, results):
        return 1 / 0
'''
NAMESAKES = """
import numpy as np
from rmpc_bench import single_run


@single_run
class Zero:
    def __init__(self, soft: bool = True):
        self.soft = soft

    def control(self, x_hat, r):
        return np.zeros(1)


@single_run
class Plant:
    nx = nu = ny = 1

    def __init__(self, uncertainty: float = 0.1):
        self.gain = uncertainty

    def step(self, x, u):
        return 0.9 * x + u

    def output(self, x):
        return x
"""
OWN = {
    "methods": "{S-MPC: {estimator: {kind: kalman}}, own: {estimator: {file: 'parts.py:slow', factor: 3}}}",
    "metrics": "[mse, {file: 'parts.py:Peak'}]",
    "figures": "[boxplot, {file: 'parts.py:Dots'}, {file: 'parts.py:Torn'}]",
    "claims": "[{says: small, source: here, check: 'mean(peak[own, controller.Hp=10]) < 1e9'}]",
    "record": "{runs: 2, signals: [y, x_hat]}",
    "sweep": "{grid: {controller.Hp: [10, 12]}}",
}


def files(directory):
    """Return the bytes of all that is derived from the trials, by name."""
    kept = {*KEPT, "config.yaml", "config.resolved.yaml", "progress.json", "published.json"}
    found = [path for path in directory.rglob("*") if path.is_file() and not {"code", "logs"} & {*path.parts}]
    return {str(path.relative_to(directory)): path.read_bytes() for path in found if path.name not in kept}


def moved(directory, there):
    """Copy only what the trials were stored in to another place."""
    there.mkdir(parents=True)
    for name in KEPT:
        shutil.copy(directory / name, there / name)
    return there


def query(directory, statement):
    """Execute a statement on the store."""
    with closing(sqlite3.connect(directory / "trials.sqlite")) as connection, connection:
        return connection.execute(statement).fetchall()


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    """Return the directory of an experiment with a user's estimator, metric and figures, whose file is gone."""
    place = tmp_path_factory.mktemp("own")
    (place / "parts.py").write_text(PARTS, encoding="utf-8")
    written = publish(run(load_config(write(place, **OWN)), directory=place / "out", jobs=1))
    (place / "parts.py").unlink()
    (place / "tiny.yaml").unlink()
    return place / "out", written


@pytest.mark.long("own layout")
def test_the_same_bytes_without_code_in_another_place(own, tmp_path):
    """Tables, claims, recorded runs and the figures of this package; the user's picture is left as it is."""
    directory, _ = own
    there = moved(directory, tmp_path / "elsewhere" / "deep")
    result = cli("report", there)
    assert result.exit_code == 0
    expected, found = files(directory), files(there)
    drawn = [expected.pop(name) for name in [*expected] if name.startswith("figures/Dots.")]
    # The pages name the directory in commands, and show the user's picture where it is drawn.
    pages = [(expected.pop(name), found.pop(name)) for name in ("report.html", "report.md")]
    assert all(drawn) and found == expected
    assert all(b"Dots" in before and b"figures/Dots" not in after for before, after in pages)
    assert load_trials(there).frame.equals(load_trials(directory).frame)
    assert compare(load_results(there)).to_markdown() == compare(load_results(directory)).to_markdown()


@pytest.mark.long("own layout")
def test_declared_failures_of_checks_are_printed(own, tmp_path):
    """With the reason, in the page of tables."""
    there = moved(own[0], tmp_path / "there")
    assert cli("report", there).exit_code == 0
    page = (there / "tables" / "summary.md").read_text(encoding="utf-8")
    section = page.partition("## Checks that are meant to fail")[2].partition("\n#")[0]
    assert section.strip() == "- own: `consistent` (starts with another covariance)"


@pytest.mark.long("own layout")
def test_a_figure_of_a_user_is_drawn_by_run_only(own, tmp_path):
    """A line says so; a mistake in one costs this figure alone and names the user's line."""
    directory, written = own
    assert [path.name for path in written.paths if path.suffix == ".svg"] == ["boxplot.svg", "Dots.svg"]
    [torn] = written.left_out
    assert torn.startswith("parts.py:Torn: ") and "parts.py:" in torn[15:] and "ZeroDivisionError" in torn
    lines = cli("report", moved(directory, tmp_path / "there")).stderr.splitlines()
    assert [line.split(": ")[:2] for line in lines] == [
        ["figure left out", "parts.py:Dots"],
        ["figure left out", "parts.py:Torn"],
    ]
    assert all("`rmpc-bench run` draws it" in line for line in lines)


@pytest.mark.long("own layout")
def test_a_report_imports_no_design(own, tmp_path):
    """Neither numba nor joblib nor a plant, model, estimator, controller or metric; nor is a configuration read."""
    there = moved(own[0], tmp_path / "there")
    code = (
        "import sys\n"
        "from rmpc_bench.publishing.publish import publish\n"
        "from rmpc_bench.results.results import load_results\n"
        f"publish(load_results({str(there)!r}))\n"
        "print(*sys.modules)\n"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    modules = set(result.stdout.split())
    groups = ("plants", "models", "estimators", "controllers", "metrics")
    designs = {target.partition(":")[0] for group in groups for target in registry.BUILT_IN[group].values()}
    assert "rmpc_bench.figures.boxplot" in modules and "rmpc_bench.estimators.kalman" in designs
    assert not modules & {"numba", "joblib", "parts", "rmpc_bench.config.build", "rmpc_bench.engines"}
    assert sorted(modules & designs) == []


def test_what_needs_no_new_trial_is_renewed_by_the_next_run(tmp_path, monkeypatch):
    """Labels, figures, claims and statistics; until then a report shows those of the run before."""
    path, out = write(tmp_path), tmp_path / "out"
    ran(path, out)
    before = load_results(out)
    claims = "[{says: small, source: here, check: 'mean(mse[S-MPC]) < 1e9'}]"
    methods = "{S-MPC: {label: plain, estimator: {kind: kalman}}, R-MPC: {estimator: {kind: robust-kalman, c: 0.1}}}"
    statistics = "{confidence: 0.9, baseline: R-MPC, relevant: 0.05}"
    path.write_text(text(claims=claims, methods=methods, statistics=statistics, figures="[rows]"), encoding="utf-8")
    assert load_results(out).experiment == before.experiment
    blocks = spied(monkeypatch)
    ran(path, out)
    after = load_results(out)
    assert blocks == [] and after.trials.frame.equals(before.trials.frame)
    assert after.trials.labels["S-MPC"] == "plain" and [claim.says for claim in after.experiment.claims] == ["small"]
    assert (after.trials.confidence, after.trials.baseline, after.trials.relevant) == (0.9, "R-MPC", 0.05)
    assert [dict(figure)["kind"] for figure in after.experiment.figures] == ["rows"]


def test_a_method_with_new_keys_gets_new_series(tmp_path):
    """And arrays that nothing names any more are gone."""
    path, out = write(tmp_path), tmp_path / "out"
    ran(path, out)
    [(n_arrays,)] = query(out, "SELECT count(*) FROM arrays")
    methods = "{S-MPC: {estimator: {kind: kalman}}, R-MPC: {estimator: {kind: robust-kalman, c: 0.7}}}"
    config = load_config(write(tmp_path, methods=methods))
    trials = run(config, directory=out, jobs=1).trials
    expected = config.experiment.method("R-MPC").estimator.series()["P"]
    assert trials.matrix_series("P", "R-MPC").tobytes() == expected.tobytes()
    assert query(out, "SELECT count(*) FROM arrays") == [(n_arrays,)]


def test_a_run_without_news_leaves_the_store_as_it_is(tmp_path):
    """Not a byte is written."""
    path, out = write_estimation(tmp_path, evaluate="[runs, moments]"), tmp_path / "out"
    ran(path, out)
    before = (out / "trials.sqlite").read_bytes()
    ran(path, out)
    assert (out / "trials.sqlite").read_bytes() == before


def test_exact_moments_and_ensembles_of_a_sweep(tmp_path):
    """Points that share an array store it once; the table is that of the designs."""
    sweep = "{grid: {initial.P: [1, 2], plant.uncertainty.high: [1, 0.5]}}"
    path = write_estimation(tmp_path, evaluate="[runs, moments]", sweep=sweep, record="{runs: 1}")
    ran(path, tmp_path / "out")
    # Of the same name, and with the configuration, which the page shows.
    there = moved(tmp_path / "out", tmp_path / "there" / "out")
    shutil.copy(tmp_path / "out" / "config.resolved.yaml", there)
    assert cli("report", there).exit_code == 0
    assert files(there) == files(tmp_path / "out")
    results = load_results(there)
    points = results.experiment.points
    methods = [method for point in points for method in point.methods.values()]
    named = [name for method in methods for name in (*method.moments, *method.series.values())]
    stored = {name for (name,) in query(there, "SELECT name FROM arrays")}
    assert stored == {*named, *(point.reference for point in points)} and len(stored) < len(named)
    assert {"cov(e)", "P"} <= set(results.series["quantity"])


def test_a_smoke_run_can_be_reported(tmp_path):
    """Also where a window of a metric reaches beyond its last sample."""
    keys = {"smoke": "{runs: 2, steps: 5}", "metrics": "[{kind: mse, name: late, from: 0.8, to: 1}]"}
    out = tmp_path / "out"
    ran(write(tmp_path, **keys), out, "--smoke")
    assert cli("report", out).exit_code == 0
    assert load_results(out).overrides == ("--smoke",) and not load_trials(out).with_verdicts


def test_an_interrupted_run_can_be_read(tmp_path, monkeypatch):
    """What reports need is stored before the first block."""
    from rmpc_bench.store import store

    path, out = write(tmp_path, execution="{block: 2}"), tmp_path / "out"
    add, added = store.Store.add_block, []

    def interrupted(self, *arguments):
        if len(added) == 2:
            raise KeyboardInterrupt
        added.append(arguments)
        add(self, *arguments)

    monkeypatch.setattr(store.Store, "add_block", interrupted)
    assert cli("run", path, "-o", out, "-j", 1, "--progress", "none").exit_code == 130
    assert load_results(out).incomplete == ("S-MPC: 2 of 6 runs", "R-MPC: 2 of 6 runs")


@pytest.mark.parametrize(
    "change",
    [
        "DELETE FROM meta WHERE key = 'layout'",
        "UPDATE meta SET value = '{}' WHERE key = 'layout'",
    ],
)
def test_a_store_without_what_a_report_needs(tmp_path, monkeypatch, change):
    """An earlier or another version wrote it: exit 2 with the way out, which computes nothing again."""
    path, out = write(tmp_path), tmp_path / "out"
    first = ran(path, out)
    with closing(sqlite3.connect(out / "trials.sqlite")) as connection:
        connection.executescript(change)
    result = cli("report", out)
    assert result.exit_code == 2 and "rmpc-bench run" in result.stderr and "version" in result.stderr
    with pytest.raises(MissingError):
        load_trials(out)
    blocks = spied(monkeypatch)
    assert ran(path, out) == first and blocks == []
    assert cli("report", out).exit_code == 0


def test_a_series_that_is_no_array_is_refused(tmp_path):
    """Before any run, at the estimator that returns it."""
    (tmp_path / "parts.py").write_text(PARTS, encoding="utf-8")
    with pytest.raises(ConfigError, match=r"estimator: `series` returns something else than numbers for 'note'"):
        load_config(write(tmp_path, methods="{own: {estimator: {file: 'parts.py:wordy'}}}"))


@pytest.mark.long("own layout")
def test_the_layout_is_plain_data(own):
    """JSON without a path of this machine."""
    directory, _ = own
    [(layout,)] = query(directory, "SELECT value FROM meta WHERE key = 'layout'")
    assert json.loads(layout)["name"] == "tiny"
    assert str(directory.parent) not in layout and str(Path.cwd()) not in layout


@pytest.mark.parametrize(
    ("controller", "limits"),
    [
        ({"limits": {"u": [-220.0, 220.0], "enforce": "clip", "du": [-1, 1]}}, {"u": (-220.0, 220.0)}),
        (
            {"limits": {"x.1": [None, 2.0]}, "soft": {"y.0": {"limits": [-1, 1], "linear": 2}}},
            {"x.1": (None, 2.0), "y.0": (-1.0, 1.0)},
        ),
        ({"limits": {"u": [[-1, float("-inf")], [1, 2]]}}, {"u.0": (-1.0, 1.0), "u.1": (None, 2.0)}),
        ({"kind": "lqr", "limits": None}, {}),
    ],
)
def test_limits_of_a_controller(controller, limits):
    """Hard and soft ones of signals, of every component; increments have no panel."""
    assert limits_of_controller(controller) == limits


def test_limits_are_stored(tmp_path):
    """A figure of stored results shows them."""
    path = write(tmp_path, record="{runs: 1}")
    run(load_config(path), directory=tmp_path / "out", jobs=1)
    stored = load_trials(tmp_path / "out").limits
    assert set(stored) and all(limits == {"u": (-220.0, 220.0)} for limits in stored.values())


def test_a_key_of_a_users_component_with_the_name_of_a_built_in_one_is_plain_data(tmp_path):
    """`soft` of a controller and `uncertainty` of a plant mean what their author says."""
    (tmp_path / "mine.py").write_text(NAMESAKES, encoding="utf-8")
    methods = "{K: {estimator: {kind: kalman}, controller: {file: mine.py:Zero}}}"
    model = "{kind: linear, A: [[0.9]], B: [[1]], C: [[1]], P_w: 1.0e-6, P_v: 4.0e-6}"
    path = tmp_path / "own.yaml"
    lines = ["version: 1", "name: own", "seed: 1", "runs: 2", "time: {step: 0.1, steps: 5}", "metrics: [mse]"]
    lines += ["plant: {file: mine.py:Plant}", f"model: {model}", f"methods: {methods}", "figures: []"]
    path.write_text("\n".join(lines), encoding="utf-8")
    results = run(load_config(path), directory=tmp_path / "out", jobs=1)
    assert results.trials.n_failed_trials == 0
    assert all(limits == {} for limits in results.trials.limits.values())
