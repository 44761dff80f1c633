"""Compute packed results again on this machine, and compare them with the packed ones."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

from rmpc_bench.analysis.looks import number_of_look
from rmpc_bench.analysis.trial_differences import TrialDifferences, trial_differences
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.claims.record import ClaimRecord
from rmpc_bench.claims.table import claims_table
from rmpc_bench.components.source import data_hash
from rmpc_bench.config.load import load_config
from rmpc_bench.execution import manifest
from rmpc_bench.execution.evaluation import judge, summarise
from rmpc_bench.execution.pack_claim import only_claim
from rmpc_bench.execution.pack_environment import environment, other_versions
from rmpc_bench.execution.pack_rows import (
    TOLERANCE,
    read_rows,
    rows_against_summary,
    series_differences,
    table_differences,
    with_rows,
    without_moved,
)
from rmpc_bench.execution.results import Results, run
from rmpc_bench.execution.runner import RESOLVED
from rmpc_bench.execution.stored_stop import stop_of
from rmpc_bench.execution.verification import Verification
from rmpc_bench.received.archive import ArchiveError, note_verification, open_archive
from rmpc_bench.received.consent import reason_against_archive
from rmpc_bench.received.plain_files import CLAIMS, DamagedError, json_of
from rmpc_bench.report.kept_tables import comparisons_table, summary_table

if TYPE_CHECKING:
    from rmpc_bench.config.experiment_config import ExperimentConfig
    from rmpc_bench.execution.progress import Progress


def verify(
    path: str | Path,
    *,
    runs: int | None = None,
    claim: str = "",
    simulate: bool = True,
    allow_code: Sequence[str | Path] = (),
    jobs: int | None = None,
    progress: Progress | None = None,
) -> Verification:
    """Compare packed results with a new computation, and append the outcome to the archive.

    Parameters
    ----------
    path : the archive, from `pack`
    runs : number of runs to compute, from the first one on; all packed ones unless given
    claim : `id` of a claim, or its number in claims.md; only what it needs is computed
    simulate : whether to compute anything; otherwise only the files and the tables are compared
    allow_code : the archive itself, if Python files in it may run
    jobs : worker processes; the configuration's `execution.workers` unless given
    progress : display; silent unless given

    Returns
    -------
    what was compared and what differs; `reproduced` says whether nothing does

    Raises
    ------
    ArchiveError
        If the file is no archive of results, may not be taken out, or has Python files that are not allowed.
    ConfigError
        If its configuration does not load here.

    Examples
    --------
    >>> import rmpc_bench, tempfile
    >>> directory = tempfile.mkdtemp()
    >>> config = rmpc_bench.load_config("configs/quickstart.yaml", runs=4)
    >>> _ = rmpc_bench.publish(rmpc_bench.run(config, directory=directory, jobs=1))
    >>> _ = rmpc_bench.pack(directory, f"{directory}/quickstart.zip")
    >>> verify(f"{directory}/quickstart.zip", runs=2, jobs=1).reproduced
    True
    """
    archive = open_archive(Path(path))
    with TemporaryDirectory() as temporary:
        place, again = Path(temporary) / "packed", Path(temporary) / "again"
        place.mkdir()
        files = archive.extract(place)
        if simulate and (reason := reason_against_archive(archive.path, archive.code(place), allow_code)):
            raise ArchiveError(reason)
        packed = _Packed(place, archive.path)
        if simulate:
            found = packed.beside(runs, claim, again, jobs, progress)
        else:
            found = Verification(scope="files only, nothing was computed", digits=packed.against_summary())
        found = replace(found, path=archive.path, files=files, versions=tuple(other_versions(packed.manifest)))
    note_verification(archive.path, {**environment(), **found.record()})
    return found


class _Extent(NamedTuple):
    """How much of what is packed is computed again."""

    all_runs: bool
    all_claims: bool

    @property
    def complete(self) -> bool:
        """Whether all of it is."""
        return self.all_runs and self.all_claims


class _Packed:
    """The content of an archive, taken out.

    Parameters
    ----------
    directory : where it lies
    path : the archive, for messages
    """

    def __init__(self, directory: Path, path: Path) -> None:
        self._directory, self._path = directory, path
        self.manifest = manifest.read(directory)
        for name in (RESOLVED, "trials.csv", "summary.csv", "comparisons.csv"):
            if not (directory / name).is_file():
                raise ArchiveError(f"{path}: there is no {name}; make archives with `rmpc-bench pack`")

    def against_summary(self) -> tuple[str, ...]:
        """Compare summary.csv with the packed rows."""
        try:
            rows, summary = (read_rows(self._directory / name) for name in ("trials.csv", "summary.csv"))
            return tuple(rows_against_summary(rows, summary))
        except (ValueError, KeyError) as error:
            return (f"trials.csv or summary.csv cannot be read ({error})",)

    def beside(
        self, runs: int | None, claim: str, again: Path, jobs: int | None, progress: Progress | None
    ) -> Verification:
        """Compute the packed runs again and compare them; see `verify`."""
        config = load_config(self._directory / RESOLVED)
        rows = self._rows()
        wanted = [name for name in config.methods if name in {*rows["method"]}] or list(config.methods)
        n_packed = int(rows["run"].max()) + 1 if len(rows) else config.experiment.n_runs
        n_runs = min(runs or n_packed, n_packed)
        rule = stop_of(config, None)
        level = config.statistics.confidence if rule is None else rule.level
        # The packed runs are computed again as they are; a stopping rule has chosen their number and the level.
        if rule is not None or n_runs != config.experiment.n_runs:
            config = load_config(self._directory / RESOLVED, runs=n_runs)
        other = self.manifest.get("experiment") != config.hash
        if claim:
            config, wanted = only_claim(config, claim, wanted)
        here = run(config, directory=again, jobs=jobs, only=wanted, progress=progress)
        extent = _Extent(all_runs=n_runs == n_packed, all_claims=not claim)
        here = replace(here, trials=_with_look(here.trials, self.manifest, level))
        found = self._compared(config, here, rows[rows["run"] < n_runs], extent)
        size = f"runs 0 to {n_runs - 1} of {n_packed}" if n_runs < n_packed else f"all {n_packed} runs"
        scope = f"{size}, {len(wanted)} method{'s' * (len(wanted) > 1)}" + (f", claim {claim}" if claim else "")
        text = "the configuration gives another experiment hash here: the meaning of a key has changed"
        return replace(found, scope=scope, remarks=(text,) if other else ())

    def _rows(self) -> Any:
        try:
            return read_rows(self._directory / "trials.csv")
        except (ValueError, KeyError) as error:
            raise ArchiveError(f"{self._path}: trials.csv cannot be read ({error})") from None

    def _compared(self, config: ExperimentConfig, results: Results, rows: Any, extent: _Extent) -> Verification:
        """Compare rows, printed digits, findings and, where all runs were computed, series."""
        here = results.trials
        chosen = rows[rows["method"].isin(here.methods)]
        ends = {point.title: point.experiment.n_steps * (here.Ts or 1.0) for point in config.points}
        packed, moved = without_moved(with_rows(here, chosen), here, ends)
        trials = _of_packed(trial_differences(packed, here, TOLERANCE), complete=extent.complete)
        tables, claims = _tables(here), _claims(replace(results, trials=here))
        # Tables and findings of fewer runs or methods are computed from the packed rows in the same way.
        before = self._tables(tables) if extent.complete else _tables(packed)
        stated = self._claims() if extent.all_runs else _claims(replace(results, trials=packed))
        digits = [text for name in tables for text in table_differences(name, before[name], tables[name])]
        # A value that has moved by one sample changes the digits of its metric.
        digits = [text for text in digits if not any(f" {name} " in text for name in moved)]
        series = self._series(results) if extent.complete else []
        return Verification(
            trials=trials,
            moved=moved,
            digits=tuple(digits),
            findings=tuple(_claim_differences(stated, claims)),
            series=tuple(series),
            n_claims=len(claims),
        )

    def _tables(self, names: Iterable[str]) -> dict[str, str]:
        return {name: (self._directory / name).read_text(encoding="utf-8") for name in names}

    def _claims(self) -> list[ClaimRecord]:
        file = self._directory / "claims.json"
        try:
            claims: list[ClaimRecord] = (json_of(file, CLAIMS, "pack the results again") or {"claims": []})["claims"]
        except DamagedError as error:
            raise ArchiveError(f"{self._path}: claims.json cannot be read ({error})") from None
        return claims

    def _series(self, results: Results) -> list[str]:
        from rmpc_bench.report.csv_file import write_csv

        file, fresh = self._directory / "series.csv", results.directory / "series.csv"
        if not file.exists():
            return []
        write_csv(results.series, fresh)
        if data_hash(file) == data_hash(fresh):
            return []
        try:
            return series_differences(read_rows(file), read_rows(fresh))
        except (ValueError, KeyError) as error:
            return [f"series.csv cannot be read ({error})"]


def _of_packed(found: TrialDifferences, *, complete: bool) -> TrialDifferences:
    """Leave out what was computed but not packed, or not meant to be compared."""
    runs = tuple(replace(each, runs_b=()) for each in found.runs if each.runs_a)
    points = (found.points[0], ()) if complete else ((), ())
    return replace(found, runs=runs, methods=(found.methods[0], ()), points=points)


def _with_look(trials: Trials, packed: dict[str, Any], level: float) -> Trials:
    """Give a table the look at which the packed tables were made, by hand or by a rule: their levels depend on it."""
    looks = [n for n in packed.get("looks", []) if isinstance(n, int)]
    look = number_of_look(looks, max(len(table.runs) for table in trials.each))
    points = tuple(replace(table, look=look, confidence=level) for table in trials.points)
    return replace(trials, look=look, confidence=level, points=points)


def _tables(trials: Trials) -> dict[str, str]:
    """Return the files of printed digits."""
    tables = summarise(trials)
    frames = {"summary.csv": summary_table(tables.described), "comparisons.csv": comparisons_table(tables.compared)}
    return {name: frame.to_csv(index=False, lineterminator="\n") for name, frame in frames.items()}


def _claims(results: Results) -> list[ClaimRecord]:
    """Return the claims as claims.json has them."""
    claims: list[ClaimRecord] = json.loads(json.dumps(claims_table(judge(results))))
    return claims


def _claim_differences(packed: Sequence[ClaimRecord], here: Sequence[ClaimRecord]) -> list[str]:
    """Compare findings and numbers of claims, which have six digits."""
    before = {claim["statement"]: claim for claim in packed}
    found = []
    for claim in here:
        name, other = claim["id"] or claim["statement"], before.get(claim["statement"])
        if other is None:
            found.append(f"{name}: is not among the packed claims")
        elif claim["finding"] != other["finding"]:
            found.append(f"{name}: packed {other['finding']}, here {claim['finding']}")
        elif [claim["numbers"], claim["sizes"]] != [other["numbers"], other["sizes"]]:
            found.append(f"{name}: {claim['finding']} as packed, with other numbers")
    return found
