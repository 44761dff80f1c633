"""rmpc-bench check."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rmpc_bench.cli import exits

if TYPE_CHECKING:
    from rmpc_bench.config.experiment_config import ExperimentConfig

MOST_VALUES = 100
"""Characters of the values of a swept path that are shown."""
MOST_WIDE = 130
"""Characters of a line of the truth."""


@click.command()
@click.argument("configs", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--deep", is_flag=True, help="Add how far the plant is from the model, and warnings of the closed loops.")
@exits.guarded
def check(configs: tuple[Path, ...], deep: bool) -> int:
    """Validate configurations; show truth beside belief, what differs between the methods, and what it will cost."""
    from rmpc_bench.config.load import load_config
    from rmpc_bench.types import ConfigError

    code = 0
    for path in configs:
        try:
            config = load_config(path)
            lines = _describe(path, config)
            if deep:
                from rmpc_bench.cli.mismatch import deep_lines

                lines += deep_lines(config)
            click.echo("\n".join(lines))
        except ConfigError as error:  # the other files are still worth a look
            click.echo(str(error), err=True)
            code = exits.USAGE
    return code


def _describe(path: Path, config: ExperimentConfig) -> list[str]:
    experiment = config.experiment
    lines = [f"{path}: valid", f"  {config.title or config.name}"]
    rows = [("", "truth", "belief"), *_truth_and_belief(config)]
    widths = [2 + max(len(row[column]) for row in rows) for column in (0, 1)]
    lines += ["", *(f"  {name:{widths[0]}}{truth:{widths[1]}}{belief}".rstrip() for name, truth, belief in rows)]
    lines += ["", "  what differs between the methods"]
    lines += [f"  {name:14}{text}" for name, text in _differences(config)]
    remarks = _remarks(config)
    lines += ["", "  worth knowing", *remarks] if remarks else []
    assumptions = [assumption for claim in config.claims for assumption in claim.assumptions]
    if assumptions:
        lines += ["", "  assumptions where the paper is silent", *(f"  - {text}" for text in assumptions)]
    if config.paths:
        lines += ["", f"  sweep of {len(config.points)} points; truth and belief are those of the first"]
        width = 2 + max(len(path) for path in config.paths)
        lines += [f"  {path:{width}}{_values(config, path)}" for path in config.paths]
    points = f"{len(config.points)} points x " if config.paths else ""
    simulated = "runs" in config.evaluate
    what = f"{experiment.n_runs} runs" if simulated else "exact moments, no runs"
    size = f"{what} x {len(experiment.methods)} methods x {experiment.n_steps} steps"
    shared = f"; {config.n_trials():,} trials, what points share counted once" if config.paths and simulated else ""
    lines += [
        "",
        f"  size          {points}{size}{shared}",
        f"  cost          about {_seconds(config):.0f} s on {config.execution.workers} processes, "
        f"{_megabytes(config):.0f} MB each for the trajectories of a block",
    ]
    return lines if simulated else lines[:-1]


def _remarks(config: ExperimentConfig) -> list[str]:
    """What a user should know of the plant and of the designs, before they are compared."""
    import numpy as np

    from rmpc_bench.types import HasRemarks

    experiment = config.experiment
    named = [("plant", experiment.plant), *((method.name, method.estimator) for method in experiment.methods)]
    found = [f"  {name}: {text}" for name, part in named if isinstance(part, HasRemarks) for text in part.remarks]
    for name, law in config.first_point["noise"].items():
        size = experiment.plant.nw if name == "process" else experiment.plant.nv
        terms = experiment.scenario.process if name == "process" else experiment.scenario.measurement
        if isinstance(law, dict) and "same" in law and size and all(_silent(term) for term in terms):
            found.append(f"  {name} noise: `same` as the model's, which has none")
    forms: dict[bool, list[str]] = {True: [], False: []}
    for method in experiment.methods:
        gain, form = getattr(method.estimator, "L", None), getattr(method.estimator, "form", None)
        if gain is not None or form is not None:
            uses_y = form == "filter" if form is not None else bool(np.any(gain))
            forms[uses_y].append(method.name)
    if all(forms.values()):
        found.append(f"  x_hat(k) uses y(k) in {', '.join(forms[True])}, and not in {', '.join(forms[False])}")
    return found


def _silent(term: Any) -> bool:
    """Whether a law of noise is known to be 0 always."""
    return all(hasattr(term, name) and not getattr(term, name).any() for name in ("mean", "cov"))


def _values(config: ExperimentConfig, path: str) -> str:
    values = dict.fromkeys(point.coordinates[path] for point in config.points)
    text = ", ".join(values)
    return text if len(text) <= MOST_VALUES else f"{len(values)} values, from {text[: MOST_VALUES // 2]} ..."


def _truth_and_belief(config: ExperimentConfig) -> list[tuple[str, str, str]]:
    resolved = config.first_point
    plant, model = dict(resolved["plant"]), dict(next(iter(config.methods.values()))["model"])
    rows = [("kind", str(plant.pop("kind")), str(model.pop("kind")))]
    changed = {**plant.pop("perturb", {}), **plant.pop("set", {})}
    assumed = model.pop("noise", None)
    for name in dict.fromkeys([*plant, *model]):
        truth = _short(plant.get(name, "-"))
        rows.append((name, f"{truth} x ({changed[name]})" if name in changed else truth, _short(model.get(name, "-"))))
    initial = resolved["initial"]
    begins = {key: initial[key] for key in ("x_hat", "P", "M") if key in initial}
    start = ", ".join(f"{key} = {_short(each) if isinstance(each, list) else each}" for key, each in begins.items())
    noise = resolved["noise"]
    rows += _beside("noise", _wrapped(_sums(noise) or [_short(noise)]), "-" if assumed is None else _short(assumed))
    return rows + _beside("start", _sums({"x": initial["x"]}) or [f"x = {_short(initial['x'])}"], start)


def _sums(laws: dict[str, Any]) -> list[str]:
    """Laws with every term of a sum on a line of its own; no lines where nothing is a sum."""
    lines = []
    for name, law in laws.items():
        terms = law["sum"] if isinstance(law, dict) and "sum" in law else [law]
        lines += [f"{'+' if number else f'{name} ='} {_short(term)}" for number, term in enumerate(terms)]
    return lines if len(lines) > len(laws) else []


def _wrapped(lines: list[str]) -> list[str]:
    """Long lines broken, so that the belief stays in sight."""
    from textwrap import wrap

    return [part for line in lines for part in wrap(line, MOST_WIDE, subsequent_indent="  ", break_on_hyphens=False)]


def _beside(name: str, truth: list[str], belief: str) -> list[tuple[str, str, str]]:
    """Rows of a truth of several lines."""
    return [("" if number else name, line, "" if number else belief) for number, line in enumerate(truth)]


def _differences(config: ExperimentConfig) -> list[tuple[str, str]]:
    """Per method, the keys whose value is not the same in all methods."""
    flat = {name: dict(_leaves(parts)) for name, parts in config.methods.items()}
    keys = dict.fromkeys(key for leaves in flat.values() for key in leaves)
    differing = [key for key in keys if len({repr(leaves.get(key)) for leaves in flat.values()}) > 1]
    return [
        (name, ", ".join(f"{key} = {_short(leaves[key])}" for key in differing if key in leaves) or "nothing")
        for name, leaves in flat.items()
    ]


def _leaves(tree: Any, path: str = "") -> list[tuple[str, Any]]:
    if not isinstance(tree, dict):
        return [(path, tree)]
    return [leaf for key, value in tree.items() for leaf in _leaves(value, f"{path}.{key}" if path else key)]


def _short(value: Any) -> str:
    from rmpc_bench.config.tree import plain
    from rmpc_bench.config.writer import dump

    if isinstance(value, str):
        return value
    if isinstance(value, list) and value and all(isinstance(entry, int | float) for entry in value):
        return f"[{', '.join(f'{entry:g}' for entry in value)}]"
    return f"{value:g}" if isinstance(value, float) else " ".join(dump(plain(value)).split())


def _seconds(config: ExperimentConfig) -> float:
    """Estimate from the number of steps: 50 us for a block, 2.5 us for a run and what costly parts take beside.

    Starting and reporting takes 2 s; what points of a sweep share counts once.
    """
    from rmpc_bench.types import HasCost

    seen, total = set[str](), 0.0
    for point in config.points if "runs" in config.evaluate else ():
        experiment = point.experiment
        for name, key in point.method_keys.items():
            if key not in seen:
                method = experiment.method(name)
                parts = (experiment.plant, method.estimator, method.controller)
                per_run = 2.5e-6 + sum(part.cost_per_step for part in parts if isinstance(part, HasCost))
                n_blocks = math.ceil(experiment.n_runs / config.execution.block)
                total += experiment.n_steps * (5e-5 * n_blocks + per_run * experiment.n_runs)
            seen.add(key)
    return math.ceil(2.0 + total / config.execution.workers)


def _megabytes(config: ExperimentConfig) -> float:
    experiment = config.experiment
    plant = experiment.plant
    width = 2 * plant.nx + plant.nw + plant.nv + plant.ny + plant.nu
    return math.ceil(8e-6 * 2 * config.execution.block * experiment.n_steps * width)
