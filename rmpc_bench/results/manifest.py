"""manifest.json: versions, machine and times of the computation of an experiment."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import rmpc_bench
from rmpc_bench.analysis.levels import Look
from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.config.identity import code_version
from rmpc_bench.installed import version_of
from rmpc_bench.received.consent import commit_of
from rmpc_bench.received.names import wrong_line
from rmpc_bench.received.plain_files import MANIFEST, StoreError, json_of
from rmpc_bench.received.store import FILE as STORE
from rmpc_bench.received.store import MissingError, OccupiedError
from rmpc_bench.replaced_file import replace_text
from rmpc_bench.results.other_code import OF_THE_BENCH, all_versions
from rmpc_bench.store.store import Store

FILE = "manifest.json"


@contextmanager
def session(
    directory: Path, config: ExperimentConfig, modified: Collection[str], say: Callable[[str], None]
) -> Iterator[None]:
    """Record one session of computing an experiment: its start, its end and the reason."""
    data = _started(directory, config, modified, say)
    write(directory / FILE, data)
    why = "finished"
    try:
        yield
    except BaseException as error:
        why = type(error).__name__
        raise
    finally:
        data["sessions"][-1] |= {"stop": _now(), "why": why}
        # A report that another process has written meanwhile has noted its looks and its way.
        now = read(directory)
        write(directory / FILE, data | {key: now[key] for key in ("looks", "report") if key in now})


def _started(
    directory: Path, config: ExperimentConfig, modified: Collection[str], say: Callable[[str], None]
) -> dict[str, Any]:
    """Return the manifest at the start of a session; what earlier ones have computed otherwise is said."""
    before = read(directory)
    versions = {"rmpc-bench": rmpc_bench.__version__, "python": platform.python_version()}
    versions |= {name: version_of(name) for name in OF_THE_BENCH}
    libraries = all_versions(config)
    changed = {name: text for name, text in before.get("versions", {}).items() if versions.get(name) != text}
    # A library that is not used any more has computed no trial of this configuration.
    earlier = before.get("libraries", {})
    changed |= {name: text for name, text in earlier.items() if libraries.get(name, text) != text}
    if changed:
        there = ", ".join(f"{name} {text}" for name, text in changed.items())
        say(f"some trials were computed with {there}; last digits may differ (--fresh computes all again)")
    return {
        "name": config.name,
        "experiment": config.hash,
        "seed": config.experiment.scenario.seed,
        "modified": [*modified],
        "versions": versions,
        **({"libraries": libraries} if libraries else {}),
        **code_version(),
        "blas": blas(),
        "git": commit_of(config.path.parent),
        "platform": {"system": platform.platform(), "machine": platform.machine(), "cores": os.cpu_count()},
        "file": _file_of(config),
        "looks": looks_of_manifest(directory),
        **({"report": before["report"]} if "report" in before else {}),
        "sessions": [*before.get("sessions", []), {"start": _now(), "stop": None, "why": "running"}],
    }


def read(directory: Path) -> dict[str, Any]:
    """Return the manifest of a directory; empty where there is none."""
    found: dict[str, Any] = json_of(directory / FILE, MANIFEST, "remove the file, and `rmpc-bench run` writes it") or {}
    return found


def looks_of_manifest(directory: Path) -> list[Look]:
    """Return the looks at which verdicts were published, in the order of time, as a manifest has them."""
    found: list[Look] = read(directory).get("looks", [])
    return found


def looks_of_store(store: Store) -> list[Look]:
    """Return the looks that a store has, then those of the manifest beside it: an earlier version kept them there."""
    return [*dict.fromkeys([*store.data("looks").get("runs", []), *looks_of_manifest(store.directory)])]


def keep_looks(store: Store, runs: Sequence[Look]) -> None:
    """Keep looks in a store, where they stay when the manifest is lost."""
    if runs and store.data("looks").get("runs", []) != [*runs]:
        store.set_meta("looks", json.dumps({"runs": [*runs]}))


def remaining_looks(directory: Path, experiment: str) -> list[Look]:
    """Return what is left of the looks of an experiment in a directory whose files may be damaged."""
    found = list[Look]()
    with suppress(StoreError, MissingError), Store(directory, writable=False) as store:
        found += store.data("looks").get("runs", []) if store.meta("experiment") == experiment else []
    with suppress(StoreError):
        found += looks_of_manifest(directory) if read(directory).get("experiment") == experiment else []
    return [*dict.fromkeys(found)]


def note_look(directory: Path, look: Look) -> None:
    """Note in store and manifest that verdicts were published."""
    found = [*dict.fromkeys([*looks_of_manifest(directory), look])]
    if (directory / STORE).exists() and not (directory / STORE).is_symlink():
        # While another process writes to the store, or where it lies elsewhere, the manifest alone keeps them.
        with suppress(OccupiedError), Store(directory) as store:
            found = [*dict.fromkeys([*looks_of_store(store), look])]
            keep_looks(store, found)
    data = read(directory)
    if data and data.get("looks") != found:
        write(directory / FILE, data | {"looks": found})


def note_report(directory: Path, made: Mapping[str, Any]) -> None:
    """Note how the derived files of a directory were made; `verify` makes them again in the same way."""
    data = read(directory)
    if data and data.get("report") != made:
        write(directory / FILE, data | {"report": dict(made)})


def join(directory: Path, shards: Mapping[str, Path]) -> list[str]:
    """Write the manifest of a directory from those of its shards; its own sessions and looks are kept."""
    here, parts = read(directory), {name: read(place) for name, place in shards.items()}
    first = next((part for part in parts.values() if part), {})
    own = [session for session in here.get("sessions", []) if session.get("shard") not in shards]
    of_shards = [{"shard": name} | session for name, part in parts.items() for session in part.get("sessions", [])]
    write(directory / FILE, {**first, **here, "looks": looks_of_manifest(directory), "sessions": [*own, *of_shards]})
    found: dict[str, dict[str, list[str]]] = {}
    for name, part in (({"the directory": here} if own else {}) | parts).items():
        for library, text in (part.get("versions", {}) | part.get("libraries", {})).items():
            found.setdefault(library, {}).setdefault(text, []).append(name)
    return [
        "the shards were computed with different versions; last digits may differ: "
        + ", ".join(f"{library} {text} ({names[0]})" for text, names in versions.items())
        for library, versions in found.items()
        if len(versions) > 1
    ]


def write(path: Path, data: dict[str, Any]) -> None:
    """Replace a manifest."""
    replace_text(path, json.dumps(data, indent=2) + "\n")


def relative_to_cwd(path: Path) -> str:
    """Return a path relative to the current directory; empty where it lies elsewhere."""
    here, path = Path.cwd().resolve(), path.resolve()
    return path.relative_to(here).as_posix() if path.is_relative_to(here) and path != here else ""


def _file_of(config: ExperimentConfig) -> str:
    """Return the file of a configuration from the current directory; empty where there is none, or elsewhere."""
    name = relative_to_cwd(config.path) if config.content is None else ""
    return ascii(name) if wrong_line(name) else name


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def blas() -> list[dict[str, Any]]:
    """Return the libraries of linear algebra that are loaded, each with the processor for which it computes."""
    from threadpoolctl import threadpool_info

    wanted = ("user_api", "internal_api", "version", "architecture")
    return [{key: info.get(key) for key in wanted} for info in threadpool_info()]
