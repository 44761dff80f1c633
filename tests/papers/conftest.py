"""Trials of whole configurations, computed once for all tests."""

from pathlib import Path

import pytest
from missing_libraries import skip_without_libraries

from rmpc_bench import load_config, run

ROOT = Path(__file__).parents[2] / "configs"


@pytest.fixture(scope="session")
def trials_of(tmp_path_factory):
    """Return a function from the name of a configuration to its trials, which are computed once."""
    known = {}

    def trials(name):
        if name not in known:
            skip_without_libraries(ROOT / f"{name}.yaml")
            config = load_config(ROOT / f"{name}.yaml")
            known[name] = config, run(config, directory=tmp_path_factory.mktemp(name.replace("/", "-")), jobs=2).trials
        return known[name]

    return trials
