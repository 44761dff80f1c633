"""Kinds of figures with their keys, at the width of a printed column.

This module is light, because a configuration is checked against its signatures: whoever draws brings matplotlib along.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from rmpc_bench.figures import sweep_points
from rmpc_bench.figures.keys import SAME_METRIC, Inches, SingleRuns, methods_of, metric_of, recorded, size_of
from rmpc_bench.figures.requirements import demands, of_boxplot, of_pareto, of_series, of_trajectories
from rmpc_bench.figures.sweep_points import Values
from rmpc_bench.types import DesignError, NonNegative, Panel

FORMATS: dict[str, dict[str, Any]] = {
    ".svg": {"metadata": {"Date": None, "Creator": None}},
    ".png": {"metadata": {"Software": None}, "dpi": 200},
    ".pdf": {"metadata": {"CreationDate": None, "Creator": None, "Producer": None}},
}
"""Endings of files, with what makes their bytes the same every time."""

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rmpc_bench.analysis.trials import Trials


@demands(of_boxplot)
def boxplot(
    trials: Trials,
    *,
    metric: str | None = None,
    width: Inches = 3.5,
    height: Inches | None = None,
    log: bool = False,
    order: list[str] | None = None,
    at: list[Values] | None = None,
) -> Figure:
    """Draw one box per method: red median, blue quartiles, whiskers to 1.5 of their distance, red outliers.

    Below a box stands the number of runs, as n/total where some failed, and how many of them are never; these are
    not part of the box.  The points of a sweep stand below each other, on a common axis; where all have the same
    numbers of runs, these stand below the last one only.

    Parameters
    ----------
    trials : the table of trials
    metric : name of the metric; the first one if not given
    width : of the whole picture [in]
    height : of the whole picture [in], if not given 2.4 and 1.4 for every further point of a sweep; labels too wide
        for their box stand upright and add to it
    log : logarithmic axis; linear nevertheless, and said so, where a value is not positive
    order : methods to show, from left to right; all if not given
    at : points of the sweep to show, from top to bottom, each by values of its paths; all (6 at most) if not given

    Returns
    -------
    the picture, for `save`

    Raises
    ------
    DesignError
        when a metric, method or point is unknown, there are too many points, or the size is below an inch
    """
    shown, info, methods = sweep_points.chosen(trials, at), metric_of(trials, metric), methods_of(trials, order)
    size = size_of(width, height, 1.0 + 1.4 * len(shown))
    from rmpc_bench.figures.boxplot import draw

    return draw(shown, info, methods, size, log=log)


@demands(of_trajectories)
def trajectories(
    trials: Trials,
    *,
    signals: list[str] | None = None,
    from_: NonNegative | None = None,
    to: NonNegative | None = None,
    runs: SingleRuns = 1,
    edges: bool = False,
    width: Inches = 3.5,
    height: Inches | None = None,
    order: list[str] | None = None,
    at: Values | None = None,
) -> Figure:
    """Draw recorded signals over time, one panel each, the methods in one panel and the reference dashed.

    Of one recorded run the picture shows its lines; of several the median (thick), the band from 5 to 95 % and single
    runs (thin), without the runs that failed.  Bursts of the noise are shaded where they are the same in all runs that
    are shown.  A method without a signal is left out of its panels.

    Parameters
    ----------
    trials : the table of trials
    signals : signals to show, from top to bottom, such as y, u, what a method reports, the control error e = r - y or,
        a single component counted from 0, x_hat.2; the components of a matrix count row by row; y and u if not given
    from_ : first time to show [s]
    to : last time to show [s]
    runs : how many single runs to show beside median and band, from the first one on
    edges : lines around the bands, which tell those of several methods apart where they lie on each other
    width : of the whole picture [in]
    height : of the whole picture [in], if not given 0.8 and 1.2 for every panel; what legend and title need beyond a
        line is added
    order : methods to show, later ones above earlier ones; all that have recorded runs if not given
    at : point of the sweep, by values of its paths; the first one if not given

    Returns
    -------
    the picture, for `save`

    Raises
    ------
    DesignError
        when nothing is recorded, or a signal, method or point is unknown, or the window holds no samples
    """
    point, title = sweep_points.only(trials, at)
    methods = recorded(point, order)
    from rmpc_bench.figures.curves import window_of
    from rmpc_bench.figures.trajectories import draw, rows_of

    rows = rows_of(point, methods, signals)
    window = window_of(point, len(point.traces[methods[0]].r) - 1, from_, to)
    size = size_of(width, height, 0.8 + 1.2 * len(rows))
    return draw(point, title, methods, rows, window, runs, size, edges=edges)


@demands(of_pareto)
def pareto(
    trials: Trials,
    *,
    x: str,
    y: str,
    bars: Literal["quartiles", "se"] = "quartiles",
    front: bool = True,
    log: bool = False,
    width: Inches = 3.5,
    height: Inches | None = None,
    order: list[str] | None = None,
    at: list[Values] | None = None,
) -> Figure:
    """Draw a point per method in the plane of two metrics, with its spread over the runs, and join the best ones.

    A point is not dominated, and filled, where none is better in one metric and at least as good in the other.  A step
    line joins these.  Of a metric that is best at 0 the absolute value counts, of a ratio that is best at 1 that of its
    logarithm.  Runs that failed are left out, and so are methods with a median or mean that is never.  The points that
    a method has in a sweep are joined in its order; they are compared with all others, so the sweep should not change
    the truth.

    Parameters
    ----------
    trials : the table of trials
    x : name of the metric of the horizontal axis
    y : name of the metric of the vertical axis
    bars : quartiles shows medians with the middle half of the runs, se means with their standard errors
    front : whether to show which points are not dominated
    log : logarithmic axes; linear nevertheless, and said so, where a value is not positive
    width : of the whole picture [in]
    height : of the whole picture [in], if not given 0.8 of the width; what legend and title need beyond a line is added
    order : methods to show, later ones above earlier ones; all if not given
    at : points of the sweep to show, each by values of its paths; all if not given

    Returns
    -------
    the picture, for `save`

    Raises
    ------
    DesignError
        when a metric, method or point is unknown, both metrics are the same, no method has a value of both, or there
        are too many points
    """
    if x == y:
        raise DesignError(SAME_METRIC, "y")
    shown, infos = sweep_points.wanted(trials, at), (metric_of(trials, x, "x"), metric_of(trials, y, "y"))
    methods = methods_of(trials, order)
    from rmpc_bench.figures.pareto import dots_of, draw

    dots = dots_of(shown, methods, infos, bars)
    return draw(trials, dots, infos, size_of(width, height, 0.8 * width), bars=bars, front=front, log=log)


@demands(of_series)
def series(
    trials: Trials,
    *,
    quantity: str,
    component: str | int | None = None,
    from_: NonNegative | None = None,
    to: NonNegative | None = None,
    log: bool = False,
    width: Inches = 3.5,
    height: Inches | None = None,
    order: list[str] | None = None,
    at: Values | None = None,
) -> Figure:
    """Draw a quantity of the designs over time, such as the gain L of an estimator.

    Parameters
    ----------
    trials : the table of trials
    quantity : name in series.csv, such as L or theta
    component : its component as in series.csv, such as 2,0 (counted from 0); all (6 at most) if not given
    from_ : first time to show [s]
    to : last time to show [s]
    log : logarithmic axis; linear nevertheless, and said so, where a value is not positive
    width : of the whole picture [in]
    height : of the whole picture [in], if not given 0.8 and 1.2 for every panel; what legend and title need beyond a
        line is added
    order : methods to show, later ones above earlier ones; all that have the quantity if not given
    at : point of the sweep, by values of its paths; the first one if not given

    Returns
    -------
    the picture, for `save`

    Raises
    ------
    DesignError
        when a quantity, component, method or point is unknown, or the window holds no samples
    """
    point, title = sweep_points.only(trials, at)
    methods = None if order is None else methods_of(point, order)
    from rmpc_bench.figures.curves import window_of
    from rmpc_bench.figures.series import draw, last_of, lines_of, within

    lines = lines_of(point, methods, quantity, None if component is None else str(component))
    window = window_of(point, last_of(lines), from_, to)
    lines = within(lines, window)
    return draw(point, title, quantity, lines, window, size_of(width, height, 0.8 + 1.2 * len(lines)), log=log)


def portrait(panels: Sequence[Panel]) -> Figure:
    """Draw what a part tells about itself.

    Parameters
    ----------
    panels : the panels from top to bottom

    Returns
    -------
    the picture, for `save_as`
    """
    from rmpc_bench.figures.component_plot import draw

    return draw(panels, (3.5, 0.4 + 1.6 * len(panels)))


def save(figure: Figure, directory: Path, stem: str) -> list[Path]:
    """Write a picture as SVG and as PNG (200 dpi), with the same bytes every time.

    Parameters
    ----------
    figure : the picture
    directory : where to; made if it is not there
    stem : file name without ending

    Returns
    -------
    the two files
    """
    directory.mkdir(parents=True, exist_ok=True)
    files = [directory / f"{stem}.svg", directory / f"{stem}.png"]
    for file in files:
        save_as(figure, file)
    return files


def save_as(figure: Figure, file: Path) -> None:
    """Write a picture in the format that the ending of the file says, with the same bytes every time.

    Parameters
    ----------
    figure : the picture
    file : ending with one of `FORMATS`; replaced
    """
    from rmpc_bench.figures.style import style

    ending = file.suffix.lower()
    with style():
        figure.savefig(file, format=ending[1:], **FORMATS[ending])
