"""Write every file that is derived from stored trials: tables, series, recorded runs, claims and figures."""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import rmpc_bench
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.claims.markdown import claims_markdown
from rmpc_bench.claims.papers import IDENTIFIERS
from rmpc_bench.claims.record import ExperimentRecord
from rmpc_bench.claims.table import claims_record
from rmpc_bench.claims.verdict import ClaimVerdict
from rmpc_bench.execution.evaluation import drivers, judge, ranks, requirements, summarise
from rmpc_bench.execution.figure_files import WrittenFigure, write_figures
from rmpc_bench.execution.latex_files import write_latex
from rmpc_bench.execution.manifest import note_look, note_report, read
from rmpc_bench.execution.page_files import PAGE, Drawn, Evaluated, place_of, write_page
from rmpc_bench.execution.published_state import with_time
from rmpc_bench.execution.report_choices import rendering_of
from rmpc_bench.execution.results import Results
from rmpc_bench.execution.tuning_report import tuning
from rmpc_bench.figures.style import Rendering, remark_on
from rmpc_bench.replaced_file import folder, inside, replace_text, replaced
from rmpc_bench.report.csv_file import comparisons_table, summary_table, trials_csv, write_csv
from rmpc_bench.report.ranks_table import RanksTable
from rmpc_bench.report.run_notes import failure_files
from rmpc_bench.report.run_tables import DriversTable, RequirementsTable, lost_table
from rmpc_bench.report.screen import WIDTH, Screen
from rmpc_bench.report.summary import Summary
from rmpc_bench.report.tuning_table import TuningTable
from rmpc_bench.types import Array


@dataclass(frozen=True, eq=False)
class Publication:
    """What `publish` has written.

    Parameters
    ----------
    results : the results that were published
    directory : where the files are
    paths : the files, in the order in which they were written
    tables : summary and comparisons
    verdicts : the finding of every claim
    drivers : what drives the primary metric
    requirements : runs that meet the requirements
    ranks : the methods in the order of their ranks over all points
    tuning : how the parameters were chosen
    figures : the figures with their captions and files
    left_out : figures that could not be drawn, each as ``kind: reason``
    remarks : what a reader of the files should know, such as a font that is not installed
    """

    results: Results
    directory: Path
    paths: tuple[Path, ...]
    tables: Summary
    verdicts: tuple[ClaimVerdict, ...]
    drivers: DriversTable
    requirements: RequirementsTable
    ranks: RanksTable
    tuning: TuningTable
    figures: tuple[WrittenFigure, ...] = ()
    left_out: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    @property
    def differing(self) -> tuple[ClaimVerdict, ...]:
        """Claims whose finding differs from the recorded one; none where `results` are not final."""
        return tuple(each for each in self.verdicts if each.differs) if self.results.is_final else ()

    def summary(self, seconds: float | None = None, width: int = WIDTH) -> str:
        """Return the text that the command line shows at the end of a run.

        Parameters
        ----------
        seconds : time that the command took [s]; left out where None
        width : columns of the terminal
        """
        experiment, results = self.results.experiment, self.results
        overridden, missing = results.overrides, results.incomplete
        reasons = [f"the configuration was overridden ({', '.join(overridden)})"] if overridden else []
        reasons += [f"runs are missing ({', '.join(missing)})"] if missing else []
        screen = Screen(
            name="/".join(filter(None, [experiment.paper, experiment.name])),
            trials=results.trials,
            tables=self.tables,
            metric=(experiment.report.metrics or [experiment.primary])[0],
            page=self.directory / PAGE,
            extent=results.extent,
            driven=self.drivers,
            tuned=self.tuning,
            demanded=self.requirements,
            ranked=self.ranks,
            verdicts=self.verdicts,
            reasons=reasons,
            stop="" if experiment.stop is None else experiment.stop.text,
        )
        text = screen.text(width)
        return text if seconds is None else with_time(text, seconds, width)

    def __str__(self) -> str:
        return self.summary()


def publish(
    results: Results,
    *,
    to: str | Path | None = None,
    rendering: Rendering | None = None,
    index: Path | None = None,
    place: str = "",
) -> Publication:
    """Write all tables, series, recorded runs, claims and figures of stored results; nothing is simulated.

    Parameters
    ----------
    results : from `run` or `load_results`
    to : directory to write to, made if it is not there; the one of the results unless given
    rendering : width, font, style and formats of the figures; those of the section `report` unless given
    index : index of several experiments that the page links; none if None
    place : the directory as commands in the files name it; from the present one, else from ``results`` on, else its
        last part, unless given

    Returns
    -------
    the written files with the tables and verdicts in them; `summary()` is the text of the command line

    Raises
    ------
    OSError
        If a file cannot be written.

    Examples
    --------
    >>> import rmpc_bench, tempfile
    >>> directory = tempfile.mkdtemp()
    >>> config = rmpc_bench.load_config("configs/quickstart.yaml", runs=4)
    >>> results = rmpc_bench.run(config, directory=directory, jobs=1)
    >>> written = publish(results, to=f"{directory}/published")
    >>> [path.name for path in written.paths][:2]
    ['trials.csv', 'uncertainty.csv']
    """
    directory = results.directory if to is None else Path(to)
    with inside(directory):
        rendering = rendering or rendering_of(results.experiment.report)
        known = read(results.directory)
        stated = known.get("report", {})
        # With a given `place` the files are made elsewhere; the file of the configuration is then the recorded one.
        file = str(stated.get("file", "") if place else known.get("file", ""))
        named = place or place_of(results.directory)
        if named != stated.get("place") and not Path(file).is_file():
            file = ""
        return _published(results, directory, rendering, index, named, file)


def _published(
    results: Results, directory: Path, rendering: Rendering, index: Path | None, place: str, file: str
) -> Publication:
    """Write everything below a directory."""
    texts, report = folder(directory, "tables"), results.experiment.report
    pictures = folder(directory, "figures") if results.experiment.figures else directory / "figures"
    tables = summarise(results).shown(report.order, report.metrics)
    verdicts = judge(results)
    driven, demanded, ranked, tuned = drivers(results), requirements(results), ranks(results), tuning(results)
    paths = [
        *_write_tables(results, tables, directory),
        *_write_table(driven, directory, "drivers"),
        *_write_table(demanded, directory, "requirements"),
        *_write_frame(lost_table(results.trials), directory / "lost.csv"),
        *_write_table(ranked, directory, "ranks"),
        *_write_table(tuned, directory, "tuning"),
        *_write_traces(results.stored, directory / "traces.npz"),
        *_write_claims(results, verdicts, directory, rendering.formats),
        *_write_frame(results.timings, directory / "timings.csv"),
        *_write_failures(results, directory / "failures", place),
    ]
    # Another directory says nothing else than this one, which stays as it is.
    if directory.resolve() == results.directory.resolve():
        if len(results.trials.runs) and results.trials.with_verdicts:
            note_look(directory, len(results.trials.runs))
        note_report(directory, _way(results, place, file))
    record = _record(results, file)
    paths += write_latex(tables, record, texts, report)
    figures, left_out = write_figures(results, pictures, rendering)
    paths += [path for figure in figures for path in figure.paths]
    drawn = Drawn(figures, left_out, rendering)
    found = (tables, verdicts, driven, demanded, ranked, tuned)
    evaluated = Evaluated(record, *found)
    paths += write_page(results, evaluated, drawn, paths, directory, place, index)
    remarks = tuple(filter(None, [remark_on(rendering.font)]))
    return Publication(results, directory, tuple(paths), *found, figures, left_out, remarks)


def _record(results: Results, file: str) -> ExperimentRecord:
    """Describe the experiment, with the command that names the file of the configuration if it is known."""
    record = experiment_record(results)
    if file:
        record["command"] = " ".join(["rmpc-bench run", shlex.quote(file), *results.overrides])
    return record


def write_tables_of_rows(results: Results, directory: Path, file: str) -> None:
    """Write the tables and claims that follow from metrics and statuses alone."""
    report, trials = results.experiment.report, results.trials
    tables = summarise(results).shown(report.order, report.metrics)
    texts = folder(directory, "tables")
    write_csv(summary_table(tables.described), directory / "summary.csv")
    write_csv(comparisons_table(tables.compared), directory / "comparisons.csv")
    _write_table(requirements(results), directory, "requirements")
    _write_frame(lost_table(trials), directory / "lost.csv")
    _write_table(ranks(results), directory, "ranks")
    if not any(notes.holds or notes.optimises for table in trials.each for notes in table.notes.values()):
        write_latex(tables, _record(results, file), texts, report)
    if not any(table.groups for table in trials.each):
        _write_claims(results, judge(results), directory, rendering_of(report).formats)


def _way(results: Results, place: str, file: str) -> dict[str, Any]:
    """Describe how the files are made, as plain data."""
    keys = {key: value for key, value in asdict(results.experiment.report).items() if value is not None}
    drawn = {"own_figures": bool(results.components), "matplotlib": version("matplotlib")}
    return {
        "place": place,
        **({"file": file} if file else {}),
        "keys": keys,
        "labels": dict(results.experiment.labels),
        **drawn,
    }


def _write_tables(results: Results, tables: Summary, directory: Path) -> list[Path]:
    trials_csv(results.stored, directory / "trials.csv")
    write_csv(results.uncertainty, directory / "uncertainty.csv")
    write_csv(results.series, directory / "series.csv")
    write_csv(summary_table(tables.described), directory / "summary.csv")
    write_csv(comparisons_table(tables.compared), directory / "comparisons.csv")
    replace_text(directory / "tables" / "summary.md", tables.to_markdown())
    names = ("trials.csv", "uncertainty.csv", "series.csv", "summary.csv", "comparisons.csv", "tables/summary.md")
    return [directory / name for name in names]


def _write_table(
    table: DriversTable | RequirementsTable | RanksTable | TuningTable, directory: Path, name: str
) -> list[Path]:
    """Write NAME.csv and tables/NAME.md; what has no content is not written, and an earlier file is removed."""
    file, text = directory / "tables" / f"{name}.md", table.to_markdown()
    file.unlink(missing_ok=True)
    if text:
        replace_text(file, text)
    return [*_write_frame(table.frame, directory / f"{name}.csv"), *([file] if text else [])]


def _write_frame(frame: pd.DataFrame, path: Path) -> list[Path]:
    """Write a table that has rows; an earlier file is removed."""
    path.unlink(missing_ok=True)
    if not len(frame):
        return []
    write_csv(frame, path)
    return [path]


def _write_failures(results: Results, directory: Path, place: str) -> list[Path]:
    """Write a file for each of the first failed runs of every method, and remove those of runs that did not fail."""
    files = failure_files(results.trials, place, results.uncertainty, read(results.directory).get("versions", {}))
    for old in directory.glob("*-*.txt") if directory.is_dir() and not directory.is_symlink() else ():
        if old.name not in files:
            old.unlink()
    if files:
        folder(directory.parent, directory.name)
    for name, text in files.items():
        replace_text(directory / name, text)
    return [directory / name for name in files]


def _write_traces(trials: Trials, path: Path) -> list[Path]:
    """Write t, r and, for every point, method and signal, (runs, samples, components); NaN after a failure."""
    # A file of an earlier configuration would stay where this one records nothing.
    path.unlink(missing_ok=True)
    arrays: dict[str, Array] = {}
    for table in trials.each:
        for method, trace in table.exported_traces().items():
            where = "/".join(part for part in (table.title, method) if part)
            # A method may report a signal of one of these names.
            own = {name: f"{name}_reported" for name in ("runs", "r", "t")}
            arrays |= {f"{where}/{own.get(signal, signal)}": array for signal, array in trace.signals.items()}
            arrays |= {f"{where}/runs": trace.runs, f"{where}/r": trace.r}
            arrays[f"{where}/t"] = np.round((table.Ts or 1.0) * np.arange(len(trace.r)), 12)
    if arrays:
        with replaced(path) as partial:
            np.savez_compressed(partial, **arrays)  # type: ignore[arg-type]
    return [path] if arrays else []


def _write_claims(
    results: Results, verdicts: tuple[ClaimVerdict, ...], directory: Path, formats: Sequence[str]
) -> list[Path]:
    files = [directory / "claims.json", directory / "claims.md"]
    # Files of an earlier configuration would stay where this one has no claims.
    for file in files:
        file.unlink(missing_ok=True)
    if not verdicts:
        return []
    record = claims_record(verdicts, experiment_record(results))
    replace_text(files[0], json.dumps(record, indent=2) + "\n")
    ending = "svg" if "svg" in formats else formats[0]
    text = claims_markdown(verdicts, informational=not results.is_final, ending=ending)
    replace_text(files[1], text)
    return files


def experiment_record(results: Results) -> ExperimentRecord:
    """Describe the experiment by what is the same on every machine, since claims.json is kept under version control."""
    experiment = results.experiment
    # The directory of a user's own file is not known; those of papers have a place.
    file = f"configs/{experiment.paper}/{experiment.name}.yaml" if experiment.paper else f"{experiment.name}.yaml"
    return {
        "name": experiment.name,
        "title": experiment.title,
        "paper": experiment.paper,
        "identifier": IDENTIFIERS.get(experiment.paper or ""),
        "runs": len(results.trials.each[0].runs),
        "seed": results.trials.seed,
        "hash": experiment.hash,
        "version": rmpc_bench.__version__,
        "numerics": rmpc_bench.NUMERICS,
        "command": " ".join(["rmpc-bench run", shlex.quote(file), *results.overrides]),
        "final": results.is_final,
    }
