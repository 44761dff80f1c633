"""Functions of results: summaries, comparisons and findings of claims, without simulation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rmpc_bench.analysis.trials import Trials
from rmpc_bench.claims import verdict
from rmpc_bench.claims.verdict import ClaimVerdict
from rmpc_bench.report import summary
from rmpc_bench.report.ranks_table import RanksTable, ranks_table
from rmpc_bench.report.run_tables import DriversTable, RequirementsTable, drivers_table, requirements_table
from rmpc_bench.report.summary import ComparisonTable, comparison_table
from rmpc_bench.results.results import Results, load_results
from rmpc_bench.types.errors import check_arguments


def summarise(results: Results | Trials | str | Path) -> summary.Summary:
    """Describe every method and compare it with the baseline, at every point of a sweep.

    Parameters
    ----------
    results : from `run` or `load_results`, their table of trials, or the directory of them

    Returns
    -------
    the tables `described` and `compared`, with `to_frame()`, `to_markdown()` and `to_latex()`

    Examples
    --------
    >>> import rmpc_bench
    >>> results = rmpc_bench.run({"name": "small", "extends": "quickstart", "runs": 4})
    >>> summarise(results).described["method"].unique().tolist()
    ['S-MPC', 'R-MPC', 'RS-MPC']
    """
    check_arguments(summarise, locals())
    return summary.summarise(_common(load_results(results) if isinstance(results, str | Path) else results))


def compare(
    results: Results,
    metric: str | None = None,
    *,
    methods: Sequence[str] | None = None,
    baseline: str | None = None,
    relevant: float | None = None,
    confidence: float | None = None,
) -> ComparisonTable:
    """Compare methods with a baseline run by run, at every point of a sweep.

    Parameters
    ----------
    results : from `run` or `load_results`
    metric : name of the metric; all unless given
    methods : names of the methods to compare; all unless given
    baseline : name of the method to compare with; that of the experiment unless given
    relevant : smallest relative change that matters, such as 0.01; that of the experiment unless given
    confidence : level of the intervals, such as 0.95; that of the experiment unless given

    Returns
    -------
    the table, with `to_frame()`, `to_markdown()`, `to_latex()`, `to_dict()` and a text of a sentence per comparison

    Raises
    ------
    DesignError
        If a metric or method is unknown, or a number is out of its range.

    Examples
    --------
    >>> import rmpc_bench
    >>> results = rmpc_bench.run({"name": "small", "extends": "quickstart", "runs": 4})
    >>> compare(results, "mse").to_frame()[["method", "baseline", "n_pairs"]].values.tolist()
    [['R-MPC', 'S-MPC', 4], ['RS-MPC', 'S-MPC', 4]]
    """
    check_arguments(compare, locals())
    return comparison_table(
        results.trials, metric=metric, methods=methods, baseline=baseline, relevant=relevant, confidence=confidence
    )


def drivers(results: Results | Trials) -> DriversTable:
    """Find which uncertain quantities explain the spread of the primary metric, and where each method does worst.

    Parameters
    ----------
    results : from `run` or `load_results`, or their table of trials

    Returns
    -------
    the table, with `frame` and `to_markdown()`

    Examples
    --------
    >>> import rmpc_bench
    >>> results = rmpc_bench.run({"name": "small", "extends": "quickstart", "runs": 4})
    >>> drivers(results).frame["resolved"].any().item()
    False
    """
    check_arguments(drivers, locals())
    return drivers_table(_common(results))


def requirements(results: Results | Trials) -> RequirementsTable:
    """Count the runs that meet the requirements of the configuration, per method and paired with the baseline.

    Parameters
    ----------
    results : from `run` or `load_results`, or their table of trials

    Returns
    -------
    the table, with `frame`, `sentences` and `to_markdown()`

    Examples
    --------
    >>> import rmpc_bench
    >>> keys = {"extends": "quickstart", "runs": 4, "statistics": {"requirement": "settling_time < 20"}}
    >>> results = rmpc_bench.run({"name": "required", **keys})
    >>> requirements(results).frame["n"].tolist()
    [4, 4, 4]
    """
    check_arguments(requirements, locals())
    return requirements_table(_common(results))


def ranks(results: Results | Trials) -> RanksTable:
    """Rank the methods over all points of the sweep, each rank as an interval, where `statistics.ranks` asks for it.

    Parameters
    ----------
    results : from `run` or `load_results`, or their table of trials

    Returns
    -------
    the table, with `frame`, `sentences`, `to_markdown()` and `to_screen()`; empty where ranks are not asked for

    Examples
    --------
    >>> import rmpc_bench
    >>> keys = {"extends": "quickstart", "runs": 4, "statistics": {"ranks": True}}
    >>> results = rmpc_bench.run({"name": "ranked", **keys})
    >>> sorted(ranks(results).columns["method"])
    ['R-MPC', 'RS-MPC', 'S-MPC']
    """
    check_arguments(ranks, locals())
    return ranks_table(_common(results))


def _common(results: Results | Trials) -> Trials:
    return results.common if isinstance(results, Trials) else results.trials


def judge(results: Results) -> tuple[ClaimVerdict, ...]:
    """Compute the finding of every claim of the configuration.

    A finding counts only where `results.is_final`; for an overridden or incomplete experiment it is information.

    Parameters
    ----------
    results : from `run` or `load_results`

    Returns
    -------
    one verdict per claim, in the order of the configuration

    Examples
    --------
    >>> import rmpc_bench, tempfile
    >>> config = rmpc_bench.load_config("zenere2018/fig7", runs=4)
    >>> results = rmpc_bench.run(config, directory=tempfile.mkdtemp(), only=["S-MPC", "R-MPC1"])
    >>> len(judge(results)) == len(config.claims)
    True
    """
    check_arguments(judge, locals())
    return tuple(verdict.judge(claim, results.trials) for claim in results.experiment.claims)
