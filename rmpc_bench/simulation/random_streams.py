"""Random streams: one per run and quantity, which depends on (seed, run, name) only.

`stream` is the definition; NumPy's SeedSequence takes most of its time.  `generators` makes the generators of many runs
from seeds that are computed at once, by SeedSequence written for arrays, in a fifth of the time.  `first_uniforms`
computes the first number of many streams, by PCG64 written for arrays: the same bits without a generator per run.

Source  numpy.random.SeedSequence (O'Neill, seed_seq); PCG64, the 128-bit generator with XSL-RR output (O'Neill 2014).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property, lru_cache
from hashlib import sha256
from itertools import cycle
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, UInt32, UInt64
from numpy.random.bit_generator import ISpawnableSeedSequence

from rmpc_bench.types import Array

# SeedSequence: size of the pool and constants of its hash functions.
POOL, SHIFT = 4, np.uint32(16)
INIT_A, MULT_A, INIT_B, MULT_B = 0x43B0D7E5, 0x931E8875, 0x8B51F9DD, 0x58F38DED
MIX_L, MIX_R = np.uint32(0xCA01F9DD), np.uint32(0x4973F715)
WORD = 0xFFFFFFFF
FEW = 16
"""Fewer runs than these take longer at once than one by one."""
# PCG64: upper and lower half of the multiplier.
MULTIPLIER = (np.uint64(2549297995355413924), np.uint64(4865540595714422341))


@lru_cache(maxsize=256)
def words_of(name: str) -> tuple[int, int]:
    """Return the first eight bytes of the hash of a name as two numbers of 32 bits."""
    first, second = np.frombuffer(sha256(name.encode()).digest()[:8], dtype="<u4")
    return int(first), int(second)


def stream(seed: int, run: int, name: str) -> np.random.Generator:
    """Random generator of one run and one quantity, named as ``uncertainty/eps_min`` or ``v/0``."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(run, *words_of(name)))))


class _KnownSeed(ISpawnableSeedSequence):
    """The SeedSequence of a stream with the words that PCG64 asks for; NumPy's is made for anything else."""

    def __init__(self, seed: int, spawn_key: tuple[int, ...], words: UInt64[Array, " words"]) -> None:
        self.entropy, self.spawn_key, self.pool_size, self._words = seed, spawn_key, POOL, words

    @cached_property
    def _sequence(self) -> np.random.SeedSequence:
        return np.random.SeedSequence(self.entropy, spawn_key=self.spawn_key)

    def generate_state(self, n_words: int, dtype: Any = np.uint32) -> Any:
        """Return words of the state."""
        known = n_words == len(self._words) and dtype is np.uint64
        return self._words.copy() if known else self._sequence.generate_state(n_words, dtype)

    def spawn(self, n_children: int) -> Any:
        """Return the next children."""
        return self._sequence.spawn(n_children)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self._sequence, name)


def generators(seed: int, runs: Sequence[int], name: str) -> Iterator[np.random.Generator]:
    """Yield `stream(seed, run, name)` of every run."""
    # An index beyond a word has two words.
    if len(runs) < FEW or max(runs) > WORD:
        yield from (stream(seed, run, name) for run in runs)
        return
    of_name = words_of(name)
    for run, words in zip(runs, np.stack(_states(seed, runs, name), axis=1), strict=True):
        known_seed: Any = _KnownSeed(seed, (run, *of_name), words)
        yield np.random.Generator(np.random.PCG64(known_seed))


class Streams(Sequence[np.random.Generator]):
    """The generators of several runs for one quantity; they are made when one is first asked for."""

    def __init__(self, seed: int, runs: Sequence[int], name: str) -> None:
        self._seed, self._runs, self._name = seed, runs, name

    @cached_property
    def _made(self) -> list[np.random.Generator]:
        return list(generators(self._seed, self._runs, self._name))

    def __len__(self) -> int:
        return len(self._runs)

    def __getitem__(self, row: Any) -> Any:
        return self._made[row]


def first_uniforms(seed: int, runs: range, name: str) -> Float[Array, " runs"]:
    """Return `stream(seed, run, name).random()` for every run."""
    if len(runs) < FEW or max(runs) > WORD:
        return np.array([rng.random() for rng in generators(seed, runs, name)])
    state_high, state_low, inc_high, inc_low = _states(seed, runs, name)
    one, inc = np.uint64(1), _Wide(inc_high, inc_low)
    increment = _Wide(inc.high << one | inc.low >> np.uint64(63), inc.low << one | one)
    # The state starts at zero; its first step leaves the increment.
    state = _stepped(_sum(increment, _Wide(state_high, state_low)), increment)
    state = _stepped(state, increment)
    mixed, turn = state.high ^ state.low, state.high >> np.uint64(58)
    number = mixed >> turn | mixed << ((np.uint64(64) - turn) & np.uint64(63))
    return (number >> np.uint64(11)).astype(float) * 2.0**-53


def _states(seed: int, runs: Sequence[int], name: str) -> list[UInt64[Array, " runs"]]:
    """Return the words of which PCG64 makes its state and its increment, upper and lower half of each."""
    words = _generated(_mixed(_entropy(seed, runs, name)), 8)
    # Pairs of shorter words, the lower half first.
    return [words[i].astype(np.uint64) | words[i + 1].astype(np.uint64) << np.uint64(32) for i in range(0, 8, 2)]


def _entropy(seed: int, runs: Sequence[int], name: str) -> list[UInt32[Array, " runs"]]:
    """Return the words that are hashed: those of the seed, at least as many as the pool has, the run and the name."""
    numbers, rest = list[int](), seed
    while rest or not numbers:
        numbers.append(rest & WORD)
        rest >>= 32
    numbers += [0] * (POOL - len(numbers))
    n = len(runs)
    of_runs = np.asarray(runs, dtype=np.uint32)
    return [*(np.full(n, number, np.uint32) for number in numbers), of_runs] + [
        np.full(n, word, np.uint32) for word in words_of(name)
    ]


def _hashes(constant: int, multiplier: int) -> Iterator[tuple[np.uint32, np.uint32]]:
    """Yield the constants of the successive calls of a hash function."""
    while True:
        following = constant * multiplier & WORD
        yield np.uint32(constant), np.uint32(following)
        constant = following


def _hashed(value: UInt32[Array, " runs"], constants: tuple[np.uint32, np.uint32]) -> UInt32[Array, " runs"]:
    hashed: Array = (value ^ constants[0]) * constants[1]
    return np.asarray(hashed ^ np.right_shift(hashed, SHIFT))


def _mixed(entropy: Sequence[UInt32[Array, " runs"]]) -> list[UInt32[Array, " runs"]]:
    """Return the pool of SeedSequence."""
    constants = _hashes(INIT_A, MULT_A)
    pool = [_hashed(word, next(constants)) for word in entropy[:POOL]]

    def mix(target: int, source: UInt32[Array, " runs"]) -> None:
        value = pool[target] * MIX_L - _hashed(source, next(constants)) * MIX_R
        pool[target] = value ^ np.right_shift(value, SHIFT)

    for source in range(POOL):
        for target in range(POOL):
            if source != target:
                mix(target, pool[source])
    for word in entropy[POOL:]:
        for target in range(POOL):
            mix(target, word)
    return pool


def _generated(pool: Sequence[UInt32[Array, " runs"]], n: int) -> list[UInt32[Array, " runs"]]:
    """Return n words of the state that SeedSequence generates."""
    return [_hashed(word, constants) for _, word, constants in zip(range(n), cycle(pool), _hashes(INIT_B, MULT_B))]


class _Wide(NamedTuple):
    """Numbers of 128 bits."""

    high: UInt64[Array, " runs"]
    low: UInt64[Array, " runs"]


def _sum(a: _Wide, b: _Wide) -> _Wide:
    low = a.low + b.low
    return _Wide(a.high + b.high + (low < a.low), low)


def _stepped(state: _Wide, increment: _Wide) -> _Wide:
    """Return state * MULTIPLIER + increment."""
    m_high, m_low = MULTIPLIER
    high = _upper_half(state.low, m_low) + state.high * m_low + state.low * m_high
    return _sum(_Wide(high, state.low * m_low), increment)


def _upper_half(a: UInt64[Array, " runs"], b: np.uint64) -> UInt64[Array, " runs"]:
    """Return the upper 64 bits of a product of 128 bits."""
    half, mask = np.uint64(32), np.uint64(WORD)
    a_1, a_0, b_1, b_0 = a >> half, a & mask, b >> half, b & mask
    middle = a_1 * b_0 + (a_0 * b_0 >> half)
    other = a_0 * b_1 + (middle & mask)
    return np.asarray(a_1 * b_1 + (middle >> half) + (other >> half))
