"""From the template context to HTML and Markdown, with jinja2, which is imported here only."""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Mapping
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rmpc_bench.report.page.inline_svg import inline_svg
from rmpc_bench.report.rich_text import plain_text, to_html, to_markdown

if TYPE_CHECKING:
    from jinja2 import Environment

TEMPLATES = Path(__file__).parents[1] / "templates"


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
    return _tidied(_environment(html=True).get_template(f"{template}.j2").render(**context, **own))


def render_markdown(template: str, context: Mapping[str, Any]) -> str:
    """Fill a template such as ``page.md`` with plain data."""
    text = _environment(html=False).get_template(f"{template}.j2").render(**context)
    return re.sub(r"\n{3,}", "\n\n", text).strip() + "\n"


def _content(name: str) -> str:
    return (TEMPLATES / name).read_text(encoding="utf-8")


def _tidied(text: str) -> str:
    """Take away the blanks that the loops of a template leave at the ends of lines."""
    return re.sub(r"[ \t]+\n", "\n", text).strip() + "\n"


@cache
def _environment(*, html: bool) -> Environment:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=html,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["inline"] = _inline_html if html else _inline_markdown
    environment.filters["picture"] = _picture
    environment.filters["cell"] = lambda text: _inline_markdown(text).replace("\n", " ")
    environment.filters["fence"] = _fence
    return environment


def _inline_html(text: Any) -> Any:
    """Write a text of a block as HTML; only the pieces of `blocks` become elements."""
    from markupsafe import Markup, escape

    if isinstance(text, str):
        return Markup(to_html(text))
    found = []
    for piece in text:
        if isinstance(piece, str):
            found.append(Markup(to_html(piece)))
        elif "code" in piece:
            found.append(Markup("<code>{}</code>").format(piece["code"]))
        elif "badge" in piece:
            found.append(Markup('<span class="badge {}">{}</span>').format(piece["style"], piece["badge"]))
        elif "strong" in piece:
            found.append(Markup("<strong>{}</strong>").format(Markup(to_html(piece["strong"]))))
        else:
            found.append(Markup('<a href="{}">{}</a>').format(escape(piece["link"]), Markup(to_html(piece["text"]))))
    return Markup("").join(found)


def _inline_markdown(text: Any) -> str:
    if isinstance(text, str):
        return to_markdown(text)
    found = []
    for piece in text:
        if isinstance(piece, str):
            blank = " " if piece[-1:] == " " else ""
            lead = " " if piece[:1] == " " else ""
            found.append(f"{lead if piece.strip() else ''}{to_markdown(piece)}{blank}")
        elif "code" in piece:
            found.append(_code(piece["code"]))
        elif "badge" in piece:
            found.append(f"**{to_markdown(piece['badge'])}**")
        elif "strong" in piece:
            found.append(f"**{to_markdown(piece['strong'])}**")
        else:
            target = piece["link"].replace(" ", "%20").replace("(", "%28").replace(")", "%29")
            found.append(f"[{to_markdown(piece['text'])}]({target})")
    return "".join(found)


def _code(text: str) -> str:
    """Write program text between as many backticks as it needs; a bar would end the cell of a table."""
    line = " ".join(text.split()).replace("|", r"\|")
    longest = max((len(run) for run in re.findall("`+", line)), default=0)
    mark = "`" * (longest + 1)
    pad = " " if line.startswith("`") or line.endswith("`") else ""
    return f"{mark}{pad}{line}{pad}{mark}"


def _fence(text: str) -> str:
    """Return a fence that is longer than any in a text."""
    return "`" * max(3, 1 + max((len(run) for run in re.findall("`+", text)), default=0))


def _picture(figure: Mapping[str, Any]) -> Any:
    from markupsafe import Markup

    caption = plain_text(figure["caption"])
    title = f"{figure['name']}: {caption.partition('. ')[0].rstrip('.')}"
    return Markup(inline_svg(figure["svg"], f"figure-{figure['name']}", title, caption))
