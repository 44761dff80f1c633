"""The work of a check and of a comparison grows with the number of methods, not with the square of it."""

import cProfile

import numpy as np
import pytest
from comparison_tables import table
from small_experiment import write

from rmpc_bench.analysis.comparison import comparisons
from rmpc_bench.config.load import load_config
from rmpc_bench.types import ConfigError


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


def test_methods_without_a_controller(tmp_path):
    """Whether another method has one is one question to the configuration."""
    found = []
    for n in (2, 100, 800):
        methods = ", ".join(f"m{i}: {{}}" for i in range(n))
        path = write(tmp_path, file=f"{n}.yaml", methods=f"{{{methods}}}", controller=None)

        def refused(path=path):
            with pytest.raises(ConfigError):
                load_config(path)

        found.append(n_calls(refused))
    _, few, many = found
    assert many < 10 * few


def test_most_methods(tmp_path):
    """A check of each takes about a millisecond."""
    methods = ", ".join(f"m{i}: {{}}" for i in range(5001))
    with pytest.raises(ConfigError, match=r"methods: there must be at most 5,000 methods \(got 5,001\)"):
        load_config(write(tmp_path, methods=f"{{{methods}}}"))


def test_most_problems(tmp_path):
    """A terminal shows the first, and how many more there are."""
    keys = ", ".join(f"k{i}: 1" for i in range(70))
    with pytest.raises(ConfigError) as caught:
        load_config(write(tmp_path, plant=f"{{kind: servo, {keys}}}"))
    assert len(caught.value.problems) >= 70
    assert str(caught.value).splitlines()[50:] == [f".. and {len(caught.value.problems) - 50} more"]


def test_the_largest_file(tmp_path):
    """PyYAML reads about 1 MB in a second, and 100,000 numbers of 20 digits have room."""
    path = write(tmp_path)
    path.write_text("# " + "x" * 3_000_000 + "\n" + path.read_text())
    with pytest.raises(ConfigError, match="cannot be read: is larger than 3 MB"):
        load_config(path)
