"""Options that several verbs have in common, and the types of their values.  It imports nothing but click."""

from __future__ import annotations

import os
import traceback
from collections.abc import Collection
from importlib import import_module
from pathlib import Path
from typing import Any

import click

imported: list[str] = []  # modules that `--import` has imported, which a process of its own imports too


class TypedPath(click.Path):
    """A path, with one of some endings; an empty one, as of a shell variable, would be the current directory."""

    def __init__(self, endings: Collection[str] = (), **options: Any) -> None:
        super().__init__(path_type=Path, **options)
        self.endings = endings

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path."""
        if not os.fspath(value):
            self.fail("a path must not be empty", param, ctx)
        if self.endings and Path(value).suffix.lower() not in self.endings:
            self.fail(f"{value}: the ending must be one of {', '.join(self.endings)}", param, ctx)
        return super().convert(value, param, ctx)


def workers(value: str) -> int:
    """Return a number of worker processes; `auto` are the cores of this process, in a batch job those of the job."""
    if value == "auto":
        from rmpc_bench.execution.shards import n_cores

        return n_cores(os.environ)
    try:
        number = int(value)
    except ValueError:
        number = 0
    if number < 1:
        raise click.BadParameter(f"{value!r} is neither a number of processes from 1 on nor 'auto'")
    return number


def _import(context: click.Context, parameter: click.Parameter, names: tuple[str, ...]) -> None:
    """Import modules; a failure is an error of the command line."""
    for name in names:
        try:
            import_module(name)
            imported.append(name)
        except (Exception, SystemExit) as error:
            frames = traceback.extract_tb(error.__traceback__)
            last = frames[-1] if frames and not frames[-1].filename.startswith("<frozen") else None
            where = "" if last is None or last.filename == __file__ else f" at {last.filename}:{last.lineno}"
            text = f"{name} cannot be imported{where} ({type(error).__name__}: {error})"
            raise click.BadParameter(text, context, parameter) from None


jobs = click.option(
    "-j", "--jobs", type=workers, help="Largest number of workers, or auto.  [default: execution.workers]"
)
n_runs = click.option("--runs", type=click.IntRange(min=1), help="Number of runs; replaces that of the configuration.")
add_method = click.option(
    "--add-method",
    "add_methods",
    multiple=True,
    metavar="'NAME: {...}'",
    help="Add a method to those of the configuration; the directory keeps it.  May be repeated.",
)
smoke = click.option("--smoke", is_flag=True, help="Use the size of the section `smoke`; results go to results/smoke.")
fresh = click.option("--fresh", is_flag=True, help="Rename an existing results directory and compute everything again.")
dry_run = click.option("-n", "--dry-run", is_flag=True, help="Print the number of trials to compute, and stop.")
progress = click.option(
    "--progress",
    type=click.Choice(["auto", "bar", "plain", "json", "none"]),
    default="auto",
    show_default=True,
    help="How progress is shown on stderr: a bar, lines, a JSON object per line, or not at all.",
)
quiet = click.option("-q", "--quiet", is_flag=True, help="Show errors and the result only.")
allow_code = click.option(
    "--allow-code",
    multiple=True,
    type=TypedPath(exists=True),
    metavar="PATH",
    help="Load files with code from here, too: a file or a directory; may be repeated.",
)
import_first = click.option(
    "--import",
    "modules",
    multiple=True,
    metavar="MODULE",
    expose_value=False,
    callback=_import,
    is_eager=True,
    help="Import an installed module that registers components; may be repeated.",
)
