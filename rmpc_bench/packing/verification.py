"""The outcome of a verification as a record and as text, and the machine and versions it was found with."""

from __future__ import annotations

import os
import platform
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import rmpc_bench
from rmpc_bench.analysis.trial_differences import TrialDifferences
from rmpc_bench.installed import version_of
from rmpc_bench.packing.comparison import BYTES, NUMBERS, FileOutcome
from rmpc_bench.results import manifest
from rmpc_bench.results.other_code import OF_THE_BENCH

MOST_LINES = 10  # differences of one kind that are named; the rest is counted


@dataclass(frozen=True)
class Verification:
    """What a verification has compared, and what differs.

    Parameters
    ----------
    scope : what was computed, in words
    path : the archive
    hashes : files with another content than the packed one, files that are missing or were added
    versions : what differs between the two environments; it is no difference of the results
    remarks : what a reader should know besides, such as how little was computed
    trials : differences of statuses and metrics; None where nothing was computed
    digits : numbers of summary.csv that do not follow from the rows, where nothing was computed
    findings : differences of a claim that was computed alone
    files : what was found about every file
    n_claims : claims that were computed alone
    """

    scope: str = ""
    path: Path = Path()
    hashes: tuple[str, ...] = ()
    versions: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    trials: TrialDifferences | None = None
    digits: tuple[str, ...] = ()
    findings: tuple[str, ...] = ()
    files: tuple[FileOutcome, ...] = ()
    n_claims: int = 0

    @property
    def differences(self) -> tuple[str, ...]:
        """Everything that differs, one text each."""
        return tuple(text for _, texts in self._sections() for text in texts)

    @property
    def reproduced(self) -> bool:
        """Whether nothing differs."""
        return not self.differences

    @property
    def result(self) -> str:
        """One word for the outcome."""
        if not self.reproduced:
            return "different"
        return "reproduced" if self.trials is not None else "unchanged"

    def record(self) -> dict[str, Any]:
        """Return the outcome as plain data, for the archive."""
        trials = self.trials
        counts = {"trials": trials.n_trials, "values": trials.n_values} if trials else {}
        relative = [each.relative.size for each in trials.values] if trials else []
        return {
            "scope": self.scope,
            "result": self.result,
            "compared": counts | {"files": sum(each.is_compared for each in self.files)},
            "files": {each.name: str(each) for each in self.files},
            "largest_relative_difference": max(relative, default=None),
            "n_differences": len(self.differences),
            "differences": list(self.differences[:MOST_LINES]),
        }

    def _sections(self) -> Iterator[tuple[str, Sequence[str]]]:
        yield "hashes", self.hashes
        if self.trials is not None:
            statuses = [(_where(each.point, each.method), each) for each in self.trials.statuses]
            yield "statuses", [f"{where} run {each.run}: packed {each.a}, here {each.b}" for where, each in statuses]
            yield "metrics", _metrics(self.trials)
            yield "rows", _alone(self.trials)
        yield "numbers of summary.csv", self.digits
        yield "findings", self.findings
        yield "files that differ", [f"{each.name}: {each.note}" for each in self.files if each.is_different]

    def __str__(self) -> str:
        # With escapes in place of what would end a line or is not seen.
        return "\n".join("".join(c if c.isprintable() else ascii(c)[1:-1] for c in line) for line in self._lines())

    def _lines(self) -> Iterator[str]:
        yield f"{self.path}: {self.result}   {self.scope}"
        for title, texts in (("other versions", self.versions), ("note", self.remarks), *self._sections()):
            if texts:
                yield from ("", title, *(f"  {text}" for text in texts[:MOST_LINES]))
                if len(texts) > MOST_LINES:
                    yield f"  and {len(texts) - MOST_LINES} more"
        yield from ("", self._compared(), self._counted())
        # Where nothing was computed, all files have the same word.
        others = [each for each in self.files if not each.is_compared and self.trials is not None]
        for word in dict.fromkeys(each.word for each in others if not each.is_different):
            yield from ("", word)
            yield from (f"  {each.name}" + f"   {each.note}" * bool(each.note) for each in others if each.word == word)

    def _compared(self) -> str:
        """Say which numbers were compared and by which rule."""
        trials = self.trials
        if trials is None:
            return "compared: the hash of every file, and summary.csv with the rows in trials.csv"
        parts = [f"{trials.n_trials} statuses", f"{trials.n_values} values of metrics ({_largest(trials)})"]
        parts += [f"{self.n_claims} claim{'' if self.n_claims == 1 else 's'}"] if self.n_claims else []
        return f"compared: {', '.join(parts)}"

    def _counted(self) -> str:
        """Count the files by what was found about them."""
        counts = Counter(each.word for each in self.files)
        words = [BYTES, NUMBERS, *sorted({*counts} - {BYTES, NUMBERS})]
        return f"{len(self.files)} files: " + "; ".join(f"{counts[word]} {word}" for word in words if counts[word])


def _largest(trials: TrialDifferences) -> str:
    """Say how large the largest difference is, also where it is allowed."""
    size = max((each.relative.size for each in trials.values), default=0.0)
    return f"largest relative difference {size:.2g}, allowed {trials.tolerance:g}" if size else "all equal"


def _where(point: str, method: str) -> str:
    return f"{point}: {method}" if point else method


def _metrics(trials: TrialDifferences) -> list[str]:
    """Name every metric that differs, with the run of the largest difference."""
    found = []
    for each in trials.differing:
        first = each.apart if each.n_apart else each.relative
        found.append(
            f"{_where(each.point, each.method)} {each.metric}: {each.n_differ} of {each.n} runs, "
            f"run {first.run}: packed {first.a!r}, here {first.b!r}"
        )
    return found


def _alone(trials: TrialDifferences) -> list[str]:
    """Name what was packed and does not come out here."""
    packed = {"method": trials.methods[0], "metric": trials.metrics[0], "point": trials.points[0]}
    found = [f"{noun} {name}: is packed only" for noun, names in packed.items() for name in names]
    found += [f"metric {name}: is computed only here" for name in trials.metrics[1]]
    found += [f"point {name}: is computed only here" for name in trials.points[1]]
    for each in trials.runs:
        runs = ", ".join(map(str, each.runs_b[:MOST_LINES]))
        found.append(f"{_where(each.point, each.method)}: {len(each.runs_b)} runs are computed only here ({runs})")
    return found


def environment() -> dict[str, Any]:
    """Return date, machine and versions."""
    versions = {"rmpc-bench": rmpc_bench.__version__, "python": platform.python_version()}
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": {"system": platform.platform(), "machine": platform.machine(), "cores": os.cpu_count()},
        "versions": versions | {name: version_of(name) for name in OF_THE_BENCH},
        "numerics": rmpc_bench.NUMERICS,
    }


def other_versions(packed: Mapping[str, Any]) -> Iterator[str]:
    """Yield what differs between the environment that a manifest states and this one."""
    here = environment()
    before = dict(packed.get("versions", {}))
    for name, text in before.items():
        if name in here["versions"] and here["versions"][name] != text:
            yield f"{name}: packed {text}, here {here['versions'][name]}"
    for name, text in dict(packed.get("libraries", {})).items():
        found = version_of(name) or "not installed"
        if found != text:
            yield f"{name}: packed {text}, here {found}"
    if packed.get("numerics") != rmpc_bench.NUMERICS:
        yield f"arithmetic (NUMERICS): packed {packed.get('numerics')}, here {rmpc_bench.NUMERICS}"
    # Another kind of processor computes other last digits.
    kinds, there = _processors(packed.get("blas", [])), _processors(manifest.blas())
    if kinds and there and not kinds & there:
        yield f"processor: packed {', '.join(sorted(kinds))}, here {', '.join(sorted(there))}"
    system, machine = (str(packed.get("platform", {}).get(key)) for key in ("system", "machine"))
    if (system, machine) != (here["machine"]["system"], here["machine"]["machine"]):
        yield f"machine: packed {system} {machine}, here {here['machine']['system']} {here['machine']['machine']}"


def _processors(infos: Iterable[Mapping[str, Any]]) -> set[str]:
    return {str(info["architecture"]) for info in infos if info.get("architecture")}
