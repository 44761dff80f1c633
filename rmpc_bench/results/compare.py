"""Two directories of results: what differs, and how much the improvement of a method differs; no code is loaded."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rmpc_bench.analysis.columns import rows_at
from rmpc_bench.analysis.comparison import comparisons, levels
from rmpc_bench.analysis.improvement_difference import improvement_differences
from rmpc_bench.analysis.result_rows import result_table
from rmpc_bench.analysis.statistics import summary
from rmpc_bench.analysis.trial_differences import common_points, trial_differences
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.report.results_text import Beside, ImprovementComparison, ResultsComparison, Setting
from rmpc_bench.results import manifest
from rmpc_bench.results.evaluate import judge
from rmpc_bench.results.results import Results, resolved_keys
from rmpc_bench.store.store import Store
from rmpc_bench.types import DesignError, MetricInfo
from rmpc_bench.types.errors import check_arguments, unknown

SECTIONS = ("methods", "metrics", "statistics")
"""Sections of the resolved configuration that the experiment hash does not cover."""

LONGEST = 80
"""Characters of a value that are shown."""

MISSING = "-"
"""What stands for a value that one of the two does not have."""


def setting_differences(a: Results, b: Results) -> list[Setting]:
    """Return the settings that differ: hash, seed, options, what all methods share, methods and metrics."""
    found = [
        Setting(name, *texts)
        for name, texts in {
            "experiment hash": (a.experiment.hash[:12], b.experiment.hash[:12]),
            "options": (" ".join(a.overrides) or MISSING, " ".join(b.overrides) or MISSING),
            "runs": (str(a.experiment.n_runs), str(b.experiment.n_runs)),
        }.items()
        if texts[0] != texts[1]
    ]
    for path in dict.fromkeys([*a.experiment.paths, *b.experiment.paths]):
        swept = [dict.fromkeys(point.coordinates.get(path, "") for point in each.experiment.points) for each in (a, b)]
        texts = (_text(", ".join(filter(None, values))) or MISSING for values in swept)
        found += [setting for setting in [Setting(f"sweep.{path}", *texts)] if setting.a != setting.b]
    shared = [{"sweep": {}, **_shared(each.directory)} for each in (a, b)]
    one, other = ({**each, "sweep": _common(each, shared, "sweep")} for each in shared)
    found += differing(one, other)
    resolved = _resolved(a.directory), _resolved(b.directory)
    if all(resolved):
        # What only one of them has is named among the trials.
        one, other = ({key: _common(each, resolved, key) for key in SECTIONS} for each in resolved)
        found += differing(one, other)
    else:
        found += _methods(a, b)
    versions = [manifest.read(each.directory).get("versions", {}) for each in (a, b)]
    return found + differing({"versions": versions[0]}, {"versions": versions[1]})


def differing(a: Any, b: Any, path: str = "") -> list[Setting]:
    """Compare two trees of plain data that stand at a path.

    Examples
    --------
    >>> differing({"seed": 1, "time": {"step": 0.1}}, {"seed": 2, "time": {"step": 0.1}})
    [Setting(path='seed', a='1', b='2')]
    >>> [text] = differing({"eps": {"low": -0.8, "high": 0.8}}, {"eps": {"low": -0.4, "high": 0.4}})
    >>> text
    Setting(path='eps', a='+-0.8', b='+-0.4')
    """
    return _ranges(list(_leaves(a, b, path)))


def _ranges(settings: Sequence[Setting]) -> list[Setting]:
    """Write both ends of a range as one setting, +-0.4 where they are symmetric about 0."""
    known = {each.path: each for each in settings}
    found = []
    for each in settings:
        stem, _, end = each.path.rpartition(".")
        low, high = known.get(f"{stem}.low"), known.get(f"{stem}.high")
        if end not in ("low", "high") or low is None or high is None or MISSING in (*low, *high):
            found.append(each)
        elif end == "low":
            found.append(Setting(stem, _range(low.a, high.a), _range(low.b, high.b)))
    return found


def _range(low: str, high: str) -> str:
    try:
        ends = float(low), float(high)
    except ValueError:
        return f"{low} to {high}"
    # Not in per cent: a quantity about 0 has its own unit, and may be no factor.
    return f"+-{high}" if ends[0] == -ends[1] else f"{low} to {high}"


def _leaves(a: Any, b: Any, path: str) -> Iterator[Setting]:
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        for key in dict.fromkeys([*a, *b]):
            where = f"{path}.{key}" if path else str(key)
            if key in a and key in b:
                yield from _leaves(a[key], b[key], where)
            else:
                yield Setting(where, *(_text(each[key]) if key in each else MISSING for each in (a, b)))
    elif a != b:
        yield Setting(path, _text(a), _text(b))


def _text(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value, sort_keys=True)
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."


def _shared(directory: Path) -> dict[str, Any]:
    with Store(directory, writable=False) as store:
        return store.data("shared")


def _resolved(directory: Path) -> dict[str, Any]:
    """Read sections of the resolved configuration; nothing where the file is missing."""
    tree = resolved_keys(directory)
    if not tree:
        return {}
    found = {key: tree[key] for key in SECTIONS if key in tree}
    metrics = found.get("metrics", [])
    found["metrics"] = {str(each.get("name", each.get("kind"))): each for each in metrics if isinstance(each, dict)}
    return found


def _common(tree: Mapping[str, Any], both: Sequence[Mapping[str, Any]], key: str) -> Any:
    """Return the entries of a section that both configurations have."""
    sections = [each[key] for each in both if isinstance(each.get(key), Mapping)]
    if key == "statistics" or len(sections) < len(both):
        return tree.get(key)
    return {name: value for name, value in tree[key].items() if all(name in each for each in sections)}


def _methods(a: Results, b: Results) -> Iterator[Setting]:
    """Compare the hashes of the methods at the first point."""
    first, second = a.experiment.points[0].methods, b.experiment.points[0].methods
    for name in (name for name in first if name in second and first[name].definition != second[name].definition):
        yield Setting(f"methods.{name}", first[name].definition[:12], second[name].definition[:12])


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
    check_arguments(compare_results, locals())
    if not tolerance >= 0:
        raise DesignError(f"must be at least 0 (got {tolerance:g})", "tolerance")
    return ResultsComparison(
        names=(str(a.directory), str(b.directory)),
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
                paired = _paired((a, b), pair)
                found = improvement_differences([pair], row.method, info, paired=paired, is_primary=False)
                yield Beside((made[0], made[1]), (row, other), found[0])


def compare_improvements(
    a: Results, b: Results, method: str, *, metric: str | None = None, confidence: float | None = None
) -> ImprovementComparison:
    """Compare how much a method improves on its baseline in two experiments.

    Runs are paired by their index where both experiments have the same seed, since random inputs of a run depend on
    the seed, the run and the name of the quantity only: with +-40 % and +-80 % a run has the same quantile of each law.
    Runs that were made elsewhere are paired where their names and all parameters agree.

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
    check_arguments(compare_improvements, locals())
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
    paired = all(_paired((a, b), pair) for pair in points)
    has_verdict = all(each.experiment.primary == name and each.trials.with_verdicts for each in (a, b))
    return ImprovementComparison(
        rows=tuple(improvement_differences(points, method, info, paired=paired, is_primary=has_verdict)),
        info=info,
        names=(str(a.directory), str(b.directory)),
        settings=tuple(_of_the_system(setting_differences(a, b), method, points[0][0])),
        tables=tuple(points),
        redefined=_key_of(a, name) != _key_of(b, name),
    )


def _paired(results: tuple[Results, Results], tables: tuple[Trials, Trials]) -> bool:
    """Whether run i of both has the same draws."""
    if any(each.unpaired for each in tables):
        return False
    made_elsewhere = [each.experiment.imported is not None for each in results]
    if not any(made_elsewhere):
        return tables[0].seed == tables[1].seed
    common = np.intersect1d(tables[0].runs, tables[1].runs)
    drawn = [rows_at(each.quantities, np.isin(each.quantities["run"], common)) for each in tables]
    names = [[each.run_names[run] if each.run_names else run for run in common.tolist()] for each in tables]
    same = names[0] == names[1] and {*drawn[0]} == {*drawn[1]}
    same = same and all(np.array_equal(cells, drawn[1][name], equal_nan=True) for name, cells in drawn[0].items())
    # A simulated run without named quantities may have had any draws.
    return same and (all(made_elsewhere) or len(drawn[0]) > 1)


def _of_the_system(settings: Sequence[Setting], method: str, table: Trials) -> list[Setting]:
    """Return the settings that may explain a difference: of the system, the method and its baseline."""
    skipped = ("experiment hash", "options", "runs", "versions.", "statistics.", "metrics.")
    others = tuple(f"methods.{name}." for name in table.methods if name not in (method, table.baseline))
    named = [each for each in settings if not each.path.startswith((*skipped, *others))]
    known = (f"methods.{method}.", f"methods.{table.baseline}.")
    return [each for each in named if not each.path.startswith("methods.") or each.path.startswith(known)]


def _key_of(results: Results, metric: str) -> str:
    return results.experiment.points[0].metric_keys.get(metric, "")


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


def _finding_differences(a: Results, b: Results) -> list[Setting]:
    """Compare the computed findings of the claims that both have, by their `id` or else by what they say."""
    one, other = ({(each.claim.name or each.claim.says): each for each in judge(results)} for results in (a, b))
    return [
        Setting(name, str(verdict.finding), str(other[name].finding))
        for name, verdict in one.items()
        if name in other and verdict.finding != other[name].finding
    ]
