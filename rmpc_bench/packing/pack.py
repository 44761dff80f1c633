"""Pack the results of an experiment into one file that somebody else can check: an RO-Crate.

It contains what a reader needs and what `verify` needs: the configuration with the user's files, the rows, the tables,
the report, and for every file its hash.  The trial store stays out, since trials.csv has its content: it is written
from the store where the report leaves it out.
"""

from __future__ import annotations

import hashlib
import io
import os
import shlex
import stat
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from filecmp import cmp
from glob import escape, glob, has_magic
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rmpc_bench.analysis.columns import n_rows
from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.config.load import load_config
from rmpc_bench.config.own_code import renamed
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import dump, load
from rmpc_bench.packing.metadata import CITATION, Contents, citation, crate
from rmpc_bench.publishing.publish import choose
from rmpc_bench.received.archive import METADATA, ArchiveError, json_bytes, write_archive
from rmpc_bench.received.consent import VERIFIED
from rmpc_bench.report.point_tables import summary_table, trials_csv, write_csv
from rmpc_bench.results import manifest
from rmpc_bench.results.evaluate import summarise
from rmpc_bench.results.results import Results, read_results
from rmpc_bench.results.tuning import FOLDER
from rmpc_bench.results.tuning import SECONDS as TIMES
from rmpc_bench.types import DesignError
from rmpc_bench.types.errors import check_arguments
from rmpc_bench.types.result_layout import CONFIG, COPIES, RESOLVED

DATA = "data"  # directory of the user's data files in an archive
SECONDS = f"{FOLDER}/{TIMES}"
ROWS = "trials.csv"  # the rows of all runs, which an archive has in any case
NEEDED = (CONFIG, RESOLVED, manifest.FILE, ROWS, "summary.csv", "comparisons.csv", "report.html")
"""Files without which a directory is not packed."""
FILES = (
    *NEEDED,
    *("uncertainty.csv", "series.csv", "traces.npz", "timings.csv", "drivers.csv", "requirements.csv", "ranks.csv"),
    "calibration.csv",
    *("lost.csv", "two-way.csv", "tuning.csv", "tuning.json", SECONDS, "claims.json", "claims.md", "report.md"),
)  # files of a directory that are packed where they exist; nothing else at its top is
SOURCES = ("source.csv.gz", "source.parquet")  # the table of runs that were made elsewhere
FOLDERS = ("tables", "figures", "failures", COPIES)  # directories of which all files are packed


@dataclass(frozen=True)
class Pack:
    """A written archive.

    Parameters
    ----------
    path : the file
    files : names of the packed files
    n_bytes : size of the archive
    remarks : what a reader of the archive should know, such as missing runs
    """

    path: Path
    files: tuple[str, ...]
    n_bytes: int
    remarks: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.path}: {len(self.files)} files, {self.n_bytes / 1e6:.2f} MB"


def pack(directory: str | Path, to: str | Path, *, authors: Sequence[str] = (), licence: str = "") -> Pack:
    """Write an archive with the results of an experiment; equal results give equal bytes.

    Parameters
    ----------
    directory : of the results, with its report
    to : the archive, replaced if it exists
    authors : names of the authors
    licence : SPDX identifier of the licence, such as ``CC-BY-4.0``; none is stated unless given

    Raises
    ------
    MissingError
        If no trial is stored.
    ArchiveError
        If a file is missing, is older than the stored trials, or is a symbolic link, or a component stands in
        a program or a notebook.
    ConfigError
        If the stored configuration does not load.
    ModuleNotFoundError
        If the library rocrate is not installed.

    Examples
    --------
    >>> import rmpc_bench, tempfile
    >>> directory = tempfile.mkdtemp()
    >>> config = rmpc_bench.load_config("configs/quickstart.yaml", runs=4)
    >>> _ = rmpc_bench.publish(rmpc_bench.run(config, directory=directory, jobs=1))
    >>> pack(directory, f"{directory}/quickstart.zip").files[:2]
    ('CITATION.cff', 'comparisons.csv')
    """
    check_arguments(pack, locals())
    place = Path(directory)
    results = read_results(place)
    # First: a pipe in place of a file would never end.
    contents: dict[str, Path | bytes] = dict(_files(place))
    with TemporaryDirectory() as temporary:
        contents[ROWS] = _checked_rows(results, place, Path(temporary))
        return _packed(results, place, contents, Path(to), (authors, licence))


def _packed(
    results: Results, place: Path, contents: dict[str, Path | bytes], target: Path, stated_by: tuple[Sequence[str], str]
) -> Pack:
    """Write an archive with the files of a directory, its data files, citation and metadata."""
    if results.experiment.imported is None:
        contents |= _loaded_files(results, place, contents)
    facts = facts_of(results, manifest.read(place), contents, *stated_by)
    contents[CITATION] = citation(facts).encode()
    hashes = {**facts.hashes, CITATION: _hash_and_size(contents[CITATION])}
    facts = facts._replace(hashes=dict(sorted(hashes.items())))
    contents |= {VERIFIED: json_bytes([]), METADATA: json_bytes(crate(facts))}
    write_archive(target, contents)
    remarks = [f"incomplete: {text}" for text in results.incomplete]
    remarks += [results.other_code] if results.other_code else []
    return Pack(target, tuple(facts.hashes), target.stat().st_size, tuple(remarks))


def _loaded_files(results: Results, place: Path, contents: Mapping[str, Path | bytes]) -> dict[str, Path | bytes]:
    """Return what the configuration, which must load, needs besides the files of the directory."""
    config = load_config(place / RESOLVED, lenient=True)
    if config.hash != results.experiment.hash:
        raise ArchiveError(f"{place}: {RESOLVED} describes another experiment than the stored trials")
    if config.own.of_program:
        names = ", ".join(sorted(config.own.of_program))
        why = "stands in a program or a notebook, so nobody could compute the trials again"
        raise ArchiveError(f"{place}: {names} {why}; write it to a file, and name it as `file: FILE.py:NAME`")
    return _data_files(config, contents)


def facts_of(
    results: Results,
    stated: Mapping[str, Any],
    contents: Mapping[str, Path | bytes],
    authors: Sequence[str],
    licence: str,
) -> Contents:
    """Return what the metadata and the citation of an archive with these contents are made from."""
    return Contents(
        experiment=results.experiment,
        manifest=stated,
        n_runs=len(results.trials.each[0].runs),
        incomplete=results.incomplete,
        hashes={name: _hash_and_size(content) for name, content in sorted(contents.items())},
        authors=tuple(authors),
        licence=licence,
    )


def _checked_rows(results: Results, directory: Path, temporary: Path) -> Path:
    """Write the stored rows, and refuse a directory of which files are missing or belong to other trials."""
    # Where the report leaves out trials.csv, summary.csv shows which trials the files belong to.
    way_out = f"`rmpc-bench report {shlex.quote(str(directory))}` writes it again"
    report = chosen(results, manifest.read(directory).get("report", {}), directory).experiment.report
    has_rows = report.writes_trials(n_rows(results.stored.columns))
    for name in NEEDED:
        if name == RESOLVED and results.experiment.imported:
            continue
        if (has_rows or name != ROWS) and not (directory / name).exists():
            raise ArchiveError(f"{directory}: there is no {name}; {way_out}")
    trials_csv(results.stored, temporary / ROWS)
    name = ROWS if (directory / ROWS).exists() else "summary.csv"
    if name != ROWS:
        tables = summarise(results).shown(report.order, report.metrics)
        write_csv(summary_table(tables.described_columns), temporary / name)
    if not cmp(temporary / name, directory / name, shallow=False):
        raise ArchiveError(f"{directory}: {name} differs from the stored trials; {way_out}")
    return temporary / ROWS


def chosen(results: Results, way: Mapping[str, Any], path: Path) -> Results:
    """Return results with the stated keys of the report; LaTeX, which PGF needs, does not run here."""
    try:
        keys = dict(way.get("keys", {}))
        given = keys.get("format", results.experiment.report.formats)
        kept = [each for each in ([given] if isinstance(given, str) else given) if each != "pgf"]
        return choose(results, **keys | {"format": kept or ["svg"]})
    except (DesignError, TypeError, ValueError, AttributeError) as error:
        raise ArchiveError(f"{path}: manifest.json: report: cannot be made as it says ({error})") from None


def _files(directory: Path) -> Iterator[tuple[str, Path]]:
    """Yield the files to pack with their names; content that is no regular file would come from elsewhere."""
    named = [directory / name for name in (*FILES, *SOURCES) if (directory / name).exists()]
    for folder in FOLDERS:
        top = directory / folder
        if top.is_symlink():
            raise ArchiveError(f"{top}: is a symbolic link")
        for parent, folders, files in os.walk(top):
            folders[:] = sorted(name for name in folders if name != "__pycache__")
            named += [Path(parent) / name for name in sorted(files) if not name.startswith(".")]
    for path in named:
        if not stat.S_ISREG(path.lstat().st_mode):
            raise ArchiveError(f"{path}: is no regular file")
        if not path.resolve().is_relative_to(directory.resolve()):
            raise ArchiveError(f"{path}: lies outside of {directory}, through a symbolic link")
        yield path.relative_to(directory).as_posix(), path


def _data_files(config: ExperimentConfig, contents: Mapping[str, Path | bytes]) -> dict[str, Path | bytes]:
    """Return the data files of the user, and a resolved configuration and a manifest that name them in the archive."""
    found: dict[str, Path | bytes] = {}
    names: dict[str, str] = {}
    base = config.own.access.base("")
    for number, text in enumerate(sorted(config.own.patterns)):
        start, rest = split_pattern(text)
        if text in contents:
            continue
        names[text] = f"{DATA}/{number}/{rest}"
        for path in _matching(base, start, rest):
            inside = path.relative_to(Path(os.path.normpath(base / start))).as_posix()
            # The content, also where the name is a link.
            found[f"{DATA}/{number}/{inside}"] = path.resolve()
    if names:
        found[RESOLVED] = dump(plain(renamed(plain(load(config.path)), names))).encode()
        # The page has the configuration with its names in the directory, and `verify` makes the page again.
        found[manifest.FILE] = json_bytes(manifest.read(config.path.parent) | {"files": names})
    return found


def split_pattern(text: str) -> tuple[str, str]:
    """Split a path or pattern into the directory before the first wildcard and the rest, which has a name.

    >>> split_pattern("../logs/2024-*/run.csv"), split_pattern("pump.csv")
    (('../logs', '2024-*/run.csv'), ('', 'pump.csv'))
    """
    parts = Path(text).parts
    first = next((i for i, part in enumerate(parts) if has_magic(part)), len(parts) - 1)
    return Path(*parts[:first]).as_posix() if first else "", Path(*parts[first:]).as_posix()


def _matching(base: Path, start: str, rest: str) -> list[Path]:
    """Return the files of a pattern by their own names, as the configuration orders them."""
    directory = Path(os.path.normpath(base / start))
    if has_magic(rest) and not (directory / rest).exists():
        return sorted(Path(each) for each in glob(os.path.join(escape(str(directory)), rest), recursive=True))
    return [directory / rest]


def _hash_and_size(content: Path | bytes) -> tuple[str, int]:
    if isinstance(content, bytes):
        return hashlib.file_digest(io.BytesIO(content), "sha256").hexdigest(), len(content)
    with content.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest(), content.stat().st_size
