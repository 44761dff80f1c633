"""rmpc-bench run."""

from __future__ import annotations

import time
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from rmpc_bench.cli import exits

if TYPE_CHECKING:
    from rmpc_bench.experiment.config import ExperimentConfig


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


@click.command()
@click.argument("config", type=click.Path(path_type=Path))
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Directory for the results.")
@click.option("-j", "--jobs", type=Workers(), help="Worker processes, or auto.  [default: execution.workers]")
@click.option("-s", "--set", "overrides", multiple=True, metavar="PATH=VALUE", help="Replace one value of the file.")
@click.option("--runs", type=click.IntRange(min=1), help="Number of runs instead of the file's.")
@click.option("--only", multiple=True, metavar="METHOD", help="Compute this method only; may be repeated.")
@click.option("--smoke", is_flag=True, help="Run the small size under `smoke`, into results/smoke.")
@click.option("--strict", is_flag=True, help="Exit with 1 when a claim's finding differs from its record.")
@click.option("--fresh", is_flag=True, help="Rename an old directory and compute everything again.")
@click.option("-n", "--dry-run", is_flag=True, help="Show what would be computed, and stop.")
@click.option("--progress", type=click.Choice(["auto", "bar", "plain", "none"]), default="auto", show_default=True)
@exits.guarded
def run(
    config: Path,
    output: Path | None,
    jobs: int | None,
    overrides: tuple[str, ...],
    runs: int | None,
    only: tuple[str, ...],
    smoke: bool,
    strict: bool,
    fresh: bool,
    dry_run: bool,
    progress: str,
) -> int:
    """Run an experiment, or continue it, and write its results.

    The same command continues what an interrupted one has left; finished runs are never computed again.  Results go to
    results/<paper>/<name> unless -o names another directory.
    """
    started = time.monotonic()
    from rmpc_bench.cli.publish import publish
    from rmpc_bench.experiment.config import load_config
    from rmpc_bench.experiment.progress import choose
    from rmpc_bench.experiment.runner import compute
    from rmpc_bench.experiment.store import StoreError

    loaded = load_config(config, overrides=overrides, runs=runs, smoke=smoke)
    _check_names(only, loaded)
    modified = _modifications(config, loaded, overrides, runs, only, smoke)
    directory = output or _directory(config, loaded, overrides, smoke)
    if dry_run:
        return _show_plan(loaded, directory, only)
    if fresh:
        _set_aside(directory)
    try:
        compute(loaded, directory, workers=jobs, only=only or None, progress=choose(progress), modified=modified)
    except StoreError as error:
        click.echo(f"{error}\nfor a new directory: rmpc-bench run {config} -o {directory}-2", err=True)
        return exits.OCCUPIED
    outcome = publish(loaded, directory, modified, seconds=time.monotonic() - started)
    click.echo(outcome.screen)
    return outcome.code(strict=strict)


def _check_names(only: tuple[str, ...], loaded: ExperimentConfig) -> None:
    from rmpc_bench.registry import unknown

    for name in only:
        if name not in loaded.methods:
            raise click.BadParameter(unknown(name, loaded.methods, "method"), param_hint="--only")


def _modifications(
    path: Path,
    loaded: ExperimentConfig,
    overrides: tuple[str, ...],
    runs: int | None,
    only: tuple[str, ...],
    smoke: bool,
) -> list[str]:
    """What differs from the file as it stands; claims are then shown for information only."""
    said = [f"-s {text}" for text in overrides] + [f"--only {name}" for name in only] + ["--smoke"] * smoke
    if runs is not None:
        from rmpc_bench.experiment.yaml import load

        if load(path)["runs"] != runs:
            said.append(f"--runs {runs}")
    return said


def _directory(path: Path, loaded: ExperimentConfig, overrides: tuple[str, ...], smoke: bool) -> Path:
    """Default directory; an override that changes the experiment gets one of its own."""
    from rmpc_bench.experiment.config import load_config

    name = loaded.name
    if overrides and load_config(path, smoke=smoke).full_hash != loaded.full_hash:
        name = f"{name}~{loaded.full_hash[:6]}"
    parent = Path("results") / ("smoke" if smoke else "") / (loaded.paper or "")
    if name != loaded.name:
        click.echo(f"the overrides change the experiment: results go to {parent / name}", err=True)
    return parent / name


def _show_plan(loaded: ExperimentConfig, directory: Path, only: tuple[str, ...]) -> int:
    from rmpc_bench.experiment.runner import pending
    from rmpc_bench.experiment.store import FILE, Store

    names = [method.name for method in loaded.experiment.methods if not only or method.name in only]
    total = len(names) * loaded.experiment.n_runs
    left = total
    if (directory / FILE).exists():
        with Store(directory, writable=False) as store:
            left = sum(len(task.runs) for task in pending(loaded, store, names))
    click.echo(f"{loaded.name}: {left} of {total} trials to compute ({', '.join(names)})")
    click.echo(f"results go to {directory}; nothing was computed (--dry-run)")
    return 0


def _set_aside(directory: Path) -> None:
    """Rename a directory; nothing is ever deleted."""
    if directory.exists():
        old = directory.with_name(f"{directory.name}.{datetime.now():%Y%m%d-%H%M%S}")
        directory.rename(old)
        click.echo(f"the old results are in {old}", err=True)
