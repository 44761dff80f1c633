"""The keys `claims` and `figures`, checked against the layout of the results that the configuration will have."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from rmpc_bench.claims.claim import (
    MAX_INTERPRETATIONS,
    Claim,
    Finding,
    HoldsFor,
    Stated,
    point_words,
    printed_number,
)
from rmpc_bench.claims.dry_run import PlaceholderResults, dry_run, placeholder_results
from rmpc_bench.claims.grammar import (
    COUNTS,
    MOMENTS,
    SIGNALS,
    ExpressionError,
    Term,
    misuse,
    parse,
    parse_expression,
    terms,
    unknown_moment,
    uses,
)
from rmpc_bench.components.designs import figure_names
from rmpc_bench.config.claim_keys import ClaimKeys, StatedKeys
from rmpc_bench.config.draft import DraftConfig, metric_names
from rmpc_bench.config.identity import Built
from rmpc_bench.config_file.tree import Map, plain
from rmpc_bench.expressions.arithmetic import Node
from rmpc_bench.registry import unknown
from rmpc_bench.simulation.moments import Moments, signals
from rmpc_bench.simulation.recording import BURSTS, COVARIANCE, design_series
from rmpc_bench.simulation.scenario import Experiment, stores_quantities
from rmpc_bench.types import DesignError, Figure, Method, ResultLayout
from rmpc_bench.types.sweep_points import lies_at, no_such_point, value_text


def read_claims(draft: DraftConfig, layout: ResultLayout) -> tuple[Claim, ...]:
    """Read the claims of the first draft; errors are added to its problems, and claims with an error are of no use.

    The layout is known as far as other errors allow.
    """
    claims = []
    results = placeholder_results(layout) if layout.trials else None
    for number, keys in enumerate(draft.claims):
        if keys is not None:
            checker = _Checker(draft, number, layout, results)
            claims.append(checker.claim(keys))
    return tuple(claims)


def _stated(keys: Any) -> str | Stated | tuple[Stated, ...] | None:
    if isinstance(keys, StatedKeys):
        return _number(keys)
    return tuple(map(_number, keys)) if isinstance(keys, list) else keys


def _number(keys: StatedKeys) -> Stated:
    printed = keys.value if isinstance(keys.value, str) else ""
    value = float(printed_number(printed)) if printed else float(keys.value)
    return Stated(keys.of, value, keys.tolerance, keys.text, printed, keys.close)


class _Checker:
    """Checks one claim."""

    def __init__(
        self, draft: DraftConfig, number: int, layout: ResultLayout, results: PlaceholderResults | None
    ) -> None:
        self.draft, self.layout, self.results = draft, layout, results
        metrics = layout.metrics
        self.smoke = layout.end == 0
        self.of_runs = () if layout.has_runs else (*metrics, *COUNTS)
        self.series = [name for name in layout.series if name not in metrics]
        self.signals = [name for name in SIGNALS if name not in metrics]
        moments = {f"{moment}({signal})": signal for signal in self.signals for moment in MOMENTS.values()}
        seen = dict.fromkeys(moments.get(name, name) for name in self.series)
        # Without any design the series are not known, and no name can be refused.
        self.known = [*metrics, *COUNTS, *seen] if layout.is_complete or layout.arrays else []
        self.path: list[str | int] = ["claims", number]
        self.misplaced = False

    def claim(self, keys: ClaimKeys) -> Claim:
        check = (keys.check,) if isinstance(keys.check, str) else tuple(keys.check or ())
        claim = Claim(
            keys.says,
            keys.source,
            check,
            Finding(keys.finding) if keys.finding else None,
            _stated(keys.stated),
            tuple(keys.assumptions),
            self._at(keys.at),
            keys.at == "all",
            name=keys.id or "",
            quote=keys.quote or "",
            holds_for=HoldsFor(keys.holds_for),
            grounds=keys.grounds,
            elsewhere={name: Finding(text) for name, text in (keys.elsewhere or {}).items()},
            figures=(keys.figure,) if isinstance(keys.figure, str) else tuple(keys.figure or ()),
        )
        for text in check:
            self._terms(claim, text, "check", parse)
        for place, number in enumerate(claim.numbers):
            path = f"stated.{place}.of" if isinstance(keys.stated, list) else "stated.of"
            self._terms(claim, number.of, path, parse_expression)
            if number.tolerance is None and self._uses_runs(number.of):
                self._note(path, "is estimated from runs: give a tolerance")
        self._interpretations(claim)
        self._figures(claim)
        return claim

    def _interpretations(self, claim: Claim) -> None:
        """Check the number of interpretations, that every ground is that of one, and that a hedge has cases."""
        points = [point_words(at) for at in claim.at]
        for name in claim.grounds:
            if not self.misplaced and name not in points:
                self._note("grounds", unknown(name, points, "point of `at`"))
        # The points of a statement with a hedge are its cases; a wider search is an additional result.
        several = claim.of_paper and claim.holds_for is HoldsFor.ALL
        if several and len(points) > MAX_INTERPRETATIONS:
            way_out = "put a wider search under the source `additional result`"
            self._note(
                "at", f"at most {MAX_INTERPRETATIONS} interpretations of a statement (got {len(points)}); {way_out}"
            )
        if claim.holds_for is not HoldsFor.ALL and not claim.check:
            self._note("holds_for", "there is no check whose cases could hold")

    def _figures(self, claim: Claim) -> None:
        """Check that the claim names figures of the configuration."""
        if None in self.draft.figures:
            return
        known = figure_names(figure.kind for figure in self.draft.figures if figure is not None)
        for name in claim.figures:
            if name not in known:
                self._note("figure", unknown(name, known, "figure of this configuration"))

    def _uses_runs(self, text: str) -> bool:
        """Whether a value is estimated: from a column of several runs, or by moments that are not exact."""
        try:
            named = terms(parse_expression(text))
        except ExpressionError:
            return False
        # Those of the file: `--runs 2` of an experiment without randomness is no error of its claims.
        runs = self.draft.tree.get("runs")
        several = isinstance(runs, int) and runs > 1
        of_runs = [*self.layout.metrics, *COUNTS] if several else []
        of_runs += [] if "moments" in self.draft.keys.evaluate else self.signals
        return any(term.quantity in of_runs for term in named)

    def _note(self, key: str, message: str) -> None:
        self.draft.note([*self.path, *key.split(".")], message)

    def _at(self, given: Any) -> tuple[dict[str, str], ...]:
        """Read one point or a list of them; what names no point is reported."""
        if given is None:
            return ()
        if self.layout.points and not self.layout.points[0]:
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
            message = no_such_point(self.layout.points, at)
            if message:
                self._note("at", message)
            else:
                found.append(at)
        if not entries:
            self._note("at", "must name at least one point")
        self.misplaced = len(found) < len(entries) or not entries
        return tuple(found)

    def _terms(self, claim: Claim, text: str, key: str, grammar: Callable[[str], Node]) -> None:
        """Check that a text can be read, names what exists, and can be answered by some results."""
        before = len(self.draft.problems)
        try:
            tree = grammar(text)
        except ExpressionError as error:
            self._note(key, str(error))
            return
        named = sorted(terms(tree))
        for term in named:
            if self.layout.methods and term.method not in self.layout.methods:
                self._note(key, unknown(term.method, self.layout.methods, "method"))
            if self.known and term.quantity not in (*self.known, *self.signals):
                self._note(key, unknown(term.quantity, self.known, "metric or series of this configuration"))
        if any(term.quantity in self.of_runs for term in named):
            self._note(key, "no runs are evaluated; add `runs` to `evaluate`")
        for message in dict.fromkeys(self._moment(term, function) for term, function in sorted(uses(tree))):
            if message:
                self._note(key, message)
        if self.layout.points and not self.misplaced:
            for at in claim.at or ({},):
                counts = [self._place(claim, term, {**at, **dict(term.point)}, key) for term in named]
                if 0 not in counts and len(set(counts)) > 1:
                    self._note(key, "the terms are about different numbers of points")
        if len(self.draft.problems) == before and self.results is not None and not self.misplaced:
            how: dict[str, Any] = {"pooled": claim.pooled, "short": self.smoke}
            found = [dry_run(tree, self.results, at, **how) for at in claim.at or ({},)]
            for message in dict.fromkeys(message for messages in found for message in messages):
                self._note(key, message)

    def _moment(self, term: Term, function: str) -> str:
        """Say what is wrong with a signal, or with what stands in a function of signals; "" for nothing."""
        signal = term.quantity in self.signals
        if not self.known or not (signal or term.quantity in self.known):
            # An unknown name has been reported already.
            return ""
        message = misuse(term, function, signal=signal)
        if message or not signal:
            return message
        known = f"{MOMENTS[function]}({term.quantity})" in self.series
        return "" if known else unknown_moment(term, function)

    def _place(self, claim: Claim, term: Term, wanted: Mapping[str, str], key: str) -> int:
        """Count the points of a term: one, or in a pooled claim some; 0 when something is wrong with them."""
        what = f"{term.quantity}[{term.method}]"
        points, trials = self.layout.points, self.layout.trials
        if not points[0] and not wanted:
            return 1
        numbers = [number for number, point in enumerate(points) if lies_at(point, wanted)]
        if not numbers:
            self._note(key, f"{what}: {no_such_point(points, wanted)}")
            return 0
        if not trials:
            # With another error it is not known which trials the points share.
            return 1
        found = [points[number] for number in numbers]
        different = len({trials[number].get(term.method, "") for number in numbers})
        if not claim.pooled and different > 1:
            self._note(key, f"{what} may be at any of {len(found)} points of the sweep: {self._way_out(term, found)}")
            return 0
        if claim.pooled and len(found) > 1 and term.quantity in (*self.series, *self.signals):
            self._note(key, f"{what} is a series, of one point: {self._way_out(term, found)}")
            return 0
        if claim.pooled and different < len(found):
            self._note(key, f"{what} is the same at several points, and would count more than once: name one of them")
            return 0
        return len(found) if claim.pooled else 1

    def _way_out(self, term: Term, found: Sequence[Mapping[str, str]]) -> str:
        open_paths = [name for name in found[0] if len({point[name] for point in found}) > 1]
        example = ", ".join(f"{name}={found[0][name]}" for name in open_paths)
        if any(letter in example.replace(", ", "") for letter in "[],"):
            return "name one with `at`"
        return f"name one, as {term.quantity}[{term.method}, {example}], or give the claim an `at`"


def check_figures(draft: DraftConfig, layout: ResultLayout) -> None:
    """Report every figure option that the experiment cannot satisfy; of an incomplete layout only names are checked."""
    for number, component in enumerate(draft.figures):
        if component is None:
            continue
        figure: Figure | None = draft.problems.tried(component.build)
        if figure is None:
            continue
        for key, message in figure.check(layout) if layout.is_complete else figure.check_names(layout):
            draft.note(["figures", number, *([key] if key else [])], message)


Shapes = dict[str, tuple[int, ...]]


def layout_of(drafts: Sequence[DraftConfig], built: Sequence[Built], *, is_valid: bool, lenient: bool) -> ResultLayout:
    """Return the layout of the results that a configuration will have.

    A method may report a signal at some points only.  If the sweep has an error (not `is_valid`), its points are not
    known.  If lenient, figures may reach beyond the end of the runs, which are shorter than in the file.
    """
    points = [each.point for each in built if each.point is not None]
    is_complete = is_valid and len(points) == len(built)
    names: dict[str, Any] = {
        "methods": tuple(drafts[0].methods),
        "metrics": tuple(metric_names([*drafts[0].metrics, *built[0].calibration])),
        "points": tuple(draft.coordinates for draft in drafts) if is_valid else (),
        "trials": tuple(point.method_keys for point in points) if is_complete else (),
        "has_runs": "runs" in drafts[0].keys.evaluate,
        "tuned": tuple(drafts[0].searches),
    }
    experiments = [point.experiment for point in points]
    if not experiments:
        return ResultLayout(**names, is_complete=False)
    first = experiments[0]
    names["is_uncertain"] = any(stores_quantities(experiment) for experiment in experiments)
    arrays = {method.name: _series_of(method, first, drafts[0]) for method in first.methods}
    return ResultLayout(
        **names,
        signals=_signals(experiments),
        recorded=range(first.recording.n_runs),
        series={name: shape[1:] for shapes in arrays.values() for name, shape in shapes.items()},
        arrays=arrays,
        end=0.0 if lenient else first.n_steps * first.plant.Ts,
        Ts=first.plant.Ts,
        is_complete=is_valid,
    )


def _signals(experiments: Sequence[Experiment]) -> dict[str, dict[str, tuple[int, ...] | None]]:
    """Return method -> recorded signal -> shape of a sample, of whatever a method reports at some point."""
    plant, recording = experiments[0].plant, experiments[0].recording
    if not recording.n_runs:
        return {}
    known = {"y": (plant.ny,), "x": (plant.nx,), "x_hat": None, COVARIANCE: None, BURSTS: (1,)}
    known |= dict.fromkeys(("u", "u_command"), (plant.nu,))
    extra = {name: (1,) for name in plant.extra_signals}
    found: dict[str, dict[str, tuple[int, ...] | None]] = {}
    for experiment in experiments:
        for method in experiment.methods:
            shapes = {**known, **method.reports, **extra}
            kept = {name: shapes[name] for name in experiment.recording.signals if name in shapes}
            found[method.name] = found.get(method.name, {}) | kept
    return found


def _series_of(method: Method, experiment: Experiment, draft: DraftConfig) -> Shapes:
    """Return series -> shape, axis 0 = k, of a design and of the ensemble; the draft gets the errors of a design."""
    shapes: Shapes = {}
    try:
        shapes = {name: array.shape for name, array in design_series(method).items()}
    except DesignError as error:
        draft.note(["methods", method.name, "estimator"], str(error))
    if experiment.recording.ensemble:
        ensemble = _ensemble(experiment.plant.nx, method)
        shapes |= {name: (experiment.n_steps + 1, *entry) for name, entry in ensemble.items()}
    return shapes


def _ensemble(nx: int, method: Method) -> Shapes:
    """Return series of the ensemble -> shape of a sample."""
    x0 = method.estimator.x0
    x_hat = np.zeros((1, nx if x0 is None else len(x0) - method.n_disturbances))
    z = np.concatenate([np.zeros((1, nx)), x_hat], axis=1)
    return {name: array.shape[1:] for name, array in signals(Moments(z, z[:, :, None] * z[:, None]), nx).items()}
