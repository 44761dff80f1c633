"""list and describe: the reference manual."""

import pytest
from small_experiment import cli, write

from rmpc_bench import registry
from rmpc_bench.experiment.schema import PROVIDED, model_of

PARTS = [(group, name) for group in registry.BUILT_IN for name in registry.names(group)]


@pytest.mark.parametrize("group", registry.BUILT_IN)
def test_list_of_a_group(group):
    """One name a line, sorted, nothing else: made for scripts."""
    assert cli("list", group).stdout.splitlines() == registry.names(group)


def test_list_of_everything():
    """The groups with their names below."""
    shown = cli("list").stdout
    for group, name in PARTS:
        assert f"\n  {name}\n" in shown.split(f"{group}:")[1]


def test_list_of_configurations(tmp_path, monkeypatch):
    """The files below configs, from where one stands."""
    (tmp_path / "configs" / "paper").mkdir(parents=True)
    write(tmp_path / "configs" / "paper", file="fig1.yaml")
    write(tmp_path / "configs", file="quickstart.yaml")
    monkeypatch.chdir(tmp_path)
    assert cli("list", "configs").stdout.split() == ["configs/paper/fig1.yaml", "configs/quickstart.yaml"]


@pytest.mark.parametrize(("group", "name"), PARTS)
def test_describe_shows_every_key_with_its_meaning(group, name):
    """What it is, every key that a configuration may give, whether it is required, and what it means."""
    result = cli("describe", f"{group}/{name}")
    assert result.exit_code == 0
    assert result.stdout.startswith(f"{group}/{name}\n\n")
    _, _, keys = result.stdout.partition("\nKeys\n")
    lines = keys.splitlines()
    fields = model_of(group, name).model_fields
    heads = [number for number, line in enumerate(lines) if line.startswith("  ") and line[2] != " "]
    assert [lines[number].split()[0] for number in heads] == [field.alias or key for key, field in fields.items()]
    for number, field in zip(heads, fields.values(), strict=True):
        assert ("(required)" in lines[number]) == field.is_required()
        assert lines[number + 1 : number + 2] and lines[number + 1].startswith("      "), lines[number]
    assert not any(f"  {provided}  (" in keys for provided in PROVIDED[group])


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
        ("kalmn", "'kalmn' is not a known part; did you mean 'kalman'?"),
        ("plants/kalman", "'kalman' is not a known part; known: servo, servo-linear"),
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
    assert "half" in cli("list", "estimators").stdout.splitlines()
    shown = cli("describe", "half").stdout
    assert "Take half of the innovation." in shown
    assert "  gain  (default 0.5)\n      how much of it, exactly\n" in shown
