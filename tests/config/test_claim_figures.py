"""A claim names the figure in which a reader sees it; the name is checked.

conformance/test_configs.py: every claim from a figure has one.
"""

import re
from pathlib import Path

from small_experiment import cli, write

import rmpc_bench
from rmpc_bench.components.designs import figure_names

CHECK = "check: 'mean(mse[R-MPC]) < 1e9'"


def test_names_of_files_are_counted_by_kind() -> None:
    assert figure_names(["boxplot", "plots.py:Own", "boxplot", "boxplot"]) == (
        "boxplot",
        "Own",
        "boxplot-2",
        "boxplot-3",
    )


def test_a_claim_names_one_figure_or_several(tmp_path: Path) -> None:
    claims = f"[{{says: a, {CHECK}, figure: boxplot}}, {{says: b, {CHECK}, figure: [boxplot-2, rows]}}]"
    config = rmpc_bench.load_config(
        write(tmp_path, figures="[boxplot, rows, {kind: boxplot, log: true}]", claims=claims)
    )
    assert [claim.figures for claim in config.claims] == [("boxplot",), ("boxplot-2", "rows")]


def test_an_unknown_figure_is_refused_with_the_nearest_one(tmp_path: Path) -> None:
    path = write(tmp_path, figures="[boxplot, rows]", claims=f"[{{says: a, {CHECK}, figure: boxplot-2}}]")
    result = cli("check", path)
    assert result.exit_code == 2
    assert "claims.0.figure: 'boxplot-2' is not a known figure of this configuration; did you mean 'boxplot'?" in (
        result.stderr
    )


def test_the_figure_is_in_claims_json_and_a_link_in_claims_md(tmp_path: Path) -> None:
    path = write(tmp_path, runs=2, figures="[boxplot]", claims=f"[{{says: a, {CHECK}, figure: boxplot}}]")
    assert cli("run", path, "-o", tmp_path / "out", "-j", 1, "--progress", "none").exit_code == 0
    assert '"figures": [\n        "boxplot"\n      ]' in (tmp_path / "out" / "claims.json").read_text(encoding="utf-8")
    text = (tmp_path / "out" / "claims.md").read_text(encoding="utf-8")
    (target,) = re.findall(r"- figure: \[boxplot\]\((.*)\)", text)
    assert (tmp_path / "out" / target).is_file()
