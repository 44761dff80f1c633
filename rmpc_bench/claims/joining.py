"""From the outcomes of single comparisons to one finding: over a list, over cases and over interpretations."""

from __future__ import annotations

from collections.abc import Sequence

from rmpc_bench.claims.claim import Finding, HoldsFor

Outcome = bool | None
"""Whether a comparison holds; None where the runs do not decide."""


def all_of(parts: Sequence[Outcome]) -> Outcome:
    """Whether all parts of one case hold: not if one fails, else inconclusive if one is."""
    if False in parts:
        return False
    return None if None in parts else True


def over_list(parts: Sequence[Outcome]) -> Finding:
    """Join the parts of a statement that says all of them.

    Examples
    --------
    >>> [over_list(parts).value for parts in ([True, None], [True, False], [None, False])]
    ['inconclusive', 'partially-confirmed', 'not-confirmed']
    """
    if False not in parts:
        return Finding.INCONCLUSIVE if None in parts else Finding.CONFIRMED
    return Finding.PARTIALLY_CONFIRMED if True in parts else Finding.NOT_CONFIRMED


def needed(n_cases: int, holds_for: HoldsFor) -> int:
    """Return the number of cases that must hold."""
    return {HoldsFor.ANY: 1, HoldsFor.MOST: n_cases // 2 + 1}.get(holds_for, n_cases)


def over_cases(cases: Sequence[Outcome], holds_for: HoldsFor) -> Finding:
    """Join the cases of a statement: ``any`` for "can", ``most`` for "usually", which is more than half of them.

    Examples
    --------
    >>> [over_cases(cases, HoldsFor.MOST).value for cases in ([True, True, None], [True, None], [False, None])]
    ['confirmed', 'inconclusive', 'not-confirmed']
    """
    least = needed(len(cases), holds_for)
    if cases.count(True) >= least:
        return Finding.CONFIRMED
    possible = len(cases) - cases.count(False)
    return Finding.INCONCLUSIVE if possible >= least else Finding.NOT_CONFIRMED


def over_numbers(findings: Sequence[Finding]) -> Finding:
    """Join numbers without Monte Carlo error, each equal, close or different."""
    if len(set(findings)) == 1:
        return findings[0]
    return Finding.PARTIALLY_CONFIRMED if Finding.DIFFERENT in findings else Finding.CLOSE


def over_interpretations(findings: Sequence[Finding]) -> Finding:
    """Join the findings under all interpretations; the first is ours.

    Those that are not testable count only if all are.  A statement depends on what the paper leaves open only if at
    least one interpretation confirms it and the runs show that another one does not.

    Examples
    --------
    >>> over_interpretations([Finding.CONFIRMED, Finding.CONFIRMED_SMALLER]).value
    'confirmed'
    >>> over_interpretations([Finding.INCONCLUSIVE, Finding.NOT_CONFIRMED]).value
    'not-confirmed'
    >>> over_interpretations([Finding.INCONCLUSIVE, Finding.PARTIALLY_CONFIRMED]).value
    'inconclusive'
    """
    tested: list[Finding] = [finding for finding in findings if finding is not Finding.NOT_TESTABLE]
    tested = tested or [*findings]
    # Under other interpretations the size may differ: the statement holds all the same.
    if len(set(tested)) == 1 or all(finding.is_confirmed for finding in tested):
        return tested[0]
    if Finding.DEPENDS_ON_ASSUMPTIONS in tested:
        return Finding.DEPENDS_ON_ASSUMPTIONS
    if any(finding.is_confirmed for finding in tested):
        others = {finding for finding in tested if not finding.is_confirmed}
        return Finding.INCONCLUSIVE if others == {Finding.INCONCLUSIVE} else Finding.DEPENDS_ON_ASSUMPTIONS
    failed = {Finding.NOT_CONFIRMED, Finding.DIFFERENT}.intersection(tested)
    return Finding.NOT_CONFIRMED if failed else Finding.INCONCLUSIVE
