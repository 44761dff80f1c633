"""CITATION.cff: the version of the package, and the papers with the identifiers that are known."""

from pathlib import Path

import yaml
from docs.reproductions_page import PAPERS

from rmpc_bench import __version__
from rmpc_bench.claims.claim import IDENTIFIERS

CITATION = yaml.safe_load((Path(__file__).parents[2] / "CITATION.cff").read_text("utf-8"))


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
