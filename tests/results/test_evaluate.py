"""What is computed: runs, ensembles over them, exact moments, and what is added to a directory later."""

import numpy as np
import pandas as pd
import pytest
from conftest import ROUND
from small_experiment import cli, ran, spied
from uncertain_experiment import PLANT, write_estimation

from rmpc_bench import load_config, load_trials
from rmpc_bench.types import ConfigError

ALL = [*range(6)]
PER_RUN = PLANT.replace("low: -1, high: 1", "per: run")
ORACLE = "{KF: {estimator: {kind: kalman-predictor}}, G: {estimator: {kind: oracle}}}"


def problems(path, **keys):
    """Return what is wrong with a configuration, each without its file."""
    with pytest.raises(ConfigError) as caught:
        load_config(path, **keys)
    return [str(problem).removeprefix(f"{path}:") for problem in caught.value.problems]


def quantities(directory, method="KF"):
    """Return the series of a method as quantity -> numbers of runs they are from."""
    frame = pd.read_csv(directory / "series.csv")
    frame = frame[frame["method"] == method]
    return {name: sorted(set(part["n"])) for name, part in frame.groupby("quantity")}


def test_runs_alone_by_default(tmp_path):
    """No ensemble is kept where nobody asks for one."""
    ran(write_estimation(tmp_path), tmp_path / "out")
    assert "cov(e)" not in quantities(tmp_path / "out")


@pytest.mark.parametrize(
    ("evaluate", "n"), [("[runs, ensemble]", [6]), ("[runs, moments]", [0, 6]), ("moments", [0]), ("[moments]", [0])]
)
def test_what_is_evaluated(tmp_path, monkeypatch, evaluate, n):
    """Exact moments have n = 0, those of runs their number; moments alone run nothing."""
    blocks = spied(monkeypatch)
    table = ran(write_estimation(tmp_path, evaluate=evaluate), tmp_path / "out")
    assert [
        quantities(tmp_path / "out")[f"{what}({of})"] for what in ("mean", "cov") for of in ("x", "x_hat", "e")
    ] == [n] * 6
    assert len(blocks) == (2 if "runs" in evaluate else 0)
    assert len(table.splitlines()) == (13 if "runs" in evaluate else 1)


def test_a_word_is_a_list_of_one(tmp_path):
    """And a word that is given twice counts once."""
    configs = [load_config(write_estimation(tmp_path, evaluate=text)) for text in ("moments", "[moments, moments]")]
    assert configs[0].resolved == configs[1].resolved and configs[0].evaluate == ("moments",)


def test_what_to_evaluate_is_no_part_of_the_experiment(tmp_path):
    """Trials are the same whatever else is computed of them."""
    hashes = {load_config(write_estimation(tmp_path, evaluate=text)).full_hash for text in ("runs", "[runs, moments]")}
    assert len(hashes) == 1


def test_moments_beside_runs_later(tmp_path, monkeypatch):
    """Runs without an ensemble are simulated once more, with the same numbers; after that nothing is."""
    path = write_estimation(tmp_path)
    first = ran(path, tmp_path / "out")
    blocks = spied(monkeypatch)
    write_estimation(tmp_path, evaluate="[runs, moments]")
    assert ran(path, tmp_path / "out") == first
    assert sorted(blocks) == [("ERP", ALL), ("KF", ALL)]
    assert quantities(tmp_path / "out")["cov(e)"] == [0, 6]
    blocks.clear()
    for evaluate in ("[runs, moments]", "[runs, ensemble]", "runs", "moments"):
        write_estimation(tmp_path, evaluate=evaluate)
        ran(path, tmp_path / "out")
    assert blocks == []
    write_estimation(tmp_path)
    assert ran(path, tmp_path / "out") == first


def test_runs_beside_moments_later(tmp_path, monkeypatch):
    """A directory that has had moments only takes the runs."""
    path = write_estimation(tmp_path, evaluate="moments")
    ran(path, tmp_path / "out")
    blocks = spied(monkeypatch)
    write_estimation(tmp_path, evaluate="[runs, moments]")
    ran(path, tmp_path / "out")
    assert sorted(blocks) == [("ERP", ALL), ("KF", ALL)]


def test_an_added_method_alone_is_computed(tmp_path, monkeypatch):
    """With its ensemble; the others are complete."""
    path = write_estimation(tmp_path, evaluate="[runs, ensemble]")
    ran(path, tmp_path / "out")
    blocks = spied(monkeypatch)
    write_estimation(tmp_path, evaluate="[runs, ensemble]", methods=ORACLE)
    ran(path, tmp_path / "out")
    assert blocks == [("G", ALL)]
    assert quantities(tmp_path / "out", "G")["cov(e)"] == [6]


def test_more_runs_update_the_ensemble(tmp_path, monkeypatch):
    """Only the new runs are computed, and the ensemble is that of all of them in one go; fewer runs take part of it."""
    path = write_estimation(tmp_path, evaluate="[runs, moments]", runs=60)
    ran(path, tmp_path / "grown")
    blocks = spied(monkeypatch)
    write_estimation(tmp_path, evaluate="[runs, moments]", runs=120)
    grown = ran(path, tmp_path / "grown")
    assert sorted({run for _, runs in blocks for run in runs}) == [*range(60, 120)]
    assert grown == ran(path, tmp_path / "whole")
    parts = [load_trials(tmp_path / name).series for name in ("grown", "whole")]
    assert set(parts[0]["n"]) == {0, 120}
    np.testing.assert_allclose(parts[0]["value"], parts[1]["value"], **ROUND, atol=1e-13)  # means of zero
    write_estimation(tmp_path, evaluate="[runs, moments]", runs=50)
    ran(path, tmp_path / "grown")
    assert quantities(tmp_path / "grown")["cov(e)"] == [0, 50]


def test_the_ensemble_is_that_of_the_runs(tmp_path):
    """Mean and covariance over runs that are recorded in full, by NumPy."""
    path = write_estimation(tmp_path, evaluate="[runs, ensemble]", record="{runs: all, signals: [x, x_hat]}", runs=70)
    ran(path, tmp_path / "out")
    trials = load_trials(tmp_path / "out")
    signals = trials.traces["KF"].signals
    e = signals["x"] - signals["x_hat"]
    np.testing.assert_allclose(trials.matrix_series("mean(e)", "KF"), e.mean(axis=0), rtol=1e-12, atol=1e-14)
    for k in range(13):
        expected = np.cov(e[:, k], rowvar=False)
        np.testing.assert_allclose(trials.matrix_series("cov(e)", "KF")[k], expected, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"evaluate": "ensemble"}, "an ensemble is one of runs: evaluate: [runs, ensemble]"),
        ({"evaluate": "moments", "plant": PER_RUN}, "KF has no exact moments: the uncertainty is drawn per run"),
        (
            {"evaluate": "moments", "methods": ORACLE},
            "G has no exact moments: the gains of the estimator depend on the",
        ),
        ({"evaluate": "[]"}, "has too few entries"),
        ({"evaluate": "[runs, moment]"}, "evaluate.1: must be 'runs', 'ensemble' or 'moments' (got 'moment')"),
        ({"evaluate": "3"}, "expected a word or a list (got 3)"),
    ],
)
def test_nothing_to_compute(tmp_path, keys, message):
    """A configuration that could show nothing is refused at `evaluate`, with what would do."""
    found = problems(write_estimation(tmp_path, **keys))
    assert found and all(line.startswith("13:") for line in found)
    assert any(message in line for line in found), found


def test_at_every_point_of_a_sweep(tmp_path):
    """Said once, though two points lack exact moments."""
    sweep = "{grid: {plant.uncertainty: [{law: uniform}, {per: run}, {per: run, low: 0}]}}"
    found = problems(write_estimation(tmp_path, evaluate="moments", sweep=sweep))
    assert len(found) == 2 and all("drawn per run" in line for line in found)


def test_moments_where_there_are_none_beside_runs(tmp_path):
    """Then those of the runs stand alone."""
    ran(write_estimation(tmp_path, evaluate="[runs, moments]", plant=PER_RUN), tmp_path / "out")
    assert quantities(tmp_path / "out")["cov(e)"] == [6]


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        (
            {"figures": "[{kind: signals, signals: [variance]}]"},
            "figures.0.signals: 'variance' needs ensemble moments: evaluate: [runs, moments]",
        ),
        ({"claims": "[{says: a, check: 'last(trace(cov(e[KF]))) < 3'}]"}, "claims.0.check: cov(e[KF]) is not there"),
    ],
)
def test_what_needs_an_ensemble(tmp_path, keys, message):
    """A figure or a claim is refused before any run; an ensemble of runs is enough."""
    (line,) = problems(write_estimation(tmp_path, **keys))
    assert message in line
    load_config(write_estimation(tmp_path, evaluate="[runs, ensemble]", **keys))
    load_config(write_estimation(tmp_path, evaluate="moments", **keys))


def test_a_claim_about_runs_without_runs(tmp_path):
    """It can never be judged, so it is a mistake of the file; one about exact moments is not."""
    claim = "[{{says: a, check: '{}'}}]"
    path = write_estimation(tmp_path, evaluate="moments", claims=claim.format("mean(estimation_mse[KF]) < 3"))
    with pytest.raises(ConfigError, match="no runs are evaluated; add `runs` to `evaluate`"):
        load_config(path)
    exact = claim.format("all(var(e[ERP]) <= diag(P[ERP]) + 1e-12)")
    ran(write_estimation(tmp_path, evaluate="moments", claims=exact), tmp_path / "out")
    assert "**confirmed**" in (tmp_path / "out" / "claims.md").read_text(encoding="utf-8")


def test_without_controller_nothing_acts(tmp_path):
    """The input is zero: the same runs as those of a plant without an input."""
    plain = ran(write_estimation(tmp_path), tmp_path / "a")
    plant = PLANT.replace("Bw:", "B: [[0], [1]], Bw:")
    path = write_estimation(tmp_path, plant=plant, record="{runs: all, signals: [u]}")
    assert ran(path, tmp_path / "b") == plain
    assert not load_trials(tmp_path / "b").traces["KF"].signals["u"].any()


def test_a_controller_for_some_methods_only(tmp_path):
    """A method without one is refused where another has one: u = 0 would be no fair comparison by oversight."""
    mpc = "controller: {kind: mpc, Hp: 5, Hu: 2, Q: 1, R: 1}"
    methods = f"{{a: {{estimator: {{kind: kalman}}}}, b: {{estimator: {{kind: kalman}}, {mpc}}}}}"
    plant = PLANT.replace("Bw:", "B: [[0], [1]], Bw:")
    (line,) = problems(write_estimation(tmp_path, plant=plant, methods=methods))
    assert "methods.a: 'controller' is missing, here and as a default of all methods" in line


def test_smoke(tmp_path):
    """A smoke run has an ensemble, too."""
    result = cli("run", write_estimation(tmp_path, evaluate="[runs, moments]"), "-o", tmp_path / "out", "--smoke")
    assert result.exit_code == 0, result.output
    assert quantities(tmp_path / "out")["cov(e)"] == [0, 4]


@pytest.mark.parametrize("kind", ["boxplot", "signals"])
def test_a_figure_of_runs_without_runs(tmp_path, kind):
    """It is a mistake of the file; without a list of figures there is none."""
    path = write_estimation(tmp_path, evaluate="moments", figures=f"[{kind}]")
    with pytest.raises(ConfigError, match=r"figures\.0: shows runs, but no runs are evaluated"):
        load_config(path)
    assert load_config(write_estimation(tmp_path, evaluate="moments", figures=None)).figures == ()
