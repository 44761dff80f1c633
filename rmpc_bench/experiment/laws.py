"""The laws of a configuration: uncertain quantities, noise, and where everything starts."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from rmpc_bench import registry
from rmpc_bench.experiment import quantities
from rmpc_bench.experiment.parts import read_part
from rmpc_bench.experiment.schema import shown, validate
from rmpc_bench.experiment.sheet import Law, Sheet
from rmpc_bench.experiment.yaml import Items, Map, locate
from rmpc_bench.simulation import distributions
from rmpc_bench.types import Matrix, NonNegative

_DISTRIBUTIONS: dict[str, type] = {
    "uniform": distributions.Uniform,
    "normal": distributions.Normal,
    "choice": distributions.Choice,
    "fixed": distributions.Fixed,
}


_SAME: Any = dict[str, NonNegative]
_CROSS: Any = float | list[list[float]]

_TAKEN = ("run", "pi", "sqrt", "sin", "cos")


def read_uncertainty(sheet: Sheet) -> None:
    """Read the laws of the named uncertain quantities."""
    for name, value in (sheet.values["uncertainty"] or {}).items():
        path: list[str | int] = ["uncertainty", name]
        if not re.fullmatch(r"[A-Za-z_]\w*", name):
            sheet.note(path, "a name starts with a letter and goes on with letters, digits and _", key=True)
        elif name in _TAKEN:
            sheet.note(path, f"{name!r} has a meaning already; choose another name", key=True)
        law = _distribution(sheet, value, path)
        if law is not None:
            sheet.uncertainty[name] = law


def _distribution(sheet: Sheet, value: Any, path: list[str | int]) -> distributions.Distribution | None:
    if isinstance(value, Map):
        kind = value.get("dist")
        if not isinstance(kind, str) or kind not in _DISTRIBUTIONS:
            sheet.note([*path, "dist"], registry.unknown(str(kind), _DISTRIBUTIONS, "distribution"))
            return None
        own = value.copy()
        del own["dist"]
        law: distributions.Distribution | None = validate(_DISTRIBUTIONS[kind], own, path, sheet.problems)
        return law
    try:
        spread = quantities.spread(value) if isinstance(value, str) else None
    except quantities.QuantityError as error:
        sheet.note(path, str(error))
        return None
    if spread is None:
        choices = ", ".join(_DISTRIBUTIONS)
        sheet.note(path, f"expected a spread such as +-10% or {{dist: ..}} with one of {choices} (got {shown(value)})")
        return None
    return distributions.Uniform(-spread, spread)


def read_noise(sheet: Sheet) -> None:
    """Read the noise that happens, per channel."""
    noise = sheet.section("noise")
    if not isinstance(noise, Map):
        noise = {"process": noise, "measurement": noise}
        paths: dict[str, list[str | int]] = {name: ["noise"] for name in noise}
        sheet.cross = "same" if sheet.section("noise") == "same" else None
    else:
        paths = {name: ["noise", name] for name in noise}
    for name, law in noise.items():
        if name == "cross":
            sheet.cross = law if law == "same" else sheet.checked(_CROSS, paths[name])
            if isinstance(sheet.cross, list) and len({len(row) for row in sheet.cross}) != 1:
                sheet.note(paths[name], "must be a number or a list of rows of the same length")
                sheet.cross = None
        elif name not in ("process", "measurement"):
            sheet.note(paths[name], registry.unknown(name, ("process", "measurement", "cross"), "key"), key=True)
        else:
            sheet.noise[name] = _laws(sheet, law, paths[name])


def _laws(sheet: Sheet, law: Any, path: list[str | int]) -> tuple[Law, ...]:
    """Read a law that may be a sum: its terms in order, none for `none` and for what is no law."""
    if not (isinstance(law, Map) and list(law) == ["sum"]):
        one = None if law == "none" else _law(sheet, law, path, ("none", "same", "sum"))
        return () if one is None else (one,)
    terms, path = law["sum"], [*path, "sum"]
    if not isinstance(terms, Items) or not terms:
        sheet.note(path, f"must be a list of laws (got {shown(terms)})")
        return ()
    return tuple(term for number, each in enumerate(terms) if (term := _term(sheet, each, [*path, number])) is not None)


def _term(sheet: Sheet, law: Any, path: list[str | int]) -> Law | None:
    """Read one law of a sum, which is neither a sum nor nothing."""
    if isinstance(law, Map) and "sum" in law:
        sheet.note(path, "a sum inside a sum; write all terms into one list")
    elif law == "none":  # the number of a term names its stream, and a term that is not there has none
        sheet.note(path, "'none' adds nothing; leave it out, or silence a law with scale: 0 (or radius: 0)")
    else:
        return _law(sheet, law, path, ("same",))
    return None


def _law(sheet: Sheet, law: Any, path: list[str | int], words: tuple[str, ...]) -> Law | None:
    """Read one noise law; None for what is not one.

    Parameters
    ----------
    sheet : gets what is wrong
    law : what the configuration says
    path : where it stands
    words : laws without a design function that may stand there
    """
    if law == "same":
        return Law(None, 1.0)
    kinds = registry.names("noises")
    if law in kinds:
        sheet.note(path, f"{law!r} needs its parameters: {{{law}: {{..}}}} (rmpc-bench describe noises/{law})")
        return None
    if law == "sum":
        sheet.note(path, "'sum' needs its terms: {sum: [{..}, {..}]}")
        return None
    if isinstance(law, Map) and len(law) > 1 and set(law) <= {"same", *kinds}:
        sheet.note(path, f"laws add up as a list: {{sum: [{', '.join(f'{{{kind}: ..}}' for kind in law)}]}}")
        return None
    if not isinstance(law, Map) or len(law) != 1 or next(iter(law)) not in ("same", *kinds):
        named = next(iter(law)) if isinstance(law, Map) and len(law) == 1 else law
        text = named if isinstance(named, str) else shown(law)
        known = [each for each in (*words, *kinds) if each != text]  # {none: {}} does not mean none
        sheet.note(path, registry.unknown(text, known, "noise law", "rmpc-bench list noises"))
        return None
    kind, value = next(iter(law.items()))
    if kind == "same":
        return _same(sheet, law, [*path, kind])
    part = read_part("noises", value, [*path, kind], sheet.problems, mark=locate(law, [kind]), kind=kind)
    return None if part is None else Law(part, None)


def _same(sheet: Sheet, law: Map, path: list[str | int]) -> Law | None:
    """Read the model's own noise times a scale."""
    scale = validate(_SAME, law["same"], path, sheet.problems, mark=locate(law, ["same"]))
    if scale is not None and set(scale) - {"scale"}:
        sheet.note(path, "the only key is 'scale'")
    return None if scale is None else Law(None, scale.get("scale", 1.0))


_Vector = float | list[float]
_INITIAL: Mapping[str, Any] = {"x": _Vector, "x_hat": _Vector, "P": Matrix, "M": Matrix}


def read_initial(sheet: Sheet) -> None:
    """Read the true initial state and the start of the estimators."""
    initial = sheet.values["initial"] or {}
    sheet.initial = {"x": 0.0, "x_hat": 0.0, "P": "process", "M": 0.0, "laws": ()}
    for name, value in initial.items():
        path: list[str | int] = ["initial", name]
        if name not in _INITIAL:
            sheet.note(path, registry.unknown(name, _INITIAL, "key"), key=True)
        elif name == "x" and isinstance(value, Map):
            sheet.initial["laws"] = _laws(sheet, value, path)
        elif name != "P" or value != "process":
            sheet.initial[name] = sheet.checked(_INITIAL[name], path)
