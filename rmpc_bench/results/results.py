"""The results of an experiment as one record, read from its directory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rmpc_bench.analysis.columns import Columns, data_frame
from rmpc_bench.analysis.runs import Extent, PointExtent
from rmpc_bench.analysis.traces import Traces
from rmpc_bench.analysis.trial_arrays import rounded_trials
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.config.own_code import check_copies
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import load
from rmpc_bench.received.store import FILE, MissingError, decoded
from rmpc_bench.report.summary import ComparisonTable, comparison_table
from rmpc_bench.results.record import StoredExperiment, read_experiment
from rmpc_bench.results.tables import StoredTables, with_timings
from rmpc_bench.results.tuning import tuning_of
from rmpc_bench.store.store import Store
from rmpc_bench.types import ConfigError
from rmpc_bench.types.errors import check_arguments
from rmpc_bench.types.result_layout import RESOLVED
from rmpc_bench.types.tuning import Tuning

if TYPE_CHECKING:
    import pandas as pd

    from rmpc_bench.config_file.component import Component


@dataclass(frozen=True, eq=False, repr=False)
class Results:
    """What an experiment has left in its directory, for tables, figures and claims.

    Parameters
    ----------
    experiment : names, settings, figures and claims of the experiment, as they are stored beside its trials
    directory : where the trials are stored
    stored : metrics and status of every stored run, series of the designs, recorded runs
    quantities : sweep columns, ``run`` and one column per named uncertain quantity; `uncertainty` is a data frame of it
    n_complete : method -> number of runs that are stored with all metrics, at the point of the sweep with fewest
    durations : sweep columns, method, component, and quantiles of the durations of its calls [s]; `timings` is a data
        frame of it
    other_code : stored rows of other code that are missing in the tables, in words; empty where there are none
    tuning : how parameters were chosen, as far as it is recorded here; None where nothing is tuned
    components : own figures by their index among the figures, loaded by `run`; stored results have none

    Examples
    --------
    >>> import rmpc_bench
    >>> results = rmpc_bench.run({"name": "small", "extends": "quickstart", "runs": 4})
    >>> results.experiment.name, results.n_complete["R-MPC"], results.is_final
    ('small', 4, True)
    """

    experiment: StoredExperiment
    directory: Path
    stored: Trials
    quantities: Columns
    n_complete: Mapping[str, int]
    durations: Columns = field(default_factory=dict)
    other_code: str = ""
    tuning: Tuning | None = None
    components: Mapping[int, Component] = field(default_factory=dict)

    @property
    def trials(self) -> Trials:
        """The stored runs that every method has, finished or failed; tables, figures and claims rest on these."""
        return self.stored.common

    @cached_property
    def comparison(self) -> ComparisonTable:
        """The main table: every method against the baseline in the primary metric, at every point of a sweep."""
        return comparison_table(self.trials, metric=self.experiment.primary)

    def __repr__(self) -> str:
        runs, methods = len(self.trials.runs), len(self.trials.methods)
        return f"<Results of {self.experiment.name!r}: {runs} runs of {methods} methods, {self.directory}>"

    def _repr_html_(self) -> str:
        return self.comparison._repr_html_() if len(self.trials.runs) else escape(repr(self))

    @property
    def overrides(self) -> tuple[str, ...]:
        """Options that changed the configuration, such as ``--smoke``; claims are then not evaluated."""
        return self.experiment.overrides

    @cached_property
    def uncertainty(self) -> pd.DataFrame:
        """The named uncertain quantities of every stored run."""
        return data_frame(self.quantities)

    @cached_property
    def timings(self) -> pd.DataFrame:
        """How long the calls of components took."""
        return data_frame(self.durations)

    @property
    def series(self) -> pd.DataFrame:
        """Series of the designs and of the ensemble over time; see `Trials`."""
        return self.trials.series

    @property
    def traces(self) -> Mapping[str, Traces]:
        """Method -> its recorded runs, NaN after a failure; in a sweep each of `trials.points` has its own."""
        return self.trials.exported_traces()

    @cached_property
    def plotted(self) -> Trials:
        """The trials with six digits, from which figures are drawn, so that every CPU draws the same."""
        return rounded_trials(self.trials)

    @property
    def extent(self) -> Extent:
        """How many of the planned runs count at every point of the experiment, and which methods have none."""
        counted = {tuple(table.point.items()): table for table in self.trials.each}
        points = []
        for point in self.experiment.points:
            table = counted.get(tuple(point.coordinates.items()))
            n, there = (0, ()) if table is None else (len(table.runs), table.methods)
            absent = tuple(name for name in point.methods if name not in there)
            points.append(PointExtent(point.title, point.coordinates, n, absent))
        return Extent(self.experiment.n_wanted, points)

    @property
    def incomplete(self) -> tuple[str, ...]:
        """Methods of which runs are missing, each with their number, and a stopping rule that has not ended."""
        n_runs = self.experiment.n_wanted
        missing = tuple(f"{name}: {n} of {n_runs} runs" for name, n in self.n_complete.items() if n < n_runs)
        stop = self.experiment.stop
        return missing if stop is None or stop.is_over else (*missing, stop.text)

    @property
    def is_final(self) -> bool:
        """Whether these are the results of the configuration as its file states it, at full size."""
        return not (self.overrides or self.incomplete)


def load_results(directory: str | Path) -> Results:
    """Load the results of a directory; nothing is simulated, no design is made and no code of a user is loaded.

    Parameters
    ----------
    directory : where `run` or the command line has stored trials

    Returns
    -------
    the results, complete or not

    Raises
    ------
    MissingError
        If there is no store in the directory, no trial in it, or an earlier version has written it.
    StoreError
        If another process writes to it.

    Examples
    --------
    >>> import rmpc_bench
    >>> results = rmpc_bench.run({"name": "small", "extends": "quickstart", "runs": 4})
    >>> rmpc_bench.load_results(results.directory).trials.frame.equals(results.trials.frame)
    True
    """
    check_arguments(load_results, locals())
    return replace(read_results(directory), directory=Path(directory).absolute())


def read_results(directory: str | Path) -> Results:
    """Do what `load_results` does; the results name their directory as it is given."""
    place = _filled(directory)
    check_copies(place)
    with Store(place, writable=False) as store, decoded(place):
        experiment = read_experiment(store)
        tuning, tables = tuning_of(experiment, place), StoredTables(experiment, store)
        durations = tables.timings()
        return Results(
            experiment=experiment,
            directory=place,
            stored=with_timings(tables.trials().with_tuning(tuning), durations),
            quantities=tables.uncertainty(),
            n_complete=tables.n_complete(),
            durations=durations,
            other_code=tables.other_code,
            tuning=tuning,
        )


def load_experiment(directory: str | Path) -> StoredExperiment:
    """Load names and settings of a stored experiment, without its trials."""
    with Store(_filled(directory), writable=False) as store:
        return read_experiment(store)


def _filled(directory: str | Path) -> Path:
    place = Path(directory)
    if not (place / FILE).exists():
        raise MissingError(f"{place}: there is no {FILE}; fill the directory with `rmpc-bench run`")
    return place


def resolved_keys(directory: Path) -> dict[str, Any]:
    """Return the configuration with every default that a directory has; empty where it is not there.

    A symbolic link in a directory of somebody else could lead to a private file.
    """
    file = directory / RESOLVED
    try:
        found = {} if file.is_symlink() else plain(load(file))
        return found if isinstance(found, dict) else {}
    except (ConfigError, OSError):
        return {}


def load_trials(directory: str | Path) -> Trials:
    """Load the table of trials of a directory that `run` or the command line has filled.

    Raises
    ------
    MissingError
        If there is no store in the directory, or no trial in it.

    Examples
    --------
    >>> import rmpc_bench
    >>> results = rmpc_bench.run({"name": "small", "extends": "quickstart", "runs": 4})
    >>> rmpc_bench.load_trials(results.directory).methods
    ('S-MPC', 'R-MPC', 'RS-MPC')
    """
    return load_results(directory).trials
