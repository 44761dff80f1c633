"""The keys `noise`, `uncertainty` and `initial`: how they are read, and the noise of the plant that is made of them."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator

from rmpc_bench import registry
from rmpc_bench.components.reference import is_reference
from rmpc_bench.config.draft import DraftConfig, Initial, NoiseSection, NoiseTerm, SameLaw, Uncertainty
from rmpc_bench.config_file.component import Component, read_component
from rmpc_bench.config_file.keys import shown, validate
from rmpc_bench.config_file.tree import FILE, Items, Map, error_at, locate
from rmpc_bench.expressions import quantity
from rmpc_bench.models.dynamics import noise_of_plant
from rmpc_bench.noise import distributions
from rmpc_bench.noise.bounded import ellipsoid
from rmpc_bench.noise.measurement import Missing
from rmpc_bench.simulation.scenario import Scenario, with_cross_covariance
from rmpc_bench.types import Array, DesignError, Matrix, Noise, Plant

DISTRIBUTIONS: dict[str, type] = {
    "uniform": distributions.Uniform,
    "normal": distributions.Normal,
    "choice": distributions.Choice,
    "fixed": distributions.Fixed,
    "lognormal": distributions.Lognormal,
    "triangular": distributions.Triangular,
}  # laws of an uncertain quantity by their `dist`
GROUPS: dict[str, type] = {"normal": distributions.NormalGroup, "choice": distributions.ChoiceGroup}
"""Laws of several quantities with the key `of`, by their `dist`."""


_CROSS: Any = float | list[list[float]]

_TAKEN = ("run", *quantity.RESERVED)
UNCERTAIN_MATRIX = "an uncertain entry of A is written with the kind uncertain-linear (H_A, G_x)"
SCALE = "scale"  # key of `uncertainty` that is no quantity: the factor on the spread of all of them


def uncertain_names(tree: Map) -> list[str]:
    """Return the names of the uncertain quantities of a configuration."""
    section = tree.get("uncertainty")
    given = section if isinstance(section, Map) else {}
    return [each for name in given if name != SCALE for each in _names_of(given[name]) or [name]]


def _names_of(value: Any) -> list[str]:
    """Return the names of the quantities of a group; none for the law of one quantity."""
    of = value.get("of") if isinstance(value, Map) else None
    return [each for each in of if isinstance(each, str)] if isinstance(of, Items) else []


def read_uncertainty(draft: DraftConfig) -> Uncertainty:
    """Read the distributions of the uncertain quantities and the scale of their spread."""
    section = draft.keys.uncertainty or {}
    laws: dict[str, distributions.UncertainLaw] = {}
    taken: set[str] = set()
    for name in section:
        if name == SCALE:
            continue
        path: list[str | int] = ["uncertainty", name]
        _check_name(draft, name, path, taken)
        for number, each in enumerate(_names_of(section[name])):
            _check_name(draft, each, [*path, "of", number], taken)
        law = draft.problems.tried(_distribution, draft.tree, section[name], path)
        if law is not None:
            laws[name] = law
    return Uncertainty(laws, _scale(draft, section[SCALE]) if SCALE in section else 1.0)


def _check_name(draft: DraftConfig, name: str, path: list[str | int], taken: set[str]) -> None:
    """Report a name that a quantity or a group cannot have."""
    key = "of" not in path[2:]
    if not re.fullmatch(r"[A-Za-z_]\w*", name):
        draft.note(path, "a name consists of letters, digits and _, and begins with a letter or _", key=key)
    elif name in _TAKEN or (name == SCALE and not key):
        draft.note(path, f"{name!r} is reserved; choose another name", key=key)
    elif name in taken:
        draft.note(path, f"{name!r} is the name of another quantity or group; choose another name", key=key)
    taken.add(name)


def _scale(draft: DraftConfig, value: Any) -> float:
    """Read the factor on the spread of all quantities; a law under its name is a quantity with a reserved name."""
    path = ["uncertainty", SCALE]
    try:
        # `+-10%` would be read as the number -0.1.
        factor = None if isinstance(value, str) and quantity.spread(value) is not None else quantity.number(value)
    except quantity.QuantityError:
        factor = None
    if factor is not None and factor >= 0:
        if not uncertain_names(draft.tree):
            draft.note(path, "has no effect: no uncertain quantity is named", key=True)
        return factor
    message = "is the factor on the spread of all quantities, a number >= 0"
    hint = "; choose another name for a quantity" if factor is None else ""
    draft.note(path, f"{message} (got {shown(value)}){hint}")
    return 1.0


def _distribution(tree: Map, value: Any, path: list[str | int]) -> distributions.UncertainLaw:
    """Read the law of a quantity or of a group; a ConfigError has what is wrong."""
    if isinstance(value, Map):
        kind, known = value.get("dist"), GROUPS if "of" in value else DISTRIBUTIONS
        if "dist" not in value:
            wrong = [key for key in value if key in ("kind", "law", "type", "distribution")][:1]
            text = f"{wrong[0]!r} is not a known key; did you mean 'dist'?" if wrong else "needs the key `dist`"
            raise error_at(tree, [*path, *wrong], f"{text} (one of {', '.join(known)})", key=bool(wrong))
        if not isinstance(kind, str) or kind not in known:
            noun = "distribution" if known is DISTRIBUTIONS else "distribution of several quantities"
            raise error_at(tree, [*path, "dist"], registry.unknown(str(kind), known, noun))
        if known is GROUPS and not _names_of(value):
            raise error_at(tree, [*path, "of"], "must be a list of names")
        own = value.copy()
        del own["dist"]
        law: distributions.UncertainLaw = validate(known[kind], own, path)
        return law
    try:
        spread = quantity.spread(value) if isinstance(value, str) else None
    except quantity.QuantityError as error:
        raise error_at(tree, path, str(error)) from None
    if spread is None:
        choices = f"{{dist: ..}} with one of {', '.join(DISTRIBUTIONS)}"
        raise error_at(tree, path, f"expected a range such as +-10% or {choices} (got {shown(value)})")
    return distributions.Uniform(-spread, spread)


def read_noise(draft: DraftConfig) -> NoiseSection:
    """Read the noise of the plant, per channel."""
    given = draft.section("noise")
    if not isinstance(given, Map):
        law = _laws(draft, given, ["noise"])
        return NoiseSection({"process": law, "measurement": law}, "same" if given == "same" else None)
    channels: dict[str, tuple[NoiseTerm, ...]] = {}
    for name, law in given.items():
        if name in ("process", "measurement", "input"):
            channels[name] = _laws(draft, law, ["noise", name])
        elif name != "cross":
            message = registry.unknown(name, ("process", "measurement", "input", "cross"), "key")
            if name in registry.names("noises"):
                message = f"a law is given per channel: {{process: {{{name}: ..}}, measurement: {{{name}: ..}}}}"
            draft.note(["noise", name], message, key=True)
    cross = given.get("cross")
    if "cross" in given and cross != "same":
        cross = draft.checked(_CROSS, ["noise", "cross"])
    if isinstance(cross, list) and len({len(row) for row in cross}) != 1:
        draft.note(["noise", "cross"], "must be a number or a list of rows of the same length")
        cross = None
    return NoiseSection(channels, cross)


def _laws(draft: DraftConfig, law: Any, path: list[str | int]) -> tuple[NoiseTerm, ...]:
    """Read a noise law that may be a sum: its terms in order; no terms for `none` and for an invalid law."""
    if law == "none":
        return ()
    if not (isinstance(law, Map) and list(law) == ["sum"]):
        one = draft.problems.tried(_law, draft, law, path, ("none", "same", "sum"))
        return () if one is None else (one,)
    terms, path = law["sum"], [*path, "sum"]
    if not isinstance(terms, Items) or not terms:
        draft.note(path, f"must be a list of laws (got {shown(terms)})")
        return ()
    found = [draft.problems.tried(_term, draft, each, [*path, number]) for number, each in enumerate(terms)]
    return tuple(term for term in found if term is not None)


def _term(draft: DraftConfig, law: Any, path: list[str | int]) -> NoiseTerm:
    """Read one term of a sum, which may be neither a sum nor `none`."""
    if isinstance(law, Map) and "sum" in law:
        raise error_at(draft.tree, path, "a sum inside a sum; write all terms into one list")
    if law == "none":
        # The number of a term names its random stream, so that a term without noise is still a term.
        message = "'none' adds nothing; leave it out, or switch a law off with scale: 0 (or radius: 0)"
        raise error_at(draft.tree, path, message)
    return _law(draft, law, path, ("same",))


def _law(draft: DraftConfig, law: Any, path: list[str | int], words: tuple[str, ...]) -> NoiseTerm:
    """Read one noise law; `words` are those without a design function that are allowed there."""
    if law == "same":
        return NoiseTerm(None, SameLaw())
    if isinstance(law, Map) and (FILE in law or is_reference(law.get("kind"))):
        return NoiseTerm(read_component("noises", law, path, mark=law.mark, access=draft.access), None)
    if message := _no_law(law, words):
        raise error_at(draft.tree, path, message)
    [(kind, value)] = law.items()
    mark, path = locate(law, [kind]), [*path, kind]
    if kind == "delayed" and not isinstance(value, Map):
        value = Map({"samples": value}, mark=mark, value_marks={"samples": mark})
    if kind == "same":
        return NoiseTerm(None, validate(SameLaw, value, path, mark=mark))
    return NoiseTerm(read_component("noises", value, path, mark=mark, kind=kind, access=draft.access), None)


def _no_law(law: Any, words: tuple[str, ...]) -> str:
    """Say why a value is not a law with its parameters; empty where it is one."""
    kinds = registry.names("noises")
    if law == "sum":
        return "'sum' needs its terms: {sum: [{..}, {..}]}"
    if isinstance(law, str) and law in kinds:
        return f"{law!r} needs its parameters: {{{law}: {{..}}}} (rmpc-bench describe noises/{law})"
    if isinstance(law, Items):
        return "a list of laws is written {sum: [..]}"
    if isinstance(law, int | float):
        return f"a number is no noise law; write {{gaussian: {{std: {law:g}}}}}, or cov for a variance"
    given = [*law] if isinstance(law, Map) else []
    if given and {*given} <= {"same", *kinds}:
        several = f"laws add up as a list: {{sum: [{', '.join(f'{{{kind}: ..}}' for kind in given)}]}}"
        return several if len(given) > 1 else ""
    named = given[0] if len(given) == 1 else law
    text = named if isinstance(named, str) else shown(law)
    # {none: {}} does not mean none.
    known = [each for each in (*words, *kinds) if each != text]
    return registry.unknown(text, known, "noise law", "rmpc-bench list noises")


_Vector = float | list[float]
_Start: Any = float | list[Annotated[Any, BeforeValidator(quantity.with_unit)]]
_INITIAL: Mapping[str, Any] = {"x": _Start, "x_hat": _Vector, "P": Matrix, "M": Matrix}


def read_initial(draft: DraftConfig) -> Initial:
    """Read the true initial state and the initial estimate."""
    found: dict[str, Any] = {}
    for name, value in (draft.keys.initial or {}).items():
        path: list[str | int] = ["initial", name]
        if name not in _INITIAL:
            draft.note(path, registry.unknown(name, _INITIAL, "key"), key=True)
        elif name == "x" and isinstance(value, Map):
            found["laws"] = _laws(draft, value, path)
        elif name != "P" or value != "process":
            found[name] = draft.checked(_INITIAL[name], path)
    if isinstance(found.get("x"), list):
        found["units"] = tuple(unit for _, unit in found["x"])
        found["x"] = [number for number, _ in found["x"]]
    return Initial(**found)


class NoiseLaws:
    """Builds the noise of a draft; errors are added to its problems.

    `model` returns the default design model, whose noise is `same`; None where it cannot be built.  A spectral density
    is sampled with the equations of the plant, around the operating point of that model.
    """

    def __init__(self, draft: DraftConfig, model: Callable[[], Any], plant: Plant) -> None:
        self.draft, self.model, self.plant = draft, model, plant

    def terms(
        self, laws: tuple[NoiseTerm, ...], n: int, channel: str, names: Sequence[str] | None = None
    ) -> tuple[Noise, ...]:
        """Build the terms of a sum for a vector of length n.

        The channel is that of `noise`, or ``initial``, the deviation of the true initial state.  Laws that
        alter a signal get the names of its components; without them it has n.
        """
        found: list[Noise] = []
        for term in laws:
            if term.same is not None:
                found += self._same(term.same, n, channel)
            elif term.law is not None:
                found += self.draft.problems.tried(self._built, term.law, n, channel, names) or []
        return tuple(found)

    def _built(self, law: Component, n: int, channel: str, names: Sequence[str] | None) -> list[Noise]:
        signal = {"ny": n} if names is None else {"ny": len(names), "signal_names": names}
        made: Noise = law.build(n=n, **signal, Ts=self.draft.time.step, sampled=partial(self._sampled, channel))
        reason, key = _unfit(made, law.kind, channel)
        if reason:
            raise law.error(reason, key)
        return [made]

    def _sampled(self, channel: str, density: Array) -> Array:
        """Return the covariance of a sample of white noise with a spectral density."""
        if channel == "initial":
            raise DesignError("an initial state is a single sample; give std or cov", "density")
        if channel == "input":
            raise DesignError("an input is held between two samples; give std or cov", "density")
        model = None if self.draft.model is None else self.model()
        point = None if model is None else model.operating_point
        return noise_of_plant(self.plant, point, density, self.draft.time.step, measured=channel == "measurement")

    def _same(self, same: SameLaw, n: int, channel: str) -> list[Noise]:
        """Build the noise of the design model: the stochastic part, and a set where the model has one."""
        path: list[str | int] = ["initial", "x"] if channel == "initial" else ["noise"]
        if channel == "input":
            self.draft.note([*path, channel], "the design model has no noise of the input")
            return []
        model = self._common_model(path)
        if model is None:
            return []
        mean, cov, shape = _model_law(model, n, channel)
        if channel != "initial" and _varies(model, channel, self.draft.time.n_steps):
            message = f"'same' must be one law at all k, but the {channel} noise of the design model changes with k"
        elif len(cov) != n:
            message = f"'same' gives {len(cov)} components of {channel} noise; the plant has {n}"
        else:
            first = same.noise(mean, cov)
            return [first, ellipsoid(n, shape=shape, scale=same.scale)] if np.any(shape) else [first]
        self.draft.note(path, message)
        return []

    def _common_model(self, path: list[str | int]) -> Any:
        """Return the design model of all methods; None, with an error at the path, where there is none."""
        if "model" not in self.draft.tree:
            self.draft.note(path, "'same' is the law of the common design model: 'model' is missing")
        return self.model()

    def refuse_names(self, scenario: Scenario) -> None:
        """Refuse uncertain quantities with the name of a quantity of random bursts: both are columns of one table."""
        for name in sorted({*scenario.burst_names} & {*scenario.quantities}):
            message = f"{name!r} is the name of a quantity of the random bursts; choose another name"
            self.draft.note(["uncertainty", name], message, key=True)

    def correlated(self, plant: Plant, scenario: Scenario) -> Scenario:
        """Return a scenario of independent noises with their cross-covariance; their sizes are those of the plant."""
        cross = self.draft.noise.cross
        if cross == "same":
            model = self._common_model(["noise"])
            cross = None if model is None else model.S
        if cross is None or not np.any(cross):
            return scenario
        try:
            return with_cross_covariance(scenario, np.atleast_2d(np.array(cross, dtype=float)), plant.nw, plant.nv)
        except DesignError as error:
            given = self.draft.tree.get("noise")
            is_given = isinstance(given, Mapping) and "cross" in given
            self.draft.note(["noise", "cross"] if is_given else ["noise"], str(error))
            return scenario


def _unfit(law: Noise, kind: str, channel: str) -> tuple[str, str]:
    """Return why a law cannot be one of a channel, and the key with the error; empty where it can."""
    if law.alters_output and channel not in ("measurement", "input"):
        return f"{kind!r} alters a signal; put it under noise.measurement or noise.input", ""
    if channel == "measurement" and isinstance(law, Missing) and law.known is not None:
        return "an estimator always sees which measurements are missing: `known` is a key of the channel input", "known"
    if channel == "initial" and law.has_bursts:
        return "an initial state has no bursts", "bursts"
    if channel == "initial" and not law.is_white:
        return f"an initial state is a single sample, and {kind!r} describes a correlation over time; use gaussian", ""
    return "", ""


def _model_law(model: Any, n: int, channel: str) -> tuple[Array, Array, Any]:
    """Return mean, covariance and set (its shape, or 0) of a noise of the design model."""
    if channel == "initial":
        # The covariance of the process noise, as `P: process`; states that the design model lacks start at their mean.
        return np.zeros(n), np.pad(model.Q_w, (0, max(0, n - len(model.Q_w)))), 0.0
    mean, cov = model.v_law if channel == "measurement" else model.w_law
    if not model.has_sets:
        return mean, cov, 0.0
    return mean, cov, model.M_v(0) if channel == "measurement" else model.M_w(0)


def _varies(model: Any, channel: str, n_steps: int) -> bool:
    """Whether a noise of the design model depends on k: that of a model with sets, or of one with bursts."""
    if channel == "measurement" and model.R_v_varies:
        return True
    if not model.has_sets:
        return False

    def at(k: int) -> tuple[Array, Array]:
        now = model.at(k)
        return (now.Q_w, model.M_w(k)) if channel == "process" else (now.R_v, model.M_v(k))

    pairs = ((a, b) for k in range(1, n_steps + 1) for a, b in zip(at(0), at(k), strict=True))
    return any(a is not b and not np.array_equal(a, b) for a, b in pairs)
