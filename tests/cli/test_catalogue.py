"""list and describe: the reference manual."""

import re

import numpy as np
import pytest
from small_experiment import cli, write

from rmpc_bench import registry
from rmpc_bench.config_file.keys import PROVIDED, model_of
from rmpc_bench.extras import NEEDED_BY, missing_for, need
from rmpc_bench.types import Line, Panel, Plant

PARTS = [(group, name) for group in registry.BUILT_IN for name in registry.names(group)]


@pytest.mark.parametrize("group", registry.BUILT_IN)
def test_list_of_a_group(group):
    """A line per name with its tags and its text, at most 80 columns."""
    head, empty, *lines = cli("list", group).stdout.splitlines()
    assert head.split()[0] == group and empty == "" and all(len(line) <= 80 for line in [head, *lines])
    lacking = [kind for kind in registry.names(group) if missing_for(group, kind)]
    alone = [kind for kind in registry.names(group) if kind not in lacking]
    names = [*alone, *lacking]
    assert [re.split(r"  +", line.strip())[0] for line in lines] == names
    texts = {name: line for name, line in zip(names, lines, strict=True)}
    assert all(texts[kind].endswith(f" {registry.short(group, kind)}") for kind in alone)
    assert all(texts[kind].endswith(f"needs rmpc-bench[{NEEDED_BY[group, kind]}]") for kind in lacking)
    for kind in alone:
        said = texts[kind].removesuffix(registry.short(group, kind)).split()
        assert said == [kind, *registry.tags(group, kind)]
    if group in registry.NONLINEAR:
        text = cli("list", group, "--tag", "nonlinear").stdout
        assert {line.split()[0] for line in text.splitlines()[2:]} == registry.NONLINEAR[group]


@pytest.mark.parametrize("tag", registry.TAGS)
def test_list_of_a_tag(tag):
    """Both groups; a kind that takes both models has the tag of each."""
    text = cli("list", "--tag", tag).stdout
    having = {"nonlinear": {"both"}, "linear": {"both", "linear"}}.get(tag, {tag})
    expected = {kind for group in registry.NONLINEAR for kind in registry.names(group)
                if having & {*registry.tags(group, kind)}}  # fmt: skip
    listed = [line.split()[0] for line in text.splitlines() if line.startswith(" ")]
    assert {*listed} == expected and len(listed) == len(expected) and max(map(len, text.splitlines())) <= 80


def test_tags_of_what_has_none():
    """Exit 2, the tags that there are, and the groups."""
    assert "only estimators and controllers have tags" in cli("list", "plants", "--tag", "gaps").stderr
    result = cli("list", "--tag", "gap")
    assert result.exit_code == 2 and "'linear', 'nonlinear', 'both', 'gaps'" in result.stderr


def test_list_of_the_mock():
    """Some lines of estimators, character by character."""
    lines = cli("list", "estimators").stdout.splitlines()
    assert lines[0] == "estimators   (design model; gaps: predicts where a measurement is missing)"
    for line in (
        " extended-kalman           both   gaps  linearises at every estimate",
        " kalman                    linear gaps  Kalman filter of the nominal model",
        " lp-window                 linear gaps  linear program over a window",
    ):
        assert line in lines


def test_list_of_everything():
    """The kinds and how many there are of each."""
    counts = dict(line.split() for line in cli("list").stdout.splitlines() if line[-1:].isdigit())
    assert [*counts] == [*registry.BUILT_IN, "functions", "configs"]
    assert all(int(counts[group]) == len(registry.names(group)) for group in registry.BUILT_IN)


def test_a_narrow_terminal(monkeypatch):
    """Lines are broken, and nothing is lost."""
    wide = cli("list", "metrics").stdout
    monkeypatch.setenv("COLUMNS", "60")
    narrow = cli("list", "metrics").stdout
    assert max(map(len, narrow.splitlines())) <= 60 and narrow.split() == wide.split()


def test_list_of_configurations(tmp_path, monkeypatch):
    """The files below configs, from where one stands."""
    (tmp_path / "configs" / "paper").mkdir(parents=True)
    write(tmp_path / "configs" / "paper", file="fig1.yaml")
    write(tmp_path / "configs", file="quickstart.yaml")
    monkeypatch.chdir(tmp_path)
    own = {"configs/paper/fig1.yaml", "configs/quickstart.yaml"}
    listed = cli("list", "configs").stdout.split()
    # Those of the package come besides; a place that both have is listed once.
    assert own < {*listed} and "configs/zenere2018/fig7.yaml" in listed
    assert listed == sorted({*listed})


@pytest.mark.parametrize(("group", "name"), PARTS)
def test_describe_shows_every_key_with_its_meaning(group, name):
    """What it is, every key that a configuration may give, whether it is required, and what it means."""
    result = cli("describe", f"{group}/{name}")
    assert result.exit_code == 0
    assert result.stdout.startswith(f"{group}/{name}  {need(group, name)}".rstrip() + "\n\n")
    _, _, keys = result.stdout.partition("\nKeys\n")
    lines = keys.splitlines()
    fields = model_of(group, name).model_fields
    heads = [number for number, line in enumerate(lines) if line.startswith("  ") and line[2] != " "]
    assert [lines[number].split()[0] for number in heads] == [field.alias or key for key, field in fields.items()]
    for number, field in zip(heads, fields.values(), strict=True):
        assert ("(required)" in lines[number]) == field.is_required()
        assert lines[number + 1 : number + 2] and lines[number + 1].startswith("      "), lines[number]
    assert not any(f"  {provided}  (" in keys for provided in PROVIDED[group])


def test_describe_shows_the_examples_of_a_docstring_after_the_keys():
    """Also of a class whose docstring has Parameters; other sections are not shown."""
    for name, example in [("tracking", 'norm="peak"'), ("mse", 'Mse(to="N")')]:
        shown = cli("describe", f"metrics/{name}").stdout
        description, _, rest = shown.partition("\nKeys\n")
        keys, _, examples = rest.partition("\nExamples\n\n")
        assert ">>>" not in description and ">>>" not in keys and "---" not in shown
        assert example in examples
    assert "Raises" not in cli("describe", "noises/uniform").stdout


def test_describe_finds_a_name_in_several_groups():
    """A plant and a model of the same name are both shown; a group picks one, in singular or plural."""
    both = cli("describe", "servo-linear").stdout
    assert "plants/servo-linear\n" in both and "models/servo-linear\n" in both
    for name in ("plants/servo-linear", "plant/servo-linear"):
        one = cli("describe", name).stdout
        assert one.startswith("plants/servo-linear\n") and "models/servo-linear" not in one


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("kalmn", "'kalmn' is not a known component or configuration; did you mean 'kalman'?"),
        (
            "plants/kalman",
            "'kalman' is not a known component; known: ",
        ),
        ("planets/servo", "'planets' is not a known group; did you mean 'plants'?"),
    ],
)
def test_describe_an_unknown_name(name, message):
    """Exit 2 and the way out."""
    result = cli("describe", name)
    assert result.exit_code == 2 and message in " ".join(result.stderr.split())


def test_a_registered_part_is_in_the_manual(monkeypatch):
    """Like a built-in one."""
    monkeypatch.setattr(registry, "_REGISTERED", {group: {} for group in registry.BUILT_IN})

    def design(model, n_steps, *, x0, P0, gain: float = 0.5):
        """Take half of the innovation.

        Parameters
        ----------
        gain : how much of it,
            exactly
        """

    registry.register("estimator", "half", design)
    assert re.search("^ half +Take half of the innovation.$", cli("list", "estimators").stdout, re.MULTILINE)
    shown = cli("describe", "half").stdout
    assert "Take half of the innovation." in shown
    assert "  gain  (default 0.5)  number\n      how much of it, exactly\n" in shown


class Drawn(Plant):
    """A plant with a plot."""

    def plots(self):
        """One panel."""
        return (Panel("drawn", "x", "y", (Line("line", np.arange(3.0), np.arange(3.0)),)),)


@pytest.fixture
def drawn(monkeypatch):
    """Register plants with a plot, one of which needs a key, and one that has none."""
    monkeypatch.setattr(registry, "_REGISTERED", {group: {} for group in registry.BUILT_IN})

    def design(Ts: float, *, gain: float = 1.0):
        """Draw it."""
        assert Ts > 0
        return Drawn()

    def design_with_key(Ts: float, *, gain: float):
        """Draw it if you can."""
        return Drawn()

    registry.register("plant", "drawn", design)
    registry.register("plant", "needs-a-key", design_with_key)
    registry.register("plant", "plain", lambda Ts: Plant())


@pytest.mark.parametrize(
    ("ending", "head"), [("svg", b"<svg"), ("png", b"\x89PNG"), ("pdf", b"%PDF"), ("PNG", b"\x89PNG")]
)
def test_describe_with_a_picture(drawn, tmp_path, ending, head):
    """The manual on stdout, the picture in the format of the ending, the same bytes each time."""
    files = [tmp_path / f"{stem}.{ending}" for stem in ("one", "other")]
    for file in files:
        result = cli("describe", "drawn", "--plot", file)
        assert result.exit_code == 0 and result.stdout.startswith("plants/drawn\n")
        assert result.stderr == f"written {file}\n"
    one, other = (file.read_bytes() for file in files)
    assert one == other and one.startswith(head)


@pytest.mark.parametrize(
    ("name", "file", "message"),
    [
        ("drawn", "a.gif", "a.gif: the ending must be one of .svg, .png, .pdf"),
        ("drawn", "a", "a: the ending must be one of"),
        ("plain", "a.svg", "plain has no picture (there is one of"),
        ("plain", "a.svg", "plants/drawn"),
        ("needs-a-key", "a.svg", "needs-a-key has no picture"),
        ("kalman", "a.svg", "kalman has no picture"),
    ],
)
def test_no_picture(drawn, tmp_path, monkeypatch, name, file, message):
    """Exit 2, the way out, and no file."""
    monkeypatch.chdir(tmp_path)
    result = cli("describe", name, "--plot", file)
    assert result.exit_code == 2 and message in " ".join(result.stderr.split()) and result.stdout == ""
    assert not list(tmp_path.iterdir())


def test_a_picture_that_cannot_be_written(drawn, tmp_path):
    """Exit 74, as for results."""
    result = cli("describe", "drawn", "--plot", tmp_path / "missing" / "a.svg")
    assert result.exit_code == 74 and "cannot be written" in result.stderr


def test_friction_of_the_servo(tmp_path):
    """Fig. 2 of zenere2018."""
    file = tmp_path / "friction.svg"
    result = cli("describe", "plants/servo", "--plot", file)
    assert result.exit_code == 0 and file.read_bytes().startswith(b"<svg")
    stderr = cli("describe", "servo-linear", "--plot", file).stderr
    assert "there is one of plants/moving-slide, plants/servo)" in " ".join(stderr.split())


@pytest.fixture
def configs(tmp_path, monkeypatch):
    """Stand where there are configurations, one of them with a sweep, two of the same name, and a part's namesake."""
    for folder, file, keys in [
        ("paper", "fig1", {"title": "A figure"}),
        ("paper", "swept", {"sweep": "{grid: {plant.perturb.J_l: [1 + eps, 2]}}"}),
        ("paper", "twice", {}),
        ("other", "twice", {}),
        ("", "kalman", {"title": "A namesake"}),
    ]:
        directory = tmp_path / "configs" / folder
        directory.mkdir(parents=True, exist_ok=True)
        write(directory, file=f"{file}.yaml", **keys)
    monkeypatch.setattr("rmpc_bench.config_file.known_files.installed_folder", lambda: tmp_path / "installed")
    monkeypatch.chdir(tmp_path)
    return tmp_path / "configs"


DESCRIBED = """\
configs/paper/fig1.yaml
A figure

plant servo-linear

noise:
  process: none
  measurement: {gaussian: {mean: 0.0, std: 0.01, scale: 1.0}}
initial: {x: 0.0, x_hat: 0.0, P: process}

methods
  S-MPC
  R-MPC
"""


@pytest.mark.parametrize("name", ["fig1", "paper/fig1", "configs/paper/fig1.yaml"])
def test_describe_a_configuration(configs, name):
    """By its name, by its place below configs, or by its file: what is true, where it starts, who is compared."""
    assert cli("describe", name).stdout == DESCRIBED


def test_describe_a_configuration_anywhere(configs, tmp_path):
    """A file need not be below configs; without a title its name stands for it, and labels stand with the methods."""
    methods = "{S-MPC: {estimator: {kind: kalman}, label: Standard}}"
    path = write(tmp_path, file="mine.yaml", methods=methods)
    lines = cli("describe", path).stdout.splitlines()
    # A path that is longer than a line is broken.
    assert "".join(map(str.strip, lines[: lines.index("tiny")])) == str(path) and lines[-2:] == [
        "methods",
        "  S-MPC  Standard",
    ]


def test_describe_a_sweep(configs):
    """What is shown is of the first point, and that is said."""
    shown = cli("describe", "swept").stdout
    assert "\nat the first of 2 points, plant.perturb.J_l=1 + eps\n\nplant servo-linear\n" in shown


def test_describe_shows_what_is_known_of_the_plant(configs, monkeypatch):
    """Labels in one column, texts of several lines below each other."""
    from rmpc_bench.plants import servo

    facts = [("A", "0  -0.5\n1     1"), ("spectral radius", "0.707107")]
    monkeypatch.setattr(servo.ServoLinear, "facts", lambda self: facts, raising=False)
    shown = cli("describe", "fig1").stdout
    assert (
        "\nplant servo-linear\n  A                0  -0.5\n                   1     1\n  spectral radius  0.707107\n"
        in shown
    )


def test_a_part_wins_over_a_configuration(configs):
    """The configuration of the same name is found by its file."""
    assert cli("describe", "kalman").stdout.startswith("estimators/kalman\n")
    assert cli("describe", "configs/kalman.yaml").stdout.startswith("configs/kalman.yaml\nA namesake\n")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("fig2", "'fig2' is not a known component or configuration; did you mean 'fig1'? (rmpc-bench list)"),
        ("papers/fig1", "'papers/fig1' is not a known configuration; did you mean 'paper/fig1'?"),
        ("configs/paper/fig2.yaml", "did you mean 'configs/paper/fig1.yaml'? (rmpc-bench list configs)"),
        ("twice", "'twice' may be any of configs/other/twice.yaml, configs/paper/twice.yaml"),
        ("plants/fig1", "'fig1' is not a known component; known: "),
        ("kalmn", "'kalmn' is not a known component or configuration; did you mean 'kalman'?"),
        ("configs", "'configs' is not a known component or configuration"),
    ],
)
def test_describe_an_unknown_configuration(configs, name, message):
    """Exit 2 and the way out."""
    result = cli("describe", name)
    assert result.exit_code == 2 and message in " ".join(result.stderr.split()) and result.stdout == ""


def test_describe_a_configuration_with_mistakes(configs):
    """Exit 2 with their places, as of any verb."""
    write(configs, file="wrong.yaml", runs=0)
    result = cli("describe", "wrong")
    assert result.exit_code == 2 and "configs/wrong.yaml:4:" in result.stderr and result.stdout == ""


def test_describe_a_configuration_with_a_picture(configs, monkeypatch):
    """The plots of its plant, with the parameters it has there; the usual message where there is none."""
    result = cli("describe", "fig1", "--plot", "plant.svg")
    message = " ".join(result.stderr.split())
    assert result.exit_code == 2 and "fig1 has no picture (there is one of plants/moving-slide, plants/servo" in message
    write(configs, file="friction.yaml", plant="{kind: servo}")
    result = cli("describe", "friction", "--plot", "plant.svg")
    assert result.exit_code == 0 and result.stderr == "written plant.svg\n"
    assert result.stdout.startswith("configs/friction.yaml\n")
    assert (configs.parent / "plant.svg").read_bytes().startswith(b"<svg")


def test_list_of_the_functions_of_claims():
    """Oracle: the grammar's own table."""
    from rmpc_bench.claims.grammar import FUNCTIONS

    lines = cli("list", "functions").stdout.splitlines()
    assert [line.split("(")[0].strip() for line in lines if line[1] != " "] == [*FUNCTIONS]
    assert all(len(line) <= 80 for line in lines)


def test_keys_inside_a_key_are_described():
    """Oracle: the fields of the dataclasses, with their meanings, and the default as YAML."""
    shown = cli("describe", "plants/uncertain-linear").stdout
    assert "(default {law: uniform, low: -1, high: 1, per: step})" in shown
    assert "        against : method whose error the greedy law maximises\n" in shown
    assert "        w : excess over the largest singular value" in cli("describe", "enhanced-robust").stdout
