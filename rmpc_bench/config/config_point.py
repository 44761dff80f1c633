"""A configuration at one point of its sweep, and the hashes under which its trials are stored."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from rmpc_bench.simulation.scenario import Experiment


def digest(data: Any) -> str:
    """SHA-256 of plain data in a canonical form."""
    return hashlib.sha256(json.dumps(data, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


@dataclass(frozen=True, eq=False)
class ConfigPoint:
    """A configuration at one point of its sweep.

    Parameters
    ----------
    coordinates : path -> text of the value; empty where nothing is swept
    title : the point in words
    experiment : all designs, ready to run
    shared : what all methods share, as plain data
    methods : what each method is, as plain data
    metrics : what each metric is, as plain data
    """

    coordinates: Mapping[str, str]
    title: str
    experiment: Experiment
    shared: Mapping[str, Any]
    methods: Mapping[str, Any]
    metrics: Mapping[str, Any]

    @cached_property
    def truth(self) -> str:
        """Hash of what all methods share."""
        return digest(self.shared)

    @cached_property
    def method_keys(self) -> dict[str, str]:
        """Hashes under which trials are stored: points that agree on a method and on the truth share them."""
        return {name: digest({"truth": self.truth, "method": keys}) for name, keys in self.methods.items()}

    @cached_property
    def metric_keys(self) -> dict[str, str]:
        """Hashes under which metrics are stored; a new name alone makes no new metric."""
        return {name: digest({**keys, "name": None}) for name, keys in self.metrics.items()}

    @cached_property
    def uncertainty_key(self) -> str:
        """Hash under which the named uncertain values are stored."""
        law = self.shared["plant"].get("uncertainty", {})
        own = {"plant": law} if law.get("per") == "run" else {}  # values that the plant draws for a run
        if self.experiment.scenario.burst_names:  # those of the noise; bursts begin and end on samples
            own |= {"noise": self.shared["noise"], "step": self.shared["time"]["step"]}
        return digest({key: self.shared[key] for key in ("seed", "uncertainty")} | own)
