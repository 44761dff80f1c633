"""rmpc-bench check."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rmpc_bench import registry
from rmpc_bench.cli import exits, own_code
from rmpc_bench.cli.tuning import tuning_line
from rmpc_bench.cli.typed_files import TypedPath
from rmpc_bench.config.method_differences import method_differences, short_value

if TYPE_CHECKING:
    from rmpc_bench.config.experiment_config import ExperimentConfig
    from rmpc_bench.types import Noise

GROUPS = [registry.singular(group) for group in registry.BUILT_IN if group != "models"]
"""Kinds of components that have checks."""
MAX_VALUES = 100
"""Characters of the values of a swept path that are shown."""
MAX_WIDTH = 130
"""Characters of a line of the column `plant`."""


@click.command()
@click.argument("configs", nargs=-1, type=TypedPath())
@click.option(
    "--deep",
    is_flag=True,
    help="Add the mismatch of plant and design model, and warnings on stability and convergence.",
)
@click.option("--shards", type=click.IntRange(min=1), metavar="N", help="Measure the time of one of N shards of `run`.")
@own_code.allow_code_option
@own_code.import_option
@click.option("--component", metavar="FILE:NAME", help="Run the conformance checks of a component of a Python file.")
@click.option("--keys", metavar="YAML", help="With --component: its keys, such as '{c: 0.1}'.")
@click.option("--model", metavar="CONFIG|YAML", help="With --component: the linear model that it is designed for.")
@click.option("--group", type=click.Choice(GROUPS), help="With --component: what it is, if that is not clear.")
@click.option("--seconds", type=click.FloatRange(min=1), default=30.0, help="With --component: time limit of a check.")
@exits.guarded
def check(
    configs: tuple[Path, ...],
    deep: bool,
    shards: int | None,
    allow_code: tuple[Path, ...],
    component: str | None,
    keys: str | None,
    model: str | None,
    group: str | None,
    seconds: float,
) -> int:
    """Validate configurations; show plant and design model, differences between the methods, assumptions and cost.

    With --deep or --shards, time and memory are measured: the first runs are computed and reported, and not kept.

    With --component: run the conformance checks of a plant, an estimator, a controller, a reference, a noise, a metric
    or a figure, and print one line per check; exit code 1 if one of them fails.
    """
    if component is not None and not configs:
        from rmpc_bench.cli.component_check import check_component

        return check_component(component, keys, model, group, seconds)
    if component is not None or not configs:
        raise click.UsageError("give one or more configurations, or --component FILE:NAME")
    from rmpc_bench.config.load import load_config
    from rmpc_bench.types import ConfigError

    code = 0
    for path in configs:
        try:
            config = load_config(path, allow_code=allow_code)
            measured = (deep or shards is not None) and "runs" in config.evaluate
            lines = _describe(path, config, measured=measured)
            if measured:
                from rmpc_bench.cli.cost_lines import measured_lines

                lines += measured_lines(path, config, allow_code, shards)
            if deep:
                from rmpc_bench.cli.mismatch import mismatch_lines
                from rmpc_bench.cli.own_components import own_component_lines

                lines += mismatch_lines(config)
                own, failed = own_component_lines(config)
                lines += own
                code = max(code, exits.FINDING_DIFFERS if failed else 0)
            click.echo("\n".join(lines))
        except ConfigError as error:
            # The other files are checked all the same.
            click.echo(str(error), err=True)
            code = exits.USAGE
    return code


def _describe(path: Path, config: ExperimentConfig, *, measured: bool = False) -> list[str]:
    from rmpc_bench.cli.catalogue import aligned
    from rmpc_bench.cli.run_warnings import warning_texts
    from rmpc_bench.execution.cost import megabytes, seconds

    experiment = config.experiment
    lines = [f"{path}: valid", f"  {config.title or config.name}"]
    rows = [("", "plant", "design model"), *_plant_and_model(config)]
    widths = [2 + max(len(row[column]) for row in rows) for column in (0, 1)]
    lines += ["", *(f"  {name:{widths[0]}}{plant:{widths[1]}}{model}".rstrip() for name, plant, model in rows)]
    for each in config.model_facts:
        lines += ["", f"  {each.where}", *aligned(each.facts)] if each.facts else []
    lines += ["", "  differences between the methods"]
    lines += [f"  {name:14}{text}" for name, text in _differences(config)]
    remarks = _remarks(config)
    lines += ["", "  remarks", *remarks] if remarks else []
    lines += ["", "  inherited and left out", *(f"  {text}" for text in config.left_out)] if config.left_out else []
    warned = warning_texts(config)
    lines += ["", "  warnings", *(f"  {text}" for text in warned)] if warned else []
    # Several claims may have an assumption in common.
    assumptions = dict.fromkeys(assumption for claim in config.claims for assumption in claim.assumptions)
    if assumptions:
        lines += ["", "  assumptions (not stated in the paper)", *(f"  - {text}" for text in assumptions)]
    if config.paths:
        lines += ["", f"  sweep of {len(config.points)} points; plant and design model are those of the first"]
        width = 2 + max(len(path) for path in config.paths)
        lines += [f"  {path:{width}}{_values(config, path)}" for path in config.paths]
    points = f"{len(config.points)} points x " if config.paths else ""
    simulated = "runs" in config.evaluate
    hint = "" if measured else "; --deep measures it"
    what = f"{experiment.n_runs} runs" if simulated else "exact moments, no runs"
    if config.stop is not None:
        what = f"at most {what} (stop: {config.stop.text})"
    size = f"{what} x {len(experiment.methods)} methods x {experiment.n_steps} steps"
    shared = f"; {config.n_trials():,} trials; those that points share count once" if config.paths and simulated else ""
    lines += [
        "",
        f"  size          {points}{size}{shared}",
        *(f"  tuning        {line}" for line in tuning_line(config)),
        f"  time          roughly {seconds(config):.0f} s on {config.execution.workers} processes" + hint,
        f"  memory        {megabytes(config):.0f} MB per process for the trajectories of a block",
    ]
    return lines if simulated else lines[:-2]


def _remarks(config: ExperimentConfig) -> list[str]:
    """Return remarks on the plant, the estimators and the controllers that matter for the comparison."""
    from rmpc_bench.components.single_design import SingleDesign
    from rmpc_bench.diagnostics.run_warnings import unlimited_inputs

    experiment = config.experiment
    named = [("plant", experiment.plant.remarks)]
    designs = [
        (method.name, design) for method in experiment.methods for design in (method.estimator, method.controller)
    ]
    named += [(each.where, each.remarks) for each in config.model_facts]
    named += [(name, design.remarks) for name, design in designs]
    found = [f"  {name}: {text}" for name, texts in named for text in texts]
    for name, law in config.first_point["noise"].items():
        size = experiment.plant.nw if name == "process" else experiment.plant.nv
        terms = experiment.scenario.process if name == "process" else experiment.scenario.measurement
        if isinstance(law, dict) and "same" in law and size and all(_silent(term) for term in terms):
            found.append(f"  {name} noise: `same` as that of the design model, which has none")
    keys: dict[tuple[str, ...], list[str]] = {}
    for name in config.methods:
        keys.setdefault(tuple(point.method_keys.get(name, name) for point in config.points), []).append(name)
    equal = (names for names in keys.values() if len(names) > 1)
    found += [f"  {', '.join(names)}: equal methods, so all their trials are equal" for names in equal]
    # A class for one run cannot say whether it has limits.
    laws = [method for method in experiment.methods if not isinstance(method.controller, SingleDesign)]
    found += [f"  {text}" for text in (*_mixed_units(config), *unlimited_inputs(experiment.plant, laws))]
    found += [
        f"  {name}: moving-horizon is a linear filter, of the model at its operating point"
        for name, method in config.first_point["methods"].items()
        if method["estimator"].get("kind") == "moving-horizon" and "at" in method["model"]
    ]
    forms: dict[bool, list[str]] = {True: [], False: []}
    for method in experiment.methods:
        if method.estimator.form is not None:
            forms[method.estimator.form == "filter"].append(method.name)
    if all(forms.values()):
        found.append(f"  x_hat(k) uses y(k) in {', '.join(forms[True])}, and not in {', '.join(forms[False])}")
    return found


def _mixed_units(config: ExperimentConfig) -> Iterator[str]:
    """Yield the metrics that add errors of components with different units."""
    from rmpc_bench.metrics.estimation import EstimationMse
    from rmpc_bench.metrics.tracking import ErrorMetric
    from rmpc_bench.types.plant_info import PlantInfo

    info = PlantInfo.of(config.experiment.plant)
    for metric in config.experiment.metrics:
        if isinstance(metric, EstimationMse | ErrorMetric):
            names = info.outputs if getattr(metric, "of", "") == "output" else info.states
            units = dict.fromkeys(info.units.get(name) or info.units.get(name[0]) or "1" for name in names)
            if len(units) > 1:
                yield f"{metric.name}: adds errors in {', '.join(units)}; the components with large numbers decide it"


def _silent(term: Noise) -> bool:
    """Whether a noise law is known to be always 0."""
    return all(moment is not None and not moment.any() for moment in (term.mean, term.cov))


def _values(config: ExperimentConfig, path: str) -> str:
    values = dict.fromkeys(point.coordinates[path] for point in config.points)
    text = ", ".join(values)
    return text if len(text) <= MAX_VALUES else f"{len(values)} values, from {text[: MAX_VALUES // 2]} ..."


def _plant_and_model(config: ExperimentConfig) -> list[tuple[str, str, str]]:
    from rmpc_bench.config.short_forms import kind_of

    resolved = config.first_point
    plant, model = dict(resolved["plant"]), dict(next(iter(config.methods.values()))["model"])
    rows = [("kind", kind_of(plant), kind_of(model))]
    for part in (plant, model):
        part.pop("kind" if "kind" in part else "file")
    perturbed, replaced = plant.pop("perturb", {}), plant.pop("set", {})
    assumed, nominal = model.pop("noise", None), config.experiment.plant.nominal
    # Parameters of a differential equation have no keys of their own.
    for name in dict.fromkeys([*plant, *model, *perturbed, *replaced]):
        true = short_value(plant[name] if name in plant else nominal.get(name, "-"))
        true = f"{true} x ({perturbed[name]})" if name in perturbed else str(replaced.get(name, true))
        rows.append(
            (name, true if name in {**plant, **perturbed, **replaced} else "-", short_value(model.get(name, "-")))
        )
    initial = resolved["initial"]
    given = {key: initial[key] for key in ("x_hat", "P", "M") if key in initial}
    start = ", ".join(f"{key} = {short_value(each) if isinstance(each, list) else each}" for key, each in given.items())
    noise = resolved["noise"]
    rows += _multiline(
        "noise", _wrapped(_sums(noise) or [short_value(noise)]), "-" if assumed is None else short_value(assumed)
    )
    if "input" in resolved:
        rows += _multiline("input", _wrapped([short_value(resolved["input"])]), "-")
    if "x" not in initial:
        return rows + _multiline("initial", ["x is the plant's own"], start)
    return rows + _multiline("initial", _sums({"x": initial["x"]}) or [f"x = {short_value(initial['x'])}"], start)


def _sums(laws: dict[str, Any]) -> list[str]:
    """Return noise laws with every term of a sum on its own line; no lines where nothing is a sum."""
    lines = []
    for name, law in laws.items():
        terms = law["sum"] if isinstance(law, dict) and "sum" in law else [law]
        lines += [f"{'+' if number else f'{name} ='} {short_value(term)}" for number, term in enumerate(terms)]
    return lines if len(lines) > len(laws) else []


def _wrapped(lines: list[str]) -> list[str]:
    """Break long lines, so that the second column stays visible."""
    from textwrap import wrap

    return [part for line in lines for part in wrap(line, MAX_WIDTH, subsequent_indent="  ", break_on_hyphens=False)]


def _multiline(name: str, plant: list[str], model: str) -> list[tuple[str, str, str]]:
    """Return the rows of an entry whose first column has several lines."""
    return [("" if number else name, line, "" if number else model) for number, line in enumerate(plant)]


def _differences(config: ExperimentConfig) -> list[tuple[str, str]]:
    """Return, per method, the keys whose values differ between the methods."""
    return [
        (name, ", ".join(f"{key} = {short_value(value)}" for key, value in keys.items()) or "nothing")
        for name, keys in method_differences(config.first_point["methods"]).items()
    ]
