"""What a single claim needs of an experiment: points of the sweep and methods."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace

from rmpc_bench.claims.claim import Claim
from rmpc_bench.claims.grammar import ExpressionError, parse, parse_expression, terms
from rmpc_bench.config.experiment_config import ExperimentConfig
from rmpc_bench.received.archive import ArchiveError
from rmpc_bench.types.errors import unknown
from rmpc_bench.types.sweep_points import lies_at


def only_claim(config: ExperimentConfig, name: str, methods: Collection[str]) -> tuple[ExperimentConfig, list[str]]:
    """Reduce an experiment to the points, methods and the claim of this `id` or number in claims.md."""
    claim = _named(config.claims, name)
    wanted = list(_needed(claim))
    names = [method for method in config.methods if method in methods and method in {each for each, _ in wanted}]
    points = tuple(
        point for point in config.points if any(lies_at(point.coordinates, coordinates) for _, coordinates in wanted)
    )
    if not names or not points:
        raise ArchiveError(f"claim {name}: no run can be computed for it: {claim.says}")
    return replace(config, claims=(claim,), points=points), names


def _named(claims: Sequence[Claim], name: str) -> Claim:
    known = {claim.name: claim for claim in claims if claim.name}
    numbered = {str(number): claim for number, claim in enumerate(claims, 1)}
    if name not in known and name not in numbered:
        numbers = f"; or a number from 1 to {len(claims)}, as in claims.md" if claims else ""
        none = f"there is no claim {name!r}" + ("" if claims else ": the experiment has no claims")
        text = unknown(name, known, "claim") if known else none
        raise ArchiveError(f"--claim: {text}{numbers}")
    return known.get(name) or numbered[name]


def _needed(claim: Claim) -> Iterator[tuple[str, Mapping[str, str]]]:
    """Yield the methods that a claim names, each with coordinates of a point."""
    trees = []
    for text, read in [
        *((each, parse) for each in claim.check),
        *((each.of, parse_expression) for each in claim.numbers),
    ]:
        try:
            trees.append(read(text))
        except ExpressionError:
            # The finding says so.
            continue
    for at in claim.at or ({},):
        for node in trees:
            for term in terms(node):
                yield term.method, {**at, **dict(term.point)}
