"""Settings of an import: some sections of a configuration, and the options that replace them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any, Literal, cast

from annotated_types import Len
from pydantic import AfterValidator

from rmpc_bench.claims.claim import Claim
from rmpc_bench.config.claims import ClaimKeys, check_figures, read_claims
from rmpc_bench.config.draft import DraftConfig, MethodComponents
from rmpc_bench.config.noise import read_uncertainty, uncertain_names
from rmpc_bench.config.report import check_report
from rmpc_bench.config.sections import SECTIONS, components_of
from rmpc_bench.config.statistics import check_statistics
from rmpc_bench.config_file.component import Component
from rmpc_bench.config_file.mapping import canonical_text
from rmpc_bench.config_file.tree import Items, Map, Mark, assign, plain
from rmpc_bench.config_file.yaml import load, parse
from rmpc_bench.received.names import METRIC, wrong_label
from rmpc_bench.received.run_table import Form
from rmpc_bench.registry import unknown
from rmpc_bench.types import ConfigError, MetricInfo, Problem, ResultLayout
from rmpc_bench.types.errors import MAPPING
from rmpc_bench.types.metric import Direction
from rmpc_bench.types.sweep_points import value_text

SHARED = ("version", "name", "title", "seed", "statistics", "uncertainty", "figures", "report", "claims")
"""Keys that mean what they mean in a configuration."""
ROLES = ("run", "method", "status")
NAMED_ROLES = ("sweep", "parameter", "metric")
"""Roles with a name behind a colon, such as ``sweep:plant.eps``."""


def _metric_name(text: str) -> str:
    if not METRIC.fullmatch(text):
        raise ValueError(f"must be a name of up to 100 letters, digits, _ (got {text!r})")
    return text


def _label(text: str) -> str:
    if wrong := wrong_label(text):
        raise ValueError(wrong)
    return text


@dataclass(frozen=True)
class MetricKeys:
    """A metric of the table.

    Parameters
    ----------
    name : its column
    unit : its unit
    better : which value is better: a lower or a higher one, the one closest to 0, or to 1
    may_not_occur : whether the measured event may not occur in a run, whose value is then inf
    """

    name: Annotated[str, AfterValidator(_metric_name)]
    unit: Annotated[str, AfterValidator(_label)] = ""
    better: Direction = "lower"
    may_not_occur: bool = False

    @property
    def info(self) -> MetricInfo:
        """What tables know of it."""
        return MetricInfo(self.name, self.unit, self.better, self.may_not_occur)


@dataclass(frozen=True)
class MethodKeys:
    """A method of the table.

    Parameters
    ----------
    label : text for tables and figures
    parameters : where its parameters come from; nothing is said unless given
    """

    label: Annotated[str, AfterValidator(_label)] | None = None
    parameters: Literal["as published", "default"] | None = None


@dataclass(frozen=True)
class SweepKeys:
    """Points of the table.

    Parameters
    ----------
    grid : swept path, a column of the table -> its values, in their order
    """

    grid: dict[str, Annotated[list[Any], Len(1)]]


OWN: dict[str, Any] = {
    "methods": dict[str, MethodKeys | None],
    "metrics": list[Annotated[str, AfterValidator(_metric_name)] | MetricKeys],
    "sweep": SweepKeys,
    "random_besides": list[str],
}
"""Key -> its annotation, where it has another form than in a configuration."""


@dataclass(frozen=True)
class Options:
    """How a table is read; see `import_runs`."""

    columns: Mapping[str, str] = field(default_factory=dict)
    form: Form = Form()
    wide: str = ""
    missing: Literal["error", "drop", "failed"] = "error"
    keep_last: str = ""
    parameters: tuple[str, ...] = ()
    unpaired: bool = False
    max_rows: int = 1_000_000

    def __post_init__(self) -> None:
        """Refuse what is no option."""
        found = []
        for role in self.columns:
            kind, _, name = role.partition(":")
            if role not in ROLES and not (kind in NAMED_ROLES and name):
                known = [*ROLES, *(f"{each}:NAME" for each in NAMED_ROLES)]
                found.append(Problem("--columns", 0, 0, "", unknown(role, known, "role")))
        if self.wide and sorted(re.findall(r"\{(\w*)\}", self.wide)) != ["method", "metric"]:
            text = f"must have {{metric}} and {{method}}, such as '{{metric}}_{{method}}' (got {self.wide!r})"
            found.append(Problem("--wide", 0, 0, "", text))
        for key, sign in (("--decimal", self.form.decimal), ("--separator", self.form.separator)):
            if len(sign) != 1 or sign in '"\r\n+-' or sign.isalnum() or not sign.isascii():
                found.append(Problem(key, 0, 0, "", f"must be one sign (got {sign!r})"))
        if self.form.decimal == self.form.separator:
            found.append(Problem("--decimal", 0, 0, "", "must differ from --separator"))
        if found:
            raise ConfigError(found)

    def data(self) -> dict[str, Any]:
        """Return the options that are not the usual ones, as keywords of `import_runs`."""
        given = {**vars(self), **vars(self.form)}
        usual = {**vars(Options()), **vars(Form())}
        return {
            key: each
            for key, each in given.items()
            if key not in ("form", "max_rows", "parameters") and each != usual[key]
        }


class Settings:
    """The sections, read before the table; what they say of it is checked by `finish`."""

    def __init__(self, source: str | Path | Mapping[str, Any] | None, options: Mapping[str, Any]) -> None:
        self.draft = draft = DraftConfig(_tree(source, options), [])
        tree = draft.tree
        for name in tree:
            if name not in (*SHARED, *OWN):
                draft.note([name], unknown(name, [*SHARED, *OWN], "section of an import"), key=True)
        for name in SHARED:
            section = SECTIONS[name]
            draft.values[name] = draft.checked(section.annotation, [name]) if name in tree else section.default
        for name, annotation in OWN.items():
            draft.values[name] = draft.checked(annotation, [name]) if name in tree else None
        read_uncertainty(draft)
        keys = draft.values["metrics"] or []
        self.metrics = [each if isinstance(each, MetricKeys) else MetricKeys(each) for each in keys]
        names = [each.name for each in self.metrics]
        for place, name in enumerate(names):
            if name in names[:place]:
                draft.note(["metrics", place], f"{name!r} is named twice")

    @property
    def quantities(self) -> list[str]:
        """Names of the quantities that have a law."""
        return uncertain_names(self.draft)

    @property
    def grid(self) -> dict[str, list[str]]:
        """Swept path -> texts of its values, in their order."""
        sweep = self.draft.values["sweep"]
        return {} if sweep is None else {path: [*map(value_text, map(plain, sweep.grid[path]))] for path in sweep.grid}

    @property
    def given_methods(self) -> list[str]:
        """Methods that are named, in their order."""
        return [*(self.draft.values["methods"] or {})]

    def law_text(self, name: str) -> str:
        """Return the law of a quantity as it is written."""
        given = self.draft.tree["uncertainty"].get(name)
        return given if isinstance(given, str) else value_text(plain(given))

    def refuse_pairs(self) -> None:
        """Refuse what only runs in pairs have."""
        tree = self.draft.tree
        given: list[list[str | int]] = [[name] for name in tree]
        given += [["statistics", key] for key in tree.get("statistics") or ()]
        for path in given:
            if path[-1] in ("uncertainty", "claims", "adjust", "lost", "ranks", "requirements"):
                self.draft.note(path, "needs runs in pairs, which --unpaired does not have", key=True)

    def finish(self, methods: Sequence[str], infos: Sequence[MetricInfo], points: Sequence[Mapping[str, str]]) -> None:
        """Check names against the table, and claims and figures against what will be stored."""
        draft = self.draft
        for name in self.given_methods:
            if name not in methods:
                draft.note(["methods", name], unknown(name, methods, "method of the table"), key=True)
        given = {name: keys or MethodKeys() for name, keys in (draft.values["methods"] or {}).items()}
        draft.labels = {name: given[name].label or name if name in given else name for name in methods}
        draft.sources = {name: keys.parameters for name, keys in given.items() if keys.parameters is not None}
        # Names of methods and metrics are all that the checks of the sections read.
        draft.methods = dict.fromkeys(methods, MethodComponents(None, None, None, None))
        draft.metrics = [_named(each.name) for each in infos]
        draft.coordinates, draft.values["evaluate"] = points[0], ["runs"]
        draft.figures = components_of(draft, "figures")
        claims = draft.values["claims"] or []
        draft.claims = [draft.checked(ClaimKeys, ["claims", number]) for number, _ in enumerate(claims)]
        trials = tuple({name: f"{number} {name}" for name in methods} for number, _ in enumerate(points))
        layout = ResultLayout(
            methods=tuple(methods), metrics=tuple(each.name for each in infos), points=tuple(points), trials=trials,
            has_runs=True, is_uncertain=True,
        )  # fmt: skip
        self.claims: tuple[Claim, ...] = read_claims(draft, layout)
        check_figures(draft, layout)
        check_report(draft)
        scenario = SimpleNamespace(uncertainty=draft.uncertainty, quantities=tuple(self.quantities), burst_names=())
        experiment = SimpleNamespace(metric_infos=tuple(infos), scenario=scenario, plant=SimpleNamespace(laws=dict))
        check_statistics(draft, cast(Any, SimpleNamespace(experiment=experiment)))

    def used(self, infos: Sequence[MetricInfo], methods: Sequence[str]) -> dict[str, Any]:
        """Return the settings as they were used, which `import_runs` takes again."""
        draft, found = self.draft, dict[str, Any](plain(self.draft.tree))
        metrics = [dict(zip(("name", "unit", "better", "may_not_occur"), each, strict=False)) for each in infos]
        named = {name: (found.get("methods") or {}).get(name) or {} for name in methods}
        return {"version": 1, "name": draft.values["name"]} | found | {"methods": named, "metrics": metrics}


def _tree(source: str | Path | Mapping[str, Any] | None, options: Mapping[str, Any]) -> Map:
    """Read the file or the mapping, and put the options in their places."""
    if isinstance(source, Mapping):
        tree = parse(canonical_text(source), MAPPING)
    else:
        tree = Map(mark=Mark(MAPPING, 1, 1)) if source is None else load(source)
    if not isinstance(tree, Map):
        raise ConfigError([Problem(str(source), 1, 1, "", "must be a mapping of sections")])
    if source is None or isinstance(source, Mapping):
        tree = assign(tree, "version", 1, Mark(MAPPING, 1, 1)) if "version" not in tree else tree
    for path, value in options.items():
        if path == "metrics" and value:
            given = tree.get("metrics")
            if not isinstance(given, Items | None):
                continue  # The file is wrong, and says so.
            named = [each for each in given or () if isinstance(each, Map) and isinstance(each.get("name"), str)]
            known = {each["name"]: each for each in named}
            value = Items([known.get(name, name) for name in value], mark=Mark("--metric", 0, 0))
        if value and (path != "name" or "name" not in tree):
            tree = assign(tree, path, value, Mark(f"--{path.rpartition('.')[2]}", 0, 0))
    return tree


def _named(name: str) -> Component:
    """Return a metric of which no more than the name is known."""
    return Component("metrics", "imported", {"name": name}, Map(mark=Mark("", 1, 1)), (), MetricKeys)
