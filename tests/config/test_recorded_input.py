"""The input from files: the input of run i is that of file i."""

import numpy as np
import pytest
from recorded_runs import SIMULATED, N, write

from rmpc_bench import load_config
from rmpc_bench.simulation.closed_loop import simulate_block
from rmpc_bench.types import ConfigError


@pytest.fixture
def directory(tmp_path):
    for i in range(4):
        rows = "\n".join(f"{0.1 * k:.1f},{i + 0.1 * k:.1f}" for k in range(N))
        (tmp_path / f"u-{i}.csv").write_text(f"time,voltage\n{rows}\n", encoding="utf-8")
    return tmp_path


def inputs_of(directory, section, runs, n=4):
    experiment = load_config(write(directory, SIMULATED, runs=n, more=f"input: {section}")).points[0].experiment
    return simulate_block(experiment, experiment.methods[0], runs).traces["u"][:, :, 0]


def problems(directory, section, **keys):
    with pytest.raises(ConfigError) as caught:
        load_config(write(directory, SIMULATED, more=f"input: {section}", **keys))
    return [str(problem) for problem in caught.value.problems]


def test_every_run_has_its_own_file_in_any_block(directory):
    """The naive version takes file 0 for the first run of every block."""
    section = "{file: 'u-*.csv', columns: voltage, t: time}"
    expected = np.arange(4)[:, None] + np.round(0.1 * np.arange(N), 1)
    np.testing.assert_array_equal(inputs_of(directory, section, range(4)), expected)
    np.testing.assert_array_equal(inputs_of(directory, section, range(2, 4)), expected[2:])


def test_one_file_holds_for_all_runs(directory):
    found = inputs_of(directory, "{file: u-2.csv, columns: voltage}", range(3), n=9)
    np.testing.assert_array_equal(found, np.tile(2.0 + np.round(0.1 * np.arange(N), 1), (3, 1)))


def test_the_content_of_the_file_counts(directory):
    path = write(directory, SIMULATED, more="input: {file: u-0.csv, columns: voltage}")
    before = load_config(path).hash
    file = directory / "u-0.csv"
    file.write_text(file.read_text(encoding="utf-8").replace("0.3,0.3", "0.3,9"), encoding="utf-8")
    assert load_config(path).hash != before


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ("{file: 'u-*.csv', columns: voltage}", "there are 5 runs, and `input.file` names 4 files"),
        ("{file: u-9.csv}", "there is no file u-9.csv; did you mean"),
        ("{file: u-0.csv, columns: volts}", "input.columns: u-0.csv: 'volts' is not a known column"),
        ("{file: u-0.csv, columns: [voltage, time]}", "names 2 columns of u-0.csv, and there are 1 inputs"),
        ("{file: u-0.csv, columns: voltage, resample: linear}", "needs the column of the time; give `t`"),
    ],
)
def test_what_does_not_fit_is_shown(directory, section, message):
    assert any(message in text for text in problems(directory, section)), problems(directory, section)
