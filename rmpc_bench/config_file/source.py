"""Stage 1, read: the file of a configuration and the overrides of the command line, as trees with positions."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from rmpc_bench.config_file.added_methods import read_methods
from rmpc_bench.config_file.extension import read_extended
from rmpc_bench.config_file.key_errors import shown
from rmpc_bench.config_file.reader import EXTENDS, Override, parse_override
from rmpc_bench.config_file.tree import Map, Mark, split
from rmpc_bench.types import ConfigError, Problem


class GivenConfig(NamedTuple):
    """A configuration as it was given."""

    path: Path
    """File of the configuration; file names inside it are relative to its directory."""
    tree: Map
    overrides: tuple[Override, ...]
    problems: tuple[Problem, ...]
    """Errors in the text of overrides."""
    texts: tuple[str, ...] = ()
    """The overrides as given."""
    added: Map = Map(mark=Mark("", 1, 1))
    """Methods that are added to those of the file."""

    def options(self, runs: int | None, *, smoke: bool) -> tuple[str, ...]:
        """Return the options of the command line that change the experiment, its runs or size, against its file."""
        found = [f"-s {shlex.quote(text)}" for text in self.texts if not text.startswith("execution.")]
        found += [f"--runs {runs}"] if runs is not None and (smoke or self.tree.get("runs") != runs) else []
        return (*found, *["--smoke"] * smoke)


def read(path: str | Path, overrides: Sequence[str], add_methods: Sequence[str] = ()) -> GivenConfig:
    """Read a file, overrides PATH=VALUE and methods ``NAME: {..}``; `ConfigError` where the file is no mapping."""
    tree = read_extended(path)
    if not isinstance(tree, Map):
        raise ConfigError([Problem(str(path), 1, 1, "", f"must be a mapping (got {shown(tree)})")])
    parsed: list[Override] = []
    problems: list[Problem] = []
    for text in overrides:
        try:
            parsed.append(parse_override(text))
            if split(parsed[-1].path, parsed[-1].mark)[0] == EXTENDS:
                message = "cannot be set here: a file extends another before it is overridden"
                problems.append(Problem(*parsed[-1].mark, EXTENDS, message))
        except ConfigError as error:
            problems += error.problems
    added = read_methods(add_methods, problems)
    return GivenConfig(Path(path), tree, tuple(parsed), tuple(problems), tuple(overrides), added)
