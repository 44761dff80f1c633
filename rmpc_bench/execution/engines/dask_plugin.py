"""Plugin that describes an experiment to every dask worker, also to one that joins the cluster later."""

from __future__ import annotations

from distributed import Worker, WorkerPlugin

from rmpc_bench.execution.engines.dask_worker import Setup, forget, remember


class ExperimentPlugin(WorkerPlugin):
    """Keeps an experiment on a dask worker as long as the client computes.

    Parameters
    ----------
    described : the experiment
    """

    def __init__(self, described: Setup) -> None:
        self.name = described.key
        self._described = described

    def setup(self, worker: Worker) -> None:
        """Take the description."""
        remember(self._described)

    def teardown(self, worker: Worker) -> None:
        """End the worker processes of the experiment."""
        forget(self._described.key)
