"""A valid configuration at one point of its sweep, with the hashes under which its trials are stored."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from rmpc_bench.config.code_version import code_version
from rmpc_bench.config.draft import DraftConfig
from rmpc_bench.simulation.scenario import Experiment
from rmpc_bench.types import DesignError
from rmpc_bench.types.errors import unknown


def digest(data: Any) -> str:
    """Return the SHA-256 of plain data, written as JSON with sorted keys."""
    return hashlib.sha256(json.dumps(data, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def key_of_trials(definition: str, code: Mapping[str, Any]) -> str:
    """Return the hash under which the trials of a method are stored."""
    return digest({"definition": definition, "code": code})


@dataclass(frozen=True, eq=False)
class SweepPoint:
    """A configuration at one point of its sweep; without a sweep there is one point.

    Parameters
    ----------
    coordinates : swept path -> text of its value; empty where nothing is swept
    title : the point in words
    experiment : all designs, ready to run
    shared : what all methods share, as plain data (identity.py)
    methods : method name -> what identifies the method, as plain data
    metrics : metric name -> what identifies the metric, as plain data
    own_code : method name -> what identifies the code that is not built in, as plain data; nothing where there is none
    modules : method name -> names of the installed modules that this code imports
    draft : the validated sections that all of this was made from
    """

    coordinates: Mapping[str, str]
    title: str
    experiment: Experiment
    shared: Mapping[str, Any]
    methods: Mapping[str, Any]
    metrics: Mapping[str, Any]
    own_code: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    modules: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    draft: DraftConfig | None = None

    @cached_property
    def experiment_hash(self) -> str:
        """Hash of what all methods share."""
        return digest(self.shared)

    @cached_property
    def definitions(self) -> dict[str, str]:
        """Hashes of what the configuration determines of the trials, by method: all but the code."""
        return {
            name: digest({"experiment": self.experiment_hash, "method": data}) for name, data in self.methods.items()
        }

    @cached_property
    def code(self) -> dict[str, dict[str, Any]]:
        """What identifies the code that computes the trials, by method."""
        here = code_version()
        return {name: {**here, **self.own_code.get(name, {})} for name in self.methods}

    @cached_property
    def method_keys(self) -> dict[str, str]:
        """Hashes under which trials are stored, by method: definition and code; points with equal ones share trials."""
        return {name: key_of_trials(key, self.code[name]) for name, key in self.definitions.items()}

    @cached_property
    def metric_keys(self) -> dict[str, str]:
        """Hashes under which metrics are stored, by metric; the name itself is not hashed."""
        return {name: digest({**data, "name": None}) for name, data in self.metrics.items()}

    @cached_property
    def uncertainty_key(self) -> str:
        """Hash under which the values of the uncertain quantities are stored; the code that draws them is in it."""
        law = self.shared["plant"].get("uncertainty", {})
        # The plant itself draws these values, once per run.
        own = {"plant": law} if law.get("per") == "run" else {}
        # Random bursts of the noise are uncertain quantities too; they begin and end on samples.
        if self.experiment.scenario.burst_names:
            own |= {"noise": self.shared["noise"], "step": self.shared["time"]["step"]}
        # A plant or a noise from a file draws values itself.
        own |= {"files": self.shared["code"]} if "code" in self.shared else {}
        return digest({key: self.shared[key] for key in ("seed", "uncertainty")} | own | {"code": code_version()})


def chosen_point(points: Sequence[SweepPoint], at: Mapping[str, str]) -> SweepPoint:
    """Return the first point of a sweep with given values."""
    for path in at:
        if path not in points[0].coordinates:
            raise DesignError(unknown(path, points[0].coordinates, "path of the sweep"), "at")
    found = [point for point in points if all(point.coordinates[path] == value for path, value in at.items())]
    if not found:
        titles = "; ".join(point.title for point in points[:5])
        raise DesignError(f"there is no such point of the sweep; the first ones are {titles}", "at")
    return found[0]
