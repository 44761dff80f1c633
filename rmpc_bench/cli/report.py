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
    from rmpc_bench.execution.publish import publish
    from rmpc_bench.execution.results import load_results

    code = 0
    for directory in directories:
        written = publish(load_results(directory))
        exits.show(written)
        code = max(code, exits.code_of(written, strict=False))
    return code
