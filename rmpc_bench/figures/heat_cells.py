"""Panels of coloured cells over two swept values, with a common colour bar."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rmpc_bench.analysis.number_text import decimals
from rmpc_bench.figures.labels import POINTS_PER_INCH, literal, metric_label, typeset, width, with_unit, wrapped
from rmpc_bench.figures.style import FONT_SIZE, lay_out, style
from rmpc_bench.figures.sweep_axis import SweepAxis
from rmpc_bench.figures.sweep_values import NO_VALUE, PointValue, SweepValues, change_label, interval_words, runs_words
from rmpc_bench.types import Array, DesignError, MetricInfo
from rmpc_bench.types.figure import SweepFigure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap, Normalize
    from matplotlib.figure import Figure as MplFigure

    from rmpc_bench.analysis.trials import Trials

PALETTE = "cividis"
"""Blue over grey to yellow with rising lightness: ordered in black and white, and for colour-blind readers."""
LEVELS = 255
"""Colours of a palette; an odd number, as the one in the middle stands for no change."""
HATCH = "////"
ROW, PANEL = 0.24, 0.34
"""Heights of a row of cells and of a panel without them [in]."""
CELL_PAD = 3.0
"""Free width of a cell beside its number [points]."""
LIGHT = 0.5
"""Relative luminance from which on a cell has black numbers."""


class Grid(NamedTuple):
    """What a heat map shows."""

    info: MetricInfo
    x: SweepAxis
    y: SweepAxis
    places: Mapping[tuple[str, str], int]
    """Values of both axes -> place in the rows of the values."""
    title: str
    """Other coordinates, the same for all points."""
    values: SweepValues

    def cell(self, method: str, x: str, y: str) -> PointValue:
        """Return the value of a method at a point; NaN where the sweep leaves the point out."""
        place = self.places.get((x, y))
        return NO_VALUE if place is None else self.values.rows[place].get(method, NO_VALUE)

    def cells(self, method: str) -> dict[tuple[str, str], PointValue]:
        """Return all cells of a method that have a value."""
        found = {(x, y): self.cell(method, x, y) for y in self.y.texts for x in self.x.texts}
        return {place: value for place, value in found.items() if math.isfinite(value.middle)}


def draw_cells(keys: SweepFigure, trials: Trials, grid: Grid, *, log: bool, numbers: bool) -> MplFigure:
    """Draw a panel per method, one below the other, and the colour bar.

    Raises a DesignError if no cell has a value, or a logarithmic scale has one that is not positive.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure as MplFigure

    methods = grid.values.methods
    size = keys.size(0.75 + len(methods) * (PANEL + ROW * len(grid.y.texts)))
    colours, norm = _colours(grid, log=log)
    with style():
        figure = MplFigure(figsize=size, layout="constrained")
        panels = list(figure.subplots(len(methods), sharex=True, squeeze=False)[:, 0])
        for axes, name in zip(panels, methods, strict=True):
            _draw_panel(axes, grid, name, colours, norm)
            title = ", ".join(filter(None, [trials.labels.get(name, name), literal(grid.title)]))
            axes.set_title("\n".join(wrapped(typeset(title), 0.6 * size[0] * POINTS_PER_INCH)))
            axes.set_ylabel("\n".join(wrapped(grid.y.label, POINTS_PER_INCH * (0.3 + ROW * len(grid.y.texts)))))
        panels[-1].set_xlabel(grid.x.label)
        bar = figure.colorbar(ScalarMappable(norm, colours), ax=panels, pad=0.02, aspect=30, fraction=0.06)
        bar.outline.set_linewidth(0.6)
        for edge in grid.values.margin if grid.values.margin[1] > 0 else ():
            bar.ax.axhline(edge, color="black", lw=0.6)
        bar.set_label(_quantity(trials, grid))
        figure.suptitle(_note(trials, grid, 0.95 * size[0] * POINTS_PER_INCH), fontsize=FONT_SIZE)
        lay_out(figure)
        if numbers:
            _write_numbers(panels, grid, colours, norm)
        figure.set_layout_engine(None)
    return figure


def _colours(grid: Grid, *, log: bool) -> tuple[Colormap, Normalize]:
    """Choose palette and scale: about 0 with a grey margin for changes, from the least to the most for values."""
    import matplotlib
    from matplotlib.colors import ListedColormap, LogNorm, Normalize

    found = np.array([cell.middle for name in grid.values.methods for cell in grid.cells(name).values()])
    if not len(found):
        raise DesignError(f"no method has a value of {grid.info.name}", "metric")
    palette = matplotlib.colormaps[PALETTE].resampled(LEVELS)
    low, high = float(found.min()), float(found.max())
    if not grid.values.kind:
        if log and low <= 0:
            raise DesignError("must be false, since some values are not positive", "log")
        return palette, (LogNorm if log else Normalize)(low, high if high > low else low + (abs(low) or 1.0))
    reach = max(abs(low), abs(high), 1.5 * grid.values.margin[1]) or 1.0
    shades = palette(np.linspace(0.0, 1.0, LEVELS))
    at = np.linspace(-reach, reach, LEVELS)
    shades[(at >= grid.values.margin[0]) & (at <= grid.values.margin[1])] = palette(0.5)
    return ListedColormap(shades), Normalize(-reach, reach)


def _draw_panel(axes: Axes, grid: Grid, name: str, colours: Colormap, norm: Normalize) -> None:
    """Draw the cells of a method at equal distances, hatched where the interval of a change contains 0."""
    from matplotlib.patches import Rectangle

    axes.set_xlim(-0.5, len(grid.x.texts) - 0.5)
    axes.set_ylim(-0.5, len(grid.y.texts) - 0.5)
    axes.set_xticks(range(len(grid.x.texts)), [literal(text) for text in grid.x.texts])
    axes.set_yticks(range(len(grid.y.texts)), [literal(text) for text in grid.y.texts])
    axes.tick_params(length=0)
    for (x, y), cell in grid.cells(name).items():
        corner = grid.x.texts.index(x) - 0.5, grid.y.texts.index(y) - 0.5
        shade = colours(norm(cell.middle))
        axes.add_patch(Rectangle(corner, 1.0, 1.0, facecolor=shade, edgecolor="white", lw=0.6))
        if grid.values.kind and cell.has_zero:
            ink = _ink(shade)
            axes.add_patch(Rectangle(corner, 1.0, 1.0, fill=False, hatch=HATCH, edgecolor=ink, lw=0.0, alpha=0.45))


def _write_numbers(panels: Sequence[Axes], grid: Grid, colours: Colormap, norm: Normalize) -> None:
    """Write the numbers into the cells, if all of them fit."""
    n_places = _places(grid)
    signed = bool(grid.values.kind)
    for axes, name in zip(panels, grid.values.methods, strict=True):
        figure = axes.get_figure(root=True)
        assert figure is not None
        room = POINTS_PER_INCH / figure.dpi * axes.bbox.width / len(grid.x.texts) - CELL_PAD
        tall = POINTS_PER_INCH / figure.dpi * axes.bbox.height / len(grid.y.texts)
        texts = {place: _text(cell.middle, n_places, signed=signed) for place, cell in grid.cells(name).items()}
        if tall < 1.2 * FONT_SIZE or any(width(text) > room for text in texts.values()):
            return
    for axes, name in zip(panels, grid.values.methods, strict=True):
        for (x, y), cell in grid.cells(name).items():
            ink = _ink(colours(norm(cell.middle)))
            shade = colours(norm(cell.middle))
            at = grid.x.texts.index(x), grid.y.texts.index(y)
            box: dict[str, Any] = {"facecolor": shade, "edgecolor": "none", "pad": 0.8}
            text = _text(cell.middle, n_places, signed=signed)
            axes.text(*at, text, ha="center", va="center", color=ink, bbox=box, zorder=3)


def _text(value: float, n_places: int | None, *, signed: bool) -> str:
    if n_places is None:
        return f"{value:.3g}"
    text = f"{value:z.{n_places}f}"
    sign = "+" if signed and float(text) > 0 else ""
    return sign + text.replace("-", "\N{MINUS SIGN}")


def _places(grid: Grid) -> int | None:
    """Decimal places that the median interval supports; None for numbers of very different size."""
    cells = [cell for name in grid.values.methods for cell in grid.cells(name).values()]
    reaches: Array = np.array([(cell.high - cell.low) / 2 for cell in cells])
    sizes: Array = np.abs([cell.middle for cell in cells])
    sizes = sizes[sizes > 0]
    reaches = reaches[np.isfinite(reaches) & (reaches > 0)]
    if not len(reaches) or not len(sizes) or sizes.max() >= 1e5 or sizes.max() < 1e-3:
        return None
    # One digit of the uncertainty is enough beside the hatch, and four digits of a number are enough in a cell.
    most = max(0, 3 - math.floor(math.log10(sizes.max())))
    return min(most, max(0, decimals(float(np.median(reaches))) - 1))


def _ink(shade: Any) -> str:
    """Black or white, whichever is legible on a colour."""
    red, green, blue = (float(part) for part in shade[:3])
    return "black" if 0.2126 * red + 0.7152 * green + 0.0722 * blue > LIGHT else "white"


def _quantity(trials: Trials, grid: Grid) -> str:
    if not grid.values.kind:
        return metric_label(grid.info)
    return with_unit(typeset(change_label(trials, grid.info, grid.values.kind)), grid.values.unit)


def _note(trials: Trials, grid: Grid, limit: float) -> str:
    """Explain the hatch and count the runs."""
    if not grid.values.kind:
        what = "medians" if grid.info.may_not_occur else "means"
        return "\n".join(wrapped(f"{what}, {runs_words(grid.values)}", limit))
    hatch = f"hatched: {interval_words(trials, grid.values).removesuffix('s')} contains 0"
    return "\n".join(wrapped(f"{hatch}; {runs_words(grid.values, 'paired run')}", limit))
