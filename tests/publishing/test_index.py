"""An index of several experiments, also of those of which only the findings are kept."""

import json
import re
import shutil

import html5lib
import pytest
from small_experiment import cli, ran, write

HOSTILE = "<script>alert(1)</script>"
CLAIMS = (
    "[{id: small-error, says: The error is small, source: Section 1, check: 'mean(mse[S-MPC]) < 1000',"
    " finding: confirmed}, {says: Not here, source: additional result (ours), check: 'mean(mse[S-MPC]) < 0'}]"
)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Return a directory with the pages of one stored experiment and the kept findings of another."""
    here = tmp_path_factory.mktemp("site")
    ran(write(here, paper="p", claims=CLAIMS, figures="[boxplot]"), here / "results" / "p" / "tiny")
    kept = here / "results" / "p" / "kept"
    kept.mkdir()
    record = json.loads((here / "results" / "p" / "tiny" / "claims.json").read_text())
    record["experiment"] |= {"name": "kept", "title": HOSTILE}
    record["claims"][0]["statement"] = HOSTILE
    (kept / "claims.json").write_text(json.dumps(record))
    result = cli("report", here / "results" / "p" / "kept", here / "results" / "p" / "tiny", "--to", here / "site")
    assert result.exit_code == 0, result.output
    assert "kept: there is no trials.sqlite; the index shows its kept findings" in result.stderr
    assert result.stdout.rstrip().endswith("index.html")
    return here / "site"


def test_the_index_links_the_pages(site):
    index = (site / "index.html").read_text()
    tree = html5lib.HTMLParser(strict=True, namespaceHTMLElements=False).parse(index)
    links = {element.get("href") for element in tree.iter("a")}
    assert "p/tiny/report.html" in links and "p/tiny/report.html#claims" in links
    for link in links:
        file, _, anchor = link.partition("#")
        text = (site / file).read_text() if file else index
        assert not anchor or f'id="{anchor}"' in text, link
    assert "default-src 'none'" in index.replace("&#39;", "'") and not re.search(r"\ssrc=|@import", index)


def test_a_page_links_the_index(site):
    """One that is written alone has no index to link."""
    page = site / "p" / "tiny" / "report.html"
    assert 'href="../../index.html"' in page.read_text() and (page.parent / "../../index.html").exists()
    assert "index.html" not in (site.parent / "results" / "p" / "tiny" / "report.html").read_text()


def test_a_statement_of_two_experiments_is_one_row(site):
    """Joined by its id; the finding is the joined one."""
    index = (site / "index.md").read_text()
    statements = index[index.index("**What the paper says**") : index.index("**Additional results**")]
    rows = [line for line in statements.splitlines() if line.startswith("|")][2:]
    assert len(rows) == 1 and "kept, [tiny](p/tiny/report.html#claims)" in rows[0] and "**confirmed**" in rows[0]


def test_texts_of_kept_findings_are_escaped(site):
    assert HOSTILE not in (site / "index.html").read_text() and "&lt;script&gt;" in (site / "index.html").read_text()
    assert HOSTILE not in (site / "index.md").read_text()


@pytest.mark.parametrize("change", [{"claims": None}, {"claims": [{"kind": "other"}]}, {"experiment": {"name": "a"}}])
def test_findings_of_another_version_are_not_used(site, tmp_path, change):
    """Exit code 2, the file and what it lacks."""
    tiny = tmp_path / "tiny"
    shutil.copytree(site / "p" / "tiny", tiny)
    record = json.loads((tiny / "claims.json").read_text()) | change
    (tiny / "claims.json").write_text(json.dumps(record))
    result = cli("report", tiny, tiny, "--to", tmp_path / "to")
    assert result.exit_code == 2 and "claims.json: " in result.stderr
