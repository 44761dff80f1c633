"""The options of `rmpc-bench run` as one record, and the types of those that are not plain texts or numbers."""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import click

if TYPE_CHECKING:
    from rmpc_bench.config.experiment_config import ExperimentConfig
    from rmpc_bench.engines.choice import ComputeOptions
    from rmpc_bench.execution.progress import Progress
    from rmpc_bench.execution.shards import Shard


class ChosenShard(NamedTuple):
    """The option --shard."""

    shard: Shard
    automatic: bool = False  # whether it was given as `auto`: the position of a task in its array job


def shard_of(value: str) -> ChosenShard:
    """Return the shard I/N; `auto` is the position of a task in its array job."""
    from rmpc_bench.execution.shards import ArrayJobError, parse_shard, shard_of_array_job

    try:
        if value == "auto":
            return ChosenShard(shard_of_array_job(os.environ), automatic=True)
        return ChosenShard(parse_shard(value))
    except (ArrayJobError, ValueError) as error:
        raise click.BadParameter(str(error)) from None


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
    engine: Literal["joblib", "serial", "dask"] | None
    add_methods: tuple[str, ...]
    scheduler: str | None
    chosen_shard: ChosenShard | None
    missing: bool
    no_report: bool
    quiet: bool
    verbose: bool
    said: list[str] = field(default_factory=list)  # what was noted

    def __post_init__(self) -> None:
        """Refuse options that exclude each other."""
        shard, missing, strict = self.shard, self.missing, self.strict
        excluded = {
            "--shard computes one shard, and --missing all runs that are missing: give one of them": shard and missing,
            "--strict needs all runs: give it with --missing when the shards are finished": shard and strict,
            "--strict compares findings, which --no-report leaves out": self.no_report and strict,
            "--missing uses stored trials, and --fresh sets them aside: give one of them": missing and self.fresh,
            "give -q or -v": self.quiet and self.verbose,
            "--scheduler needs --engine dask": self.scheduler and self.engine not in (None, "dask"),
        }
        wrong = [text for text, given in excluded.items() if given]
        if wrong:
            raise click.UsageError("\n".join(wrong))

    @property
    def shard(self) -> Shard | None:
        """The shard to compute; None for all runs."""
        return None if self.chosen_shard is None else self.chosen_shard.shard

    @property
    def compute_options(self) -> ComputeOptions:
        """How trials are computed."""
        from rmpc_bench.engines.choice import ComputeOptions

        # A scheduler is that of a dask cluster.
        engine = "dask" if self.scheduler else self.engine
        return ComputeOptions(self.jobs, engine, self.scheduler, self.accept_versions)

    def place(self, directory: Path) -> Path:
        """Return where the trials are stored: the directory of the results, or of the shard in it."""
        return directory if self.shard is None else self.shard.directory(directory)

    def display(self) -> Progress:
        """Return what shows the progress."""
        from rmpc_bench.execution.progress import choose

        return choose("quiet" if self.quiet else self.progress)

    def note(self, text: str) -> None:
        """Show a note on stderr."""
        self.said.append(text)
        if not self.quiet:
            click.echo(text, err=True)

    @property
    def arguments(self) -> list[str]:
        """Everything given, but for the directory, that decides the configuration and what is shown of its results."""
        given = (str(self.config), self.overrides, self.runs, self.only, self.smoke, self.accept_versions)
        return [*map(repr, given), *self.add_methods, *map(str, self.allow_code)]

    @property
    def may_be_done(self) -> bool:
        """Whether the whole of it may have been done before: its results, and nothing said about how they came."""
        special = (self.fresh, self.missing, self.shard, self.dry_run, self.no_report, self.add_methods)
        return not (any(special) or self.allow_code)

    def changes(self) -> list[str]:
        """Options that change what is computed."""
        texts = [f"-s {shlex.quote(text)}" for text in self.overrides if not text.startswith("execution.")]
        texts += [f"--runs {self.runs}"] if self.runs is not None else []
        texts += [f"--only {shlex.quote(name)}" for name in self.only] + ["--smoke"] * self.smoke
        return texts + [f"--add-method {shlex.quote(text)}" for text in self.add_methods]

    def command(self, directory: Path) -> str:
        """Return the same command for another directory."""
        allowed = [f"--allow-code {shlex.quote(str(path))}" for path in self.allow_code]
        part = [] if self.shard is None else [f"--shard {self.shard}"]
        return " ".join(
            ["rmpc-bench run", shlex.quote(str(self.config)), *self.changes(), *allowed, *part, f"-o {directory}"]
        )

    def load(self, *, overridden: bool = True, add_methods: Sequence[str] = ()) -> ExperimentConfig:
        """Load the configuration, with or without the overrides and the number of runs."""
        from rmpc_bench.config.load import load_config

        changes: dict[str, Any] = {"overrides": self.overrides, "runs": self.runs} if overridden else {}
        changes["add_methods"] = add_methods
        return load_config(self.config, smoke=self.smoke, allow_code=self.allow_code, **changes)


def check_division(chosen: ChosenShard, directory: Path) -> None:
    """Refuse --shard auto where the directory is divided otherwise, as when single tasks of an array run again."""
    from rmpc_bench.execution.shards import shards_in
    from rmpc_bench.received.store import FILE

    count = chosen.shard.total
    others = sorted({shard.total for shard in shards_in(directory, FILE)} - {count})
    if chosen.automatic and others:
        text = f"this array has {count} tasks, and {directory} has shards of {', '.join(map(str, others))}"
        way_out = "give --shard I/N, or --missing in place of --shard to compute the runs that are missing"
        raise click.BadParameter(f"{text}; {way_out}", param_hint="--shard")


def configured(request: Request) -> tuple[ExperimentConfig, Path]:
    """Load the configuration with the methods that its directory has, and say what is added or left out."""
    config = request.load()
    directory = request.output or _directory(request, config)
    stored = {} if request.fresh else _stored_methods(directory, config)
    if request.chosen_shard is not None:
        if config.stop is not None:
            message = f"a shard cannot decide `stop: {config.stop.text}`, which looks at all runs; --runs N gives them"
            raise click.BadParameter(message, param_hint="--shard")
        check_division(request.chosen_shard, directory)
        stored |= {} if request.fresh else _stored_methods(request.place(directory), config)
    if request.add_methods:
        # Before those of the directory, so that an error names the text that is given now.
        config = request.load(add_methods=request.add_methods)
    if stored:
        config = request.load(add_methods=[*{**stored, **config.added}.values()])
    if config.tuning is not None and not request.fresh:
        from rmpc_bench.execution.tuning.tune import with_known

        config = with_known(config, directory)
    for line in _said(config, stored, directory):
        request.note(line)
    for text in config.left_out:
        request.note(f"left out: {text}")
    return config, directory


def _stored_methods(directory: Path, config: ExperimentConfig) -> dict[str, str]:
    """Return methods that were added to the results of this experiment and that its configuration does not have."""
    from rmpc_bench.received.store import FILE, MissingError
    from rmpc_bench.results.record import added_methods
    from rmpc_bench.store.store import Store

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
    claims = "claims rest on the methods that they name; " if config.claims else ""
    yield f"{claims}intervals of verdicts are simultaneous for {n} methods now"


def _directory(request: Request, config: ExperimentConfig) -> Path:
    """Default directory; an override that changes the experiment gets one of its own."""
    name = config.name
    if request.overrides and request.load(overridden=False).full_hash != config.full_hash:
        name = f"{name}~{config.full_hash[:6]}"
    parent = Path("results") / ("smoke" if request.smoke else "") / (config.paper or "")
    if name != config.name:
        request.note(f"the overrides change the experiment: results go to {parent / name}")
    return parent / name
