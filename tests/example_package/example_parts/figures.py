"""A figure: a frozen dataclass whose fields are its keys."""

from dataclasses import dataclass
from typing import ClassVar

from rmpc_bench.types import Figure


@dataclass(frozen=True, kw_only=True)
class LastValues(Figure):
    """Values of a metric over the index of the run, one mark per run and method.

    Parameters
    ----------
    metric : metric to show; the primary one if not given
    """

    needs_runs: ClassVar[bool] = True
    metric_keys: ClassVar[tuple[str, ...]] = ("metric",)

    metric: str | None = None

    def draw(self, results):
        """Draw the table of trials."""
        from matplotlib.figure import Figure as Picture

        picture = Picture(figsize=self.size(2.5), layout="constrained")
        axes = picture.add_subplot()
        for method, rows in results.frame.groupby("method", sort=False):
            axes.plot(rows["run"], rows[self.metric], "o", label=method)
        axes.set(xlabel="run", ylabel=self.metric)
        axes.legend()
        return picture
