"""Where the parameters of methods come from, in words: tuned, as published, or default."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from rmpc_bench.types.tuning import NOTHING_TUNED

if TYPE_CHECKING:
    from rmpc_bench.analysis.trials import Trials

TUNED = "tuned"
"""First word of what is said of a tuned method, such as ``tuned (budget 16, 40 runs)``."""
_HERE = f"{TUNED} ("
"""How this begins where the tuning was for these settings."""


def is_tuned(trials: Trials, method: str) -> bool:
    """Whether the parameters of a method were tuned for this experiment."""
    return trials.parameters.get(method, "").startswith(_HERE)


def parameter_text(trials: Trials, method: str) -> str:
    """Say where the parameters of a method come from; empty where it is not known.

    Such as "as published, not tuned", "tuned (budget 16, 40 runs)" or "default (nothing could be tuned)".
    """
    word = trials.parameters.get(method, "")
    return word if not word or word.startswith(TUNED) or word.endswith(NOTHING_TUNED) else f"{word}, not tuned"


def untuned_text(trials: Trials, method: str) -> str:
    """Say where the parameters of a method come from if they were not tuned; empty for a tuned method."""
    return "" if is_tuned(trials, method) else parameter_text(trials, method)


def pair_text(trials: Trials, method: str, baseline: str) -> str:
    """Say where the parameters of two compared methods come from, once where both are alike.

    The text is such as "both default, not tuned" or "WKF: tuned (budget 16, 40 runs), S-MPC: default, not tuned"; empty
    where it is not known.
    """
    first, second = parameter_text(trials, method), parameter_text(trials, baseline)
    if not second:
        return ""
    if first == second:
        return f"both {second}"
    return ", ".join(f"{name}: {word}" for name, word in ((method, first), (baseline, second)) if word)


def parameter_groups(trials: Trials, methods: Sequence[str]) -> dict[str, list[str]]:
    """Return what is said of parameters -> the methods of which it is said, in their order.

    Parameters
    ----------
    trials : the table of trials
    methods : names of methods; those of which nothing is known are left out
    """
    found: dict[str, list[str]] = {}
    for method in methods:
        if word := parameter_text(trials, method):
            found.setdefault(word, []).append(method)
    return found


def parameter_cells(trials: Trials, methods: Sequence[str]) -> list[str]:
    """Return ``tuned``, ``default`` or ``as published`` for every method; nothing where all methods are alike.

    Where methods were tuned with different budgets, each has its own, such as ``tuned (budget 9, 50 runs)``.
    """
    words = [trials.parameters.get(method, "-") for method in methods]
    if len(_tuned_words(trials)) == 1:
        words = [TUNED if word.startswith(_HERE) else word for word in words]
    return words if len(set(words)) > 1 else []


def parameter_legend(trials: Trials) -> list[str]:
    """Return the parts of the legend of a table of comparisons that say where parameters come from.

    One text where all methods are alike; else the protocol of the tuned ones, and the word of a baseline that is not
    tuned; nothing where it is not known.
    """
    groups = parameter_groups(trials, trials.methods)
    if len(groups) == 1:
        return [f"parameters: {word}" for word in groups]
    words = _tuned_words(trials)
    # Otherwise the column has each of them.
    tuned = [f"tuned = {word.removeprefix(TUNED).strip(' ()')}" for word in words] if len(words) == 1 else []
    baseline = untuned_text(trials, trials.baseline)
    return [*tuned, *([f"{trials.baseline}: {baseline}"] if baseline else [])]


def _tuned_words(trials: Trials) -> list[str]:
    """Return what is said of tuned methods, each word once."""
    words = [trials.parameters.get(method, "") for method in trials.methods]
    return list(dict.fromkeys(word for word in words if word.startswith(_HERE)))
