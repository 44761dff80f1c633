"""Names and texts of a stranger in every file that a run writes: they stay texts."""

import json
import re
from html.parser import HTMLParser
from time import process_time
from xml.etree import ElementTree

import pytest
from small_experiment import ran, write

from rmpc_bench.report.page.rendering import to_markdown, unbroken
from rmpc_bench.report.point_tables import markdown_table
from rmpc_bench.store.rows import read_failures
from rmpc_bench.store.store import Store
from rmpc_bench.types import RunFailure, Status
from rmpc_bench.types.texts import inert_markdown, without_formulas

TAG, LINK = "<script>alert(1)</script>", "[l](javascript:alert(2))"
COMMANDS = r"$\href{javascript:alert(3)}{x}$ \input{x} \write18{id} % $"
METHODS = {
    TAG: "{estimator: {kind: kalman}}",
    '\\" onload=\\"alert(4)': "{estimator: {kind: robust-kalman, c: 0.1}, label: '"
    + f"</title>{TAG} {COMMANDS}"
    + "'}",
    "=1+1": "{estimator: {kind: robust-kalman, c: 0.2}, label: '$a<script>[b](javascript:c)`d$'}",
}
CLAIM = "{says: 'S %s %s', source: '<i>Sec</i>', quote: '`%s`', assumptions: ['a `%s'], check: 'mse[%s] < mse[=1+1]'}"


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Run an experiment whose names are hostile, and return its directory."""
    directory = tmp_path_factory.mktemp("hostile")
    path = write(
        directory,
        title=f"'T {TAG} {LINK} {COMMANDS}'",
        methods="{" + ", ".join(f'"{name}": {keys}' for name, keys in METHODS.items()) + "}",
        evaluate="[runs, ensemble]",
        figures="[boxplot]",
        claims="[" + CLAIM % (TAG, LINK, TAG, TAG, TAG) + "]",
    )
    ran(path, directory / "out")
    return directory / "out"


def test_markdown(files):
    pages = sorted(files.rglob("*.md"))
    assert {"summary.md", "drivers.md", "claims.md", "report.md"} <= {page.name for page in pages}
    for page in pages:
        text = page.read_text(encoding="utf-8")
        text = re.sub(r"^(`{3,}).*?^\1$", "", text, flags=re.DOTALL | re.MULTILINE)
        text = re.sub(r"(`+)(?!`).+?(?<!`)\1(?!`)", "", text)
        text = re.sub(r"</?(?:details|summary)>", "", text)  # the page's own
        assert "alert(1)" in text
        assert not re.search(r"(?<!\\)<[A-Za-z/!?]", text), page
        assert not re.search(r"(?<!\\)\]\(javascript", text), page
    # A closed pair of backticks stays code; a single one would take the next expression for text.
    text = (files / "claims.md").read_text(encoding="utf-8")
    assert '- quote: "`&lt;script>' in text and "  - a &#96;&lt;script>" in text


class Elements(HTMLParser):
    """Collects the elements of a page and their attributes."""

    def reset(self):
        super().reset()
        self.found = []

    def handle_starttag(self, tag, attributes):
        self.found.append((tag, dict(attributes)))


def test_pages_and_figures(files):
    """The page has its own script only, no element acts on events, and a figure has no script."""
    page = Elements()
    page.feed((files / "report.html").read_text(encoding="utf-8"))
    assert [tag for tag, _ in page.found].count("script") == 1
    assert not [key for _, attributes in page.found for key in attributes if key.startswith("on")]
    assert not [value for _, attributes in page.found if (value := attributes.get("href", "")).startswith("javascript")]
    for figure in files.rglob("*.svg"):
        for element in ElementTree.parse(figure).iter():
            assert not element.tag.endswith("}script") and not [key for key in element.attrib if key.startswith("on")]


def test_latex_and_csv(files):
    """Commands of a label are text.  A spreadsheet may take `=1+1` for a formula: docs/security.md says so."""
    tables = [table.read_text(encoding="utf-8") for table in (files / "tables").glob("*.tex")]
    assert tables and not any(re.search(r"^[^%].*\\(input|write|href)\b", text, re.MULTILINE) for text in tables)
    assert "\n=1+1,mse," in (files / "summary.csv").read_text(encoding="utf-8")


def test_marks_that_are_no_text():
    """Tags, links and images are escaped; comparisons, intervals, tables and marks stay."""
    for text in ("a < b, $x<1$", "| a | [0.1, 0.2] (n) |", "- a [1, 2]; b: c", "`a` **b**"):
        assert inert_markdown(text) == text
    for text in ("<b>", "</b>", "<!-- x", "<?x", "[a](b)", "![a](b)", "[a]: b", "- [a]: b"):
        assert inert_markdown(text) != text


def test_what_code_has_said_contains_no_controls(tmp_path):
    """The message, the trace and the component of a failure are shown with escapes, in every file and on the screen."""
    row = RunFailure(1, int(Status.DIVERGED), "plant", 0, "\x1b[2J\x9b\u202e", "File x\n\x07")._asdict()
    with Store(tmp_path) as store:
        with store.file.writing():
            store.file.insert("failures", [(1, 1, json.dumps(row))])
        (failure,) = read_failures(store.file, 1, 9)
    assert failure.message == r"\x1b[2J\x9b\u202e" and failure.trace == "File x\n\\x07" and failure.k == 0


def test_a_name_is_no_formula_on_the_screen():
    """Also where names share their beginning."""
    names = [r"$\href{a}{b}$", "$$", r"$\href{a}{b}$ 2"]
    text = rf"{names[2]} and {names[0]} beat {names[1]} in "
    assert without_formulas(text + r"$\delta_v$", names) == text + "delta_v"


def test_a_name_in_markdown_is_a_text():
    """No emphasis, code, link, mention or entity, in the cell of a table and in a sentence; usual names stay."""
    name = r"**a** _b_ `c` $\href{https://evil.example}{d}$ &lrm; www.evil.example @x"
    for text in (markdown_table({name: []}).splitlines()[0], to_markdown(name)):
        assert not re.search(r"(?<!\\)[*`$]|://|www\.|@|&lrm;|(?<!\\)\b_b", text)
    for usual in ("estimation_mse", "A & B", "R-MPC2, $c_1$", "`settling_time < 20`", "[-16, 0] %"):
        assert markdown_table({usual: []}).splitlines()[0] == f"| {usual} |"


def test_intervals_are_found_in_linear_time():
    """A name without blanks is no part of an interval."""
    start = process_time()
    assert "9,999" not in unbroken("&" * 9_999 + " 1 [0, 2]", ())
    assert process_time() - start < 1
