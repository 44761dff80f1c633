"""rmpc-bench check: configurations, or with --component the conformance checks of one component of the user."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rmpc_bench import registry
from rmpc_bench.cli import exits, shared_options
from rmpc_bench.cli.shared_options import TypedPath
from rmpc_bench.cli.streams import echo_folded
from rmpc_bench.received.consent import NO_CODE

if TYPE_CHECKING:
    from rmpc_bench.components.consent import CodeAccess
    from rmpc_bench.config_file.tree import Map, Mark
    from rmpc_bench.conformance.systems import LinearSystem


GROUPS = [registry.singular(group) for group in registry.BUILT_IN if group != "models"]
"""Kinds of components that have checks."""


@click.command()
@click.argument("configs", nargs=-1, type=TypedPath())
@click.option(
    "--deep",
    is_flag=True,
    help="Add the mismatch of plant and design model, and warnings on stability and convergence.",
)
@click.option("--full", is_flag=True, help="Add every setting, the assumptions and all remarks.")
@click.option("--shards", type=click.IntRange(min=1), metavar="N", help="Measure the time of one of N shards of `run`.")
@shared_options.allow_code
@shared_options.import_first
@click.option("--component", metavar="FILE:NAME", help="Run the conformance checks of a component of a Python file.")
@click.option("--keys", metavar="YAML", help="With --component: its keys, such as '{c: 0.1}'.")
@click.option("--model", metavar="CONFIG|YAML", help="With --component: the linear model that it is designed for.")
@click.option("--group", type=click.Choice(GROUPS), help="With --component: what it is, if that is not clear.")
@click.option("--seconds", type=click.FloatRange(min=1), default=30.0, help="With --component: time limit of a check.")
@exits.guarded
def check(
    configs: tuple[Path, ...],
    deep: bool,
    full: bool,
    shards: int | None,
    allow_code: tuple[Path, ...],
    component: str | None,
    keys: str | None,
    model: str | None,
    group: str | None,
    seconds: float,
) -> int:
    """Validate configurations; show size, methods, plant, design model and remarks, the severest first.

    With --deep or --shards, time and memory are measured: the first runs are computed and reported, and not kept.

    With --component: run the conformance checks of a plant, an estimator, a controller, a reference, a noise, a metric
    or a figure, and print one line per check; exit code 1 if one of them fails.
    """
    if component is not None and not configs:
        return _check_component(component, keys, model, group, seconds)
    if component is not None or not configs:
        raise click.UsageError("give one or more configurations, or --component FILE:NAME")
    from rmpc_bench.types import ConfigError

    code = 0
    for path in configs:
        try:
            code = max(code, _check_config(path, allow_code, deep=deep, full=full, shards=shards))
        except ConfigError as error:
            # The other files are checked all the same.
            click.echo(str(error), err=True)
            code = exits.USAGE
    return code


def _check_config(path: Path, allow_code: tuple[Path, ...], *, deep: bool, full: bool, shards: int | None) -> int:
    """Show what a configuration is; the exit code says whether a check of an own component fails."""
    from rmpc_bench.cli.config_text import full_lines, short_lines
    from rmpc_bench.config.load import load_config

    config, failed = load_config(path, allow_code=allow_code), False
    measured = (deep or shards is not None) and "runs" in config.evaluate
    lines = short_lines(path, config, full=full, measured=measured)
    lines += full_lines(config) if full else []
    if measured:
        from rmpc_bench.cli.deep_check import measured_lines

        lines += measured_lines(path, config, allow_code, shards)
    if deep:
        from rmpc_bench.cli.deep_check import mismatch_lines, own_component_lines

        lines += mismatch_lines(config)
        own, failed = own_component_lines(config)
        lines += own
    echo_folded(lines)
    return exits.FINDING_DIFFERS if failed else 0


def _check_component(component: str, keys: str | None, model: str | None, group: str | None, seconds: float) -> int:
    """Check a component and print the table; the exit code is 1 where a check of the class `error` fails."""
    from rmpc_bench.components.reference import split_reference
    from rmpc_bench.config_file.tree import Map
    from rmpc_bench.config_file.yaml import parse
    from rmpc_bench.conformance.process import check_subject
    from rmpc_bench.conformance.subject import subject_of
    from rmpc_bench.types import DesignError

    parts = split_reference(component)
    if parts is not None and os.environ.get(NO_CODE) == "1":
        raise click.UsageError(f"{NO_CODE}=1 refuses all Python files")
    if parts is not None and not Path(parts[0]).is_file():
        raise click.UsageError(f"there is no file {parts[0]}")
    given = None if keys is None else parse(keys, "--keys")
    if given is not None and not isinstance(given, Map):
        raise click.UsageError("--keys must be a YAML mapping, such as '{c: 0.1}'")
    try:
        subject = subject_of(component, f"{group}s" if group else "", given, written=given is not None)
        system = None if model is None else _system(model)
    except DesignError as error:
        raise click.UsageError(str(error)) from None
    report = check_subject(subject, system=system, seconds=seconds)
    click.echo(str(report))
    return 0 if report.passed else 1


def _system(text: str) -> LinearSystem:
    """Return the linear system of a configuration's first method, or of the YAML mapping of a model with its key Ts."""
    from rmpc_bench.components.consent import NO_ACCESS, CodeAccess
    from rmpc_bench.config.load import load_config
    from rmpc_bench.config_file.tree import Map, Mark
    from rmpc_bench.config_file.yaml import parse
    from rmpc_bench.conformance.systems import LinearSystem
    from rmpc_bench.types import DesignError

    if text.lstrip().startswith("{"):
        tree: Any = parse(text, "--model")
        tree = tree.copy()
        Ts = float(tree.pop("Ts", 1.0))
        model = _model(tree, tree.mark, NO_ACCESS, Ts=Ts, n_steps=1).at(0)
    else:
        config, mark = load_config(Path(text)), Mark(text, 1, 1)
        plant, Ts = config.experiment.plant, config.experiment.plant.Ts
        tree = Map(next(iter(config.methods.values()))["model"], mark=mark)
        size = {"Ts": Ts, "n_steps": config.experiment.n_steps, "plant": plant}
        model = _model(tree, mark, CodeAccess.of(Path(text)), **size)
        model = model.at(0) if model.is_linear_model else model
    if not model.is_linear_model:
        raise DesignError("the checks need a linear model; `rmpc-bench check --deep CONFIG` checks with other ones")
    return LinearSystem.of(model, Ts)


def _model(tree: Map, mark: Mark, access: CodeAccess, **size: Any) -> Any:
    """Build the model of a mapping."""
    from rmpc_bench.config_file.component import read_component

    return read_component("models", tree, ["model"], mark=mark, access=access).build(**size)
