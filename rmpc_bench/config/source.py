"""Stage 1, read: the file of a configuration and the overrides of the command line, as trees with positions."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from rmpc_bench.config.key_errors import shown
from rmpc_bench.config.reader import Override, load, parse_override
from rmpc_bench.config.tree import Map
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

    def options(self, runs: int | None, *, smoke: bool) -> tuple[str, ...]:
        """Return the options of the command line that change the experiment against its file.

        Parameters
        ----------
        runs : number of runs instead of the one in the file
        smoke : whether the small size is taken
        """
        found = [f"-s {shlex.quote(text)}" for text in self.texts if not text.startswith("execution.")]
        found += [f"--runs {runs}"] if runs is not None and (smoke or self.tree.get("runs") != runs) else []
        return (*found, *["--smoke"] * smoke)


def read(path: str | Path, overrides: Sequence[str]) -> GivenConfig:
    """Read a file and the overrides.

    Parameters
    ----------
    path : the YAML file
    overrides : texts PATH=VALUE

    Raises
    ------
    ConfigError
        If the file cannot be read, is not valid YAML, or is not a mapping.
    """
    tree = load(path)
    if not isinstance(tree, Map):
        raise ConfigError([Problem(str(path), 1, 1, "", f"must be a mapping (got {shown(tree)})")])
    parsed: list[Override] = []
    problems: list[Problem] = []
    for text in overrides:
        try:
            parsed.append(parse_override(text))
        except ConfigError as error:
            problems += error.problems
    return GivenConfig(Path(path), tree, tuple(parsed), tuple(problems), tuple(overrides))
