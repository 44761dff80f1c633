"""What the columns of a table are: run, method, status, points, parameters, metrics; wide tables are made long."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

from rmpc_bench.config_file.tree import Problems
from rmpc_bench.importing.settings import NAMED_ROLES, ROLES, Options, Settings
from rmpc_bench.received.names import METRIC
from rmpc_bench.received.run_table import Table
from rmpc_bench.registry import unknown

LAST = "--keep-last"
"""Role of the column that says which of several rows of a run counts."""


def named(roles: Mapping[str, str], kind: str) -> dict[str, str]:
    """Return name -> column of the roles of a kind, such as ``sweep``."""
    return {role.partition(":")[2]: column for role, column in roles.items() if role.startswith(f"{kind}:")}


def is_text(settings: Settings, options: Options) -> Callable[[str], bool]:
    """Return what says of the name of a column whether its cells are texts, even if they look like numbers."""
    chosen = {name for role, name in options.columns.items() if role.partition(":")[0] in ("method", "status", "sweep")}
    known = {"method", "status", *settings.grid, *chosen} - {options.columns.get("run", "")}
    return lambda name: name in known or name.startswith("sweep:")


def roles_of(table: Table, settings: Settings, options: Options) -> dict[str, str]:
    """Return role -> column: roles that the options give, and those of columns that are named like a role."""
    roles, header, problems = dict[str, str](), [*table.frame], Problems()
    for role, name in [*options.columns.items(), *([(LAST, options.keep_last)] if options.keep_last else [])]:
        if name in header:
            roles[role] = name
        else:
            where = role if role == LAST else f"--columns {role}"
            problems.append(table.problem(f"{where}: {unknown(name, header, 'column')}", 1))
    for name in header:
        kind, _, rest = name.partition(":")
        if name not in roles.values() and (name in ROLES or kind in NAMED_ROLES and rest):
            roles.setdefault(name, name)
    for kind, names in (("sweep", settings.grid), ("parameter", [*settings.quantities, *options.parameters])):
        for name in names:
            if name in header:
                roles.setdefault(f"{kind}:{name}", name)
    for name in settings.quantities:
        if f"parameter:{name}" not in roles:
            settings.draft.note(["uncertainty"], f"the table has no column {name!r} ({_listed(table)})")
    for path in settings.grid:
        if f"sweep:{path}" not in roles:
            settings.draft.note(["sweep", "grid", path], f"the table has no such column ({_listed(table)})", key=True)
    for role in roles:
        kind, _, name = role.partition(":")
        if kind in ("parameter", "metric") and not METRIC.fullmatch(name):
            problems.append(table.problem(f"--columns {role}: the name must have letters, digits and _", 1))
    if "method" not in roles and not options.wide:
        free = [name for name in header if name not in roles.values() and table.is_text(name)]
        hint = f"; --columns method={free[0]}" if free else "; a table with a row per run needs --wide"
        problems.append(table.problem(f"no column 'method' ({_listed(table)}){hint}"))
    problems.stop()
    return roles


def _listed(table: Table) -> str:
    names = [name[:40] for name in table.frame]
    return ", ".join(names[:12]) + (f" and {len(names) - 12} more" if len(names) > 12 else "")


def made_long(table: Table, roles: Mapping[str, str], settings: Settings, pattern: str) -> tuple[Table, dict[str, str]]:
    """Return a table with a row per run and method from one with a row per run, and the roles with its new columns."""
    import pandas as pd

    columns, problems = dict[str, dict[str, str]](), Problems()
    for name in table.frame.columns.difference([*roles.values()], sort=False):
        readings = [*_readings(name, pattern, settings)]
        if len(readings) > 1:
            texts = " or ".join(f"{metric} of {method}" for metric, method in readings)
            problems.append(table.problem(f"column {name!r} may be {texts}: name the metrics with --metric", 1))
        for metric, method in readings[:1]:
            columns.setdefault(method, {})[name] = metric
    metrics = dict.fromkeys(metric for each in columns.values() for metric in each.values())
    if not columns:
        problems.append(table.problem(f"no column is like {pattern!r} ({_listed(table)})", 1))
    for metric in metrics:
        missing = [method for method, each in columns.items() if metric not in each.values() and metric != "status"]
        if missing:
            name = next(name for name in table.frame if metric in (each.get(name) for each in columns.values()))
            way = f"if it is a parameter, --columns parameter:{name}={name}; else name the metrics with --metric"
            problems.append(table.problem(f"{name!r} would be {metric}, which {missing[0]} does not have: {way}", 1))
    problems.stop()
    roles = {**roles, "method": "\0method", "run": roles.get("run", "\0run")}
    roles |= {"status" if metric == "status" else f"metric:{metric}": metric for metric in metrics}
    rest = table.frame.drop(columns=[name for each in columns.values() for name in each])
    rest = rest if roles["run"] in rest else rest.assign(**{"\0run": range(len(rest))})
    parts = [
        rest.assign(**table.frame[[*each]].rename(columns=each), **{"\0method": method})
        for method, each in columns.items()
    ]
    return replace(table, frame=pd.concat(parts)), roles


def _readings(name: str, pattern: str, settings: Settings) -> Iterator[tuple[str, str]]:
    """Yield metric and method that the name of a column may consist of."""
    start, first, middle, second, end = re.split(r"\{(\w+)\}", pattern)
    inner = name.removeprefix(start).removesuffix(end)
    for place in range(1, len(inner) - len(middle) if middle and name == f"{start}{inner}{end}" else 0):
        if inner.startswith(middle, place):
            found = {first: inner[:place], second: inner[place + len(middle) :]}
            metric, method = found["metric"], found["method"]
            is_known = not settings.metrics or metric in (*settings.metrics, "status")
            if is_known and (not settings.methods or method in settings.methods):
                yield metric, method
