"""Runs made elsewhere become a directory of results: trial store, settings, a copy of the table, manifest."""

from __future__ import annotations

import gzip
import os
import platform
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

import rmpc_bench
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.config.experiment_config import headline_of
from rmpc_bench.config.identity import code_version, digest, set_keys
from rmpc_bench.config.statistics import read_requirement
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import dump
from rmpc_bench.execution import progress_file
from rmpc_bench.importing.doubts import read_runs
from rmpc_bench.importing.runs import OK, Runs
from rmpc_bench.importing.settings import Options, Settings
from rmpc_bench.installed import version_of
from rmpc_bench.received.plain_files import StoreError
from rmpc_bench.received.run_table import FRAME, MAX_NAMED, Table
from rmpc_bench.received.store import FILE as STORE
from rmpc_bench.replaced_file import inside, replace_text, replaced
from rmpc_bench.results import manifest
from rmpc_bench.results.imported import ELSEWHERE, Imported
from rmpc_bench.results.other_code import OF_THE_BENCH
from rmpc_bench.results.record import PointMethod, StoredExperiment, StoredPoint, write_experiment
from rmpc_bench.results.results import Results, load_experiment, read_results
from rmpc_bench.simulation.closed_loop import Block
from rmpc_bench.store.store import WORDS, Store
from rmpc_bench.types import Array, ConfigError, DesignError, Journal, RunFailure
from rmpc_bench.types.errors import check_arguments
from rmpc_bench.types.result_layout import CONFIG
from rmpc_bench.types.texts import visible

if TYPE_CHECKING:
    import pandas as pd

MAX_COPY = 64 * 2**20
"""Largest table of which the directory keeps a copy [bytes]."""
AT_ONCE = 50_000
"""Rows that are stored together."""
METHOD_PATHS = ("methods", "model", "estimator", "controller")
"""First steps of swept paths that change methods, not the true system."""


@dataclass(frozen=True)
class Prepared:
    """A table that was read and checked, and the record of its experiment."""

    settings: Settings
    options: Options
    table: Table
    runs: Runs
    experiment: StoredExperiment
    adds_to: str = ""  # hash of the experiment to which the table adds runs

    @property
    def facts(self) -> list[str]:
        """What was read, in words."""
        runs, metrics = self.runs, [each.name for each in self.runs.infos]
        points = f" at {len(runs.points)} points" if runs.paths else ""
        names = {"methods": runs.methods, "metrics": metrics, "parameters": runs.parameters}
        head = f"{len(runs.row):,} runs{points}, {np.count_nonzero(runs.status != OK):,} failed"
        return [head, *(f"{kind}: {', '.join(each)}" for kind, each in names.items() if each)]

    @property
    def remarks(self) -> list[str]:
        """What was ignored, and what is probably not meant, in words."""
        notes = [*dict.fromkeys(self.table.notes)]
        notes[MAX_NAMED:] = [f"and {len(notes) - MAX_NAMED:,} more remarks"] * (len(notes) > MAX_NAMED)
        return [*notes, *(f"warning: {text}" for text in self.runs.warnings)]


def prepare(
    source: Any, settings: str | Path | Mapping[str, Any] | None, given: Mapping[str, Any], options: Options
) -> Prepared:
    """Read a table with its settings; `given` are the options that replace settings, by their paths."""
    stem = Path(source).name.partition(".")[0] if isinstance(source, str | Path) else "runs"
    name = re.sub("[^A-Za-z0-9_-]", "_", stem).lstrip("_-")[:100] or "runs"
    chosen = Settings(settings, {"name": name, **given})
    table, runs = read_runs(source, chosen, options)
    return Prepared(chosen, options, table, runs, _record(chosen, table, runs, options))


def _record(settings: Settings, table: Table, runs: Runs, options: Options) -> StoredExperiment:
    """Return what reports need of the experiment."""
    draft, keys, statistics = settings.draft, settings.draft.keys, settings.statistics
    names = [each.name for each in runs.infos]
    primary = statistics.primary or names[0]
    rows = [runs.point, runs.method, runs.run, runs.status, *runs.metrics.values(), *runs.parameters.values()]
    content = [sha256(each.tobytes()).hexdigest() for each in rows]
    key = digest([content, names, [*runs.parameters], runs.methods, runs.points, sorted({*runs.reason.tolist()})])
    points = tuple(_point(settings, runs, number, key) for number in range(len(runs.points)))
    of_plant = not any(path.partition(".")[0] in METHOD_PATHS for path in runs.paths)
    return StoredExperiment(
        **{each: getattr(keys, each) for each in ("name", "title", "report")},
        paper=None,
        hash=key,
        n_runs=int(runs.run.max()) + 1,
        has_runs=True,
        axes=tuple((path,) for path in runs.paths),
        labels=settings.labels,
        primary=primary,
        baseline=statistics.baseline or runs.methods[0],
        confidence=statistics.confidence,
        relevant=statistics.relevant_change,
        margins=dict(statistics.margins),
        average=statistics.average,
        headline=headline_of(settings.claims, primary),
        # How many failures are too many is decided where the runs are made.
        max_failures=len(runs.row),
        alike=of_plant and all([*point.methods] == runs.methods for point in points),
        overrides=(),
        figures=tuple(plain(set_keys(each)) for each in draft.figures if each is not None),
        claims=settings.claims,
        points=points,
        parameters=settings.sources,
        requirements=tuple(read_requirement(text, names) for text in statistics.requirements),
        **statistics.comparison_keys() | ({"adjust": "none"} if options.unpaired else {}),
        imported=Imported(
            table=table.name,
            names=() if runs.names == [*range(len(runs.names or ()))] else tuple(runs.names or ()),
            options=options.data(),
        ),
    )


def _point(settings: Settings, runs: Runs, number: int, key: str) -> StoredPoint:
    draft, coordinates = settings.draft, runs.points[number]
    present = np.unique(runs.method[runs.point == number]).tolist()
    besides = settings.random_besides
    return StoredPoint(
        coordinates=coordinates,
        title=", ".join(f"{path}={text}" for path, text in coordinates.items()),
        seed=draft.keys.seed or 0,
        Ts=0.0,
        nx=0,
        n_steps=1,
        units={},
        metrics=tuple(runs.infos),
        metric_keys={each.name: each.name for each in runs.infos},
        methods={runs.methods[each]: PointMethod(digest([key, number, each]), ELSEWHERE) for each in present},
        n_recorded=0,
        has_ensemble=False,
        reference=None,
        uncertainty_key=digest([key, number]),
        uncertainty=tuple(runs.parameters),
        random_besides=None if besides is None else tuple(besides),
        laws=settings.laws,
    )


def import_runs(
    source: Any,
    *,
    directory: str | Path | None = None,
    settings: str | Path | Mapping[str, Any] | None = None,
    baseline: str | None = None,
    metrics: Sequence[str] = (),
    columns: Mapping[str, str] | None = None,
    wide: str = "",
    decimal: str = ".",
    separator: str = ",",
    missing: Literal["error", "drop", "failed"] = "error",
    keep_last: str = "",
    unpaired: bool = False,
    add: bool = False,
    max_rows: int = 1_000_000,
) -> Results:
    """Make a directory of results from a table of runs that another program has made.

    Parameters
    ----------
    source : a file .csv, .csv.gz or .parquet, or a data frame of pandas: a row per run and method, or per run
    directory : where the results will lie; ``results/<name of the table>`` unless given
    settings : a file or a mapping with sections of a configuration: version, name, title, seed, methods, metrics,
        statistics, uncertainty, random_besides, sweep, figures, report, claims
    baseline : method with which the others are compared; the first one unless given
    metrics : names of the metrics; all columns of numbers that differ between the methods unless given
    columns : role -> column: run, method, status, sweep:PATH, parameter:NAME, metric:NAME
    wide : pattern of the columns of a table with a row per run, such as ``{metric}_{method}``
    decimal, separator : signs within and between the numbers of a csv file
    missing : what to do with runs that a method lacks and with empty metrics: ``error``, leave the run out (``drop``),
        or count it as ``failed``
    keep_last : column whose largest value says which row of a run and method counts
    unpaired : whether run i of two methods had other draws: they are compared without pairs, with Welch's intervals
    add : whether methods or runs are added to those of the directory, whose settings stay
    max_rows : largest number of rows

    Returns
    -------
    the results; `publish` writes their tables, figures and page

    Raises
    ------
    ConfigError
        If anything is wrong with the table or the settings: all errors, each with its line.
    StoreError
        If the directory holds other results.

    Examples
    --------
    >>> import pandas, rmpc_bench, tempfile
    >>> frame = pandas.DataFrame({"run": [1, 2, 1, 2], "method": ["KF", "KF", "R-KF", "R-KF"], "mse": [2.0, 3, 1, 2]})
    >>> results = import_runs(frame, directory=tempfile.mkdtemp())
    >>> rmpc_bench.compare(results, "mse").to_frame()[["method", "won", "n_pairs"]].values.tolist()
    [['R-KF', 2, 2]]
    """
    given = dict(locals())
    check_arguments(import_runs, given)
    prepared, place = prepare_import(**given)
    store_runs(prepared, place)
    return replace(read_results(place), directory=place.absolute())


def prepare_import(
    source: Any,
    directory: str | Path | None = None,
    *,
    settings: str | Path | Mapping[str, Any] | None = None,
    baseline: str | None = None,
    metrics: Sequence[str] = (),
    add: bool = False,
    **options: Any,
) -> tuple[Prepared, Path]:
    """Read a table with the arguments of `import_runs`; return it and the directory."""
    chosen = Options(**{key: each for key, each in options.items() if each is not None})
    if add:
        if directory is None or settings is not None or baseline is not None:
            raise DesignError("give the directory; its settings and its baseline stay as they are", "add")
        return added(source, Path(directory), metrics, chosen), Path(directory)
    prepared = prepare(source, settings, {"statistics.baseline": baseline, "metrics": [*metrics]}, chosen)
    return prepared, Path(directory or Path("results") / prepared.experiment.name)


def added(source: Any, place: Path, metrics: Sequence[str], options: Options) -> Prepared:
    """Read a table together with the runs of a directory; a row that both have with other values is a StoreError."""
    import pandas as pd

    results = read_results(place)
    before, point = results.experiment.imported, results.experiment.points[0]
    if before is None:
        raise StoreError(f"{place} holds an experiment that was simulated; `rmpc-bench run --add-method` adds to it")
    wanted = {"metrics": [*metrics] or [each.name for each in point.metrics]}
    if options.unpaired and not before.unpaired:
        raise StoreError(f"{place} holds runs in pairs; import all methods together with --unpaired")
    more = prepare(source, None, wanted, replace(options, parameters=point.uncertainty, unpaired=before.unpaired))
    with TemporaryDirectory() as temporary:
        store_runs(more, Path(temporary))
        tables = [*results.stored.each, *read_results(Path(temporary)).stored.each]
    both = pd.concat([*map(_frame, tables)], ignore_index=True).drop_duplicates()
    key = [name for name in both if name in ("run", "method") or name.startswith("sweep:")]
    if (again := both.duplicated(key)).any():
        row = both[again].iloc[0]
        raise StoreError(f"run {row['run']} of {row['method']} is in {place} with other values")
    usual = Options(missing=options.missing, unpaired=before.unpaired, max_rows=options.max_rows)
    try:
        joined = prepare(both, place / CONFIG, {}, usual)
    except ConfigError as error:
        # Nobody sees the joined table, nor its rows.
        name, found = f"{more.table.name} and {place}", error.problems
        raise ConfigError([replace(p, file=name, line=0) if p.file == FRAME else p for p in found]) from None
    joined.table.name, joined.runs.warnings[:0] = before.table, more.runs.warnings
    how = {"unpaired": True} if before.unpaired else {}
    record = replace(joined.experiment.imported or before, table=before.table, options=how)
    return replace(joined, experiment=replace(joined.experiment, imported=record), adds_to=results.experiment.hash)


def _frame(trials: Trials) -> pd.DataFrame:
    """Return the runs of a point as a table whose columns are named by their roles."""
    names = trials.run_names or range(int(trials.runs[-1]) + 1)
    drawn = trials.uncertainty.rename(columns=lambda name: name if name == "run" else f"parameter:{name}")
    rows = trials.frame[["run", "method", "status", *(each.name for each in trials.metrics)]]
    rows = rows.merge(drawn, on="run", how="left").assign(run=[names[run] for run in rows["run"]])
    rows = rows.assign(**{f"sweep:{path}": text for path, text in trials.point.items()})
    reasons = {(name, names[each.run]): each.message for name, notes in trials.notes.items() for each in notes.failures}
    status = map(reasons.get, zip(rows["method"], rows["run"], strict=True), rows["status"])
    return rows.assign(status=[*status])


def store_runs(prepared: Prepared, place: Path) -> None:
    """Write the directory; one that holds other results is refused."""
    experiment, before = prepared.experiment, None
    if (place / STORE).exists() or (place / STORE).is_symlink():
        before = load_experiment(place)
        if before.imported is None:
            raise StoreError(f"{place} holds an experiment that was simulated; choose another directory with -o")
        if before.hash not in (experiment.hash, prepared.adds_to):
            raise StoreError(f"{place} holds other runs made elsewhere; --add adds runs or methods to them")
    place.mkdir(parents=True, exist_ok=True)
    with inside(place):
        _write_store(prepared, place)
        used = prepared.settings.used(prepared.runs.infos, prepared.runs.methods)
        replace_text(place / CONFIG, dump(used))
        _write_manifest(prepared, place, _copy(prepared.table, place))
        _write_progress(prepared, place)


def _write_progress(prepared: Prepared, place: Path) -> None:
    """Write what `status` reads."""
    experiment, status = prepared.experiment, prepared.runs.status
    data = {
        **{"name": experiment.name, "metric": experiment.primary, "state": progress_file.FINISHED, "why": "imported"},
        **{"host": platform.node() or "unknown", "pid": os.getpid(), "updated": _now(), "every": progress_file.EVERY},
        **{"runs": [0, experiment.n_runs], "n_runs": experiment.n_runs, "rate": 0.0, "left_seconds": None},
        **dict.fromkeys(("total", "done", "all_trials"), len(prepared.runs.row)),
        "failed": dict(sorted(Counter(WORDS[status[status != OK]].tolist()).items())),
    }
    progress_file.write(place / progress_file.FILE, data)


def _write_store(prepared: Prepared, place: Path) -> None:
    """Write a new trial store, which takes the place of an earlier one as a whole."""
    runs, experiment = prepared.runs, prepared.experiment
    with TemporaryDirectory(dir=place, prefix=".importing-") as temporary:
        with Store(Path(temporary)) as store:
            store.claim(experiment.hash, {"imported": experiment.hash})
            store.register(experiment.stored_methods)
            write_experiment(store, experiment, {})
            for number, point in enumerate(experiment.points):
                for name, method in point.methods.items():
                    here = np.flatnonzero((runs.point == number) & (runs.method == runs.methods.index(name)))
                    for first in range(0, len(here), AT_ONCE):
                        _store_rows(store, runs, here[first : first + AT_ONCE], method.key, point)
            manifest.keep_looks(store, manifest.looks_of_manifest(place))
        (Path(temporary) / STORE).replace(place / STORE)


def _store_rows(store: Store, runs: Runs, rows: Array, key: str, point: StoredPoint) -> None:
    failures = {}
    for row in rows[runs.reason[rows] != ""].tolist():
        run, status = int(runs.run[row]), int(runs.status[row])
        failures[run] = RunFailure(run, status, "", None, visible(str(runs.reason[row]))[:1000])
    metrics = {name: cells[rows] for name, cells in runs.metrics.items()}
    block = Block(runs.status[rows].astype(np.int8), np.array([*metrics.values()]), {}, (), Journal(failures))
    sampled = {name: cells[rows] for name, cells in runs.parameters.items()}
    store.add_block(key, runs.run[rows].tolist(), block, metrics, point.uncertainty_key, sampled)


def _copy(table: Table, place: Path) -> str:
    """Keep a copy of the table, and return its name; empty where it is too large."""
    if len(table.content) > MAX_COPY:
        return ""
    is_parquet = table.content.startswith(b"PAR1")
    name = "source.parquet" if is_parquet else "source.csv.gz"
    with replaced(place / name) as partial:
        # A higher level takes several times as long for a few per cent of the size.
        partial.write_bytes(table.content if is_parquet else gzip.compress(table.content, 2, mtime=0))
    return name


def _write_manifest(prepared: Prepared, place: Path, copy: str) -> None:
    table, experiment, before = prepared.table, prepared.experiment, manifest.read(place)
    versions = {"rmpc-bench": rmpc_bench.__version__, "python": platform.python_version()}
    source = {"file": table.name, "copy": copy, "sha256": table.digest, "rows": len(prepared.runs.row)}
    data = {
        "origin": "imported",
        "name": experiment.name,
        "experiment": experiment.hash,
        "seed": experiment.points[0].seed,
        "sources": [{**source, "options": prepared.options.data()}],
        "warnings": prepared.runs.warnings,
        "modified": [],
        "versions": versions | {name: version_of(name) for name in OF_THE_BENCH},
        **code_version(),
        "blas": manifest.blas(),
        "platform": {"system": platform.platform(), "machine": platform.machine(), "cores": os.cpu_count()},
        "looks": before.get("looks", []),
        **({"report": before["report"]} if "report" in before else {}),
        "sessions": [{"start": _now(), "stop": _now(), "why": "imported"}],
    }
    manifest.write(place / manifest.FILE, data)


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
