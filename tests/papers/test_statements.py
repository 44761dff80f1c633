"""Statements of the papers as the configurations record them; nothing is computed."""

from pathlib import Path

import pytest

from rmpc_bench.config_file import yaml

ROOT = Path(__file__).parents[2] / "configs"
PAPERS = ("belda2017", "ma2025", "souto2011", "zenere2017", "zenere2018")


def claims_of(paper):
    """Every claim of a paper, with the name of its configuration."""
    trees = [(path.stem, yaml.load(path)) for path in sorted((ROOT / paper).glob("*.yaml"))]
    return [(name, claim) for name, tree in trees for claim in tree.get("claims") or []]


@pytest.mark.parametrize("paper", PAPERS)
def test_an_id_is_one_statement(paper):
    """In all configurations it has the same words and the same source, and it is in two of them at least."""
    found = {}
    for name, claim in claims_of(paper):
        if claim.get("id"):
            names, statements = found.setdefault(claim["id"], (set(), set()))
            names.add(name)
            statements.add((claim["says"], claim["source"]))
    assert found
    for names, statements in found.values():
        assert len(statements) == 1 < len(names), statements


@pytest.mark.parametrize("paper", PAPERS)
def test_interpretations_have_a_ground_in_the_text(paper):
    """At most twelve, and a ground for each; an experiment at several points that is no interpretation has none."""
    for _, claim in claims_of(paper):
        of_paper = not claim["source"].startswith(("additional result", "suspected misprint"))
        points = claim.get("at")
        if not of_paper or not isinstance(points, list) or "(37)" in claim["source"]:
            continue
        assert len(points) <= 12
        if "grounds" in claim:
            assert len(claim["grounds"]) == len(points)


def test_the_statements_on_figure_8_are_judged_in_both_configurations():
    """Where our interpretation and the others of zenere2018 stand, and no third one."""
    where = {}
    for name, claim in claims_of("zenere2018"):
        if claim["source"] == "Section 4.3, Fig. 8" and claim.get("id"):
            where.setdefault(claim["id"], set()).add(name)
    assert len(where) == 5
    assert set(map(frozenset, where.values())) == {frozenset({"fig8", "interpretations-fig8"})}


def test_settings_without_a_ground_are_additional_results():
    """Ratios of weights, seeds and divergences that were searched for."""
    searched = {"R/Q 1e-5", "R/Q 1e-8", "printed law R/Q 1e-5", "printed law R/Q 1e-8", "tau 0.5", "tau 1"}
    searched |= {"seed 1", "seed 2", "seed 3"}
    for paper in PAPERS:
        for name, claim in claims_of(paper):
            points = claim.get("at") if isinstance(claim.get("at"), list) else []
            if searched & {point.get("name") for point in points}:
                assert claim["source"].startswith("additional result"), (name, claim["says"])


def test_one_wave_for_all_statements_of_zenere2017():
    """It begins with pi in sim1 and sim2, as Fig. 8 shows; the other one is an interpretation or an addition."""
    for name, claim in claims_of("zenere2017"):
        if name != "interpretations-sim2" and claim.get("check") and claim["source"].startswith("Section"):
            assert dict(claim["at"]) == {"reference.values": "pi first"}, claim["says"]


def test_statements_of_belda2017_are_judged_by_the_methods_of_the_paper():
    """The constant penalty I and the tuned one, with and without its bounds; other penalties are additional results."""
    ours = ("Q0_5", "Q0_75", "Q1_5", "Q2", "Q2_5", "Q3", "Q4", "square", "printed", "KF", "wide", "residual")
    for name, claim in claims_of("belda2017"):
        if not claim["source"].startswith(("additional result", "suspected misprint")):
            text = str(claim.get("check"))
            assert not any(f"[{method}" in text for method in ours), (name, claim["says"])


def test_the_certificate_is_judged_at_the_horizon_of_the_paper():
    """N = 100 of (76); shorter horizons are additional results."""
    claims = [claim for name, claim in claims_of("ma2025") if name == "certificate" and "Theorem 1" in claim["source"]]
    assert [claim["finding"] for claim in claims] == ["not-confirmed", "confirmed"]
    for claim in claims:
        assert claim["at"]["controller.horizon"] == 100 and claim["at"]["controller.set"] == "stacked"
