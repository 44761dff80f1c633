"""`rmpc_bench.run`: tune, compute what a directory lacks, and load its results."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import Literal

from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.execution.missing import ComputeOptions
from rmpc_bench.execution.progress import Progress
from rmpc_bench.execution.runner import compute
from rmpc_bench.execution.shards import parse_shard
from rmpc_bench.execution.tuning.tune import tuned
from rmpc_bench.results.results import Results, load_experiment, load_results


def run(
    config: ExperimentConfig,
    *,
    directory: str | Path | None = None,
    jobs: int | None = None,
    only: Collection[str] | None = None,
    progress: Progress | None = None,
    accept_versions: bool = False,
    engine: Literal["joblib", "serial", "dask"] | None = None,
    scheduler: str | None = None,
    shard: str | None = None,
    missing: bool = False,
) -> Results:
    """Compute the runs that are missing in a directory; the same call continues an interrupted one.

    Parameters that are to be tuned are chosen first, on runs of their own.

    Parameters
    ----------
    config : from `load_config`
    directory : where trials.sqlite lies or will lie; ``results/<paper>/<name>`` unless given
    jobs : worker processes; the configuration's `execution.workers` unless given
    only : names of the methods to compute; all unless given
    progress : display; silent unless given
    accept_versions : whether stored rows are used that another version of a library has computed, one that a Python
        file of the user imports
    engine : ``joblib`` for worker processes, ``serial`` for none: a component that ends its process then ends this one;
        unless given, one worker is this process where no component comes from a file or an installed package; ``dask``
        for the workers of a dask cluster
    scheduler : address of the scheduler of a dask cluster, such as ``tcp://node7:8786``
    shard : the part ``I/N`` of the runs, stored in ``shards/I-of-N`` of the directory; all runs unless given
    missing : whether the trials of all shards in the directory are taken before the rest is computed

    Returns
    -------
    all that is stored for this configuration, or for the shard

    Raises
    ------
    StoreError
        If the directory holds another experiment, or another process writes to it.
    WriteError
        If a block cannot be written.

    Examples
    --------
    >>> import rmpc_bench, tempfile
    >>> directory = tempfile.mkdtemp()
    >>> config = rmpc_bench.load_config("configs/quickstart.yaml", runs=4)
    >>> results = rmpc_bench.run(config, directory=directory, jobs=1)
    >>> len(results.trials.runs)
    4
    """
    part = None if shard is None else parse_shard(shard)
    usual = Path("results") / (config.paper or "") / config.name
    place = usual if directory is None else Path(directory)
    how = ComputeOptions(jobs, engine, scheduler, accept_versions)
    if config.tuning is not None:
        config = tuned(config, place, shard=part, only=only, how=how, progress=progress)
    compute(config, place, how=how, only=only, progress=progress, shard=part, missing=missing)
    stop = load_experiment(place).stop if config.tuning is not None and config.stop is not None else None
    if stop is not None:
        tuned(config, place, only=only, how=how, progress=progress, n_runs=stop.looks.wanted)
    place = place if part is None else part.directory(place)
    own = {number: figure for number, figure in enumerate(config.figures) if not figure.is_built_in}
    return replace(load_results(place), components=own)
