"""Temporary directories of a process, which are removed after it.

A worker process may be ended at any time, so that nothing that was registered for its end is called.  The name of a
directory therefore contains the machine and the process; every process removes those of processes that have ended.
"""

from __future__ import annotations

import atexit
import glob
import os
import platform
import shutil
from functools import partial
from pathlib import Path
from tempfile import gettempdir, mkdtemp


def process_directory(name: str) -> Path:
    """Make a temporary directory that is removed at the end of this process, or later by another one."""
    prefix = f"{name}-{platform.node()}-"
    _remove(prefix, ended_only=True)
    made = Path(mkdtemp(prefix=f"{prefix}{os.getpid()}-"))
    atexit.register(partial(_remove, prefix, ended_only=False))
    return made


def _remove(prefix: str, *, ended_only: bool) -> None:
    """Remove the directories of processes that have ended, and those of this process."""
    for directory in Path(gettempdir()).glob(f"{glob.escape(prefix)}*"):
        process = directory.name.removeprefix(prefix).partition("-")[0]
        own = process == str(os.getpid())
        if (own and not ended_only) or (not own and process.isdigit() and _has_ended(int(process))):
            shutil.rmtree(directory, ignore_errors=True)


def _has_ended(process: int) -> bool:
    if os.name != "posix":
        return False
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return True
    except OSError:
        return False
    return False
