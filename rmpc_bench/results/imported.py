"""Runs made elsewhere, which a table has: what the record of their experiment says of them, and what they refuse."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rmpc_bench.received.store import MissingError, is_filled
from rmpc_bench.store.store import Store

ELSEWHERE: Mapping[str, Any] = {"numerics": 0}
"""What stands in place of the code of runs that another program has made."""


@dataclass(frozen=True)
class Imported:
    """Runs made elsewhere, which a table has."""

    table: str  # its file, as commands name it
    names: tuple[int | str, ...] = ()  # original name of every run, where they are not 0, 1, 2, ..
    options: Mapping[str, Any] = field(default_factory=dict)  # how the table was read, as keywords of `import_runs`

    @property
    def unpaired(self) -> bool:
        """Whether run i of two methods has nothing in common."""
        return bool(self.options.get("unpaired"))

    @property
    def command(self) -> str:
        """The command that reads the table."""
        words = ["rmpc-bench", "import", self.table]
        for key, value in self.options.items():
            roles = value.items() if isinstance(value, Mapping) else ()
            text = ",".join(f"{role}={name}" for role, name in roles) or str(value)
            words += [f"--{key.replace('_', '-')}", *([] if value is True else [text])]
        return " ".join(map(shlex.quote, words))


def is_imported(directory: Path) -> bool:
    """Whether the runs of a directory were made elsewhere."""
    if not is_filled(directory):
        return False
    with Store(directory, writable=False) as store:
        return bool(store.data("layout").get("imported"))


def refuse_imported(directory: Path) -> None:
    """Raise a MissingError where the runs of a directory were made elsewhere, so that none can be computed."""
    if is_imported(directory):
        text = f"add methods with `rmpc-bench import more.csv -o {shlex.quote(str(directory))} --add`"
        raise MissingError(f"{directory} holds runs made elsewhere; {text}")
