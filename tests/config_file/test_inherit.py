"""Configurations made from others: what is taken, where mistakes are, and that nothing depends on files afterwards."""

import shutil

import numpy as np
import pytest
from small_experiment import cli, ran
from uncertain_experiment import INITIAL, METHODS, MODEL, PLANT, write_estimation, write_taking

from rmpc_bench import load_config, load_trials, registry
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import dump
from rmpc_bench.types import ConfigError

BENCH = "b/bench.yaml"
OTHER_A = "[[0.5, 0.1], [0, 0.3]]"


@pytest.fixture
def here(tmp_path):
    """Return a directory with b/bench.yaml, b/other.yaml (another A) and b/third.yaml, which takes bench's plant."""
    (tmp_path / "b").mkdir()
    write_estimation(tmp_path / "b", file="bench.yaml")
    write_estimation(tmp_path / "b", file="other.yaml", plant=PLANT.replace("[[0.9, 0.2], [0, 0.7]]", OTHER_A))
    write_taking(tmp_path / "b", "{from: bench.yaml, Dv: 2}", file="third.yaml", initial="{x: 0, x_hat: 0, P: 3}")
    return tmp_path


def identity(config):
    """What trials are filed under."""
    return [(point.experiment_hash, point.method_keys, point.metric_keys) for point in config.points]


def problems(path, **keys):
    """Return what is wrong with a configuration, each without the directory."""
    with pytest.raises(ConfigError) as caught:
        load_config(path, **keys)
    return [str(problem).removeprefix(f"{path.parent}/") for problem in caught.value.problems]


def A_of(point):
    """A of plant and model, as plain lists."""
    return point.shared["plant"]["A"], next(iter(point.methods.values()))["model"]["A"]


def test_a_plant_of_another_file_is_the_plant(here):
    """Plant, model, noise and start of the other file: the same experiment as with everything in one file."""
    taking, whole = write_taking(here, f"{{from: {BENCH}}}"), write_estimation(here)
    assert identity(load_config(taking)) == identity(load_config(whole))
    assert load_config(taking).resolved == load_config(whole).resolved


def test_keys_beside_from_win(here):
    """They are laid over the plant; a law of the uncertainty replaces the other one whole, a part of it does not."""
    own = "uncertainty: {law: fixed, value: 0.5}, Dv: 3"
    config = load_config(write_taking(here, f"{{from: {BENCH}, {own}}}"))
    plant = config.points[0].shared["plant"]
    assert plant["uncertainty"] == {"law": "fixed", "value": 0.5}
    assert plant["Dv"] == 3.0 and plant["A"] == [[0.9, 0.2], [0.0, 0.7]]
    half = load_config(write_taking(here, f"{{from: {BENCH}, uncertainty: {{high: 0.5}}}}"))
    law = half.points[0].shared["plant"]["uncertainty"]
    assert law == {"law": "uniform", "low": -1.0, "high": 0.5, "per": "step"}


def test_own_sections_win(here):
    """A section that is given here stands alone; those that are not come from the file; its methods and size do not."""
    keys = {"noise": "{process: {gaussian: {std: 2}}}", "runs": 3, "methods": "{a: {estimator: {kind: kalman}}}"}
    config = load_config(write_taking(here, f"{{from: {BENCH}}}", **keys))
    assert config.points[0].shared["noise"]["measurement"] == "none"
    assert config.resolved["initial"]["P"] == 1.0
    assert [*config.methods] == ["a"] and config.experiment.n_runs == 3


def test_files_of_files(here):
    """Every name is relative to the file that it stands in, and the nearest section counts."""
    config = load_config(write_taking(here, "{from: b/third.yaml}"))
    assert config.points[0].shared["plant"]["Dv"] == 2.0
    assert config.resolved["initial"]["P"] == 3.0  # of third.yaml
    assert config.methods["KF"]["model"]["W"] == 1.0  # of bench.yaml


def test_from_any_directory(here, monkeypatch):
    """Names do not depend on where the command runs."""
    path = write_taking(here, "{from: b/third.yaml}")
    found = identity(load_config(path))
    monkeypatch.chdir(here / "b")
    assert identity(load_config("../taking.yaml")) == found
    assert cli("check", "../taking.yaml").exit_code == 0


def test_the_model_has_the_parameters_of_the_plant(here):
    """Nominal matrices of the plant, but for what is given; not the law of its uncertainty."""
    model = "{from: plant, A: 0.5, W: 2, V: 3}"
    config = load_config(write_taking(here, f"{{from: {BENCH}, C: [[2, 0]]}}", model=model))
    model_data = config.methods["KF"]["model"]
    assert model_data["A"] == 0.5 and model_data["C"] == [[2.0, 0.0]] and model_data["W"] == 2.0
    assert "uncertainty" not in model_data


def test_the_model_of_a_method_has_the_parameters_of_the_plant(here):
    """Its own model may come from the plant too, over the default of all methods."""
    model, methods = "{from: plant, A: 0.5, W: 2, V: 3}", "{a: {model: {from: plant, W: 4}, estimator: {kind: kalman}}}"
    model_data = load_config(write_taking(here, f"{{from: {BENCH}}}", model=model, methods=methods)).methods["a"][
        "model"
    ]
    assert (model_data["A"], model_data["W"], model_data["V"]) == ([[0.9, 0.2], [0.0, 0.7]], 4.0, 3.0)


SWEPT = {
    "a list": "{grid: {plant.from: [b/bench.yaml, b/other.yaml, b/third.yaml]}}",
    "names": "{grid: {plant.from: {bench: b/bench.yaml, other: b/other.yaml, third: b/third.yaml}}}",
    "a zip of lists": "{zip: {name: [one, two, three], plant.from: [b/bench.yaml, b/other.yaml, b/third.yaml]}}",
    "rows": "{zip: [{name: one}, {name: two, plant.from: b/other.yaml}, {name: three, plant.from: b/third.yaml}]}",
    "rows without names": "{zip: [{plant.from: b/bench.yaml}, {plant.from: b/other.yaml}, {plant.from: b/third.yaml}]}",
}


@pytest.mark.parametrize("way", SWEPT)
def test_swept_files(here, way):
    """Every way to write it: each point is the experiment with that file alone, its model and start included."""
    config = load_config(write_taking(here, f"{{from: {BENCH}}}", sweep=SWEPT[way]))
    alone = [load_config(write_taking(here, f"{{from: b/{name}.yaml}}")) for name in ("bench", "other", "third")]
    assert identity(config) == [each for config in alone for each in identity(config)]
    names = {"names": "other", "a list": "b/other.yaml", "rows without names": "b/other.yaml"}
    assert config.points[1].title.removeprefix("plant.from=") == names.get(way, "two")


@pytest.mark.parametrize("way", SWEPT)
def test_swept_files_survive_being_written(here, tmp_path_factory, way):
    """The resolved form is read anywhere, as the same experiment at every point."""
    config = load_config(write_taking(here, f"{{from: {BENCH}}}", sweep=SWEPT[way]))
    copy = tmp_path_factory.mktemp("elsewhere") / "r.yaml"
    copy.write_text(dump(plain(config.resolved)), encoding="utf-8")
    again = load_config(copy)
    assert identity(again) == identity(config) and again.resolved == config.resolved
    assert [point.title for point in again.points] == [point.title for point in config.points]


@pytest.mark.parametrize(
    "keys",
    [
        {"sweep": f"{{grid: {{plant.A: [{OTHER_A}, 0.5]}}}}"},
        {"sweep": "{grid: {methods.ERP.estimator.gamma: [5, 10]}}"},
        {"sweep": "{grid: {methods.ERP.estimator.gamma: [5, 10], plant.uncertainty.low: [-1, 0]}}"},
        {"sweep": "{grid: {plant.uncertainty: {fixed: {law: fixed}, greedy: {law: greedy, against: KF}}}}"},
        {"sweep": "{grid: {model.W: [1, 2]}}", "model": MODEL},
        {"sweep": "{grid: {initial.P: [1, 2]}}", "initial": INITIAL},
        {"sweep": "{grid: {noise.process.gaussian.std: [1, 2]}}", "noise": "{process: {gaussian: {std: 1}}}"},
        {
            "sweep": f"{{grid: {{plant.A: [{OTHER_A}, 0.5]}}}}",
            "methods": "{a: {model: {from: plant, W: 4}, estimator: {kind: kalman}}}",
        },
    ],
    ids=lambda keys: keys["sweep"],
)
@pytest.mark.parametrize("plant", ["from", "given"])
def test_sweeps_survive_being_written(here, tmp_path_factory, keys, plant):
    """Whatever is swept over a plant that comes from a file, or that a model comes from."""
    if plant == "from":
        config = load_config(write_taking(here, f"{{from: {BENCH}}}", **keys))
    else:
        own = {} if "methods" not in keys else {"model": "{kind: uncertain-linear, A: 0.5, C: [[1, 0]], W: 1, V: 1}"}
        config = load_config(write_estimation(here, **(own | keys)))
    copy = tmp_path_factory.mktemp("elsewhere") / "r.yaml"
    copy.write_text(dump(plain(config.resolved)), encoding="utf-8")
    again = load_config(copy)
    assert identity(again) == identity(config) and again.resolved == config.resolved


def test_the_sweep_of_the_other_file_plays_no_part(here):
    """Even where it names this file, or one that does not exist."""
    sweep = "{grid: {plant.from: [../taking.yaml, none.yaml]}}"
    write_taking(here / "b", "{from: bench.yaml}", file="sweeping.yaml", sweep=sweep)
    swept, plain = (load_config(write_taking(here, f"{{from: b/{name}.yaml}}")) for name in ("sweeping", "bench"))
    assert identity(swept) == identity(plain)


def test_the_model_follows_a_swept_matrix(here):
    """`model.from: plant` means the plant of the point."""
    config = load_config(write_taking(here, f"{{from: {BENCH}}}", sweep=f"{{grid: {{plant.A: [{OTHER_A}, 0.5]}}}}"))
    assert [A_of(point) for point in config.points] == [([[0.5, 0.1], [0.0, 0.3]],) * 2, (0.5, 0.5)]
    assert config.points[0].method_keys != config.points[1].method_keys


def test_results_outlive_the_files(here, tmp_path_factory):
    """A directory of results can be copied, read and reported where neither the YAML nor the benchmarks are."""
    path = write_taking(here, f"{{from: {BENCH}}}", sweep=SWEPT["rows"], evaluate="[runs, moments]")
    first = ran(path, here / "out")
    elsewhere = tmp_path_factory.mktemp("elsewhere") / "out"
    shutil.copytree(here / "out", elsewhere)
    for name in ("b", "out"):
        shutil.rmtree(here / name)
    path.unlink()
    trials = load_trials(elsewhere)
    assert [table.title for table in trials.points] == ["one", "two", "three"]
    assert len(trials.frame) == 3 * 2 * 6
    result = cli("report", elsewhere)
    assert result.exit_code == 0, result.output
    assert (elsewhere / "trials.csv").read_bytes() == first


def test_overrides(here):
    """`-s` reaches into the plant of the file, and may name another file, relative to the configuration's directory."""
    path = write_taking(here, f"{{from: {BENCH}}}")
    assert A_of(load_config(path, overrides=[f"plant.A={OTHER_A}"]).points[0]) == ([[0.5, 0.1], [0.0, 0.3]],) * 2
    other = load_config(path, overrides=["plant.from=b/other.yaml"])
    assert identity(other) == identity(load_config(write_taking(here, "{from: b/other.yaml}")))


def test_values_are_laid_over_what_comes_along(here):
    """An override or a sweep into a section of the other file changes this value and keeps the rest of the section."""
    changes = {
        "initial.P=2": {"initial": INITIAL.replace("P: 1", "P: 2")},
        "model.W=2": {"model": MODEL.replace("W: 1", "W: 2")},
        "noise={process: none}": {"noise": "{process: none}"},
        "initial.x_hat=0": {"initial": INITIAL.replace("x_hat: [1, 0]", "x_hat: 0")},
    }
    for text, keys in changes.items():
        expected = load_config(write_estimation(here, **keys))
        assert identity(load_config(write_taking(here, f"{{from: {BENCH}}}"), overrides=[text])) == identity(expected)
    for order in ([0, 1], [1, 0]):
        texts = [["plant.from=b/other.yaml", "initial.P=2"][i] for i in order]
        found = load_config(write_taking(here, f"{{from: {BENCH}}}"), overrides=texts)
        assert found.resolved["initial"]["x_hat"] == [1.0, 0.0] and A_of(found.points[0])[0][0] == [0.5, 0.1]
    axes = ["initial.P: [2, 3]", "model.W: [2]", "plant.from: [b/bench.yaml, b/third.yaml]"]
    for order in (axes, axes[::-1]):
        config = load_config(write_taking(here, f"{{from: {BENCH}}}", sweep=f"{{grid: {{{', '.join(order)}}}}}"))
        starts = {tuple(map(str, (point.methods["KF"]["x_hat"], point.methods["KF"]["P"]))) for point in config.points}
        assert starts == {(x_hat, P) for x_hat in ("[1.0, 0.0]", "0.0") for P in ("2.0", "3.0")}
        assert {point.methods["KF"]["model"]["V"] for point in config.points} == {1.0}
        copy = here / "elsewhere.yaml"
        copy.write_text(dump(plain(config.resolved)), encoding="utf-8")
        assert identity(load_config(copy)) == identity(config)


WRONG = {
    "{from: 3}": "6:15: plant.from: must be the name of a configuration (got 3)",
    "{from: [a]}": "6:15: plant.from: must be the name of a configuration (got a list of 1)",
    "{from: }": "6:14: plant.from: must be the name of a configuration (got nothing)",
    '{from: ""}': "6:15: plant.from: must be the name of a configuration (got '')",
    "{from: b/bnch.yaml}": "6:15: plant.from: {here}/b/bnch.yaml: there is no such file; "
    "did you mean '{here}/b/bench.yaml'?",
    "{from: b/system.mat}": "6:15: plant.from: must be the name of a configuration (.yaml); matrices of a file are "
    "written A: {file: b/system.mat, name: A}",
    "{from: A.csv}": "6:15: plant.from: must be the name of a configuration (.yaml); matrices of a file are written A: "
    "{file: A.csv}",
    "{from: b}": "6:15: plant.from: {here}/b: is a directory, not a YAML file",
    "{from: taking.yaml}": "6:15: plant.from: taking.yaml: includes itself",
    "{from: b/cycle.yaml}": "b/cycle.yaml:1:15: plant.from: ../taking.yaml: includes itself",
    "{from: b/none.yaml}": "6:15: plant.from: b/none.yaml: has no plant",
    "{from: b/list.yaml}": "6:15: plant.from: b/list.yaml: has no plant",
    "{from: b/empty.yaml}": "b/empty.yaml:1:1: the file is empty",
    "{from: b/lost.yaml}": "b/lost.yaml:2:10: plant.from: {here}/b/lots.yaml: there is no such file; "
    "did you mean '{here}/b/lost.yaml'?",
    "{from: b/number.yaml}": "b/number.yaml:1:15: plant.from: must be the name of a configuration (got 3)",
    "{from: b/bench.yaml, Dq: 1}": "6:29: plant.Dq: 'Dq' is not a known key; did you mean 'D'?",
}
FILES = {
    "cycle": "plant: {from: ../taking.yaml}\n",
    "none": "name: x\n",
    "list": "plant: [1]\n",
    "empty": "# nothing\n",
    "lost": "plant:\n  {from: lots.yaml}\n",
    "number": "plant: {from: 3}\n",
}


@pytest.mark.parametrize("plant", WRONG)
def test_mistakes_of_names(here, plant):
    """Each is at the place of the name, in the file that it stands in."""
    for name, content in FILES.items():
        (here / "b" / f"{name}.yaml").write_text(content, encoding="utf-8")
    message = WRONG[plant].replace("{here}", str(here))
    assert problems(write_taking(here, plant)) == [message if message.startswith("b/") else f"taking.yaml:{message}"]


INSIDE = {
    "unknown kind": ({"plant": PLANT.replace("linear", "linaer")}, "6:15: plant.kind: 'uncertain-linaer' is not a"),
    "no kind": ({"plant": PLANT.replace("kind: uncertain-linear, ", "")}, "'kind' is missing; known kinds of plant"),
    "unknown key": ({"plant": PLANT.replace("Dv:", "Dq:")}, ": plant.Dq: 'Dq' is not a known key"),
    "unknown name": ({"plant": PLANT.replace("0.7", "foo")}, "6:36: plant.A: column 1 of 'foo': unknown name 'foo'"),
    "1/k": (
        {"plant": PLANT.replace("0.7", "1/k")},
        "6:36: plant.A: has no value at k = 0: column 2 of '1/k': division",
    ),
    "size": (
        {"plant": PLANT.replace("[[1], [0.5]]", "[[1], [1], [1]]")},
        ": plant.Bw: has the shape 3 x 1; 2 x nw",
    ),
    "noise": ({"noise": "{process: 3}"}, ": noise.process: a number is no noise law"),
    "W": ({"model": "{from: plant, W: -1, V: 1}"}, "7:25: model.W: must be positive semidefinite"),
    "model.from": ({"model": "{from: moon}"}, "7:15: model.from: must be 'plant' (got 'moon')"),
    "x_hat": ({"initial": "{x_hat: [1, 2, 3]}"}, "9:18: initial.x_hat: shape (3,) does not fit"),
    "a law": ({"plant": PLANT.replace("uniform", "unifrom")}, ": plant.uncertainty.law: must be 'uniform', 'extremes'"),
    "crossed": ({"plant": PLANT.replace("low: -1", "low: 3")}, ": plant.uncertainty: low (3) must not exceed high (1)"),
}


@pytest.mark.parametrize("mistake", INSIDE)
def test_mistakes_inside_the_file(here, mistake):
    """They point into the file that the plant comes from, whichever file names it."""
    keys, message = INSIDE[mistake]
    write_estimation(here / "b", file="wrong.yaml", **keys)
    found = problems(write_taking(here, "{from: b/wrong.yaml}"))
    if mistake != "no kind":
        assert all(line.startswith("b/wrong.yaml:") for line in found), found
    assert any(message in line for line in found), found
    assert not any(": model.A:" in line or ": model.Bw:" in line for line in found)  # it is the plant's, said once


def test_a_mistake_in_a_swept_file(here):
    """It points into the file; a name that is none, at its place in the sweep."""
    write_estimation(here / "b", file="wrong.yaml", plant=PLANT.replace("0.7", "foo"))
    for sweep in SWEPT.values():
        found = problems(write_taking(here, f"{{from: {BENCH}}}", sweep=sweep.replace("b/other.yaml", "b/wrong.yaml")))
        assert found and all(line.startswith("b/wrong.yaml:6:36: ") for line in found)
        path = write_taking(here, f"{{from: {BENCH}}}", sweep=sweep.replace("b/other.yaml", "b/ohter.yaml"))
        (line,) = problems(path)
        column = path.read_text(encoding="utf-8").splitlines()[-1].index("b/ohter.yaml") + 1
        assert line.startswith(f"taking.yaml:10:{column}: plant.from: {here}/b/ohter.yaml: there is no such file")


def test_a_mistake_in_an_override(here):
    """The place is that of the override."""
    path = write_taking(here, f"{{from: {BENCH}}}")
    assert problems(path, overrides=["plant.from=3"]) == [
        "-s plant.from=3:1:12: plant.from: must be the name of a configuration (got 3)"
    ]
    (line,) = problems(path, overrides=["plant.from=b/bnch.yaml"])
    assert line.startswith("-s plant.from=b/bnch.yaml:1:12: plant.from: ")


def test_a_model_of_a_plant_that_is_no_model(here):
    """The kinds of models are offered."""
    lines = problems(write_estimation(here, plant="{kind: env}", time="{step: 0.1, steps: 5}"))
    known = ", ".join(registry.names("models"))
    assert any(f"model.from: there is no model of kind 'env'; give one of {known}" in line for line in lines)


def test_every_model_that_comes_from_nowhere_is_reported(here):
    """One error per method, at its place."""
    methods = (
        "{A: {model: {from: sun}, estimator: {kind: kalman}}, B: {model: {from: moon}, estimator: {kind: kalman}}}"
    )
    lines = problems(write_estimation(here, methods=methods))
    assert [line.partition(": ")[2] for line in lines] == [
        f"model.from: must be 'plant' (got {name!r})" for name in ("sun", "moon")
    ]


def test_what_a_file_takes_shows_in_check(here):
    """Plant beside design model, with the numbers of the file."""
    shown = " ".join(cli("check", write_taking(here, f"{{from: {BENCH}}}", methods=METHODS), "--full").stdout.split())
    assert "A [[0.9, 0.2], [0.0, 0.7]] [[0.9, 0.2], [0.0, 0.7]]" in shown


def test_arithmetic_of_k_keeps_its_meaning(here):
    """A matrix over time is the same however it is spelt, and is written so that it can be read again."""
    spelt = [PLANT.replace("0.7", text) for text in ('"0.6*(1 + 0.1*sin(k))"', '"0.6*( 1+0.1*sin( k ) )"')]
    one, two = (load_config(write_estimation(here, plant=plant)) for plant in spelt)
    assert identity(one) == identity(two)
    entries = [one.experiment.plant.system.at(k).A[1, 1] for k in range(13)]
    np.testing.assert_allclose(entries, 0.6 * (1 + 0.1 * np.sin(np.arange(13))), rtol=1e-15)
