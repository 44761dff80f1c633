"""docs/reproductions.md: the papers statement by statement, from the kept claims.json and the configurations."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from docs.markdown import DOCS, ROOT, anchor, block, heading, table, text

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
    "benchmarks": ("Systems of the literature", "Plants for other configurations: `plant: {from: ..}`."),
    "wkf2018": (
        "Wasserstein Kalman filter",
        "Fig. 5 of S. Shafieezadeh-Abadeh, V. Nguyen, D. Kuhn and P. Mohajerin Esfahani, Wasserstein Distributionally "
        "Robust Kalman Filtering (2018), arXiv:1809.08830. The statements are those of its curves, as the public code "
        "of the paper draws them.",
    ),
    "estimators": (
        "Filters, tuned alike",
        "The filters that the literature compares with. [tuning.md](tuning.md) explains "
        "how their parameters are chosen.",
    ),
    "servo-constrained": ("Servomechanism with constraints", "Results: [servo-constrained.md](servo-constrained.md)."),
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


Place = tuple[Configuration, dict[str, Any]]
"""A configuration and a claim in it."""


def statements() -> str:
    """Return the part of the page below its introduction."""
    parts = [part for group in GROUPS for part in (heading(2, GROUPS[group][0], group), *group_parts(group))]
    links = ", ".join(f"[{title}](#{group})" for group, (title, _) in GROUPS.items())
    return "\n\n".join([f"Papers and other experiments: {links}.", *parts])


TABLES: Mapping[str, Callable[[], str]] = {"statements": statements}
"""Marker -> part of the page."""


def configurations(group: str) -> list[Configuration]:
    """Return the configurations of a folder, in the order of their statements: interpretations come last."""
    found = [configuration(path) for path in sorted((ROOT / "configs" / group).glob("*.yaml"))]
    return sorted(
        found, key=lambda one: any(each["ground"] for claim in one.claims for each in claim["interpretations"])
    )


def configuration(path: Path) -> Configuration:
    """Read a configuration and what is kept of its claims."""
    data = plain(load(path))
    results = ROOT / "results" / path.parent.relative_to(ROOT / "configs") / data["name"]
    file = results / "claims.json"
    claims = json.loads(file.read_text(encoding="utf-8"))["claims"] if file.exists() else []
    return Configuration(path, data, claims, results)


def group_parts(group: str) -> list[str]:
    """Introduction, statements by kind and configurations of a folder."""
    found = configurations(group)
    parts = [GROUPS[group][1]]
    for kind, title in TITLES.items():
        # Claims of one id are one statement.
        statements: dict[Any, list[Place]] = {}
        for place in ((each, claim) for each in found for claim in each.claims if claim["kind"] == kind):
            statements.setdefault(place[1]["id"] or id(place[1]), []).append(place)
        rows = [_row(group, places) for places in statements.values()]
        parts += [f"### {title}", table(("statement", "finding", "numbers"), rows)] if rows else []
    links = ", ".join(f"[{each.name}](../{_relative(each.path)})" for each in sorted(found, key=lambda one: one.name))
    return [*filter(None, parts), f"Configurations: {links}."]


def _relative(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def _row(group: str, places: Sequence[Place]) -> tuple[str, ...]:
    first = places[0][1]
    mark = f'<a id="{anchor(group, first["id"])}"></a>' if first["id"] else ""
    links = [f"[{each.name}](../{_relative(each.results)}/claims.md)" for each, _ in places]
    return f"{mark}{text(first['statement'])}", _finding(places), ", ".join(links)


def _finding(places: Sequence[Place]) -> str:
    joined = {claim["joined"] for _, claim in places}
    assert len(joined) == 1, [claim["id"] for _, claim in places]
    word = Finding(joined.pop()).sentence
    here = {each.name: _words(claim) for each, claim in places}
    if len(here) == 1 or {*here.values()} == {word}:
        return f"**{next(iter(here.values()))}**"
    own = {name: "" if words == word else f": {words.removeprefix(f'{word}: ')}" for name, words in here.items()}
    return f"**{word}** ({'; '.join(name + words for name, words in own.items())})"


def _words(claim: dict[str, Any]) -> str:
    """The finding here with what it rests on; a claims.json of an earlier version has the finding alone."""
    return text(claim.get("words") or Finding(claim["finding"]).sentence)


def claim_parts(claim: dict[str, Any]) -> list[str]:
    """Statement, source, figures and finding of a claim, and a block with its numbers and what they rest on."""
    source = claim["source"].removeprefix("additional result").removeprefix("suspected misprint").strip(" ,;:()")
    figures = ", ".join(claim.get("figures", ()))
    where = "; ".join(filter(None, (text(source), f"figure {text(figures)}" * bool(figures))))
    mark = f'<a id="{anchor(claim["id"])}"></a>' if claim["id"] else ""
    line = f"{mark}**{text(claim['statement'])}.** {f'({where}): ' if where else ''}**{_words(claim)}**."
    lines = [*map(_size, claim["sizes"]), *map(_comparison, claim["numbers"])]
    if not lines:
        return [line + " " + text(claim["reason"] or next(iter(claim["assumptions"]), ""))]
    n = claim["n_runs"]
    basis = f"({n:,} run{'s' if n > 1 else ''})" if n else "(exact)"
    return [line, block("text", "\n".join([*(" ".join(each.split()) for each in lines), basis]))]


def _comparison(numbers: dict[str, Any]) -> str:
    interval = numbers["interval"]
    known = interval is not None and None not in interval
    reach = (interval[1] - interval[0]) / 2 if known else float("nan")
    left, right = (number_text(float(numbers[side]), reach) for side in ("left", "right"))
    difference = f" [{', '.join(number_text(float(end), reach) for end in interval)}]" if known else ""
    where = f" at {numbers['at']}" if numbers["at"] else ""
    word = {True: "", False: ", does not hold", None: ", inconclusive"}[numbers["holds"]]
    return f"{numbers['text']}{where}: {left} and {right}{word}{difference}"


def _size(size: dict[str, Any]) -> str:
    computed = number_text(float(size["computed"]))
    return f"{size['of']}: stated {size['stated']}, computed {computed}"
