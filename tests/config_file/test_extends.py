"""``extends``: what is inherited, what replaces it, and where an error is reported."""

from pathlib import Path

import pytest
from small_experiment import text, write

from rmpc_bench import load_config
from rmpc_bench.config_file.extends import read_extended
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import dump, parse
from rmpc_bench.types import ConfigError

CLAIM = "[{says: a, source: b, check: 'mean(mse[R-MPC]) < mean(mse[S-MPC])', finding: confirmed}]"


@pytest.fixture
def extended(tmp_path):
    """Read a file that extends the small experiment in another directory; returns plain data."""
    (tmp_path / "base").mkdir()
    write(tmp_path / "base", claims=CLAIM, figures="[boxplot, {kind: boxplot, metric: input_power}]")

    def made(body, *, file="own.yaml"):
        path = tmp_path / file
        path.write_text(f"extends: base/tiny.yaml\nname: own\n{body}")
        return path

    return made


def problems_of(path, **options):
    with pytest.raises(ConfigError) as caught:
        load_config(path, **options)
    return [(problem.file, problem.line, problem.column, problem.path) for problem in caught.value.problems], str(
        caught.value
    )


def test_a_file_that_only_extends_is_the_same_experiment(extended, tmp_path):
    """With another name and without claims."""
    own, base = load_config(extended("")), load_config(tmp_path / "base" / "tiny.yaml")
    assert own.full_hash == base.full_hash
    assert (own.name, base.name) == ("own", "tiny")
    assert len(base.claims) == 1 and own.claims == ()
    assert len(own.figures) == 2


@pytest.mark.parametrize(
    ("base", "own", "merged"),
    [
        ("a: {b: 1, c: 2}", "a: {c: 3, d: 4}", {"a": {"b": 1, "c": 3, "d": 4}}),
        ("a: [1, 2, 3]", "a: [4]", {"a": [4]}),
        ("a: {b: 1, c: 2}", "a: {b: !delete}", {"a": {"c": 2}}),
        ("a: {b: 1, c: 2}", "a: {b: !delete, e: !delete}", "'e' is not a known inherited key"),
        ("a: {b: 1}", "a:\n  b: !delete\n  d: 1\n", {"a": {"d": 1}}),
        ("a: {b: 1}", "a: !delete", {}),
        ("plant: {kind: x, R: 1}", "plant: {R: 2}", {"plant": {"kind": "x", "R": 2}}),
        ("plant: {kind: x, R: 1}", "plant: {kind: y}", {"plant": {"kind": "y"}}),
        ("plant: {file: p.py:P, R: 1}", "plant: {kind: y}", {"plant": {"kind": "y"}}),
        ("estimator: {kind: x, c: 1}", "estimator: {file: f.py:F}", {"estimator": {"file": "f.py:F"}}),
        (
            "methods: {A: {estimator: {kind: x, c: 1}}}",
            "methods: {A: {estimator: {c: 2}}, B: {}}",
            {"methods": {"A": {"estimator": {"kind": "x", "c": 2}}, "B": {}}},
        ),
        ("time: {step: 1, duration: 20}", "time: {steps: 5}", {"time": {"step": 1, "steps": 5}}),
        ("time: {step: 1, steps: 20}", "time: {duration: 5}", {"time": {"step": 1, "duration": 5}}),
        (
            "noise: {process: {gaussian: {std: 1}}, measurement: none}",
            "noise: {process: {uniform: {radius: 2}}}",
            {"noise": {"process": {"uniform": {"radius": 2}}, "measurement": "none"}},
        ),
        (
            "noise: {process: {gaussian: {std: 1, mean: 2}}}",
            "noise: {process: {gaussian: {mean: 3}}}",
            {"noise": {"process": {"gaussian": {"std": 1, "mean": 3}}}},
        ),
        ("uncertainty: {e: {dist: normal, std: 1}}", "uncertainty: {e: {dist: fixed, value: 2}}",
         {"uncertainty": {"e": {"dist": "fixed", "value": 2}}}),
        ("uncertainty: {e: +-10%}", "uncertainty: {e: +-20%}", {"uncertainty": {"e": "+-20%"}}),
        ("sweep: {grid: {a: [1], b: [2]}}", "sweep: {grid: {b: !delete }}", {"sweep": {"grid": {"a": [1]}}}),
        ("name: base\nclaims: [1]\nruns: 3", "name: own", {"name": "own", "runs": 3}),
    ],
)  # fmt: skip
def test_what_is_merged_and_what_is_replaced(tmp_path, base, own, merged):
    """Mappings key by key; lists, scalars and what is of another kind whole."""
    (tmp_path / "base.yaml").write_text(base + "\n")
    (tmp_path / "own.yaml").write_text(f"extends: base.yaml\n{own}\n")
    if isinstance(merged, str):
        with pytest.raises(ConfigError, match=merged):
            read_extended(tmp_path / "own.yaml")
    else:
        assert plain(read_extended(tmp_path / "own.yaml")) == merged


def test_a_chain_and_a_cycle(tmp_path):
    """The nearest file wins; a file that leads back to itself is refused where it is named."""
    (tmp_path / "a.yaml").write_text("x: {p: 1, q: 1, r: 1}\n")
    (tmp_path / "b.yaml").write_text("extends: a.yaml\nx: {q: 2, r: !delete}\n")
    (tmp_path / "c.yaml").write_text("extends: b.yaml\nx: {r: 3}\n")
    assert plain(read_extended(tmp_path / "c.yaml")) == {"x": {"p": 1, "q": 2, "r": 3}}
    (tmp_path / "a.yaml").write_text("x: 1\nextends: c.yaml\n")
    found, message = problems_of(tmp_path / "c.yaml")
    assert found == [(str(tmp_path / "a.yaml"), 2, 10, "extends")] and "extends itself" in message


@pytest.mark.parametrize(
    ("line", "column", "message"),
    [
        ("extends: none.yaml", 10, "there is no such file; did you mean"),
        ("extends: [a]", 10, "must be the name of a configuration"),
        ("extends: ''", 10, "must be the name of a configuration"),
        ("extends: list.yaml", 10, "must be a mapping"),
    ],
)
def test_a_file_that_cannot_be_extended(tmp_path, line, column, message):
    """Reported at its name."""
    (tmp_path / "list.yaml").write_text("[1]\n")
    (tmp_path / "own.yaml").write_text(f"{line}\n")
    found, text_ = problems_of(tmp_path / "own.yaml")
    assert found == [(str(tmp_path / "own.yaml"), 1, column, "extends")] and message in text_


def test_an_error_is_reported_in_the_file_it_stands_in(extended, tmp_path):
    """With its line and column there: a wrong value in the base, one in the extension, and a missing name."""
    base = tmp_path / "base" / "tiny.yaml"
    base.write_text(base.read_text().replace("seed: 7", "seed: -7"))
    own = extended("methods:\n  R-MPC: {estimator: {c: -1}}\n  S-MPC: {estimator: {kinde: kalman}}\n")
    found, _ = problems_of(own)
    assert (str(base), 3, 7, "seed") in found
    assert (str(own), 4, 26, "methods.R-MPC.estimator.c") in found
    assert (str(own), 5, 23, "methods.S-MPC.estimator.kinde") in found
    own.write_text("extends: base/tiny.yaml\n")
    assert "'name' is missing" in problems_of(own)[1]


@pytest.mark.parametrize(
    ("body", "place", "message"),
    [
        ("methods: {X: {estimator: !delete}}", "methods.X.estimator", "there is nothing to delete"),
        ("methods: {S-MPC: {estimator: {kind: robust-kalman, c: !delete}}}", "estimator.c", "there is nothing"),
        ("metrics: [{kind: mse, name: !delete}]", "metrics.0.name", "there is nothing to delete"),
        ("metrics: [mse, !delete]", "metrics.1", "!delete stands alone"),
        ("metrics: !delete [mse]", "metrics", "tags are not allowed (!delete)"),
        ("title: !delete no", "title", "!delete stands alone"),
        ("title: !remove", "title", "tags are not allowed (!remove)"),
        ("methods: {R-NPC: !delete}", "methods.R-NPC", "did you mean 'R-MPC'?"),
        ("claims: !delete", "claims", "is not a known inherited key"),
    ],
)  # fmt: skip
def test_a_wrong_deletion(extended, body, place, message):
    """Only an inherited key can be deleted, and nothing else is a tag."""
    found, text_ = problems_of(extended(body + "\n"))
    assert any(place in path for *_, path in found) and message in text_


@pytest.mark.parametrize("given", ["a: !delete", "a: {b: !delete}", "[!delete]", "!delete"])
def test_without_extends_no_tag_is_accepted(given):
    """In a file, and in a value of the command line."""
    with pytest.raises(ConfigError, match="delete"):
        parse(given, "tiny.yaml", may_extend=True)
    with pytest.raises(ConfigError, match="delete"):
        parse("{extends: b, c: !delete}", "-s x=..")


def test_an_override_cannot_extend(extended):
    """It would be too late."""
    found, message = problems_of(extended(""), overrides=["extends=other.yaml"])
    assert found == [("-s extends=other.yaml", 1, 9, "extends")] and "cannot be set here" in message


def test_overrides_and_sweeps_work_on_top(extended):
    """And a sweep of the base may be changed."""
    config = load_config(
        extended("sweep: {grid: {controller.Hp: [10, 12]}}\n"), overrides=["runs=2", "methods.R-MPC.estimator.c=0.5"]
    )
    assert config.experiment.n_runs == 2 and len(config.points) == 2
    assert config.methods["R-MPC"]["estimator"]["c"] == 0.5


def test_inherited_figures_that_do_not_fit_are_left_out(extended):
    """An own one is an error."""
    config = load_config(extended("metrics: [mse]\n"))
    assert [figure.kind for figure in config.figures] == ["boxplot"]
    assert len(config.left_out) == 1 and config.left_out[0].startswith("figure boxplot: ")
    found, _ = problems_of(extended("metrics: [mse]\nfigures: [{kind: boxplot, metric: input_power}]\n"))
    assert [path for *_, path in found] == ["figures.0.metric"]


def test_the_resolved_configuration_loads_alone(extended, tmp_path):
    """Anywhere, as an equal configuration."""
    config = load_config(extended("methods: {R-MPC: {estimator: {c: 0.3}}}\nsweep: {grid: {seed: [1, 2]}}\n"))
    (tmp_path / "elsewhere").mkdir()
    resolved = tmp_path / "elsewhere" / "resolved.yaml"
    resolved.write_text(dump(plain(config.resolved)))
    again = load_config(resolved)
    assert again.full_hash == config.full_hash and again.resolved == config.resolved


def test_a_plant_of_a_file_that_extends_another(tmp_path):
    """Names of files are relative to the file they stand in, however they were inherited."""
    for folder in ("plants", "base", "own"):
        (tmp_path / folder).mkdir()
    write(tmp_path / "plants", file="nominal.yaml")
    (tmp_path / "plants" / "heavy.yaml").write_text("extends: nominal.yaml\nname: heavy\nplant: {J_l: 30}\n")
    given = text(plant="{from: ../plants/heavy.yaml}", model=None)
    (tmp_path / "base" / "tiny.yaml").write_text(given)
    (tmp_path / "own" / "own.yaml").write_text("extends: ../base/tiny.yaml\nname: own\nplant: {R: 21}\n")
    config = load_config(tmp_path / "own" / "own.yaml")
    assert (config.resolved["plant"]["J_l"], config.resolved["plant"]["R"]) == (30, 21)


FILTER = """
from rmpc_bench import single_run

@single_run
class Hold:
    def update(self, y):
        return y[0] * 0 + [0.0, 0.0, 0.0, 0.0]
"""


def test_code_of_the_other_directory_needs_consent(tmp_path):
    """The extended file may name a Python file beside it; it is found there and loaded only if it is allowed."""
    (tmp_path / "base").mkdir()
    (tmp_path / "own").mkdir()
    (tmp_path / "base" / "hold.py").write_text(FILTER)
    write(tmp_path / "base", methods="{Hold: {estimator: {file: hold.py:Hold}}, K: {estimator: {kind: kalman}}}")
    own = tmp_path / "own" / "own.yaml"
    own.write_text("extends: ../base/tiny.yaml\nname: own\n")
    found, message = problems_of(own)
    assert {Path(file).resolve() for file, *_ in found} == {(tmp_path / "base" / "tiny.yaml").resolve()}
    assert "--allow-code" in message
    assert [*load_config(own, allow_code=[tmp_path / "base"]).methods] == ["Hold", "K"]
