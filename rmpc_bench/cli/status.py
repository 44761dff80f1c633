"""rmpc-bench status."""

from __future__ import annotations

import json
from pathlib import Path

import click

from rmpc_bench.cli import exits
from rmpc_bench.cli.streams import screen_width
from rmpc_bench.cli.typed_files import TypedPath


@click.command()
@click.argument("directory", type=TypedPath(exists=True, file_okay=False))
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@exits.guarded
def status(directory: Path, as_json: bool) -> None:
    """Show how far the computation of an experiment and its shards is.

    Shows finished and failed trials, the rate, the time that is left, and the means of the primary metric so far with
    their standard errors.  It reads progress.json only, so it works on every machine that sees the directory.
    """
    from rmpc_bench.execution.status import read_status
    from rmpc_bench.types.texts import folded

    found = read_status(directory)
    text = "\n".join(folded(str(found).split("\n"), screen_width()))
    click.echo(json.dumps(found.to_json(), indent=2) if as_json else text)
