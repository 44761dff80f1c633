"""The runs of a table: roles of its columns, numbers of the runs, statuses, metrics and parameters, all checked."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from rmpc_bench.importing.roles import LAST, made_long, named, roles_of
from rmpc_bench.importing.settings import Options, Settings
from rmpc_bench.received.names import METRIC, wrong_line, wrong_method
from rmpc_bench.received.run_table import DECIMAL_COMMA, MAX_NAMED, Table
from rmpc_bench.registry import unknown
from rmpc_bench.types import Array, ConfigError, MetricInfo, Problem, Status

if TYPE_CHECKING:
    import pandas as pd

MOST_POINTS, MOST_METHODS, MOST_METRICS = 1000, 200, 100
OK, CRASHED = int(Status.OK), int(Status.CRASHED)
STATUSES = {status.word: int(status) for status in Status}
STATUSES |= dict.fromkeys(("", "ok", "1", "true"), OK) | dict.fromkeys(("0", "false"), CRASHED)
"""Statuses of the bench, and what else a table calls a run that has ended well, or failed for no reason it knows."""
NO_ROW = "the table has no row of this run"
MOSTLY = 0.8
"""Share of the runs from which on equal values of all methods are no accident."""
KEY = ["point", "method", "run"]
ROWS = (*KEY, "status", "reason", "row")


@dataclass
class Runs:
    """Checked runs; axis 0 of every array is the row, sorted by point, method and run."""

    methods: list[str]  # names, in the order of the settings, else as they appear
    infos: list[MetricInfo]
    paths: list[str]  # the swept paths
    points: list[dict[str, str]]  # path -> text of its value, of every point
    names: list[Any] | None  # original names of the runs, whole numbers or texts; None where the table has none
    point: Array  # place of each row in the three lists
    method: Array
    run: Array
    status: Array  # number of its status, and its text where that is no word of the bench
    reason: Array
    row: Array  # its place in the table, -1 where the table has no such row
    metrics: dict[str, Array]
    parameters: dict[str, Array]
    warnings: list[str] = field(default_factory=list)  # what is probably not meant


class Reader:
    """Makes runs of a table and collects its problems; `rows` has a row per run and method, sorted by these."""

    def __init__(self, table: Table, settings: Settings, options: Options) -> None:
        self.settings, self.options, self.problems = settings, options, list[Problem]()
        try:
            roles = roles_of(table, settings, options)
            self.table, self.roles = made_long(table, roles, settings, options.wide) if options.wide else (table, roles)
        except ConfigError as error:
            raise ConfigError([*error.problems, *settings.draft.problems]) from None

    def _stop(self, problem: str = "") -> None:
        """Raise all problems, where nothing more can be known."""
        self.problems += [self.table.problem(problem)] if problem else []
        if self.problems:
            raise ConfigError([*self.problems, *self.settings.draft.problems])

    def _note(self, rows: pd.DataFrame, message: str | Callable[[Any], str]) -> None:
        """Add a problem for some rows; a function makes its text of a row."""
        rows = rows.sort_values("row")
        named = rows[:MAX_NAMED].itertuples()
        texts = [message if isinstance(message, str) else message(each) for each in named]
        self.problems += self.table.problems(rows["row"].to_numpy(), texts)

    def _numbers(self, rows: pd.DataFrame, column: str, name: str) -> Array:
        """Return the numbers of a column for some rows, NaN where the table has none; texts are problems."""
        values, wrong = self.table.numbers(column)
        self._note(rows[rows["row"].isin(wrong)], f"{name} is no number")
        return np.where(rows["row"] >= 0, values[rows["row"]], np.nan)

    def runs(self) -> Runs:
        """Return the checked runs."""
        self.rows = self._rows()
        infos = self._metrics()
        for info in infos:
            self._check_values(info)
        self._treat_empty([info.name for info in infos])
        self._complete()
        if not len(self.rows):
            self._stop("--missing drop leaves no run")
        drawn = named(self.roles, "parameter")
        if self.options.unpaired and drawn:
            self.table.notes.append(f"--unpaired: the parameters {', '.join(drawn)} are not used")
            drawn = {}
        parameters = {name: self._parameter(name, column) for name, column in drawn.items()}
        rows, names = self.rows, self.names
        used, run = np.unique(rows["run"], return_inverse=True)
        if len(used) < (rows["run"].max() + 1 if names is None else len(names)):
            names, rows = [each if names is None else names[each] for each in used.tolist()], rows.assign(run=run)
        return Runs(
            methods=self.methods, infos=infos, paths=[*named(self.roles, "sweep")], points=self.points, names=names,
            metrics={info.name: rows[f"metric:{info.name}"].to_numpy() for info in infos}, parameters=parameters,
            **{name: rows[name].to_numpy() for name in ROWS},
        )  # fmt: skip

    def _rows(self) -> pd.DataFrame:
        """Return points, methods, runs and statuses of all rows, without their numbers."""
        import pandas as pd

        table, roles = self.table, self.roles
        rows = pd.DataFrame({"row": np.arange(len(table.frame))})
        rows["method"], methods = self._coded(table.texts(roles["method"]), [*self.settings.methods])
        self.methods = self._method_names(methods, rows)
        rows["point"], self.points = self._points(rows)
        rows["run"], self.names = self._runs(rows)
        words = pd.Series(table.texts(roles["status"]) if "status" in roles else "", rows.index, dtype=object)
        statuses = {word: STATUSES.get(word.lower(), CRASHED) for word in words.unique()}
        rows["status"] = words.map(statuses).astype(np.int64)
        rows["reason"] = words.mask(words.str.lower().isin(STATUSES), "").astype(object)
        if LAST in roles:
            rows["last"] = self._numbers(rows, roles[LAST], roles[LAST])
            rows = rows.sort_values([*KEY, "last"]).drop_duplicates(KEY, keep="last")
        rows = rows.sort_values([*KEY, "row"], ignore_index=True)
        if (again := rows.duplicated(KEY)).any():
            twice = rows.assign(first=rows.groupby(KEY)["row"].transform("first"))[again]
            text = "run {} of {} occurs twice (first in line {})"
            self._note(
                twice,
                lambda row: text.format(self._name_of(row.run), self.methods[row.method], *table.lines([row.first])),
            )
        self._stop()
        # What rows of the same run at the same point have in common.
        return rows.assign(group=rows.groupby(["point", "run"]).ngroup())

    def _name_of(self, run: int) -> str:
        return str(run if self.names is None else self.names[run])

    def _coded(self, texts: Array, known: Sequence[str]) -> tuple[Array, list[str]]:
        """Return the place of every text in a list of different ones: known ones first, others as they appear."""
        import pandas as pd

        found = dict.fromkeys(pd.unique(texts))
        order = [*dict.fromkeys([*(each for each in known if each in found), *found])]
        return pd.Index(order, dtype=object).get_indexer(texts), order

    def _method_names(self, names: list[str], rows: pd.DataFrame) -> list[str]:
        """Return the names of the methods; brackets and commas, which no method may have, are replaced."""
        made = [re.sub(r",\s*", " ", name.replace("[", "(").replace("]", ")")) for name in names]
        for number, (name, new) in enumerate(zip(names, made, strict=True)):
            wrong = wrong_method(new) and f"{wrong_method(new)} (got {name[:60]!r})" if name else "a row has no method"
            if wrong:
                self._note(rows[rows["method"] == number], wrong)
            elif name != new:
                self.table.notes.append(f"method {name!r} is called {new!r} here")
        if len(names) > MOST_METHODS:
            self._stop(f"{len(names):,} methods, at most {MOST_METHODS}")
        self._stop("two methods get one name" if len({*made}) < len(made) else "")
        return made

    def _points(self, rows: pd.DataFrame) -> tuple[Array, list[dict[str, str]]]:
        """Return the point of every row, and the points in the order of their values."""
        import pandas as pd

        codes, values = pd.DataFrame(index=rows.index), dict[str, list[str]]()
        for path, column in named(self.roles, "sweep").items():
            texts = self.table.texts(column)
            found = sorted(pd.unique(texts))
            by_number = np.argsort(pd.to_numeric(found, errors="coerce"), kind="stable").tolist()
            order = self.settings.grid.get(path) or [found[place] for place in by_number]
            codes[path], values[path] = self._coded(texts, order)
            self._note(rows[~pd.Series(texts).isin(order)], f"{path} has a value that sweep.grid lacks")
            if any(wrong_line(text) or not text for text in values[path]):
                self.problems.append(self.table.problem(f"{path} is empty, or has invisible characters, in some rows"))
            if len(values[path]) > MOST_POINTS:
                self._stop(f"{path} has {len(values[path]):,} values, at most {MOST_POINTS:,}")
        if not values:
            return np.zeros(len(codes), dtype=np.int64), [{}]
        used = codes.drop_duplicates().sort_values([*codes])
        if len(used) > MOST_POINTS:
            self._stop(f"{len(used):,} points of a sweep, at most {MOST_POINTS:,}")
        points = [{path: values[path][place] for path, place in each.items()} for each in used.to_dict("records")]
        return codes.groupby([*codes]).ngroup().to_numpy(), points

    def _runs(self, rows: pd.DataFrame) -> tuple[Array, list[Any] | None]:
        """Return the number of the run of every row and the original names."""
        if "run" not in self.roles:
            like = [each for each in self.table.frame if each.lower() in ("run", "seed", "trial", "repetition")]
            hint = f" (--columns run={like[0]} takes those of {like[0]!r})" if like else ""
            self.table.notes.append(f"no column 'run': the rows of a method are its runs in their order{hint}")
            return rows.groupby(["point", "method"]).cumcount().to_numpy(), None
        cells = self.table.frame[self.roles["run"]].to_numpy()
        if cells.dtype.kind == "f" and (np.abs(cells) < 2**53).all() and (cells == np.floor(cells)).all():
            cells = cells.astype(np.int64)
        if cells.dtype.kind == "i":
            numbers, places = np.unique(cells, return_inverse=True)
            return places, numbers.tolist()
        codes, names = self._coded(self.table.texts(self.roles["run"]), ())
        for number, text in enumerate(names):
            if wrong := wrong_line(text) or len(text) > 100 and "is longer than 100" or not text and "a row has no run":
                self._note(rows[codes == number][:1], f"the name of the run: {wrong}")
        return codes, names

    def _metrics(self) -> list[MetricInfo]:
        """Find metrics and parameters among the columns; the rows get the values of the metrics."""
        roles, wanted = self.roles, self.settings.metrics
        free = [each for each in self.table.frame if each not in roles.values()]
        chosen = {name: name for name in wanted if name in free} | named(roles, "metric")
        lacking = [unknown(name, free, "column") for name in wanted if name not in chosen]
        self.problems += [self.table.problem(f"metric {text}", 1) for text in lacking]
        for name in [each for each in free if each not in chosen.values()]:
            if (kind := self._kind(name)) == "metric":
                chosen[name] = name
            elif kind == "parameter":
                roles[f"parameter:{name}"] = name
            elif not self.problems or kind:
                self.table.notes.append(f"column {name!r} is ignored{kind and ': ' + kind}")
        chosen = {name: chosen[name] for name in (wanted or chosen) if name in chosen}
        if not chosen:
            text = "no metric: no column has numbers that differ between the methods; --metric names one"
            self._stop("" if self.problems else "; ".join([text, *self.table.notes[:MAX_NAMED]]))
        if len(chosen) > MOST_METRICS:
            self._stop(f"{len(chosen):,} metrics, at most {MOST_METRICS}; --metric names some")
        roles |= {f"metric:{name}": column for name, column in chosen.items()}
        return [wanted.get(name, MetricInfo(name, "", "lower")) for name in chosen]

    def _kind(self, name: str) -> str:
        """Return whether a column without a role is a metric or a parameter; else why it is ignored."""
        values, wrong = self.table.numbers(name)
        values, is_wrong = values[self.rows["row"]], np.isin(self.rows["row"], wrong)
        commas = [DECIMAL_COMMA.fullmatch(text) is not None for text in self.table.texts(name, wrong[:MAX_NAMED])]
        is_empty = np.isnan(values).all() and not (commas and all(commas))
        if is_empty or 2 * is_wrong.sum() > len(values) and not any(commas):
            return "its cells are texts" if len(wrong) else "it is empty"
        if not METRIC.fullmatch(name):
            return f"the name is none of a metric; --columns {shlex.quote(f'metric:NAME={name}')} takes it"
        other = "it is not named with --metric" if self.settings.metrics else "metric"
        if len(self.methods) == 1 or is_wrong.any():
            return other
        low, high = (each[~np.isnan(each)] for each in self._ends(values))
        alike, n_different = float(np.mean(low == high)), len(np.unique(low))
        if alike == 1.0:
            return "parameter" if n_different > 1 else "all its cells are equal"
        is_drawn = alike >= MOSTLY and n_different > 0.5 * len(low) and len(low) >= 5
        if is_drawn and other == "metric" and not self.options.unpaired:
            self._differing(name, values, f"; if it is a metric, --metric {name}")
            return ""
        return other

    def _check_values(self, info: MetricInfo) -> None:
        """Give the rows the values of a metric; refuse texts and infinite ones of runs that have ended well."""
        name, column = info.name, self.roles[f"metric:{info.name}"]
        values, wrong = self.table.numbers(column)

        def no_number(row: Any) -> str:
            (text,) = self.table.texts(column, [row.row])
            if DECIMAL_COMMA.fullmatch(text):
                return f"{name} is {text!r}: with decimal commas give --decimal , and --separator ';'"
            way = "a failed run has a status, a missing value is empty (--missing drop|failed)"
            return f"{name} of {self.methods[row.method]} is {text[:60]!r}, no number; {way}"

        def infinite(row: Any) -> str:
            way = f"metrics: [{{name: {name}, may_not_occur: true}}] says that the event did not occur"
            text = f"{name} of {self.methods[row.method]} is {values[row.row]:g}"
            return f"{text}: {way if values[row.row] > 0 else 'no number'}"

        ended = self.rows[self.rows["status"] == OK]
        self._note(ended[ended["row"].isin(wrong)], no_number)
        # They have been reported, and are not empty.
        values[wrong] = 0.0
        is_wrong = np.isinf(values) & ~((values > 0) & info.may_not_occur)
        self._note(ended[is_wrong[ended["row"]]], infinite)
        self.rows.loc[ended.index, f"metric:{name}"] = values[ended["row"]]

    def _treat_empty(self, metrics: Sequence[str]) -> None:
        """Treat empty metrics of runs that have ended well as the options say."""
        columns, rows = [f"metric:{name}" for name in metrics], self.rows
        lacking = rows[columns].isna().any(axis=1) & (rows["status"] == OK)
        if self.options.missing == "error":
            text = "a metric of a finished run is empty: --missing drop leaves the run out, --missing failed"
            self._note(rows[lacking], f"{text} counts it as failed")
        elif self.options.missing == "failed":
            rows.loc[lacking, ["status", "reason"]] = CRASHED, "a metric is empty"
            rows.loc[lacking, columns] = np.nan
        elif lacking.any():
            self._drop(rows["run"][lacking], "runs with an empty metric are left out")

    def _drop(self, runs: pd.Series, words: str) -> None:
        """Leave runs out at all points, which have the same ones."""
        self.table.notes.append(f"--missing drop: {runs.nunique()} {words}")
        self.rows = self.rows[~self.rows["run"].isin(runs)]

    def _complete(self) -> None:
        """Treat runs that some method lacks at a point as the options say."""
        import pandas as pd

        absent, runs = list[pd.DataFrame](), np.unique(self.rows["run"])
        for point, part in self.rows.groupby("point"):
            lacking = part.pivot(index="run", columns="method", values="row").reindex(runs).isna()
            for method in lacking.columns[lacking.any()]:
                missing = lacking.index[lacking[method]]
                absent.append(pd.DataFrame({"point": point, "method": method, "run": missing}))
                if self.options.missing == "error":
                    shown = ", ".join(map(self._name_of, missing[:10])) + (", .." if len(missing) > 10 else "")
                    at = "".join(f" at {path}={text}" for path, text in self.points[point].items())
                    text = f"{len(missing)} of {len(lacking)} runs have no row for {self.methods[method]}{at} ({shown})"
                    way = f"--missing drop compares the other {len(lacking) - len(missing)}, --missing failed counts"
                    way += " them as failed" + "; number the runs alike at all points" * bool(at)
                    self.problems.append(self.table.problem(f"{text}: {way}"))
        if absent and self.options.missing == "drop":
            self._drop(pd.concat(absent)["run"], "runs are left out, which some method lacks")
        elif absent and self.options.missing == "failed":
            added = pd.concat(absent).assign(status=CRASHED, reason=NO_ROW, row=-1)
            rows = pd.concat([self.rows, added]).sort_values(KEY, ignore_index=True)
            self.rows = rows.assign(group=rows.groupby(["point", "run"]).ngroup())

    def _parameter(self, name: str, column: str) -> Array:
        """Return the values of a parameter of every row, which are those of its run."""
        cells = self._numbers(self.rows, column, name)
        self._differing(name, cells)
        return np.asarray(self._ends(cells)[0][self.rows["group"]])

    def _ends(self, cells: Array) -> tuple[Array, Array]:
        """Return the smallest and the largest known value of every run, NaN without one."""
        group = self.rows["group"].to_numpy()
        low, high = np.full((2, group.max() + 1), np.nan)
        # Tables have thousands of columns, for each of which a groupby of pandas would take milliseconds.
        np.fmin.at(low, group, cells)
        np.fmax.at(high, group, cells)
        return low, high

    def _differing(self, name: str, cells: Array, way: str = "") -> None:
        """Report the runs in which two methods have different values of a parameter."""
        (low, high), rows = self._ends(cells), self.rows.assign(cells=cells)
        for group in np.flatnonzero(low < high)[:MAX_NAMED]:
            part = rows[(rows["group"] == group) & rows["cells"].isin([low[group], high[group]])]
            pair = part.drop_duplicates("cells").sort_values("row")
            said = " and ".join(f"{each.cells:.10g} for {self.methods[each.method]}" for each in pair.itertuples())
            text = f"{name} is {said} in run {self._name_of(pair['run'].iloc[0])}: the methods did not have the same"
            self._note(pair[-1:], f"{text} draws (--unpaired compares them without pairs){way}")
