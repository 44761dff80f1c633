"""Figures of stored results, alone and as files; `run` alone draws those of a user, whose code it loads."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from rmpc_bench.analysis.layout import layout_of
from rmpc_bench.components.designs import figure_names, is_built_in, replacement_of
from rmpc_bench.components.loading import user_code
from rmpc_bench.components.reference import CodeError
from rmpc_bench.config.report import ReportKeys
from rmpc_bench.config_file.component import Component, read_component
from rmpc_bench.config_file.tree import FILE, Map, Mark
from rmpc_bench.figures.files import FigureResult, page_svg, save, thin_lines
from rmpc_bench.figures.style import Place, Rendering, rendered
from rmpc_bench.figures.svg_text import for_page
from rmpc_bench.publishing.table_files import write_caption
from rmpc_bench.report.source import PageFigure
from rmpc_bench.results.results import Results
from rmpc_bench.types import ConfigError, DesignError, Figure
from rmpc_bench.types.errors import check_arguments

PRINTED = ("pdf", "pgf")  # formats for papers
OWN = "is not part of this package, and stored results are read without its code; `rmpc-bench run` draws it"


def write_figures(
    results: Results, directory: Path, rendering: Rendering
) -> tuple[tuple[PageFigure, ...], tuple[str, ...]]:
    """Draw the figures of an experiment."""
    figures: list[PageFigure] = []
    left_out: list[str] = []
    kinds = [str(keys.get(FILE) or keys["kind"]) for keys in results.experiment.figures]
    for number, (kind, stem) in enumerate(zip(kinds, figure_names(kinds), strict=True)):
        try:
            with rendered(rendering):
                caption, paths, svg = _written(results, number, directory / stem, rendering)
            figures.append(PageFigure(stem, kind, caption, svg, paths))
        except DesignError as error:
            # A method that the figure shows has not been computed yet.
            left_out.append(f"{kind}: {error}")
        except CodeError as error:
            left_out.append(f"{kind}: {error.line}")
    return tuple(figures), tuple(left_out)


def more_figures(results: Results, wanted: Sequence[Mapping[str, Any]], rendering: Rendering) -> list[PageFigure]:
    """Draw figures that are no files, only inside of the page; what the results cannot show is left out."""
    figures = []
    rendering = replace(rendering, formats=())
    for keys in wanted:
        kind = keys["kind"]
        try:
            with rendered(rendering):
                made = figure_of(results, figure_component(keys), rendering)
                picture, caption, _ = _drawn(made, results, Path(kind), rendering)
                figures.append(PageFigure(kind, kind, caption, page_svg(picture, kind)))
        except DesignError:
            continue
    return figures


def _written(results: Results, number: int, stem: Path, rendering: Rendering) -> tuple[str, tuple[Path, ...], str]:
    """Find a figure of an experiment, draw it and write its files; return caption, files and SVG."""
    keys = results.experiment.figures[number]
    own = results.components.get(number)
    if own is not None:
        # The code of a user may raise anything; the tables and the other figures are written all the same.
        with user_code(None if own.code is None else own.code.path):
            return _saved(figure_of(results, own, rendering), results, stem, rendering)
    if FILE not in keys and (old := replacement_of("figures", keys["kind"])):
        raise DesignError(old)
    if FILE in keys or not is_built_in("figures", keys["kind"]):
        raise DesignError(OWN)
    return _saved(figure_of(results, figure_component(keys), rendering), results, stem, rendering)


def _saved(made: Figure, results: Results, stem: Path, rendering: Rendering) -> tuple[str, tuple[Path, ...], str]:
    """Draw a figure and write its files; those for papers have the labels of methods in place of their keys."""
    trials = results.plotted
    printed = tuple(each for each in rendering.formats if each in PRINTED)
    with_labels = bool(printed) and any(trials.labels.get(name, name) != name for name in trials.methods)
    own = tuple(each for each in rendering.formats if not (with_labels and each in printed))
    picture, caption, paths = _drawn(made, results, stem, replace(rendering, formats=own))
    file = next((path for path in paths if path.suffix == ".svg"), None)
    svg = page_svg(picture, stem.name) if file is None else for_page(file.read_text(encoding="utf-8"), stem.name)
    printed_caption = caption
    if with_labels:
        _, printed_caption, more = _drawn(made, results, stem, replace(rendering, formats=printed, labels=True))
        paths = [path for ending in rendering.formats for path in (*paths, *more) if path.suffix == f".{ending}"]
    if printed:
        paths.append(write_caption(printed_caption, stem))
    return caption, tuple(paths), svg


def _drawn(made: Figure, results: Results, stem: Path, rendering: Rendering) -> tuple[Any, str, list[Path]]:
    """Draw a figure, and write it in the formats of a rendering; return picture, caption and files."""
    picture = _picture(made, results, rendering)
    with rendered(rendering):
        return picture, str(made.caption(results.plotted)), save(picture, stem.parent, stem.name, rendering)


def _picture(made: Figure, results: Results, rendering: Rendering) -> Any:
    """Draw a figure whose keys are validated."""
    with rendered(rendering):
        picture = made.draw(results.plotted)
        if rendering.place is None and not hasattr(picture, "savefig"):
            raise DesignError(f"draw returned {type(picture).__name__}, not a figure of matplotlib")
        if rendering.style == "paper":
            thin_lines(picture)
        return picture


def figure(
    results: Results, kind: str, *, ax: Any = None, rendering: Rendering | None = None, **keys: Any
) -> FigureResult:
    """Draw a figure from stored results.

    Parameters
    ----------
    results : from `run` or `load_results`
    kind : kind of the figure, such as ``boxplot``; see ``rmpc-bench list figures``
    ax : where to draw in a picture of yours: an Axes for a figure with one panel, a SubFigure for any other
    rendering : font, style and width; the usual ones unless given
    keys : keys of the figure as in a configuration; ``from_`` stands for ``from``, and `width` may be a text, ``252pt``

    Returns
    -------
    the figure, with `axes` and `save(path)`

    Raises
    ------
    DesignError
        If the kind or a key is unknown, or the results do not hold what the figure shows.

    Examples
    --------
    >>> import rmpc_bench
    >>> results = rmpc_bench.run({"name": "small", "extends": "quickstart", "runs": 4})
    >>> picture = figure(results, "boxplot", metric="settling_time", width=3.5)
    >>> picture.save(results.directory / "settling_time.svg").name
    'settling_time.svg'
    """
    check_arguments(figure, locals())
    if ax is not None:
        place = Place(ax)
        rendering = replace(rendering or Rendering(), place=place)
        keys = {"width": max(1.0, place.get_figwidth()), **keys}
    if isinstance(keys.get("width"), str):
        keys["width"] = ReportKeys(width=keys["width"]).width_in
    rendering = rendering or Rendering()
    component = figure_component({"kind": kind, **{key.rstrip("_"): keys[key] for key in keys}})
    picture = _picture(figure_of(results, component, rendering), results, rendering)
    return FigureResult(rendering.place.root if rendering.place else picture, rendering)


def figure_component(keys: Mapping[str, Any]) -> Component:
    """Validate the keys of a figure, as in a configuration; a wrong one is a `DesignError`."""
    mark = Mark("", 1, 1)
    with _as_design_error():
        return read_component("figures", Map(keys, mark=mark), [], mark=mark)


def figure_of(results: Results, component: Component, rendering: Rendering) -> Figure:
    """Build a figure whose keys are validated, with what the section `report` says of all figures.

    A metric that is not named is the first of the report, else the primary one.  The methods of the report are shown
    in its order, those of them that the figure itself names, or can show.
    """
    with _as_design_error():
        made: Figure = component.build()
    report = results.experiment.report
    shown = (report.metrics or [results.experiment.primary])[0]
    keys: dict[str, Any] = {key: shown for key in made.metric_keys if getattr(made, key) is None}
    if rendering.width is not None:
        keys["width"] = rendering.width
    made = replace(made, **keys)
    return replace(made, order=_order(results, made, report.order)) if report.order else made


def _order(results: Results, made: Figure, order: Sequence[str]) -> list[str] | None:
    """Return the methods of the report that a figure names, or can show; its own ones where none is left."""
    if made.order is not None:
        return [name for name in order if name in made.order] or made.order
    layout = layout_of(results.plotted)
    shown = [name for name in order if not any(i.key == "order" for i in replace(made, order=[name]).check(layout))]
    return shown or None


@contextmanager
def _as_design_error() -> Iterator[None]:
    """Raise a DesignError for wrong keys of a figure, which stand in no file."""
    try:
        yield
    except ConfigError as error:
        raise DesignError("; ".join(f"{each.path}: {each.message}" for each in error.found)) from None
