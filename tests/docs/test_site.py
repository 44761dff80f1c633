"""The documentation site: no dead link, nothing that its parser shows as text, and a search that needs no network."""

import filecmp
import re
import subprocess
import sys
from contextlib import closing
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

pytest.importorskip("latex2mathml")

from docs.components_page import place  # noqa: E402
from docs.markdown import ROOT  # noqa: E402
from docs.site.__main__ import HERE, write  # noqa: E402
from docs.site.browser import LOCAL, PROGRAM, Browser  # noqa: E402
from docs.site.markup import commonmark, math  # noqa: E402
from docs.site.pages import outside_code  # noqa: E402
from docs.site.tree import navigation, site  # noqa: E402

from rmpc_bench import registry  # noqa: E402

KB = 1000
LIMITS = {"experiments": 25_000, "": 60_000}
"""Words of the gallery, and of all other parts together."""
FIRST = 3
"""Results of a search among which an expected page has to be."""
MARKS = re.compile(r"\$\$|\\frac|\\~|\*\*|```|\$[\\a-z]_")
LINK = re.compile(r"\]\(([^)\s]+)\)")


def words(text):
    """Words of two characters or more with a letter, outside code, formulas, targets of links and HTML."""
    text = re.sub(r"^ *```.*?^ *```$", " ", text, flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"<math.*?</math>|<!--.*?-->|</?[a-z]+(?: [a-z]+=[^<>\n]*)?/?>", " ", text, flags=re.DOTALL)
    return len(re.findall(r"[A-Za-z][\w.'-]+", re.sub(r"\]\([^)]*\)", "]", text)))


@pytest.fixture(scope="module")
def made():
    return site()


@pytest.fixture(scope="module")
def sources(made, tmp_path_factory):
    """Folder of the written Markdown."""
    out = tmp_path_factory.mktemp("sources")
    write(made, out)
    return out / "docs"


def test_every_link_leads_to_a_page(made, sources):
    assert made.lost == []
    dead = []
    for file in sources.rglob("*.md"):
        text = file.read_text(encoding="utf-8")
        targets: set[str] = set()
        outside_code(lambda part, found=targets: found.update(LINK.findall(part)) or part, text)
        inside = {target.partition("#")[0] for target in targets if not target.startswith(("http", "mailto"))}
        dead += [(file.name, target) for target in inside if not (file.parent / target).exists()]
    assert dead == []


def test_nothing_that_the_parser_does_not_know_is_left(sources):
    for file in sources.rglob("*.md"):
        found = []
        outside_code(
            lambda part, found=found: found.extend(re.findall(r"\$\$|\\frac|\\[~<$]|```", part)) or part,
            file.read_text(encoding="utf-8"),
            re.compile(r"(^ *```.*?^ *```$|`[^`\n]+`)", re.M | re.S),
        )
        assert not found, file.name


@pytest.mark.parametrize("part", LIMITS)
def test_a_part_is_no_longer_than_its_limit(sources, part):
    inside = [
        file for file in sources.rglob("*.md") if (sources / "experiments" in file.parents) == (part == "experiments")
    ]
    assert sum(words(file.read_text(encoding="utf-8")) for file in inside) <= LIMITS[part]


def test_every_component_has_a_page(made):
    kinds = {f"components/{place(group, kind)}" for group, kinds in registry.BUILT_IN.items() for kind in kinds}
    assert kinds <= {*made.texts}


def test_every_page_is_in_the_navigation_once(made):
    def paths(node):
        inner = node.values() if isinstance(node, dict) else node
        return [node] if isinstance(node, str) else [path for each in inner for path in paths(each)]

    assert sorted(paths(navigation(made))) == sorted(made.texts)


def test_formulas_and_code_as_the_parser_of_the_site_reads_them():
    assert commonmark("```yaml cart.yaml\na: 1\n```") == '```yaml title="cart.yaml"\na: 1\n```'
    assert "<msub><mi>x</mi><mn>1</mn></msub>" in math("State $x_1$.")
    assert commonmark("- a\n  - b\\~ `\\~`") == "- a\n    - b&#126; `\\~`"
    assert math("`$x$` and $5") == "`$x$` and $5"
    block = math("$$\na = b, \\quad c_{k \\quad l} = d\n$$")
    assert block.count("<math") == 2 and block.count('<div class="formula">') == 1


class Page(HTMLParser):
    """Text outside code, addresses and anchors of a page."""

    def __init__(self, file):
        super().__init__()
        self.text, self.links, self.anchors, self.depth = "", [], set(), 0
        self.feed(file.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.depth += tag in ("code", "pre", "script", "style", "math")
        self.links += [found[name] for name in ("href", "src") if found.get(name)]
        self.anchors |= {found[name] for name in ("id", "name") if found.get(name)}

    def handle_endtag(self, tag):
        self.depth -= tag in ("code", "pre", "script", "style", "math")

    def handle_data(self, data):
        self.text += data * (not self.depth)


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Folder of the built site."""
    if not Path(sys.executable).with_name("zensical").exists():
        pytest.skip("zensical is not installed")
    return _built(tmp_path_factory.mktemp("one"))


def _built(out):
    done = subprocess.run([sys.executable, "-m", "docs.site", out], cwd=ROOT / "tests", capture_output=True, text=True)
    assert done.returncode == 0 and "warning" not in done.stdout.lower(), done.stdout + done.stderr
    return out / "site"


@pytest.mark.slow
def test_two_builds_are_equal(built, tmp_path):
    again = _built(tmp_path)
    names = sorted(path.relative_to(built) for path in built.rglob("*") if path.is_file())
    assert names == sorted(path.relative_to(again) for path in again.rglob("*") if path.is_file())
    assert filecmp.cmpfiles(built, again, names, shallow=False)[1:] == ([], [])


@pytest.mark.slow
def test_sizes(built):
    files = {path: path.stat().st_size for path in built.rglob("*") if path.is_file()}
    assert max(size for path, size in files.items() if path.suffix == ".html") <= 150 * KB
    assert (built / "search.json").stat().st_size <= 2 * KB**2 and sum(files.values()) <= 25 * KB**2


@pytest.mark.slow
def test_pages_have_no_dead_link_and_no_mark(built):
    pages = {file: Page(file) for file in built.rglob("*.html") if file.name != "404.html"}
    for file, page in pages.items():
        assert not MARKS.findall(page.text), file
        for link in page.links:
            parts = urlsplit(link)
            goal = (file.parent / unquote(parts.path)).resolve() if parts.path else file
            assert parts.scheme in ("", "http", "https", "mailto"), (file, link)
            if not parts.scheme:
                assert goal.exists(), (file, link)
                known = goal not in pages or unquote(parts.fragment) in pages[goal].anchors
                assert not parts.fragment or known, (file, link)


@pytest.mark.slow
@pytest.mark.skipif(PROGRAM is None, reason="chromium is not installed")
def test_a_search_finds_its_page_without_a_network(built, tmp_path):
    if not (built / "iframe-worker.js").exists():
        pytest.skip("make site-setup was not run")
    missed = {}
    with closing(Browser(tmp_path)) as browser:
        for line in (HERE / "queries.tsv").read_text(encoding="utf-8").splitlines():
            query, expected = line.split("\t")
            found = browser.results(built, query)[:FIRST]
            if not any(page.startswith(tuple(expected.split("|"))) for page in found):
                missed[query] = found
        assert not [address for address in browser.asked if not address.startswith(LOCAL)]
    assert missed == {}
