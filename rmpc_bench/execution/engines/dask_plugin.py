"""Plugin that describes an experiment to every dask worker, also to one that joins the cluster later."""

from __future__ import annotations

import signal

from distributed import Worker, WorkerPlugin

from rmpc_bench.execution.engines.dask_worker import Setup, forget, remember


class ExperimentPlugin(WorkerPlugin):
    """Keeps an experiment on a dask worker as long as the client computes; `local` if that has started the worker."""

    def __init__(self, described: Setup, *, local: bool) -> None:
        self.name = described.key
        self._described, self._local = described, local

    def setup(self, worker: Worker) -> None:
        """Take the description."""
        if self._local:
            # Ctrl-C in a terminal reaches every process of the group; only the client handles it.
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        remember(self._described)

    def teardown(self, worker: Worker) -> None:
        """End the worker processes of the experiment."""
        forget(self._described.key)
