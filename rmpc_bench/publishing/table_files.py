"""Tables, series, recorded runs, failures and claims of an experiment as files, also those for a LaTeX document."""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import rmpc_bench
from rmpc_bench.analysis.columns import Columns, n_rows, series_columns
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.claims.claim import IDENTIFIERS
from rmpc_bench.claims.markdown import claims_markdown
from rmpc_bench.claims.record import ExperimentRecord, claims_record
from rmpc_bench.claims.verdict import ClaimVerdict
from rmpc_bench.config.report import ReportKeys
from rmpc_bench.figures.style import own_words
from rmpc_bench.replaced_file import folder, replace_text, replaced
from rmpc_bench.report.calibration_table import CALIBRATION, CalibrationTable, calibration_table
from rmpc_bench.report.latex import WIDTH
from rmpc_bench.report.latex_text import printed_latex
from rmpc_bench.report.notes import latex_tables
from rmpc_bench.report.point_tables import FrameTable, comparisons_table, summary_table, trials_csv, write_csv
from rmpc_bench.report.run_notes import failure_files
from rmpc_bench.report.run_tables import lost_table
from rmpc_bench.report.source import Evaluation
from rmpc_bench.report.summary import Summary
from rmpc_bench.report.two_way_table import two_way_content
from rmpc_bench.results.evaluate import judge, ranks, requirements, summarise
from rmpc_bench.results.manifest import read
from rmpc_bench.results.results import Results
from rmpc_bench.types import Array

POINTS = 72.27  # points of LaTeX in an inch
WRITTEN = "% written by rmpc-bench"
"""Beginning of these files; a file that begins otherwise belongs to the user and is kept."""


def write_latex(
    tables: Summary, calibration: CalibrationTable, record: ExperimentRecord, directory: Path, report: ReportKeys
) -> list[Path]:
    """Write the tables for a paper with their captions and notes, and remove those of an earlier choice of metrics."""
    comments = [
        f"{WRITTEN[2:]}, version {record['version']}, numerics {record['numerics']}",
        f"experiment {record['name']}, hash {record['hash']}",
        f"seed {record['seed']}, n = {record['runs']} runs per method",
        record["command"],
    ]
    width = WIDTH if report.width_in is None else POINTS * report.width_in
    files = {}
    # The formulas of names are measured with the font of figures.
    with own_words():
        # A metric may have the name of the table of calibration.
        found = calibration.to_latex(comments) | latex_tables(tables, comments, report.columns, width)
    for name, table in found.items():
        files[f"{name}.tex"] = table.body
        files[f"{name}.caption.tex"] = f"{_head(name)}{table.caption}"
        files[f"{name}.note.tex"] = f"{_head_of_note(name)}{table.note}"
    for old in directory.glob("*.tex"):
        if old.name not in files and old.is_file() and not old.is_symlink() and _is_ours(old):
            old.unlink()
    for name, text in files.items():
        replace_text(directory / name, text)
    return [directory / name for name in files]


def _is_ours(file: Path) -> bool:
    with file.open("rb") as lines:
        return lines.read(len(WRITTEN.encode())) == WRITTEN.encode()


def _head(name: str) -> str:
    """Say how a document includes a caption."""
    return f"{WRITTEN}\n% \\caption{{\\protect\\input{{{name}.caption}}}}\n"


def _head_of_note(name: str) -> str:
    """Say how a document includes a note."""
    box = r"\par\smallskip\parbox{\linewidth}"
    return f"{WRITTEN}\n% below the table: {box}{{\\footnotesize\\input{{{name}.note}}}}\n"


def write_caption(caption: str, stem: Path) -> Path:
    """Write the caption of a figure, with formulas between dollar signs, beside its files; `stem` has no ending."""
    file = stem.with_name(f"{stem.name}.caption.tex")
    replace_text(file, f"{_head(stem.name)}{printed_latex(caption)}%\n")
    return file


def write_summary(results: Results, tables: Summary, directory: Path) -> list[Path]:
    """Write the rows of all runs, where the report has them, summary and comparisons."""
    rows = [directory / "trials.csv"] if results.experiment.report.writes_trials(n_rows(results.stored.columns)) else []
    for path in rows:
        trials_csv(results.stored, path)
    if not rows:
        (directory / "trials.csv").unlink(missing_ok=True)
    write_csv(results.quantities, directory / "uncertainty.csv")
    write_csv(series_columns(results.trials.over_time, results.trials.paths), directory / "series.csv")
    write_csv(summary_table(tables.described_columns), directory / "summary.csv")
    write_csv(comparisons_table(tables.compared_columns), directory / "comparisons.csv")
    replace_text(directory / "tables" / "summary.md", tables.to_markdown())
    names = ("uncertainty.csv", "series.csv", "summary.csv", "comparisons.csv", "tables/summary.md")
    return [*rows, *(directory / name for name in names)]


def write_table(table: FrameTable, directory: Path, name: str) -> list[Path]:
    """Write NAME.csv and tables/NAME.md; what has no content is not written, and an earlier file is removed."""
    file, text = directory / "tables" / f"{name}.md", table.to_markdown()
    file.unlink(missing_ok=True)
    if text:
        replace_text(file, text)
    return [*write_rows(table.content, directory / f"{name}.csv"), *([file] if text else [])]


def write_rows(columns: Columns, path: Path) -> list[Path]:
    """Write a table that has rows; an earlier file is removed."""
    path.unlink(missing_ok=True)
    if not n_rows(columns):
        return []
    write_csv(columns, path)
    return [path]


def write_failures(results: Results, directory: Path, place: str) -> list[Path]:
    """Write a file for each of the first failed runs of every method, and remove those of runs that did not fail."""
    files = failure_files(results.trials, place, results.quantities, read(results.directory).get("versions", {}))
    for old in directory.glob("*-*.txt") if directory.is_dir() and not directory.is_symlink() else ():
        if old.name not in files:
            old.unlink()
    if files:
        folder(directory.parent, directory.name)
    for name, text in files.items():
        replace_text(directory / name, text)
    return [directory / name for name in files]


def write_traces(trials: Trials, path: Path) -> list[Path]:
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


def write_claims(
    results: Results, verdicts: Sequence[ClaimVerdict], directory: Path, formats: Sequence[str]
) -> list[Path]:
    """Write claims.json and claims.md; `formats` are those of the figures that the claims name."""
    files = [directory / "claims.json", directory / "claims.md"]
    # Files of an earlier configuration would stay where this one has no claims.
    for file in files:
        file.unlink(missing_ok=True)
    if not verdicts:
        return []
    record = claims_record(verdicts, experiment_record(results))
    replace_text(files[0], json.dumps(record, indent=2) + "\n")
    ending = "svg" if "svg" in formats else formats[0]
    replace_text(files[1], claims_markdown(verdicts, informational=not results.is_final, ending=ending))
    return files


def write_tables(
    results: Results, found: Evaluation, directory: Path, place: str, formats: Sequence[str]
) -> list[Path]:
    """Write everything but pictures, pages and what is for a LaTeX document."""
    return [
        *write_summary(results, found.tables, directory),
        *write_table(found.drivers, directory, "drivers"),
        *write_table(found.requirements, directory, "requirements"),
        *write_rows(lost_table(found.trials), directory / "lost.csv"),
        *write_table(found.ranks, directory, "ranks"),
        *write_rows(two_way_content(found.trials), directory / "two-way.csv"),
        *write_table(found.tuning, directory, "tuning"),
        *write_table(found.calibration, directory, CALIBRATION),
        *write_traces(results.stored, directory / "traces.npz"),
        *write_claims(results, found.verdicts, directory, formats),
        *write_rows(results.durations, directory / "timings.csv"),
        *write_failures(results, directory / "failures", place),
    ]


def write_tables_of_rows(results: Results, directory: Path, file: str) -> None:
    """Write the tables and claims that follow from metrics and statuses alone."""
    report, trials, calibration = results.experiment.report, results.trials, calibration_table(results.trials)
    tables = summarise(results).shown(report.order, results.experiment.shown_metrics)
    texts = folder(directory, "tables")
    write_csv(summary_table(tables.described_columns), directory / "summary.csv")
    write_csv(comparisons_table(tables.compared_columns), directory / "comparisons.csv")
    write_table(requirements(results), directory, "requirements")
    write_rows(lost_table(trials), directory / "lost.csv")
    write_table(ranks(results), directory, "ranks")
    write_rows(two_way_content(trials), directory / "two-way.csv")
    write_table(calibration, directory, CALIBRATION)
    if not any(notes.holds or notes.optimises for table in trials.each for notes in table.notes.values()):
        write_latex(tables, calibration, experiment_record(results, file), texts, report)
    if not any(table.groups for table in trials.each):
        write_claims(results, judge(results), directory, report.formats)


def experiment_record(results: Results, file: str = "") -> ExperimentRecord:
    """Describe the experiment, with a command that names `file`, its configuration.

    Without it the record is the same on every machine, since claims.json is kept under version control.
    """
    experiment = results.experiment
    imported = experiment.imported
    if not file:
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
        "command": imported.command
        if imported
        else " ".join(["rmpc-bench run", shlex.quote(file), *results.overrides]),
        "final": results.is_final,
    }
