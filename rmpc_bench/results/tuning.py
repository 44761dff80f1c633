"""tuning.json: what tuning has tried and chosen, by the key of each search.

It is kept beside the tables of the results: a search whose key is in it is not made again, also where no trial is
stored.  Its numbers have six digits and do not depend on the machine; times are in a file of their own.

Without regret the single tuning runs are needed for the chosen value only.  The other values then have their objective
in place of their runs, which keeps the record of a large suite small.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from rmpc_bench.received import plain_files
from rmpc_bench.received.plain_files import TUNING, DamagedError, json_of, text_of
from rmpc_bench.replaced_file import replace_text
from rmpc_bench.types import Array
from rmpc_bench.types.result_layout import SHARDS
from rmpc_bench.types.tuning import TunedParameter, Tuning, TuningProtocol, TuningSearch

if TYPE_CHECKING:
    from rmpc_bench.config.experiment_config import TuningPlan
    from rmpc_bench.results.record import StoredExperiment


FILE = "tuning.json"
FOLDER = "tuning"
"""Directory of the trials of tuning, below that of the results."""
SECONDS = "seconds.json"
"""File in it: key of a search -> computing time of its trials [s]."""
MAX_BYTES = 500_000_000
_VERSION = 1


@dataclass(frozen=True, eq=False)
class Found(TuningSearch):
    """What a search has found; equal methods and points share it, and point and protocol are those of its use."""

    tested: str = ""  # what identifies the runs of ``test``; empty without them
    is_short: bool = False  # whether the rows of ``tuning`` but for the chosen one hold the objective at all runs


ANY_USE: dict[str, Any] = {"point": "", "protocol": TuningProtocol(0, 0, "")}
"""Fields of a search before its use."""


def read_record(directory: Path) -> dict[str, Found]:
    """Return key of a search -> what it has found, of a directory and of the shards in it."""
    found: dict[str, Found] = {}
    places = sorted((directory / SHARDS).glob(f"*/{FILE}")) if (directory / SHARDS).is_dir() else []
    for path in [*places, directory / FILE]:
        if path.is_file():
            found |= _read(path)
    return found


def _read(path: Path) -> dict[str, Found]:
    way_out = "remove the file, and `rmpc-bench run` tunes again"
    data = json_of(path, TUNING, way_out, MAX_BYTES) or {"version": None}
    try:
        if data["version"] != _VERSION:
            raise ValueError("another version of the bench has written it")
        return {str(key): _found(entry) for key, entry in data["searches"].items()}
    except (ArithmeticError, ValueError, LookupError, TypeError, AttributeError) as error:
        raise DamagedError(f"{path}: is no record of a tuning ({error}); {way_out}") from None


def _found(entry: Mapping[str, Any]) -> Found:
    parameters = tuple(TunedParameter(**each) for each in entry["parameters"])
    candidates = np.array(entry["candidates"], dtype=float).reshape(-1, len(parameters))
    chosen, test, is_short = entry["chosen"], entry.get("test"), "objectives" in entry
    tuning, stages = _matrix(entry["tuning"]), tuple(map(str, entry["stages"]))
    if is_short:
        own = tuning[0]
        tuning = np.repeat(_matrix([entry["objectives"]]).T, len(own), axis=1)
        tuning[chosen or 0] = own
    if not (0 <= int(chosen or 0) < len(candidates) == len(stages) == len(tuning)):
        raise ValueError("its lists differ in length")
    values = None if test is None else _matrix(test["values"])
    if values is not None and len(values) != len(candidates) + 1:
        raise ValueError("its lists differ in length")
    return Found(
        **ANY_USE,
        method=str(entry["method"]),
        parameters=parameters,
        default=tuple(None if each is None else float(each) for each in entry["default"]),
        candidates=candidates,
        stages=stages,
        tuning=tuning,
        test=values,
        chosen=None if chosen is None else int(chosen),
        tested="" if test is None else str(test["key"]),
        is_short=is_short,
    )


def _matrix(rows: Sequence[Sequence[float | None]]) -> Array:
    return np.array([[math.nan if value is None else value for value in row] for row in rows], dtype=float)


def write_record(directory: Path, plan: TuningPlan, found: Mapping[str, Found]) -> None:
    """Write the record of a directory; searches that the configuration does not have any more are left out."""
    wanted = {search.key: None for search in plan.searches if search.key in found}
    entries = [
        f'  "{key}": {_entry(found[key], None if plan.regret or found[key].test is not None else plan.protocol)}'
        for key in wanted
    ]
    head = json.dumps({"version": _VERSION, "protocol": vars(plan.protocol)})[:-1]
    text = f'{head}, "searches": {{\n' + ",\n".join(entries) + "\n}}\n"
    path = directory / FILE
    if not path.is_file() or text_of(path, MAX_BYTES) != text:
        replace_text(path, text)


def _entry(found: Found, of_objectives: TuningProtocol | None) -> str:
    """Write what a search has found with a line for every value, so that differences are short."""
    # With a protocol the objectives take the place of the runs, but for those of the chosen value.
    head: dict[str, Any] = {
        "method": found.method,
        "parameters": [vars(each) for each in found.parameters],
        "default": found.default,
        "chosen": found.chosen,
        "stages": found.stages,
        "candidates": found.candidates.tolist(),
    }
    tuning = found.tuning
    if of_objectives is not None:
        objectives = [float(f"{value:.6g}") for value in of_objectives.objective(tuning)]
        head["objectives"] = [value if math.isfinite(value) else None for value in objectives]
        tuning = tuning[[found.chosen or 0]]
    parts = [json.dumps(head)[1:-1], f'"tuning": {_rows(tuning)}']
    if found.test is not None:
        parts.append(f'"test": {{"key": "{found.tested}", "values": {_rows(found.test)}}}')
    return "{" + ",\n   ".join(parts) + "}"


def _rows(values: Float[Array, "n runs"]) -> str:
    rows = [json.dumps([None if math.isnan(value) else value for value in row]) for row in values.tolist()]
    return "[\n    " + ",\n    ".join(rows) + "]"


def read_seconds(directory: Path) -> dict[str, float]:
    """Return key of a search -> computing time of its trials [s]; empty where it is not known."""
    found: dict[str, float] = json_of(directory / FOLDER / SECONDS, plain_files.SECONDS, "remove the file") or {}
    return found


def add_seconds(directory: Path, seconds: Mapping[str, float]) -> None:
    """Add computing times to those that are noted."""
    noted = read_seconds(directory)
    noted |= {key: round(noted.get(key, 0.0) + value, 3) for key, value in seconds.items()}
    replace_text(directory / FOLDER / SECONDS, json.dumps(noted, indent=1) + "\n")


def tuning_of(experiment: StoredExperiment, directory: Path) -> Tuning | None:
    """Return the searches that tuning.json has, None where nothing is tuned; a StoreError for a damaged file."""
    stored = experiment.tuning
    if stored is None:
        return None
    found, seconds = read_record(directory), read_seconds(directory)
    searches = [
        replace(
            found[key], point=point, method=method, key=key, protocol=stored.protocol, seconds=seconds.get(key, 0.0)
        )
        for point, method, key in stored.searches
        if key in found
    ]
    return Tuning(stored.protocol, tuple(searches), experiment.origins)
