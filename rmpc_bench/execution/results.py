"""The results of an experiment as one record, and the functions that return it: `run` and `load_results`."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import pandas as pd

from rmpc_bench.analysis.rounded_trials import rounded_trials
from rmpc_bench.analysis.trials import Traces, Trials
from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.config.load import load_config
from rmpc_bench.execution import manifest
from rmpc_bench.execution.database import FILE, MissingError
from rmpc_bench.execution.progress import Progress
from rmpc_bench.execution.runner import RESOLVED, compute
from rmpc_bench.execution.stored_trials import n_complete, other_code, stored_trials, uncertainty


@dataclass(frozen=True, eq=False)
class Results:
    """What an experiment has left in its directory, for tables, figures and claims.

    Parameters
    ----------
    config : the configuration
    directory : where the trials are stored
    trials : metrics and status of every run, series of the designs, recorded runs
    uncertainty : sweep columns, ``run`` and one column per named uncertain quantity
    n_complete : method -> number of runs that are stored with all metrics, at the point of the sweep with fewest
    overrides : options that changed the configuration, such as ``--smoke``; claims are then not evaluated
    other_code : stored rows of other code that are missing in the tables, in words; empty where there are none
    """

    config: ExperimentConfig
    directory: Path
    trials: Trials
    uncertainty: pd.DataFrame
    n_complete: Mapping[str, int]
    overrides: tuple[str, ...] = ()
    other_code: str = ""

    @property
    def series(self) -> pd.DataFrame:
        """Series of the designs and of the ensemble over time; see `Trials`."""
        return self.trials.series

    @property
    def traces(self) -> Mapping[str, Traces]:
        """Method -> its recorded runs; in a sweep each of `trials.points` has its own."""
        return self.trials.traces

    @cached_property
    def plotted(self) -> Trials:
        """The trials with six digits, from which figures are drawn, so that every CPU draws the same."""
        return rounded_trials(self.trials)

    @property
    def incomplete(self) -> tuple[str, ...]:
        """Methods of which runs are missing, each with their number."""
        n_runs = self.config.experiment.n_runs if "runs" in self.config.evaluate else 0
        return tuple(f"{name}: {n} of {n_runs} runs" for name, n in self.n_complete.items() if n < n_runs)

    @property
    def is_final(self) -> bool:
        """Whether these are the results of the configuration as its file states it, at full size."""
        return not (self.overrides or self.incomplete)


def default_directory(config: ExperimentConfig) -> Path:
    """Return ``results/<paper>/<name>``, or ``results/<name>`` without a paper."""
    return Path("results") / (config.paper or "") / config.name


def run(
    config: ExperimentConfig,
    *,
    directory: str | Path | None = None,
    jobs: int | None = None,
    only: Collection[str] | None = None,
    progress: Progress | None = None,
) -> Results:
    """Compute the runs that are missing in a directory; the same call continues an interrupted one.

    Parameters
    ----------
    config : from `load_config`
    directory : where trials.sqlite lies or will lie; ``results/<paper>/<name>`` unless given
    jobs : worker processes, 1 for none; the configuration's `execution.workers` unless given
    only : names of the methods to compute; all unless given
    progress : display; silent unless given

    Returns
    -------
    all that is stored for this configuration

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
    place = default_directory(config) if directory is None else Path(directory)
    compute(config, place, workers=jobs, only=only, progress=progress, modified=config.overrides)
    return stored_results(config, place, config.overrides)


def load_results(directory: str | Path) -> Results:
    """Load the results of a directory; nothing is simulated.

    Parameters
    ----------
    directory : where `run` or the command line has stored trials

    Returns
    -------
    the results, complete or not

    Raises
    ------
    MissingError
        If there is no store in the directory, or no trial in it.

    Examples
    --------
    >>> import rmpc_bench, tempfile
    >>> directory = tempfile.mkdtemp()
    >>> config = rmpc_bench.load_config("configs/quickstart.yaml", runs=4)
    >>> results = rmpc_bench.run(config, directory=directory, jobs=1)
    >>> rmpc_bench.load_results(directory).trials.frame.equals(results.trials.frame)
    True
    """
    place = Path(directory)
    if not (place / FILE).exists():
        raise MissingError(f"{place}: there is no {FILE}; fill the directory with `rmpc-bench run`")
    return stored_results(load_config(place / RESOLVED), place, manifest.read(place).get("modified", ()))


def load_trials(directory: str | Path) -> Trials:
    """Load the table of trials of a directory that `run` or the command line has filled.

    Raises
    ------
    MissingError
        If there is no store in the directory, or no trial in it.
    """
    return load_results(directory).trials


def stored_results(config: ExperimentConfig, directory: Path, overrides: Collection[str] = ()) -> Results:
    """Read the results of a configuration that lie in a directory.

    Parameters
    ----------
    config : the configuration
    directory : where its trials are stored
    overrides : options that changed the configuration

    Raises
    ------
    MissingError
        If there is no store, or nothing in it belongs to the configuration.
    StoreError
        If the directory holds another experiment.
    """
    return Results(
        config=config,
        directory=directory,
        trials=stored_trials(config, directory, with_verdicts="--smoke" not in overrides),
        uncertainty=uncertainty(config, directory),
        n_complete=n_complete(config, directory),
        overrides=tuple(overrides),
        other_code=other_code(config, directory),
    )
