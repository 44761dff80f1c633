"""The work of a check and of a comparison grows with the number of methods, not with the square of it."""

import cProfile

import numpy as np
from comparison_tables import table
from small_experiment import write

from rmpc_bench.analysis.comparison import comparisons
from rmpc_bench.config.load import load_config


def n_calls(work, *arguments):
    """Count the function calls of some work, which do not depend on how fast this machine is."""
    profile = cProfile.Profile()
    profile.runcall(work, *arguments)
    return sum(entry.callcount for entry in profile.getstats())


def test_a_check(tmp_path):
    """Pairs of identical methods, whose labels show the value in which they differ from the others."""
    paths = []
    for n in (2, 40, 320):
        methods = ", ".join(f"m{i}: {{estimator: {{kind: robust-kalman, c: 0.1{i // 2:04}}}}}" for i in range(n))
        paths.append(write(tmp_path, file=f"{n}.yaml", methods=f"{{{methods}}}"))
    load_config(paths[0])  # what is found once in a process
    few, many = (n_calls(load_config, path) for path in paths[1:])
    assert many < 10 * few


def test_a_comparison():
    """Whether a metric has negative values is one question to the table, not one to every method."""
    rng = np.random.default_rng(3)
    tables = [table({f"m{i}": np.exp(rng.normal(size=10)) for i in range(n)}) for n in (50, 400)]
    comparisons(tables[0])
    few, many = (n_calls(comparisons, each) for each in tables)
    assert many < 10 * few
