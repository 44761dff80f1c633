"""Files for a LaTeX document: tables with their captions, and captions of figures."""

from __future__ import annotations

from pathlib import Path

from rmpc_bench.claims.record import ExperimentRecord
from rmpc_bench.config.report_section import ReportKeys
from rmpc_bench.figures.style import own_words
from rmpc_bench.replaced_file import replace_text
from rmpc_bench.report.latex import WIDTH
from rmpc_bench.report.latex_text import printed_latex
from rmpc_bench.report.notes import latex_tables
from rmpc_bench.report.summary import Summary

POINTS = 72.27
"""Points of LaTeX in an inch."""
WRITTEN = "% written by rmpc-bench"
"""Beginning of these files; a file that begins otherwise belongs to the user and is kept."""


def write_latex(tables: Summary, record: ExperimentRecord, directory: Path, report: ReportKeys) -> list[Path]:
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
        found = latex_tables(tables, comments, report.columns, width)
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
