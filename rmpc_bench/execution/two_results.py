"""Functions of the results of two directories: what differs, and how much the improvement of a method differs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from rmpc_bench.analysis.comparison import comparisons, levels
from rmpc_bench.analysis.improvement_difference import improvement_differences
from rmpc_bench.analysis.result_rows import result_table
from rmpc_bench.analysis.statistics import summary
from rmpc_bench.analysis.trial_differences import common_points, trial_differences
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.execution.evaluation import judge
from rmpc_bench.execution.results import Results
from rmpc_bench.execution.setting_differences import setting_differences
from rmpc_bench.report.results_text import Beside, FindingDifference, ImprovementComparison, ResultsComparison, Setting
from rmpc_bench.types import DesignError, MetricInfo
from rmpc_bench.types.errors import unknown


def compare_results(a: Results, b: Results, *, tolerance: float = 0.0) -> ResultsComparison:
    """Compare the trials of two directories, paired by point of the sweep, method and run.

    Parameters
    ----------
    a, b : from `run` or `load_results`
    tolerance : largest relative difference of values that count as equal, such as 1e-9

    Returns
    -------
    what only one of them has, statuses and metrics that differ, settings and findings; `equal` says whether any trial
    or finding differs, and the text names them

    Raises
    ------
    DesignError
        If the tolerance is negative.

    Examples
    --------
    >>> import rmpc_bench, tempfile
    >>> config = rmpc_bench.load_config("configs/quickstart.yaml", runs=4)
    >>> a, b = (rmpc_bench.run(config, directory=tempfile.mkdtemp(), jobs=1) for _ in range(2))
    >>> compare_results(a, b).equal
    True
    """
    if not tolerance >= 0:
        raise DesignError(f"must be at least 0 (got {tolerance:g})", "tolerance")
    return ResultsComparison(
        names=_names(a, b),
        sizes=(_size(a), _size(b)),
        settings=tuple(setting_differences(a, b)),
        trials=trial_differences(a.stored, b.stored, tolerance),
        findings=tuple(_finding_differences(a, b)),
        beside=tuple(_beside(a, b)),
    )


def _beside(a: Results, b: Results) -> Iterator[Beside]:
    """Yield the methods of both with their verdicts, where metric and baseline are the same."""
    name = a.experiment.primary
    try:
        info = _common_metric(a, b, name)
    except DesignError:
        return
    if a.experiment.baseline != b.experiment.baseline or _key_of(a, name) != _key_of(b, name):
        return
    of = [levels(each.trials) for each in (a, b)]
    for pair in common_points(a.trials, b.trials):
        made = [
            result_table(table, summary(table), comparisons(table, level), info)
            for table, level in zip(pair, of, strict=True)
        ]
        for row in made[0].rows:
            other = next((each for each in made[1].rows if each.method == row.method), None)
            if row.compared and other is not None and other.compared:
                paired = pair[0].seed == pair[1].seed
                found = improvement_differences([pair], row.method, info, paired=paired, is_primary=False)
                yield Beside((made[0], made[1]), (row, other), found[0])


def compare_improvements(
    a: Results, b: Results, method: str, *, metric: str | None = None, confidence: float | None = None
) -> ImprovementComparison:
    """Compare how much a method improves on its baseline in two experiments.

    Runs are paired by their index where both experiments have the same seed, since random inputs of a run depend on
    the seed, the run and the name of the quantity only: with +-40 % and +-80 % a run has the same quantile of each law.

    Parameters
    ----------
    a, b : from `run` or `load_results`
    method : name of the method, in both
    metric : name of the metric; the primary one of `a` unless given, which has a verdict
    confidence : level of the intervals, such as 0.95; that of `a` unless given

    Returns
    -------
    one record per common point of the sweeps, with a sentence each

    Raises
    ------
    DesignError
        If the method or the metric is unknown, the baselines differ, or the metric has another unit or direction.

    Examples
    --------
    >>> import rmpc_bench, tempfile
    >>> path = "configs/quickstart.yaml"
    >>> configs = [rmpc_bench.load_config(path, runs=8), rmpc_bench.load_config(path, runs=8, overrides=["seed=3"])]
    >>> a, b = (rmpc_bench.run(config, directory=tempfile.mkdtemp(), jobs=1) for config in configs)
    >>> [row.paired for row in compare_improvements(a, b, "R-MPC").rows]
    [False]
    """
    if confidence is not None and not 0 < confidence < 1:
        raise DesignError(f"must lie between 0 and 1 (got {confidence:g})", "confidence")
    name = a.experiment.primary if metric is None else metric
    info = _common_metric(a, b, name)
    _check_methods(a, b, method)
    points = common_points(a.trials, b.trials)
    if not points:
        raise DesignError("the two experiments have no point of a sweep in common", "sweep")
    if confidence is not None:
        points = [(replace(one, confidence=confidence), other) for one, other in points]
    points = [pair for pair in points if all({method, table.baseline} <= {*table.methods} for table in pair)]
    if not points:
        raise DesignError(f"no trial of {method} and its baseline is stored at a common point", "method")
    paired = all(one.seed == other.seed for one, other in points)
    has_verdict = all(each.experiment.primary == name and each.trials.with_verdicts for each in (a, b))
    return ImprovementComparison(
        rows=tuple(improvement_differences(points, method, info, paired=paired, is_primary=has_verdict)),
        info=info,
        names=_names(a, b),
        settings=tuple(_of_the_system(setting_differences(a, b), method, points[0][0])),
        tables=tuple(points),
        redefined=_key_of(a, name) != _key_of(b, name),
    )


def _of_the_system(settings: Sequence[Setting], method: str, table: Trials) -> list[Setting]:
    """Return the settings that may explain a difference: of the system, the method and its baseline."""
    skipped = ("experiment hash", "options", "runs", "versions.", "statistics.", "metrics.")
    others = tuple(f"methods.{name}." for name in table.methods if name not in (method, table.baseline))
    named = [each for each in settings if not each.path.startswith((*skipped, *others))]
    known = (f"methods.{method}.", f"methods.{table.baseline}.")
    return [each for each in named if not each.path.startswith("methods.") or each.path.startswith(known)]


def _key_of(results: Results, metric: str) -> str:
    return dict(results.experiment.points[0].metric_keys).get(metric, "")


def _names(a: Results, b: Results) -> tuple[str, str]:
    """Name the two experiments by their directories."""
    return str(a.directory), str(b.directory)


def _size(results: Results) -> str:
    trials = results.trials
    n_runs = max((len(table.runs) for table in trials.each), default=0)
    counts = [(n_runs, "run"), (len(trials.methods), "method"), (len(trials.metrics), "metric")]
    counts += [(len(trials.points), "point")] if trials.points else []
    texts = [f"{n} {noun}{'' if n == 1 else 's'}" for n, noun in counts]
    return f"{results.experiment.name}, {', '.join(texts)}, seed {trials.seed}"


def _common_metric(a: Results, b: Results, name: str) -> MetricInfo:
    found = []
    for results in (a, b):
        infos = {info.name: info for info in results.trials.metrics}
        if name not in infos:
            raise DesignError(f"{unknown(name, infos, 'metric')}, in {results.directory}", "metric")
        found.append(infos[name])
    one, other = found
    if (one.unit, one.direction) != (other.unit, other.direction):
        texts = [f"{info.unit or 'no unit'}, best: {info.direction}" for info in found]
        raise DesignError(f"{name} has another unit or direction in the two experiments ({'; '.join(texts)})", "metric")
    return one._replace(may_not_occur=one.may_not_occur or other.may_not_occur)


def _check_methods(a: Results, b: Results, method: str) -> None:
    for results in (a, b):
        known = results.experiment.methods
        if method not in known:
            raise DesignError(f"{unknown(method, known, 'method')}, in {results.directory}", "method")
    baselines = [results.experiment.baseline for results in (a, b)]
    if baselines[0] != baselines[1]:
        raise DesignError(f"improvements on different baselines: {baselines[0]} and {baselines[1]}", "baseline")
    if method == baselines[0]:
        raise DesignError(f"{method} is the baseline itself", "method")


def _finding_differences(a: Results, b: Results) -> list[FindingDifference]:
    """Compare the computed findings of the claims that both have, by their `id` or else by what they say."""
    one, other = ({(each.claim.name or each.claim.says): each for each in judge(results)} for results in (a, b))
    return [
        FindingDifference(name, str(verdict.finding), str(other[name].finding))
        for name, verdict in one.items()
        if name in other and verdict.finding != other[name].finding
    ]
