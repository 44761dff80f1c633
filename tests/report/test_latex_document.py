"""A paper with generated tables and figures compiles, nothing is wider than a column, and texts are 8 pt."""

import shutil
import subprocess

import pytest
from pypdf import PdfReader
from small_experiment import cli, ran, write

LATEX = shutil.which("pdflatex")
NO_LATEX = "no pdflatex is installed, and the document needs one"
pytestmark = [pytest.mark.slow, pytest.mark.skipif(LATEX is None, reason=NO_LATEX)]
DOCUMENT = r"""
\documentclass[%s]{%s}
\usepackage{booktabs,graphicx}
%s
\begin{document}
\typeout{columnwidth \the\columnwidth}
%s
\end{document}
"""
TABLE = (
    r"\begin{table}[!ht]\centering\footnotesize\caption{\protect\input{tables/%s.caption}}\input{tables/%s}\end{table}"
)
FIGURE = (
    r"\begin{figure}[!ht]\centering\includegraphics{figures/%s}\caption{\protect\input{figures/%s.caption}}\end{figure}"
)
METHODS = (
    "{S-MPC: {estimator: {kind: kalman}, label: 'S_MPC & 50% #1 ~x^2 {y} \\z'},"
    " R-MPC: {estimator: {kind: robust-kalman, c: 0.1}, label: 'R-MPC, $c=${c}$'}}"
)


def document(body):
    finder = shutil.which("kpsewhich")
    if finder and subprocess.run([finder, "IEEEtran.cls"], capture_output=True, check=False).returncode == 0:
        return DOCUMENT % ("journal", "IEEEtran", "", body)
    width = r"\setlength{\columnsep}{16pt}\usepackage[textwidth=520pt]{geometry}"
    return DOCUMENT % ("twocolumn", "article", width, body)


def compiled(place, source):
    """Messages of LaTeX, none of an overfull box, and the PDF."""
    (place / "paper.tex").write_text(source)
    command = [LATEX, "-interaction=nonstopmode", "-halt-on-error", "paper.tex"]
    done = subprocess.run(command, cwd=place, capture_output=True, check=False, timeout=120)
    messages = done.stdout.decode(errors="replace")
    assert done.returncode == 0 and "Overfull" not in messages, messages[-2000:]
    return messages, PdfReader(place / "paper.pdf")


def written(place, *options, **keys):
    """Tables and figures of a small experiment for a column of 252 pt."""
    ran(write(place, figures="[boxplot, rows]", methods=METHODS, runs=30, **keys), place / "stored")
    result = cli("report", place / "stored", "--to", place, "--width", "252pt", "--style", "paper", *options)
    assert result.exit_code == 0, result.output


@pytest.mark.parametrize("sweep", [None, "{grid: {controller.Hu: [2, 3]}}"], ids=["one point", "sweep"])
def test_paper(tmp_path, sweep):
    """No error and no overfull box; `figures/test_files` has the fonts of figures."""
    written(tmp_path, "--font", "times", sweep=sweep)
    body = "\n".join(
        [TABLE % (name, name) for name in ("mse", "input_power", "all-metrics")]
        + [FIGURE % (name, name) for name in ("boxplot", "rows")]
    )
    messages, _ = compiled(tmp_path, document(body))
    assert "columnwidth 252" in messages


def test_pgf_in_a_document(tmp_path):
    written(tmp_path, "--format", "pgf,pdf")
    body = r"\begin{figure}\centering\input{figures/boxplot.pgf}\end{figure}"
    source = document(body).replace("{booktabs,graphicx}", "{booktabs,graphicx,pgf}\n\\def\\mathdefault#1{#1}")
    _, reader = compiled(tmp_path, source)
    assert "R-MPC" in "".join(page.extract_text() for page in reader.pages)
