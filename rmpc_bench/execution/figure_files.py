"""The figures of an experiment as files; those of a user are drawn by `run` only, which loads their code."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from rmpc_bench.components.code import CodeError
from rmpc_bench.components.designs import is_built_in
from rmpc_bench.components.figure_names import figure_names
from rmpc_bench.components.loading import user_code
from rmpc_bench.config.short_forms import FILE
from rmpc_bench.execution.evaluation import figure_component, figure_of
from rmpc_bench.execution.results import Results
from rmpc_bench.figures.files import save, svg_of
from rmpc_bench.figures.rendering import Rendering
from rmpc_bench.types import DesignError

OWN = "is not part of this package, and stored results are read without its code; `rmpc-bench run` draws it"


class WrittenFigure(NamedTuple):
    """A figure with its files."""

    name: str
    """File name without ending, such as ``boxplot`` or ``boxplot-2``."""
    kind: str
    """Kind, or the reference to a user's figure."""
    keys: Mapping[str, Any]
    """The keys of the configuration."""
    caption: str
    """What it shows, in full sentences."""
    paths: tuple[Path, ...]
    """One file per format."""
    svg: str = ""
    """The picture as SVG, whatever the formats."""


def write_figures(
    results: Results, directory: Path, rendering: Rendering
) -> tuple[tuple[WrittenFigure, ...], tuple[str, ...]]:
    """Draw the figures of an experiment.

    Parameters
    ----------
    results : what to draw
    directory : where the pictures are written
    rendering : width, font, style and formats

    Returns
    -------
    the figures, and what could not be drawn with the reason
    """
    figures: list[WrittenFigure] = []
    left_out: list[str] = []
    kinds = [str(keys.get(FILE) or keys["kind"]) for keys in results.experiment.figures]
    for number, (kind, stem) in enumerate(zip(kinds, figure_names(kinds), strict=True)):
        keys = results.experiment.figures[number]
        try:
            figures.append(WrittenFigure(stem, kind, keys, *_written(results, number, directory / stem, rendering)))
        except DesignError as error:
            # A method that the figure shows has not been computed yet.
            left_out.append(f"{kind}: {error}")
        except CodeError as error:
            left_out.append(f"{kind}: {error.line}")
    return tuple(figures), tuple(left_out)


def write_more(
    results: Results, wanted: Sequence[Mapping[str, Any]], directory: Path, rendering: Rendering
) -> tuple[WrittenFigure, ...]:
    """Draw figures that the configuration does not name, as SVG; what the results cannot show is left out.

    Parameters
    ----------
    results : what to draw
    wanted : the keys of every figure
    directory : where the pictures are written
    rendering : width, font and style
    """
    figures = []
    for keys in wanted:
        try:
            made = figure_of(results, figure_component(keys))
            picture, caption = made.draw(results.plotted), str(made.caption(results.plotted))
        except DesignError:
            continue
        paths = save(picture, directory, keys["kind"], ("svg",))
        figures.append(WrittenFigure(keys["kind"], keys["kind"], keys, caption, tuple(paths), _svg(picture, paths)))
    return tuple(figures)


def _svg(picture: Any, paths: Sequence[Path]) -> str:
    """Return the picture as SVG: the content of its file, if there is one."""
    file = next((path for path in paths if path.suffix == ".svg"), None)
    return svg_of(picture) if file is None else file.read_text(encoding="utf-8")


def _written(results: Results, number: int, stem: Path, rendering: Rendering) -> tuple[str, tuple[Path, ...], str]:
    """Draw a figure and write its files; return its caption, the files and the SVG."""
    keys = results.experiment.figures[number]
    own = results.components.get(number)
    if own is not None:
        # The code of a user may raise anything; the tables and the other figures are written all the same.
        with user_code(None if own.code is None else own.code.path):
            made = figure_of(results, own)
            picture = made.draw(results.plotted)
            if not hasattr(picture, "savefig"):
                raise DesignError(f"draw returned {type(picture).__name__}, not a figure of matplotlib")
            return _saved(str(made.caption(results.plotted)), picture, stem, rendering)
    if FILE in keys or not is_built_in("figures", keys["kind"]):
        raise DesignError(OWN)
    made = figure_of(results, figure_component(keys))
    picture = made.draw(results.plotted)
    return _saved(made.caption(results.plotted), picture, stem, rendering)


def _saved(caption: str, picture: Any, stem: Path, rendering: Rendering) -> tuple[str, tuple[Path, ...], str]:
    paths = save(picture, stem.parent, stem.name, rendering.formats)
    return caption, tuple(paths), _svg(picture, paths)
