"""The runs of a table: roles of its columns, numbers of the runs, statuses, metrics and parameters, all checked."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rmpc_bench.importing.roles import made_long, roles_of
from rmpc_bench.importing.settings import MetricKeys, Options, Settings
from rmpc_bench.received.names import METRIC, wrong_line, wrong_method
from rmpc_bench.received.run_table import DECIMAL_COMMA, MAX_NAMED, Table
from rmpc_bench.registry import unknown
from rmpc_bench.types import Array, ConfigError, MetricInfo, Problem, Status

MOST_POINTS, MOST_METHODS, MOST_METRICS = 1000, 200, 100
FINISHED = ("", "ok", "1", "true")
"""Statuses of a run that has ended well."""
FAILED = (Status.CRASHED.word, "0", "false")
"""Statuses of a run that has failed for no reason that is known."""
OK, CRASHED = int(Status.OK), int(Status.CRASHED)
NO_ROW = "the table has no row of this run"
MOSTLY = 0.8
"""Share of the runs from which on equal values of all methods are no accident."""


@dataclass
class Runs:
    """Checked runs; axis 0 of every array is the row, sorted by point, method and run.

    Parameters
    ----------
    methods : names, in the order of the settings, else as they appear
    infos : the metrics
    paths : the swept paths
    points : path -> text of its value, of every point
    names : original names of the runs, whole numbers or texts; None where the table has none
    point, method, run : place of each row in the three lists
    status, reason : number of its status, and its text where that is no word of the bench
    metrics, parameters : name -> values
    row : its place in the table, -1 where the table has no such row
    notes, warnings : what was ignored, and what is probably not meant
    """

    methods: list[str]
    infos: list[MetricInfo]
    paths: list[str]
    points: list[dict[str, str]]
    names: list[Any] | None
    point: Array
    method: Array
    run: Array
    status: Array
    reason: Array
    metrics: dict[str, Array]
    parameters: dict[str, Array]
    row: Array
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    ROWS = ("point", "method", "run", "status", "reason", "row")

    def taken(self, places: Array) -> None:
        """Keep some rows, in the given order."""
        for name in self.ROWS:
            setattr(self, name, getattr(self, name)[places])
        for columns in (self.metrics, self.parameters):
            columns |= {name: values[places] for name, values in columns.items()}

    @property
    def group(self) -> Array:
        """What rows of the same run at the same point have in common."""
        return self.point * (int(self.run.max(initial=0)) + 1) + self.run

    def named(self, run: int) -> str:
        """Return the original name of a run."""
        return str(run if self.names is None else self.names[run])


class Reader:
    """Makes runs of a table and collects its problems."""

    def __init__(self, table: Table, settings: Settings, options: Options) -> None:
        self.settings, self.options, self.problems = settings, options, list[Problem]()
        self.roles = roles_of(table, settings, options, self.problems)
        if options.wide and not self.problems:
            table = made_long(table, self.roles, settings, options.wide, self.problems)
        self._stop()
        self.table = table

    def _stop(self) -> None:
        """Raise all problems, where nothing more can be known."""
        if self.problems:
            raise ConfigError([*self.problems, *self.settings.draft.problems])

    def _note(self, places: Array, message: str | Callable[[int], str]) -> None:
        """Add a problem for some places of the table; a function gets the place."""
        if len(places):
            named = places[:MAX_NAMED].tolist()
            texts = [message if isinstance(message, str) else message(place) for place in named]
            self.problems += self.table.problems(places, texts)

    def runs(self) -> Runs:
        """Return the checked runs."""
        found = self._rows()
        self._keep_last(found)
        self._once(found)
        self._stop()
        values = self._sort_columns(found)
        self._check_values(found, values)
        self._complete(found, [*values])
        if not len(found.row):
            self.problems.append(self.table.problem("--missing drop leaves no run"))
            self._stop()
        found.parameters = self._parameters(found)
        used, run = np.unique(found.run, return_inverse=True)
        if len(used) <= int(found.run.max(initial=0)):
            found.names, found.run = [each if found.names is None else found.names[each] for each in used.tolist()], run
        return found

    def _rows(self) -> Runs:
        """Return points, methods, runs and statuses of all rows, without their numbers."""
        table, roles = self.table, self.roles
        method, methods = self._coded(table.texts(str(roles.method)), self.settings.given_methods)
        methods = self._method_names(methods, method)
        columns = [
            self._coded(table.texts(name), self.settings.grid.get(path)) for path, name in roles.named["sweep"].items()
        ]
        point, points = self._points(columns)
        run, names = self._runs(method, point)
        texts = np.full(len(table), "", dtype=object) if roles.status is None else table.texts(roles.status)
        status, words = self._coded(texts)
        numbers = [_status(word) for word in words]
        reasons = [
            "" if number != CRASHED or word.lower() in FAILED else word
            for number, word in zip(numbers, words, strict=True)
        ]
        return Runs(
            methods=methods, infos=[], paths=[*roles.named["sweep"]], points=points, names=names, point=point,
            method=method, run=run, status=np.array(numbers)[status], reason=np.array(reasons, dtype=object)[status],
            metrics={}, parameters={}, row=np.arange(len(table)),
        )  # fmt: skip

    def _coded(self, texts: Array, known: Sequence[str] | None = None) -> tuple[Array, list[str]]:
        """Return the place of every text in a list of different ones: known ones first, others as they appear."""
        import pandas as pd

        codes, found = pd.factorize(texts)
        order = [each for each in known or () if each in {*found}]
        order += [each for each in found if each not in {*order}]
        place = {text: number for number, text in enumerate(order)}
        return np.array([place[text] for text in found], dtype=np.int64)[codes], order

    def _method_names(self, names: list[str], codes: Array) -> list[str]:
        """Return the names of the methods; brackets and commas, which no method may have, are replaced."""
        made = [re.sub(r",\s*", " ", name.replace("[", "(").replace("]", ")")) for name in names]
        for number, (name, new) in enumerate(zip(names, made, strict=True)):
            if wrong := "a row has no method" if not name else wrong_method(new):
                (place,) = np.nonzero(codes == number)
                self._note(place, f"{wrong} (got {name[:60]!r})" if name else wrong)
            elif name != new:
                self.table.notes.append(f"method {name!r} is called {new!r} here")
        if len(names) > MOST_METHODS or len({*made}) < len(made):
            many = (
                f"{len(names):,} methods, at most {MOST_METHODS}"
                if len(names) > MOST_METHODS
                else "two methods get one name"
            )
            self.problems.append(self.table.problem(many))
        self._stop()
        return made

    def _points(self, columns: list[tuple[Array, list[str]]]) -> tuple[Array, list[dict[str, str]]]:
        """Return the point of every row, and the points in the order of their values."""
        paths, codes = [*self.roles.named["sweep"]], np.zeros(len(self.table), dtype=np.int64)
        for path, (places, texts) in zip(paths, columns, strict=True):
            if path in self.settings.grid:
                others = np.array([text not in self.settings.grid[path] for text in texts])
                self._note(np.flatnonzero(others[places]), f"{path} has a value that sweep.grid lacks")
            else:
                order = sorted(range(len(texts)), key=lambda n: _as_number(texts[n]))
                places, texts[:] = np.argsort(order)[places], [texts[n] for n in order]
            if any(wrong_line(text) or not text for text in texts):
                self.problems.append(self.table.problem(f"{path} is empty, or has invisible characters, in some rows"))
            if len(texts) > MOST_POINTS:
                self.problems.append(self.table.problem(f"{path} has {len(texts):,} values, at most {MOST_POINTS:,}"))
                self._stop()
            codes = codes * len(texts) + places
        values, point = np.unique(codes, return_inverse=True)
        points = []
        for value in values.tolist():
            texts_of = dict[str, str]()
            for path, (_, texts) in reversed([*zip(paths, columns, strict=True)]):
                value, place = divmod(value, len(texts))
                texts_of[path] = texts[place]
            points.append({path: texts_of[path] for path in paths})
        if len(points) > MOST_POINTS:
            self.problems.append(self.table.problem(f"{len(points):,} points of a sweep, at most {MOST_POINTS:,}"))
            self._stop()
        return point, points

    def _runs(self, method: Array, point: Array) -> tuple[Array, list[Any] | None]:
        """Return the number of the run of every row and the original names."""
        name = self.roles.run
        if name is None:
            import pandas as pd

            like = [each for each in self.table.columns if each.lower() in ("run", "seed", "trial", "repetition")]
            hint = f" (--columns run={like[0]} takes those of {like[0]!r})" if like else ""
            self.table.notes.append(f"no column 'run': the rows of a method are its runs in their order{hint}")
            return pd.Series(method).groupby([point, method]).cumcount().to_numpy(), None
        cells = self.table.columns[name]
        if cells.dtype.kind == "f" and np.isfinite(cells).all() and (cells == np.floor(cells)).all():
            cells = cells.astype(np.int64) if (np.abs(cells) < 2**53).all() else cells
        if cells.dtype.kind == "i":
            numbers, places = np.unique(cells, return_inverse=True)
            return places, numbers.tolist()
        texts = self.table.texts(name)
        codes, names = self._coded(texts)
        for number, text in enumerate(names):
            if (
                wrong := "a row has no run"
                if not text
                else wrong_line(text) or len(text) > 100 and "is longer than 100"
            ):
                self._note(np.flatnonzero(codes == number)[:1], f"the name of the run: {wrong}")
        return codes, names

    def _keep_last(self, found: Runs) -> None:
        """Keep the row of every run and method with the largest value of a column."""
        if self.roles.keep_last is None:
            return
        values, wrong = self.table.numbers(self.roles.keep_last)
        self._note(wrong, f"{self.roles.keep_last} is no number")
        order = np.lexsort((values, found.run, found.method, found.point))
        last = np.ones(len(order), dtype=bool)
        same = (found.group[order][1:] == found.group[order][:-1]) & (
            found.method[order][1:] == found.method[order][:-1]
        )
        last[:-1] = ~same
        found.taken(order[last])

    def _once(self, found: Runs) -> None:
        """Sort the rows by point, method and run, and report those of one run and method."""
        found.taken(np.lexsort((found.row, found.run, found.method, found.point)))
        group, method, row = found.group, found.method, found.row
        again = np.flatnonzero((group[1:] == group[:-1]) & (method[1:] == method[:-1])) + 1
        if len(again):
            first = self.table.lines(row[again[:MAX_NAMED] - 1])
            rows = zip(found.run[again].tolist(), method[again].tolist(), first, strict=False)
            texts = [
                f"run {found.named(run)} of {found.methods[each]} occurs twice (first in line {line})"
                for run, each, line in rows
            ]
            self.problems += self.table.problems(row[again], texts)

    def _sort_columns(self, found: Runs) -> dict[str, Array]:
        """Find metrics and parameters among the columns, and return the values of the metrics."""
        roles, named = self.roles, {each.name: each for each in self.settings.metrics}
        chosen = {**roles.named["metric"]}
        for name in named:
            if name not in chosen and name in self.table.columns and name not in roles.taken:
                chosen[name] = name
            elif name not in chosen:
                known = [each for each in self.table.columns if each not in roles.taken]
                self.problems.append(self.table.problem(f"metric {unknown(name, known, 'column')}", 1))
        free = [each for each in self.table.columns if each not in (*roles.taken, *chosen.values())]
        for name in free:
            if (kind := self._kind(found, name, any_metric=not named)) == "metric":
                chosen[name] = name
            elif kind == "parameter":
                roles.named["parameter"][name] = name
            elif not self.problems or kind:
                self.table.notes.append(f"column {name!r} is ignored{kind and ': ' + kind}")
        chosen = {name: chosen[name] for name in (named or chosen) if name in chosen}
        if not chosen:
            text = "no metric: no column has numbers that differ between the methods; --metric names one"
            text = "; ".join([text, *self.table.notes[:MAX_NAMED]])
            self.problems += [] if self.problems else [self.table.problem(text)]
            self._stop()
        if len(chosen) > MOST_METRICS:
            self.problems.append(
                self.table.problem(f"{len(chosen):,} metrics, at most {MOST_METRICS}; --metric names some")
            )
            self._stop()
        found.infos = [named.get(name, MetricKeys(name)).info for name in chosen]
        return {name: self._values(found, column, name) for name, column in chosen.items()}

    def _kind(self, found: Runs, name: str, *, any_metric: bool) -> str:
        """Return whether a column without a role is a metric or a parameter; else why it is ignored."""
        values, wrong = self.table.numbers(name)
        values, is_wrong = values[found.row], np.isin(found.row, wrong)
        commas = [DECIMAL_COMMA.fullmatch(text) is not None for text in self.table.texts(name)[wrong[:MAX_NAMED]]]
        if (
            np.isnan(values).all()
            and not (any(commas) and all(commas))
            or 2 * is_wrong.sum() > len(values)
            and not any(commas)
        ):
            return "its cells are texts" if len(wrong) else "it is empty"
        if not METRIC.fullmatch(name):
            return f"the name is none of a metric; --columns {shlex.quote(f'metric:NAME={name}')} takes it"
        if len(found.methods) == 1 or is_wrong.any():
            return "metric" if any_metric else "it is not named with --metric"
        low, high = ends_of(found.group, values)
        known = ~np.isnan(low)
        alike, continuous = float(np.mean((low == high)[known])), len(np.unique(low[known])) > 0.5 * known.sum()
        if alike == 1.0:
            return "parameter" if len(np.unique(low[known])) > 1 else "all its cells are equal"
        if alike >= MOSTLY and continuous and any_metric and known.sum() >= 5 and not self.options.unpaired:
            self._differing(found, name, values, f"; if it is a metric, --metric {name}")
            return ""
        return "metric" if any_metric else "it is not named with --metric"

    def _values(self, found: Runs, column: str, name: str) -> Array:
        """Return the numbers of a metric; a text in a run that ended well is a problem."""
        values, wrong = self.table.numbers(column)
        finished, texts = found.status == OK, self.table.texts(column)
        bad = found.row[np.isin(found.row, wrong) & finished]

        def message(place: int) -> str:
            text, of = texts[place], found.methods[found.method[found.row == place][0]]
            if DECIMAL_COMMA.fullmatch(text):
                return f"{name} is {text!r}: with decimal commas give --decimal , and --separator ';'"
            way = "a failed run has a status, a missing value is empty (--missing drop|failed)"
            return f"{name} of {of} is {text[:60]!r}, no number; {way}"

        self._note(np.sort(bad), message)
        # They have been reported, and are not empty.
        values[wrong] = 0.0
        return values[found.row]

    def _check_values(self, found: Runs, values: dict[str, Array]) -> None:
        """Refuse infinite values of events that always occur, and missing ones unless an option treats them."""
        finished, lacking = found.status == OK, np.zeros(len(found.row), dtype=bool)
        for info in found.infos:
            cells = values[info.name]
            infinite = np.isinf(cells) & finished & ~((cells > 0) & info.may_not_occur)

            def message(place: int, info: MetricInfo = info, cells: Array = cells) -> str:
                (row,) = np.nonzero(found.row == place)
                of = found.methods[found.method[row[0]]]
                way = f"metrics: [{{name: {info.name}, may_not_occur: true}}] says that the event did not occur"
                return f"{info.name} of {of} is {cells[row[0]]:g}: {way if cells[row[0]] > 0 else 'no number'}"

            self._note(np.sort(found.row[infinite]), message)
            lacking |= np.isnan(cells) & finished
            values[info.name] = np.where(finished, cells, np.nan)
        found.metrics = values
        if self.options.missing == "error":
            text = "a metric of a finished run is empty: --missing drop leaves the run out, --missing failed"
            text += " counts it as failed"
            self._note(np.sort(found.row[lacking]), text)
        elif self.options.missing == "failed":
            self._fail(found, lacking, "a metric is empty")
        elif lacking.any():
            self.table.notes.append(
                f"--missing drop: {len(np.unique(found.run[lacking]))} runs with an empty metric are left out"
            )
            found.taken(np.flatnonzero(~np.isin(found.run, found.run[lacking])))

    def _fail(self, found: Runs, places: Array, reason: str) -> None:
        found.status = np.where(places, CRASHED, found.status)
        found.reason = np.where(places, reason, found.reason)
        for cells in found.metrics.values():
            cells[places] = np.nan

    def _complete(self, found: Runs, metrics: Sequence[str]) -> None:
        """Treat runs that some method lacks at a point as the options say; all points have the same runs."""
        parts, left, runs = list[Array](), np.zeros(len(found.row), dtype=bool), np.unique(found.run)
        for number, point in enumerate(found.points):
            here = np.flatnonzero(found.point == number)
            for method in np.unique(found.method[here]).tolist():
                missing = np.setdiff1d(runs, found.run[here][found.method[here] == method])
                if not len(missing):
                    continue
                left |= np.isin(found.run, missing)
                parts.append(np.array([[number, method, run] for run in missing.tolist()]))
                self._missing(found, point, method, missing, len(runs))
        if not parts or self.options.missing == "error":
            return
        if self.options.missing == "drop":
            self.table.notes.append(
                f"--missing drop: {len(np.unique(found.run[left]))} runs are left out, which some method lacks"
            )
            found.taken(np.flatnonzero(~left))
            return
        added = np.concatenate(parts)
        for name, column in zip(("point", "method", "run"), added.T, strict=True):
            setattr(found, name, np.append(getattr(found, name), column))
        n = len(added)
        found.status, found.reason = np.append(found.status, [CRASHED] * n), np.append(found.reason, [NO_ROW] * n)
        found.row, nan = np.append(found.row, [-1] * n), np.full(n, np.nan)
        found.metrics = {name: np.append(found.metrics[name], nan) for name in metrics}
        found.taken(np.lexsort((found.run, found.method, found.point)))

    def _missing(self, found: Runs, point: Mapping[str, str], method: int, missing: Array, n: int) -> None:
        if self.options.missing != "error":
            return
        shown = ", ".join(found.named(run) for run in missing[:10].tolist()) + (", .." if len(missing) > 10 else "")
        at = "".join(f" at {path}={text}" for path, text in point.items())
        text = f"{len(missing)} of {n} runs have no row for {found.methods[method]}{at} ({shown}): --missing drop"
        text += f" compares the other {n - len(missing)}, --missing failed counts them as failed"
        text += "; number the runs alike at all points" * bool(point)
        self.problems.append(self.table.problem(text))

    def _parameters(self, found: Runs) -> dict[str, Array]:
        """Return the parameters of every row, which are those of its run."""
        parameters, named = {}, self.roles.named["parameter"]
        if self.options.unpaired and named:
            self.table.notes.append(f"--unpaired: the parameters {', '.join(named)} are not used")
            return {}
        for name, column in named.items():
            values, wrong = self.table.numbers(column)
            self._note(wrong, f"{name} is no number")
            cells = np.where(found.row >= 0, values[found.row], np.nan)
            low, high = ends_of(found.group, cells)
            if (low < high).any():
                self._differing(found, name, cells)
            parameters[name] = low[np.unique(found.group, return_inverse=True)[1]]
        return parameters

    def _differing(self, found: Runs, name: str, cells: Array, way: str = "") -> None:
        """Report the runs in which two methods have different values of a parameter."""
        low, high = ends_of(found.group, cells)
        _, group = np.unique(found.group, return_inverse=True)
        places, texts = [], []
        for number in np.flatnonzero(low < high)[:MAX_NAMED].tolist():
            a, b = (np.flatnonzero((group == number) & (cells == end[number]))[0] for end in (low, high))
            a, b = sorted((int(a), int(b)), key=lambda place: found.row[place])
            said = " and ".join(f"{cells[each]:.10g} for {found.methods[found.method[each]]}" for each in (a, b))
            text = f"{name} is {said} in run {found.named(int(found.run[b]))}: the methods did not have the same draws"
            text += " (--unpaired compares them without pairs)"
            texts.append(f"{text}{way}")
            places.append(found.row[b])
        self.problems += self.table.problems(np.array(places), texts)


def _status(word: str) -> int:
    """Return the number of a status: a word of the bench, or what else a table calls a run that has failed or not."""
    if word.lower() in FINISHED:
        return OK
    found = [status for status in Status if status.word == word.lower()]
    return int(found[0]) if found else CRASHED


def _as_number(text: str) -> tuple[float, str]:
    try:
        return (float(text), "")
    except ValueError:
        return (np.inf, text)


def ends_of(group: Array, values: Array) -> tuple[Array, Array]:
    """Return the smallest and the largest known value of every group, NaN without one."""
    order = np.argsort(group, kind="stable")
    first = np.flatnonzero(np.r_[True, np.diff(group[order]) != 0])
    return np.fmin.reduceat(values[order], first), np.fmax.reduceat(values[order], first)
