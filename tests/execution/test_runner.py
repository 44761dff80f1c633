"""The promises: the same bytes whatever the way, nothing computed twice, nothing lost."""

import signal

import numpy as np
import pytest
from small_experiment import cli, ran, spied, write
from threadpoolctl import threadpool_info

from rmpc_bench import load_config, registry
from rmpc_bench.config_file import factories
from rmpc_bench.engines import tasks
from rmpc_bench.engines.blocks import BlockLengths, TaskQueue
from rmpc_bench.engines.choice import serial
from rmpc_bench.execution.missing import pending
from rmpc_bench.store.store import Store

NOISY = {
    "uncertainty": "{eps: +-20%, delta: {dist: normal, std: 5%, truncate: 3}}",
    "plant": "{kind: servo-linear, perturb: {J_l: 1 + eps, R: 1 + delta}}",
    "noise": "{process: {gaussian: {std: 0.01}}, measurement: {same: {scale: 0.01}}}",
    "initial": "{x: {gaussian: {std: 0.1}}}",
    "metrics": "[mse, input_power, settling_time, steady_state_error]",
}
THREE = (
    "{S-MPC: {estimator: {kind: kalman}}, new: {estimator: {kind: robust-kalman, c: 1}},"
    " R-MPC: {estimator: {kind: robust-kalman, c: 0.1}}}"
)


@pytest.fixture
def noisy(tmp_path):
    """Write the small experiment with every source of randomness."""
    return write(tmp_path, **NOISY, runs=20)


def rows(csv, method=None, below=None):
    """Lines of a trials.csv of one method, or of the runs below a number."""
    lines = csv.decode().splitlines()[1:]
    return [
        line
        for line in lines
        if (method is None or line.startswith(method + ",")) and (below is None or int(line.split(",")[1]) < below)
    ]


def test_every_run_differs(noisy, tmp_path):
    """The comparisons below would be worth nothing otherwise."""
    lines = rows(ran(noisy, tmp_path / "a"))
    assert len(lines) == 40 == len({line.split(",")[3] for line in lines})


def test_one_and_two_workers_give_the_same_bytes(noisy, tmp_path):
    """Blocks may finish in any order."""
    two = ran(noisy, tmp_path / "two", "-s", "execution.block=3", jobs=2)
    assert two == ran(noisy, tmp_path / "one")


@pytest.mark.parametrize("block", [1, 7])
def test_blocks_of_any_size_give_the_same_bytes(noisy, tmp_path, block):
    """As those of 50, the default."""
    assert ran(noisy, tmp_path / "a", "-s", f"execution.block={block}") == ran(noisy, tmp_path / "b")


@pytest.mark.parametrize("keys", [{}, {"plant": "{kind: servo, perturb: {J_l: 1 + eps}}"}])
def test_the_first_runs_of_many_are_a_smaller_experiment(tmp_path, keys):
    """What befalls a run does not depend on how many there are."""
    path = write(tmp_path, **{**NOISY, "runs": 20, **keys})
    many, few = ran(path, tmp_path / "many"), ran(path, tmp_path / "few", "--runs", 5)
    assert rows(few) == rows(many, below=5)


def test_the_order_of_the_methods_changes_only_the_order_of_the_rows(noisy, tmp_path):
    """A method meets the same plants and the same noise wherever it stands and whoever stands beside it."""
    three = ran(write(tmp_path, file="three.yaml", **NOISY, runs=20, methods=THREE), tmp_path / "three")
    two = ran(noisy, tmp_path / "two")
    assert rows(three, "S-MPC") + rows(three, "R-MPC") == rows(two)


def test_twice_is_once(noisy, tmp_path, monkeypatch):
    """The same command again computes nothing and changes nothing."""
    first, blocks = ran(noisy, tmp_path / "a"), spied(monkeypatch)
    assert ran(noisy, tmp_path / "a") == first
    assert blocks == []


def test_more_runs_compute_only_the_new_ones(noisy, tmp_path, monkeypatch):
    """And end in the same bytes as all at once."""
    ran(noisy, tmp_path / "a", "--runs", 5)
    blocks = spied(monkeypatch)
    grown = ran(noisy, tmp_path / "a")
    assert blocks == [("S-MPC", [*range(5, 20)]), ("R-MPC", [*range(5, 20)])]
    assert grown == ran(noisy, tmp_path / "b")


def test_fewer_runs_show_fewer_and_keep_the_others(noisy, tmp_path, monkeypatch):
    """The store forgets nothing."""
    all_of_them, blocks = ran(noisy, tmp_path / "a"), spied(monkeypatch)
    assert rows(ran(noisy, tmp_path / "a", "--runs", 5)) == rows(all_of_them, below=5)
    assert ran(noisy, tmp_path / "a") == all_of_them
    assert blocks == []


def test_a_new_method_is_computed_alone(noisy, tmp_path, monkeypatch):
    """The rows of the others stay as they are."""
    before, blocks = ran(noisy, tmp_path / "a"), spied(monkeypatch)
    after = ran(write(tmp_path, **NOISY, runs=20, methods=THREE), tmp_path / "a")
    assert blocks == [("new", [*range(20)])]
    assert rows(after, "S-MPC") + rows(after, "R-MPC") == rows(before)
    assert len(rows(after, "new")) == 20


def test_a_method_that_changes_is_computed_again(noisy, tmp_path, monkeypatch):
    """Under an old name nothing old is found."""
    before, blocks = ran(noisy, tmp_path / "a"), spied(monkeypatch)
    after = ran(noisy, tmp_path / "a", "-s", "methods.R-MPC.estimator.c=5")
    assert blocks == [("R-MPC", [*range(20)])]
    assert rows(after, "S-MPC") == rows(before, "S-MPC") and rows(after, "R-MPC") != rows(before, "R-MPC")


def test_a_method_under_a_new_name_is_there_already(noisy, tmp_path, monkeypatch):
    """Names and labels are no part of what a method is."""
    before, blocks = ran(noisy, tmp_path / "a"), spied(monkeypatch)
    methods = "{one: {estimator: {kind: kalman}, label: first}, two: {estimator: {kind: robust-kalman, c: 10%}}}"
    after = ran(write(tmp_path, **NOISY, runs=20, methods=methods), tmp_path / "a")
    assert blocks == []
    assert after == before.replace(b"S-MPC,", b"one,").replace(b"R-MPC,", b"two,")


def test_a_new_metric_is_filled_in(noisy, tmp_path):
    """The values of the old ones stay, bit for bit."""
    before = ran(noisy, tmp_path / "a").decode().splitlines()
    metrics = "[mse, mae, input_power, settling_time, steady_state_error]"
    after = ran(write(tmp_path, **{**NOISY, "metrics": metrics}, runs=20), tmp_path / "a").decode().splitlines()
    split = [line.split(",") for line in after]
    assert [",".join([*cells[:4], *cells[5:]]) for cells in split] == before
    assert all(float(cells[4]) > 0 for cells in split[1:])


def test_a_metric_less_needs_no_computing(noisy, tmp_path, monkeypatch):
    """Nor does another order or name."""
    ran(noisy, tmp_path / "a")
    blocks = spied(monkeypatch)
    metrics = "[input_power, {kind: mse, name: error}]"
    ran(write(tmp_path, **{**NOISY, "metrics": metrics}, runs=20), tmp_path / "a")
    assert blocks == []


def test_a_window_in_another_unit_is_another_metric(tmp_path):
    """`to: 1` is one sample with steps and ten with a duration of as many steps."""
    keys = {"metrics": "[{kind: mse, to: 1}]", "runs": "2"}
    ran(write(tmp_path, **keys, time="{step: 0.1, steps: 10}"), tmp_path / "a")
    path = write(tmp_path, **keys, time="{step: 0.1, duration: 1}")
    fresh = ran(path, tmp_path / "b")
    result = cli("run", path, "-o", tmp_path / "a", "-j", 1)
    assert result.exit_code == 5 or (tmp_path / "a" / "trials.csv").read_bytes() == fresh


def test_an_interrupted_run_continues_where_it_was(noisy, tmp_path, monkeypatch):
    """Blocks that are stored are not computed again, and the bytes are those of an uninterrupted run."""
    simulate = tasks.simulate_block

    def interrupted(experiment, method, runs, *draws):
        if runs.start >= 9:
            signal.raise_signal(signal.SIGINT)
        return simulate(experiment, method, runs, *draws)

    monkeypatch.setattr(tasks, "simulate_block", interrupted)
    command = ("-s", "execution.block=3")
    result = cli("run", noisy, "-o", tmp_path / "a", "-j", 1, *command)
    assert result.exit_code == 130
    assert "the same command continues" in result.stderr and "Traceback" not in result.stderr
    monkeypatch.setattr(tasks, "simulate_block", simulate)
    blocks = spied(monkeypatch)
    assert ran(noisy, tmp_path / "a", *command) == ran(noisy, tmp_path / "b")
    assert min(min(runs) for _, runs in blocks[:8]) == 9


def test_a_queue_goes_block_by_block(noisy, tmp_path):
    """All methods of a block come together; a hole in what is stored is filled, within the borders of the blocks."""
    config = load_config(noisy)

    def blocks(directory, methods):
        with Store(directory) as store:
            queue = TaskQueue(pending(config, store, methods), BlockLengths([config.experiment], 8))
        return [tuple(task)[:3] for task in iter(queue.take, None)]

    assert blocks(tmp_path / "a", ["S-MPC", "R-MPC"]) == [
        *(("S-MPC", 0, 8), ("R-MPC", 0, 8), ("S-MPC", 8, 16), ("R-MPC", 8, 16), ("S-MPC", 16, 20), ("R-MPC", 16, 20))
    ]
    ran(noisy, tmp_path / "b", "--runs", 3, "--only", "R-MPC")
    assert blocks(tmp_path / "b", ["R-MPC"]) == [("R-MPC", 3, 8), ("R-MPC", 8, 16), ("R-MPC", 16, 20)]


def test_blas_runs_on_one_thread(tmp_path, monkeypatch):
    """In designs and in blocks, from Python too: more threads may change last bits."""
    monkeypatch.setattr(registry, "_REGISTERED", {group: {} for group in registry.BUILT_IN})
    threads = {}

    def note(when):
        found = [info["num_threads"] for info in threadpool_info() if info["user_api"] == "blas"]
        threads[when] = max(found)

    def watching(model, n_steps, *, x0, P0):
        note("design")
        return factories.estimator("kalman", model, n_steps, x0=x0, P0=P0)

    registry.register("estimator", "watching", watching)
    config = load_config(write(tmp_path, methods="{a: {estimator: {kind: watching}}}"))
    simulate = tasks.simulate_block
    monkeypatch.setattr(tasks, "simulate_block", lambda *args: note("block") or simulate(*args))
    list(serial([config.experiment], TaskQueue([tasks.Task("a", 0, 2)])))
    assert threads == {"design": 1, "block": 1}


def test_a_task_brings_its_uncertain_values(noisy):
    """One value per run and name, the same as any other task that contains the run."""
    config = load_config(noisy)
    done = tasks.work([config.experiment], tasks.Task("S-MPC", 2, 5))
    again = tasks.work([config.experiment], tasks.Task("R-MPC", 4, 6))
    assert [*done.uncertainty] == ["eps", "delta"]
    for name, values in done.uncertainty.items():
        assert len(values) == 3 and values[2] == again.uncertainty[name][0]
    assert done.block.metrics.shape == (4, 3) and np.isfinite(done.block.metrics[0]).all()
