"""Files of figures: their formats, written with reproducible bytes."""

from __future__ import annotations

from collections.abc import Sequence
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rmpc_bench.figures.stable_svg import stable_svg
from rmpc_bench.figures.style import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure as MplFigure

FORMATS: dict[str, dict[str, Any]] = {
    ".svg": {"metadata": {"Date": None, "Creator": None}},
    ".png": {"metadata": {"Software": None}, "dpi": 200},
    ".pdf": {"metadata": {"CreationDate": None, "Creator": None, "Producer": None}},
}
"""Endings of files, with the settings that make their bytes the same every time."""


def save(figure: MplFigure, directory: Path, stem: str, formats: Sequence[str] = ("svg", "png")) -> list[Path]:
    """Write a picture in several formats, PNG with 200 dpi, with the same bytes every time.

    Parameters
    ----------
    figure : the picture
    directory : where to write; made if it does not exist
    stem : file name without ending
    formats : endings of the files

    Returns
    -------
    the files
    """
    directory.mkdir(parents=True, exist_ok=True)
    files = [directory / f"{stem}.{ending}" for ending in formats]
    for file in files:
        save_as(figure, file)
    return files


def save_as(figure: MplFigure, file: Path) -> None:
    """Write a picture in the format of the file's ending, with the same bytes every time.

    Parameters
    ----------
    figure : the picture
    file : ending with one of `FORMATS`; replaced
    """
    ending = file.suffix.lower()
    if ending != ".svg":
        with style():
            figure.savefig(file, format=ending[1:], **FORMATS[ending])
        return
    file.write_text(svg_of(figure), encoding="utf-8", newline="\n")


def svg_of(figure: MplFigure) -> str:
    """Return a picture as SVG, the same text every time.

    Parameters
    ----------
    figure : the picture
    """
    text = StringIO()
    with style():
        figure.savefig(text, format="svg", **FORMATS[".svg"])
    return stable_svg(text.getvalue())
