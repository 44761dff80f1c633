"""How the parameters were chosen, as tables, sentences and the lines at the end of a run."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rmpc_bench.analysis.columns import Columns, columns_of
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.analysis.tuning import Outcome, outcome, parameter_text, tuning_rows
from rmpc_bench.analysis.tuning_ranks import SETS, TuningRanks, tuning_ranks, why_unranked
from rmpc_bench.report.point_tables import FrameTable, columns_from, markdown_page, markdown_table, rounded_columns
from rmpc_bench.report.run_notes import counted, percent
from rmpc_bench.types.tuning import Tuning

EXPLANATION = (
    "Columns of objectives and of the share of failed runs: tuning is on the runs of the search, test on those of the "
    "experiment. A run whose metric is not finite counts as failed. Best: the smallest objective on the test runs "
    "among all values that were tried and the default. Regret: by how much the tuned value is worse than the best one. "
    "Rank: order of the objectives on the test runs; equal methods share a rank. In brackets: smallest and largest "
    f"rank over {SETS} bootstrap sets of the tuning runs, in each of which every method chooses again among the values "
    "that it has tried."
)


def number(value: float | None) -> str:
    """Write a parameter or an objective with four digits; ``-`` where it is not known."""
    return "-" if value is None or math.isnan(value) else f"{value:.4g}"


def short_text(found: Outcome) -> str:
    """Write a method with the last part of the name of every parameter and its value, in a few words."""
    search, row = found.search, found.search.tuned_row
    if row is None:
        return f"{search.method} nothing found"
    values = [
        f"{parameter.path.rpartition('.')[2]} {parameter.text(float(value))}{' (end of range)' * end}"
        for parameter, value, end in zip(search.parameters, row, search.at_end, strict=True)
    ]
    return " ".join([search.method, *values])


def value_columns(found: Sequence[Outcome]) -> dict[str, list[str]]:
    """Return head -> cells of the table of values at one point of the sweep, a line per method and parameter."""
    columns = columns_from(_cells(each, place) for each in found for place in range(len(each.search.parameters)))
    # Without runs of the experiment there is nothing to say about them.
    hidden = ("test", "best", "regret") if all(each.search.test is None for each in found) else ()
    return {head: cells for head, cells in columns.items() if not head.startswith(hidden)}


def _cells(found: Outcome, place: int) -> dict[str, str]:
    search, parameter, row = found.search, found.search.parameters[place], found.search.tuned_row

    def text(value: float | None) -> str:
        return "-" if value is None else parameter.text(value)

    return {
        "method": search.method,
        "parameter": parameter.path,
        "range": " to ".join(map(parameter.text, parameter.ends)) + ", whole numbers" * parameter.integer,
        "default": text(search.default[place]),
        "tuned": text(None if row is None else float(row[place])) + " (end of range)" * search.at_end[place],
        "best on test": text(found.best_values[place]),
        "tuning: tuned": number(found.objective),
        "test: default": number(found.test_default),
        "test: tuned": number(found.test_tuned),
        "test: best": number(found.test_best),
        "regret": percent(found.regret),
        "tuning: failed": percent(100 * found.failed),
        "test: failed": percent(100 * found.test_failed),
    }


def rank_columns(ranks: TuningRanks, trials: Trials) -> dict[str, list[str]]:
    """Return head -> cells of the table of ranks at one point of the sweep: every method after each budget."""
    columns = {"method": [*ranks.methods]}
    words = [parameter_text(trials, name) or "-" for name in ranks.methods]
    columns |= {"parameters": words} if {*words} != {"-"} else {}
    for index, n in enumerate(ranks.budgets):
        found = zip(ranks.ranks[index], ranks.smallest[index], ranks.largest[index], strict=True)
        columns[f"rank after {n} values"] = [f"{rank} ({low} to {high})" for rank, low, high in found]
    return columns


MOST_NAMED = 3  # searches whose values the screen names
MOST_POINTS = 6  # points of a sweep that tables/tuning.md and the page show; tuning.csv has all
_SHARES = ["failed_pct", "test_failed_default_pct", "test_failed_pct", "regret_pct"]
_SHARES += ["same_order_pct", "same_winner_pct"]
_NUMBERS = ["objective", "test_default", "test_tuned", "test_best"]
_RANKS = ["rank", "rank_smallest", "rank_largest"]


@dataclass(frozen=True, eq=False, repr=False)
class TuningTable(FrameTable):
    """What tuning has chosen and gained, at every point of a sweep."""

    trials: Trials
    tuning: Tuning | None  # how the parameters were chosen; None where no method is tuned
    whole = _RANKS

    @cached_property
    def _every(self) -> list[Outcome]:
        """What all searches have found, point by point."""
        return [each for found in self.outcomes.values() for each in found]

    @cached_property
    def outcomes(self) -> dict[str, list[Outcome]]:
        """Title of a point -> what the searches there have found."""
        found: dict[str, list[Outcome]] = {}
        for search in self.tuning.searches if self.tuning else ():
            found.setdefault(search.point, []).append(outcome(search))
        return found

    @cached_property
    def _ranked(self) -> dict[str, TuningRanks | str]:
        """Title of a point -> ranks there, or why it has none."""
        tables, ranked = {table.title: table for table in self.trials.each}, dict[str, TuningRanks | str]()
        if self.tuning is None:
            return ranked
        protocol = self.tuning.protocol
        for title, found in self.outcomes.items():
            searches, table, others = [each.search for each in found], tables.get(title), {}
            if table is not None and protocol.metric in [info.name for info in table.metrics]:
                rest = [name for name in table.methods if name not in {search.method for search in searches}]
                others = {name: table.column(protocol.metric, name) for name in rest}
            why = why_unranked(searches, None if table is None else len(table.runs))
            ranks = None if why else tuning_ranks(protocol, searches, others, self.trials.all_methods)
            ranked[title] = (why or "every run of the experiment has failed") if ranks is None else ranks
        return ranked

    @cached_property
    def ranks(self) -> dict[str, TuningRanks]:
        """Title of a point -> ranks there; without the points that have none."""
        return {title: ranks for title, ranks in self._ranked.items() if not isinstance(ranks, str)}

    @cached_property
    def unranked(self) -> dict[str, str]:
        """Title of a point without ranks -> why it has none; nothing where there is one method only."""
        whys = {title: why for title, why in self._ranked.items() if isinstance(why, str)}
        return whys if len(self.trials.methods) > 1 else {}

    @property
    def content(self) -> Columns:
        """Content of tuning.csv: one row per point, method and parameter; empty where nothing is known."""
        # The record of a tuning may be missing, and a command may compute the other methods only.
        if self.tuning is None or not self.tuning.searches:
            return {}
        rows = [row | self._rank_row(str(row["point"]), str(row["method"])) for row in tuning_rows(self.tuning)]
        names = [name for name in rows[0] if name != "point" or any(row["point"] for row in rows)]
        return rounded_columns(rounded_columns(columns_of(rows, names), _NUMBERS), _SHARES, 100.0)

    def _rank_row(self, point: str, method: str) -> dict[str, object]:
        ranks = self.ranks.get(point)
        if ranks is None:
            return {**dict.fromkeys(_RANKS), "ranks": "", "same_order_pct": np.nan, "same_winner_pct": np.nan}
        place = ranks.methods.index(method)
        last = (int(each[-1, place]) for each in (ranks.ranks, ranks.smallest, ranks.largest))
        texts = [f"{n}: {rank}" for n, rank in zip(ranks.budgets, ranks.ranks[:, place], strict=True)]
        row: dict[str, object] = dict(zip(_RANKS, last, strict=True)) | {"ranks": ", ".join(texts)}
        return row | {"same_order_pct": 100 * ranks.same_order, "same_winner_pct": 100 * ranks.same_winner}

    @property
    def sentences(self) -> tuple[str, ...]:
        """Sentences that can be quoted: how far the ranks can be relied on, or why there are none."""
        found = [(title, text) for title in self.outcomes for text in self._sentences_at(title)]
        return tuple(f"{title}: {text}" if title else text for title, text in found)

    def _sentences_at(self, title: str) -> list[str]:
        if title not in self.ranks:
            return [f"No ranks: {self.unranked[title]}."] if title in self.unranked else []
        ranks = self.ranks[title]
        order, winner = (f"{100 * share:.3g} %" for share in (ranks.same_order, ranks.same_winner))
        same = f"the order is the same in {order} of {SETS} bootstrap sets, the first rank in {winner}"
        budgets = ", ".join(map(str, ranks.budgets))
        names = [f"{name} {', '.join(map(str, found))}" for name, found in ranks.changing.items()]
        changing = f"Ranks that change with the budget ({budgets} values): {'; '.join(names) or 'none'}."
        return [f"Other tuning runs: {same}.", *([changing] if len(ranks.budgets) > 1 else [])]

    @property
    def limitations(self) -> list[str]:
        """What the tuning of these methods leaves open; nothing where no method is tuned."""
        if self.tuning is None:
            return []
        names = [name for ranks in self.ranks.values() for name in (*ranks.can_change, *ranks.changing)]
        named = [
            ("Tuned values at the end of their range: {}; a better value may lie outside.", self._at_end),
            ("Nothing could be tuned, so the defaults stay: {}.", self._lost),
            ("Ranks that change with the tuning runs or with the budget: {}.", [*dict.fromkeys(names)]),
        ]
        texts = [text.format(", ".join(names)) for text, names in named if names]
        return [*texts, "A larger budget, more tuning runs or wider ranges may change the order of the methods."]

    @property
    def protocol(self) -> str:
        """The protocol in one sentence; empty where no method is tuned."""
        if self.tuning is None:
            return ""
        protocol = self.tuning.protocol
        penalty = f" x (1 + {protocol.penalty:g} x share of failed runs)" if protocol.penalty else ""
        return (
            f"{protocol.budget} values at most are tried for each method, each on {counted(protocol.runs, 'run')} "
            "whose random numbers the experiment does not use. "
            f"Objective: {protocol.statistic} of {protocol.metric} over the finished runs{penalty}."
        )

    @property
    def _at_end(self) -> list[str]:
        """Methods whose tuned values are at the end of their range."""
        return [*dict.fromkeys(each.search.method for each in self._every if any(each.search.at_end))]

    @property
    def _lost(self) -> list[str]:
        """Methods for which nothing was found."""
        return [*dict.fromkeys(each.search.method for each in self._every if each.search.chosen is None)]

    @property
    def cost(self) -> str:
        """Trials that tuning has computed, and their computing time where it is known; searches that are equal once."""
        searches = {each.search.key or id(each.search): each.search for each in self._every}
        sizes = [each.tuning.size + (0 if each.test is None else each.test.size) for each in searches.values()]
        seconds = sum(each.seconds for each in searches.values())
        return f"{sum(sizes):,} trials" + (f", {seconds:.0f} s of computing time" if seconds >= 0.5 else "")

    @property
    def tables(self) -> list[tuple[str, dict[str, list[str]], dict[str, list[str]], list[str]]]:
        """Title, table of values, table of ranks (empty without) and sentences of each point, `MOST_POINTS` at most."""
        of_ranks = {title: rank_columns(ranks, self.trials) for title, ranks in self.ranks.items()}
        return [
            (title, value_columns(found), of_ranks.get(title, {}), self._sentences_at(title))
            for title, found in [*self.outcomes.items()][:MOST_POINTS]
        ]

    @property
    def n_left(self) -> int:
        """Number of points that `tables` leaves out."""
        return max(0, len(self.outcomes) - MOST_POINTS)

    def to_markdown(self) -> str:
        """Return the tables and sentences of the points; empty where no method is tuned."""
        if not self.outcomes:
            return ""
        parts = [f"# {self.trials.name}: tuning", self.protocol]
        for title, values, ranks, sentences in self.tables:
            parts += [f"## {title}"] * bool(title) + [markdown_table(values)]
            parts += [markdown_table(ranks)] if ranks else []
            parts += ["\n".join(f"- {text}" for text in sentences)] if sentences else []
        parts += [f"{counted(self.n_left, 'more point')} of the sweep: tuning.csv"] if self.n_left else []
        return markdown_page([*parts, EXPLANATION])

    @property
    def gist(self) -> str:
        """What is tuned, to what values if these are few, and what that leaves open; empty where nothing is."""
        if self.tuning is None or not self.outcomes:
            return ""
        protocol = self.tuning.protocol
        size = f"budget {protocol.budget}, {protocol.runs} runs (tables/tuning.md)"
        size += f"; no ranks: {next(iter(self.unranked.values()))}" if self.unranked else ""
        if len(self._every) <= MOST_NAMED:
            return f"tuned: {', '.join(map(short_text, self._every))}; {size}"
        text = f"tuned: {counted(len({each.search.method for each in self._every} - {*self._lost}), 'method')}"
        text += f"; nothing found for {', '.join(self._lost)}" if self._lost else ""
        text += f"; at the end of its range: {', '.join(self._at_end)}" if self._at_end else ""
        return f"{text}; {size}"

    def __str__(self) -> str:
        return "\n".join(self.sentences)
