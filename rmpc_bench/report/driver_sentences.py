"""Drivers of one method in sentences: which quantities explain its spread, and where it does worst."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from rmpc_bench.analysis.driver_text import PAIRED, Row, response_text, share_text
from rmpc_bench.analysis.drivers import FAILED, FEWEST, REST, Inputs
from rmpc_bench.analysis.number_text import interval_text
from rmpc_bench.analysis.pairs import name_of_distance
from rmpc_bench.analysis.responses import SHARE, SHARE_DIFFERENCE
from rmpc_bench.analysis.rounding import significant_text
from rmpc_bench.analysis.trials import Trials
from rmpc_bench.types import MetricInfo

MOST_NAMED = 4
"""Quantities whose shares a sentence states; the table has all of them."""


def method_sentences(trials: Trials, method: str, rows: Sequence[Row], found: Inputs) -> Iterator[str]:
    """Say what drives a method, where it does worst and where it fails, by its rows of `analysis.drivers`."""
    shares = [row for row in rows if row["response"] != FAILED]
    info = next(info for info in trials.metrics if info.name == shares[0]["metric"])
    yield _explained(trials, method, shares, info, found)
    if worst := _worst(trials, method, shares, info):
        yield worst
    for row in rows:
        if row["response"] == FAILED:
            yield _failing(method, row)


def _explained(trials: Trials, method: str, rows: Sequence[Row], info: MetricInfo, found: Inputs) -> str:
    of = response_text(str(rows[0]["response"]), info, trials.baseline)
    n = f"{rows[0]['n']} runs"
    left = rows[0]["n_failed"]
    n += f", {left} left out in which a method failed" if left else ""
    absent = len(trials.runs) - rows[0]["n"] - left
    n += f", {absent} not computed" if absent else ""
    if rows[0]["n"] < FEWEST:
        return f"{method}: what drives {of} is not resolved from {n}; at least {FEWEST} runs are needed."
    if math.isnan(rows[0]["share"]):
        return f"{method}: what drives {of} is not resolved: it does not differ between the {n}, or they are too few."
    quantities = sorted((row for row in rows if row["quantity"] != REST), key=lambda row: -row["share"])
    texts = [f"{row['quantity']} {share_text(row)}" for row in quantities[:MOST_NAMED]]
    if more := quantities[MOST_NAMED:]:
        texts.append(f"and {len(more)} more with smaller shares")
    rest = next(row for row in rows if row["quantity"] == REST)
    text = f"{method}: of the variance of {of}, {', '.join(texts)} ({n}; total effects)."
    text += f" The {_surface(rest['surface'])} leaves {share_text(rest)} unexplained{_random(trials)}."
    if found.constant:
        text += f" Constant in all runs: {', '.join(found.constant)}."
    for first, second in found.correlated:
        text += f" {first} and {second} are correlated: the share of each leaves out what both explain."
    return text


def _surface(form: str) -> str:
    return {
        "quadratic": "quadratic response surface",
        "without interactions": "response surface without interactions (too few runs for them)",
        "linear": "linear response surface (too few runs for squares and interactions)",
    }[form]


def _random(trials: Trials) -> str:
    """Name what the rest may come from besides terms of higher order."""
    if trials.random_besides is None:
        return " (terms of higher order, and noise and initial state if they are random)"
    if not trials.random_besides:
        return " (terms of higher order; nothing else is random)"
    *names, last = trials.random_besides
    words = f"{', '.join(names)} and {last}" if names else last
    return f" ({words}, and terms of higher order)"


def _worst(trials: Trials, method: str, rows: Sequence[Row], info: MetricInfo) -> str:
    """Name the region with the worst mean; empty where nothing is known of it."""
    known = [row for row in rows if row["worst_n"]]
    if not known:
        return ""
    sign = -1.0 if info.direction == "higher" else 1.0
    # A region of few runs may have a worse mean that is not resolved.
    row = max(known, key=lambda row: (bool(row["differs"]), sign * float(row["worst"])))
    unit, signed = str(row["unit"]), row["response"] in PAIRED
    there = interval_text(row["worst"], row["worst_low"], row["worst_high"], unit=unit, sign=signed)
    overall = interval_text(row["overall"], math.nan, math.nan, unit=unit, sign=signed)
    counts = row["response"] in (SHARE, SHARE_DIFFERENCE)
    what = f"share of runs in which {info.name} has no value" if counts else name_of_distance(info)
    against = f" against {trials.baseline}" if signed else ""
    if not row["differs"]:
        mean = what if counts else f"mean {what}"
        return (
            f"{method}: no fifth of a quantity has a {mean}{against} that is resolved as worse than that of all runs."
        )
    improves = signed and sign * float(row["worst_high" if sign > 0 else "worst_low"]) < 0
    verb = f"improves least on {trials.baseline}" if improves else "does worst"
    return f"{method} {verb} where {_region(row)}: {what}{against} {there} there, {overall} overall."


def _failing(method: str, row: Row) -> str:
    share = interval_text(row["worst"], row["worst_low"], row["worst_high"], unit="%", sign=False)
    overall = f"{row['n_failed']} of {row['n']} runs overall"
    start = f"{method} fails most where {_region(row)}: {share} of {row['worst_n']} runs there, {overall}"
    return f"{start}." if row["differs"] else f"{start}; the difference is not resolved."


def _region(row: Row) -> str:
    low, high = (significant_text(float(row[name]), 2) for name in ("worst_from", "worst_to"))
    if not row["worst_part"]:
        return f"{row['quantity']} is {low}"
    return f"{row['quantity']} is in its {row['worst_part']} fifth ({low} to {high})"
