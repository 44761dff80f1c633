"""Checks of references: signals that are known in advance and do not depend on the number of samples."""

from __future__ import annotations

import pickle
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from rmpc_bench.conformance.results import FROZEN, Check, require, require_same
from rmpc_bench.types import Reference


@dataclass(frozen=True)
class ReferenceExample:
    """Size of the signal that a reference is checked with.

    Parameters
    ----------
    ny : number of outputs
    n_samples : length of the signal
    """

    ny: int
    n_samples: int = 40
    checks: ClassVar[tuple[Check, ...]]


def _base_class(reference: Any, _: ReferenceExample) -> None:
    require(isinstance(reference, Reference), f"{type(reference).__name__} is not a subclass of Reference")


def _shapes(reference: Reference, example: ReferenceExample) -> None:
    r = reference.sample(example.n_samples)
    require(r.shape == (example.n_samples, example.ny), f"the signal has shape {r.shape}")
    require(r.dtype == np.float64, f"the signal is {r.dtype}, not float64")
    require(bool(np.isfinite(r).all()), "the signal is not finite")


def _prefix(reference: Reference, example: ReferenceExample) -> None:
    r = reference.sample(example.n_samples)
    for n_samples in (1, example.n_samples // 2):
        require_same("the beginning", reference.sample(n_samples), r[:n_samples])


def _purity(reference: Reference, example: ReferenceExample) -> None:
    first = reference.sample(example.n_samples)
    before = first.copy()
    first += 1.0  # what a caller does with the array must not reach the next one
    require_same("the second signal", reference.sample(example.n_samples), before)
    copy = pickle.loads(pickle.dumps(reference))
    require_same("the signal of the copy", copy.sample(example.n_samples), before)


ReferenceExample.checks = (
    Check("base-class", "the reference is a subclass of Reference", _base_class, is_first=True),
    FROZEN,
    Check("shapes", "the signal is (samples, ny) finite numbers", _shapes),
    Check("prefix", "a longer signal begins with the shorter one", _prefix),
    Check("purity", "every call returns the same bits in an array of its own; a copy made by pickle too", _purity),
)
