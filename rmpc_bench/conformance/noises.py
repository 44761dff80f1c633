"""Checks of noise laws: draws depend on the generator only and have the stated moments."""

from __future__ import annotations

import pickle
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from rmpc_bench.conformance.results import FROZEN, Check, require, require_same
from rmpc_bench.types import Array, Noise

MOST_ERRORS = 5.0
"""Standard errors that a mean over draws may be away from its expectation: once in 1.7 million by chance."""


@dataclass(frozen=True)
class NoiseExample:
    """Size of the draws that a noise law is checked with.

    Parameters
    ----------
    n : dimension of the noise
    n_samples : samples of a short draw
    n_many : samples of the draw whose mean and covariance are compared with the law's
    seed : of the generators
    """

    n: int
    n_samples: int = 12
    n_many: int = 20_000
    seed: int = 14
    checks: ClassVar[tuple[Check, ...]]

    def draw(self, law: Noise, n_samples: int | None = None) -> Float[Array, "samples n"]:
        """Noise of one run from a fresh generator."""
        return law.draw(np.random.default_rng(self.seed), self.n_samples if n_samples is None else n_samples)


def _base_class(law: Any, _: NoiseExample) -> None:
    require(isinstance(law, Noise), f"{type(law).__name__} is not a subclass of Noise")


def _shapes(law: Noise, example: NoiseExample) -> None:
    noise = example.draw(law)
    require(noise.shape == (example.n_samples, example.n), f"a draw has shape {noise.shape}")
    require(noise.dtype == np.float64, f"a draw is {noise.dtype}, not float64")
    require(bool(np.isfinite(noise).all()), "a draw is not finite")


def _generator(law: Noise, example: NoiseExample) -> None:
    np.random.default_rng(0).standard_normal(3)  # another generator in between
    require_same("the second draw", example.draw(law), example.draw(law))
    require_same("the draw of the copy", example.draw(pickle.loads(pickle.dumps(law))), example.draw(law))


def _prefix(law: Noise, example: NoiseExample) -> None:
    longer = example.draw(law, 2 * example.n_samples)
    require_same("the beginning of a longer draw", longer[: example.n_samples], example.draw(law))


def _bursts(law: Noise, example: NoiseExample) -> None:
    fresh = [np.random.default_rng(example.seed) for _ in range(3)]
    inside = law.in_burst(fresh[0], example.n_samples)
    require(inside.shape == (example.n_samples,), f"in_burst has shape {inside.shape}")
    require(law.has_bursts or not inside.any(), "a law without bursts has a sample in one")
    first, second = (dict(law.burst_values(rng)) for rng in fresh[1:])
    require(tuple(first) == law.burst_names, f"burst_values has the names {tuple(first)} instead of {law.burst_names}")
    require(first == second, "burst_values depends on something else than the generator")


def _moments(law: Noise, example: NoiseExample) -> None:
    if law.mean is None or law.cov is None:
        return
    noise = example.draw(law, example.n_many)
    error = noise.std(axis=0) / np.sqrt(example.n_many) + 1e-300
    require(bool((np.abs(noise.mean(axis=0) - law.mean) <= MOST_ERRORS * error).all()), "the draws have another mean")
    products = np.einsum("ki,kj->kij", noise - law.mean, noise - law.mean)
    error = products.std(axis=0) / np.sqrt(example.n_many) + 1e-12 * np.abs(law.cov).max(initial=0.0)
    away = np.abs(products.mean(axis=0) - law.cov)
    require(bool((away <= MOST_ERRORS * error).all()), "the draws have another covariance")


NoiseExample.checks = (
    Check("base-class", "the law is a subclass of Noise", _base_class, is_first=True),
    FROZEN,
    Check("shapes", "a draw is (samples, n) finite numbers", _shapes),
    Check("generator", "a draw depends on the generator alone; a copy made by pickle draws the same", _generator),
    Check("prefix", "a longer draw begins with the shorter one", _prefix),
    Check("bursts", "bursts have the declared names and depend on the generator alone", _bursts),
    Check("moments", "draws have the mean and the covariance that the law states", _moments),
)
