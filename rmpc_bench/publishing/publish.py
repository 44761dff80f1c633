"""Write every file that is derived from stored trials, with what options replace in the section `report`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, get_args

from rmpc_bench.analysis.columns import n_rows
from rmpc_bench.analysis.levels import look_of
from rmpc_bench.config.report import ReportKeys
from rmpc_bench.figures.files import NO_LATEX, latex_program
from rmpc_bench.figures.style import Rendering, remark_on
from rmpc_bench.installed import version_of
from rmpc_bench.publishing.figure_files import write_figures
from rmpc_bench.publishing.pages import Publication, place_of, write_page
from rmpc_bench.publishing.table_files import experiment_record, write_latex, write_tables
from rmpc_bench.replaced_file import folder, inside
from rmpc_bench.report.calibration_table import calibration_table
from rmpc_bench.report.tuning_table import TuningTable
from rmpc_bench.results.evaluate import drivers, judge, ranks, requirements, summarise
from rmpc_bench.results.manifest import note_look, note_report, read
from rmpc_bench.results.record import StoredExperiment
from rmpc_bench.results.results import Results
from rmpc_bench.types import DesignError
from rmpc_bench.types.errors import check_arguments, unknown
from rmpc_bench.types.result_layout import Column, Font, Format, Style

CHOICES: dict[str, tuple[str, ...]] = {
    "columns": get_args(Column),
    "format": get_args(Format),
    "font": get_args(Font),
    "style": get_args(Style),
}  # key -> its values
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
    wrong = {key for key, _ in found}
    valid = {key: value for key, value in given.items() if key not in wrong}
    if "pgf" in replace(experiment.report, **valid).formats and latex_program() is None:
        found.append(("format", NO_LATEX))
    return found


def choose(results: Results, **keys: Any) -> Results:
    """Return the same results whose tables and figures show something else, or are written otherwise.

    The keys replace those of the section `report`: order, width, metrics, columns, style, font, format, trials.  None
    leaves a key as it is.  Raises a DesignError with the choices or the nearest name if a value is wrong.

    >>> import rmpc_bench
    >>> results = rmpc_bench.run({"name": "small", "extends": "quickstart", "runs": 4})
    >>> choose(results, width="252pt", order=["R-MPC", "S-MPC"]).experiment.report.order
    ['R-MPC', 'S-MPC']
    """
    if problems := wrong_choices(results.experiment, **keys):
        raise DesignError("\n".join(f"{key}: {message}" for key, message in problems), problems[0][0])
    given = {key: value for key, value in keys.items() if value is not None}
    report = replace(results.experiment.report, **given)
    return replace(results, experiment=replace(results.experiment, report=report))


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


def publish(
    results: Results,
    *,
    to: str | Path | None = None,
    rendering: Rendering | None = None,
    index: Path | None = None,
    place: str = "",
) -> Publication:
    """Write all tables, series, recorded runs, claims and figures of stored results; nothing is simulated.

    Parameters
    ----------
    results : from `run` or `load_results`
    to : directory to write to, made if it is not there; the one of the results unless given
    rendering : width, font, style and formats of the figures; those of the section `report` unless given
    index : index of several experiments that the page links; none if None
    place : the directory as commands in the files name it; from the present one, else from ``results`` on, else its
        last part, unless given

    Returns
    -------
    the written files with the tables and verdicts in them; `summary()` is the text of the command line

    Raises
    ------
    OSError
        If a file cannot be written.

    Examples
    --------
    >>> import rmpc_bench
    >>> results = rmpc_bench.run({"name": "small", "extends": "quickstart", "runs": 4})
    >>> written = publish(results, to=results.directory / "published")
    >>> [path.name for path in written.paths][:2]
    ['trials.csv', 'uncertainty.csv']
    """
    check_arguments(publish, locals())
    directory = results.directory if to is None else Path(to)
    with inside(directory):
        report = results.experiment.report
        rendering = rendering or Rendering(
            width=report.width_in, font=report.font, style=report.style, formats=report.formats
        )
        known = read(results.directory)
        stated = known.get("report", {})
        # With a given `place` the files are made elsewhere; the file of the configuration is then the recorded one.
        file = str(stated.get("file", "") if place else known.get("file", ""))
        named = place or place_of(results.directory)
        if named != stated.get("place") and not Path(file).is_file():
            file = ""
        return _published(results, directory, rendering, index, named, file)


def _published(
    results: Results, directory: Path, rendering: Rendering, index: Path | None, place: str, file: str
) -> Publication:
    """Write everything below a directory."""
    texts, report = folder(directory, "tables"), results.experiment.report
    pictures = folder(directory, "figures") if results.experiment.figures else directory / "figures"
    published = Publication(
        results=results,
        directory=directory,
        trials=results.trials,
        extent=results.extent,
        overrides=results.overrides,
        incomplete=results.incomplete,
        tables=summarise(results).shown(report.order, results.experiment.shown_metrics),
        verdicts=judge(results),
        drivers=drivers(results),
        requirements=requirements(results),
        ranks=ranks(results),
        tuning=tuning(results),
        calibration=calibration_table(results.trials),
        remarks=tuple(filter(None, [remark_on(rendering.font), _remark_on_rows(results)])),
    )
    paths = write_tables(results, published, directory, place, rendering.formats)
    # Another directory says nothing else than this one, which stays as it is.
    if directory.resolve() == results.directory.resolve():
        if len(results.trials.runs) and results.trials.with_verdicts:
            note_look(directory, look_of(len(results.trials.runs), results.trials.adjust))
        note_report(directory, _way(results, place, file))
    record = experiment_record(results, file)
    paths += write_latex(published.tables, published.calibration, record, texts, report)
    figures, left_out = write_figures(results, pictures, rendering)
    paths += [path for figure in figures for path in figure.paths]
    published = replace(published, paths=tuple(paths), figures=figures, left_out=left_out)
    pages = write_page(published, record, rendering, place, index)
    return replace(published, paths=(*paths, *pages))


def _remark_on_rows(results: Results) -> str:
    """Say that trials.csv is left out unasked; empty where it is not."""
    report, n = results.experiment.report, n_rows(results.stored.columns)
    if report.trials is not None or report.writes_trials(n):
        return ""
    return f"trials.csv, with {n:,} rows, is left out; --trials or `report: {{trials: true}}` writes it"


def _way(results: Results, place: str, file: str) -> dict[str, Any]:
    """Describe how the files are made, as plain data."""
    keys = {key: value for key, value in asdict(results.experiment.report).items() if value is not None}
    return {
        "place": place,
        **({"file": file} if file else {}),
        "keys": keys,
        "labels": dict(results.experiment.labels),
        "adjust": asdict(results.experiment)["adjust"],
        "own_figures": bool(results.components),
        "matplotlib": version_of("matplotlib"),
        "fonttools": version_of("fonttools"),
        "font_tables": "outlines and metrics",  # not stated by versions that also embedded others
    }


def tuning(results: Results) -> TuningTable:
    """Return how the parameters were chosen, what that gains, and how far the ranks of tuned methods can be relied on.

    Parameters
    ----------
    results : from `run` or `load_results`

    Returns
    -------
    the table, with `frame`, `sentences`, `to_markdown()` and `to_screen()`; empty where no method is tuned

    Examples
    --------
    >>> import rmpc_bench
    >>> keys = {"tune": {"budget": 3, "runs": 2}, "methods": {"R-MPC": {"tune": {"estimator.c": [0.01, 1]}}}}
    >>> results = rmpc_bench.run({"name": "tuned", "extends": "quickstart", "runs": 4, **keys}, only=["S-MPC", "R-MPC"])
    >>> tuning(results).frame[["method", "parameter", "n_values", "n_runs"]].to_numpy().tolist()
    [['R-MPC', 'estimator.c', 3, 2]]
    """
    check_arguments(tuning, locals())
    return TuningTable(results.trials, results.tuning)
