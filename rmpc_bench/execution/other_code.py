"""Stored rows that other code has computed: they are kept apart under their own keys and enter no table."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from rmpc_bench.config.code_version import code_version
from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.execution.store import Store, StoredMethod


def rows_of_other_code(config: ExperimentConfig, store: Store, methods: Collection[str]) -> str:
    """Describe the rows that other code has computed and this code has not.

    Parameters
    ----------
    config : the experiment
    store : its open store
    methods : names of the methods to look at

    Returns
    -------
    such as ``800 rows of other code (NUMERICS 1, here 2) are kept apart``; empty where there are none
    """
    return rows_kept_apart(stored_methods(config, methods), store, config.experiment.n_runs)


def rows_kept_apart(methods: Iterable[StoredMethod], store: Store, n_runs: int) -> str:
    """Describe the rows of some methods that other code has computed and this code has not.

    Parameters
    ----------
    methods : what the trials of this code are stored under
    store : an open store
    n_runs : number of runs of the experiment
    """
    here, numbers, n_rows = code_version(), set[int](), 0
    for method in methods:
        runs = store.of_other_code(method, n_runs)
        numbers |= {code["numerics"] for codes in runs.values() for code in codes}
        n_rows += len(runs)
    there = ", ".join(map(str, sorted(numbers)))
    return f"{n_rows} rows of other code (NUMERICS {there}, here {here['numerics']}) are kept apart" if n_rows else ""


def stored_methods(config: ExperimentConfig, methods: Collection[str]) -> list[StoredMethod]:
    """Return what identifies the trials of some methods at all points of the sweep, each once."""
    found = {
        key: StoredMethod(key, point.definitions[name], point.code[name])
        for point in config.points
        for name, key in point.method_keys.items()
        if name in methods
    }
    return list(found.values()) if "runs" in config.evaluate else []
