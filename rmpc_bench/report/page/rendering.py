"""From the template context to HTML and Markdown, with jinja2, which is imported here only."""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Mapping, Sequence
from functools import cache
from hashlib import sha256
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rmpc_bench.report.point_tables import markdown_table
from rmpc_bench.report.rich_text import to_html, to_markdown

if TYPE_CHECKING:
    from jinja2 import Environment

TEMPLATES = Path(__file__).parents[1] / "templates"
LONGEST = 24  # characters of a name that is not broken
_FORMULA = r"(?<!\\)\$(?:\\.|[^$\\])+\$"
_INTERVAL = re.compile(r"(?:\S+ (?:% )?)?\[[^\[\]<>]{1,24}, [^\[\]<>]{1,24}\]")


def render_html(template: str, context: Mapping[str, Any]) -> str:
    """Fill a template such as ``page.html`` with plain data.

    The file loads nothing: its style and script are in it, and its policy allows this script alone.
    """
    script = _content("page.js").strip()
    digest = b64encode(sha256(f"\n{script}\n".encode()).digest()).decode()
    policy = f"default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-{digest}'"
    own = {
        "script": script,
        "style": _content("page.css").strip(),
        "policy": f"{policy}; base-uri 'none'; form-action 'none'",
    }
    text = _environment(html=True).get_template(f"{template}.j2").render(**context, **own)
    # The loops of a template leave blanks and empty lines.
    return re.sub(r"\n{2,}", "\n", re.sub(r"[ \t]+\n", "\n", text)).strip() + "\n"


def render_markdown(template: str, context: Mapping[str, Any]) -> str:
    """Fill a template such as ``page.md`` with plain data."""
    text = _environment(html=False).get_template(f"{template}.j2").render(**context)
    return re.sub(r"\n{3,}", "\n\n", text).strip() + "\n"


def _content(name: str) -> str:
    return (TEMPLATES / name).read_text(encoding="utf-8")


@cache
def _environment(*, html: bool) -> Environment:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined, pass_context

    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=html,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["rich"] = pass_context(lambda context, text: _markup(said(text, context.get("names", ()))))
    environment.filters["whole"] = pass_context(lambda context, text: _markup(unbroken(text, context.get("names", ()))))
    environment.filters["svg"] = _markup
    environment.filters["text"] = to_markdown
    environment.filters["code"] = _code
    environment.filters["grid"] = markdown_table
    environment.filters["target"] = lambda file: file.replace(" ", "%20").replace("(", "%28").replace(")", "%29")
    return environment


def _markup(text: str) -> Any:
    from markupsafe import Markup

    return Markup(text)


@cache
def _pieces(names: Sequence[str]) -> re.Pattern[str]:
    """Match formulas, and names of methods, which are no formulas whatever they contain."""
    odd, plain = ([re.escape(name) for name in names if ("$" in name) == has] for has in (True, False))
    found = [f"(?P<name>{'|'.join(odd)})"] * bool(odd) + [_FORMULA]
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
    longest = max((len(run) for run in re.findall("`+", line)), default=0)
    mark = "`" * (longest + 1)
    pad = " " if line.startswith("`") or line.endswith("`") else ""
    return f"{mark}{pad}{line}{pad}{mark}"
