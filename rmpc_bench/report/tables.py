"""Tables of one experiment, or one point of a sweep: the Markdown page and the block at the end of the screen."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import pandas as pd

from rmpc_bench.analysis.statistics import decimals, format_with_error, sentence
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.figures.labels import marked
from rmpc_bench.types import MetricInfo, Status

GAPS = {"mean": 4, "median": 3, "change": 4, "won": 5, "n": 3, "verdict": 2}
"""Blanks before each column of the screen."""

BEST = {"zero": "best at 0", "one": "best at 1"}

AVERAGES = {"geometric": "geometric mean of the paired ratios", "mean": "ratio of the means"}

ENORMOUS = 1e6
"""Per cent beyond which a change is written with an exponent."""

NOISE = 1e-12
"""Relative errors below this one come from rounding: all runs are equal."""


class _Line(NamedTuple):
    """A method in the table of one metric, with its row of the summary and, but for the baseline, of comparisons."""

    method: str
    shown: str
    described: Mapping[str, Any]
    compared: Mapping[str, Any] | None


class _Table(NamedTuple):
    """What the tables of one metric need to know."""

    info: MetricInfo
    lines: list[_Line]
    may_not_occur: bool
    with_comparisons: bool
    with_failed: bool


def _table(trials: Trials, summary: pd.DataFrame, comparisons: pd.DataFrame, info: MetricInfo) -> _Table:
    described = {row["method"]: row for row in summary[summary["metric"] == info.name].to_dict("records")}
    compared = {row["method"]: row for row in comparisons[comparisons["metric"] == info.name].to_dict("records")}
    return _Table(
        info,
        [_Line(method, marked(trials, method), described[method], compared.get(method)) for method in trials.methods],
        info.may_not_occur or any(row["did_not_occur"] for row in described.values()),
        bool(compared),
        any(row["n_failed"] for row in described.values()),
    )


def screen(trials: Trials, summary: pd.DataFrame, comparisons: pd.DataFrame, metric: str) -> str:
    """Lay out one metric as the plain text shown at the end of a run.

    Parameters
    ----------
    trials : the table of trials
    summary, comparisons : the tables of `rmpc_bench.analysis.statistics`
    metric : name of the metric, the primary one as a rule

    Returns
    -------
    a header, a line per method and a legend, without a line end after the last; `n/n_failed` is there only where a
    run failed, and where an event does not occur in a run, the share of these runs stands in place of the mean
    """
    table = _table(trials, summary, comparisons, next(info for info in trials.metrics if info.name == metric))
    columns = {"name": [_quantity(table.info), *(line.shown for line in table.lines)]}
    # The heads of mean and change leave room for a sign.
    columns["mean"] = [
        " did not occur" if table.may_not_occur else " mean",
        *(_mean(line, table) for line in table.lines),
    ]
    columns["median"] = ["median [quartiles]", *(_quartiles(line.described) for line in table.lines)]
    if table.with_comparisons:
        columns["change"] = [f" change vs {trials.baseline}", *(_signed(_change(line)) for line in table.lines)]
        columns["won"] = ["runs won", *(_won(line) for line in table.lines)]
    if table.with_failed:
        columns["n"] = ["n/n_failed", *(_counts(line) for line in table.lines)]
    if table.with_comparisons:
        columns["verdict"] = ["", *(line.compared["verdict"] if line.compared else "" for line in table.lines)]
    rows = [""] * (len(table.lines) + 1)
    for name, cells in columns.items():
        width = max(len(cell) for cell in cells)
        rows = [row + " " * GAPS.get(name, 0) + cell.ljust(width) for row, cell in zip(rows, cells, strict=True)]
    return "\n".join([row.rstrip() for row in rows] + _legend(trials, table))


def summary_markdown(trials: Trials, summary: pd.DataFrame, comparisons: pd.DataFrame) -> str:
    """Write the page of tables: per metric a table and its sentences, then the failed runs.

    Parameters
    ----------
    trials : the table of trials
    summary, comparisons : the tables of `rmpc_bench.analysis.statistics`

    Returns
    -------
    Markdown, ending with a line end
    """
    runs, level = len(trials.runs), 100 * trials.confidence
    name = f"{trials.name}: {trials.title}" if trials.title else trials.name
    size = f"{_count(runs, 'run')} per method, seed {trials.seed}, intervals at {level:g} %."
    parts = [f"# {name}", f"One run of each method at each of {runs} points, all there are." if trials.alike else size]
    for info in trials.metrics:
        table = _table(trials, summary, comparisons, info)
        parts.append(f"## {_quantity(info)}, {BEST.get(info.direction, info.direction + ' is better')}")
        parts.append(markdown_table(_markdown_columns(trials, table)))
        parts += ["\n".join(_legend(trials, table))] if _legend(trials, table) else []
        rows = [line.compared for line in table.lines if line.compared]
        if rows:
            parts.append("\n".join(f"- {sentence(row, info, confidence=trials.confidence)}" for row in rows))
    if len(trials.methods) > 1:
        parts.append(explanation(trials))
    parts += _failures(trials)
    return "\n\n".join(parts) + "\n"


def _markdown_columns(trials: Trials, table: _Table) -> dict[str, list[str]]:
    lines = table.lines
    columns = {"method": [line.shown for line in lines]}
    labels = [trials.labels.get(line.method, line.method) for line in lines]
    if labels != columns["method"]:
        columns["label"] = labels
    columns["did not occur" if table.may_not_occur else "mean"] = [_mean(line, table) for line in lines]
    columns["median [quartiles]"] = [_quartiles(line.described) for line in lines]
    if table.with_comparisons:
        columns[f"change vs {trials.baseline}"] = [_change(line) for line in lines]
        columns["won/lost/tied"] = [_won_lost_tied(line.compared) for line in lines]
        columns["superiority"] = [_superiority(line.compared) for line in lines]
        columns["p"] = [(line.compared["p_wilcoxon_holm"] if line.compared else "") or "-" for line in lines]
        columns["verdict"] = [line.compared["verdict"] if line.compared else "-" for line in lines]
    columns["n/n_failed"] = [_counts(line) for line in lines]
    return columns


def markdown_table(columns: Mapping[str, Sequence[str]]) -> str:
    """Lay out columns, head -> cells, as a Markdown table without a line end."""
    rows = [list(columns), *([*row] for row in zip(*columns.values(), strict=True))]
    texts = ["| " + " | ".join(cell.replace("|", r"\|") for cell in row) + " |" for row in rows]
    return "\n".join([texts[0], "|" + " --- |" * len(columns), *texts[1:]])


def _legend(trials: Trials, table: _Table) -> list[str]:
    """Say what the brackets mean, with those of the first row that has any; no line where there is nothing to say."""
    parts = [f"paired runs, {100 * trials.confidence:g} %"] if table.with_comparisons else []
    if table.with_comparisons and table.info.direction in BEST:
        parts.append("compared by distance from 0" if table.info.direction == "zero" else "compared by |log|")
    if table.with_comparisons and trials.look > 1:
        parts.append(f"look {trials.look} at a growing number of runs, with wider intervals")
    means = [_mean(line, table) for line in table.lines]
    bracket = next((text[text.index("(") : text.index(")") + 1] for text in means if "(" in text), "")
    if bracket and not table.may_not_occur:
        parts.append(f"{bracket} = standard error of the last digits")
    if any(line.shown != line.method for line in table.lines):
        parts.append("an oracle knows the true parameters")
    if any(line.compared["tied"] for line in table.lines if line.compared):
        parts.append(f"within {100 * trials.relevant:g} % is tied, not won")
    return ["; ".join(parts)] if parts else []


def explanation(trials: Trials) -> str:
    """Say how the columns of a comparison are computed."""
    return (
        f"Runs are paired with those of {trials.baseline}; a failed run is worse than any finished one. Change: the "
        f"average is the {AVERAGES[trials.headline]}. Tied: within {100 * trials.relevant:g} %. Superiority: share of "
        "the runs in which the method is better, tied ones half. p: Wilcoxon signed-rank, after Holm. Verdicts: for "
        "the primary metric, from intervals that hold together for all methods and points."
    )


def _failures(trials: Trials) -> list[str]:
    """List the failed runs by method and status; nothing where all runs ended well."""
    failed = trials.frame.loc[trials.frame["status"] != Status.OK.word, ["method", "status"]]
    counts = failed.value_counts().to_dict()
    rows = []
    for method in trials.methods:
        for word in sorted({word for name, word in counts if name == method}):
            status = Status.__members__.get(word.upper().replace("-", "_"))
            meaning = f": {status.explanation}" if status is not None else ""
            rows.append(f"- {method}: {_count(counts[method, word], 'run')} {word}{meaning}")
    return ["## Failed runs", "\n".join(rows)] if rows else []


def _count(n: int, noun: str) -> str:
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def _quantity(info: MetricInfo) -> str:
    return f"{info.name} [{info.unit}]" if info.unit else info.name


def _mean(line: _Line, table: _Table) -> str:
    """Mean with its error, or the share of runs without the event."""
    row = line.described
    if not table.may_not_occur:
        mean, se = float(row["mean"]), float(row["se"])
        return format_with_error(mean, se if se > NOISE * abs(mean) else math.nan)
    return f"{row['did_not_occur']}/{row['n']} ({100 * row['did_not_occur'] / row['n']:.3g} %)" if row["n"] else "-"


def _quartiles(row: Mapping[str, Any]) -> str:
    """Median and quartiles, rounded to the power of ten that is nearest to the standard error of the median."""
    median, low, high, n = float(row["median"]), float(row["q25"]), float(row["q75"]), int(row["n"])
    if math.isnan(median):
        return "-"
    # In a Gaussian sample a quartile has the error 1.01 (high - low)/sqrt(n).  In a skewed one the tighter side, where
    # most values are, says how well the median is known; the other one may be infinite.
    sides = [side for side in (median - low, high - median) if math.isfinite(side) and side > 0]
    error = 2 * min(sides) / math.sqrt(n) if sides else 0.0
    texts = [_rounded(value, error, max(abs(median), abs(low))) for value in (median, low, high)]
    return f"{texts[0]} [{texts[1]}, {texts[2]}]"


def _rounded(value: float, error: float, scale: float) -> str:
    """Round a value; beyond 1e-4 and 1e6 with the exponent of `scale`."""
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    if not (math.isfinite(scale) and NOISE * scale < error < math.inf):
        return f"{value:.4g}"
    size = math.floor(math.log10(max(scale, error)))
    exponent = 0 if -4 <= size < 6 else size
    places = min(12, exponent + round(-math.log10(error)))
    mantissa = f"{round(value / 10.0**exponent, places):z.{max(places, 0)}f}"
    return f"{mantissa}e{exponent:+03d}" if exponent else mantissa


def _change(line: _Line) -> str:
    if line.compared is None or math.isnan(line.compared["change_pct"]):
        return "-"
    change, low, high = (float(line.compared[name]) for name in ("change_pct", "ci_low", "ci_high"))
    if math.isnan(low):
        return f"{change:+.3g} %"
    if abs(high) >= ENORMOUS:
        return f"{change:+.3g} % [{low:+.3g}, {high:+.3g}]"
    places = min(3, decimals((high - low) / 2))
    return f"{change:+z.{places}f} % [{low:+z.{places}f}, {high:+z.{places}f}]"


def _signed(text: str) -> str:
    """Let the sign of a number hang out on the left, so that digits stand below digits."""
    return text if len(text) > 1 else f" {text}"


def _won(line: _Line) -> str:
    return f"{line.compared['won']}/{line.compared['n_pairs']}" if line.compared else "-"


def _won_lost_tied(row: Mapping[str, Any] | None) -> str:
    return f"{row['won']}/{row['lost']}/{row['tied']}" if row else "-"


def _superiority(row: Mapping[str, Any] | None) -> str:
    if row is None or not row["n_pairs"]:
        return "-"
    share, low, high = float(row["superiority"]), 100 * row["superiority_low"], 100 * row["superiority_high"]
    places = decimals((high - low) / 2)
    return f"{100 * share:.{places}f} % [{low:.{places}f}, {high:.{places}f}]"


def _counts(line: _Line) -> str:
    return f"{line.described['n']}/{line.described['n_failed']}"
