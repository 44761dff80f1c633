"""Base class of figures: each kind is a frozen dataclass whose fields are its YAML keys."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, TypeAlias

from annotated_types import Ge, Le

from rmpc_bench.types.errors import DesignError, Issue
from rmpc_bench.types.result_layout import ResultLayout

Inches = Annotated[float, Ge(1), Le(100)]
Index = Annotated[int, Ge(0)]
"""Index of a component, a run or a sample, counted from 0."""
PointValues: TypeAlias = dict[str, Any]
"""Values by path of the sweep, such as ``{controller.Hp: 10}``; each is a value of the sweep or its name."""


@dataclass(frozen=True, kw_only=True)
class Figure:
    """A kind of figure.

    A derived class adds its own fields, checks its requirements on the results in `check`, and draws them in `draw`.

    Parameters
    ----------
    width : width of the whole picture [in]
    height : height of the whole picture [in]
    order : methods to show; all that can be shown if not given

    Examples
    --------
    >>> @dataclass(frozen=True, kw_only=True)
    ... class Empty(Figure):
    ...     def draw(self, results): from matplotlib.figure import Figure; return Figure(self.size(2.5))
    >>> Empty(width=5.0).draw(None).get_size_inches().tolist()
    [5.0, 2.5]
    """

    needs_runs: ClassVar[bool] = False
    """Whether it shows single runs, which an experiment of exact moments does not have."""
    metric_keys: ClassVar[tuple[str, ...]] = ()
    """Fields that name a metric."""

    width: Inches = 3.5
    height: Inches | None = None
    order: list[str] | None = None

    def check_names(self, layout: ResultLayout) -> Iterator[Issue]:
        """Yield an issue for every metric, method or point of the sweep that does not exist.

        Parameters
        ----------
        layout : layout of the results; only these names must be known
        """
        if self.needs_runs:
            yield from layout.require_runs()
        for key in self.metric_keys:
            yield from layout.require_metric(getattr(self, key), key)
        yield from layout.require_methods(self.order)

    def check(self, layout: ResultLayout) -> Iterator[Issue]:
        """Yield an issue for every option that the results cannot satisfy.

        Parameters
        ----------
        layout : layout of the results
        """
        yield from self.check_names(layout)

    def require(self, layout: ResultLayout) -> None:
        """Raise the first issue that `check` finds.

        Raises
        ------
        DesignError
            if there is an issue; it names the key
        """
        for issue in self.check(layout):
            raise DesignError(issue.message, issue.key)

    def size(self, usual_height: float) -> tuple[float, float]:
        """Return width and height of the picture [in].

        Parameters
        ----------
        usual_height : the height if none is given [in]

        Raises
        ------
        DesignError
            if one of them is less than an inch, or not finite
        """
        for key, size in (("width", self.width), ("height", self.height)):
            if size is not None and not 1 <= size < math.inf:
                raise DesignError(f"must be at least 1 inch (got {size:g})", key)
        return self.width, usual_height if self.height is None else self.height

    def caption(self, results: Any) -> str:
        """Say in plain text what the figure shows, as its caption in a paper and on the page does.

        Parameters
        ----------
        results : the table of trials

        Returns
        -------
        one sentence that defines every mark and names the number of runs; formulas as ``$..$``
        """
        return (type(self).__doc__ or "").strip().partition("\n")[0]

    def draw(self, results: Any) -> Any:
        """Draw stored results.

        Parameters
        ----------
        results : the table of trials

        Returns
        -------
        a figure of matplotlib, which is imported only here

        Raises
        ------
        DesignError
            if these results cannot be drawn
        """
        raise NotImplementedError("draw")


@dataclass(frozen=True, kw_only=True)
class OnePointFigure(Figure):
    """A figure of one point of a sweep.

    Parameters
    ----------
    at : point of the sweep, by values of its paths; the first one if not given
    """

    at: PointValues | None = None

    def check_names(self, layout: ResultLayout) -> Iterator[Issue]:
        """Add the point to the names of every figure."""
        yield from super().check_names(layout)
        yield from layout.require_points(None if self.at is None else [self.at])


@dataclass(frozen=True, kw_only=True)
class SweepFigure(Figure):
    """A figure of several points of a sweep.

    Parameters
    ----------
    at : points of the sweep to show, in this order, each by values of its paths; all if not given
    """

    at: list[PointValues] | None = None

    def check_names(self, layout: ResultLayout) -> Iterator[Issue]:
        """Add the points to the names of every figure."""
        yield from super().check_names(layout)
        yield from layout.require_points(self.at)
