"""What the columns of a table are: run, method, status, points, parameters, metrics; wide tables are made long."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from rmpc_bench.importing.settings import NAMED_ROLES, Options, Settings
from rmpc_bench.received.names import METRIC
from rmpc_bench.received.run_table import Table
from rmpc_bench.registry import unknown
from rmpc_bench.types import Problem

STATUS = "status"


@dataclass
class Roles:
    """Role -> column; `named` has those of the roles with a name, such as ``sweep``, by this name."""

    run: str | None = None
    method: str | None = None
    status: str | None = None
    keep_last: str | None = None
    named: dict[str, dict[str, str]] = field(default_factory=lambda: {kind: {} for kind in NAMED_ROLES})

    @property
    def taken(self) -> set[str]:
        """Columns that have a role."""
        single = {self.run, self.method, self.status, self.keep_last}
        return {each for each in single if each is not None}.union(*(each.values() for each in self.named.values()))


def is_text(settings: Settings, options: Options) -> Callable[[str], bool]:
    """Return what says of the name of a column whether its cells are texts, even if they look like numbers."""
    chosen = {name for role, name in options.columns.items() if role in ("method", STATUS) or role.startswith("sweep:")}
    known = {"method", STATUS, *settings.grid, *chosen} - {options.columns.get("run", "")}
    return lambda name: name in known or name.startswith("sweep:")


def roles_of(table: Table, settings: Settings, options: Options, problems: list[Problem]) -> Roles:
    """Return the roles that the options give, and those of columns that are named like a role."""
    found, header = Roles(), table.columns
    for role, name in options.columns.items():
        if name not in header:
            problems.append(table.problem(f"--columns {role}: {unknown(name, header, 'column')}", 1))
            continue
        _set(found, role, name)
    for name in header:
        if name not in found.taken:
            _set(found, name, name, unless_given=True)
    if options.keep_last and options.keep_last not in header:
        problems.append(table.problem(f"--keep-last: {unknown(options.keep_last, header, 'column')}", 1))
    found.keep_last = options.keep_last if options.keep_last in header else None
    for kind, names in (("sweep", settings.grid), ("parameter", [*settings.quantities, *options.parameters])):
        for name in names:
            if name not in found.named[kind] and name in header:
                found.named[kind][name] = name
    for name in settings.quantities:
        if name not in found.named["parameter"]:
            settings.draft.note(["uncertainty"], f"the table has no column {name!r} ({_listed(table)})")
    for path in settings.grid:
        if path not in found.named["sweep"]:
            settings.draft.note(["sweep", "grid", path], f"the table has no such column ({_listed(table)})", key=True)
    problems += [
        table.problem(f"--columns {kind}:{name}: the name must have letters, digits and _", 1)
        for kind in ("parameter", "metric")
        for name in found.named[kind]
        if not METRIC.fullmatch(name)
    ]
    if found.method is None and not options.wide:
        free = [name for name, cells in header.items() if name not in found.taken and cells.dtype == object]
        hint = f"; --columns method={free[0]}" if free else "; a table with a row per run needs --wide"
        problems.append(table.problem(f"no column 'method' ({_listed(table)}){hint}"))
    return found


def _set(found: Roles, role: str, name: str, *, unless_given: bool = False) -> None:
    kind, _, named = role.partition(":")
    if named and kind in found.named:
        found.named[kind].setdefault(named, name)
    elif role in ("run", "method", STATUS) and not (unless_given and getattr(found, role)):
        setattr(found, role, name)


def _listed(table: Table) -> str:
    names = [name[:40] for name in table.header if name]
    return ", ".join(names[:12]) + (f" and {len(names) - 12} more" if len(names) > 12 else "")


def made_long(table: Table, roles: Roles, settings: Settings, pattern: str, problems: list[Problem]) -> Table:
    """Return a table with a row per run and method from one with a row per run; the roles get the new columns."""
    cells: dict[tuple[str, str], str] = {}
    for name in table.columns:
        readings = [] if name in roles.taken else [*_readings(name, pattern, settings)]
        if len(readings) > 1:
            texts = " or ".join(f"{metric} of {method}" for metric, method in readings)
            problems.append(table.problem(f"column {name!r} may be {texts}: name the metrics with --metric", 1))
        cells |= {reading: name for reading in readings[:1]}
    methods = [*dict.fromkeys(method for _, method in cells)]
    metrics = [*dict.fromkeys(metric for metric, _ in cells)]
    if not methods:
        problems.append(table.problem(f"no column is like {pattern!r} ({_listed(table)})", 1))
    for metric in metrics:
        missing = [method for method in methods if (metric, method) not in cells and metric != STATUS]
        if missing:
            name = next(cells[key] for key in cells if key[0] == metric)
            way = f"if it is a parameter, --columns parameter:{name}={name}; else name the metrics with --metric"
            problems.append(table.problem(f"{name!r} would be {metric}, which {missing[0]} does not have: {way}", 1))
    if problems:
        return table
    n, empty = len(table), np.full(len(table), "", dtype=object)
    rest = {name: np.tile(each, len(methods)) for name, each in table.columns.items() if name not in cells.values()}
    long = {
        metric: np.concatenate(
            [table.columns[cells[metric, name]] if (metric, name) in cells else empty for name in methods]
        )
        for metric in metrics
    }
    roles.method, roles.status = "\0method", STATUS if STATUS in metrics else None
    if roles.run is None:
        rest["\0run"], roles.run = np.tile(np.arange(n), len(methods)), "\0run"
    roles.named["metric"] |= {metric: metric for metric in metrics if metric != STATUS}
    long["\0method"] = np.repeat(np.array(methods, dtype=object), n)
    return replace(table, columns=rest | long, rows=np.tile(table.rows, len(methods)))


def _readings(name: str, pattern: str, settings: Settings) -> Iterator[tuple[str, str]]:
    """Yield metric and method that the name of a column may consist of."""
    start, first, middle, second, end = _parts(pattern)
    known = {"metric": [each.name for each in settings.metrics], "method": settings.given_methods}
    inner = name[len(start) : len(name) - len(end)]
    if name != f"{start}{inner}{end}" or not middle:
        return
    for place in range(1, len(inner) - len(middle)):
        if inner[place : place + len(middle)] == middle:
            found = {first: inner[:place], second: inner[place + len(middle) :]}
            metric, method = found["metric"], found["method"]
            is_known = not known["metric"] or metric in (*known["metric"], STATUS)
            if is_known and (not known["method"] or method in known["method"]):
                yield metric, method


def _parts(pattern: str) -> tuple[str, str, str, str, str]:
    start, _, rest = pattern.partition("{")
    first, _, rest = rest.partition("}")
    middle, _, rest = rest.partition("{")
    second, _, end = rest.partition("}")
    return start, first, middle, second, end
