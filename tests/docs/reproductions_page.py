"""docs/reproductions.md: the papers statement by statement, from the kept claims.json and the configurations."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from docs.markdown import DOCS, ROOT, anchor, heading, page, table, text

from rmpc_bench.claims.claim import IDENTIFIERS, Finding
from rmpc_bench.claims.markdown import number_text
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import load

PAGE = DOCS / "reproductions.md"
PAPERS = {
    "zenere2018": "A. Zenere and M. Zorzi, On the coupling of Model Predictive Control and Robust Kalman "
    "Filtering (2018)",
    "zenere2017": "A. Zenere and M. Zorzi, Model Predictive Control meets robust Kalman filtering (2017)",
    "souto2011": "R. Souto, J. Ishihara and G. Borges, Kalman Filtering for Discrete Time Uncertain Systems (2011)",
    "ma2025": "X. Ma, S. Zhang, X. Zhang, J. Xin and H. Garcia de Marina, Linear quadratic control for discrete-time "
    "systems with stochastic and bounded noises (2025)",
    "belda2017": "K. Belda and L. Pavelková, Online Tuned Model Predictive Control for Robotic Systems with Bounded "
    "Noise (2017)",
}
INTRODUCTION = """# Reproductions

What five papers state, and what we find, statement by statement. A finding is computed from the trials and
compared with the one that the configuration records; `make papers` computes all of them again and stops at the first
difference. A finding holds for the experiment as we interpret it. Where a paper leaves something open, the claim in the
configuration lists the assumptions, and the pages of the methods explain them. A statement that several configurations
check has one finding, joined over all interpretations. There is no score per paper. The link behind a finding has its
numbers, source and figures.

| finding | meaning |
| --- | --- |
| confirmed | every comparison of the check holds, with its interval |
| confirmed, in 1 of 8 cases | of a statement with "can" one case is enough, with "usually" more than half are needed |
| confirmed, but below the margin of relevance | the direction is as stated; no difference reaches the margin |
| confirmed, smaller (larger) effect | the direction is as stated, the size is outside its tolerance |
| partially confirmed | some comparisons hold, some do not |
| inconclusive | an interval contains the border; the runs that would decide are named |
| depends on unstated assumptions | at least one admissible interpretation confirms it, and another one does not |
| not confirmed | the check does not hold, and its interval does not contain the border |
| not confirmed: confirmed under none of 7 interpretations | at least one of them contradicts it |
| not testable | the experiment cannot show it; there is no check |
| equal to the digits printed | a number without Monte Carlo error agrees in every digit that the paper prints |
| close, different | its relative difference is small (the claim names the limit), or it is not |

Two numbers after a comparison are its left and its right side, and brackets the interval of their difference.
[statistics.md](statistics.md) explains how intervals and verdicts are computed, [experiments.md](experiments.md) how
claims are written.

**Versions.** Trials have the same bytes on Python 3.11, 3.12 and 3.13 with the same versions of the libraries. NumPy
and SciPy bring OpenBLAS, and another version of it rounds differently: NumPy 2.5 in place of 2.4, or SciPy 1.18 in
place of 1.17, changes values of quickstart and zenere2018/fig7 by at most 1.3e-14 (relative), and none of ma2025.
`make dist-check` prints hashes of the trials for each Python and compares those with the same versions. Python 3.11,
for which there is no NumPy 2.5, was compared once by hand. `rmpc-bench compare` prints differences of two results.

**Reported covariances.** `rmpc-bench run configs/souto2011/comparison.yaml --runs 100 -s calibration=true`, and the
same with wkf2018/fig5, ma2025/fig1-3 and zenere2018/sim1, give each filter a word, explained in
[statistics.md](statistics.md#calibration-of-reported-covariances). A number is the size of the errors over the reported
standard deviations. On souto2011 with delta on [-1, 1] the enhanced robust predictor is conservative, as a bound has to
be: 0.64, and 0.70 when tuned. Designed for half of the uncertainty (ERP-state) it is conservative there, too, 0.90, but
overconfident with delta at its extremes, 1.15: that uncertainty is outside of its design. The classic predictor is
overconfident, 8.3, and with R = 100 V 100' 1.3. Sayed's filter, whose P is no bound, is overconfident, 1.6. LMMSE and
oracle are calibrated. On wkf2018 the Kalman filter is calibrated at the small white uncertainty, 1.00, and
overconfident at the large one, white 1.3 and frozen 2.5. The Wasserstein filter is conservative at the small white one,
0.89, calibrated at the large white one, and overconfident, size uncertain, at the large frozen one, 1.12. On ma2025 the
P of the mixed filter is that of the stochastic part of the error only, so that P alone is overconfident, 2.5; that of
the Kalman filter, 3.5. On the nominal servomechanism of zenere2018 the noise is at most 0.03 of that of the design, and
every filter is conservative. In Fig. 7 and 8 the plant has five states and the filters four: there is no x_hat - x."""
TITLES = {
    "statement of the paper": "What the paper says",
    "additional result": "Additional results",
    "suspected misprint": "Suspected misprints",
}


def _named(paper: str) -> str:
    """Authors, title, year and identifier of a paper."""
    return text(", ".join(filter(None, (PAPERS[paper], IDENTIFIERS.get(paper)))))


GROUPS = {
    **{paper: (paper, f"{_named(paper)}. [Equations and assumptions](methods/{paper}.md).") for paper in PAPERS},
    "benchmarks": (
        "Systems of the literature",
        "Small systems, which other configurations use with `plant: {from: ..}`.",
    ),
    "wkf2018": (
        "Wasserstein Kalman filter",
        "Fig. 5 of S. Shafieezadeh-Abadeh, V. Nguyen, D. Kuhn and P. Mohajerin Esfahani, Wasserstein Distributionally "
        "Robust Kalman Filtering (2018), arXiv:1809.08830. The statements are those of its curves, as the public code "
        "of the paper draws them.",
    ),
    "estimators": (
        "Estimators, tuned alike",
        "Experiments of our own with the estimators that the literature compares with. [tuning.md](tuning.md) explains "
        "how their parameters are chosen.",
    ),
    "servo-constrained": (
        "Servomechanism with constraints",
        "Experiments of our own, explained in [constraints.md](constraints.md).",
    ),
    "mayne2005": (
        "Tube predictive control",
        "The example of Mayne, Seron and Rakovic, Robust model predictive control of constrained linear systems with "
        "bounded disturbances (2005), with claims of our own: the text of the paper was not at hand.",
    ),
    "examples": ("Examples", "Experiments with functions or components of a user."),
}
"""Folder of configurations -> title and introduction."""


class Configuration(NamedTuple):
    """A configuration with what is kept of its results."""

    path: Path
    data: dict[str, Any]
    claims: list[dict[str, Any]]
    results: Path

    @property
    def name(self) -> str:
        """Name of the experiment."""
        return str(self.data["name"])


class Place(NamedTuple):
    """A claim in a configuration."""

    configuration: Configuration
    claim: dict[str, Any]


def generated() -> str:
    """Return the page."""
    parts = [part for group in GROUPS for part in (heading(2, GROUPS[group][0], group), *group_parts(group))]
    links = ", ".join(f"[{title}](#{group})" for group, (title, _) in GROUPS.items())
    return page(INTRODUCTION, f"Papers and other experiments: {links}.", *parts)


def configurations(group: str) -> list[Configuration]:
    """Return the configurations of a folder, in the order of their statements: interpretations come last."""
    found = [configuration(path) for path in sorted((ROOT / "configs" / group).glob("*.yaml"))]
    return sorted(found, key=_is_of_interpretations)


def configuration(path: Path) -> Configuration:
    """Read a configuration and what is kept of its claims."""
    data = plain(load(path))
    results = ROOT / "results" / path.parent.relative_to(ROOT / "configs") / data["name"]
    file = results / "claims.json"
    claims = json.loads(file.read_text(encoding="utf-8"))["claims"] if file.exists() else []
    return Configuration(path, data, claims, results)


def _is_of_interpretations(configuration: Configuration) -> bool:
    """Whether it checks statements of another configuration under other interpretations."""
    return any(each["ground"] for claim in configuration.claims for each in claim["interpretations"])


def statements(places: Iterable[Place]) -> list[list[Place]]:
    """Group claims by statement: those of one id are one statement."""
    groups: dict[Any, list[Place]] = {}
    for number, place in enumerate(places):
        groups.setdefault(place.claim["id"] or number, []).append(place)
    return list(groups.values())


def group_parts(group: str) -> list[str]:
    """Introduction, statements by kind and configurations of a folder."""
    found = configurations(group)
    parts = [GROUPS[group][1]]
    places = [Place(each, claim) for each in found for claim in each.claims]
    for kind, title in TITLES.items():
        rows = [_row(group, each) for each in statements(place for place in places if place.claim["kind"] == kind)]
        parts += [f"### {title}", table(("statement", "finding", "numbers"), rows)] if rows else []
    links = ", ".join(f"[{each.name}](../{_relative(each.path)})" for each in sorted(found, key=lambda one: one.name))
    return [*filter(None, parts), f"Configurations: {links}."]


def _relative(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def _row(group: str, places: Sequence[Place]) -> tuple[str, ...]:
    first = places[0].claim
    mark = f'<a id="{anchor(group, first["id"])}"></a>' if first["id"] else ""
    links = [f"[{each.name}](../{_relative(each.results)}/claims.md)" for each, _ in places]
    return f"{mark}{text(first['statement'])}", _finding(places), ", ".join(links)


def _finding(places: Sequence[Place]) -> str:
    joined = {place.claim["joined"] for place in places}
    assert len(joined) == 1, [place.claim["id"] for place in places]
    word = Finding(joined.pop()).sentence
    here = {place.configuration.name: _words(place.claim) for place in places}
    if len(here) == 1:
        return f"**{next(iter(here.values()))}**"
    if set(here.values()) == {word}:
        return f"**{word}**"
    return f"**{word}**: {'; '.join(f'{words} in {name}' for name, words in here.items())}"


def _words(claim: dict[str, Any]) -> str:
    """The finding here with what it rests on; a claims.json of an earlier version has the finding alone."""
    return text(claim.get("words") or Finding(claim["finding"]).sentence)


def claim_parts(claim: dict[str, Any]) -> list[str]:
    """Statement, source, figures and finding of a claim, and a block with its numbers and what they rest on."""
    source = claim["source"].removeprefix("additional result").removeprefix("suspected misprint").strip(" ,;:()")
    figures = ", ".join(claim.get("figures", ()))
    where = "; ".join(filter(None, (text(source), f"figure {figures}" * bool(figures))))
    mark = f'<a id="{claim["id"]}"></a>' if claim["id"] else ""
    line = f"{mark}**{text(claim['statement'])}.** {f'({where}): ' if where else ''}**{_words(claim)}**."
    lines = [*map(_size, claim["sizes"]), *map(_comparison, claim["numbers"])]
    if not lines:
        return [line + " " + text(claim["reason"] or next(iter(claim["assumptions"]), ""))]
    n = claim["n_runs"]
    basis = f"({n:,} run{'s' if n > 1 else ''})" if n else "(exact)"
    return [line, "\n".join(["```text", *lines, basis, "```"])]


def _comparison(numbers: dict[str, Any]) -> str:
    interval = numbers["interval"]
    known = interval is not None and None not in interval
    reach = (interval[1] - interval[0]) / 2 if known else float("nan")
    left, right = (number_text(float(numbers[side]), reach) for side in ("left", "right"))
    difference = f" [{', '.join(number_text(float(end), reach) for end in interval)}]" if known else ""
    where = f" at {numbers['at']}" if numbers["at"] else ""
    word = {True: "", False: ", does not hold", None: ", inconclusive"}[numbers["holds"]]
    return f"{' '.join(numbers['text'].split())}{where}: {left} and {right}{word}{difference}"


def _size(size: dict[str, Any]) -> str:
    computed = number_text(float(size["computed"]))
    return f"{' '.join(size['of'].split())}: stated {size['stated']}, computed {computed}"
