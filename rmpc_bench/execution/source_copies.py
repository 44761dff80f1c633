"""Copies of a user's Python files beside the trials that they have computed: ``code/<hash>/tanks.py``."""

from __future__ import annotations

from pathlib import Path

from rmpc_bench.config.own_code import OwnCode
from rmpc_bench.config.relocation import COPIES, check_copies
from rmpc_bench.replaced_file import inside, refuse_outside, replaced


def keep_sources(own: OwnCode, directory: Path) -> None:
    """Copy every Python file that computes trials, with all that it imports; paths relative to each other are kept.

    A copy that is there stays, since equal hashes mean equal programs.
    """
    check_copies(directory)
    for source in (*own.sources.values(), *own.parts.values()):
        for place, file in source.copies.items():
            path = directory / COPIES / source.folder / place
            if not path.exists():
                with inside(directory):
                    refuse_outside(path.parent)
                    path.parent.mkdir(parents=True, exist_ok=True)
                    with replaced(path) as partial:
                        partial.write_bytes(file.content)
