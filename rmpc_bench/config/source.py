"""Stage 1, read: the file of a configuration and the overrides of the command line, as trees that know their places."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from rmpc_bench.config.reader import Override, load, parse_override
from rmpc_bench.config.schema import shown
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


def read(path: str | Path, overrides: Sequence[str]) -> GivenConfig:
    """Read a file and the overrides.

    Parameters
    ----------
    path : the YAML file
    overrides : texts PATH=VALUE

    Raises
    ------
    ConfigError
        If the file cannot be read, is no valid YAML, or is not a mapping.
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
    return GivenConfig(Path(path), tree, tuple(parsed), tuple(problems))
