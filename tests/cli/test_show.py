"""`show` replays a run bit for bit; the files, tables and the screen name failed runs, held steps and warnings."""

import shutil
import subprocess
import sys
from contextlib import nullcontext

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from own_experiment import write_own
from scipy.io import loadmat
from stored_rows import change

import rmpc_bench
from rmpc_bench.cli import main


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """Run the experiment; its directory, what was printed, and the place of the results after the sources are gone."""
    directory = tmp_path_factory.mktemp("own")
    path = write_own(directory)
    results = directory / "results"
    run = CliRunner().invoke(main, ["run", str(path), "-o", str(results), "-j", "1", "--progress", "none"])
    for file in ("mine.py", "own.yaml"):
        (directory / file).unlink()
    return results, run


def show(results, *arguments):
    return CliRunner().invoke(main, ["show", str(results), *arguments])


def test_failures_up_to_the_limit_are_no_error(done):
    assert done[1].exit_code == 0, done[1].output
    table = pd.read_csv(done[0] / "trials.csv").groupby("method")["status"].agg(lambda words: sorted(set(words)))
    assert table["raises"] == ["crashed", "ok"]
    assert table["stops"] == ["not-converged", "ok"]
    assert all(table[method] == ["ok"] for method in ("KF", "good", "holds", "warns"))


def test_the_screen_names_failed_runs_with_the_command_that_replays_the_first(done):
    """The method that fails most, and its first run; held steps and warnings stand in the summary."""
    shown = "".join(done[1].stdout.replace("\\\n", "").split())
    for text in (
        "failed: raises, 2 runs, 'ValueError: negative level -1.0' (and 1 more method: failures/); the first again:",
        f"rmpc-bench show {done[0]} --run 2 --method raises --until 4 --pdb",
    ):
        assert "".join(text.split()) in shown
    summary = (done[0] / "tables" / "summary.md").read_text(encoding="utf-8")
    assert "- holds: 2 of 80 steps held in 1 run" in summary and "## Warnings of components" in summary


def test_a_failed_run_has_a_file(done):
    assert sorted(path.name for path in (done[0] / "failures").iterdir()) == [
        "raises-2.txt",
        "raises-5.txt",
        "stops-3.txt",
    ]
    text = (done[0] / "failures" / "raises-2.txt").read_text(encoding="utf-8")
    for part in (
        "crashed",
        "k = 4, t = 2 s",
        "ValueError: negative level -1.0",
        "mine.py",
        "in update",
        "eps",
        "numpy",
    ):
        assert part in text
    assert "rmpc_bench/" not in text.split("versions")[0]
    assert "u_previous" in text
    assert "infeasible" not in (done[0] / "failures" / "stops-3.txt").read_text(encoding="utf-8")


def test_held_steps_are_a_column_and_stand_beside_the_means(done):
    table = pd.read_csv(done[0] / "trials.csv")
    held = table[table["held_steps"] > 0]
    assert held[["method", "run", "held_steps"]].values.tolist() == [["holds", 3, 2]]
    text = (done[0] / "tables" / "summary.md").read_text(encoding="utf-8")
    assert "| held steps |" in text
    assert "2.5 %" in text
    assert "- holds: 2 of 80 steps held in 1 run" in text


def test_a_warning_is_shown_once_with_its_count(done):
    text = (done[0] / "tables" / "summary.md").read_text(encoding="utf-8")
    warned = [line for line in text.splitlines() if line.startswith("- warns, ")]
    assert len(warned) == 1
    assert warned[0].startswith("- warns, 88 times: RuntimeWarning: invalid value encountered in sqrt (mine.py:")
    assert "RuntimeWarning" not in done[1].stderr


def test_comparisons_say_on_how_many_runs_they_rest(done):
    text = (done[0] / "tables" / "summary.md").read_text(encoding="utf-8")
    assert next(line for line in text.splitlines() if line.startswith("| raises |")).endswith("| 6, 2 failed |")


def test_durations_are_apart_from_the_trials(done):
    table = pd.read_csv(done[0] / "timings.csv")
    rows = table[(table["method"] == "good") & (table["component"] == "estimator")].set_index("phase")
    assert rows.loc["first step", "calls"] == 8
    assert rows.loc["step", "calls"] == 80
    assert (rows["median_s"] <= rows["q95_s"] * 1.01).all()
    assert (rows["q95_s"] <= rows["largest_s"] * 1.01).all()
    np.testing.assert_allclose(table["q95_share_of_Ts"], table["q95_s"] / 0.5, rtol=1e-3)  # four digits are kept


def test_the_time_per_step_is_a_column_on_demand(done):
    """Of own and of built-in estimators, on the page; a file that is kept does not have it."""
    page = (done[0] / "report.html").read_text(encoding="utf-8")
    assert '<th scope="col" class="n more"><div>time per step</div></th>' in page
    assert "time per step" not in (done[0] / "tables" / "summary.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("method", ["KF", "good", "holds", "warns"])
@pytest.mark.long
def test_a_replay_is_bit_for_bit_as_stored(done, method):
    again = rmpc_bench.replay(done[0], 3, method)
    assert (again.status, again.stored_status, again.differing) == ("ok", "ok", {})
    assert again.metrics == again.stored
    assert len(again.signals["x"]) == 11
    assert len(again.signals["u"]) == 10


def test_the_trace_is_that_of_the_block(done):
    """x_hat of the metric: the mean square of the estimation error over k = 0..N-1."""
    again = rmpc_bench.replay(done[0], 6, "good")
    error = again.signals["x_hat"][:10] - again.signals["x"][:10]
    np.testing.assert_allclose(np.mean(error**2), again.metrics["estimation_mse"], rtol=1e-12)


def test_a_failed_run_fails_again_at_the_same_place(done):
    shown = show(done[0], "--run", "5", "--method", "raises")
    assert shown.exit_code == 0
    assert "run 5 of raises: crashed" in shown.stdout
    assert "estimator at k = 4, t = 2 s: ValueError: negative level -1.0" in shown.stdout
    assert "as stored: crashed" in shown.stdout


def test_the_first_samples_are_those_of_the_whole_run(done):
    """Trap: a part without the input of its last sample does not reach the failure of a controller there."""
    whole = rmpc_bench.replay(done[0], 1, "good").signals
    part = rmpc_bench.replay(done[0], 1, "good", until=4)
    assert part.metrics == {}
    for name in ("x", "x_hat", "u"):
        assert np.array_equal(part.signals[name], whole[name][:5])


def test_a_difference_is_found(done, tmp_path):
    """The stored value is changed behind its back."""
    copy = tmp_path / "copy"
    shutil.copytree(done[0], copy)
    change(copy, "metric", lambda values: values + 1e-9)
    shown = show(copy, "--run", "0", "--method", "good")
    assert shown.exit_code == 1
    assert "differs: estimation_mse is " in shown.stdout


@pytest.mark.parametrize("ending", ["csv", "npz", "mat"])
@pytest.mark.long
def test_exports_have_the_trace(done, tmp_path, ending):
    file = tmp_path / f"trace.{ending}"
    assert show(done[0], "--run", "1", "--method", "good", "--export", str(file)).exit_code == 0
    x_hat = rmpc_bench.replay(done[0], 1, "good").signals["x_hat"][:, 0]
    if ending == "csv":
        table = pd.read_csv(file, dtype=str).astype(float)
        assert list(table.columns[:2]) == ["k", "t"]
        assert np.array_equal(table["x_hat"], x_hat)
        assert np.isnan(table["u"].iloc[-1])
    else:
        with np.load(file) if ending == "npz" else nullcontext(loadmat(file)) as arrays:
            assert np.array_equal(np.ravel(arrays["x_hat"]), x_hat)


def test_the_picture_is_drawn(done, tmp_path):
    assert show(done[0], "--run", "1", "--method", "good", "--plot", str(tmp_path / "a.svg")).exit_code == 0
    assert "x_hat" in (tmp_path / "a.svg").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--run", "8", "--method", "good"], "there is no run 8; they count from 0 to 7"),
        (["--run", "1", "--method", "god"], "'god' is not a known method; did you mean 'good'?"),
        (["--run", "1", "--method", "good", "--until", "11"], "there is no sample 11; they count from 0 to 10"),
        (["--run", "1", "--method", "good", "--at", "a=1"], "'a' is not a known path of the sweep"),
        (["--run", "1", "--method", "good", "--at", "a"], "expected PATH=VALUE"),
        (["--run", "1", "--method", "good", "--export", "a.txt"], "the ending must be one of .csv, .npz, .mat"),
    ],
)
def test_a_wrong_option_is_explained(done, arguments, text):
    shown = show(done[0], *arguments)
    assert shown.exit_code == 2
    assert text in shown.stderr


@pytest.mark.parametrize(
    ("arguments", "typed", "expected"),
    [
        (["--run", "2", "--method", "raises"], "p level\nq\n", ["-1.0", "run 2 of raises: crashed"]),
        (["--run", "1", "--method", "good", "--until", "3"], "p k, run\nq\n", ["(3, 1)"]),
        (["--run", "1", "--method", "good", "--until", "3"], "c\n", ["run 1 of good: ok"]),
    ],
)
@pytest.mark.long
def test_the_debugger_stops_in_the_users_frame(done, arguments, typed, expected):
    command = [sys.executable, "-m", "rmpc_bench", "show", str(done[0]), *arguments, "--pdb"]
    shown = subprocess.run(command, input=typed, capture_output=True, text=True)
    assert shown.returncode == 0, shown.stderr
    for text in [*expected, "mine.py"]:
        assert text in shown.stdout
    assert "Traceback" not in shown.stderr


def test_a_directory_without_an_experiment_is_refused(tmp_path):
    shown = show(tmp_path, "--run", "0", "--method", "good")
    assert shown.exit_code == 2
    assert "there is no experiment; fill the directory with `rmpc-bench run`" in shown.stderr
