"""A process that repeats a component on recorded data; there is no plant in it."""

from __future__ import annotations

import os
import pickle
import sys
from typing import Any

from rmpc_bench.conformance.results import raised
from rmpc_bench.conformance.subject import unpacked


def main() -> None:
    """Read a job from stdin and write what the component answers to stdout."""
    out = os.fdopen(os.dup(1), "wb")
    # What the component prints goes where the errors go.
    os.dup2(2, 1)
    with os.fdopen(0, "rb") as stream:
        sys.path[:] = [path for path in pickle.load(stream) if path]
        job = stream.read()
    try:
        answer = answered(unpacked(job)), ""
    except (Exception, SystemExit) as error:  # the component may raise anything
        answer = None, raised(error)
    pickle.dump(answer, out)
    out.flush()
    # Threads and handlers at exit of the component's libraries may wait for each other.
    os._exit(0)


def answered(job: Any) -> Any:
    """Make the component and return its answers to the data.

    Parameters
    ----------
    job : ``subject``, ``group``, ``provided`` and ``data``
    """
    design = job["subject"].made(job["group"], job["provided"])
    return job["data"].answers(design)
