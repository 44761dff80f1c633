"""From the template context to HTML and Markdown, with jinja2, which is imported here only, and formulas in both.

Texts are plain, with formulas between dollar signs, such as labels and captions.  Covered are indices, exponents, Greek
letters, accents and common operators.  A fraction is written in one line, and a prime is U+2032.
"""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from hashlib import sha256
from html import escape, unescape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rmpc_bench.report.point_tables import markdown_table
from rmpc_bench.types.texts import without_links

if TYPE_CHECKING:
    from jinja2 import Environment

TEMPLATES = Path(__file__).parents[1] / "templates"
LONGEST = 24  # characters of a name that is not broken
_INTERVAL = re.compile(r"(?:(?<!\S)\S{1,40} (?:% )?)?\[[^\[\]<>]{1,24}, [^\[\]<>]{1,24}\]")


def render_html(template: str, context: Mapping[str, Any]) -> str:
    """Fill a template such as ``page.html`` with plain data.

    The file loads nothing: its style and script are in it, and its policy allows this script alone.
    """
    script, style = ((TEMPLATES / name).read_text(encoding="utf-8").strip() for name in ("page.js", "page.css"))
    digest = b64encode(sha256(f"\n{script}\n".encode()).digest()).decode()
    policy = f"default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-{digest}'"
    own = {"script": script, "style": style, "policy": f"{policy}; base-uri 'none'; form-action 'none'"}
    text = _environment(html=True).get_template(f"{template}.j2").render(**context, **own)
    # The loops of a template leave blanks and empty lines.
    return re.sub(r"\n{2,}", "\n", re.sub(r"[ \t]+\n", "\n", text)).strip() + "\n"


def render_markdown(template: str, context: Mapping[str, Any]) -> str:
    """Fill a template such as ``page.md`` with plain data."""
    text = _environment(html=False).get_template(f"{template}.j2").render(**context)
    return re.sub(r"\n{3,}", "\n\n", text).strip() + "\n"


@cache
def _environment(*, html: bool) -> Environment:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined, pass_context
    from markupsafe import Markup

    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=html,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters |= {
        "rich": pass_context(lambda context, text: Markup(said(text, context.get("names", ())))),
        "whole": pass_context(lambda context, text: Markup(unbroken(text, context.get("names", ())))),
        "text": to_markdown,
        "code": _code,
        "grid": markdown_table,
        "target": lambda file: file.replace(" ", "%20").replace("(", "%28").replace(")", "%29"),
    }
    return environment


@cache
def _pieces(names: Sequence[str]) -> re.Pattern[str]:
    """Match formulas, and names of methods, which are no formulas whatever they contain."""
    odd, plain = ([re.escape(name) for name in names if ("$" in name) == has] for has in (True, False))
    found = [f"(?P<name>{'|'.join(odd)})"] * bool(odd) + [_FORMULA.pattern]
    found += [rf"(?P<word>(?<![\w-])(?:{'|'.join(plain)})(?![\w-]))"] * bool(plain)
    return re.compile("|".join(found))


def said(text: str, names: Sequence[str], name_html: Any = escape) -> str:
    """Write a text with formulas as HTML, in which names of methods stay as they are."""
    found, end = [], 0
    for piece in _pieces(tuple(names)).finditer(text):
        name = piece.groupdict().get("name") or piece.groupdict().get("word")
        if name is None:
            continue
        found += [to_html(text[end : piece.start()]), name_html(name)]
        end = piece.end()
    return "".join([*found, to_html(text[end:])])


def unbroken(text: str, names: Sequence[str]) -> str:
    """Write a text in which names and intervals are not broken into lines."""
    html = said(text, names, lambda name: _whole(escape(name)) if len(name) <= LONGEST else escape(name))
    return _INTERVAL.sub(lambda found: _whole(found[0]), html)


def _whole(html: str) -> str:
    return f'<span class="nb">{html}</span>'


def _code(text: str) -> str:
    """Write program text between as many backticks as it needs; a bar would end the cell of a table."""
    line = " ".join(text.split()).replace("|", r"\|")
    mark = "`" * (1 + max(map(len, re.findall("`+", line)), default=0))
    pad = " " if line.startswith("`") or line.endswith("`") else ""
    return f"{mark}{pad}{line}{pad}{mark}"


_LETTERS = "alpha beta gamma delta epsilon zeta eta theta iota kappa lambda mu nu xi omicron pi rho"
_LETTERS += " sigma tau upsilon phi chi psi omega"
GREEK = {name: unescape(f"&{name};") for letter in _LETTERS.split() for name in (letter, letter.capitalize())}
SIGNS = {"varepsilon": "\u03b5", "ell": "\u2113", "infty": "\u221e", "sum": "\u2211", "prime": "\u2032"}
SIGNS |= {"ldots": "\u2026", "dots": "\u2026", "cdot": "\u22c5", "%": "%", "|": "\u2016", "{": "{", "}": "}"}
SIGNS |= {name: "" for name in ",;:!"} | {" ": " ", "quad": " "}
SIGNS |= {name: name for name in ("log", "ln", "exp", "max", "min", "det", "sin", "cos", "arg")}
BETWEEN = {"=": "=", "<": "<", ">": ">", "le": "\u2264", "leq": "\u2264", "ge": "\u2265", "geq": "\u2265"}
BETWEEN |= {"ne": "\u2260", "neq": "\u2260", "approx": "\u2248", "sim": "\u223c", "in": "\u2208", "to": "\u2192"}
BETWEEN |= {"pm": "\u00b1", "times": "\u00d7"}  # with a blank on both sides
ACCENTS = {"hat": "\u0302", "bar": "\u0304", "tilde": "\u0303", "breve": "\u0306", "dot": "\u0307", "vec": "\u20d7"}
UPRIGHT = ("mathrm", "text", "operatorname", "mathit")
_TOKEN = re.compile(r"\\(?:[A-Za-z]+|.)|\s+|.", re.DOTALL)
_SIMPLE = re.compile(r"[\w.\u0300-\u036f\u20d7]*")


class FormulaError(ValueError):
    """A formula contains something that is not covered."""


def formula_html(formula: str) -> str:
    """Write a formula, without its dollar signs, as HTML; a FormulaError if it holds something that is not covered."""
    left = _TOKEN.findall(formula)[::-1]
    try:
        found = _elements(left, "")
    except RecursionError:
        raise FormulaError("nested too deep") from None
    if left:
        raise FormulaError(f"a brace is closed that was not opened in {formula!r}")
    return " ".join(found.split())


def _elements(left: list[str], end: str) -> str:
    """Read elements, which are in reverse order, up to the one that ends them."""
    found = ""
    while left:
        if left[-1] == end:
            left.pop()
            return found
        if left[-1] == "}":
            break
        if left[-1].isspace():
            left.pop()
            continue
        found += _with_scripts(left)
    if end:
        raise FormulaError("a brace is not closed")
    return found


def _with_scripts(left: list[str]) -> str:
    base, scripts = _atom(left), dict[str, str]()
    while left and left[-1] in ("_", "^"):
        which = left.pop()
        if which in scripts:
            raise FormulaError("two indices or two exponents")
        scripts[which] = _argument(left)
    if scripts.get("^") == "\u2032":
        base += scripts.pop("^")
    tags = {"_": "sub", "^": "sup"}
    return base + "".join(f"<{tag}>{scripts[key]}</{tag}>" for key, tag in tags.items() if key in scripts)


def _argument(left: list[str]) -> str:
    """Read one token or a group as one element."""
    while left and left[-1].isspace():
        left.pop()
    if not left:
        raise FormulaError("something is missing at the end")
    return _atom(left).strip()


def _atom(left: list[str]) -> str:
    token = left.pop()
    if token == "{":
        return _elements(left, "}")
    if token in ("_", "^"):
        raise FormulaError("an index without a base")
    if token.startswith("\\"):
        return _command(token[1:], left)
    if token in BETWEEN:
        return f" {escape(BETWEEN[token])} "
    return {"'": "\u2032", "-": "\u2212"}.get(token) or escape(token)


def _command(name: str, left: list[str]) -> str:
    sign = GREEK.get(name, SIGNS.get(name))
    if sign is not None:
        return sign
    if name in BETWEEN:
        return f" {BETWEEN[name]} "
    if name in UPRIGHT:
        return escape(_words(left))
    if name in ACCENTS:
        base = _argument(left)
        return base[:1] + ACCENTS[name] + base[1:]
    if n := {"sqrt": 1, "frac": 2}.get(name, 0):
        parts = [text if _SIMPLE.fullmatch(text) else f"({text})" for text in (_argument(left) for _ in range(n))]
        return "\u221a" * (name == "sqrt") + "/".join(parts)
    raise FormulaError(f"\\{name} is not covered")


def _words(left: list[str]) -> str:
    """Read a group as plain words."""
    if not left or left.pop() != "{":
        raise FormulaError("words need braces")
    words = []
    while left and left[-1] != "}":
        words.append(left.pop())
    if not left:
        raise FormulaError("a brace is not closed")
    left.pop()
    if any(word[0] in "\\{^_" for word in words):
        raise FormulaError("words hold a command")
    return "".join(words)


_FORMULA = re.compile(r"(?<!\\)\$((?:\\.|[^$\\])+)\$", re.DOTALL)
_MINUS = re.compile(r"(?<![\w.)\]])-(?=\d)")  # the sign of a number; hyphens in names such as R-MPC1 and in dates stay
_RAISED = re.compile(r"(?<=[A-Za-z)])\^(-?\d+)")  # exponent of a unit, such as rad^2 or (rad/s)^2
_MARKDOWN = re.compile(r"([\\`*_{}\[\]<>#|~$])")
_LIST_MARK = re.compile(r"^(\s*)([-+]|\d+[.)])(?=\s)")


def to_html(text: str) -> str:
    r"""Write a text as HTML; a formula that is not covered stays as it is, and ``\$`` is a dollar sign."""
    return "".join(_plain(piece) if html is None else html for piece, html in _with_formulas(text))


def _with_formulas(text: str) -> Iterator[tuple[str, str | None]]:
    """Split a text into pieces, each with its HTML if it is a formula that is covered, else with None."""
    end = 0
    for formula in _FORMULA.finditer(text):
        try:
            html = formula_html(formula[1])
        except FormulaError:
            continue
        yield from ((text[end : formula.start()], None), (formula[0], html))
        end = formula.end()
    yield text[end:], None


def _plain(text: str) -> str:
    text = _MINUS.sub("\u2212", text.replace(r"\$", "$"))
    return _RAISED.sub(r"<sup>\1</sup>", escape(text)).replace("<sup>-", "<sup>\u2212")


def to_markdown(text: str) -> str:
    """Write a text as Markdown of one line; formulas stay, as code hosts set them, and everything else is escaped."""
    found = []
    for piece, html in _with_formulas(" ".join(text.split())):
        if html is not None:
            # It neither ends the cell of a table nor begins a tag, a link or code.
            found.append(piece.replace("|", r"\vert ").replace("<", r"\lt ").replace("](", "] (").replace("`", "'"))
        else:
            found.append(without_links(_MARKDOWN.sub(r"\\\1", piece.replace(r"\$", "$"))))
    return _LIST_MARK.sub(r"\1\\\2", "".join(found))
