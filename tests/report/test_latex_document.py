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
    """A paper with two columns of 252 pt."""
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
    """No error, no overfull box, embedded fonts, texts of figures at 8 pt."""
    written(tmp_path, "--font", "times", sweep=sweep)
    body = "\n".join(
        [TABLE % (name, name) for name in ("mse", "input_power", "all-metrics")]
        + [FIGURE % (name, name) for name in ("boxplot", "rows")]
    )
    messages, reader = compiled(tmp_path, document(body))
    assert "columnwidth 252" in messages
    assert all(embedded(font.get_object()) for page in reader.pages for font in fonts_of(page))
    sizes = []
    for name in ("boxplot", "rows"):
        (page,) = PdfReader(tmp_path / "figures" / f"{name}.pdf").pages

        def visit(text, cm, tm, font, size):
            sizes.extend([round(size, 3)] if text.strip() else [])

        page.extract_text(visitor_text=visit)
    # Exponents are smaller; nothing else is.
    assert set(sizes) <= {8.0, 5.6} and 8.0 in sizes


def fonts_of(page):
    """Fonts of a page and of the figures on it."""
    found, parts = [], [page]
    while parts:
        resources = parts.pop().get("/Resources")
        if resources is None:
            continue
        resources = resources.get_object()
        found += resources.get("/Font", {}).values()
        parts += [part.get_object() for part in resources.get("/XObject", {}).values()]
    return found


def embedded(font):
    """Whether the file of a font is in the PDF."""
    if "/DescendantFonts" in font:
        font = font["/DescendantFonts"].get_object()[0].get_object()
    return any(key in font["/FontDescriptor"].get_object() for key in ("/FontFile", "/FontFile2", "/FontFile3"))


def test_pgf_in_a_document(tmp_path):
    """The document sets the texts of a figure itself."""
    written(tmp_path, "--format", "pgf,pdf")
    body = r"\begin{figure}\centering\input{figures/boxplot.pgf}\end{figure}"
    source = document(body).replace("{booktabs,graphicx}", "{booktabs,graphicx,pgf}\n\\def\\mathdefault#1{#1}")
    _, reader = compiled(tmp_path, source)
    assert "R-MPC" in "".join(page.extract_text() for page in reader.pages)
