"""Ensemble moments as a table: bias and variance of the error at the end, beside the reported covariance."""

from __future__ import annotations

import numpy as np

from rmpc_bench.analysis.trials import Trials
from rmpc_bench.figures.labels import marked
from rmpc_bench.report.tables import markdown_table
from rmpc_bench.types import Array
from rmpc_bench.types.texts import inert_markdown


def ensemble_rows(trials: Trials) -> list[list[str]]:
    """Return a head and a row per method of one point; nothing where no moments were evaluated."""
    rows = [["error at the end", "bias x - x_hat", "variance", "mean square", "reported covariance", ""]]
    for method in trials.methods:
        mean, cov, P = (_last(trials, quantity, method) for quantity in ("mean(e)", "cov(e)", "P"))
        if mean is None or cov is None:
            continue
        variance = np.diagonal(cov)
        reported = "-" if P is None else _numbers(np.diagonal(P))
        square = f"{float(variance.sum() + mean @ mean):.4g}"
        n = trials.n_of("cov(e)", method)
        cells = [_numbers(np.where(np.abs(mean) < 1e-9 * np.sqrt(variance.max()), 0.0, mean)), _numbers(variance)]
        rows.append([marked(trials, method), *cells, square, reported, f"from {n} runs" if n else "exact"])
    return rows if len(rows) > 1 else []


def _last(trials: Trials, quantity: str, method: str) -> Array | None:
    try:
        last: Array = trials.matrix_series(quantity, method)[-1]
    except KeyError:
        return None
    return last


def _numbers(values: Array) -> str:
    return " ".join(f"{value:.4g}" for value in values)


def ensemble_markdown(trials: Trials) -> str:
    """Lay the table out as Markdown; empty where there is none."""
    rows = ensemble_rows(trials)
    if not rows:
        return ""
    title = f": {trials.title}" if trials.title else ""
    head = inert_markdown(f"## Ensemble of the error at the end{title}")
    table = markdown_table(dict(zip(rows[0], zip(*rows[1:], strict=True), strict=True)))
    return "\n".join([head, "", table, "", "Bias, variance and P by component.", ""])
