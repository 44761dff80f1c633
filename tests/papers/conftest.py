"""Results of whole configurations, computed once for all tests."""

import shutil
from pathlib import Path

import pytest
from loaded_configs import loaded
from missing_libraries import skip_without_libraries

from rmpc_bench import run

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def results_of(tmp_path_factory):
    """Return a function from the name of a configuration to it and its results, which are computed once.

    A kept tuning.json is there from the beginning, as it is for `rmpc-bench run`.
    """
    known = {}

    def results(name):
        if name not in known:
            skip_without_libraries(ROOT / "configs" / f"{name}.yaml")
            config = loaded(name)
            directory = tmp_path_factory.mktemp(name.replace("/", "-"))
            if (tuned := ROOT / "results" / name / "tuning.json").exists():
                shutil.copy(tuned, directory)
            known[name] = config, run(config, directory=directory, jobs=2)
        return known[name]

    return results


@pytest.fixture(scope="session")
def trials_of(results_of):
    """Return a function from the name of a configuration to it and its trials."""

    def trials(name):
        config, results = results_of(name)
        return config, results.trials

    return trials
