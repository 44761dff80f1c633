"""Kinds of figures of one recorded run beside its trajectories, with their keys; as light as figures.py."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rmpc_bench.figures import sweep_points
from rmpc_bench.figures.keys import NO_OUTPUT, Inches, Index, recorded, size_of
from rmpc_bench.figures.requirements import demands, of_elements, of_plane, too_narrow
from rmpc_bench.figures.sweep_points import Values
from rmpc_bench.types import DesignError, NonNegative, Positive

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rmpc_bench.analysis.trials import Trials


@demands(of_elements)
def elements(
    trials: Trials,
    *,
    signal: str,
    run: Index = 0,
    from_: NonNegative | None = None,
    to: NonNegative | None = None,
    width: Inches = 3.5,
    height: Inches | None = None,
    order: list[str] | None = None,
    at: Values | None = None,
) -> Figure:
    """Draw all entries of a matrix that methods report, such as Q_yw, over time: a panel for each, as in the matrix.

    The panels of the diagonal have one vertical axis, all others another one.  Bursts of the noise are shaded.  A value
    that is held over a sample is drawn in steps; before there is one, there is a gap.

    Parameters
    ----------
    trials : the table of trials
    signal : name of the matrix, which must be recorded and square, such as Q_yw
    run : index of the run, which must be recorded
    from_ : first time to show [s]
    to : last time to show [s]
    width : of the whole picture [in]; 3.5 holds three columns
    height : of the whole picture [in], if not given 0.7 and 0.8 for every row; what legend and title need beyond a line
        is added
    order : methods to show, later ones above earlier ones; all that report the signal if not given
    at : point of the sweep, by values of its paths; the first one if not given

    Returns
    -------
    the picture, for `save`

    Raises
    ------
    DesignError
        when the run or the signal is not recorded, the signal is no square matrix or too large for the width, a method
        does not report it, a method or point is unknown, or the window holds no samples
    """
    point, title = sweep_points.only(trials, at)
    recorded(point, order)
    from rmpc_bench.figures.curves import window_of
    from rmpc_bench.figures.elements import draw, entries_of

    found = entries_of(point, order, signal, run)
    values = next(iter(found.values())).values
    window = window_of(point, len(values) - 1, from_, to)
    size = size_of(width, height, 0.7 + 0.8 * values.shape[1])
    if message := too_narrow(values.shape[1], width):
        raise DesignError(message, "width")
    return draw(point, title, signal, found, run, window, size)


@demands(of_plane)
def plane(
    trials: Trials,
    *,
    components: tuple[Index, Index] = (0, 1),
    run: Index = 0,
    marks: NonNegative = 1.0,
    magnify: Positive = 1.0,
    from_: NonNegative | None = None,
    to: NonNegative | None = None,
    width: Inches = 3.5,
    height: Inches | None = None,
    order: list[str] | None = None,
    at: Values | None = None,
) -> Figure:
    """Draw the path of one run in the plane of two outputs, the reference dashed, a line for every method.

    Both axes have one scale where both outputs have one unit.  Where the noise is in a burst, the reference lies on a
    broad grey band.

    Parameters
    ----------
    trials : the table of trials
    components : the two outputs (counted from 0), the horizontal one first
    run : index of the run, which must be recorded with the signal y
    marks : time between two marks on the paths [s], whose numbers stand beside the reference; 0 for none
    magnify : how many times as large the control errors are drawn, r + magnify (y - r)
    from_ : first time to show [s]
    to : last time to show [s]
    width : of the whole picture [in]
    height : of the whole picture [in], if not given that of the paths, in some bounds
    order : methods to show, later ones above earlier ones; all that have recorded runs if not given
    at : point of the sweep, by values of its paths; the first one if not given

    Returns
    -------
    the picture, for `save`

    Raises
    ------
    DesignError
        when the run or its output is not recorded, an output, method or point is unknown, marks are too close, or the
        window holds no samples
    """
    point, title = sweep_points.only(trials, at)
    if len(set(components)) < 2:
        raise DesignError("must be two different outputs", "components")
    methods = recorded(point, order)
    if any("y" not in point.traces[name].signals for name in methods):
        raise DesignError(NO_OUTPUT, "")
    from rmpc_bench.figures.curves import window_of
    from rmpc_bench.figures.plane import draw, height_of, is_equal, path_of

    window = window_of(point, len(point.traces[methods[0]].r) - 1, from_, to)
    paths = {name: path_of(point, name, run, components, window) for name in methods}
    size = size_of(width, height, height_of(paths, magnify, width, equal=is_equal(point, components)))
    return draw(point, title, paths, components, window, size, run=run, marks=marks, magnify=magnify)
