"""rmpc-bench import: runs that another program has made."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import click

from rmpc_bench.cli import exits
from rmpc_bench.cli.shared_options import TypedPath


def roles(value: str) -> dict[str, str]:
    """Return role -> column; a comma in the name of a column is followed by no role."""
    parts = [part.partition("=") for part in re.split(r",(?=[a-z]+(?::[^=,]+)?=)", value)]
    if wrong := next(("".join(part) for part in parts if not part[0] or not part[2]), ""):
        raise click.BadParameter(f"{wrong!r}: expected ROLE=COLUMN, such as method=Filter")
    return {role.strip(): column.strip() for role, _, column in parts}


@click.command("import")
@click.argument("table", type=TypedPath())
@click.option("-o", "--output", "directory", type=TypedPath(), help="Directory to fill.  [default: results/TABLE]")
@click.option("--settings", type=TypedPath(), metavar="FILE.yaml", help="Title, metrics, laws, statistics, claims ...")
@click.option("--baseline", metavar="METHOD", help="Method with which the others are compared.  [default: the first]")
@click.option("--metric", "metrics", multiple=True, metavar="NAME", help="A metric; may be repeated.")
@click.option(
    "--columns",
    type=roles,
    metavar="ROLE=NAME,..",
    help="Columns of run, method, status, sweep:PATH, parameter:NAME, metric:NAME.  [default: those so named]",
)
@click.option("--wide", default="", metavar="PATTERN", help="The table has a row per run: '{metric}_{method}'.")
@click.option("--decimal", default=".", metavar="SIGN", help="Sign before the fraction of a number.  [default: .]")
@click.option("--separator", default=",", metavar="SIGN", help="Sign between two cells.  [default: ,]")
@click.option(
    "--missing",
    type=click.Choice(["error", "drop", "failed"]),
    default="error",
    show_default=True,
    help="Runs that a method lacks, and empty metrics: an error, left out, or failed runs.",
)
@click.option(
    "--keep-last", default="", metavar="COLUMN", help="Of several rows of a run, keep the largest value here."
)
@click.option("--unpaired", is_flag=True, help="Run i of two methods had other draws: compare without pairs.")
@click.option("--add", is_flag=True, help="Add methods or runs to those of the directory (-o).")
@click.option("-n", "--dry-run", is_flag=True, help="Print what would be imported, and stop.")
@click.option("--max-rows", type=click.IntRange(min=1), default=1_000_000, show_default=True, help="Most rows.")
@exits.guarded
def import_(table: Path, directory: Path | None, dry_run: bool, **given: Any) -> int:
    """Compare runs of your own simulator: make a directory of results from a table of them.

    TABLE is a .csv, .csv.gz or .parquet file with a row per run and method: the columns run, method, status (empty, ok,
    1 or true for a run that has finished) and one per metric.  Run i of every method must have the same random draws.
    Other columns of numbers that are equal for all methods in every run are parameters.

    The verbs report, compare, pack, verify, status and show take the directory as any other one.
    """
    from rmpc_bench.importing.directory import prepare_import, store_runs
    from rmpc_bench.publishing.publish import publish
    from rmpc_bench.results.results import read_results
    from rmpc_bench.types import DesignError

    try:
        prepared, place = prepare_import(str(table), directory, **{key: each for key, each in given.items() if each})
    except DesignError as error:
        raise click.UsageError(f"--{error.parameter}: {error}") from None
    for text in prepared.remarks:
        click.echo(text, err=True)
    if dry_run:
        click.echo("\n".join([*prepared.facts, f"nothing is written; without -n to {place}"]))
        return 0
    store_runs(prepared, place)
    return exits.show(publish(read_results(place)))
