"""Choices of a report: what options replace in the section `report` of an experiment, checked against its names."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, get_args

from rmpc_bench.config.report_section import ReportKeys
from rmpc_bench.execution.results import Results
from rmpc_bench.execution.stored_experiment import StoredExperiment
from rmpc_bench.figures.files import NO_LATEX, latex_program
from rmpc_bench.figures.style import Rendering
from rmpc_bench.types import DesignError
from rmpc_bench.types.issue import unknown
from rmpc_bench.types.report_choices import Column, Font, Format, Style

CHOICES: dict[str, tuple[str, ...]] = {
    "columns": get_args(Column),
    "format": get_args(Format),
    "font": get_args(Font),
    "style": get_args(Style),
}
"""Key -> its values."""
NOUNS = {"order": "method", "metrics": "metric of this experiment"}


def wrong_choices(experiment: StoredExperiment, **keys: Any) -> list[tuple[str, str]]:
    """Return key and message of everything that is wrong with these keys; see `choose`."""
    given = {key: value for key, value in keys.items() if value is not None}
    found = [*_wrong_names(experiment, given)]
    for key, value in given.items():
        try:
            ReportKeys(**{key: value})
        except ValueError as error:
            found.append((key, str(error)))
    if "pgf" in replace(experiment.report, **_valid(given, found)).formats and latex_program() is None:
        found.append(("format", NO_LATEX))
    return found


def _valid(given: dict[str, Any], found: list[tuple[str, str]]) -> dict[str, Any]:
    wrong = {key for key, _ in found}
    return {key: value for key, value in given.items() if key not in wrong}


def choose(results: Results, **keys: Any) -> Results:
    """Return the same results whose tables and figures show something else, or are written otherwise.

    The keys replace those of the section `report`: order, width, metrics, columns, style, font, format.  None leaves a
    key as it is.  Raises a DesignError with the choices or the nearest name if a value is wrong.

    Examples
    --------
    >>> import rmpc_bench, tempfile
    >>> directory = tempfile.mkdtemp()
    >>> config = rmpc_bench.load_config("configs/quickstart.yaml", runs=4)
    >>> results = rmpc_bench.run(config, directory=directory, jobs=1)
    >>> choose(results, width="252pt", order=["R-MPC", "S-MPC"]).experiment.report.order
    ['R-MPC', 'S-MPC']
    """
    if problems := wrong_choices(results.experiment, **keys):
        raise DesignError("\n".join(f"{key}: {message}" for key, message in problems), problems[0][0])
    given = {key: value for key, value in keys.items() if value is not None}
    report = replace(results.experiment.report, **given)
    return replace(results, experiment=replace(results.experiment, report=report))


def rendering_of(report: ReportKeys) -> Rendering:
    """Return how figures are written by the section `report`."""
    return Rendering(width=report.width_in, font=report.font, style=report.style, formats=report.formats)


def _wrong_names(experiment: StoredExperiment, given: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield key and message of every name that does not exist."""
    names_of = {"order": experiment.methods, "metrics": [info.name for info in experiment.points[0].metrics]}
    for key, value in given.items():
        values = [value] if isinstance(value, str) else value
        for name in values if key in CHOICES else ():
            if name not in CHOICES[key]:
                yield key, f"must be one of {', '.join(CHOICES[key])} (got {name!r})"
        known = names_of.get(key, CHOICES.get(key, ()))
        if known and not value:
            yield key, f"must name at least one of {', '.join(known)}"
        if key not in names_of:
            continue
        for name in value:
            if name not in names_of[key]:
                yield key, unknown(name, names_of[key], NOUNS[key])
