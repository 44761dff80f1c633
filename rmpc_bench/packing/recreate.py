"""The files of an archive made again from computed trials; which of them are compared, and which cannot be."""

from __future__ import annotations

import re
import shlex
import shutil
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path, PurePosixPath
from typing import Any

import rmpc_bench
from rmpc_bench.analysis.columns import Columns, n_rows
from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.config.load import load_config
from rmpc_bench.config.own_code import in_directory, renamed
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import dump, load
from rmpc_bench.execution.runner import added_in
from rmpc_bench.importing.directory import import_runs
from rmpc_bench.packing.comparison import (
    DIFFERENT,
    HASHED,
    UNSEEN,
    FileOutcome,
    compared,
    compared_text,
    read_rows,
    same_but_fonts,
)
from rmpc_bench.packing.metadata import CITATION, citation, crate, stated_by
from rmpc_bench.packing.pack import DATA, FILES, NEEDED, ROWS, SECONDS, SOURCES, chosen, facts_of, split_pattern
from rmpc_bench.publishing.publish import publish
from rmpc_bench.publishing.table_files import write_tables_of_rows
from rmpc_bench.received.archive import METADATA, ArchiveError, json_bytes
from rmpc_bench.received.consent import VERIFIED
from rmpc_bench.received.plain_files import checked
from rmpc_bench.report.point_tables import trials_csv
from rmpc_bench.results import manifest
from rmpc_bench.results.results import Results
from rmpc_bench.results.tables import with_timings
from rmpc_bench.results.tuning import FILE as TUNING
from rmpc_bench.types import ConfigError, DesignError
from rmpc_bench.types.result_layout import CONFIG, COPIES, RESOLVED

MOST_ROWS = 20_000_000  # rows of a packed table that are read where no configuration says how many there are
TIMINGS = "timings.csv"
DURATIONS = ("calls", "median_s", "q95_s", "largest_s", "q95_share_of_Ts")
"""Columns of timings.csv that differ from computation to computation."""
COMPARED = ("name", "experiment", "seed", "modified")  # fields of manifest.json that follow from the configuration
STATED = ("versions", "libraries", "blas", "git", "platform", "file", "looks", "report", "sessions")
"""Fields of manifest.json that say where, when and how; the files are made with them as they are."""
DRAWN = (".svg", ".pdf", ".png", ".pgf", ".html")  # endings of files that have drawings in them


class PackedFiles:
    """The files of an archive, taken out; `exact` where the versions and the machine are those of the archive."""

    def __init__(self, directory: Path, names: Sequence[str], stated: Mapping[str, Any], path: Path, *, exact: bool):
        self._directory, self._names, self._stated, self._path, self.exact = directory, names, stated, path, exact
        self._way: Mapping[str, Any] = stated.get("report", {})
        self._overrides = tuple(stated.get("modified", []))
        self._loaded: ExperimentConfig | None = None
        place = PurePosixPath(self._way.get("place", ""))
        if place.is_absolute() or ".." in place.parts or str(place).startswith("-"):
            text = f"report.place: must be a plain relative path (got {str(place)!r})"
            raise ArchiveError(f"{path}: manifest.json: {text}")

    def as_stated(self, config: ExperimentConfig) -> ExperimentConfig:
        """Return a resolved configuration with what it does not have: options of the command, given labels."""
        # Where the given one is not loaded, a stated label counts that is the name of its method with parameters.
        labels = dict(config.labels)
        for name, text in self._way.get("labels", {}).items():
            given = text.startswith(f"{name}, ") if self._loaded is None else self._loaded.labels.get(name) == text
            labels |= {name: text} if name in labels and given else {}
        # A version that adjusted nothing has stated nothing of it.
        statistics = config.statistics if "adjust" in self._way else replace(config.statistics, adjust="none")
        return replace(config, overrides=self._overrides, labels=labels, statistics=statistics)

    def prepare(self, place: Path) -> None:
        """Give the directory of the new computation what it cannot find again: earlier looks, and what tuning chose."""
        place.mkdir()
        self._loaded = self._load(place.with_name("given"))
        (place / manifest.FILE).write_bytes(json_bytes({"looks": self._stated.get("looks", [])}))
        for name in (TUNING, SECONDS):
            if (self._directory / name).is_file():
                (place / name).parent.mkdir(exist_ok=True)
                shutil.copyfile(self._directory / name, place / name)

    def outcomes(
        self, results: Results, config: ExperimentConfig, temporary: Path, n_runs: int | None = None
    ) -> list[FileOutcome]:
        """Make all files again and compare them; only the tables where no more than `n_runs` were computed."""
        made, computed = temporary / "made", manifest.read(results.directory)
        made.mkdir()
        timed = self._timed(results)
        found = {each.name: each for each in self._inputs(config, computed, temporary)}
        found[TIMINGS] = _timings(timed.durations, results.durations)
        results = chosen(timed, self._way, self._path)
        if n_runs is None:
            self._name_files(results.directory / RESOLVED, config.own.patterns)
            shown = results if self._way.get("own_figures", True) else replace(results, components={})
            self._publish(shown, computed, made)
        else:
            write_tables_of_rows(results, made, str(self._way.get("file", "")))
            found["trials.csv"] = FileOutcome("trials.csv", HASHED, f"rows of runs 0 to {n_runs - 1} are compared")
        return self._with_others(found, results, made, NEEDED, whole=n_runs is None)

    def imported(self, place: Path) -> Results:
        """Import the packed table again, as the manifest states."""
        source = (self._stated.get("sources") or [{"copy": "", "file": "", "options": {}}])[-1]
        if source["copy"] not in {*SOURCES} & {*self._names}:
            raise ArchiveError(f"{self._path}: the table of runs is not in it; --no-run checks the files")
        place.mkdir()
        (place / manifest.FILE).write_bytes(json_bytes({"looks": self._stated.get("looks", [])}))
        given = {"directory": place, "settings": self._directory / CONFIG, "max_rows": MOST_ROWS}
        try:
            found = import_runs(self._directory / source["copy"], **{**source["options"], **given})
        except (ConfigError, DesignError, TypeError) as error:
            raise ArchiveError(f"{self._path}: the packed table cannot be imported as it was: {error}") from None
        made = found.experiment.imported
        assert made is not None
        return replace(found, experiment=replace(found.experiment, imported=replace(made, table=source["file"])))

    def imported_outcomes(self, results: Results, temporary: Path) -> list[FileOutcome]:
        """Make all files of an imported table again and compare them."""
        made, computed = temporary / "made", manifest.read(results.directory)
        made.mkdir()
        found = {name: FileOutcome(name, HASHED, "input") for name in (CONFIG, *SOURCES)}
        found |= {VERIFIED: FileOutcome(VERIFIED, UNSEEN, "records of other verifications")}
        results = chosen(results, self._way, self._path)
        self._publish(results, computed, made)
        same = all(self._stated.get(name) == computed.get(name) for name in (*COMPARED, "origin", "warnings"))
        found[manifest.FILE] = FileOutcome(manifest.FILE, *((HASHED, "") if same else (DIFFERENT, "other runs")))
        return self._with_others(found, results, made, (), whole=True)

    def _with_others(
        self, found: dict[str, FileOutcome], results: Results, made: Path, needed: Collection[str], *, whole: bool
    ) -> list[FileOutcome]:
        """Add what was found about the other files: compared, missing, not made where not all runs were computed."""
        found[METADATA], found[CITATION] = self._metadata(results)
        for name in self._names:
            if name not in found:
                seen = whole or (made / name).is_file()
                found[name] = self._compared(name, made) if seen else FileOutcome(name, UNSEEN, "needs all runs")
        here = {path.relative_to(made).as_posix() for path in made.rglob("*") if path.is_file()}
        found |= {name: FileOutcome(name, DIFFERENT, "is missing") for name in {*here, *needed} - {*self._names}}
        return [each for name, each in sorted(found.items()) if name in self._names or each.is_different]

    def _publish(self, results: Results, computed: Mapping[str, Any], made: Path) -> None:
        """Write all files in the way that the archive states, for its machine and its times."""
        known = {name: self._stated[name] for name in STATED if name in self._stated}
        (results.directory / manifest.FILE).write_bytes(json_bytes({**computed, **known}))
        publish(results, to=made, place=self._way.get("place", ""))
        # The archive has it also where the report leaves it out.
        if not (made / ROWS).is_file():
            trials_csv(results.stored, made / ROWS)

    def _inputs(self, config: ExperimentConfig, computed: Mapping[str, Any], temporary: Path) -> Iterator[FileOutcome]:
        """Yield what was found about the files from which all others are computed."""
        yield FileOutcome(VERIFIED, UNSEEN, "records of other verifications")
        yield self._given(config, temporary / "given")
        yield self._resolved(config)
        yield self._manifest(computed)
        for name in self._names:
            if name.startswith((f"{COPIES}/", f"{DATA}/")) or name in (TUNING, SECONDS):
                tuned = ": the search of tuning is not repeated" * (name in (TUNING, SECONDS))
                yield FileOutcome(name, HASHED, f"input{tuned}")

    def _resolved(self, config: ExperimentConfig) -> FileOutcome:
        """Check that the configuration is that of the experiment that the manifest names."""
        if config.hash != self._stated.get("experiment"):
            return FileOutcome(RESOLVED, DIFFERENT, "gives another experiment hash than manifest.json states")
        return FileOutcome(RESOLVED, HASHED, "input: gives the experiment hash of manifest.json")

    def _given(self, config: ExperimentConfig, place: Path) -> FileOutcome:
        """Check that the configuration as given resolves to the resolved one."""
        given = self._loaded
        if any(name.startswith(f"{COPIES}/") for name in self._names):
            return FileOutcome(CONFIG, HASHED, "input: own code is loaded once only, for the resolved one")
        if given is None:
            return FileOutcome(CONFIG, HASHED, "input: does not load from the archive alone")
        tree, packed = in_directory(given.resolved, place, given.own), plain(load(self._directory / RESOLVED))
        found = compared_text(CONFIG, _by_names(tree, given), _by_names(packed, config))
        # Tuning has put its values into the resolved one.
        if given.hash != config.hash or (found.is_different and config.tuning is None):
            return FileOutcome(CONFIG, DIFFERENT, f"does not resolve to {RESOLVED}: {found.note or 'another hash'}")
        return FileOutcome(CONFIG, HASHED, f"input: resolves to {RESOLVED}")

    def _load(self, place: Path) -> ExperimentConfig | None:
        """Load the configuration as given; None where it has own code or does not load from the archive alone."""
        if any(name.startswith(f"{COPIES}/") for name in self._names):
            return None
        # The configuration last, so that no data file takes its place.
        parts = {name: name.split("/", 2) for name in self._names}
        files = {name: each[2] for name, each in parts.items() if each[0] == DATA and len(each) > 2} | {CONFIG: CONFIG}
        try:
            for name, inside in files.items():
                (place / inside).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(self._directory / name, place / inside)
            return load_config(place / CONFIG, **_options(self._overrides), add_methods=added_in(place / CONFIG))
        except (ConfigError, ValueError, OSError):
            return None

    def _manifest(self, computed: Mapping[str, Any]) -> FileOutcome:
        """Compare the fields that follow from the configuration."""
        unknown = self._stated.keys() - {*COMPARED, *STATED, "numerics", "files"}
        wrong = [name for name in COMPARED if self._stated.get(name) != computed.get(name)]
        for name in (*wrong, *sorted(unknown)):
            shown = (ascii(data.get(name))[:50] for data in (self._stated, computed))
            return FileOutcome(manifest.FILE, DIFFERENT, f"{ascii(name)}: packed {next(shown)}, here {next(shown)}")
        note = f"{', '.join(COMPARED)} are compared; not {', '.join(STATED)}"
        return FileOutcome(manifest.FILE, HASHED, note)

    def _timed(self, results: Results) -> Results:
        """Return results with the durations of the archive."""
        file = self._directory / TIMINGS
        try:
            timings = dict(read_rows(file).items()) if file.is_file() else {}
            trials = with_timings(results.stored, timings)
        except (ValueError, KeyError, TypeError) as error:
            raise ArchiveError(f"{self._path}: {TIMINGS} cannot be read ({error})") from None
        return replace(results, durations=timings, stored=trials)

    def _name_files(self, resolved: Path, known: Collection[str]) -> None:
        """Write the configuration that the page shows, with data files as the packed directory named them."""
        shutil.copyfile(self._directory / RESOLVED, resolved)
        if names := {new: old for old, new in self._stated.get("files", {}).items()}:
            for new, old in names.items():
                if new not in known or not new.startswith(f"{DATA}/") or split_pattern(old)[1] != new.split("/", 2)[-1]:
                    text = f"{ascii(old[:60])} and {ascii(new[:60])} are not the names of one data file"
                    raise ArchiveError(f"{self._path}: manifest.json: files: {text}")
            resolved.write_bytes(dump(plain(renamed(plain(load(resolved)), names))).encode())

    def _metadata(self, results: Results) -> tuple[FileOutcome, FileOutcome]:
        """Compare the metadata of the crate and the citation with those of these results."""
        text, cited = (_text(self._directory / name) for name in (METADATA, CITATION))
        authors, licence = stated_by(checked(text.encode(), dict, any_text=True))
        files = {name: self._directory / name for name in sorted(self._names) if name not in (METADATA, VERIFIED)}
        facts = facts_of(results, self._stated, files, authors, licence)
        citing = compared_text(CITATION, cited, citation(facts))
        try:
            found = compared_text(METADATA, text, json_bytes(crate(facts)).decode())
        except ModuleNotFoundError:
            return FileOutcome(METADATA, UNSEEN, "needs the library rocrate"), citing
        if found.is_compared and citing.is_different:
            # Authors and licence stand in both.
            found = FileOutcome(METADATA, DIFFERENT, f"does not fit {CITATION}")
        return found, citing

    def _compared(self, name: str, made: Path) -> FileOutcome:
        """Compare a file with the one that was made, unless another version made it otherwise."""
        packed, here = self._directory / name, made / name
        if not here.is_file():
            return FileOutcome(name, DIFFERENT if name in FILES else UNSEEN, "is not made here")
        found = compared(name, packed, here, exact=self.exact)
        same_fonts = self._way.get("fonttools") == version("fonttools") and "font_tables" in self._way
        if found.is_different and name.endswith(".pdf") and not same_fonts and same_but_fonts(packed, here):
            return FileOutcome(name, UNSEEN, "the same drawing, its fonts embedded by another version")
        if not found.is_different or self.exact:
            return found
        bench, library = self._stated.get("versions", {}).get("rmpc-bench"), self._way.get("matplotlib")
        if name.startswith(("figures/", "report.")) and bench != rmpc_bench.__version__:
            return FileOutcome(name, f"not compared, made by rmpc-bench {bench}")
        if name.endswith(DRAWN) and library != version("matplotlib"):
            return FileOutcome(name, f"not compared, drawn by matplotlib {library}")
        return FileOutcome(name, UNSEEN, "drawn on another machine") if name.endswith(".png") else found


def _timings(packed: Columns, here: Columns) -> FileOutcome:
    """Compare what was timed, not the durations."""
    a, b = ([[*map(str, table[name])] for name in table if name not in DURATIONS] for table in (packed, here))
    same = [*packed] == [*here] and a == b if n_rows(packed) else not n_rows(here)
    note = f"all but {', '.join(DURATIONS)} are compared" if same else "other methods, components or phases"
    return FileOutcome(TIMINGS, HASHED if same else DIFFERENT, note)


def _text(file: Path) -> str:
    return file.read_text(encoding="utf-8", errors="replace") if file.is_file() else ""


def _options(overrides: Sequence[str]) -> dict[str, Any]:
    """Read the options of a command line that have changed a configuration.

    >>> _options(["-s 'runs=3'", "--runs 4", "--smoke"])
    {'overrides': ['runs=3'], 'runs': 4, 'smoke': True}
    """
    words = shlex.split(" ".join(overrides))
    pairs = [*pairwise(words)]
    runs = [int(value) for option, value in pairs if option == "--runs"]
    given = [value for option, value in pairs if option == "-s"]
    return {"overrides": given, "runs": runs[-1] if runs else None, "smoke": "--smoke" in words}


def _by_names(resolved: Mapping[str, Any], config: ExperimentConfig) -> str:
    """Write a resolved configuration with the files of a user as names without directories."""
    tree = plain(renamed(resolved, {text: Path(text).name for text in config.own.patterns}))
    for claim in tree.get("claims") or ():
        # What other configurations of a paper find is not in the archive.
        claim.pop("elsewhere", None)
    return re.sub(rf"{COPIES}/[0-9a-f]+/", "", dump(tree))
