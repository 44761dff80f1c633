"""A process that repeats a component on recorded data; there is no plant in it."""

from __future__ import annotations

import os
import pickle
import sys
from typing import Any

from rmpc_bench.conformance.results import raised
from rmpc_bench.conformance.subject import unpacked


def main() -> None:
    """Read a job from stdin and write what the component returns to stdout."""
    out = os.fdopen(os.dup(1), "wb")
    # What the component prints goes where the errors go.
    os.dup2(2, 1)
    with os.fdopen(0, "rb") as stream:
        sys.path[:] = [path for path in pickle.load(stream) if path]
        job = stream.read()
    try:
        result = results_of(unpacked(job)), ""
    except (Exception, SystemExit) as error:  # the component may raise anything
        result = None, raised(error)
    pickle.dump(result, out)
    out.flush()
    # Threads and handlers at exit of the component's libraries may wait for each other.
    os._exit(0)


def results_of(job: Any) -> Any:
    """Make the component and return its results for the data.

    Parameters
    ----------
    job : ``subject``, ``group``, ``provided`` and ``data``
    """
    design = job["subject"].made(job["group"], job["provided"])
    return job["data"].results(design)
