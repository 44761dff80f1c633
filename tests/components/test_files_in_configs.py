"""Components from files of a user in a configuration: every group, every form, keys, overrides and sweeps."""

import numpy as np
import pytest
from own_files import ESTIMATOR, METHODS, own_estimator, write

import rmpc_bench
from rmpc_bench import load_config, registry
from rmpc_bench.types import ConfigError, DataFiles, UserFunction

PARTS = """
import numpy as np
from dataclasses import dataclass
from rmpc_bench import Controller, Figure, Metric, Plant, estimator, model, plant
from rmpc_bench.noise.gaussian import gaussian
from rmpc_bench.simulation.reference import constant
from rmpc_bench.types import Command
from rmpc_bench.metrics.tracking import Mse


def servo(Ts, *, J_l: float = 25.0):
    return plant("servo-linear", Ts, J_l=J_l)


def law(Ts, *, weight: float = 1.0):
    from rmpc_bench.models.servo import ServoNoise, design
    return design(Ts, noise=ServoNoise(process=weight, measurement=1.0))


def filter(model, n_steps, *, x0, P0):
    return estimator("kalman", model, n_steps, x0=x0, P0=P0)


class Rest(Controller):
    def __init__(self, model, *, offset: float = 0.0):
        self.nu, self.offset = model.nu, offset

    def init(self, n_runs):
        return ()

    def control(self, k, state, y, estimate, r):
        return state, Command(np.full((len(y), self.nu), self.offset), np.zeros(len(y), dtype=np.int8), {})


def step(ny, *, value: float = 1.0):
    return constant(ny, value=value)


def quiet(n, *, std: float = 0.01):
    return gaussian(n, std=std)


class MyMse(Mse):
    pass


@dataclass(frozen=True)
class Empty(Figure):
    def draw(self, results):
        from matplotlib.figure import Figure
        return Figure()
"""
CASES = {
    "plant": ("plant", "{file: parts.py:servo, J_l: 24, perturb: {J_l: 1 + eps}}"),
    "model": ("model", "{file: parts.py:law, weight: 2}"),
    "estimator": ("estimator", "{file: parts.py:filter}"),
    "controller": ("controller", "{file: parts.py:Rest, offset: 0.5}"),
    "reference": ("reference", "{file: parts.py:step, value: pi}"),
    "noise": ("noise", "{measurement: {file: parts.py:quiet, std: 0.02}}"),
    "sum of noises": ("noise", "{measurement: {sum: [{gaussian: {std: 1}}, {file: parts.py:quiet, std: 0.02}]}}"),
    "initial state": ("initial", "{x: {file: parts.py:quiet}, x_hat: 0}"),
    "metric": ("metrics", "[mse, {file: parts.py:MyMse, name: mine, from: 0.2}]"),
    "metric by its name": ("metrics", "[parts.py:MyMse]"),
    "figure": ("figures", "[{file: parts.py:Empty}]"),
}


@pytest.fixture
def clean(monkeypatch):
    """Forget afterwards what a test registers."""
    monkeypatch.setattr(registry, "_REGISTERED", {group: {} for group in registry.BUILT_IN})


def problems(path, **options):
    """Return the messages of a configuration with errors."""
    with pytest.raises(ConfigError) as caught:
        load_config(path, **options)
    return [str(problem).replace(f"{path.parent}/", "") for problem in caught.value.problems]


@pytest.mark.parametrize("case", CASES)
def test_every_component_may_come_from_a_file(tmp_path, case):
    """And `kind: PATH.py:NAME` means the same; the resolved configuration says `file`."""
    key, text = CASES[case]
    config = load_config(write(tmp_path, {"parts.py": PARTS}, **{key: text}))
    same = load_config(write(tmp_path, {"parts.py": PARTS}, **{key: text.replace("file:", "kind:")}))
    assert config.full_hash == same.full_hash
    assert config.resolved == same.resolved
    assert "'file': 'parts.py:" in str(config.resolved)


def test_data_of_the_design_reach_it(tmp_path):
    """Sampling time, sizes, limits and nominal data of the plant by name; other arguments are keys."""
    files = {
        "asks.py": ESTIMATOR
        + """
class Asks(Own):
    def __init__(self, model, x0, Ts, n_steps, limits, plant_info, gain: Positive = 0.1):
        super().__init__(model, x0, gain=gain)
        self.asked = Ts, n_steps, limits, plant_info
"""
    }
    Ts, n_steps, limits, info = own_estimator(write(tmp_path, files, estimator="{file: asks.py:Asks}")).asked
    assert (Ts, n_steps, info.nx, info.parameters["J_l"]) == (0.1, 10, 4, 25.0)
    assert np.isinf(limits.u).all()


def test_keys_are_validated_as_those_of_built_in_components(tmp_path):
    """A quantity is read; a wrong value and an unknown key have their place and the nearest name."""
    assert own_estimator(write(tmp_path, estimator="{file: own.py:Own, gain: 5%}")).gain == 0.05
    found = problems(write(tmp_path, estimator="{file: own.py:Own, gain: -1}"))
    assert found == ["tiny.yaml:13:86: methods.Own.estimator.gain: must be > 0 (got -1)"]
    found = problems(write(tmp_path, estimator="{file: own.py:Own, gian: 1}"))
    assert found == [
        "tiny.yaml:13:80: methods.Own.estimator.gian: 'gian' is not a known key; did you mean 'gain'?",
    ]


def test_a_method_replaces_or_extends_the_default(tmp_path):
    """Another file, or another kind, replaces whole; a key alone is merged into the default."""
    methods = (
        "{A: {}, B: {estimator: {gain: 0.3}}, C: {estimator: {kind: kalman}}, D: {estimator: {file: more.py:Own}}, "
        "E: {estimator: {kind: own.py:Own}}}"
    )
    files = {"more.py": ESTIMATOR.replace("Positive = 0.1", "Positive = 0.7")}
    path = write(tmp_path, files, methods=methods, **{"estimator": "{}"})
    path.write_text(path.read_text().replace("methods:", "estimator: {file: own.py:Own, gain: 0.2}\nmethods:"))
    methods = {method.name: method.estimator for method in load_config(path).experiment.methods}
    assert {name: methods[name].gain for name in "ABDE"} == {"A": 0.2, "B": 0.3, "D": 0.7, "E": 0.2}
    assert not hasattr(methods["C"], "gain")


def test_overrides_name_files_relative_to_the_configuration(tmp_path, monkeypatch):
    """Not to the current directory, where a file of the same name lies."""
    path = write(tmp_path / "there", {"own.py": ESTIMATOR.replace("Positive = 0.1", "Positive = 0.7")})
    write(tmp_path)
    monkeypatch.chdir(tmp_path)
    for override in ("methods.KF.estimator={file: own.py:Own}", "methods.KF.estimator.kind=own.py:Own"):
        assert load_config(path, overrides=[override]).experiment.method("KF").estimator.gain == 0.7


def test_sweep_over_files(tmp_path):
    """A point per file; the text of the value names it."""
    files = {"more.py": ESTIMATOR.replace("Positive = 0.1", "Positive = 0.7")}
    sweep = "{grid: {estimator: [{file: own.py:Own}, {file: more.py:Own}, {kind: kalman}]}}"
    config = load_config(write(tmp_path, files, methods="{A: {}}", sweep=sweep))
    gains = [getattr(point.experiment.methods[0].estimator, "gain", None) for point in config.points]
    assert gains == [0.1, 0.7, None]
    assert config.points[0].title == "estimator={file: own.py:Own}"
    assert len({key for point in config.points for key in point.method_keys.values()}) == 3
    config = load_config(
        write(tmp_path, methods="{A: {}}", sweep="{grid: {estimator.file: [own.py:Own, more.py:Own]}}")
    )
    assert [point.experiment.methods[0].estimator.gain for point in config.points] == [0.1, 0.7]


def test_equal_texts_in_two_files_are_two_components(tmp_path):
    """A plant of another configuration names the file beside itself, and its keys do not count for another file."""
    plant = "def design(Ts, *, J_l: float = {}, {}: float = 0.0):\n"
    body = "    from rmpc_bench import plant\n    return plant('servo-linear', Ts, J_l=J_l)\n"
    base = write(tmp_path / "base", {"sys.py": plant.format(21.0, "one") + body}, plant="{file: sys.py:design, one: 1}")
    path = write(tmp_path, {"sys.py": plant.format(22.0, "two") + body}, plant="{from: base/tiny.yaml}")
    assert load_config(path).experiment.plant.nominal["J_l"] == 21.0
    path = write(tmp_path, plant="{from: base/tiny.yaml, file: sys.py:design, two: 2}")
    assert load_config(path).experiment.plant.nominal["J_l"] == 22.0
    assert base.exists()


def test_a_plant_of_another_directory_needs_consent(tmp_path):
    """The directory of the configuration that the user names counts, not that of the files it includes."""
    body = "def design(Ts):\n    from rmpc_bench import plant\n    return plant('servo-linear', Ts)\n"
    write(tmp_path / "base", {"sys.py": body}, plant="{file: sys.py:design}")
    path = write(tmp_path / "here", plant="{from: ../base/tiny.yaml}")
    (found,) = problems(path)
    assert "plant.file: ../base/sys.py is outside the directory of the configuration" in found
    config = load_config(path, allow_code=[tmp_path / "base" / "sys.py"])
    assert config.first_point["plant"]["file"] == "../base/sys.py:design"


def test_paths_with_blanks_and_names_inside_a_class(tmp_path):
    """The last colon separates the file from the name."""
    files = {"my parts/own v1.2.py": f"{ESTIMATOR}\n\nclass Outer:\n    Inner = Own\n"}
    path = write(tmp_path, files, estimator="{file: 'my parts/own v1.2.py:Outer.Inner', gain: 0.4}")
    assert own_estimator(path).gain == 0.4


def test_functions_and_data_of_keys(tmp_path, clean):
    """A design function receives the loaded object and the sorted files, also inside records and lists."""
    received = {}

    def design(Ts, *, f: UserFunction, data: DataFiles, g: UserFunction | None = None, more: list[UserFunction] = ()):
        received.update(f=f, data=data, g=g, more=more)
        return rmpc_bench.plant("servo-linear", Ts)

    registry.register("plant", "asking", design)
    files = {"fun.py": "def f(): return 1\ndef g(): return 2\n", "runs/b.csv": "2", "runs/a.csv": "1", "c.csv": ""}
    plant = "{kind: asking, f: fun.py:f, data: 'runs/*.csv', g: fun.py:g, more: [fun.py:f, fun.py:g]}"
    config = load_config(write(tmp_path, files, plant=plant))
    assert (received["f"](), received["g"](), [each() for each in received["more"]]) == (1, 2, [1, 2])
    assert received["data"] == (tmp_path / "runs" / "a.csv", tmp_path / "runs" / "b.csv")
    assert config.first_point["plant"] == {
        **{"kind": "asking", "f": "fun.py:f", "data": "runs/*.csv", "g": "fun.py:g"},
        "more": ["fun.py:f", "fun.py:g"],
    }
    load_config(write(tmp_path, files, plant="{kind: asking, f: fun.py:f, data: c.csv}"))
    assert received["g"] is None and received["data"] == (tmp_path / "c.csv",)
    found = problems(write(tmp_path, files, plant="{kind: asking, f: fun.py:h, data: d.csv}"))
    assert [each.partition(": plant.")[2] for each in found] == [
        "f: 'h' is not a known name in fun.py; known: f, g",
        "data: there is no file d.csv; did you mean 'c.csv'?",
    ]
    (found,) = problems(write(tmp_path, files, plant="{kind: asking, f: 3, data: c.csv}"))
    assert "must name a function of a Python file, PATH.py:NAME" in found


def test_plugins_register_kinds(tmp_path, clean, capsys):
    """A file under `plugins` runs first; its names are kinds as all others, also after it has changed."""
    text = ESTIMATOR + "\nimport rmpc_bench\nrmpc_bench.register('estimator', 'mine', Own)\n"
    path = write(tmp_path, {"plug.py": text}, estimator="{kind: mine, gain: 0.4}", plugins="[plug.py]")
    assert own_estimator(path).gain == 0.4
    assert capsys.readouterr().err.startswith("code  plug.py (sha ")
    assert own_estimator(path).gain == 0.4
    assert capsys.readouterr().err == ""
    (tmp_path / "plug.py").write_text(text.replace("self.gain = model, x0, gain", "self.gain = model, x0, 2 * gain"))
    assert own_estimator(path).gain == 0.8
    said = capsys.readouterr().err.splitlines()
    assert said[0].startswith("code  plug.py (sha ")
    assert said[1:] == ["estimator 'mine': the new definition replaces the earlier one"]
    found = problems(write(tmp_path, plugins="[plug.pi, gone.py]"))
    assert [each.partition(": plugins.")[2] for each in found] == [
        "0: must be a Python file that registers components (got 'plug.pi')",
        "1: there is no file gone.py; did you mean 'own.py'?",
    ]


def test_methods_with_a_default_of_another_short_form():
    """A short form counts as the kind before the merge: the keys of the default do not count for another form."""
    from rmpc_bench.config_file.tree import merge, plain, with_kind
    from rmpc_bench.config_file.yaml import parse

    default, own = (
        with_kind("models", parse(text, "a.yaml"))
        for text in ("{linearise: plant, at: {u: 8}}", "{ode: simple.py:rhs, parameters: {a: 1}}")
    )
    assert plain(merge(default, own)) == {"ode": "simple.py:rhs", "parameters": {"a": 1}, "kind": "ode"}
    again = with_kind("models", parse("{linearise: plant, jacobian: a.py:J}", "a.yaml"))
    assert plain(merge(default, again))["at"] == {"u": 8}


@pytest.mark.parametrize(
    ("estimator", "message"),
    [
        ("{}", "'kind' is missing; known kinds of estimator: "),
        ("{file: own.py}", "file: must name something in a Python file, PATH.py:NAME (got 'own.py')"),
        ("{file: 3}", "kind: '3' is not a known estimator"),
        ("{kind: kalman, file: own.py:Own}", "file: stands for `kind`; give one of the two"),
    ],
)
def test_forms_that_are_none(tmp_path, estimator, message):
    """With the form to write."""
    (found,) = problems(write(tmp_path, methods=METHODS % estimator))
    assert message in found


def test_a_wrong_key_beside_a_second_kind(tmp_path):
    """Both are reported."""
    found = problems(write(tmp_path, methods=METHODS % "{kind: kalman, file: own.py:Own, wrong: 1}"))
    assert len(found) == 2
    assert "file: stands for `kind`" in found[0] and "wrong: 'wrong' is not a known key" in found[1]


def test_points_of_a_sweep_read_a_file_once(tmp_path, monkeypatch):
    """The same component at many points costs one look at its file, not one per point."""
    from rmpc_bench.components import consent

    looked = []
    check = consent.import_file
    monkeypatch.setattr(consent, "import_file", lambda *given: looked.append(given) or check(*given))
    sweep = "{grid: {estimator.gain: [0.1, 0.2, 0.3], seed: [1, 2]}}"
    path = write(tmp_path, methods="{A: {}, B: {estimator: {gain: 0.5}}}", sweep=sweep)
    path.write_text(path.read_text().replace("methods:", "estimator: {file: own.py:Own}\nmethods:"))
    assert len(load_config(path).points) == 6
    assert len(looked) == 1
