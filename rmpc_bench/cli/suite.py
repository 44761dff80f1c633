"""rmpc-bench suite."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from rmpc_bench.cli import exits, shared_options
from rmpc_bench.cli.run import run
from rmpc_bench.cli.shared_options import TypedPath
from rmpc_bench.config_file.known_files import known_configs, located, short_names

SETS = "configs/suite/"  # where the sets of the suite are


@click.command()
@click.argument("names", nargs=-1, metavar="[SET]...")
@click.option(
    "-o", "--output", type=TypedPath(), help="Directory for the results; with several sets, the directory above theirs."
)
@shared_options.jobs
@shared_options.n_runs
@shared_options.add_method
@shared_options.smoke
@shared_options.fresh
@shared_options.dry_run
@shared_options.progress
@shared_options.quiet
@shared_options.allow_code
@shared_options.import_first
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
    places = [place for place in known_configs() if place.startswith(SETS)]
    chosen = [_place(name, places) for name in names] or places
    if not chosen:
        raise click.UsageError(f"there is no set in {SETS}")
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


def from_here(texts: Sequence[str], config: Path) -> tuple[list[str], list[Path]]:
    """Name the files of typed methods relative to the directory of a configuration, and return those that are there.

    Who types the name of a file allows its code.  A text that cannot be read and the name of a file that is not there
    stay as they are.
    """
    from rmpc_bench.config_file.tree import plain
    from rmpc_bench.config_file.yaml import one_line, parse
    from rmpc_bench.types import ConfigError

    found, files = [], list[Path]()
    for text in texts:
        try:
            tree = plain(parse(text, "--add-method"))
        except ConfigError:
            tree = None
        before = len(files)
        if isinstance(tree, dict):
            for method in tree.values():
                for component in method.values() if isinstance(method, dict) else ():
                    _rename(component, config, files)
        found.append(
            ", ".join(f"{name}: {one_line(method)}" for name, method in tree.items()) if len(files) > before else text
        )
    return found, files


def _rename(component: Any, config: Path, files: list[Path]) -> None:
    """Change the key `file` of a component whose file is in the current directory."""
    if not isinstance(component, dict) or not isinstance(component.get("file"), str):
        return
    file, colon, name = component["file"].partition(":")
    if file and not os.path.isabs(file) and os.path.isfile(file):
        files.append(Path(file))
        component["file"] = Path(os.path.relpath(file, config.absolute().parent)).as_posix() + colon + name
