"""The machine and the versions of a verification, without names of hosts or users."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable, Iterator, Mapping
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import rmpc_bench
from rmpc_bench.execution import manifest
from rmpc_bench.execution.libraries import OF_THE_BENCH


def environment() -> dict[str, Any]:
    """Return date, machine and versions."""
    versions = {"rmpc-bench": rmpc_bench.__version__, "python": platform.python_version()}
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": {"system": platform.platform(), "machine": platform.machine(), "cores": os.cpu_count()},
        "versions": versions | {name: version(name) for name in OF_THE_BENCH},
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
        found = _version(name)
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


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"
