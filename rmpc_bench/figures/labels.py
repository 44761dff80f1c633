"""Text in figures: formulas where matplotlib can set them, units, lines that fit into their place, and captions.

A caption is plain text with formulas as ``$..$``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from rmpc_bench.figures.style import FONT_SIZE, LINE_HEIGHT, font_family, has_labels, style

if TYPE_CHECKING:
    from rmpc_bench.analysis.trials import Trials
    from rmpc_bench.types import MetricInfo


MOST_LINES, COLUMN_PAD, LONGEST_TURNED = 3, 3.0, 90.0
"""Lines of the name of a column, free space beside it, and width of a turned one [pt]."""
GREEK = {"theta": "theta", "lam": "lambda", "gamma": "gamma", "rho": "rho", "Lambda": "Lambda", "Pi": "Pi"}
ACCENTS = ("hat", "breve")
DID_NOT_OCCUR = "did not occur"
"""Words for a metric value of inf, such as the settling time of a run that did not settle."""
ESTIMATE = ", estimate"  # behind the name of a state whose estimate is shown
LINEAR = "\n(linear: some <= 0)"  # remark at an axis that cannot be logarithmic


def metric_of(trials: Trials, name: str | None) -> MetricInfo:
    """Return the metric of a name; the first one for None."""
    return next(info for info in trials.metrics if name in (None, info.name))


def metric_label(info: MetricInfo) -> str:
    """Label an axis with a metric and its unit."""
    return with_unit(typeset(info.words), info.unit)


def unit_of(trials: Trials, component: str) -> str:
    """Return the unit of a component such as ``y.2``: its own, else that of the signal."""
    return trials.units.get(component, trials.units.get(component.partition(".")[0], ""))


def component_label(trials: Trials, signal: str, component: int, place: str) -> str:
    """Label an axis with a component of a signal, by its index as written, and its unit: by name, else ``$y_0$``."""
    key = f"{signal}.{component}"
    name = f"{literal(trials.names[key])}{ESTIMATE * (signal == 'x_hat')}" if key in trials.names else ""
    return with_unit(name or symbol(signal, place), unit_of(trials, key))


def name_of(trials: Trials, method: str) -> str:
    """Name a method as this picture does: by its key, and in a file for a paper by its label."""
    return trials.labels.get(method, method) if has_labels() else method


def typeset(text: str) -> str:
    """Keep `$...$` where matplotlib can set it, else make the text literal."""
    return text if all(map(can_be_set, text.split("\n"))) else literal(text)


@lru_cache(maxsize=1000)
def can_be_set(line: str) -> bool:
    """Whether matplotlib can set a line with formulas; they are read, and kept, as for a figure: 3 ms each."""
    # Without a dollar sign there is no formula in it, and nothing to read.
    if "$" not in line:
        return True
    if (line.count("$") - line.count(r"\$")) % 2:
        return False
    try:
        with style():
            width(line)
    except (ValueError, RecursionError):
        return False
    return True


def literal(text: str) -> str:
    """Protect every dollar sign of a text."""
    return text.replace(r"\$", "$").replace("$", r"\$")


def with_unit(name: str, unit: str) -> str:
    """Join a name that is typeset and a plain unit, such as rad^2, whose exponents are raised."""
    raised = re.sub(r"\^(-?\d+(?:\.\d+)?)", r"$^{\1}$", literal(unit))
    return f"{name} [{raised}]" if unit else name


def symbol(name: str, component: str = "") -> str:
    """Typeset a signal or a quantity, such as x_hat, and the component of it that is shown (counted from 0)."""
    formula = _formula(name)
    if not component:
        return f"${formula}$" if formula else literal(name)
    if not formula:
        return f"{literal(name)}[{component}]"
    # A letter has one index only: that of an entry stands behind parentheses where the name has one.
    index = component if len(component) == 1 else f"{{{component}}}"
    return f"$({formula})_{index}$" if "_{" in formula else f"${formula}_{index}$"


def _formula(name: str) -> str:
    """A letter with an accent or with a short index, such as r_breve or Q_yw; empty for other names."""
    for accent in ACCENTS:
        core = name.removesuffix(f"_{accent}")
        if core != name:
            return rf"\{accent}{{{letter}}}" if (letter := _letter(core)) else ""
    core, _, index = name.partition("_")
    if not index:
        return _letter(name)
    return f"{letter}_{{{index}}}" if (letter := _letter(core)) and index.isalnum() and len(index) <= 2 else ""


def _letter(name: str) -> str:
    return rf"\{GREEK[name]}" if name in GREEK else name if len(name) == 1 and name.isalpha() else ""


def wrapped(text: str, limit: float) -> list[str]:
    """Break a label at the blanks outside its formulas so that no line is wider than `limit` points, if possible."""
    lines: list[str] = []
    for paragraph in text.split("\n"):
        words = re.findall(r"(?:\\\$|\$(?:\\.|[^$\\])*\$|\S)+", paragraph)
        for index, word in enumerate(words):
            if index and width(f"{lines[-1]} {word}") <= limit:
                lines[-1] += f" {word}"
            else:
                lines.append(word)
    return lines or [""]


def shortened(text: str, limit: float) -> str:
    """Typeset a name on one line; the end of one that is wider than `limit` points is left out."""
    shown = typeset(" ".join(text.split("\n")))
    parts = re.findall(r"\\\$|\$(?:\\.|[^$\\])*\$|.", shown)
    fits, ends = 0, len(parts)
    while fits < ends:
        middle = (fits + ends + 1) // 2
        end = "…" if middle < len(parts) else ""
        fits, ends = (middle, ends) if width("".join(parts[:middle]) + end) <= limit else (fits, middle - 1)
    return shown if fits == len(parts) else "".join(parts[: max(fits, 1)]) + "…"


def on_two_lines(name: str, limit: float) -> str:
    """Write the name of a row on two lines at most, where `limit` points are too few for one."""
    lines = wrapped(typeset(name), limit)
    fits = len(lines) <= 2 and all(width(line) <= limit for line in lines)
    return "\n".join(lines) if fits else shortened(name, limit)


def names_of_columns(names: Sequence[str], slot: float) -> tuple[list[str], dict[str, Any], float]:
    """Write names below columns of `slot` points, on 3 lines or turned; also how ticks have them, and height [pt]."""
    heads = [wrapped(typeset(name), slot - COLUMN_PAD) for name in names]
    most = max(map(len, heads))
    if most <= MOST_LINES and all(width(line) <= slot - COLUMN_PAD for head in heads for line in head):
        return ["\n".join(head) for head in heads], {"linespacing": 1.0}, LINE_HEIGHT * most
    cut = [shortened(name, LONGEST_TURNED) for name in names]
    if slot >= 1.2 * LINE_HEIGHT:
        return cut, {"rotation": 60, "ha": "right", "rotation_mode": "anchor"}, max(map(width, cut))
    return cut, {"rotation": 90, "fontsize": min(FONT_SIZE, 0.9 * slot)}, max(map(width, cut))


def width(text: str) -> float:
    """Width of one line of a label in points."""
    import matplotlib

    return _width(text, font_family(), matplotlib.rcParams["mathtext.fontset"])


@lru_cache(maxsize=1000)
def _width(text: str, family: str, formulas: str) -> float:
    from matplotlib.cbook import is_math_text
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import TextToPath

    formula = is_math_text(text)
    font = FontProperties(family=family, size=FONT_SIZE, math_fontfamily=formulas)
    line = text if formula else text.replace(r"\$", "$")
    return float(TextToPath().get_text_width_height_descent(line, font, formula)[0])


def marked(trials: Trials, method: str) -> str:
    """Return the name of a method for a table, where an oracle estimator is marked."""
    return f"{method} (oracle)" if method in trials.oracles else method


def joined(words: Iterable[str]) -> str:
    """Join words as a sentence does: ``a, b and c``."""
    *first, last = list(words) or [""]
    return f"{', '.join(first)} and {last}" if first else last


def sentence(*parts: str) -> str:
    """Make one sentence of the parts that are not empty."""
    return f"{'; '.join(filter(None, parts))}."


def quantity(info: MetricInfo) -> str:
    """Name a metric with its unit, such as ``MSE [rad^2]``."""
    return f"{info.words} [{info.unit}]" if info.unit else info.words


def at_point(title: str) -> str:
    """Name the point of a sweep that a figure of one point shows; empty without a sweep."""
    return f" at {title}" if title else ""


def runs_sentence(points: Sequence[Trials], methods: Sequence[str]) -> str:
    """Say how many runs there are, and which methods failed in how many of them."""
    sizes = sorted({len(point.runs) for point in points}) or [0]
    n = f"n = {sizes[0]}" if len(sizes) == 1 else f"n = {sizes[0]} to {sizes[-1]}"
    noun = "run" if sizes == [1] else "runs"
    failed = []
    for point in points:
        where = f" at {short_title(point)}" if len(points) > 1 else ""
        failed += [f"{name_of(point, name)} {point.n_failed(name)}{where}" for name in methods if point.n_failed(name)]
    if not failed:
        return f"{n} {noun} of every method; no run failed"
    return f"{n} {noun} of every method; failed runs are left out ({', '.join(failed)})"


def short_title(point: Trials) -> str:
    """Name a point by the last parts of its paths, such as ``Hp=10, Hu=8``; by whole paths if these are not unique.

    A value of several words, such as ``pi first``, stands without its path if it is the only one.  A point whose values
    share a name has its title, shortened in the same way.
    """
    # The title has only the name of values that change together.
    title = f", {point.title}, "
    named = "name" in point.point
    shown = {path: text for path, text in point.point.items() if not named or f", {path}={text}, " in title}
    last = [path.rpartition(".")[2] for path in shown]
    names = last if len(set(last)) == len(last) else list(shown)
    phrases = [text for text in shown.values() if re.search(r"\w \w", text)]
    words = [text if phrases == [text] else f"{name}={text}" for name, text in zip(names, shown.values(), strict=True)]
    if not named:
        return printed(", ".join(words))
    for (path, text), word in zip(shown.items(), words, strict=True):
        title = title.replace(f", {path}={text}, ", f", {word}, ")
    return printed(title[2:-2])


def printed(title: str) -> str:
    """Write the signs of a title as they are printed: a minus in front of a number, a cross between factors.

    >>> printed("delta from -1 to 1, noise x 0.01, 1e-5, run-2")
    'delta from −1 to 1, noise × 0.01, 1e-5, run-2'
    """
    return re.sub(r"(?<= )x(?= \.?\d)", "×", re.sub(r"(?<![\w.)\]-])-(?=\.?\d)", "−", title))
