"""CITATION.cff, codecheck.yml and the forms for reports: this version, and papers with their known identifiers."""

import json
from pathlib import Path

import yaml
from docs.reproductions_page import PAPERS

from rmpc_bench import __version__
from rmpc_bench.claims.claim import IDENTIFIERS

ROOT = Path(__file__).parents[2]
CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))


def test_it_cites_this_version():
    assert (CITATION["cff-version"], CITATION["type"], CITATION["version"]) == ("1.2.0", "software", __version__)
    assert CITATION["license"] == "BSD-3-Clause" and CITATION["message"] and CITATION["authors"]


def test_every_paper_is_a_reference_with_its_identifier():
    """Authors, title and year as on docs/reproductions.md; no other identifier than those of the package."""
    cited = {each["notes"].split()[0]: each for each in CITATION["references"]}
    assert {*cited} == {*PAPERS}
    for key, each in cited.items():
        assert each["title"] in PAPERS[key] and f"({each['year']})" in PAPERS[key]
        assert all(author["family-names"] in PAPERS[key] for author in each["authors"])
        found = [identifier["value"] for identifier in each.get("identifiers", ())]
        found += [f"ISBN {each['isbn']}"] if "isbn" in each else []
        assert found == [IDENTIFIERS[name] for name in [key] if name in IDENTIFIERS] and "doi" not in each


def test_the_files_to_be_checked_are_kept_and_their_command_is_that_of_the_results():
    """codecheck.yml, as https://codecheck.org.uk/spec/config/1.0/ asks; persons are added by the one who checks."""
    text = (ROOT / "codecheck.yml").read_text("utf-8")
    given = yaml.safe_load(text)
    assert text.startswith("---\n") and {*given} == {"version", "paper", "manifest"}
    assert given["paper"]["title"] in PAPERS["zenere2018"] and IDENTIFIERS["zenere2018"].endswith("1804.06746")
    assert given["paper"]["reference"].endswith("1804.06746")
    results = ROOT / "results" / "zenere2018" / "fig7"
    assert {ROOT / each["file"] for each in given["manifest"]} == {*results.glob("*.csv")}
    command = json.loads((results / "claims.json").read_text("utf-8"))["experiment"]["command"]
    assert given["manifest"][0]["comment"].endswith(f"; {command}")


def test_forms_ask_for_what_a_report_needs():
    """.github/ISSUE_TEMPLATE: every form is valid, and every field has an id of its own."""
    forms = {path.stem: yaml.safe_load(path.read_text("utf-8")) for path in (ROOT / ".github").rglob("*.yml")}
    fields = {name: [each["id"] for each in form["body"]] for name, form in forms.items()}
    assert fields == {
        "bug": ["version", "yaml", "command", "manifest"],
        "wrong-number": ["claim", "grounds", "command"],
    }
    assert all(form["name"] and form["description"] for form in forms.values())
