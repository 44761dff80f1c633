"""The same component in another process: one without a plant, with another hash seed and working directory."""

from __future__ import annotations

import pickle
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np

from rmpc_bench.child_process import start
from rmpc_bench.conformance.results import Returned
from rmpc_bench.conformance.subject import Subject, packed

SAME_SEED, OTHER_SEED = "0", "1"
"""PYTHONHASHSEED of the process of the checks, and of the one with another environment."""
MODULE = "rmpc_bench.conformance.replay"


def started(
    module: str,
    hash_seed: str,
    directory: Path | None = None,
    *,
    errors: IO[bytes] | int = subprocess.DEVNULL,
    session: bool = False,
) -> subprocess.Popen[bytes]:
    """Start a Python process that runs ``main`` of a module of the kit; it gets its job from stdin.

    Parameters
    ----------
    module : of the kit
    hash_seed : PYTHONHASHSEED
    directory : working directory; this one unless given
    errors : file for stderr; dropped unless given
    session : whether the process gets a group of its own, which can be ended together
    """
    environment = {"PYTHONHASHSEED": hash_seed}
    return start(
        module, subprocess.PIPE, subprocess.PIPE, errors, environment=environment, directory=directory, session=session
    )


@dataclass(eq=False)
class SeparateProcess:
    """Repeats the calls of a component in a process that gets nothing but the data.

    Parameters
    ----------
    subject : the component
    provided : what its design function gets
    group : group of the registry
    seconds : time limit, below that of a check
    """

    subject: Subject
    provided: Mapping[str, Any]
    group: str
    seconds: float = 20.0
    returned: dict[bool, Returned] = field(default_factory=dict)
    _process: subprocess.Popen[bytes] | None = None
    _directory: tempfile.TemporaryDirectory[str] | None = None

    def prepare(self) -> None:
        """Start the process with another environment, so that it imports while other checks run."""
        self._directory = tempfile.TemporaryDirectory()
        self._process = started(MODULE, OTHER_SEED, Path(self._directory.name))

    def close(self) -> None:
        """End the process and delete its directory."""
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None
        if self._directory is not None:
            self._directory.cleanup()
            self._directory = None

    def __call__(self, data: Any, same: bool) -> Returned:
        """Return what the component returns there.

        Parameters
        ----------
        data : what it gets
        same : whether the environment is that of this process
        """
        if same not in self.returned:
            if self._process is None and not same:
                self.prepare()
            process = started(MODULE, SAME_SEED) if same else self._process
            assert process is not None
            self.returned[same] = self._request(process, data)
            self.close()
        return self.returned[same]

    def _request(self, process: subprocess.Popen[bytes], data: Any) -> Returned:
        job = {"subject": self.subject, "provided": self.provided, "group": self.group, "data": data}
        # The search path first: what the job consists of is imported along it.
        text = pickle.dumps(tuple(sys.path)) + packed(self.subject, job)
        try:
            out, _ = process.communicate(text, timeout=self.seconds)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            return Returned(None, f"no result within {self.seconds:g} s")
        if not out:
            return Returned(None, f"the process ended with code {process.returncode}")
        values, raised = pickle.loads(out)
        return Returned(None if values is None else np.asarray(values), raised)
