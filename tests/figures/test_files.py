"""Files of figures: text stays text of 8 pt, fonts are embedded, sizes are exact, bytes are the same everywhere."""

import os
import shutil
import subprocess
import sys
from copy import copy

import pytest
from matplotlib.font_manager import FontManager, fontManager, json_dump
from pypdf import PdfReader

from rmpc_bench.expressions.units import inches
from rmpc_bench.figures import files, style
from rmpc_bench.figures.boxplot import Boxplot
from rmpc_bench.figures.files import FORMATS, LEAST, THINNER, FigureResult, save, save_as, thin_lines
from rmpc_bench.figures.rows import Rows
from rmpc_bench.figures.style import Rendering, font_family, is_for_paper, rendered

COLUMN = inches("252pt")
SCRIPT = """
import sys
from matplotlib.figure import Figure
from rmpc_bench.figures.files import save
from rmpc_bench.figures.style import Rendering
from rmpc_bench.figures.style import rendered, style
from pathlib import Path
rendering = Rendering(font="stix", formats=("svg", "pdf", "png"))
with rendered(rendering), style():
    figure = Figure(figsize=(3.5, 2))
    axes = figure.subplots()
    axes.plot([1, 2, 3], label="R-MPC, $c=10^{-1}$")
    axes.legend()
save(figure, Path(sys.argv[1]), "a", rendering)
"""


def drawn(make_trials, kind=Boxplot, **keys):
    """A figure with a formula in a label, drawn as a report does."""
    rendering = Rendering(width=COLUMN, **keys)
    values = {"S-MPC": [1.0, 2.0, 3.0, 9.0], "R": [1.5, 2.5, 3.0, 4.0]}
    trials = make_trials({"mse": values}, labels={"R": "R-MPC, $c=10^{-1}$"})
    with rendered(rendering):
        return kind(width=COLUMN).draw(trials), rendering


def text_sizes(page):
    """Sizes of all texts of a page of a PDF [pt, of which an inch has 72]."""
    sizes = []

    def visit(text, cm, tm, font, size):
        if text.strip():
            sizes.append(round(size * abs(tm[0] * tm[3] - tm[1] * tm[2]) ** 0.5, 3))

    page.extract_text(visitor_text=visit)
    return sizes


@pytest.mark.parametrize(("font", "kind"), [("dejavu", Boxplot), ("stix", Rows), ("times", Boxplot)])
def test_pdf(make_trials, tmp_path, font, kind):
    """The width is exact, fonts are embedded as TrueType, texts are 8 pt and indices smaller, and there is no date."""
    picture, rendering = drawn(make_trials, kind, font=font, formats=("pdf",))
    (file,) = save(picture, tmp_path, "a", rendering)
    reader = PdfReader(file)
    (page,) = reader.pages
    assert float(page.mediabox.width) == pytest.approx(252 * 72 / 72.27, abs=1e-3)
    assert "/CreationDate" not in (reader.metadata or {})
    resources = page["/Resources"]["/Font"].values()
    for each in resources:
        descendant = each.get_object()["/DescendantFonts"].get_object()[0].get_object()
        assert descendant["/Subtype"] == "/CIDFontType2" and "/FontFile2" in descendant["/FontDescriptor"].get_object()
    sizes = text_sizes(page)
    assert sizes and set(sizes) <= {8.0, 5.6} and sizes.count(8.0) > len(sizes) / 2
    assert "S-MPC" in page.extract_text()


def written(place, script, **environment):
    """Run a script in a process of its own and return the bytes of its files."""
    arguments = [sys.executable, "-c", script, str(place)]
    subprocess.run(arguments, env={**os.environ, **environment}, check=True, timeout=120)
    return {file.name: file.read_bytes() for file in place.iterdir() if file.suffix != ".json"}


def test_the_same_bytes_in_every_process(tmp_path):
    """Where Python orders its sets in another way, and where the list of fonts that all processes share is damaged."""
    damaged = copy(fontManager)
    damaged.ttflist = [each for each in fontManager.ttflist if each.fname.endswith("DejaVuSans.ttf")]
    found = []
    for seed, fonts_of in (("1", fontManager), ("2", damaged)):
        place = tmp_path / seed
        place.mkdir()
        json_dump(fonts_of, place / f"fontlist-v{FontManager.__version__}.json")
        found.append(written(place, SCRIPT, PYTHONHASHSEED=seed, MPLCONFIGDIR=str(place)))
    assert found[0] == found[1] and set(found[0]) == {"a.svg", "a.pdf", "a.png"}


@pytest.mark.parametrize("ending", FORMATS)
def test_the_same_bytes_twice(make_trials, tmp_path, ending):
    """No date, no version; writing a picture does not change it; the ending may be in capitals; PGF has 8 pt."""
    if ending == ".pgf" and files.latex_program() is None:
        pytest.skip("no LaTeX is installed, and it measures the texts of PGF")
    picture, _ = drawn(make_trials)
    one, other = tmp_path / f"one{ending}", tmp_path / f"other{ending.upper()}"
    for file in (one, other):
        save_as(picture, file)
    assert one.read_bytes() == other.read_bytes()
    dated = b"matplotlib.org", b"Matplotlib v", b"CreationDate", b"dc:date"
    assert not any(word in one.read_bytes() for word in dated)
    assert ending != ".pgf" or ("S-MPC" in one.read_text() and r"\fontsize{8.000000}" in one.read_text())


def test_fonts(monkeypatch):
    """Times is a Times of the system, else STIX with a remark; the choice ends with the block."""
    with rendered(Rendering(font="stix", style="paper")):
        assert font_family() == "STIXGeneral" and is_for_paper()
    assert font_family() == "DejaVu Sans" and not is_for_paper()
    monkeypatch.setattr(style, "_is_installed", lambda family: family == "Liberation Serif")
    style.family_of.cache_clear()
    assert style.family_of("times") == "Liberation Serif" and style.remark_on("times") == ""
    monkeypatch.setattr(style, "_is_installed", lambda family: False)
    style.family_of.cache_clear()
    assert style.family_of("times") == "STIXGeneral" and "STIX" in style.remark_on("times")
    style.family_of.cache_clear()
    assert style.remark_on("dejavu") == ""


def test_lines_of_a_paper_are_thinner_and_pgf_needs_a_latex(make_trials, tmp_path, monkeypatch):
    picture, _ = drawn(make_trials)
    before = [line.get_linewidth() for line in picture.axes[0].lines]
    thin_lines(picture)
    after = [line.get_linewidth() for line in picture.axes[0].lines]
    assert after == pytest.approx([max(min(LEAST, width), THINNER * width) for width in before])
    monkeypatch.setattr(shutil, "which", lambda name: None)
    picture, _ = drawn(make_trials)
    with pytest.raises(FileNotFoundError, match="pgf needs a LaTeX"):
        FigureResult(picture).save(tmp_path / "a.pgf")


def test_what_matplotlib_warns_of_is_said_once_in_own_words(make_trials, tmp_path, capsys):
    """A font without a character of a label; no warning with a line of this program."""
    picture, rendering = drawn(make_trials, formats=("svg",))
    with rendered(rendering):
        picture.axes[0].set_title("\u6bd4")
    for name in ("a", "b"):
        save(picture, tmp_path, name, rendering)
    assert capsys.readouterr().err == "figures: the font DejaVu Sans lacks \u6bd4; choose others for figures\n"
