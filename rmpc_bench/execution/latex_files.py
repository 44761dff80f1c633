"""Files for a LaTeX document: tables with their captions, and captions of figures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rmpc_bench.claims.record import ExperimentRecord
from rmpc_bench.report.caption import latex_captions
from rmpc_bench.report.latex import latex_tables
from rmpc_bench.report.latex_text import to_latex
from rmpc_bench.report.summary import Summary
from rmpc_bench.types.report_choices import Column

WRITTEN = "% written by rmpc-bench"
"""Beginning of these files; a file that begins otherwise belongs to the user and is kept."""


def write_latex(
    tables: Summary, record: ExperimentRecord, directory: Path, columns: Sequence[Column] | None
) -> list[Path]:
    """Write the tables for a paper with their captions, and remove those of an earlier choice of metrics.

    Parameters
    ----------
    tables : the statistics, with the methods and metrics to show
    record : name, hash, seed, number of runs, version and command
    directory : where to write
    columns : columns behind the name of the method; the usual ones if None

    Returns
    -------
    the files
    """
    comments = [
        f"{WRITTEN[2:]}, version {record['version']}, numerics {record['numerics']}",
        f"experiment {record['name']}, hash {record['hash']}",
        f"seed {record['seed']}, n = {record['runs']} runs per method",
        record["command"],
    ]
    files = {f"{name}.tex": text for name, text in latex_tables(tables, comments, columns).items()}
    captions = latex_captions(tables, columns)
    files |= {f"{name}.caption.tex": f"{WRITTEN}\n{text}" for name, text in captions.items()}
    for old in directory.glob("*.tex"):
        if old.name not in files and not old.is_symlink() and old.read_bytes().startswith(WRITTEN.encode()):
            old.unlink()
    for name, text in files.items():
        (directory / name).write_text(text, encoding="utf-8")
    return [directory / name for name in files]


def write_caption(caption: str, stem: Path) -> Path:
    """Write the caption of a figure beside its files.

    Parameters
    ----------
    caption : plain text with formulas between dollar signs
    stem : path of the figure without ending
    """
    file = stem.with_name(f"{stem.name}.caption.tex")
    file.write_text(f"{WRITTEN}\n{to_latex(caption)}%\n", encoding="utf-8")
    return file
