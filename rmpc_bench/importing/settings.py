"""Settings of an import: some sections of a configuration, and the options that replace them."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from annotated_types import Len
from pydantic import AfterValidator

from rmpc_bench.claims.claim import Claim
from rmpc_bench.config.check import Quantities, check_report, check_statistics
from rmpc_bench.config.claim_keys import ClaimKeys
from rmpc_bench.config.claims import check_figures, read_claims
from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.config.identity import law_data
from rmpc_bench.config.noise import read_uncertainty, uncertain_names
from rmpc_bench.config.sections import SECTIONS
from rmpc_bench.config.statistics import Statistics
from rmpc_bench.config_file.mapping import canonical_text
from rmpc_bench.config_file.tree import Items, Map, Mark, assign, plain
from rmpc_bench.config_file.yaml import load, parse
from rmpc_bench.noise.distributions import Distribution
from rmpc_bench.received.names import wrong_label, wrong_metric
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


def _unless(wrong: Callable[[object], str]) -> AfterValidator:
    """Return what refuses a text with which something is wrong."""

    def checked(text: str) -> str:
        if message := wrong(text):
            raise ValueError(f"{message} (got {text!r})")
        return text

    return AfterValidator(checked)


Name = Annotated[str, _unless(wrong_metric)]
Label = Annotated[str, _unless(wrong_label)]


@dataclass(frozen=True)
class MetricKeys:
    """A metric of the table: its column, and what tables know of it."""

    name: Name
    unit: Label = ""
    better: Direction = "lower"
    may_not_occur: bool = False


@dataclass(frozen=True)
class MethodKeys:
    """A method of the table: its text for tables and figures, and where its parameters come from."""

    label: Label | None = None
    parameters: Literal["as published", "default"] | None = None


@dataclass(frozen=True)
class SweepKeys:
    """Points of the table: swept path, a column of it -> its values, in their order."""

    grid: dict[str, Annotated[list[Any], Len(1)]]


OWN: dict[str, Any] = {
    "methods": dict[str, MethodKeys | None],
    "metrics": list[Name | MetricKeys],
    "sweep": SweepKeys,
    "random_besides": list[str],
}
"""Key -> its annotation, where it has another form than in a configuration."""


@dataclass(frozen=True)
class Options:
    """How a table is read; see `import_runs`."""

    columns: Mapping[str, str] = field(default_factory=dict)
    wide: str = ""
    missing: Literal["error", "drop", "failed"] = "error"
    keep_last: str = ""
    decimal: str = "."
    separator: str = ","
    parameters: tuple[str, ...] = ()
    unpaired: bool = False
    max_rows: int = 1_000_000

    def __post_init__(self) -> None:
        """Refuse what is no option."""
        found = list[tuple[str, str]]()
        known = [*ROLES, *(f"{each}:NAME" for each in NAMED_ROLES)]
        for role in self.columns:
            if re.sub("(?<=:).+", "NAME", role) not in known:
                found.append(("--columns", unknown(role, known, "role")))
        if self.wide and sorted(re.findall(r"\{(\w*)\}", self.wide)) != ["method", "metric"]:
            text = f"must have {{metric}} and {{method}}, such as '{{metric}}_{{method}}' (got {self.wide!r})"
            found.append(("--wide", text))
        for key, sign in (("--decimal", self.decimal), ("--separator", self.separator)):
            if len(sign) != 1 or sign in '"\r\n+-' or sign.isalnum() or not sign.isascii():
                found.append((key, f"must be one sign (got {sign!r})"))
        if self.decimal == self.separator:
            found.append(("--decimal", "must differ from --separator"))
        if found:
            raise ConfigError([Problem(key, 0, 0, "", text) for key, text in found])

    def data(self) -> dict[str, Any]:
        """Return the options that are not the usual ones, as keywords of `import_runs`."""
        usual = {**vars(Options()), "max_rows": self.max_rows, "parameters": self.parameters}
        return {key: each for key, each in vars(self).items() if each != usual[key]}


class Settings:
    """The sections, read before the table; what they say of it is checked by `finish`."""

    def __init__(self, source: str | Path | Mapping[str, Any] | None, options: Mapping[str, Any]) -> None:
        draft = DraftConfig(_tree(source, options))
        for name in draft.tree:
            if name not in (*SHARED, *OWN):
                draft.note([name], unknown(name, [*SHARED, *OWN], "section of an import"), key=True)
        annotations = {name: SECTIONS[name].annotation for name in SHARED} | OWN
        defaults = {name: SECTIONS[name].default for name in SHARED if SECTIONS[name].default is not ...}
        values = {
            name: draft.checked(each, [name]) if name in draft.tree else defaults.get(name)
            for name, each in annotations.items()
        }
        draft = draft.with_keys(**{name: values[name] for name in (*SHARED, "methods")}, evaluate=["runs"])
        self.draft = replace(draft, uncertainty=read_uncertainty(draft))
        keys = [MetricKeys(each) if isinstance(each, str) else each for each in values["metrics"] or []]
        self.metrics = {each.name: MetricInfo(*vars(each).values()) for each in keys}
        names = [each.name for each in keys]
        for place, name in enumerate(names):
            if name in names[:place]:
                draft.note(["metrics", place], f"{name!r} is named twice")
        self.methods: dict[str, MethodKeys | None] = values["methods"] or {}
        self.random_besides: list[str] | None = values["random_besides"]
        self.quantities = uncertain_names(draft.tree)
        grid = {} if values["sweep"] is None else values["sweep"].grid
        # Swept path -> texts of its values, in their order.
        self.grid = {path: [*map(value_text, map(plain, swept))] for path, swept in grid.items()}

    @property
    def statistics(self) -> Statistics:
        """The section `statistics` of settings without errors."""
        assert self.draft.keys.statistics is not None
        return self.draft.keys.statistics

    @property
    def laws(self) -> dict[str, dict[str, Any]]:
        """Keys of the laws of the uncertain quantities that are drawn alone."""
        laws = self.draft.uncertainty.scaled
        return {name: law_data(law) for name, law in laws.items() if isinstance(law, Distribution)}

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
        draft, metrics = self.draft, tuple(each.name for each in infos)
        for name in self.methods:
            if name not in methods:
                draft.note(["methods", name], unknown(name, methods, "method of the table"), key=True)
        given = {name: self.methods.get(name) or MethodKeys() for name in methods}
        self.labels = {name: each.label or name for name, each in given.items()}
        self.sources = {name: each.parameters for name, each in given.items() if each.parameters is not None}
        draft = replace(draft, coordinates=points[0])
        figures = draft.components("figures")
        claims = [draft.checked(ClaimKeys, ["claims", number]) for number, _ in enumerate(draft.keys.claims or ())]
        self.draft = draft = replace(draft, figures=figures, claims=claims)
        trials = tuple({name: f"{number} {name}" for name in methods} for number, _ in enumerate(points))
        layout = ResultLayout(
            methods=tuple(methods), metrics=metrics, points=tuple(points), trials=trials, has_runs=True,
            is_uncertain=True,
        )  # fmt: skip
        self.claims: tuple[Claim, ...] = read_claims(draft, layout)
        check_figures(draft, layout)
        check_report(draft, layout)
        check_statistics(draft, layout, Quantities(infos, self.quantities, self.laws))

    def used(self, infos: Sequence[MetricInfo], methods: Sequence[str]) -> dict[str, Any]:
        """Return the settings as they were used, which `import_runs` takes again."""
        found = dict[str, Any](plain(self.draft.tree))
        metrics = [dict(zip((each.name for each in fields(MetricKeys)), info, strict=False)) for info in infos]
        named = {name: (found.get("methods") or {}).get(name) or {} for name in methods}
        return {"version": 1, "name": self.draft.keys.name} | found | {"methods": named, "metrics": metrics}


def _tree(source: str | Path | Mapping[str, Any] | None, options: Mapping[str, Any]) -> Map:
    """Read the file or the mapping, and put the options in their places."""
    if source is None or isinstance(source, Mapping):
        tree = parse(canonical_text({"version": 1, **(source or {})}), MAPPING)
    else:
        tree = load(source)
    if not isinstance(tree, Map):
        raise ConfigError([Problem(str(source), 1, 1, "", "must be a mapping of sections")])
    for path, value in options.items():
        if path == "metrics":
            given = tree.get("metrics")
            if not isinstance(given, Items | None):
                continue  # The file is wrong, and says so.
            known = {str(each.get("name")): each for each in given or () if isinstance(each, Map)}
            value = Items([known.get(name, name) for name in value], mark=Mark("--metric", 0, 0))
        if value and (path != "name" or "name" not in tree):
            tree = assign(tree, path, value, Mark(f"--{path.rpartition('.')[2]}", 0, 0))
    return tree
