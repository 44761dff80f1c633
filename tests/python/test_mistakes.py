"""Typical mistakes in calls of the public functions: each names the argument, what is wrong and what is valid."""

import numpy as np
import pytest
from small_experiment import write

import rmpc_bench
from rmpc_bench import registry, single_run


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    """Return valid first arguments by name: a file, its configuration, and results."""
    place = tmp_path_factory.mktemp("mistakes")
    file = write(place)
    config = rmpc_bench.load_config(file, runs=2)
    results = rmpc_bench.run(config, directory=place / "out", jobs=1)
    return {"file": file, "config": config, "results": results, "place": place / "out"}


class Unmarked:
    """A filter without a mark."""

    def update(self, y):
        """Return y."""
        return y


class Half(rmpc_bench.Estimator):
    """An estimator that lacks two methods."""

    def init(self, n_runs):
        """Start."""
        return ()


@single_run
class Misspelt:
    """A filter with an unknown argument."""

    def update(self, y, u_prev):
        """Return y."""
        return y


MISTAKES = [
    ("load_config", ["file"], {"runs": -1}, "runs: must be a whole number from 1 to .* .got -1."),
    ("load_config", ["file"], {"runs": 0}, "runs: must be a whole number from 1 to .* .got 0."),
    ("load_config", ["file"], {"runs": 3.5}, "runs: must be a whole number from 1 to .* .got 3.5."),
    ("load_config", ["file"], {"runs": "4"}, "runs: must be a whole number from 1 to .* .got '4'."),
    ("load_config", ["file"], {"overrides": "rns=3"}, "rns: 'rns' is not a known key; did you mean 'runs'"),
    ("load_config", ["file"], {"overrides": {"runs": 0}}, "runs: must be >= 1 .got 0."),
    ("load_config", ["file"], {"overrides": 3}, r"overrides must be str \| Sequence.* .got 3."),
    ("load_config", ["file"], {"overrides": [3]}, r"overrides must be str \| Sequence\[str\]"),
    ("load_config", ["file"], {"smoke": "yes"}, "smoke must be bool .got 'yes'."),
    ("load_config", ["file"], {"allow_code": 3}, "allow_code must be str . Path"),
    ("load_config", [3], {}, r"path must be str \| Path.* .got 3."),
    ("run", ["config"], {"only": "S"}, "only: 'S' is not a known method; known: S-MPC, R-MPC"),
    ("run", ["config"], {"only": ["S-MCP"]}, "only: 'S-MCP' is not a known method; did you mean 'S-MPC'"),
    ("run", ["config"], {"only": 3}, r"only must be str \| Collection\[str\] \| None .got 3."),
    ("run", ["config"], {"jobs": 0}, "jobs: must be a whole number of 1 or more, or 'auto' .got 0."),
    ("run", ["config"], {"jobs": 1.5}, "jobs must be int .* .got 1.5."),
    ("run", ["config"], {"jobs": "all"}, "jobs must be .*'auto'.* .got 'all'."),
    ("run", ["config"], {"progress": 3}, "progress must be bool .* .got 3."),
    ("run", ["config"], {"engine": "joblip"}, "engine must be Literal.'joblib', .* .got 'joblip'."),
    ("run", ["config"], {"shard": "3/2"}, "shard '3/2': the shards of 2 are 1/2 to 2/2"),
    ("run", ["config"], {"directory": 3}, r"directory must be str \| Path \| None .got 3."),
    ("run", ["results"], {}, "config must be ExperimentConfig .* .got an object of type Results."),
    ("summarise", ["config"], {}, r"results must be Results \| Trials.* .got an object of type ExperimentConfig."),
    ("judge", ["config"], {}, "results must be Results .got an object of type ExperimentConfig."),
    ("drivers", ["config"], {}, r"results must be Results \| Trials"),
    ("ranks", ["config"], {}, r"results must be Results \| Trials"),
    ("requirements", ["config"], {}, r"results must be Results \| Trials"),
    ("compare", ["results"], {"metric": "mes"}, "metric: 'mes' is not a known metric; did you mean 'mse'"),
    ("compare", ["results"], {"methods": ["S"]}, "methods: 'S' is not a known method; known: S-MPC, R-MPC"),
    ("compare", ["results"], {"methods": "S-MPC"}, "methods must be Sequence.str. . None .got 'S-MPC'."),
    ("compare", ["results"], {"baseline": "KF"}, "baseline: 'KF' is not a known method; known: S-MPC, R-MPC"),
    ("compare", ["results"], {"confidence": 95}, "confidence must lie between 0 and 1 .got 95."),
    ("compare", ["results"], {"confidence": "high"}, "confidence must be float . None .got 'high'."),
    ("figure", ["results", "boxplt"], {}, "kind: 'boxplt' is not a known figure; did you mean 'boxplot'"),
    ("figure", ["results", "boxplot"], {"metrc": "mse"}, "metrc: 'metrc' is not a known key; did you mean 'metric'"),
    ("figure", ["results", "boxplot"], {"metric": "mes"}, "'mes' is not a known metric .*; did you mean 'mse'"),
    ("figure", ["config", "boxplot"], {}, "results must be Results .got an object of type ExperimentConfig."),
    ("load_results", [3], {}, r"directory must be str \| Path .got 3."),
    ("replay", ["place", "1", "S-MPC"], {}, "run must be int .got '1'."),
    ("replay", ["place", 99, "S-MPC"], {}, "there is no run 99; they count from 0 to 1"),
    ("replay", ["place", 1, "S-MCP"], {}, "'S-MCP' is not a known method; did you mean 'S-MPC'"),
    ("replay", ["results", 1, "S-MPC"], {}, r"directory must be str \| Path .got an object of type Results."),
    ("merge", [None], {}, r"directory must be str \| Path .got None."),
    ("publish", ["place"], {}, "results must be Results .got an object of type PosixPath."),
    ("tuning", ["place"], {}, "results must be Results .got an object of type PosixPath."),
    ("pack", ["results", "a.zip"], {}, r"directory must be str \| Path .got an object of type Results."),
    ("verify", ["results"], {}, r"path must be str \| Path .got an object of type Results."),
    ("compare_results", ["results", "place"], {}, "b must be Results .got an object of type PosixPath."),
    ("compare_improvements", ["results", "results", 1], {}, "method must be str .got 1."),
    (
        "register",
        ["estimater", "mine", Half],
        {},
        "group: 'estimater' is not a known group .* did you mean 'estimators'",
    ),
    ("register", ["estimator", 3, Half], {}, "name must be str .got 3."),
    ("register", ["estimator", "kalman", Misspelt], {}, "Misspelt.update: 'u_prev' is not a known argument; did you"),
    ("register", ["estimator", "mine", dict], {}, "estimator 'mine': dict is not marked|dict is no estimator"),
    ("register", ["estimator", "mine", 3], {}, "estimator 'mine': an estimator is a class or a function; .* type int"),
    ("register", ["estimator", "mine", Half], {}, "estimator 'mine': Half does not define correct, predict"),
    ("register", ["estimator", "mine", Unmarked], {}, "estimator 'mine': Unmarked is not marked: write @single_run"),
    ("register", ["metric", "mine", Half], {}, "metric 'mine': Half is an Estimator, no metric"),
    ("single_run", [3], {}, "single_run marks a class or a function .got 3."),
]


@pytest.mark.parametrize(("name", "places", "keywords", "words"), MISTAKES)
def test_a_mistake(given, monkeypatch, name, places, keywords, words):
    """It ends with a ValueError, and with no other text than that."""
    monkeypatch.setattr(registry, "_REGISTERED", {group: {} for group in registry.BUILT_IN})
    arguments = [given[each] if isinstance(each, str) and each in given else each for each in places]
    with pytest.raises(ValueError, match=words) as found:
        getattr(rmpc_bench, name)(*arguments, **keywords)
    assert "\n" not in str(found.value) and "object at 0x" not in str(found.value)


def test_right_types_are_taken(given):
    """Numbers of NumPy, paths and tuples are as good as those of Python."""
    made = rmpc_bench.load_config(str(given["file"]), runs=np.int64(2), overrides=("seed=3",), smoke=False)
    assert made.experiment.n_runs == 2 and type(made.experiment.n_runs) is int
    assert (
        rmpc_bench.compare(given["results"], methods=("S-MPC", "R-MPC"), confidence=np.float64(0.9)).to_frame()
        is not None
    )
