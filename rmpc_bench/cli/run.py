"""rmpc-bench run."""

from __future__ import annotations

import gc
import shlex
import sys
import time
from collections import defaultdict
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from importlib import import_module
from itertools import count
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import click

from rmpc_bench.child_process import held
from rmpc_bench.cli import exits, shared_options
from rmpc_bench.cli.run_request import Request, configured, shard_of
from rmpc_bench.cli.shared_options import TypedPath
from rmpc_bench.cli.streams import screen_width
from rmpc_bench.extras import stand_ins
from rmpc_bench.received.plain_files import noted

if TYPE_CHECKING:
    from rmpc_bench.config.experiment_config import ExperimentConfig
    from rmpc_bench.publishing.published import Shown
    from rmpc_bench.results.record import StoredStop

_RARELY = (400_000, 50, 10)  # thresholds of the garbage collection while a report is made: a figure leaves some cycles


@click.command()
@click.argument("config", type=TypedPath())
@click.option("-o", "--output", type=TypedPath(), help="Directory for the results.")
@shared_options.jobs
@click.option("-s", "--set", "overrides", multiple=True, metavar="PATH=VALUE", help="Replace one value of the file.")
@shared_options.n_runs
@click.option("--only", multiple=True, metavar="METHOD", help="Compute this method only; may be repeated.")
@shared_options.add_method
@shared_options.smoke
@click.option("--strict", is_flag=True, help="Exit with 1 if the finding of a claim differs from its record.")
@shared_options.fresh
@click.option("--accept-versions", is_flag=True, help="Use rows that other versions of a library have computed.")
@click.option("--if-installed", is_flag=True, help="Skip a configuration if a library under `requires` is missing.")
@shared_options.dry_run
@click.option(
    "--engine",
    type=click.Choice(["joblib", "serial", "dask"]),
    help="joblib: worker processes; serial: this process, which a component that crashes ends; dask: a dask cluster.",
)
@click.option("--scheduler", metavar="ADDRESS", help="Scheduler of a dask cluster, such as tcp://node7:8786.")
@click.option(
    "--shard",
    "chosen_shard",
    type=shard_of,
    metavar="I/N|auto",
    help="Compute shard I of N; auto: those of the array job.",
)
@click.option("--missing", is_flag=True, help="Take the trials of all shards, and compute the runs that are missing.")
@click.option("--no-report", is_flag=True, help="Compute trials; write no tables, figures or claims.")
@shared_options.progress
@shared_options.quiet
@click.option("-v", "--verbose", is_flag=True, help="Also show how long each stage takes, and which files are written.")
@shared_options.allow_code
@shared_options.import_first
@exits.guarded
def run(**options: Any) -> int:
    """Run an experiment, or continue it, and write its results.

    After an interruption the same command continues; finished runs are not computed again.  Results go to
    results/<paper>/<name> unless -o names another directory.
    """
    started = time.monotonic()
    gc.disable()  # it would visit all objects of imports, although these stay
    if options.pop("if_installed"):
        from rmpc_bench.config.plugins import skipped

        if text := skipped(options["config"]):
            click.echo(text, err=True)
            return 0
    request = Request(**options)
    done = _done_before(request)
    if done is not None:
        for text in done.said:
            request.note(text)
        return _show_again(request, done, time.monotonic() - started)
    # An interrupted import may ignore the interruption, or report a broken library.
    with held():
        load_libraries()
        import rmpc_bench.config.load  # noqa: F401
        from rmpc_bench.cli.config_text import warning_texts
        from rmpc_bench.received.plain_files import StoreError

    with noted() as read:
        config, directory = configured(request)
    for text in warning_texts(config):
        request.note(f"warning: {text}")
    _check_names(request.only, config)
    try:
        if request.dry_run:
            return _show_plan(config, directory, request)
        if request.fresh:
            _set_aside(request.place(directory), config.hash)
        if request.shard or request.no_report:
            return _run_trials(request, config, directory, started)
        return _run_all(request, config, directory, started, read)
    except StoreError as error:
        click.echo(f"{error}\nfor a new directory: {request.command(_free(directory))}", err=True)
        return exits.code_of_store(error)


class _Docstring(defaultdict[str, list[Any]]):
    """What SciPy reads the docstring of a function into, to add sections to it; it stays as it is."""

    def __init__(self, function: Any) -> None:
        super().__init__(list)
        self.text = function.__doc__

    def __str__(self) -> str:
        return f"\n{self.text}"


_STAND_INS: Mapping[str, Mapping[str, Any]] = {
    "scipy._lib._docscrape": {"FunctionDoc": _Docstring, "Parameter": None},
    "unittest.mock": {"patch": None},  # jaxtyping needs it in tests
}
"""Modules that others load without need, with the names that these take from them."""


def load_libraries() -> None:
    """Load SciPy and jaxtyping while small modules stand for four that they would load without need (0.2 s).

    A library that needs more of them is not loaded here, but as usual by the next import.
    """
    import numpy

    names = vars(numpy)
    empty = {name: ModuleType(name) for name in ("f2py", "testing") if f"numpy.{name}" not in sys.modules}
    names |= empty
    try:
        with stand_ins(_STAND_INS), suppress(AttributeError, ImportError):
            for name in ("jaxtyping", "scipy.linalg", "scipy.special"):
                import_module(name)
    finally:
        for name, module in empty.items():
            if names.get(name) is module:
                del names[name]  # NumPy loads the module itself when it is asked for


def _done_before(request: Request) -> Shown | None:
    """Return what the same command has shown where nothing has changed; it imports no NumPy."""
    from rmpc_bench.config_file.known_files import located
    from rmpc_bench.publishing.published import FILE, unchanged

    if not request.may_be_done or shared_options.imported:
        return None
    folder = Path("results", *["smoke"] * request.smoke)
    found = (path for pattern in ("*", "*/*") for path in sorted(folder.glob(f"{pattern}/{FILE}")))
    directories = (path.parent for path in found) if request.output is None else [request.output]
    return unchanged(request.arguments, located(request.config), directories, screen_width())


def _run_all(
    request: Request, config: ExperimentConfig, directory: Path, started: float, read: Mapping[str, str]
) -> int:
    """Compute what is missing and write all results; show them as they are where nothing has changed."""
    options = [f"--only {name}" for name in request.only] + ["--accept-versions"] * request.accept_versions
    with held():
        from rmpc_bench.publishing.published import Command, Shown, keep_state, up_to_date
    said, command = [*request.said], Command.of(request.arguments, config.path, read)
    shown = None if request.missing or request.fresh else up_to_date(config, directory, options, screen_width())
    if shown is not None:
        return _show_again(request, shown, time.monotonic() - started)
    with held():
        from rmpc_bench.execution.run import filled
        from rmpc_bench.figures.style import without_docstrings_of_artists
        from rmpc_bench.publishing.publish import publish

    loaded = time.monotonic()
    _say_shards(request, directory)
    config = _tuned_config(request, config, directory)
    results = filled(
        config,
        directory,
        request.compute_options,
        only=request.only or None,
        progress=request.display(),
        missing=request.missing,
    )
    computed = time.monotonic()
    gc.freeze()
    gc.set_threshold(*_RARELY)
    gc.enable()
    with without_docstrings_of_artists():
        written = publish(results)
    exits.show(written, time.monotonic() - started, notes=not request.quiet)
    if request.verbose:
        seconds = loaded - started, computed - loaded, time.monotonic() - computed
        click.echo("configuration {:.1f} s, trials {:.1f} s, report {:.1f} s".format(*seconds), err=True)
        click.echo("\n".join(f"written: {path}" for path in written.paths), err=True)
    codes = [exits.code_of(written, strict=strict) for strict in (False, True)]
    width, uncompared = screen_width(), bool(results.experiment.claims) and not results.is_final
    lines = written.summary(None, width).split("\n")
    shown = Shown(said, exits.notes_of(written), lines, width, uncompared, codes)
    _say_uncompared(request, shown.uncompared)
    if not results.other_code:
        keep_state(config, directory, options, written.paths, shown, command)
    return codes[request.strict]


def _show_again(request: Request, shown: Shown, seconds: float) -> int:
    """Show results of which nothing has changed."""
    for text in shown.notes:
        request.note(text)
    click.echo(shown.text(seconds))
    if request.verbose:
        click.echo("nothing has changed: no trial was computed and no file written", err=True)
    _say_uncompared(request, shown.uncompared)
    return shown.codes[request.strict]


def _say_uncompared(request: Request, uncompared: bool) -> None:
    if request.strict and uncompared:
        click.echo("--strict compared no finding: see `claims` above", err=True)


def _say_shards(request: Request, directory: Path) -> None:
    """Say that a directory without a store has shards, which the option --missing takes."""
    from rmpc_bench.execution.shards import shards_in
    from rmpc_bench.received.store import FILE, is_filled

    if not request.missing and not is_filled(directory) and shards_in(directory, FILE):
        request.note(f"{directory} has shards, which are not used; with --missing their trials are taken")


def _check_names(only: Sequence[str], config: ExperimentConfig) -> None:
    from rmpc_bench.registry import unknown

    for name in only:
        if name not in config.methods:
            raise click.BadParameter(unknown(name, config.methods, "method"), param_hint="--only")


def _run_trials(request: Request, config: ExperimentConfig, directory: Path, started: float) -> int:
    """Compute the trials of a shard or of all runs, and say in one line what is stored; return the exit code.

    Failed runs of a shard count when the shards are joined.  `started` is a time of the monotonic clock [s].
    """
    with held():
        from rmpc_bench.execution import progress_file
        from rmpc_bench.execution.runner import compute
        from rmpc_bench.results.results import load_experiment

    config = _tuned_config(request, config, directory)
    compute(
        config,
        directory,
        how=request.compute_options,
        only=request.only or None,
        progress=request.display(),
        shard=request.shard,
        missing=request.missing,
    )
    stop = None if config.stop is None else load_experiment(directory).stop
    if stop is not None:
        _tuned_config(request, config, directory, stop.looks.wanted)
    place = request.place(directory)
    data = progress_file.read(place) or {}
    failed = data.get("failed", {})
    what = "trials" if request.shard is None else f"shard {request.shard.name}"
    texts = [f"{config.name}   {what} done in {time.monotonic() - started:.1f} s"]
    if data:
        first, end = data["runs"]
        runs = f"runs {first} to {end - 1}" if end > first else "no runs: there are more shards than runs"
        words = "".join(f", {word} {n}" for word, n in failed.items())
        texts.append(f"{runs}, {data['done']} of {data['total']} trials, {sum(failed.values())} failed{words}")
    click.echo("   ".join([*texts, str(place)]))
    if request.shard is not None:
        request.note(f"when all shards are finished: rmpc-bench merge {shlex.quote(str(directory))}")
    if request.shard is None and sum(failed.values()) > config.execution.max_failures:
        return exits.TOO_MANY_FAILURES
    return exits.STOP_UNMET if stop is not None and stop.is_unmet else 0


def _tuned_config(
    request: Request, config: ExperimentConfig, directory: Path, n_runs: int | None = None
) -> ExperimentConfig:
    """Return a configuration with tuned values; those that are not known are found first.

    `n_runs` is the number of runs that a stopping rule has made; before them the regret is left for later.
    """
    if config.tuning is None:
        return config
    from rmpc_bench.execution.tuning.tune import tuned

    return tuned(
        config,
        directory,
        shard=request.shard,
        only=request.only or None,
        how=request.compute_options,
        progress=request.display(),
        n_runs=n_runs,
    )


def _show_plan(config: ExperimentConfig, directory: Path, request: Request) -> int:
    from rmpc_bench.cli.config_text import tuning_line
    from rmpc_bench.execution.missing import pending
    from rmpc_bench.received.store import is_filled
    from rmpc_bench.results.other_code import rows_of_other_code
    from rmpc_bench.results.record import stop_of
    from rmpc_bench.store.store import Store

    names = [method.name for method in config.experiment.methods if not request.only or method.name in request.only]
    stop, place = stop_of(config, None), request.place(directory)
    runs = _planned_runs(config, stop, request)
    left = total = config.n_trials(names, len(runs))
    apart = None
    if is_filled(place):
        with Store(place, writable=False) as store:
            store.check(config.hash, config.shared, config.own.names())
            stop = stop_of(config, store)
            runs = _planned_runs(config, stop, request)
            total = config.n_trials(names, len(runs))
            left = sum(len(task.runs) for task in pending(config, store, names, runs))
            apart = rows_of_other_code(config, store, names)
    part = "" if request.shard is None else f", shard {request.shard}"
    until = f", up to the next look of `{stop.rule}`" if stop is not None and not stop.is_over else ""
    click.echo(f"{config.name}{part}: {left} of {total} trials to compute ({', '.join(names)}){until}")
    if apart:
        click.echo("\n".join(apart.said("; they would be computed again", ": they would be computed again")))
    for line in tuning_line(config, request.only or None):
        click.echo(f"tuning comes first: {line}")
    click.echo(f"results go to {place}; nothing was computed (--dry-run)")
    return 0


def _planned_runs(config: ExperimentConfig, stop: StoredStop | None, request: Request) -> range:
    """Return the runs that the command would compute: those of a shard, or those up to the next look of a rule."""
    if stop is not None:
        return range(stop.looks.wanted)
    n_runs = config.experiment.n_runs
    return range(n_runs) if request.shard is None else request.shard.runs(n_runs)


def _set_aside(directory: Path, experiment: str) -> None:
    """Rename a directory; nothing is ever deleted, and the looks at the experiment go into the new store."""
    from rmpc_bench.received.plain_files import StoreError
    from rmpc_bench.received.store import FILE, is_in_use, is_there
    from rmpc_bench.results.manifest import keep_looks, remaining_looks
    from rmpc_bench.store.store import Store

    if is_there(directory):  # without a store, whole or damaged, the directory counts as new
        if directory.resolve() in (Path.cwd(), *Path.cwd().parents):
            raise click.BadParameter("cannot rename the directory it stands in", param_hint="--fresh")
        if is_in_use(directory):
            raise StoreError(f"{directory / FILE}: another process writes to it; wait for it to end")
        old = directory.with_name(f"{directory.name}.{datetime.now():%Y%m%d-%H%M%S}")
        old = _free(old) if old.exists() else old
        looks = remaining_looks(directory, experiment)
        directory.rename(old)
        if looks:
            with Store(directory) as store:
                keep_looks(store, looks)
        click.echo(f"the old results are in {old}", err=True)


def _free(directory: Path) -> Path:
    """Return a name that is not taken, made from a directory's by a number."""
    names = (directory.with_name(f"{directory.name}-{number}") for number in count(2))
    return next(name for name in names if not name.exists())
