"""A claim of a configuration, the numbers that papers print, and where the papers are.

This module does not import pandas, so that `check` stays fast.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from enum import StrEnum
from typing import NamedTuple

from rmpc_bench.analysis.rounding import STABLE

CLOSE = 0.01
"""Relative difference up to which a computed number counts as close to the printed one, unless the claim gives one."""
MAX_INTERPRETATIONS = 12
"""Points at which a statement of a paper may be checked; a wider search is an additional result."""
MAX_QUOTED_WORDS = 25
MISPRINT = "suspected misprint"


class Finding(StrEnum):
    """Outcome of checking a claim; the value is its word in YAML and JSON, `sentence` the words for readers."""

    CONFIRMED = "confirmed"
    CONFIRMED_SMALLER = "confirmed-smaller"
    CONFIRMED_LARGER = "confirmed-larger"
    PARTIALLY_CONFIRMED = "partially-confirmed"
    INCONCLUSIVE = "inconclusive"
    DEPENDS_ON_ASSUMPTIONS = "depends-on-assumptions"
    NOT_CONFIRMED = "not-confirmed"
    NOT_TESTABLE = "not-testable"
    EQUAL = "equal"
    CLOSE = "close"
    DIFFERENT = "different"

    @property
    def sentence(self) -> str:
        """The finding in words."""
        return _SENTENCES.get(self, self.value.replace("-", " "))

    @property
    def is_confirmed(self) -> bool:
        """Whether the statement holds, whatever the size of the effect."""
        return self in _CONFIRMED


_CONFIRMED = frozenset(
    (Finding.CONFIRMED, Finding.CONFIRMED_SMALLER, Finding.CONFIRMED_LARGER, Finding.EQUAL, Finding.CLOSE)
)
_SENTENCES = {
    Finding.CONFIRMED_SMALLER: "confirmed, smaller effect",
    Finding.CONFIRMED_LARGER: "confirmed, larger effect",
    Finding.DEPENDS_ON_ASSUMPTIONS: "depends on unstated assumptions",
    Finding.EQUAL: "equal to the digits printed",
}
FINDINGS = tuple(finding.value for finding in Finding)
"""The words that a configuration may record."""


class HoldsFor(StrEnum):
    """How many of its cases a statement is about: "is", "usually is" or "can be"."""

    ALL = "all"
    MOST = "most"
    ANY = "any"


@dataclass(frozen=True)
class Stated:
    """A number that a paper gives."""

    of: str  # the expression that computes it
    value: float  # the number of the paper
    # largest absolute difference of the same size of effect; None for a number without Monte Carlo error, which is
    # compared by its printed digits
    tolerance: float | None
    text: str  # the number in words, as in the paper
    printed: str = ""  # the digits as printed, where there is no tolerance
    close: float = CLOSE  # relative difference up to which a number without tolerance counts as close


@dataclass(frozen=True)
class Claim:
    """One statement of a paper.

    Parameters
    ----------
    says : the statement, in one sentence
    source : where it stands
    check : comparisons, see `claims.grammar`; empty when nothing here can test it
    finding : the recorded finding
    stated : what the paper gives, as a text or as numbers: sizes, which are checked when all comparisons hold, and
        numbers without Monte Carlo error, which need no comparison
    assumptions : what the paper leaves open and what this project assumes, one sentence each
    at : points of a sweep, path -> text of the value, one per interpretation in which the checks are made; terms that
        name a point of their own override it
    pooled : whether terms that name no point use the runs of all points together
    name : names the statement in all configurations of a paper; empty where it stands in one only
    quote : the words of the paper
    holds_for : whether all, most or any of the cases must hold; the cases are all checks at all points of `at`
    grounds : point of `at` in words -> what in the text of the paper allows this interpretation
    elsewhere : configuration -> the finding that it records for the same statement
    figures : names of the figures in which a reader sees whether it holds
    """

    says: str
    source: str
    check: tuple[str, ...]
    finding: Finding | None = None
    stated: str | Stated | tuple[Stated, ...] | None = None
    assumptions: tuple[str, ...] = ()
    at: tuple[Mapping[str, str], ...] = ()
    pooled: bool = False
    name: str = ""
    quote: str = ""
    holds_for: HoldsFor = HoldsFor.ALL
    grounds: Mapping[str, str] = field(default_factory=dict)
    elsewhere: Mapping[str, Finding] = field(default_factory=dict)
    figures: tuple[str, ...] = ()

    @property
    def numbers(self) -> tuple[Stated, ...]:
        """The stated numbers."""
        if isinstance(self.stated, Stated):
            return (self.stated,)
        return self.stated if isinstance(self.stated, tuple) else ()

    @property
    def is_testable(self) -> bool:
        """Whether there is something to check."""
        return bool(self.check) or any(number.tolerance is None for number in self.numbers)

    @property
    def of_paper(self) -> bool:
        """Whether the paper says so; what this project adds has a source that begins with ``additional result``."""
        return not self.source.startswith(("additional result", MISPRINT))

    @property
    def is_misprint(self) -> bool:
        """Whether it is about a suspected misprint of the paper; its source begins with ``suspected misprint``."""
        return self.source.startswith(MISPRINT)


def point_words(at: Mapping[str, str]) -> str:
    """Name a point of a sweep: by its name alone where it has one, else by its values."""
    named = {"name": at["name"]} if "name" in at else {}
    rest = [f"{path}={value}" for path, value in at.items() if path not in named]
    return ", ".join([*named.values(), *rest])


IDENTIFIERS: Mapping[str, str] = {
    "zenere2017": "arXiv:1703.05219",
    "zenere2018": "arXiv:1804.06746",
    "souto2011": "ISBN 978-953-307-200-5",
    "wkf2018": "arXiv:1809.08830",
}
"""Key of a paper -> DOI, arXiv number or ISBN; of papers that are not named here none is known to us."""
_WITH_YEAR = re.compile(r".*\d{4}[a-z]?")


def usual_parameters(paper: str | None) -> str:
    """Say where parameters come from that are neither tuned nor described in the configuration.

    The key of a publication ends with its year; any other `paper` names a collection.

    >>> usual_parameters("zenere2018"), usual_parameters("examples"), usual_parameters(None)
    ('as published', 'default', 'default')
    """
    return "as published" if paper is not None and _WITH_YEAR.fullmatch(paper) else "default"


_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?")


def printed_number(text: str) -> Decimal:
    """Read a number as printed, such as ``1,869.20``; its last digit, a zero included, says how exactly.

    >>> printed_number("62,908"), printed_number("5.80")
    (Decimal('62908'), Decimal('5.80'))
    """
    plain = re.sub(r"(?<=\d)[ ,](?=\d{3}(\D|$))", "", text.strip())
    if not _NUMBER.fullmatch(plain):
        raise ValueError(f"must be a number as the paper prints it, such as '58.24' (got {text!r})")
    return Decimal(plain)


class Closeness(NamedTuple):
    """How close a computed number is to a printed one."""

    finding: Finding
    relative: float  # difference relative to the printed number; inf beside a printed 0


def closeness(value: float, stated: Stated) -> Closeness:
    """Compare a number without Monte Carlo error with the printed one: equal if it rounds to the printed digits.

    >>> [closeness(v, Stated("", 5.8, None, "", "5.8")).finding.value for v in (5.84, 5.851, 6.1)]
    ['equal', 'close', 'different']
    """
    printed = printed_number(stated.printed)
    if not math.isfinite(value):
        return Closeness(Finding.DIFFERENT, math.inf)
    # Digits beyond `STABLE` differ between machines.
    gap = Decimal(f"{value:.{STABLE}g}") - printed
    exponent = printed.as_tuple().exponent
    assert isinstance(exponent, int)
    relative = float(gap / abs(printed)) if printed else math.copysign(math.inf, gap) if gap else 0.0
    if 2 * abs(gap) <= Decimal(1).scaleb(exponent):
        return Closeness(Finding.EQUAL, relative)
    return Closeness(Finding.CLOSE if abs(relative) <= stated.close else Finding.DIFFERENT, relative)
