"""Cells, columns and sentences of the tables of tuned parameters."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rmpc_bench.analysis.parameter_text import parameter_text
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.analysis.tuning import Outcome
from rmpc_bench.analysis.tuning_ranks import SETS, TuningRanks
from rmpc_bench.types.tuning import TunedParameter, TuningProtocol

EXPLANATION = (
    "Columns of objectives and of the share of failed runs: tuning is on the runs of the search, test on those of the "
    "experiment. "
    "A run whose metric is not finite counts as failed. Best: the smallest objective on the test runs among all "
    "values that were tried and the default. Regret: by how much the tuned value is worse than the best one. "
    "Rank: order of the objectives on the test runs; equal methods share a rank. In brackets: smallest and largest "
    f"rank over {SETS} bootstrap sets of the tuning runs, in each of which every method chooses again among the values "
    "that it has tried."
)


def number(value: float | None) -> str:
    """Write a parameter or an objective with four digits; ``-`` where it is not known."""
    return "-" if value is None or math.isnan(value) else f"{value:.4g}"


def percent(value: float) -> str:
    """Write a number in per cent with two digits, from 100 on without decimals; ``-`` where it is not known.

    Examples
    --------
    >>> percent(2.345), percent(0.0), percent(1234.5), percent(float("nan"))
    ('2.3 %', '0 %', '1234 %', '-')
    """
    if math.isnan(value):
        return "-"
    return f"{value:.2g} %" if abs(value) < 99.5 else f"{value:.0f} %"


def objective_text(protocol: TuningProtocol) -> str:
    """Say what the search makes small."""
    penalty = f" x (1 + {protocol.penalty:g} x share of failed runs)" if protocol.penalty else ""
    return f"{protocol.statistic} of {protocol.metric} over the finished runs{penalty}"


def range_text(parameter: TunedParameter) -> str:
    """Write the range of a parameter."""
    low, high = map(parameter.text, parameter.ends)
    whole = ", whole numbers" if parameter.integer else ""
    return f"{low} to {high}{whole}"


def short_text(found: Outcome) -> str:
    """Write a method with the last part of the name of every parameter and its value, in a few words."""
    search, row = found.search, found.search.tuned_row
    if row is None:
        return f"{search.method} nothing found"
    values = [
        f"{parameter.path.rpartition('.')[2]} {parameter.text(float(value))}{' (end of range)' if end else ''}"
        for parameter, value, end in zip(search.parameters, row, search.at_end, strict=True)
    ]
    return " ".join([search.method, *values])


def value_columns(found: Sequence[Outcome]) -> dict[str, list[str]]:
    """Return head -> cells of the table of values at one point of the sweep, a line per method and parameter."""
    columns: dict[str, list[str]] = {}
    for each in found:
        for place in range(len(each.search.parameters)):
            for head, cell in _cells(each, place).items():
                columns.setdefault(head, []).append(cell)
    if all(each.search.test is None for each in found):
        # Without runs of the experiment there is nothing to say about them.
        columns = {head: cells for head, cells in columns.items() if not head.startswith(("test", "best", "regret"))}
    return columns


def _cells(found: Outcome, place: int) -> dict[str, str]:
    search, parameter, row = found.search, found.search.parameters[place], found.search.tuned_row
    end = " (end of range)" if search.at_end[place] else ""
    return {
        "method": search.method,
        "parameter": parameter.path,
        "range": range_text(parameter),
        "default": _text(parameter, search.default[place]),
        "tuned": _text(parameter, None if row is None else float(row[place])) + end,
        "best on test": _text(parameter, found.best_values[place]),
        "tuning: tuned": number(found.objective),
        "test: default": number(found.test_default),
        "test: tuned": number(found.test_tuned),
        "test: best": number(found.test_best),
        "regret": percent(found.regret),
        "tuning: failed": percent(100 * found.failed),
        "test: failed": percent(100 * found.test_failed),
    }


def _text(parameter: TunedParameter, value: float | None) -> str:
    """Write a value of a parameter; ``-`` where it is not known."""
    return "-" if value is None else parameter.text(value)


def rank_text(ranks: TuningRanks, method: str, budget: int = -1) -> str:
    """Write a rank with its smallest and largest rank over the bootstrap sets, such as "2 (1 to 3)".

    The budget is an index among the budgets.
    """
    place = ranks.methods.index(method)
    ends = ranks.smallest[budget, place], ranks.largest[budget, place]
    return f"{ranks.ranks[budget, place]} ({ends[0]} to {ends[1]})"


def rank_columns(ranks: TuningRanks, trials: Trials) -> dict[str, list[str]]:
    """Return head -> cells of the table of ranks at one point of the sweep: every method after each budget.

    The trials say where parameters come from.
    """
    columns = {"method": [*ranks.methods]}
    words = [parameter_text(trials, name) for name in ranks.methods]
    columns |= {"parameters": [word or "-" for word in words]} if any(words) else {}
    for index, n in enumerate(ranks.budgets):
        columns[f"rank after {n} values"] = [rank_text(ranks, name, index) for name in ranks.methods]
    return columns


def rank_sentences(ranks: TuningRanks) -> list[str]:
    """Say how far the ranks at one point of the sweep depend on the tuning runs and on the budget."""
    order, winner = (f"{100 * share:.3g} %" for share in (ranks.same_order, ranks.same_winner))
    texts = [
        f"Other tuning runs: the order is the same in {order} of {SETS} bootstrap sets, the first rank in {winner}."
    ]
    if len(ranks.budgets) > 1:
        budgets = ", ".join(map(str, ranks.budgets))
        names = [f"{name} {', '.join(map(str, found))}" for name, found in ranks.changing.items()]
        texts.append(f"Ranks that change with the budget ({budgets} values): {'; '.join(names) or 'none'}.")
    return texts
