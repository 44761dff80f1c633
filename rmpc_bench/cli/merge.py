"""rmpc-bench merge."""

from __future__ import annotations

from pathlib import Path

import click

from rmpc_bench.cli import exits
from rmpc_bench.cli.typed_files import TypedPath


@click.command()
@click.argument("directory", type=TypedPath(exists=True, file_okay=False))
@click.option("--partial", is_flag=True, help="Join the runs that are there, also while other shards are computed.")
@exits.guarded
def merge(directory: Path, partial: bool) -> int:
    """Join the shards of a directory and write its tables, figures and claims.

    The shards of `rmpc-bench run --shard I/N` must belong to one experiment and be computed by the same code.  They
    stay as they are.  Runs may be missing with --partial only; `rmpc-bench run --missing` computes them.
    """
    from rmpc_bench.execution.merge import merge as join
    from rmpc_bench.publishing.publish import publish
    from rmpc_bench.results.results import load_results

    merged = join(directory, partial=partial, say=lambda text: click.echo(text, err=True))
    click.echo(f"joined: {', '.join(shard.name for shard in merged.shards)}", err=True)
    if merged.missing:
        click.echo("\n".join(["incomplete:", *merged.missing]), err=True)
    written = publish(load_results(directory))
    exits.show(written)
    return exits.code_of(written, strict=False)
