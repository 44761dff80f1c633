"""An estimator-controller pair."""

from __future__ import annotations

from typing import NamedTuple

from rmpc_bench.types.controller import Controller
from rmpc_bench.types.estimator import Estimator
from rmpc_bench.types.records import DISTURBANCES


class Method(NamedTuple):
    """An estimator-controller pair under the name the user gave it."""

    name: str
    estimator: Estimator
    controller: Controller
    n_disturbances: int = 0
    """Number of disturbances that the design model has as its last states; see `types.estimate_of_x`."""
    remarks: tuple[str, ...] = ()
    """Sentences about the pair, which warnings and tables show."""

    @property
    def reports(self) -> dict[str, tuple[int, ...]]:
        """Entries of `info` of the estimator and of the controller: name -> shape of the entry of one run."""
        disturbances = {DISTURBANCES: (self.n_disturbances,)} if self.n_disturbances else {}
        reported = (*disturbances.items(), *self.estimator.reports.items(), *self.controller.reports.items())
        return {name: tuple(shape) for name, shape in reported}
