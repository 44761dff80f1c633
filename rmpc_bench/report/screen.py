"""The screen at the end of a run: what ran, the answer, the table or matrix, and a few notes."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from rmpc_bench.analysis.drivers import LITTLE, gist
from rmpc_bench.analysis.lost_runs import lost_runs
from rmpc_bench.analysis.result_rows import MARKS, MOST_UNSORTED, ResultTable, in_one_form, result_table
from rmpc_bench.analysis.shown_numbers import plain
from rmpc_bench.analysis.tuning import parameter_groups
from rmpc_bench.claims.claim import Finding
from rmpc_bench.report.answer import answer, finding_words
from rmpc_bench.report.run_notes import adjustment_text, counted, failed_runs, message_of, remark_lines, show_command
from rmpc_bench.report.run_tables import MOST_NAMED, worst_of
from rmpc_bench.report.screen_tables import moment_lines, ran_lines, rank_lines, row_lines, sweep_lines
from rmpc_bench.report.source import Evaluation
from rmpc_bench.report.two_way_table import TwoWayTable, two_way_lines, two_way_tables
from rmpc_bench.types.texts import command_lines, cut, width_of, without_formulas, wrapped

WIDTH = 80  # columns of the screen; fewer where a terminal has fewer
MOST_NOTES = 7  # lines below the table
MOST_LINES = 25  # lines of the screen of few methods and points; notes below a long matrix are fewer
# Notes in the order of their importance.
_FIRST = (
    "page differs failed note adjusted stop claims two-way tuned requirements calibration lost remarks worst driven"
).split()
_AVERAGES = {"geometric": "geometric mean", "mean": "ratio of the means"}
_PARAMETERS = {"default, not tuned": "default parameters", "as published, not tuned": "parameters of the paper"}
_WHOLE = ("failed", "worst", "page", "calibration")  # notes whose lines are not broken, such as a command or a path
_INTERVAL = re.compile(r"\[[^\[\] ]+, [^\[\] ]+\]")
_GLUE = "\x01"  # stands for a blank at which a line does not end


@dataclass(frozen=True, eq=False, kw_only=True)
class Screen(Evaluation):
    """What the screen at the end of a run is made of."""

    name: str  # of the experiment, with its paper
    metric: str  # that the table shows; the answer is that of the primary one
    page: Path
    stored: Path  # directory of the trials, as a command names it
    stop: str = ""  # what a stopping rule has decided

    @property
    def reasons(self) -> list[str]:
        """Why the findings do not count."""
        found = [f"the configuration was overridden ({', '.join(self.overrides)})"] if self.overrides else []
        return found + ([f"runs are missing ({', '.join(self.incomplete)})"] if self.incomplete else [])

    def text(self, width: int = WIDTH) -> str:
        """Lay out the screen for a terminal with some columns."""
        head, answered = self._head(width), plain(without_formulas(self._answer(), self.trials.methods))
        # Lines do not end within an interval or a name.
        answered = _INTERVAL.sub(lambda found: found[0].replace(" ", _GLUE), answered)
        for name in self.trials.methods:
            answered = answered.replace(name, name.replace(" ", _GLUE))
        said = [line.replace(_GLUE, " ") for line in wrapped(answered, width)]
        blank = [""] * (len(head) + len(said) < 5)
        tables = self._tables(self.metric)
        table = self._table(tables, width)
        above = [*head, *blank, *said, "", *table, ""]
        room = max(4, min(MOST_NOTES, MOST_LINES - len(above)))
        return "\n".join([*above, *self._notes(tables, table, room, width)])

    def _head(self, width: int) -> list[str]:
        k, what = len(self.extent.points), f"{self.extent.text}, {self.trials.n_failed_trials} failed"
        if not self.extent.planned:
            what = f"exact moments{f' at each of {k} points' if k > 1 else ''}, no runs"
        elif self.extent.is_unfinished:
            what = f"INTERRUPTED at {what}; run it again to go on"
        elif not self.trials.with_verdicts:
            what = f"smoke run: {what}"
        line = f"{self.name}   {what}"
        return [line] if width_of(line) <= width else [cut(self.name, width), *wrapped(what, width, " ", " ")]

    def _tables(self, metric: str) -> list[ResultTable]:
        infos = [info for info in self.trials.metrics if info.name == metric]
        return in_one_form([result_table(*point, info) for info in infos for point in self.tables.with_runs])

    def _crossed(self) -> list[TwoWayTable]:
        """Return the table of two axes of methods; none at the points of a sweep."""
        found = two_way_tables(self.trials) if not self.trials.points else ()
        return [table for table in found if table.info.name == self.metric]

    def _answer(self) -> str:
        primary = self.trials.primary_info
        tables = self._tables(primary.name if primary is not None else self.metric) or self._tables(self.metric)
        verdicts = () if self.reasons else self.verdicts
        return answer(tables, verdicts, unfinished=self.extent.is_unfinished, n_blank=len(self.extent.blank))

    def _table(self, tables: Sequence[ResultTable], width: int) -> list[str]:
        if not self.trials.with_verdicts:
            return ran_lines(self.trials, width)
        if self.ranks.found is not None:
            lines = rank_lines(self.ranks.found, self.trials, width)
        elif len(tables) > 1:
            lines = sweep_lines(tables, width)
        else:
            lines = row_lines(tables[0], width) if tables else []
        shows_moments = not lines or len(self.trials.methods) <= MOST_UNSORTED and not self.trials.points
        moments = moment_lines(self.trials, width) if shows_moments else []
        lines += [line for table in self._crossed() for line in two_way_lines(table, width)]
        return [*lines, *([""] if lines and moments else []), *moments]

    def _notes(self, tables: Sequence[ResultTable], table: Sequence[str], room: int, width: int) -> list[str]:
        """Choose the notes that fit, the most important ones first; they are shown in another order."""
        notes = {
            name: [f" {line}" for line in texts]
            if name in _WHOLE
            else [line for text in texts for line in wrapped(plain(text), width, " ", " ")]
            for name, texts in self._texts(tables, table, width)
            if texts
        }
        kept: set[str] = set()
        for name in _FIRST:
            if sum(len(notes[each]) for each in {*kept, name} & notes.keys()) <= room:
                kept.add(name)
        return [line for name, lines in notes.items() if name in kept for line in lines]

    def _texts(
        self, tables: Sequence[ResultTable], table: Sequence[str], width: int
    ) -> Iterator[tuple[str, list[str]]]:
        """Yield the notes in the order in which they are shown, each as its name and texts that begin a line."""
        if self.trials.with_verdicts and self.extent.planned:
            yield "note", [self._note(tables, table)]
            yield "adjusted", [*filter(None, [adjustment_text(tables)])]
        yield "stop", [f"stop: {self.stop}"] if self.stop else []
        if self.trials.with_verdicts:
            yield "two-way", [text for table in self._crossed() for text in table.sentences][:2]
            yield "tuned", [*filter(None, [self.tuning.gist])]
            yield "requirements", [*filter(None, [self.requirements.gist])]
            yield "calibration", self.calibration.lines(width)
            yield "lost", self._lost()
        yield "failed", self._failed(width)
        yield "worst", self._worst(tables, width)
        yield "claims", self._claims()
        yield "differs", [cut(text, width - 1) for text in self._differing()]
        yield "driven", self._driven()
        yield "remarks", [cut(text, 2 * width - 4) for text in remark_lines(self.trials)[:1]]
        yield "page", [str(self.page)]

    def _note(self, tables: Sequence[ResultTable], table: Sequence[str]) -> str:
        """Say what runs share, what the signs of the table are, and where parameters come from."""
        shown = "\n".join(table)
        compared = [row.compared for table in tables for row in table.rows if row.compared]
        parts = ["runs are not paired" if self.trials.unpaired else "same draws for all"] if compared else []
        if self.ranks.found is not None:
            parts = ["[ ]: simultaneous intervals of geometric means over all points"]
        elif len(tables) > 1:
            # The mark of a cell ends it; in a title the sign of equality has one blank behind it.
            ends = {
                mark for mark in map(plain, MARKS.values()) if re.search(rf" {re.escape(mark)}(?:  |$)", shown, re.M)
            }
            marks = ", ".join(f"{plain(mark)} {word}" for word, mark in MARKS.items() if plain(mark) in ends)
            parts = [f"{marks}; intervals: tables/summary.md".removeprefix("; ")]
        elif tables:
            simultaneous = any(float(row["ci_level"]) > self.trials.confidence for row in compared)
            level = f"{100 * self.trials.confidence:g} %"
            # A unit stands in brackets, too.
            signs = ["[ ]"] * bool(_INTERVAL.search(shown)) + ["\u00b1"] * ("\u00b1" in shown)
            which = {"[ ]": "simultaneous "} if simultaneous else {}
            said = [f"{sign}: {which.get(sign, '')}{level}" for sign in signs]
            apart = simultaneous or len(said) < 2
            parts += [", ".join(said) if apart else f"{' and '.join(signs)}: {level}"] if said else []
            parts += ["ties count half"] if tables[0].form == "share" else []
            parts += [f"change: {_AVERAGES[tables[0].average_key]}"] if tables[0].form == "ratio" else []
        parts += [] if self.trials.planned is None else [self.trials.planned.text]
        look = max((int(row["look"]) for row in compared), default=1)
        parts += [f"look {look} at a growing number of runs"] if look > 1 else []
        parts += ["failed runs are left out of means and changes"] if compared and self.trials.n_failed_trials else []
        groups = parameter_groups(self.trials, self.trials.methods)
        if len(groups) == 1:
            return "; ".join([*parts, *(_PARAMETERS.get(word, f"parameters: {word}") for word in groups)])
        origins = [f"{counted(len(names), 'method')} {word.partition(' (')[0]}" for word, names in groups.items()]
        return "; ".join([*parts, *([f"parameters: {'; '.join(origins)}"] if origins else [])])

    def _driven(self) -> list[str]:
        if len(self.drivers.points) != 1 or not self.trials.with_verdicts:
            return []
        text = gist(self.drivers.points[0][1], self.trials.baseline)
        what = "the change" if len(self.trials.methods) > 1 else f"the {self.tables.points[0].trials.metrics[0].words}"
        mostly = "mostly " * text.startswith("mostly ")
        found = f"{what} depends {mostly}on {text.removeprefix(mostly)}"
        return [found] if text not in ("", LITTLE) else []

    def _lost(self) -> list[str]:
        """Count the lost runs at the only point, where the configuration says what a lost run is."""
        info = self.trials.primary_info
        if self.trials.lost is None or self.trials.points or info is None:
            return []
        counts = [f"{row['n_lost']} ({row['method']})" for row in lost_runs(self.trials)]
        rule = f"failed, or {info.words} above {self.trials.lost:g} times that of {self.trials.baseline}"
        return [f"lost ({rule}): {', '.join(counts[:MOST_NAMED])}{': lost.csv' * (len(counts) > MOST_NAMED)}"]

    def _worst(self, tables: Sequence[ResultTable], width: int) -> list[str]:
        """Show the worst run: that of the baseline."""
        worst = worst_of(tables) if self.trials.with_verdicts else None
        if worst is None:
            return []
        command = worst.command(self.stored)
        line = f"worst run: {command}"
        return [line] if width_of(line) < width else ["worst run:", *command_lines(command, width - 1)]

    def _failed(self, width: int) -> list[str]:
        """Say which method fails most, why, and how its first failed run is computed again."""
        found = failed_runs(self.trials)
        if not found:
            return []
        counts = Counter(method for _, method, _ in found)
        [(method, n)] = counts.most_common(1)
        table, _, run = next(each for each in found if each[1] == method)
        message = Counter(filter(None, (message_of(t, m, k) for t, m, k in found if m == method))).most_common(1)
        why = f", '{message[0][0]}'" if message else ""
        more = f" (and {counted(len(counts) - 1, 'more method')}: failures/)" if len(counts) > 1 else ""
        text = f"failed: {method}, {counted(n, 'run')}{why}{more}; the first{'' if table.elsewhere else ' again'}:"
        command = show_command(table, self.stored, method, run)
        return [*wrapped(plain(cut(text, 2 * (width - 1))), width - 1), *command_lines(command, width - 1)]

    def _claims(self) -> list[str]:
        if not self.verdicts:
            return []
        why = self.reasons if self.trials.with_verdicts else ["a smoke run is too short"]
        if why:
            return [f"claims: not evaluated, {'; '.join(why)}"]
        found = [Counter(each.joined for each in self.verdicts if each.claim.of_paper == of) for of in (True, False)]
        if len(known := {*found[0], *found[1]} - {Finding.NOT_TESTABLE}) == 1:
            [finding] = known
            n, ours = found[0][finding], found[1][finding]
            texts = [f"{counted(n, 'statement')} of the paper"] * bool(n) + [f"{ours} additional"] * bool(ours)
            return [f"{finding_words(finding)}: {', '.join(texts)} (claims.md)"]
        parts = []
        for name, counts in zip(("statements of the paper", "additional"), found, strict=True):
            words = [f"{counts[each]} {finding_words(each)}" for each in Finding if counts[each]]
            parts += [f"{name}: {', '.join(words)}"] if words else []
        return [f"{'; '.join(parts)} (claims.md)"]

    def _differing(self) -> list[str]:
        if self.reasons or not self.trials.with_verdicts:
            return []
        found = [each for each in self.verdicts if each.differs]
        more = f" (and {len(found) - 1} more: claims.md)" if len(found) > 1 else ""
        words = [(finding_words(each.claim.finding or each.finding), finding_words(each.finding)) for each in found[:1]]
        return [f"recorded {before}, now {now}{more}: {found[0].claim.says}" for before, now in words]
