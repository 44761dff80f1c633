"""The figure of one run among the sets that the methods believed it to be in, with its keys; as light as figures.py."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from rmpc_bench.figures import sweep_points
from rmpc_bench.figures.keys import Inches, Index, Level, OneOrTwo, methods_of, size_of
from rmpc_bench.figures.requirements import demands, of_tubes
from rmpc_bench.figures.sweep_points import Values
from rmpc_bench.types import Count, DesignError, NonNegative

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rmpc_bench.analysis.trials import Trials


@demands(of_tubes)
def tubes(
    trials: Trials,
    *,
    over: Literal["plane", "time"] = "plane",
    run: Index = 0,
    components: OneOrTwo = (0, 1),
    from_: NonNegative | None = None,
    to: NonNegative | None = None,
    every: Count | None = None,
    level: Level = 0.95,
    width: Inches = 3.5,
    height: Inches | None = None,
    order: list[str] | None = None,
    at: Values | None = None,
) -> Figure:
    """Draw one run among the sets that the methods believed it to be in, one panel per method, all of one scale.

    A set is the ellipsoid about the estimate whose shape is the method's own M; a method without M has the one that
    holds a Gaussian error of its own P at the level (dashed).  Where there are more states than are shown, it is the
    shadow of the ellipsoid.  A true state outside of what is shown of its set is hollow.

    Parameters
    ----------
    trials : the table of trials
    over : plane shows both states and some ellipses, time every state with the band from its least to its largest
        value in the set, which is easier to read
    run : index of the run, which must be recorded with the signals x and x_hat
    components : the states (counted from 0), the horizontal one first; over time there may be one
    from_ : first time to show [s]
    to : last time to show [s]
    every : samples from one ellipse of a plane to the next; as many as leave a dozen if not given
    level : of the ellipsoid of P, such as 95%
    width : of the whole picture [in]
    height : of the whole picture [in], if not given 0.8 and 1.6 for every plane or 1.2 for every band; what legend and
        title need beyond a line is added
    order : methods to show, from top to bottom; all that are recorded and have M or P if not given
    at : point of the sweep, by values of its paths; the first one if not given

    Returns
    -------
    the picture, for `save`

    Raises
    ------
    DesignError
        when the run, its states or estimates are not recorded, no method has M or P, a state, method or point is
        unknown, there are too many panels, or the window holds no samples
    """
    point, title = sweep_points.only(trials, at)
    plane = over == "plane"
    if len(set(components)) < (2 if plane else len(components)):
        raise DesignError("must be two different states", "components")
    names = None if order is None else methods_of(point, order)
    from rmpc_bench.figures import tubes as drawn
    from rmpc_bench.figures.curves import window_of

    shown = drawn.methods_of(point, names)
    n_panels = sweep_points.fitting(len(shown) * (1 if plane else len(components)))
    window = window_of(point, len(point.traces[shown[0]].r) - 1, from_, to)
    found = {name: drawn.tube_of(point, name, run, components, window, level) for name in shown}
    size = size_of(width, height, 0.8 + (1.6 if plane else 1.2) * n_panels)
    every = every or drawn.distance_of(window)
    return drawn.draw(point, title, found, components, window, size, run=run, level=level, every=every, plane=plane)
