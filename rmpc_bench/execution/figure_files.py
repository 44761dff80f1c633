"""The figures of an experiment as files; those of a user are drawn by `run` only, which loads their code."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rmpc_bench.components.code import CodeError, split_reference
from rmpc_bench.components.designs import is_built_in
from rmpc_bench.components.loading import user_code
from rmpc_bench.config.short_forms import FILE
from rmpc_bench.execution.evaluation import drawn, figure_component
from rmpc_bench.execution.results import Results
from rmpc_bench.figures.files import save
from rmpc_bench.types import DesignError

OWN = "is not part of this package, and stored results are read without its code; `rmpc-bench run` draws it"


def write_figures(results: Results, directory: Path) -> tuple[list[Path], list[str]]:
    """Draw the figures of an experiment.

    Parameters
    ----------
    results : what to draw
    directory : where the pictures are written

    Returns
    -------
    the files, and what could not be drawn with the reason
    """
    paths: list[Path] = []
    left_out: list[str] = []
    counts: Counter[str] = Counter()
    for number, keys in enumerate(results.experiment.figures):
        kind = str(keys.get(FILE) or keys["kind"])
        name = _name(kind)
        counts[name] += 1
        stem = name if counts[name] == 1 else f"{name}-{counts[name]}"
        try:
            paths += _written(results, number, keys, directory, stem)
        except DesignError as error:
            # A method that the figure shows has not been computed yet.
            left_out.append(f"{kind}: {error}")
        except CodeError as error:
            left_out.append(f"{kind}: {error.line}")
    return paths, left_out


def _written(results: Results, number: int, keys: Mapping[str, Any], directory: Path, stem: str) -> list[Path]:
    """Draw a figure and write its files."""
    own = results.components.get(number)
    if own is not None:
        # The code of a user may raise anything; the tables and the other figures are written all the same.
        with user_code(None if own.code is None else own.code.path):
            picture = drawn(results, own).figure
            if not hasattr(picture, "savefig"):
                raise DesignError(f"draw returned {type(picture).__name__}, not a figure of matplotlib")
            return save(picture, directory, stem)
    if FILE in keys or not is_built_in("figures", keys["kind"]):
        raise DesignError(OWN)
    return save(drawn(results, figure_component(keys)).figure, directory, stem)


def _name(kind: str) -> str:
    """Return the name of the files: the kind, or the name in a user's file."""
    parts = split_reference(kind)
    return kind if parts is None else parts[1]
