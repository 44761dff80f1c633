"""Sentences on tuning: what was chosen, ends of ranges, and how far ranks can be relied on."""

from __future__ import annotations

import math
from collections.abc import Iterator

from rmpc_bench.analysis.tuning import Outcome
from rmpc_bench.analysis.tuning_ranks import SETS, TuningRanks
from rmpc_bench.report.tuning_cells import number, percent, rank_text, value_text

EXPLANATION = (
    "Columns of objectives and of the share of failed runs: tuning is on the runs of the search, test on those of the "
    "experiment. "
    "A run whose metric is not finite counts as failed. Best: the smallest objective on the test runs among all "
    "values that were tried and the default. Regret: by how much the tuned value is worse than the best one. "
    "Rank: order of the objectives on the test runs; equal methods share a rank. In brackets: smallest and largest "
    f"rank over {SETS} bootstrap sets of the tuning runs, in each of which every method chooses again among the values "
    "that it has tried."
)


def search_sentence(found: Outcome) -> str:
    """Say what a search has chosen, what that changes on the runs of the experiment, and the regret."""
    search = found.search
    if search.chosen is None:
        why = f"none of {len(search.candidates)} values has a finite {search.protocol.metric} in a tuning run"
        return f"{search.method}: {value_text(found)}, as {why}."
    text = f"{search.method}: {value_text(found)}, chosen from {len(search.candidates)} values"
    if search.test is None:
        return f"{text}."
    parts = [f"objective {number(found.test_tuned)} on the test runs, {number(found.test_default)} with the default"]
    parts += [] if math.isnan(found.regret) else [f"regret {percent(found.regret)}"]
    failed = max(found.failed, found.test_failed)
    shares = f"failed runs: {percent(100 * found.failed)} in tuning, {percent(100 * found.test_failed)} in the test"
    return f"{text}: {', '.join(parts)}{f'; {shares}' if failed > 0 else ''}."


def end_sentences(found: Outcome) -> Iterator[str]:
    """Name the parameters whose tuned value is an end of the range."""
    search = found.search
    for place, parameter in enumerate(search.parameters):
        if search.at_end[place] and search.tuned_row is not None:
            value = float(search.tuned_row[place])
            end = "lower" if value == parameter.ends[0] else "upper"
            text = f"{search.method}: {parameter.path} = {parameter.text(value)} is the {end} end of its range"
            yield f"{text}; a better value may lie outside."


def rank_sentences(ranks: TuningRanks) -> list[str]:
    """Say how far the ranks at one point of the sweep depend on the tuning runs and on the budget."""
    order, winner = (f"{100 * share:.3g} %" for share in (ranks.same_order, ranks.same_winner))
    text = f"Other tuning runs: the order is the same in {order} of {SETS} bootstrap sets"
    texts = [f"{text}, the first rank in {winner}."]
    if ranks.can_change:
        names = [f"{name} {rank_text(ranks, name)}" for name in ranks.can_change]
        texts.append(f"With other tuning runs ranks can change: {', '.join(names)}.")
    return texts + _budget(ranks)


def _budget(ranks: TuningRanks) -> list[str]:
    budgets = [str(n) for n in ranks.budgets]
    if len(budgets) == 1:
        return []
    if not ranks.changing:
        text = f"No rank changes between {', '.join(budgets[:-1])} and {budgets[-1]} values"
        return [f"{text}; a larger budget can change ranks."]
    names = [f"{name} {', '.join(map(str, found))}" for name, found in ranks.changing.items()]
    text = f"Ranks change with the budget ({', '.join(budgets)} values): {'; '.join(names)}"
    return [f"{text}. A larger one can change them again."]
