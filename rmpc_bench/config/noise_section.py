"""Reads the sections `uncertainty`, `noise` and `initial` of a configuration."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BeforeValidator

from rmpc_bench import registry
from rmpc_bench.components.reference import is_reference
from rmpc_bench.config.draft import DraftConfig, NoiseTerm
from rmpc_bench.config.same_law import SameLaw
from rmpc_bench.config_file.component import read_component
from rmpc_bench.config_file.keys import shown, validate
from rmpc_bench.config_file.tree import FILE, Items, Map, locate
from rmpc_bench.expressions import quantity
from rmpc_bench.noise import distributions
from rmpc_bench.types import Matrix

DISTRIBUTIONS: dict[str, type] = {
    "uniform": distributions.Uniform,
    "normal": distributions.Normal,
    "choice": distributions.Choice,
    "fixed": distributions.Fixed,
}
"""Laws of an uncertain quantity by their `dist`."""


_CROSS: Any = float | list[list[float]]

_TAKEN = ("run", "pi", "sqrt", "sin", "cos")
SCALE = "scale"
"""Key of `uncertainty` that is no quantity: the factor on the spread of all of them."""


def uncertain_names(draft: DraftConfig) -> list[str]:
    """Return the names of the uncertain quantities of a configuration."""
    return [name for name in draft.values["uncertainty"] or {} if name != SCALE]


def read_uncertainty(draft: DraftConfig) -> None:
    """Read the distributions of the uncertain quantities and the scale of their spread."""
    section = draft.values["uncertainty"] or {}
    if SCALE in section:
        _read_scale(draft, section[SCALE])
    for name in uncertain_names(draft):
        value = section[name]
        path: list[str | int] = ["uncertainty", name]
        if not re.fullmatch(r"[A-Za-z_]\w*", name):
            draft.note(path, "a name consists of letters, digits and _, and begins with a letter or _", key=True)
        elif name in _TAKEN:
            draft.note(path, f"{name!r} is reserved; choose another name", key=True)
        law = _distribution(draft, value, path)
        if law is not None:
            draft.laws[name] = law


def _read_scale(draft: DraftConfig, value: Any) -> None:
    """Read the factor on the spread of all quantities; a law under its name is a quantity with a reserved name."""
    path: list[str | int] = ["uncertainty", SCALE]
    try:
        # `+-10%` would be read as the number -0.1.
        factor = None if isinstance(value, str) and quantity.spread(value) is not None else quantity.number(value)
    except quantity.QuantityError:
        factor = None
    if factor is None or factor < 0:
        message = "is the factor on the spread of all quantities, a number >= 0"
        hint = "; choose another name for a quantity" if factor is None else ""
        draft.note(path, f"{message} (got {shown(value)}){hint}")
    elif not uncertain_names(draft):
        draft.note(path, "has no effect: no uncertain quantity is named", key=True)
    else:
        draft.scale = factor


def _distribution(draft: DraftConfig, value: Any, path: list[str | int]) -> distributions.Distribution | None:
    if isinstance(value, Map):
        kind = value.get("dist")
        if not isinstance(kind, str) or kind not in DISTRIBUTIONS:
            draft.note([*path, "dist"], registry.unknown(str(kind), DISTRIBUTIONS, "distribution"))
            return None
        own = value.copy()
        del own["dist"]
        law: distributions.Distribution | None = validate(DISTRIBUTIONS[kind], own, path, draft.problems)
        return law
    try:
        spread = quantity.spread(value) if isinstance(value, str) else None
    except quantity.QuantityError as error:
        draft.note(path, str(error))
        return None
    if spread is None:
        choices = ", ".join(DISTRIBUTIONS)
        draft.note(path, f"expected a range such as +-10% or {{dist: ..}} with one of {choices} (got {shown(value)})")
        return None
    return distributions.Uniform(-spread, spread)


def read_noise(draft: DraftConfig) -> None:
    """Read the noise of the plant, per channel."""
    noise = draft.section("noise")
    if not isinstance(noise, Map):
        noise = {"process": noise, "measurement": noise}
        paths: dict[str, list[str | int]] = {name: ["noise"] for name in noise}
        draft.cross = "same" if draft.section("noise") == "same" else None
    else:
        paths = {name: ["noise", name] for name in noise}
    for name, law in noise.items():
        if name == "cross":
            draft.cross = law if law == "same" else draft.checked(_CROSS, paths[name])
            if isinstance(draft.cross, list) and len({len(row) for row in draft.cross}) != 1:
                draft.note(paths[name], "must be a number or a list of rows of the same length")
                draft.cross = None
        elif name not in ("process", "measurement"):
            message = registry.unknown(name, ("process", "measurement", "cross"), "key")
            if name in registry.names("noises"):
                message = f"a law is given per channel: {{process: {{{name}: ..}}, measurement: {{{name}: ..}}}}"
            draft.note(paths[name], message, key=True)
        else:
            draft.noise[name] = _laws(draft, law, paths[name])


def _laws(draft: DraftConfig, law: Any, path: list[str | int]) -> tuple[NoiseTerm, ...]:
    """Read a noise law that may be a sum: its terms in order; no terms for `none` and for an invalid law."""
    if not (isinstance(law, Map) and list(law) == ["sum"]):
        one = None if law == "none" else _law(draft, law, path, ("none", "same", "sum"))
        return () if one is None else (one,)
    terms, path = law["sum"], [*path, "sum"]
    if not isinstance(terms, Items) or not terms:
        draft.note(path, f"must be a list of laws (got {shown(terms)})")
        return ()
    return tuple(term for number, each in enumerate(terms) if (term := _term(draft, each, [*path, number])) is not None)


def _term(draft: DraftConfig, law: Any, path: list[str | int]) -> NoiseTerm | None:
    """Read one term of a sum, which may be neither a sum nor `none`."""
    if isinstance(law, Map) and "sum" in law:
        draft.note(path, "a sum inside a sum; write all terms into one list")
    elif law == "none":
        # The number of a term names its random stream, so that a term without noise is still a term.
        draft.note(path, "'none' adds nothing; leave it out, or switch a law off with scale: 0 (or radius: 0)")
    else:
        return _law(draft, law, path, ("same",))
    return None


def _law(draft: DraftConfig, law: Any, path: list[str | int], words: tuple[str, ...]) -> NoiseTerm | None:
    """Read one noise law; None where it is invalid.

    `words` are the laws without a design function that are allowed there.
    """
    if law == "same":
        return NoiseTerm(None, SameLaw())
    kinds = registry.names("noises")
    if law in kinds:
        draft.note(path, f"{law!r} needs its parameters: {{{law}: {{..}}}} (rmpc-bench describe noises/{law})")
        return None
    if law == "sum":
        draft.note(path, "'sum' needs its terms: {sum: [{..}, {..}]}")
        return None
    if isinstance(law, Map) and len(law) > 1 and set(law) <= {"same", *kinds}:
        draft.note(path, f"laws add up as a list: {{sum: [{', '.join(f'{{{kind}: ..}}' for kind in law)}]}}")
        return None
    if isinstance(law, Map) and (FILE in law or is_reference(law.get("kind"))):
        component = read_component("noises", law, path, draft.problems, mark=law.mark, access=draft.access)
        return None if component is None else NoiseTerm(component, None)
    if not isinstance(law, Map) or len(law) != 1 or next(iter(law)) not in ("same", *kinds):
        if isinstance(law, int | float):
            draft.note(path, f"a number is no noise law; write {{gaussian: {{std: {law:g}}}}}, or cov for a variance")
            return None
        named = next(iter(law)) if isinstance(law, Map) and len(law) == 1 else law
        text = named if isinstance(named, str) else shown(law)
        # {none: {}} does not mean none.
        known = [each for each in (*words, *kinds) if each != text]
        draft.note(path, registry.unknown(text, known, "noise law", "rmpc-bench list noises"))
        return None
    kind, value = next(iter(law.items()))
    if kind == "same":
        return _same(draft, law, [*path, kind])
    component = read_component(
        "noises", value, [*path, kind], draft.problems, mark=locate(law, [kind]), kind=kind, access=draft.access
    )
    return None if component is None else NoiseTerm(component, None)


def _same(draft: DraftConfig, law: Map, path: list[str | int]) -> NoiseTerm | None:
    """Read the noise of the design model with a departure from it."""
    found: SameLaw | None = validate(SameLaw, law["same"], path, draft.problems, mark=locate(law, ["same"]))
    return None if found is None else NoiseTerm(None, found)


_Vector = float | list[float]
_Start: Any = float | list[Annotated[Any, BeforeValidator(quantity.with_unit)]]
_INITIAL: Mapping[str, Any] = {"x": _Start, "x_hat": _Vector, "P": Matrix, "M": Matrix}


def read_initial(draft: DraftConfig) -> None:
    """Read the true initial state and the initial estimate."""
    initial = draft.values["initial"] or {}
    draft.initial = {"x": 0.0, "x_hat": 0.0, "P": "process", "M": 0.0, "laws": ()}
    for name, value in initial.items():
        path: list[str | int] = ["initial", name]
        if name not in _INITIAL:
            draft.note(path, registry.unknown(name, _INITIAL, "key"), key=True)
        elif name == "x" and isinstance(value, Map):
            draft.initial["laws"] = _laws(draft, value, path)
        elif name != "P" or value != "process":
            draft.initial[name] = draft.checked(_INITIAL[name], path)
    if isinstance(draft.initial["x"], list):
        draft.start_units = [unit for _, unit in draft.initial["x"]]
        draft.initial["x"] = [number for number, _ in draft.initial["x"]]
