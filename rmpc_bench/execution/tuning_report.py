"""How the parameters of an experiment were chosen, as a table."""

from __future__ import annotations

from rmpc_bench.execution.results import Results
from rmpc_bench.report.tuning_table import TuningTable


def tuning(results: Results) -> TuningTable:
    """Return how the parameters were chosen, what that gains, and how far the ranks of tuned methods can be relied on.

    Parameters
    ----------
    results : from `run` or `load_results`

    Returns
    -------
    the table, with `frame`, `sentences`, `to_markdown()` and `to_screen()`; empty where no method is tuned

    Examples
    --------
    >>> import rmpc_bench, tempfile
    >>> directory = tempfile.mkdtemp()
    >>> changes = ["tune={budget: 3, runs: 2}", "methods.R-MPC.tune={estimator.c: [0.01, 1]}"]
    >>> config = rmpc_bench.load_config("configs/quickstart.yaml", runs=4, overrides=changes)
    >>> results = rmpc_bench.run(config, directory=directory, jobs=1, only=["S-MPC", "R-MPC"])
    >>> tuning(results).frame[["method", "parameter", "n_values", "n_runs"]].to_numpy().tolist()
    [['R-MPC', 'estimator.c', 3, 2]]
    """
    return TuningTable(results.trials, results.tuning)
