"""Pages of the documentation site: which text stands where, and what the links between the files of docs/ become."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Callable
from pathlib import Path

from docs.markdown import DOCS, MADE, ROOT

FILES = "docs/files.md"
"""The list of files, which is for those who change the program, is no page."""
_FENCE = re.compile(r"(^ *```.*?^ *```$)", re.MULTILINE | re.DOTALL)
_HEADING = re.compile(r"^#+ (.+)$", re.MULTILINE)
_LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\[\]]*\])*)\]\(([^)\s]+)\)")
_SECTION = re.compile(r'^(?:<a id="[^"]+"></a>\n\n)?## (.+)$', re.MULTILINE)


def outside_code(change: Callable[[str], str], text: str, code: re.Pattern[str] = _FENCE) -> str:
    """Change a text where it is no code; the pattern of code has one group."""
    parts = code.split(text)
    parts[::2] = [change(part) for part in parts[::2]]
    return "".join(parts)


def slug(title: str) -> str:
    """Anchor of a heading as code hosts make it."""
    text = re.sub(r"[`*]|\[([^\]]*)\]\([^)]*\)", lambda found: found[1] or "", title).strip().lower()
    return re.sub(r"[^\w\- ]", "", text).replace(" ", "-")


def sections(text: str) -> list[tuple[str, str]]:
    """Parts that begin with a heading of level 2, each after its title; what stands before them has the title ""."""
    fences = [found.span() for found in _FENCE.finditer(text)]
    found = [one for one in _SECTION.finditer(text) if not any(low < one.start() < high for low, high in fences)]
    starts = [0, *(one.start() for one in found)]
    titles = ["", *(one[1] for one in found)]
    ends = [*starts[1:], len(text)]
    return [(title, text[low:high]) for title, low, high in zip(titles, starts, ends, strict=True)]


class Site:
    """Pages below the folder of the site's sources, by path.

    Attributes
    ----------
    texts : path of a page -> its Markdown, with links as docs/ has them
    titles : path of a page -> its name in the navigation, at first its heading up to a colon
    images : path of a picture -> the file it is copied from
    lost : links to files of docs/ or anchors that no page has, after `linked`
    """

    def __init__(self) -> None:
        self.texts: dict[str, str] = {}
        self.titles: dict[str, str] = {}
        self.images: dict[str, Path] = {}
        self.lost: list[str] = []
        self._sources: dict[str, str] = {}
        self._places: dict[tuple[str, str], str] = {}

    def add(self, path: str, text: str, source: str = "", linked: bool = True) -> None:
        """Add a page.

        Parameters
        ----------
        path : of the page, as ``components/estimators/kalman.md``
        text : in Markdown; links are relative to the source, or begin with / and are paths of pages
        source : file of docs/ that the text is from, as ``tutorial.md``
        linked : whether links to headings and anchors of the source lead to this page
        """
        text = text.replace(MADE, "").strip() + "\n"
        title = _HEADING.search(_FENCE.sub("", text))
        self.texts[path] = text
        self.titles[path] = re.sub(r"[`*]|:.*", "", title[1]) if title else path
        self._sources[path] = _file(source) if source else ""
        for name in anchors(text) if source and linked else ():
            self._places.setdefault((_file(source), name), path)

    def lead(self, source: str, anchor: str, path: str) -> None:
        """Make links to an anchor of a file of docs/, with "" to the file itself, lead to a page."""
        self._places[_file(source), anchor] = path

    def whole(self, path: str, name: str) -> None:
        """Add a file of docs/ as one page."""
        self.add(path, (DOCS / name).read_text(encoding="utf-8"), name)
        self.lead(name, "", path)

    def split(self, name: str, folder: str) -> None:
        """Divide a file of docs/ at its headings of level 2 into the pages of a folder, which has an index."""
        (_, first), *parts = sections((DOCS / name).read_text(encoding="utf-8"))
        links = []
        for title, text in ((title.partition(":")[0], text) for title, text in parts):
            path = f"{folder}/{slug(title)}.md"
            raised = outside_code(lambda part: re.sub(r"^##(#*) ", r"#\1 ", part, flags=re.MULTILINE), text)
            self.add(path, raised, name)
            links.append(f"- [{title}](/{path})")
        self.add(f"{folder}/index.md", "\n\n".join([first.strip(), "## Pages", "\n".join(links)]), name)
        self.lead(name, "", f"{folder}/index.md")

    def linked(self, path: str) -> str:
        """Return the text of a page with its links as links between pages of the site."""
        return outside_code(lambda part: _LINK.sub(lambda found: self._link(path, found), part), self.texts[path])

    def _link(self, page: str, found: re.Match[str]) -> str:
        mark, words, target = found.groups()
        if re.match(r"https?:|mailto:", target):
            return found[0]
        words = _LINK.sub(lambda inner: self._link(page, inner), words) if "](" in words else words
        goal, _, anchor = self._goal(page, target).partition("#")
        if not goal:
            return f"`{words}`" if words.endswith((".py", ".yaml")) and "`" not in words else words
        words = self.titles[goal] if goal in self.titles and re.fullmatch(r"[\w./-]+\.md", words) else words
        relative = posixpath.relpath(goal, posixpath.dirname(page) or ".") if goal != page or not anchor else ""
        return f"{mark}[{words}]({relative}{'#' * bool(anchor)}{anchor})"

    def _goal(self, page: str, target: str) -> str:
        """Path in the site of a target that a page names, with its anchor; "" for what the site does not have."""
        name, _, anchor = target.partition("#")
        source = self._sources[page]
        file = posixpath.normpath(posixpath.join(posixpath.dirname(source or "docs/"), name)) if name else source
        if name.startswith("/") or (not name and self._has(page, anchor)):
            return self._checked(page, name[1:] or page, anchor)
        if file.startswith("results/") and file.endswith(".svg"):
            self.images[f"assets/{file[8:]}"] = ROOT / file
            return f"assets/{file[8:]}" if (ROOT / file).exists() else self._lose(page, target)
        folder, _, rest = file.partition("/")
        if folder in ("results", "configs"):
            goal = f"experiments/{'/'.join(rest.removesuffix('.yaml').split('/')[:2])}.md"
            return self._checked(page, goal, "claims" * ("claims" in rest)) if goal in self.texts else ""
        exact, goal = self._places.get((file, anchor)), self._places.get((file, ""), "")
        if exact or goal:
            return self._checked(page, exact or goal, anchor) if exact or not anchor else self._lose(page, target)
        return self._lose(page, target) if file.startswith("docs/") and file.endswith(".md") and file != FILES else ""

    def _checked(self, page: str, goal: str, anchor: str) -> str:
        """A page with an anchor, if it has that."""
        return (goal + f"#{anchor}" * self._has(goal, anchor)) if goal in self.texts else self._lose(page, f"/{goal}")

    def _has(self, page: str, anchor: str) -> bool:
        return page in self.texts and anchor in anchors(self.texts[page])

    def _lose(self, page: str, target: str) -> str:
        self.lost.append(f"{page}: {target}")
        return ""


def _file(source: str) -> str:
    """Path of a file of docs/ in the project."""
    return posixpath.normpath(posixpath.join("docs", source))


def anchors(text: str) -> set[str]:
    """Anchors of headings, and those in HTML."""
    prose = _FENCE.sub("", text)
    return {slug(title) for title in _HEADING.findall(prose)} | {*re.findall(r'<a id="([^"]+)">', prose)}
