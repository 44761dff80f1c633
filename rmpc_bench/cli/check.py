"""rmpc-bench check."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rmpc_bench.cli import exits

if TYPE_CHECKING:
    from rmpc_bench.experiment.config import ExperimentConfig


@click.command()
@click.argument("configs", nargs=-1, required=True, type=click.Path(path_type=Path))
@exits.guarded
def check(configs: tuple[Path, ...]) -> int:
    """Validate configurations; show truth beside belief, what differs between the methods, and what it will cost."""
    from rmpc_bench.experiment.config import load_config
    from rmpc_bench.types import ConfigError

    code = 0
    for path in configs:
        try:
            click.echo("\n".join(_describe(path, load_config(path))))
        except ConfigError as error:  # the other files are still worth a look
            click.echo(str(error), err=True)
            code = exits.USAGE
    return code


def _describe(path: Path, config: ExperimentConfig) -> list[str]:
    experiment = config.experiment
    lines = [f"{path}: valid", f"  {config.title or config.name}"]
    rows = [("", "truth", "belief"), *_truth_and_belief(config)]
    widths = [2 + max(len(row[column]) for row in rows) for column in (0, 1)]
    lines += ["", *(f"  {name:{widths[0]}}{truth:{widths[1]}}{belief}" for name, truth, belief in rows)]
    lines += ["", "  what differs between the methods"]
    lines += [f"  {name:14}{text}" for name, text in _differences(config)]
    chosen = [claim.chosen for claim in config.claims if claim.chosen]
    if chosen:
        lines += ["", "  left open by the paper and chosen", *(f"  - {text}" for text in chosen)]
    trials = experiment.n_runs * len(experiment.methods)
    steps = trials * experiment.n_steps
    lines += [
        "",
        f"  size          {experiment.n_runs} runs x {len(experiment.methods)} methods x {experiment.n_steps} steps",
        f"  cost          about {_seconds(steps, config):.0f} s on {config.execution.workers} processes, "
        f"{_megabytes(config):.0f} MB each for the trajectories of a block",
    ]
    return lines


def _truth_and_belief(config: ExperimentConfig) -> list[tuple[str, str, str]]:
    resolved = config.resolved
    plant, model = dict(resolved["plant"]), dict(next(iter(config.methods.values()))["model"])
    rows = [("kind", str(plant.pop("kind")), str(model.pop("kind")))]
    changed = {**plant.pop("perturb", {}), **plant.pop("set", {})}
    assumed = model.pop("noise", None)
    for name in dict.fromkeys([*plant, *model]):
        truth = _short(plant.get(name, "-"))
        rows.append((name, f"{truth} x ({changed[name]})" if name in changed else truth, _short(model.get(name, "-"))))
    rows.append(("noise", _short(resolved["noise"]), _short(assumed)))
    initial = resolved["initial"]
    rows.append(("start", f"x = {_short(initial['x'])}", f"x_hat = {initial['x_hat']}, P = {initial['P']}"))
    return rows


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
    from rmpc_bench.experiment.yaml import dump, plain

    if isinstance(value, str):
        return value
    return f"{value:g}" if isinstance(value, float) else " ".join(dump(plain(value)).split())


def _seconds(steps: int, config: ExperimentConfig) -> float:
    """Estimate from the number of steps: 4 us each in the loop, 0.05 us per plant substep."""
    substeps = getattr(config.experiment.plant, "n_substeps", 1)
    return math.ceil(2.0 + steps * (4e-6 + 5e-8 * substeps) / config.execution.workers)


def _megabytes(config: ExperimentConfig) -> float:
    experiment = config.experiment
    plant = experiment.plant
    width = 2 * plant.nx + plant.nw + plant.nv + plant.ny + plant.nu
    return math.ceil(8e-6 * 2 * config.execution.block * experiment.n_steps * width)
