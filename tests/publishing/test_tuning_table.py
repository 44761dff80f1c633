"""Files, page and screen of an experiment with tuned methods, from a record of searches; nothing is tuned here."""

from dataclasses import replace

import pandas as pd
import pytest
from small_experiment import cli, write
from tuned_searches import constant, search, tuning

from rmpc_bench import load_results, publish
from rmpc_bench.publishing.pages import _as_computed
from rmpc_bench.publishing.publish import tuning as tuning_report
from rmpc_bench.results.tables import StoredTables

N_RUNS = 3


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Return results of three runs of two methods."""
    here = tmp_path_factory.mktemp("tuned")
    result = cli("run", write(here, runs=N_RUNS), "-o", here / "out", "-j", 1, "--progress", "none")
    assert result.exit_code == 0, result.output
    return load_results(here / "out")


@pytest.fixture
def tuned(results):
    """Return the same with a record of two values of one method, of which the first has a regret of 100 %."""
    record = tuning(search("R-MPC", constant([1, 2]), constant([0.4, 0.2, 0.9], N_RUNS), values=[0.05, 0.5]))
    trials = replace(results.trials, parameters={"S-MPC": "default", **record.parameters})
    return replace(results, stored=trials.with_tuning(record), tuning=record)


def test_an_experiment_says_that_nothing_is_tuned(results, tmp_path):
    """On the screen and on the page, also where the record of the experiment says nothing."""
    written = publish(results, to=tmp_path)
    shown = written.summary().replace("\\\n", "").replace(str(results.directory), "")
    assert "; default parameters" in shown and "tuned" not in shown
    assert "No parameter was tuned: all are default" in (tmp_path / "report.html").read_text()
    assert results.experiment.origins == {"S-MPC": "default", "R-MPC": "default"}
    older = replace(results.experiment, parameters={}, paper="zenere2018")
    assert older.origins == {"S-MPC": "as published", "R-MPC": "as published"}
    assert not list(tmp_path.rglob("tuning.*")) and tuning_report(results).sentences == ()


def test_the_words_are_those_of_the_stored_experiment(results):
    from rmpc_bench.store.store import Store

    other = replace(results.experiment, parameters={"S-MPC": "as published"})
    with Store(results.directory, writable=False) as store:
        assert StoredTables(other, store).trials().parameters == {"S-MPC": "as published", "R-MPC": "default"}


def test_publish_writes_the_tables_and_the_section(tuned, tmp_path):
    written = publish(tuned, to=tmp_path)
    table = pd.read_csv(tmp_path / "tuning.csv")
    assert table["regret_pct"].tolist() == [100.0] and table["tuned"].tolist() == [0.05]
    assert (tmp_path / "tables" / "tuning.md").read_text().startswith("# tiny: tuning\n")
    assert {tmp_path / "tuning.csv", tmp_path / "tables" / "tuning.md"} <= set(written.paths)
    page = (tmp_path / "report.html").read_text()
    assert "<summary><b>Tuning</b><span>R-MPC radius 0.05; budget 4, 3 runs</span>" in page
    assert "S-MPC: default, not tuned; other parameters may change a verdict." in page
    assert 'id="figure-tuning"' in page and not [*tmp_path.glob("figures/tuning.*")]
    screen = written.summary()
    assert " tuned: R-MPC radius 0.05; budget 4, 3 runs (tables/tuning.md)\n" in screen
    assert "parameters: 1 method default, not tuned; 1 method tuned" in " ".join(screen.split())


def test_files_of_an_earlier_tuning_are_removed(tuned, tmp_path):
    publish(tuned, to=tmp_path)
    untuned = replace(tuned, tuning=None, stored=tuned.trials.with_tuning(None))
    written = publish(untuned, to=tmp_path)
    assert not [*tmp_path.glob("tuning.*"), *tmp_path.glob("tables/tuning.*")]
    assert tmp_path / "figures" / "tuning.svg" not in written.paths


def test_the_table_of_methods_has_tuned_values_in_their_places():
    """Also at a place that the file leaves to the default; values that differ from point to point have a word."""
    methods = {
        "A": {"estimator": {"kind": "x", "radius": 0.1}, "tune": {"estimator.radius": [0.01, 1]}},
        "B": {"estimator": {"kind": "x", "radius": 0.1}, "parameters": "as published"},
    }
    one = search("A", constant([1, 2]), values=[0.3, 0.6])
    assert _as_computed(methods, tuning(one)) == {
        "A": {"estimator": {"kind": "x", "radius": 0.3}},
        "B": {"estimator": {"kind": "x", "radius": 0.1}},
    }
    assert methods["A"]["estimator"]["radius"] == 0.1
    two = search("A", constant([2, 1]), values=[0.3, 0.6], point="s=1")
    assert _as_computed(methods, tuning(one, two))["A"]["estimator"]["radius"] == "tuned at each point"
    (parameter,) = one.parameters
    elsewhere = replace(one, parameters=(replace(parameter, path="model.noise.scale"),))
    assert _as_computed(methods, tuning(elsewhere))["A"]["model"] == {"noise": {"scale": 0.3}}
