"""The claims of a configuration: read, and checked against what the experiment will have to say."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from rmpc_bench.analysis.claim import Claim, Stated
from rmpc_bench.analysis.claim_grammar import COUNTS, ClaimError, parse, parse_expression
from rmpc_bench.analysis.claim_tree import Term, terms
from rmpc_bench.analysis.points import lies_at, value_text
from rmpc_bench.experiment.places import Place, nowhere
from rmpc_bench.experiment.sections import ClaimKeys
from rmpc_bench.experiment.sheet import Sheet
from rmpc_bench.experiment.yaml import Map, plain
from rmpc_bench.registry import unknown
from rmpc_bench.types import Outlook


def read_claims(
    sheet: Sheet, metrics: Sequence[str], places: Sequence[Place], outlook: Outlook | None
) -> tuple[Claim, ...]:
    """Turn the claims of a sheet into statements; what is wrong with them is noted.

    Parameters
    ----------
    sheet : of the first point
    metrics : names of the metrics
    places : the points of the sweep; empty where something is wrong with it
    outlook : what the results will have; None where it is not known because something else is wrong
    """
    claims = []
    for number, keys in enumerate(sheet.claims):
        if keys is not None:
            checker = _Checker(sheet, number, metrics, places, outlook)
            claims.append(checker.claim(keys))
    return tuple(claims)


class _Checker:
    """Checks one claim."""

    def __init__(
        self, sheet: Sheet, number: int, metrics: Sequence[str], places: Sequence[Place], outlook: Outlook | None
    ) -> None:
        self.sheet, self.places = sheet, places
        self.series = [name for name in outlook.series if name not in metrics] if outlook else []
        self.known = [*metrics, *COUNTS, *self.series] if outlook else []
        self.path: list[str | int] = ["claims", number]
        self.misplaced = False

    def claim(self, keys: ClaimKeys) -> Claim:
        check = (keys.check,) if isinstance(keys.check, str) else tuple(keys.check or ())
        stated = keys.stated if isinstance(keys.stated, str) or keys.stated is None else Stated(**asdict(keys.stated))
        claim = Claim(
            keys.says, keys.source, check, keys.finding, stated, keys.chosen, self._at(keys.at), keys.at == "all"
        )
        for text in check:
            self._terms(claim, text, "check", parse)
        if isinstance(stated, Stated):
            self._terms(claim, stated.of, "stated.of", parse_expression)
        return claim

    def _note(self, key: str, message: str) -> None:
        self.sheet.note([*self.path, *key.split(".")], message)

    def _at(self, given: Any) -> tuple[dict[str, str], ...]:
        """Read one point or a list of them; what names no point is noted and left out."""
        if given is None:
            return ()
        if self.places and not self.places[0].coordinates:
            self._note("at", "nothing is swept in this configuration")
            return ()
        if given == "all":
            return ()
        entries = given if isinstance(given, list) else [given]
        found = []
        for entry in entries:
            if not isinstance(entry, Map) or not entry:
                self._note("at", "must be a mapping from paths to values, a list of those, or 'all'")
                continue
            at = {name: value_text(plain(value)) for name, value in entry.items()}
            if at in found:
                self._note("at", "names a point twice")
            message = nowhere(self.places, at)
            if message:
                self._note("at", message)
            else:
                found.append(at)
        if not entries:
            self._note("at", "must name at least one point")
        self.misplaced = len(found) < len(entries) or not entries
        return tuple(found)

    def _terms(self, claim: Claim, text: str, key: str, grammar: Callable[[str], object]) -> None:
        """Check that a text can be read and speaks of what is there."""
        try:
            named = sorted(terms(grammar(text)))
        except ClaimError as error:
            self._note(key, str(error))
            return
        for term in named:
            if self.sheet.methods and term.method not in self.sheet.methods:
                self._note(key, unknown(term.method, self.sheet.methods, "method"))
            if self.known and term.quantity not in self.known:
                self._note(key, unknown(term.quantity, self.known, "metric or series of this configuration"))
        if self.places and not self.misplaced:
            for at in claim.at or ({},):
                counts = [self._place(claim, term, {**at, **dict(term.point)}, key) for term in named]
                if 0 not in counts and len(set(counts)) > 1:
                    self._note(key, "the terms speak of different numbers of points")

    def _place(self, claim: Claim, term: Term, wanted: Mapping[str, str], key: str) -> int:
        """Count the points of a term: one, or in a pooled claim some; 0 when something is wrong with them."""
        what = f"{term.quantity}[{term.method}]"
        if not self.places[0].coordinates and not wanted:
            return 1
        found = [place for place in self.places if lies_at(place.coordinates, wanted)]
        if not found:
            self._note(key, f"{what}: {nowhere(self.places, wanted)}")
            return 0
        if not all(place.keys for place in found):
            return 1  # something else is wrong, and what the points share is not known
        different = len({place.keys.get(term.method, "") for place in found})
        if not claim.pooled and different > 1:
            self._note(key, f"{what} may be at any of {len(found)} points of the sweep: {self._way_out(term, found)}")
            return 0
        if claim.pooled and len(found) > 1 and term.quantity in self.series:
            self._note(key, f"{what} is a series, of one point: {self._way_out(term, found)}")
            return 0
        if claim.pooled and different < len(found):
            self._note(key, f"{what} is the same at several points, and would count more than once: name one of them")
            return 0
        return len(found) if claim.pooled else 1

    def _way_out(self, term: Term, found: Sequence[Place]) -> str:
        open_paths = [name for name in found[0].coordinates if len({place.coordinates[name] for place in found}) > 1]
        example = ", ".join(f"{name}={found[0].coordinates[name]}" for name in open_paths)
        if any(letter in example.replace(", ", "") for letter in "[],"):
            return "name one with `at`"
        return f"name one, as {term.quantity}[{term.method}, {example}], or give the claim an `at`"
