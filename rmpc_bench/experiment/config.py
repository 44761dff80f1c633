"""A configuration: what a YAML says, checked whole, with every design made."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rmpc_bench.analysis.claim import Claim, Stated
from rmpc_bench.analysis.claim_grammar import COUNTS, ClaimError, parse, parse_expression, terms
from rmpc_bench.experiment import yaml
from rmpc_bench.experiment.build import build
from rmpc_bench.experiment.engines import single_thread
from rmpc_bench.experiment.parts import Part
from rmpc_bench.experiment.reader import at_their_origin, read
from rmpc_bench.experiment.resolve import belief, measured, resolved, shared
from rmpc_bench.experiment.schema import shown
from rmpc_bench.experiment.sections import ClaimKeys, Execution, Statistics
from rmpc_bench.experiment.sheet import Sheet
from rmpc_bench.experiment.yaml import Map
from rmpc_bench.registry import unknown
from rmpc_bench.simulation.scenario import Experiment
from rmpc_bench.types import ConfigError, Problem


@dataclass(frozen=True, eq=False)
class ExperimentConfig:
    """A valid configuration.

    Parameters
    ----------
    path : the file it was read from
    name, paper, title : as given; ``paper`` may be None
    experiment : all designs, ready to run
    statistics, execution : how to compare, how to work
    labels : method name -> text for tables and figures
    figures : the parts to draw
    claims : statements to judge
    shared : what all methods share, as plain data; its hash identifies the experiment
    methods : what each method is, as plain data; the hash of one identifies its trials
    metrics : what each metric is, as plain data
    resolved : the whole configuration with every default filled in; loads to an equal one
    """

    path: Path
    name: str
    paper: str | None
    title: str
    experiment: Experiment
    statistics: Statistics
    execution: Execution
    labels: Mapping[str, str]
    figures: tuple[Part, ...]
    claims: tuple[Claim, ...]
    shared: Mapping[str, Any]
    methods: Mapping[str, Any]
    metrics: Mapping[str, Any]
    resolved: Mapping[str, Any]

    @property
    def primary(self) -> str:
        """Name of the metric that the screen and the figures show."""
        return self.statistics.primary or self.experiment.metrics[0].info.name

    @property
    def baseline(self) -> str:
        """Method that all others are compared with."""
        return self.statistics.baseline or self.experiment.methods[0].name

    @property
    def hash(self) -> str:
        """Hash of what all methods share."""
        return digest(self.shared)

    @property
    def full_hash(self) -> str:
        """Hash of everything that determines a trial, methods included."""
        return digest({"shared": self.shared, "methods": self.methods})


def digest(data: Any) -> str:
    """SHA-256 of plain data in a canonical form."""
    return hashlib.sha256(json.dumps(data, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def load_config(
    path: str | Path, *, overrides: Sequence[str] = (), runs: int | None = None, smoke: bool = False
) -> ExperimentConfig:
    """Read, check and build a configuration.

    Parameters
    ----------
    path : the YAML
    overrides : texts PATH=VALUE, each replacing one value
    runs : number of runs instead of the file's
    smoke : the small size under ``smoke`` instead of the full one

    Raises
    ------
    ConfigError
        With everything that is wrong, each with its place.
    """
    tree = yaml.load(path)
    if not isinstance(tree, Map):
        raise ConfigError([Problem(str(path), 1, 1, "", f"must be a mapping (got {shown(tree)})")])
    tree = _overridden(tree, overrides)
    sheet = read(tree)
    if runs is not None:
        sheet.values["runs"] = runs
    if smoke:
        _shrink(sheet)
    with single_thread():
        experiment = build(sheet, smoke=smoke)
    claims = _claims(sheet, experiment)
    _statistics(sheet)
    _figures(sheet)
    if sheet.problems or experiment is None:
        raise ConfigError(at_their_origin(sheet))
    values = sheet.values
    return ExperimentConfig(
        path=Path(path),
        name=values["name"],
        paper=values["paper"],
        title=values["title"],
        experiment=experiment,
        statistics=values["statistics"],
        execution=values["execution"],
        labels={name: parts.label for name, parts in sheet.methods.items()},
        figures=tuple(part for part in sheet.figures if part is not None),
        claims=claims,
        shared=shared(sheet, experiment),
        methods={name: belief(sheet, parts) for name, parts in sheet.methods.items()},
        metrics=measured(sheet, experiment),
        resolved=resolved(sheet, experiment, smoke=smoke),
    )


def _overridden(tree: Map, overrides: Sequence[str]) -> Map:
    """Replace single values; what is wrong with any of them is raised together."""
    problems: list[Problem] = []
    for text in overrides:
        try:
            tree = yaml.assign(tree, *yaml.parse_override(text))
        except ConfigError as error:
            problems += error.problems
    if problems:
        raise ConfigError(problems)
    return tree


def _shrink(sheet: Sheet) -> None:
    """Take the size of a smoke run where it is smaller."""
    size, values = sheet.values["smoke"], sheet.values
    if size is not None and values["runs"] is not None and values["time"] is not None:
        time = values["time"]
        values["runs"] = min(values["runs"], size.runs)
        n_steps = min(time.n_steps, size.steps)
        # The unit of windows must survive, so a time in seconds stays one in seconds.
        length = {"duration": n_steps * time.step} if time.duration is not None else {"steps": n_steps}
        values["time"] = type(time)(step=time.step, **length)


def _statistics(sheet: Sheet) -> None:
    given, names = sheet.tree.get("statistics"), _metric_names(sheet)
    if not isinstance(given, Map):
        return
    if isinstance(given.get("primary"), str) and given["primary"] not in names:
        sheet.note(["statistics", "primary"], unknown(given["primary"], names, "metric of this configuration"))
    if isinstance(given.get("baseline"), str) and sheet.methods and given["baseline"] not in sheet.methods:
        sheet.note(["statistics", "baseline"], unknown(given["baseline"], sheet.methods, "method"))


def _figures(sheet: Sheet) -> None:
    """Check what a figure can only be asked about once there are trials."""
    for number, part in enumerate(sheet.figures):
        keys = part.parameters if part is not None else {}
        if keys.get("metric") is not None and keys["metric"] not in _metric_names(sheet):
            message = unknown(keys["metric"], _metric_names(sheet), "metric of this configuration")
            sheet.note(["figures", number, "metric"], message)
        order = keys.get("order") or []
        if len(set(order)) < len(order):
            sheet.note(["figures", number, "order"], "a method is named twice")
        for name in order:
            if name not in sheet.methods:
                sheet.note(["figures", number, "order"], unknown(name, sheet.methods, "method"))


def _metric_names(sheet: Sheet) -> list[str]:
    return [part.parameters["name"] for part in sheet.metrics if part is not None and "name" in part.parameters]


def _claims(sheet: Sheet, experiment: Experiment | None) -> tuple[Claim, ...]:
    quantities = [*_metric_names(sheet), *COUNTS]
    for method in experiment.methods if experiment is not None else ():
        series: dict[str, Any] = getattr(method.estimator, "series", dict)()
        quantities += [name for name in series if name not in quantities]
    claims = []
    for number, keys in enumerate(sheet.claims):
        if keys is not None:
            claims.append(_claim(keys))
            path: list[str | int] = ["claims", number]
            for text in claims[-1].check:
                _check_terms(sheet, text, [*path, "check"], quantities if experiment else None, parse)
            if isinstance(claims[-1].stated, Stated):
                known = quantities if experiment else None
                _check_terms(sheet, claims[-1].stated.of, [*path, "stated", "of"], known, parse_expression)
    return tuple(claims)


def _check_terms(sheet: Sheet, text: str, path: list[str | int], quantities: list[str] | None, grammar: Any) -> None:
    """Check that a claim can be read and speaks of what is there."""
    try:
        named = terms(grammar(text))
    except ClaimError as error:
        sheet.note(path, str(error))
        return
    for quantity, method in sorted(named):
        if sheet.methods and method not in sheet.methods:
            sheet.note(path, unknown(method, sheet.methods, "method"))
        if quantities is not None and quantity not in quantities:
            sheet.note(path, unknown(quantity, quantities, "metric or series of this configuration"))


def _claim(keys: ClaimKeys) -> Claim:
    check = (keys.check,) if isinstance(keys.check, str) else tuple(keys.check or ())
    stated = keys.stated if isinstance(keys.stated, str) or keys.stated is None else Stated(**asdict(keys.stated))
    return Claim(keys.says, keys.source, check, keys.finding, stated, keys.chosen)
