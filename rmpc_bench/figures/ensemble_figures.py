"""Kinds of figures of an ensemble, with their keys, at the width of a printed column.

They need the ensemble moments (`evaluate: [runs, moments]`): mean and covariance of true state, estimate and error at
every sample, exact, over the runs, or both.  This module is as light as figures.py.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rmpc_bench.figures import sweep_points
from rmpc_bench.figures.keys import Inches, Index, Radii, having, metric_of, radii_of, size_of
from rmpc_bench.figures.requirements import demands, of_ellipses, of_means, of_variance_with_bound
from rmpc_bench.figures.sweep_points import Values
from rmpc_bench.types import NonNegative

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rmpc_bench.analysis.trials import Trials


@demands(of_means)
def means(
    trials: Trials,
    *,
    component: Index | None = None,
    from_: NonNegative | None = None,
    to: NonNegative | None = None,
    width: Inches = 3.5,
    height: Inches | None = None,
    order: list[str] | None = None,
    at: Values | None = None,
) -> Figure:
    """Draw the ensemble mean of the true state (black) and of every method's estimate, one panel per state.

    The lines are the exact means; those from runs lie behind them, thin and pale.  Where there are no exact ones,
    those from runs are the lines.  Where the true state depends on the method, as under feedback, it is dotted in the
    method's colour.

    Parameters
    ----------
    trials : the table of trials
    component : index of the state (counted from 0); all (6 at most) if not given
    from_ : first time to show [s]
    to : last time to show [s]
    width : of the whole picture [in]
    height : of the whole picture [in], if not given 0.8 and 1.2 for every panel; what legend and title need beyond a
        line is added
    order : methods to show, later ones above earlier ones; all that have moments if not given
    at : point of the sweep, by values of its paths; the first one if not given

    Returns
    -------
    the picture, for `save`

    Raises
    ------
    DesignError
        when there are no moments, a state, method or point is unknown, or the window holds no samples
    """
    point, title = sweep_points.only(trials, at)
    methods = having(point, ["mean(x)", "mean(x_hat)"], order)
    from rmpc_bench.figures import ensembles
    from rmpc_bench.figures.curves import window_of

    panels = ensembles.means(point, methods, component)
    window = window_of(point, ensembles.last_of(panels), from_, to)
    size = size_of(width, height, 0.8 + 1.2 * len(panels))
    return ensembles.draw(point, title, methods, panels, window, size, words=("exact", "mean"), log=False)


@demands(of_variance_with_bound)
def variance_with_bound(
    trials: Trials,
    *,
    component: Index | None = None,
    from_: NonNegative | None = None,
    to: NonNegative | None = None,
    log: bool = False,
    width: Inches = 3.5,
    height: Inches | None = None,
    order: list[str] | None = None,
    at: Values | None = None,
) -> Figure:
    """Draw the ensemble variance of every method's error beside the method's own P, one panel per state.

    Solid is the exact variance of x - x_hat, thin and pale behind it the one from runs; where there is no exact one,
    the one from runs is the line.  Dashed in the same colour is the diagonal of P: the variance that the estimator
    itself believes or guarantees.  A solid line above its dashes is a bound that does not hold.

    Parameters
    ----------
    trials : the table of trials
    component : index of the state (counted from 0); all (6 at most) if not given
    from_ : first time to show [s]
    to : last time to show [s]
    log : logarithmic axis; linear nevertheless, and said so, where a value is not positive
    width : of the whole picture [in]
    height : of the whole picture [in], if not given 0.8 and 1.2 for every panel; what legend and title need beyond a
        line is added
    order : methods to show, later ones above earlier ones; all that have moments if not given
    at : point of the sweep, by values of its paths; the first one if not given

    Returns
    -------
    the picture, for `save`

    Raises
    ------
    DesignError
        when there are no moments or no P, a state, method or point is unknown, or the window holds no samples
    """
    point, title = sweep_points.only(trials, at)
    methods = having(point, ["cov(e)"], order)
    from rmpc_bench.figures import ensembles
    from rmpc_bench.figures.curves import window_of

    panels = ensembles.variances(point, methods, component)
    window = window_of(point, ensembles.last_of(panels), from_, to)
    size = size_of(width, height, 0.8 + 1.2 * len(panels))
    return ensembles.draw(point, title, methods, panels, window, size, words=("variance", "variance"), log=log)


@demands(of_ellipses)
def ellipses(
    trials: Trials,
    *,
    x: str,
    y: str,
    k: Index | None = None,
    sigmas: Radii = (1.0, 3.0),
    components: tuple[Index, Index] = (0, 1),
    width: Inches = 3.5,
    height: Inches | None = None,
    order: list[str] | None = None,
    at: Values | None = None,
) -> Figure:
    """Draw the covariance ellipses of the methods among the runs, one dot each.

    An ellipse has its centre (a cross) at the mean of the method's estimates, and the radius s times the standard
    deviation that the method's own P tells: (z - c)' P^-1 (z - c) = s^2.  Where P is singular, it is a segment.  The
    dots are grey where all methods have the same values, such as true states, else each method has its own.  Runs that
    failed have none; the title counts them.

    Parameters
    ----------
    trials : the table of trials
    x : name of the metric that is the horizontal coordinate of the dots
    y : name of the metric that is the vertical coordinate of the dots
    k : the sample whose P and mean are shown; the last one if not given
    sigmas : radii of the ellipses in standard deviations, 4 at most: solid, dashed, dotted and dash-dotted
    components : the two states of the ellipses (counted from 0), the horizontal one first
    width : of the whole picture [in]
    height : of the whole picture [in], if not given 2.6; what legend and title need beyond a line is added
    order : methods to show, later ones above earlier ones; all that have moments and P if not given
    at : point of the sweep, by values of its paths; the first one if not given

    Returns
    -------
    the picture, for `save`

    Raises
    ------
    DesignError
        when there are no moments or no P, or a metric, state, sample, method or point is unknown
    """
    point, title = sweep_points.only(trials, at)
    axes = metric_of(point, x, "x"), metric_of(point, y, "y")
    radii = radii_of(sigmas)
    methods = having(point, ["mean(x_hat)", "P"], order)
    from rmpc_bench.figures.ellipses import draw, ellipses_of

    k, found = ellipses_of(point, methods, components, k)
    return draw(point, title, found, axes, k, radii, size_of(width, height, 2.6))
