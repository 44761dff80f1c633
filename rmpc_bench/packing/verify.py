"""Compute packed results again on this machine, make every file from them, and compare all with the packed ones."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from rmpc_bench.analysis.levels import look_of, number_of_look
from rmpc_bench.analysis.trial_differences import RunsInOne, trial_differences
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.claims.claim import Claim
from rmpc_bench.claims.grammar import ExpressionError, parse, parse_expression, terms
from rmpc_bench.claims.record import ClaimRecord, claims_table
from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.config.load import load_config
from rmpc_bench.engines.choice import ComputeOptions
from rmpc_bench.execution.progress import Progress
from rmpc_bench.execution.run import filled
from rmpc_bench.packing.comparison import (
    DIFFERENT,
    HASHED,
    NUMBERS,
    TOLERANCE,
    FileOutcome,
    compared_text,
    read_rows,
    rows_against_summary,
    with_draws,
    with_rows,
    wrong_row,
)
from rmpc_bench.packing.recreate import MOST_ROWS, PackedFiles
from rmpc_bench.packing.verification import Verification, environment, other_versions
from rmpc_bench.received.archive import Archive, ArchiveError, note_verification, open_archive
from rmpc_bench.received.consent import reason_against_archive
from rmpc_bench.received.plain_files import CLAIMS, DamagedError, json_of
from rmpc_bench.results import manifest
from rmpc_bench.results.evaluate import judge
from rmpc_bench.results.record import stop_of
from rmpc_bench.results.results import Results
from rmpc_bench.types import ConfigError
from rmpc_bench.types.errors import check_arguments, unknown
from rmpc_bench.types.result_layout import CONFIG, RESOLVED
from rmpc_bench.types.sweep_points import lies_at


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
    """Compute packed results again, make all files from them, compare these with the packed ones, and note the outcome.

    Parameters
    ----------
    path : the archive, from `pack`
    runs : number of runs to compute, from the first one on; all packed ones unless given.  Tables are then made from
        the packed rows, of which those of the other runs are not checked; figures and pages are not compared
    claim : `id` of a claim, or its number in claims.md; only what it needs is computed and compared
    simulate : whether to compute anything; otherwise only hashes are compared, and summary.csv with the rows
    allow_code : the archive itself, if Python files in it may run
    jobs : most worker processes; the configuration's `execution.workers` unless given
    progress : display; silent unless given

    Returns
    -------
    what was compared, file by file, and what differs; `reproduced` says whether nothing does

    Raises
    ------
    ArchiveError
        If the file is no archive of results, may not be taken out, has code that is not allowed, or its configuration
        does not load here.

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
    check_arguments(verify, locals())
    archive = open_archive(Path(path))
    with TemporaryDirectory() as temporary:
        place = Path(temporary) / "packed"
        place.mkdir()
        hashes = archive.extract(place)
        if simulate and (reason := reason_against_archive(archive.path, archive.code(place), allow_code)):
            raise ArchiveError(reason)
        try:
            packed = _Packed(place, archive)
            found = packed.beside(runs, claim, Path(temporary), jobs, progress) if simulate else packed.unchanged()
        except DamagedError as error:
            text = re.sub(rf"{re.escape(temporary)}/\w+/", "", str(error)).rpartition(";")[0]
            raise ArchiveError(f"{archive.path}: {text}; ask for the archive again") from None
        except ConfigError as error:
            text = re.sub(rf"{re.escape(temporary)}/\w+/", f"{archive.path}: ", str(error))
            raise ArchiveError(text) from None
        found = replace(found, path=archive.path, hashes=hashes, versions=packed.versions)
    try:
        note_verification(archive.path, {**environment(), **found.record()})
    except OSError as error:
        return replace(
            found, remarks=(*found.remarks, f"{archive.path} does not record this outcome: {error.strerror}")
        )
    return found


class _Packed:
    """The content of an archive, taken out into a directory."""

    def __init__(self, directory: Path, archive: Archive) -> None:
        self._directory, self._path, self._names = directory, archive.path, archive.names
        self._manifest = manifest.read(directory)
        self.versions = tuple(other_versions(self._manifest))
        self._is_imported = self._manifest.get("origin") == "imported"
        for name in (CONFIG if self._is_imported else RESOLVED, "trials.csv", "summary.csv", "comparisons.csv"):
            if not (directory / name).is_file():
                raise ArchiveError(f"{archive.path}: there is no {name}; make archives with `rmpc-bench pack`")

    def unchanged(self) -> Verification:
        """Compare summary.csv with the packed rows; nothing is computed."""
        try:
            rows = read_rows(self._directory / "trials.csv", MOST_ROWS)
            summary = read_rows(self._directory / "summary.csv")
            digits = tuple(rows_against_summary(rows, summary))
        except (ValueError, KeyError, TypeError) as error:
            digits = (f"trials.csv or summary.csv cannot be read ({error})",)
        return Verification(scope="files only, nothing was computed", digits=digits, files=tuple(self._hashed("")))

    def _files(self) -> PackedFiles:
        return PackedFiles(self._directory, self._names, self._manifest, self._path, exact=not self.versions)

    def _hashed(self, note: str) -> list[FileOutcome]:
        return [FileOutcome(name, HASHED, note) for name in sorted(self._names)]

    def beside(
        self, runs: int | None, claim: str, temporary: Path, jobs: int | None, progress: Progress | None
    ) -> Verification:
        """Compute the packed runs again and compare them and what is made from them; see `verify`."""
        if self._is_imported:
            if runs or claim:
                raise ArchiveError(f"{self._path}: runs made elsewhere are verified as a whole: no --runs, no --claim")
            return self._read_again(temporary)
        stated = load_config(self._directory / RESOLVED, lenient=True)
        rows = self._rows(stated)
        extent = _extent(stated, rows, runs, claim)
        files = self._files()
        files.prepare(temporary / "again")
        config, wanted = self._config(stated, extent, files), extent.methods
        if claim:
            config, wanted = only_claim(config, claim, wanted)
        here = filled(config, temporary / "again", ComputeOptions(jobs), only=wanted, progress=progress)
        extent = extent._replace(complete=extent.complete and len(here.stored.runs) in (0, extent.n_packed))
        found, packed = self._compared(here.stored, rows[rows["run"] < extent.n_runs], complete=extent.complete)
        if claim:
            both = (replace(here, stored=self._with_look(each, stated)) for each in (here.stored, packed))
            texts, n_claims = self._claim(*both, all_runs=extent.n_runs == extent.n_packed)
            found = replace(found, findings=texts, n_claims=n_claims)
            outcomes = self._hashed("is not made for one claim")
        elif extent.complete:
            # On another machine the files are made from the packed rows: last digits would change what is printed.
            trials = here.stored if files.exact or found.differences else packed
            outcomes = files.outcomes(replace(here, stored=trials), stated, temporary)
            outcomes = [_of_rows(each, found, exact=files.exact) for each in outcomes]
        else:
            every = self._with_look(self._with_draws(with_rows(here.stored, rows)), stated)
            here = replace(_as_packed(here, stated, rows), stored=every)
            outcomes = files.outcomes(here, stated, temporary, extent.n_runs)
        scope = f"{extent}, {len(wanted)} method{'s' * (len(wanted) > 1)}" + (f", claim {claim}" if claim else "")
        return replace(found, scope=scope, remarks=extent.remarks(claim), files=tuple(outcomes))

    def _read_again(self, temporary: Path) -> Verification:
        """Import the packed table again, and compare rows and files; the runs themselves cannot be repeated."""
        files = self._files()
        here = files.imported(temporary / "again")
        try:
            rows = read_rows(self._directory / "trials.csv", len(here.stored.columns["run"]))
            found, _ = self._compared(here.stored, rows, complete=True)
        except (ValueError, KeyError, TypeError) as error:
            raise ArchiveError(f"{self._path}: trials.csv cannot be read ({error})") from None
        text = "the runs were made elsewhere and were not repeated: their table was read again"
        outcomes = files.imported_outcomes(here, temporary)
        return replace(found, scope="table, claims and files again", remarks=(text,), files=tuple(outcomes))

    def _config(self, stated: ExperimentConfig, extent: _Extent, files: PackedFiles) -> ExperimentConfig:
        """Return the experiment to compute: a stopping rule is applied again where all runs are computed."""
        if not extent.complete and (stated.stop is not None or extent.n_runs != stated.experiment.n_runs):
            stated = load_config(self._directory / RESOLVED, runs=extent.n_runs, lenient=True)
        return files.as_stated(stated)

    def _with_look(self, trials: Trials, config: ExperimentConfig) -> Trials:
        """Give a table the look at which the packed tables were made, and its level."""
        rule = stop_of(config, None)
        level = config.statistics.confidence if rule is None else rule.level
        n_runs = max(len(table.runs) for table in trials.common.each)
        look = number_of_look(self._manifest.get("looks", []), look_of(n_runs, config.statistics.adjust))
        points = tuple(replace(table, look=look, confidence=level) for table in trials.points)
        return replace(trials, look=look, confidence=level, points=points)

    def _rows(self, config: ExperimentConfig) -> Any:
        points, n_runs = [(each.coordinates, each.method_keys) for each in config.points], config.experiment.n_runs
        try:
            rows = read_rows(self._directory / "trials.csv", sum(len(methods) for _, methods in points) * n_runs)
            if wrong := wrong_row(rows, points, n_runs):
                raise ArchiveError(f"{self._path}: trials.csv: {wrong}; ask for the archive again")
            return rows
        except (ValueError, KeyError, TypeError) as error:
            raise ArchiveError(f"{self._path}: trials.csv cannot be read ({error})") from None

    def _with_draws(self, trials: Trials) -> Trials:
        """Give a table the packed values of uncertain quantities, which the changes of all runs are adjusted for."""
        file = self._directory / "uncertainty.csv"
        try:
            return with_draws(trials, read_rows(file, MOST_ROWS, first="run")) if file.is_file() else trials
        except (ValueError, KeyError, TypeError) as error:
            raise ArchiveError(f"{self._path}: uncertainty.csv cannot be read ({error})") from None

    def _compared(self, here: Trials, rows: Any, *, complete: bool) -> tuple[Verification, Trials]:
        """Compare rows with those of this computation, and return both the outcome and the packed trials."""
        packed = with_rows(here, rows[rows["method"].isin(here.methods)])
        trials = trial_differences(packed, here, TOLERANCE if self.versions else 0.0)
        points = (trials.points[0], trials.points[1] if complete else ())
        return Verification(trials=replace(trials, runs=tuple(_missing(packed, here)), points=points)), packed

    def _claim(self, here: Results, packed: Results, *, all_runs: bool) -> tuple[tuple[str, ...], int]:
        """Compare one claim with the packed one, or with that of the packed rows where not all runs are computed."""
        file = json_of(self._directory / "claims.json", CLAIMS, "") or {"claims": []}
        stated = file["claims"] if all_runs else _claims(packed)
        before = {claim["statement"]: claim for claim in stated}
        counts = Counter(claim["statement"] for claim in stated)
        found = [f"claims.json: {text[:60]!r} is given {n} times" for text, n in counts.items() if n > 1]
        for claim in _claims(here):
            texts = (json.dumps(each, indent=1) for each in (before.get(claim["statement"]), claim))
            outcome = compared_text(claim["id"] or claim["statement"], *texts, exact=not self.versions)
            found += [f"{outcome.name}: {outcome.note}"] if outcome.is_different else []
        return tuple(found), len(here.experiment.claims)


class _Extent(NamedTuple):
    """How much of what is packed is computed again."""

    methods: list[str]
    n_runs: int
    n_packed: int
    complete: bool  # whether all runs of all these methods are packed and computed, so that every file can be made

    def __str__(self) -> str:
        n, n_packed = self.n_runs, self.n_packed
        return f"runs 0 to {n - 1} of {n_packed}" if n < n_packed else f"all {n_packed} runs"

    def remarks(self, claim: str) -> tuple[str, ...]:
        """Say how little is known where not all was computed."""
        if self.complete:
            return ()
        if claim:
            return (f"only what claim {claim} needs was computed; no file was compared",)
        left = self.n_packed - self.n_runs
        found = f"{left} of {self.n_packed} runs were not computed, their rows are taken as packed" if left else ""
        rest = "tables and claims are compared with what the packed rows give, figures and pages are not compared"
        return (f"{found or 'the archive has not all runs'}; {rest}",)


def _extent(config: ExperimentConfig, rows: Any, runs: int | None, claim: str) -> _Extent:
    """Find how much is packed, and how much of it is to be computed."""
    wanted = [name for name in config.methods if name in {*rows["method"]}] or list(config.methods)
    n_packed = int(rows["run"].max()) + 1 if len(rows) else config.experiment.n_runs
    n_runs = min(runs or n_packed, n_packed)
    n_methods = sum(name in point.method_keys for point in config.points for name in wanted)
    is_whole = len(rows) == ("runs" in config.evaluate) * n_methods * n_packed
    is_whole = is_whole and (config.stop is not None or n_packed == config.experiment.n_runs)
    return _Extent(wanted, n_runs, n_packed, is_whole and n_runs == n_packed and not claim)


def _as_packed(here: Results, config: ExperimentConfig, rows: Any) -> Results:
    """Return results that count the packed runs, not those that were computed."""
    points = list(rows.columns[: list(rows.columns).index("method")])
    counts = rows.groupby([*points, "method"]).size().groupby("method").min().to_dict()
    n_runs = config.experiment.n_runs if config.stop is None else int(rows["run"].max()) + 1
    return replace(
        here,
        n_complete={name: counts.get(name, 0) for name in config.methods},
        experiment=replace(here.experiment, n_runs=n_runs),
    )


def _of_rows(outcome: FileOutcome, found: Verification, *, exact: bool) -> FileOutcome:
    """Say of trials.csv what the comparison of its rows has found; on another machine it was made from them."""
    if outcome.name != "trials.csv" or exact or not outcome.is_compared:
        return outcome
    return FileOutcome(outcome.name, *((DIFFERENT, "see above") if found.differences else (NUMBERS, "")))


def _missing(packed: Trials, here: Trials) -> Iterator[RunsInOne]:
    """Yield the runs that were computed but have no row; a run that was packed has been computed."""
    for table in here.each:
        rows = next(each for each in packed.each if each.point == table.point)
        for name in table.methods:
            if left := sorted(table.statuses(name).keys() - rows.statuses(name).keys()):
                yield RunsInOne(table.title, name, (), tuple(left))


def _claims(results: Results) -> list[ClaimRecord]:
    """Return the claims as claims.json has them."""
    claims: list[ClaimRecord] = json.loads(json.dumps(claims_table(judge(results))))
    return claims


def only_claim(config: ExperimentConfig, name: str, methods: Collection[str]) -> tuple[ExperimentConfig, list[str]]:
    """Reduce an experiment to the points, methods and the claim of this `id` or number in claims.md."""
    claim = _named(config.claims, name)
    wanted = list(_needed(claim))
    names = [method for method in config.methods if method in methods and method in {each for each, _ in wanted}]
    points = tuple(
        point for point in config.points if any(lies_at(point.coordinates, coordinates) for _, coordinates in wanted)
    )
    if not names or not points:
        raise ArchiveError(f"claim {name}: no run can be computed for it: {claim.says}")
    return replace(config, claims=(claim,), points=points), names


def _named(claims: Sequence[Claim], name: str) -> Claim:
    known = {claim.name: claim for claim in claims if claim.name}
    numbered = {str(number): claim for number, claim in enumerate(claims, 1)}
    if name not in known and name not in numbered:
        numbers = f"; or a number from 1 to {len(claims)}, as in claims.md" if claims else ""
        none = f"there is no claim {name!r}" + ("" if claims else ": the experiment has no claims")
        text = unknown(name, known, "claim") if known else none
        raise ArchiveError(f"--claim: {text}{numbers}")
    return known.get(name) or numbered[name]


def _needed(claim: Claim) -> Iterator[tuple[str, Mapping[str, str]]]:
    """Yield the methods that a claim names, each with coordinates of a point."""
    trees = []
    for text, read in [
        *((each, parse) for each in claim.check),
        *((each.of, parse_expression) for each in claim.numbers),
    ]:
        try:
            trees.append(read(text))
        except ExpressionError:
            # The finding says so.
            continue
    for at in claim.at or ({},):
        for node in trees:
            for term in terms(node):
                yield term.method, {**at, **dict(term.point)}
