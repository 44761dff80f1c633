"""rmpc-bench report."""

from __future__ import annotations

from pathlib import Path

import click

from rmpc_bench.cli import exits


@click.command()
@click.argument("directories", nargs=-1, required=True, type=click.Path(path_type=Path, exists=True, file_okay=False))
@exits.guarded
def report(directories: tuple[Path, ...]) -> int:
    """Write tables and figures again from stored trials; nothing is simulated."""
    from rmpc_bench.cli.publish import publish
    from rmpc_bench.config.load import load_config
    from rmpc_bench.execution import manifest
    from rmpc_bench.execution.runner import RESOLVED
    from rmpc_bench.execution.store import FILE, MissingError

    code = 0
    for directory in directories:
        if not (directory / FILE).exists():
            raise MissingError(f"{directory}: there is no {FILE}; fill the directory with `rmpc-bench run`")
        config = load_config(directory / RESOLVED)
        outcome = publish(config, directory, manifest.read(directory).get("modified", []))
        click.echo(outcome.screen)
        code = max(code, outcome.code(strict=False))
    return code
