"""The number of the arithmetic grows with every change that alters numbers.

The golden values are guards and no oracles: they are copied from the bench itself.  They guard that nobody mixes
rows of two arithmetics, since `rmpc_bench.NUMERICS` is what tells them apart.
"""

import golden_trials
import pytest
from golden_trials import CONFIGS, Golden, Key, computed, differences, stored

import rmpc_bench

WAY_OUT = """
If the code alters these numbers: raise rmpc_bench.NUMERICS in the same commit, say why in its message, and renew the
values with `python tests/golden_trials.py`.  If only the configuration has changed (another definition): renew them."""
KEY = Key("paper/figure", "", "S-MPC", "mse")


@pytest.mark.parametrize("name", CONFIGS)
def test_golden_values(name):
    """The first runs of every method have the numbers of the file, to what another machine may change."""
    _, before = stored()
    before = {key: golden for key, golden in before.items() if key.config == name}
    assert before, f"no golden values of {name}{WAY_OUT}"
    changed = differences(before, computed(name))
    assert not changed, "\n".join(changed) + WAY_OUT


def test_the_golden_values_have_the_number_of_the_code():
    """Whoever raises NUMERICS renews the values, and the other way about."""
    assert stored()[0] == rmpc_bench.NUMERICS, WAY_OUT


@pytest.mark.parametrize(
    ("values", "n_lines"),
    [
        (("1.0", "inf"), 0),
        (("1.0000000001", "inf"), 0),
        (("1.00000001", "inf"), 1),
        (("1.0", "2.0"), 1),
        (("1.0", "nan"), 1),
    ],
)
def test_what_counts_as_a_difference(values, n_lines):
    """More than 1e-9 relative, and any other word or infinity."""
    assert len(differences({KEY: Golden("a", ("1.0", "inf"))}, {KEY: Golden("a", values)})) == n_lines


def test_a_value_that_is_gone():
    """A method that is not in the configuration any more guards nothing."""
    assert differences({KEY: Golden("a", ("1.0",))}, {}) == ["paper/figure  S-MPC mse: is not computed any more"]


def test_numbers_are_not_renewed_under_the_same_number(tmp_path, monkeypatch):
    """The command refuses, names what differs and writes nothing; with a higher number it writes."""
    monkeypatch.setattr(golden_trials, "FILE", tmp_path / "golden.csv")
    monkeypatch.setattr(golden_trials, "CONFIGS", ("paper/figure",))
    for definition, value, number, refused in (
        ("a", "1.0", 1, False),
        ("a", "2.0", 1, True),
        ("b", "2.0", 1, False),
        ("b", "3.0", 2, False),
    ):
        golden = {KEY: Golden(definition, (value, value))}
        monkeypatch.setattr(golden_trials, "computed", lambda name, golden=golden: golden)
        monkeypatch.setattr(rmpc_bench, "NUMERICS", number)
        message = golden_trials.renew()
        assert bool(message) == refused
        assert (stored() == (number, golden)) != refused
    assert stored()[0] == 2


def test_last_digits_of_another_machine_change_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(golden_trials, "FILE", tmp_path / "golden.csv")
    monkeypatch.setattr(golden_trials, "CONFIGS", ("paper/figure",))
    for value in ("1.0", "1.0000000000000002"):
        monkeypatch.setattr(golden_trials, "computed", lambda name, value=value: {KEY: Golden("a", (value, value))})
        assert golden_trials.renew() is None and stored()[1] == {KEY: Golden("a", ("1.0", "1.0"))}
