"""rmpc-bench suite."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from rmpc_bench.cli import exits, own_code, run_options
from rmpc_bench.cli.run import run
from rmpc_bench.cli.typed_files import TypedPath, from_here
from rmpc_bench.config_file.known_files import known_configs, located, short_names

FOLDER = "configs/suite/"
"""Where the sets of the suite are."""


@click.command()
@click.argument("names", nargs=-1, metavar="[SET]...")
@click.option(
    "-o",
    "--output",
    type=TypedPath(),
    help="Directory for the results; with several sets, the directory above theirs.",
)
@run_options.jobs
@run_options.n_runs
@run_options.add_method
@run_options.smoke
@run_options.fresh
@run_options.dry_run
@run_options.progress
@run_options.quiet
@own_code.allow_code_option
@own_code.import_option
@click.pass_context
def suite(
    context: click.Context,
    /,
    names: tuple[str, ...],
    output: Path | None,
    add_methods: tuple[str, ...],
    allow_code: tuple[Path, ...],
    **options: Any,
) -> None:
    """Run the sets of the suite, or continue them, and show the ranks of the methods on their systems.

    A set is a configuration in configs/suite, such as suite-1: estimators on published uncertain systems, tuned alike.
    All sets are run unless some are named.  Every set is run by `rmpc-bench run`, which has further options.  The file
    of an added method is relative to the current directory.
    """
    places = [place for place in known_configs() if place.startswith(FOLDER)]
    chosen = [_place(name, places) for name in names] or places
    if not chosen:
        raise click.UsageError(f"there is no set in {FOLDER}")
    codes = []
    for place in chosen:
        directory = output if output is None or len(chosen) == 1 else output / short_names(place)[1]
        config = located(place)
        texts, files = from_here(add_methods, config)
        added = {"add_methods": tuple(texts), "allow_code": (*allow_code, *files)}
        codes.append(_code(context, config=config, output=directory, **added, **options))
    sys.exit(next((code for code in exits.MEANINGS if code in codes and code), 0))


def _place(name: str, places: list[str]) -> str:
    """Return the place of a named set."""
    found = [place for place in places if name == place or name in short_names(place)]
    if not found:
        from rmpc_bench.types.errors import unknown

        known = [short_names(place)[1] for place in places]
        raise click.BadParameter(unknown(name, known, "set of the suite"), param_hint="SET")
    return found[0]


def _code(context: click.Context, **options: Any) -> int:
    """Run a set and return the exit code; an interruption ends the suite."""
    try:
        context.invoke(run, **options)
    except SystemExit as end:
        code = int(end.code or 0)
        if code in (exits.INTERRUPTED, exits.TERMINATED):
            raise
        return code
    return 0
