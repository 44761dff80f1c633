"""The promises of a sweep: what points share is computed once, and every point is the plain experiment."""

import re
import shutil
import signal

import numpy as np
import pandas as pd
import pytest
from small_experiment import cli, ran, spied, text, write

from rmpc_bench import load_config, load_trials, run
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import dump
from rmpc_bench.engines import tasks

HP, HU, C, STD = "controller.Hp", "controller.Hu", "methods.R-MPC.estimator.c", "noise.measurement.gaussian.std"
METHODS = f"{{grid: {{{C}: [0.1, 1]}}, zip: {{{HP}: [10, 12], {HU}: [3, 2]}}}}"
TRUTH = f"{{grid: {{{STD}: [0.01, 0.02], {C}: [0.1, 1]}}}}"
ALL = [*range(6)]
NOISY = {"initial": "{x: {gaussian: {std: 0.1}}}", "record": "{runs: 3, signals: [u, x_hat]}"}
FILES = ("trials.csv", "series.csv", "uncertainty.csv", "summary.csv", "comparisons.csv", "traces.npz")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Return a function that runs a sweep of the small experiment, each only once, into a directory of a test."""
    done = {}

    def make(sweep, directory, **keys):
        name = text(sweep=sweep, **keys)
        if name not in done:
            done[name] = tmp_path_factory.mktemp("made")
            ran(write(done[name], sweep=sweep, **keys), done[name] / "out")
        return shutil.copytree(done[name] / "out", directory)

    return make


def files(directory):
    """Bytes of all derived tables and of the recorded runs."""
    return {name: (directory / name).read_bytes() for name in FILES}


def table(directory):
    """Read trials.csv; sweep columns as text."""
    return pd.read_csv(directory / "trials.csv", dtype={name: str for name in (HP, HU, C, STD)})


def test_what_does_not_depend_on_a_path_is_computed_once(tmp_path, monkeypatch):
    """S-MPC at the two horizons, R-MPC at the four points; the table has all of them."""
    blocks = spied(monkeypatch)
    ran(write(tmp_path, sweep=METHODS), tmp_path / "a")
    assert sorted(blocks) == [("R-MPC", ALL)] * 4 + [("S-MPC", ALL)] * 2
    frame = table(tmp_path / "a")
    assert [*frame.columns] == [C, HP, HU, "method", "run", "status", "mse", "input_power"]
    keys = [
        (c, hp, method, i) for c in ("0.1", "1") for hp in ("10", "12") for method in ("S-MPC", "R-MPC") for i in ALL
    ]
    assert [tuple(row) for row in frame[[C, HP, "method", "run"]].itertuples(index=False)] == keys
    s = frame[frame["method"] == "S-MPC"].groupby([HP, "run"])["mse"].nunique()
    r = frame[frame["method"] == "R-MPC"].groupby([HP, "run"])["mse"].nunique()
    assert set(s) == {1} and set(r) == {2}


@pytest.mark.parametrize("sweep", [METHODS, TRUTH])
def test_every_point_is_the_plain_experiment(made, tmp_path, sweep):
    """Oracle: the same values without a sweep, bit for bit, with the series of the designs."""
    directory = made(sweep, tmp_path / "a", **NOISY)
    trials, plain = load_trials(directory), write(tmp_path, **NOISY)
    assert len(trials.points) == 4
    for number, point in enumerate(trials.points):
        overrides = [f"{path}={value}" for path, value in point.point.items()]
        alone = run(load_config(plain, overrides=overrides), directory=tmp_path / str(number), jobs=1).trials
        assert point.frame.equals(alone.frame) and point.series.equals(alone.series)
        for method in ("S-MPC", "R-MPC"):
            for name, array in alone.traces[method].signals.items():
                np.testing.assert_array_equal(point.traces[method].signals[name], array)
    assert len({tuple(point.column("mse", "R-MPC")) for point in trials.points}) == 4


def test_the_way_to_compute_changes_no_byte(made, tmp_path):
    """Two workers and blocks of two runs, against one worker and one block."""
    there = files(made(TRUTH, tmp_path / "a", **NOISY))
    ran(write(tmp_path, sweep=TRUTH, **NOISY), tmp_path / "b", "-s", "execution.block=2", jobs=2)
    assert files(tmp_path / "b") == there


def test_an_interrupted_sweep_continues_where_it_was(made, tmp_path, monkeypatch):
    """What is stored is not computed again, and the bytes are those of an uninterrupted sweep."""
    path, simulate, done = write(tmp_path, sweep=TRUTH, **NOISY), tasks.simulate_block, []

    def interrupted(*args):
        if len(done) == 7:
            signal.raise_signal(signal.SIGINT)
        done.append(simulate(*args))
        return done[-1]

    monkeypatch.setattr(tasks, "simulate_block", interrupted)
    command = ("-s", "execution.block=2")
    assert cli("run", path, "-o", tmp_path / "b", "-j", 1, *command).exit_code == 130
    monkeypatch.setattr(tasks, "simulate_block", simulate)
    blocks = spied(monkeypatch)
    ran(path, tmp_path / "b", *command)
    assert len(blocks) == 3 * (2 + 4) - 7
    assert files(tmp_path / "b") == files(made(TRUTH, tmp_path / "a", **NOISY))


def test_all_points_meet_the_same_chance(tmp_path):
    """The same plants, initial states and noise; noise of twice the size is twice the noise."""
    config = load_config(write(tmp_path, sweep=TRUTH, **NOISY))
    draws = [
        point.experiment.scenario.draw(point.experiment.plant, range(3), 10) for point in config.points
    ]  # std 0.01, 0.01, 0.02, 0.02
    for drawn in draws:
        np.testing.assert_array_equal(drawn.x0, draws[0].x0)
        np.testing.assert_equal(drawn.delta._asdict(), draws[0].delta._asdict())
    np.testing.assert_array_equal(draws[1].v, draws[0].v)
    np.testing.assert_allclose(draws[2].v, 2 * draws[0].v, rtol=1e-15)
    assert draws[0].v.any() and draws[0].x0.any()


def test_uncertain_values_at_every_point(made, tmp_path):
    """With the sweep columns, so that they join trials.csv; the same at all points."""
    frame = pd.read_csv(made(METHODS, tmp_path / "a") / "uncertainty.csv", dtype={C: str, HP: str, HU: str})
    assert [*frame.columns] == [C, HP, HU, "run", "eps"]
    joined = table(tmp_path / "a").merge(frame, on=[C, HP, HU, "run"], validate="many_to_one")
    assert len(joined) == 48 and len(frame) == 24
    assert set(frame.groupby("run")["eps"].nunique()) == {1} and frame["eps"].nunique() == 6


def test_series_stand_once(made, tmp_path):
    """Those of a filter depend on no horizon: that column is empty, and so is the one of another method's parameter."""
    directory = made(METHODS, tmp_path / "a")
    frame = pd.read_csv(directory / "series.csv", dtype={C: str, HP: str, HU: str}, keep_default_na=False)
    assert [*frame.columns] == [C, HP, HU, "method", "quantity", "component", "k", "n", "value"]
    assert set(frame[HP]) == set(frame[HU]) == {""}
    assert set(map(tuple, frame[["method", C]].values)) == {("S-MPC", ""), ("R-MPC", "0.1"), ("R-MPC", "1")}
    assert not frame.duplicated([C, "method", "quantity", "component", "k"]).any()


GROWN = [
    # what is there, what is asked for, the blocks to compute
    (METHODS, f"{{grid: {{{C}: [0.1, 1, 5]}}, zip: {{{HP}: [10, 12], {HU}: [3, 2]}}}}", ["R-MPC", "R-MPC"]),
    (METHODS, f"{{grid: {{{C}: [0.1, 1]}}, zip: {{{HP}: [12, 10, 8], {HU}: [2, 3, 1]}}}}", ["R-MPC", "R-MPC", "S-MPC"]),
    (METHODS, f"{{grid: {{{HU}: [3], {HP}: [10], {C}: [1, 0.1]}}}}", []),
    (METHODS, None, []),
    (None, METHODS, ["R-MPC", "R-MPC", "R-MPC", "S-MPC"]),
    (None, "{grid: {controller: {given: {kind: mpc, Hp: 8, Hu: 2, Q: 1, R: 1}}}}", ["R-MPC", "S-MPC"]),
    (TRUTH, f"{{grid: {{{STD}: [0.01, 0.02], {C}: [0.1, 1, 5]}}}}", ["R-MPC", "R-MPC"]),
    (
        f"{{grid: {{{STD}: [0.01, 0.02], {HP}: [10, 8]}}, "
        f"exclude: [{{{STD}: 0.01, {HP}: 8}}, {{{STD}: 0.02, {HP}: 10}}]}}",
        f"{{grid: {{{STD}: [0.01, 0.02], {HP}: [10, 8]}}}}",
        ["R-MPC", "R-MPC", "S-MPC", "S-MPC"],
    ),
    (TRUTH, f"{{grid: {{{STD}: [0.01, 0.02], {HP}: [10, 8]}}}}", ["R-MPC", "R-MPC", "S-MPC", "S-MPC"]),
]  # fmt: skip


@pytest.mark.parametrize(("before", "after", "computed"), GROWN)
def test_a_sweep_over_methods_grows_in_place(made, tmp_path, monkeypatch, before, after, computed):
    """Only new values are computed, and the table is that of a new directory."""
    directory, blocks = made(before, tmp_path / "a"), spied(monkeypatch)
    config = load_config(write(tmp_path, sweep=after))
    grown = run(config, directory=directory, jobs=1).trials
    assert sorted(blocks) == [(name, ALL) for name in computed]
    assert grown.frame.equals(run(config, directory=tmp_path / "b", jobs=1).trials.frame)


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        (None, "{grid: {seed: [7, 8]}}", ("seed", "8")),
        (None, f"{{grid: {{{STD}: [0.02, 0.03]}}}}", (STD, "0.01", "0.02")),
        (
            "{grid: {uncertainty.eps: [+-20%]}}",
            "{grid: {uncertainty.eps: [+-20%, +-10%]}}",
            ("uncertainty.eps", "+-10%"),
        ),
        ("{grid: {plant.J_l: [25, 20]}}", "{grid: {plant.J_l: [25]}}", ("plant.J_l", "20")),
        ("{grid: {reference.value: [1, 2]}}", "{grid: {reference.value: [1, 3]}}", ("reference.value", "3")),
    ],
)
def test_a_sweep_over_the_truth_does_not(made, tmp_path, monkeypatch, before, after, said):
    """Exit 5 with the difference in words that a reader can compare and a command that works; nothing is touched."""
    directory, blocks = made(before, tmp_path / "a"), spied(monkeypatch)
    stored = (directory / "trials.csv").read_bytes()
    result = cli("run", write(tmp_path, sweep=after), "-o", directory, "-j", 1)
    assert result.exit_code == 5 and not blocks
    assert all(word in result.stderr for word in said) and f"-o {directory}-2" in result.stderr
    assert not re.search("[0-9a-f]{32}", result.stderr)
    assert (directory / "trials.csv").read_bytes() == stored


def test_more_runs_compute_only_the_new_ones(made, tmp_path, monkeypatch):
    """At every point, and end in the same bytes as all at once."""
    path = write(tmp_path, sweep=METHODS)
    few = run(load_config(path, runs=4), directory=tmp_path / "a", jobs=1).trials
    assert len(few.frame) == 4 * 2 * 4
    blocks = spied(monkeypatch)
    grown = run(load_config(path), directory=tmp_path / "a", jobs=1).trials
    assert sorted(blocks) == [("R-MPC", [4, 5])] * 4 + [("S-MPC", [4, 5])] * 2
    assert grown.frame.equals(load_trials(made(METHODS, tmp_path / "b")).frame)


def test_one_method_only(made, tmp_path, monkeypatch):
    """Its rows at every point, and only its series; the others follow later."""
    path = write(tmp_path, sweep=METHODS)
    blocks = spied(monkeypatch)
    trials = run(load_config(path), directory=tmp_path / "a", jobs=1, only=["R-MPC"]).trials
    assert blocks == [("R-MPC", ALL)] * 4
    assert set(trials.frame["method"]) == {"R-MPC"} and len(trials.frame) == 4 * 6 and trials.baseline == "R-MPC"
    assert set(trials.series["method"]) == {"R-MPC"}
    assert ran(path, tmp_path / "a") == (made(METHODS, tmp_path / "b") / "trials.csv").read_bytes()
    assert blocks[4:] == [("S-MPC", ALL)] * 2


def test_a_point_where_nothing_is_stored_is_left_out(made, tmp_path):
    """After an interruption, say: the table has the points that have trials."""
    directory = made(f"{{grid: {{{HP}: [10]}}}}", tmp_path / "a")
    config = load_config(write(tmp_path, sweep=f"{{grid: {{{HP}: [12, 10]}}}}"))
    trials = load_trials(directory)
    part = run(config, directory=directory, only=())
    assert [dict(point.point) for point in part.trials.points] == [{HP: "10"}]
    assert part.trials.frame.equals(trials.frame)
    assert part.n_complete == {"S-MPC": 0, "R-MPC": 0}


SWEEPS = [
    METHODS,
    TRUTH,
    f"{{grid: {{plant.perturb.R: [1 + 5%, 1 - eps], {C}: [10%, 1]}}}}",
    "{grid: {estimator: {a: {kind: kalman}, b: {kind: robust-kalman, c: 2}}}, zip: {name: [u, v], seed: [1, 2]}}",
    "{grid: {model.noise.process: [1, 2], controller: [{kind: mpc, Hp: 9, Hu: 2, Q: 2*pi, R: 1}]}}",
    "{grid: {methods.S-MPC.controller: {own: {Hp: 12}, other: {kind: mpc, Hp: 8, Hu: 2, Q: 1, R: 1}}}}",
    "{grid: {noise: {none: none, loud: {process: same}}, initial.P: [process, 2]}, exclude: [{noise: loud}]}",
    "{grid: {time.step: [0.1, 0.05]}}",
    "{zip: {reference: [{kind: constant, value: 1}, {kind: square, values: [0, pi], period: 0.4}], seed: [3, 4]}}",
]


@pytest.mark.parametrize(
    ("sweep", "smoke"), [*((each, False) for each in SWEEPS), *((each, True) for each in (*SWEEPS[1:4], SWEEPS[7]))]
)
def test_what_is_written_back_loads_to_the_same_sweep(tmp_path, sweep, smoke):
    """Points, truths, methods and metrics; also at the size of a smoke run."""
    keys = {"methods": "{S-MPC: {}, R-MPC: {estimator: {kind: robust-kalman, c: 1}}}"} if sweep == SWEEPS[3] else {}
    path = write(tmp_path, sweep=sweep, smoke="{runs: 2, steps: 7}", metrics="[mse, {kind: mae, to: 9}]", **keys)
    config = load_config(path, smoke=smoke)
    (tmp_path / "again.yaml").write_text(dump(plain(config.resolved)))
    again = load_config(tmp_path / "again.yaml")
    assert (again.hash, again.full_hash, again.axes) == (config.hash, config.full_hash, config.axes)
    assert plain(again.resolved) == plain(config.resolved)
    for one, other in zip(again.points, config.points, strict=True):
        assert (one.title, one.coordinates, one.experiment_hash) == (
            other.title,
            other.coordinates,
            other.experiment_hash,
        )
        assert (one.method_keys, one.metric_keys) == (other.method_keys, other.metric_keys)
        assert one.experiment.n_runs == other.experiment.n_runs == (2 if smoke else 6)
