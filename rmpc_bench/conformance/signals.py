"""Checks of noise laws and references: they depend on the generator, or on nothing, and have the stated moments."""

from __future__ import annotations

import pickle
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from rmpc_bench.conformance.results import FROZEN, Check, base_class, require, require_same
from rmpc_bench.types import Array, Noise, Reference

MOST_ERRORS = 5.0
"""Standard errors that a mean over draws may be away from its expectation: once in 1.7 million by chance."""


@dataclass(frozen=True)
class NoiseExample:
    """Size of the draws that a noise law is checked with."""

    n: int  # dimension of the noise
    n_samples: int = 12  # samples of a short draw
    # samples whose mean and covariance are compared with the law's: those of one draw, or of a law that is correlated
    # over time the last samples of short draws
    n_many: int = 20_000
    seed: int = 14  # of the generators
    checks: ClassVar[tuple[Check, ...]]

    def draw(self, law: Noise, n_samples: int | None = None) -> Float[Array, "samples n"]:
        """Noise of one run from a fresh generator."""
        return law.draw(np.random.default_rng(self.seed), self.n_samples if n_samples is None else n_samples)

    def many(self, law: Noise) -> Float[Array, "many n"]:
        """Independent samples of the noise."""
        if law.is_white:
            return self.draw(law, self.n_many)
        seeds = np.random.SeedSequence(self.seed).spawn(self.n_many)
        return np.array([law.draw(np.random.default_rng(seed), self.n_samples)[-1] for seed in seeds])


def _noise_shapes(law: Noise, example: NoiseExample) -> None:
    noise = example.draw(law)
    require(noise.shape == (example.n_samples, example.n), f"a draw has shape {noise.shape}")
    require(noise.dtype == np.float64, f"a draw is {noise.dtype}, not float64")
    require(bool(np.isfinite(noise).all()), "a draw is not finite")


def _generator(law: Noise, example: NoiseExample) -> None:
    np.random.default_rng(0).standard_normal(3)  # another generator in between
    require_same("the second draw", example.draw(law), example.draw(law))
    require_same("the draw of the copy", example.draw(pickle.loads(pickle.dumps(law))), example.draw(law))


def _noise_prefix(law: Noise, example: NoiseExample) -> None:
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
    # Without a covariance the error of a mean is not known.
    if law.mean is None or (law.cov is None and law.is_white):
        return
    noise = example.many(law)
    error = noise.std(axis=0) / np.sqrt(example.n_many) + 1e-300
    require(bool((np.abs(noise.mean(axis=0) - law.mean) <= MOST_ERRORS * error).all()), "the draws have another mean")
    if law.cov is None:
        return
    products = np.einsum("ki,kj->kij", noise - law.mean, noise - law.mean)
    error = products.std(axis=0) / np.sqrt(example.n_many) + 1e-12 * np.abs(law.cov).max(initial=0.0)
    away = np.abs(products.mean(axis=0) - law.cov)
    require(bool((away <= MOST_ERRORS * error).all()), "the draws have another covariance")


def _altered(law: Noise, example: NoiseExample) -> None:
    if not law.alters_output:
        require(not law.omits_measurements, "a law that omits measurements declares `alters_output`")
        return
    require(law.mean is None and law.cov is None, "a law that alters measurements has no mean and no cov")
    drawn = example.draw(law)
    y = np.random.default_rng(example.seed + 1).standard_normal(drawn.shape)
    kept = y.copy(), drawn.copy()
    found = law.altered(y, drawn)
    require(found.shape == y.shape, f"altered returns shape {found.shape} instead of {y.shape}")
    require_same("the measurements after the call", y, kept[0])
    require_same("the numbers of the draw after the call", drawn, kept[1])
    require(law.omits_measurements or bool(np.isfinite(found).all()), "a measurement is not finite")
    rows = [law.altered(y[row : row + 1], drawn[row : row + 1])[0] for row in range(len(y))]
    require_same("a measurement altered by itself", np.array(rows), found)
    y[0] = np.nan
    require(bool(np.isnan(law.altered(y, drawn)[0]).all()), "a missing measurement has a value")


NoiseExample.checks = (
    base_class(Noise, "law"),
    FROZEN,
    Check("shapes", "a draw is (samples, n) finite numbers", _noise_shapes),
    Check("generator", "a draw depends on the generator alone; a copy made by pickle draws the same", _generator),
    Check("prefix", "a longer draw begins with the shorter one", _noise_prefix),
    Check("bursts", "bursts have the declared names and depend on the generator alone", _bursts),
    Check("moments", "draws have the mean and the covariance that the law states", _moments),
    Check("altered", "a law that alters measurements does so run by run, and a missing one stays missing", _altered),
)


@dataclass(frozen=True)
class ReferenceExample:
    """Size of the signal that a reference is checked with."""

    ny: int  # number of outputs
    n_samples: int = 40  # length of the signal
    checks: ClassVar[tuple[Check, ...]]


def _reference_shapes(reference: Reference, example: ReferenceExample) -> None:
    r = reference.sample(example.n_samples)
    require(r.shape == (example.n_samples, example.ny), f"the signal has shape {r.shape}")
    require(r.dtype == np.float64, f"the signal is {r.dtype}, not float64")
    require(bool(np.isfinite(r).all()), "the signal is not finite")


def _reference_prefix(reference: Reference, example: ReferenceExample) -> None:
    r = reference.sample(example.n_samples)
    for n_samples in (1, example.n_samples // 2):
        require_same("the beginning", reference.sample(n_samples), r[:n_samples])


def _reference_purity(reference: Reference, example: ReferenceExample) -> None:
    first = reference.sample(example.n_samples)
    before = first.copy()
    first += 1.0  # what a caller does with the array must not reach the next one
    require_same("the second signal", reference.sample(example.n_samples), before)
    copy = pickle.loads(pickle.dumps(reference))
    require_same("the signal of the copy", copy.sample(example.n_samples), before)


ReferenceExample.checks = (
    base_class(Reference, "reference"),
    FROZEN,
    Check("shapes", "the signal is (samples, ny) finite numbers", _reference_shapes),
    Check("prefix", "a longer signal begins with the shorter one", _reference_prefix),
    Check(
        "purity",
        "every call returns the same bits in an array of its own; a copy made by pickle too",
        _reference_purity,
    ),
)
