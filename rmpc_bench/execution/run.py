"""`rmpc_bench.run`: tune, compute what a directory lacks, load its results, and warn of runs that crashed."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, Literal

from rmpc_bench.components.transport import process_directory
from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.config.load import load_config
from rmpc_bench.engines.choice import ComputeOptions
from rmpc_bench.execution.progress import Called, Progress, choose
from rmpc_bench.execution.runner import compute
from rmpc_bench.execution.shards import n_cores, parse_shard
from rmpc_bench.execution.tuning.tune import tuned
from rmpc_bench.report.run_notes import crashed_runs, sections_of
from rmpc_bench.results.results import Results, load_experiment, read_results
from rmpc_bench.types.errors import DesignError, check_arguments, unknown


def run(
    config: ExperimentConfig | str | Path | Mapping[str, Any],
    *,
    directory: str | Path | None = None,
    jobs: int | Literal["auto"] | None = None,
    only: str | Collection[str] | None = None,
    progress: bool | Callable[[int, int, str], Any] | Progress | None = None,
    accept_versions: bool = False,
    engine: Literal["joblib", "serial", "dask"] | None = None,
    scheduler: str | None = None,
    shard: str | None = None,
    missing: bool = False,
) -> Results:
    """Compute the runs that are missing in a directory; the same call continues an interrupted one.

    Parameters that are to be tuned are chosen first, on runs of their own.  Runs in which a component raised an
    exception, held or failed steps and warnings of components are warnings (`RuntimeWarning`), each with its number.

    Parameters
    ----------
    config : from `load_config`, or what it takes
    directory : where trials.sqlite lies or will lie; unless given ``results/<paper>/<name>``, or for a mapping a
        temporary one, which this process keeps to its end
    jobs : most workers, ``"auto"`` or -1 for one per core; the configuration's `execution.workers` unless given
    only : name of the method to compute, or names; all unless given
    progress : True for a bar or lines, a function that is called as ``progress(done, total, text)``; messages only
        unless given
    accept_versions : whether stored rows are used that another version of a library has computed, one that a Python
        file of the user imports
    engine : ``joblib`` for all workers, ``serial`` for none: a component that ends its process then ends this one;
        unless given, this process is first where no component comes from a file or an installed package, and workers
        start where they save time; ``dask`` for the workers of a dask cluster
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
    DesignError
        If there is no such method, or an argument has no meaning.

    Examples
    --------
    >>> import rmpc_bench
    >>> results = rmpc_bench.run({"name": "small", "extends": "quickstart", "runs": 4})
    >>> len(results.trials.runs)
    4
    """
    check_arguments(run, locals())
    config = config if isinstance(config, ExperimentConfig) else load_config(config)
    if directory is None and config.content is not None:
        directory = _temporary() / config.full_hash[:16]
    how = ComputeOptions(_workers(jobs), engine, scheduler, accept_versions)
    only, progress = _methods(only, config), _display(progress)
    results = filled(config, directory, how, only=only, progress=progress, shard=shard, missing=missing)
    results = replace(results, directory=results.directory.absolute())
    for text in _remarks(results):
        warnings.warn(text, RuntimeWarning, stacklevel=2)
    return results


@cache
def _temporary() -> Path:
    return process_directory("rmpc-bench-results")


def filled(
    config: ExperimentConfig,
    directory: str | Path | None,
    how: ComputeOptions,
    *,
    only: Collection[str] | None = None,
    progress: Progress | None = None,
    shard: str | None = None,
    missing: bool = False,
) -> Results:
    """Do what `run` does, without warnings."""
    part = None if shard is None else parse_shard(shard)
    usual = Path("results") / (config.paper or "") / config.name
    place = usual if directory is None else Path(directory)
    if config.tuning is not None:
        config = tuned(config, place, shard=part, only=only, how=how, progress=progress)
    compute(config, place, how=how, only=only, progress=progress, shard=part, missing=missing)
    stop = load_experiment(place).stop if config.tuning is not None and config.stop is not None else None
    if stop is not None:
        tuned(config, place, only=only, how=how, progress=progress, n_runs=stop.looks.wanted)
    place = place if part is None else part.directory(place)
    own = {number: figure for number, figure in enumerate(config.figures) if not figure.is_built_in}
    return replace(read_results(place), components=own)


def _workers(jobs: int | Literal["auto"] | None) -> int | None:
    if jobs == "auto" or jobs == -1:
        return n_cores({})
    if jobs is not None and jobs < 1:
        raise DesignError(f"jobs: must be a whole number of 1 or more, or 'auto' (got {jobs!r})", "jobs")
    return jobs


def _methods(only: str | Collection[str] | None, config: ExperimentConfig) -> Collection[str] | None:
    """Return the names of methods to compute; None for all of them."""
    names = [only] if isinstance(only, str) else only
    for name in names or ():
        if name not in config.methods:
            raise DesignError(f"only: {unknown(name, config.methods, 'method')}", "only")
    return names


def _display(progress: bool | Callable[[int, int, str], Any] | Progress | None) -> Progress:
    if isinstance(progress, bool | None):
        return choose("auto") if progress else Progress()
    return Called(progress) if callable(progress) else progress


def _remarks(results: Results) -> Iterator[str]:
    """Say what no program should overlook, with the call that shows it."""
    directory = str(results.directory)
    for table in results.trials.each:
        at = f" at {table.title}" if table.title else ""
        for method, (runs, n, message) in crashed_runs(table).items():
            call = f"rmpc_bench.replay({directory!r}, {runs[0]}, {method!r})"
            yield f"{len(runs)} of {n} runs of {method!r}{at} crashed: {message}; {call} simulates run {runs[0]} again"
        sections = sections_of(table)
        for title in ("Held steps", "Failed steps", "Warnings of components"):
            yield from (f"{text}{at}" for text in sections[title])
