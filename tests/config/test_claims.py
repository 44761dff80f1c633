"""Keys of a claim: id, quote, holds_for, grounds and stated numbers; and the same statement in other files."""

import re
from pathlib import Path

import pytest
from small_experiment import cli, write

import rmpc_bench
from rmpc_bench import load_config
from rmpc_bench.components.designs import figure_names
from rmpc_bench.types import ConfigError

SWEEP = "{zip: [{name: ours, seed: 1}, {name: theirs, seed: 2}]}"
CHECK = "check: 'last(trace(P[R-MPC])) < 1e9'"


def problems(path):
    """Return path and message of every error."""
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    return [(problem.path, problem.message) for problem in caught.value.problems]


@pytest.fixture
def paper(tmp_path):
    """Return a function that writes a file of a paper with one claim."""

    def make(name, finding, claim_id="hu-large", paper="smith2020"):
        claim = f"{{says: s, id: {claim_id}, {CHECK}, finding: {finding}}}"
        return write(tmp_path, file=f"{name}.yaml", name=name, paper=paper, claims=f"[{claim}]")

    return make


def test_the_findings_of_other_files(paper):
    """Of the same paper and the same id, with a recorded finding; the file itself does not count."""
    path = paper("fig8", "confirmed")
    paper("interpretations-fig8", "depends-on-assumptions")
    paper("fig7", "confirmed", claim_id="c-larger")
    paper("other", "not-confirmed", paper="jones2021")
    [claim] = load_config(path).claims
    assert claim.name == "hu-large" and dict(claim.elsewhere) == {"interpretations-fig8": "depends-on-assumptions"}


def test_other_files_may_have_errors(paper, tmp_path):
    """They are reported where they are checked; an unreadable file joins nothing."""
    path = paper("fig8", "confirmed")
    (tmp_path / "broken.yaml").write_text("paper: smith2020\nclaims: [{id: hu-large, finding: ")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe hu-large")
    (tmp_path / "words.yaml").write_text("paper: smith2020\nclaims: [hu-large, {id: hu-large, finding: perhaps}]")
    [claim] = load_config(path).claims
    assert not claim.elsewhere


def test_results_do_not_need_the_other_files(paper, tmp_path):
    """config.resolved.yaml keeps their findings; `report` shows the joined one without the checkout."""
    path = paper("fig8", "confirmed")
    other = paper("interpretations-fig8", "not-confirmed")
    place = tmp_path / "results"
    assert cli("run", path, "-o", place, "-j", 1, "--progress", "none").exit_code == 0
    other.unlink()
    path.unlink()
    [claim] = load_config(place / "config.resolved.yaml").claims
    assert dict(claim.elsewhere) == {"interpretations-fig8": "not-confirmed"}
    (place / "claims.md").unlink()
    assert cli("report", place).exit_code == 0
    text = (place / "claims.md").read_text(encoding="utf-8")
    assert "- finding: **depends on unstated assumptions**, joined over this configuration and interp" in text
    assert "- finding here: confirmed (recorded: confirmed)" in text


def test_a_statement_has_one_claim(tmp_path):
    """An id that stands twice in a file is an error at its place."""
    claims = f"[{{says: s, id: a, {CHECK}}}, {{says: t, id: a, {CHECK}}}]"
    assert problems(write(tmp_path, claims=claims)) == [
        ("claims.1.id", "is that of claim 1, too; a statement has one claim")
    ]


@pytest.mark.parametrize(
    ("keys", "path", "message"),
    [
        ("id: Hu large", "claims.0.id", "must have 1 to 100 letters"),
        (f"quote: '{'word ' * 26}'", "claims.0", "quote must have at most 25 words (got 26)"),
        ("holds_for: some", "claims.0.holds_for", "must be"),
        ("stated: {of: 'last(trace(P[S-MPC]))', value: 58.2}", "claims.0.stated", "in quotes"),
        ("stated: {of: 'last(trace(P[S-MPC]))', value: 'about 58'}", "claims.0.stated", "as the paper prints it"),
        ("stated: {of: 'mean(mse[S-MPC])', value: 'a third', tolerance: 1}", "claims.0.stated", "'a third': "),
        ("stated: {of: 'mean(mse[S-MPC])', value: '58.2'}", "claims.0.stated.of", "estimated from runs: give a tol"),
        ("stated: [{of: 'mean(mse[S-MPC])', value: '1'}]", "claims.0.stated.0.of", "estimated from runs: give a tol"),
        ("grounds: {hours: Section 2}, at: [{name: ours}]", "claims.0.grounds", "did you mean 'ours'?"),
    ],
)
def test_mistakes_are_reported_at_their_place(tmp_path, keys, path, message):
    """With what is wrong and the way out."""
    claims = f"[{{says: s, check: '1 < 2', {keys}}}]"
    [(found, text)] = problems(write(tmp_path, claims=claims, sweep=SWEEP if "at:" in keys else None))
    assert found.startswith(path) and message in text


def test_a_hedge_needs_cases(tmp_path):
    """Without a check there are none."""
    [(path, message)] = problems(write(tmp_path, claims="[{says: s, holds_for: any}]"))
    assert (path, message) == ("claims.0.holds_for", "there is no check whose cases could hold")


def test_numbers_of_a_single_run_may_be_compared_by_their_digits(tmp_path):
    """One run is no estimate."""
    stated = "{of: 'mean(mse[S-MPC])', value: '58.20', text: as printed}"
    [claim] = load_config(write(tmp_path, runs=1, claims=f"[{{says: s, stated: {stated}}}]")).claims
    [number] = claim.numbers
    assert (number.value, number.tolerance, number.printed, claim.is_testable) == (58.2, None, "58.20", True)
    assert load_config(write(tmp_path, runs=1, claims=f"[{{says: s, stated: {stated}}}]")).resolved["claims"][0][
        "stated"
    ] == {"of": "mean(mse[S-MPC])", "value": "58.20", "text": "as printed", "close": 0.01}


def test_more_runs_on_the_command_line_leave_a_number_of_a_single_run_valid(tmp_path):
    """`--runs 2` of an experiment without randomness is no error of its claims, which are shown for information."""
    claims = "[{says: s, stated: {of: 'median(mse[S-MPC])', value: '8'}}]"
    path = write(tmp_path, runs=1, claims=claims)
    [claim] = load_config(path, runs=2).claims
    assert claim.numbers[0].printed == "8"


@pytest.mark.parametrize(
    ("keys", "refused"),
    [
        ("source: Fig. 1", True),
        ("source: additional result", False),
        ("source: Fig. 1, holds_for: most", False),
    ],
)
def test_at_most_twelve_interpretations_of_a_statement(tmp_path, keys, refused):
    """A wider search is an additional result; the points of a hedged statement are a population."""
    rows = [f"{{name: n{seed}, seed: {seed}}}" for seed in range(13)]
    at = ", ".join(f"{{name: n{seed}}}" for seed in range(13))
    claims = f"[{{says: s, {keys}, at: [{at}], check: 'mean(mse[R-MPC]) < 1'}}]"
    path = write(tmp_path, claims=claims, sweep=f"{{zip: [{', '.join(rows)}]}}")
    if not refused:
        assert len(load_config(path).claims[0].at) == 13
        return
    [(place, message)] = problems(path)
    assert place == "claims.0.at" and "at most 12 interpretations of a statement (got 13)" in message


MEAN_CHECK = "check: 'mean(mse[R-MPC]) < 1e9'"


def test_names_of_files_are_counted_by_kind() -> None:
    assert figure_names(["boxplot", "plots.py:Own", "boxplot", "boxplot"]) == (
        "boxplot",
        "Own",
        "boxplot-2",
        "boxplot-3",
    )


def test_a_claim_names_one_figure_or_several(tmp_path: Path) -> None:
    claims = f"[{{says: a, {MEAN_CHECK}, figure: boxplot}}, {{says: b, {MEAN_CHECK}, figure: [boxplot-2, rows]}}]"
    config = rmpc_bench.load_config(
        write(tmp_path, figures="[boxplot, rows, {kind: boxplot, log: true}]", claims=claims)
    )
    assert [claim.figures for claim in config.claims] == [("boxplot",), ("boxplot-2", "rows")]


def test_an_unknown_figure_is_refused_with_the_nearest_one(tmp_path: Path) -> None:
    path = write(tmp_path, figures="[boxplot, rows]", claims=f"[{{says: a, {MEAN_CHECK}, figure: boxplot-2}}]")
    result = cli("check", path)
    assert result.exit_code == 2
    assert "claims.0.figure: 'boxplot-2' is not a known figure of this configuration; did you mean 'boxplot'?" in (
        result.stderr
    )


def test_the_figure_is_in_claims_json_and_a_link_in_claims_md(tmp_path: Path) -> None:
    path = write(tmp_path, runs=2, figures="[boxplot]", claims=f"[{{says: a, {MEAN_CHECK}, figure: boxplot}}]")
    assert cli("run", path, "-o", tmp_path / "out", "-j", 1, "--progress", "none").exit_code == 0
    assert '"figures": [\n        "boxplot"\n      ]' in (tmp_path / "out" / "claims.json").read_text(encoding="utf-8")
    text = (tmp_path / "out" / "claims.md").read_text(encoding="utf-8")
    (target,) = re.findall(r"- figure: \[boxplot\]\((.*)\)", text)
    assert (tmp_path / "out" / target).is_file()
