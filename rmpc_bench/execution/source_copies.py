"""Copies of a user's Python files beside the trials that they have computed: ``code/<hash>/tanks.py``."""

from __future__ import annotations

from pathlib import Path

from rmpc_bench.config.own_code import OwnCode
from rmpc_bench.config.relocation import COPIES
from rmpc_bench.replaced_file import replaced


def keep_sources(own: OwnCode, directory: Path) -> None:
    """Copy every Python file that computes trials, with all that it imports; paths relative to each other are kept.

    A copy that is there stays, since equal hashes mean equal programs.

    Parameters
    ----------
    own : the files of a configuration
    directory : of the results

    Raises
    ------
    OSError
        If a file cannot be written.
    """
    for source in (*own.sources.values(), *own.parts.values()):
        for place, file in source.copies.items():
            path = directory / COPIES / source.folder / place
            if not path.exists():
                path.parent.mkdir(parents=True, exist_ok=True)
                with replaced(path) as partial:
                    partial.write_bytes(file.content)
