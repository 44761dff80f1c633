"""rmpc-bench run."""

from __future__ import annotations

import shlex
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from rmpc_bench.cli import exits, own_code
from rmpc_bench.execution.interrupts import held

if TYPE_CHECKING:
    from rmpc_bench.config.experiment_config import ExperimentConfig


class Workers(click.ParamType[int]):
    """A number of worker processes, or `auto`."""

    name = "workers"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Return the number; `auto` is the number of cores this process may use."""
        if value == "auto":
            import os

            return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        try:
            number = int(str(value))
        except ValueError:
            number = 0
        if number < 1:
            self.fail(f"{value!r} is neither a number of processes from 1 on nor 'auto'", param, ctx)
        return number


@dataclass(frozen=True)
class Request:
    """The options of the command line, one field each."""

    config: Path
    output: Path | None
    jobs: int | None
    overrides: tuple[str, ...]
    runs: int | None
    only: tuple[str, ...]
    smoke: bool
    strict: bool
    fresh: bool
    accept_versions: bool
    dry_run: bool
    progress: str
    allow_code: tuple[Path, ...]
    engine: Literal["joblib", "serial"] | None
    add_methods: tuple[str, ...]

    def changes(self) -> list[str]:
        """Options that change what is computed."""
        texts = [f"-s {shlex.quote(text)}" for text in self.overrides if not text.startswith("execution.")]
        texts += [f"--runs {self.runs}"] if self.runs is not None else []
        texts += [f"--only {shlex.quote(name)}" for name in self.only] + ["--smoke"] * self.smoke
        return texts + [f"--add-method {shlex.quote(text)}" for text in self.add_methods]

    def command(self, directory: Path) -> str:
        """Return the same command for another directory."""
        allowed = [f"--allow-code {shlex.quote(str(path))}" for path in self.allow_code]
        return " ".join(["rmpc-bench run", shlex.quote(str(self.config)), *self.changes(), *allowed, f"-o {directory}"])

    def load(self, *, overridden: bool = True, add_methods: Sequence[str] = ()) -> ExperimentConfig:
        """Load the configuration, with or without the overrides and the number of runs.

        Parameters
        ----------
        overridden : whether to use the overrides and the number of runs
        add_methods : texts of methods to add
        """
        from rmpc_bench.config.load import load_config

        changes: dict[str, Any] = {"overrides": self.overrides, "runs": self.runs} if overridden else {}
        changes["add_methods"] = add_methods
        return load_config(self.config, smoke=self.smoke, allow_code=self.allow_code, **changes)


@click.command()
@click.argument("config", type=click.Path(path_type=Path))
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Directory for the results.")
@click.option("-j", "--jobs", type=Workers(), help="Worker processes, or auto.  [default: execution.workers]")
@click.option("-s", "--set", "overrides", multiple=True, metavar="PATH=VALUE", help="Replace one value of the file.")
@click.option("--runs", type=click.IntRange(min=1), help="Number of runs; replaces that of the file.")
@click.option("--only", multiple=True, metavar="METHOD", help="Compute this method only; may be repeated.")
@click.option(
    "--add-method",
    "add_methods",
    multiple=True,
    metavar="'NAME: {...}'",
    help="Add a method to those of the file; the directory keeps it.  May be repeated.",
)
@click.option("--smoke", is_flag=True, help="Use the size of the section `smoke`; results go to results/smoke.")
@click.option("--strict", is_flag=True, help="Exit with 1 if the finding of a claim differs from its record.")
@click.option("--fresh", is_flag=True, help="Rename an existing results directory and compute everything again.")
@click.option("--accept-versions", is_flag=True, help="Use rows that other versions of a library have computed.")
@click.option("-n", "--dry-run", is_flag=True, help="Print the number of trials to compute, and stop.")
@click.option(
    "--engine",
    type=click.Choice(["joblib", "serial"]),
    help="Worker processes, or none: a component that ends its process then ends the experiment.",
)
@click.option(
    "--progress",
    type=click.Choice(["auto", "bar", "plain", "json", "none"]),
    default="auto",
    show_default=True,
    help="How progress is shown on stderr: a bar, lines, a JSON object per line, or not at all.",
)
@own_code.allow_code_option
@own_code.import_option
@exits.guarded
def run(**options: Any) -> int:
    """Run an experiment, or continue it, and write its results.

    After an interruption the same command continues; finished runs are not computed again.  Results go to
    results/<paper>/<name> unless -o names another directory.
    """
    started = time.monotonic()
    # An interrupted import may ignore the interruption, or report a broken library.
    with held():
        import scipy.linalg  # noqa: F401

        import rmpc_bench.config.load  # noqa: F401
        from rmpc_bench.cli.run_warnings import warning_texts
        from rmpc_bench.execution.database import StoreError
        from rmpc_bench.execution.progress import choose
        from rmpc_bench.execution.publish import publish
        from rmpc_bench.execution.results import run as run_experiment

    request = Request(**options)
    config, directory = configured(request)
    for text in warning_texts(config):
        click.echo(f"warning: {text}", err=True)
    _check_names(request.only, config)
    try:
        if request.dry_run:
            return _show_plan(config, directory, request.only)
        if request.fresh:
            _set_aside(directory)
        results = run_experiment(
            config,
            directory=directory,
            jobs=request.jobs,
            only=request.only or None,
            accept_versions=request.accept_versions,
            progress=choose(request.progress),
            engine=request.engine,
        )
    except StoreError as error:
        click.echo(f"{error}\nfor a new directory: {request.command(_free(directory))}", err=True)
        return exits.OCCUPIED
    written = publish(results)
    exits.show(written, time.monotonic() - started)
    if request.strict and config.claims and not results.is_final:
        click.echo("--strict compared no finding: see the line `claims`", err=True)
    return exits.code_of(written, strict=request.strict)


def _check_names(only: Sequence[str], config: ExperimentConfig) -> None:
    from rmpc_bench.registry import unknown

    for name in only:
        if name not in config.methods:
            raise click.BadParameter(unknown(name, config.methods, "method"), param_hint="--only")


def configured(request: Request) -> tuple[ExperimentConfig, Path]:
    """Load the configuration with the methods that its directory has, and say what is added or left out."""
    config = request.load()
    directory = request.output or _directory(request, config)
    stored = {} if request.fresh else _stored_methods(directory, config)
    if request.add_methods:
        # Before those of the directory, so that an error names the text that is given now.
        config = request.load(add_methods=request.add_methods)
    if stored:
        config = request.load(add_methods=[*{**stored, **config.added}.values()])
    for line in _said(config, stored, directory):
        click.echo(line, err=True)
    for text in config.left_out:
        click.echo(f"left out: {text}", err=True)
    return config, directory


def _stored_methods(directory: Path, config: ExperimentConfig) -> dict[str, str]:
    """Return methods that were added to the results of this experiment and that its configuration does not have."""
    from rmpc_bench.execution.database import FILE, MissingError
    from rmpc_bench.execution.store import Store
    from rmpc_bench.execution.stored_experiment import added_methods

    if not (directory / FILE).exists():
        return {}
    try:
        with Store(directory, writable=False) as store:
            found = added_methods(store) if store.meta("experiment") == config.hash else {}
    except MissingError:
        # An earlier version, which could not add methods, has written the store.
        return {}
    return {name: text for name, text in found.items() if name not in config.methods}


def _said(config: ExperimentConfig, stored: Mapping[str, str], directory: Path) -> Iterator[str]:
    """Say which methods are added, and what follows for the intervals."""
    if not config.added:
        return
    for name, text in config.added.items():
        if name not in stored:
            yield f"added: {name}"
        elif text == stored[name]:
            yield f"added before and kept: {name} (a directory without it: -o DIR, or --fresh)"
        else:
            yield f"added: {name}, in place of another method of this name in {directory}, whose trials are kept"
    n = len(config.methods) - 1
    yield f"claims rest on the methods that they name; intervals of verdicts are simultaneous for {n} methods now"


def _directory(request: Request, config: ExperimentConfig) -> Path:
    """Default directory; an override that changes the experiment gets one of its own."""
    name = config.name
    if request.overrides and request.load(overridden=False).full_hash != config.full_hash:
        name = f"{name}~{config.full_hash[:6]}"
    parent = Path("results") / ("smoke" if request.smoke else "") / (config.paper or "")
    if name != config.name:
        click.echo(f"the overrides change the experiment: results go to {parent / name}", err=True)
    return parent / name


def _show_plan(config: ExperimentConfig, directory: Path, only: Sequence[str]) -> int:
    from rmpc_bench.execution.database import FILE
    from rmpc_bench.execution.other_code import rows_of_other_code
    from rmpc_bench.execution.runner import pending
    from rmpc_bench.execution.store import Store

    names = [method.name for method in config.experiment.methods if not only or method.name in only]
    left = total = config.n_trials(names)
    apart = None
    if (directory / FILE).exists():
        with Store(directory, writable=False) as store:
            store.check(config.hash, config.shared, config.own.names())
            left = sum(len(task.runs) for task in pending(config, store, names))
            apart = rows_of_other_code(config, store, names)
    click.echo(f"{config.name}: {left} of {total} trials to compute ({', '.join(names)})")
    if apart:
        click.echo("\n".join(apart.said("; they would be computed again", ": they would be computed again")))
    click.echo(f"results go to {directory}; nothing was computed (--dry-run)")
    return 0


def _set_aside(directory: Path) -> None:
    """Rename a directory; nothing is ever deleted."""
    from rmpc_bench.execution.database import FILE
    from rmpc_bench.execution.store import Store

    if (directory / FILE).exists():  # without it the directory counts as new
        if directory.resolve() in (Path.cwd(), *Path.cwd().parents):
            raise click.BadParameter("cannot rename the directory it stands in", param_hint="--fresh")
        old = directory.with_name(f"{directory.name}.{datetime.now():%Y%m%d-%H%M%S}")
        old = _free(old) if old.exists() else old
        with Store(directory):  # nobody else may be writing to it
            directory.rename(old)
        click.echo(f"the old results are in {old}", err=True)


def _free(directory: Path) -> Path:
    """Return a name that is not taken, made from a directory's by a number."""
    names = (directory.with_name(f"{directory.name}-{number}") for number in count(2))
    return next(name for name in names if not name.exists())
