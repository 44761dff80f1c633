"""The window of samples that a figure shows."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from rmpc_bench.types import DesignError
from rmpc_bench.types.result_layout import empty_window, samples_between

if TYPE_CHECKING:
    from rmpc_bench.analysis.trials import Trials


class TimeWindow(NamedTuple):
    """The samples that are shown, both ends included, and the length of one on the axis."""

    first: int
    last: int
    sample: float
    label: str
    """Label of the axis."""

    @property
    def limits(self) -> tuple[float, float]:
        """Both ends on the axis."""
        return self.first * self.sample, self.last * self.sample

    @property
    def slice(self) -> slice:
        """The same samples, for indexing."""
        return slice(self.first, self.last + 1)

    @property
    def in_seconds(self) -> bool:
        """Whether the axis shows seconds, and not samples."""
        return self.label != "$k$"


def window_of(point: Trials, last: int, start: float | None, stop: float | None) -> TimeWindow:
    """Find the samples between two times [s], both included; these are samples where the sampling time is not known.

    An end that is not given is that of the samples.  Raises a DesignError when less than two samples are left.
    """
    sample, label = (point.Ts, "$t$ [s]") if point.Ts else (1.0, "$k$")
    window = TimeWindow(*samples_between(start, stop, sample, last), sample, label)
    if window.first >= window.last:
        issue = empty_window(start, last * sample)
        raise DesignError(issue.message, issue.key)
    return window
