"""rmpc-bench check."""

from __future__ import annotations

from pathlib import Path

import click

from rmpc_bench import registry
from rmpc_bench.cli import exits, own_code
from rmpc_bench.cli.streams import screen_width
from rmpc_bench.cli.typed_files import TypedPath

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
        from rmpc_bench.cli.component_check import check_component

        return check_component(component, keys, model, group, seconds)
    if component is not None or not configs:
        raise click.UsageError("give one or more configurations, or --component FILE:NAME")
    from rmpc_bench.cli.config_text import full_lines, short_lines
    from rmpc_bench.config.load import load_config
    from rmpc_bench.types import ConfigError
    from rmpc_bench.types.texts import folded

    code = 0
    for path in configs:
        try:
            config = load_config(path, allow_code=allow_code)
            measured = (deep or shards is not None) and "runs" in config.evaluate
            lines = short_lines(path, config, full=full, measured=measured)
            lines += full_lines(config) if full else []
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
            click.echo("\n".join(folded(lines, screen_width())))
        except ConfigError as error:
            # The other files are checked all the same.
            click.echo(str(error), err=True)
            code = exits.USAGE
    return code
