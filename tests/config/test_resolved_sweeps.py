"""The resolved configuration of a sweep loads to an equal one, also where a row of a zip leaves a value as it is."""

import pytest
from small_experiment import write

from rmpc_bench import load_config
from rmpc_bench.config_file.tree import plain
from rmpc_bench.config_file.yaml import dump

ROWS = [
    "{plant.perturb: {R: 1 + eps}}",
    "{plant.perturb.R: 1 + 2*eps}",
    "{plant.R: 2}",
    "{uncertainty.eps: +-50%}",
    "{noise: none}",
    "{noise.measurement.gaussian.std: 0.5}",
    "{initial.x: 1}",
    "{initial: {x: 1, x_hat: 1, P: 2}}",
    "{reference.value: 0.5}",
    "{reference: {kind: square, values: [0, 1], period: 0.4}}",
    "{seed: 11}",
    "{time.step: 0.05}",
    "{model.noise.process: 2}",
    "{controller.Hp: 12}",
    "{methods.R-MPC.estimator.c: 0.2}",
]


@pytest.mark.parametrize(("row", "smoke"), [*((row, False) for row in ROWS), ("{time.step: 0.05}", True)])
@pytest.mark.parametrize("order", ["first", "last"])
def test_a_row_that_changes_what_another_leaves(tmp_path, row, order, smoke):
    """Whichever of the two comes first."""
    rows = [row[0] + "name: changed, " + row[1:], "{name: as given}"]
    path = write(
        tmp_path,
        sweep="{zip: [" + ", ".join(rows if order == "first" else rows[::-1]) + "]}",
        smoke="{runs: 2, steps: 5}",
    )
    config = load_config(path, smoke=smoke)
    again = tmp_path / "again.yaml"
    again.write_text(dump(plain(config.resolved)))
    loaded = load_config(again)
    assert [point.experiment_hash for point in loaded.points] == [point.experiment_hash for point in config.points]
    assert [point.method_keys for point in loaded.points] == [point.method_keys for point in config.points]
    assert loaded.resolved == config.resolved
    assert len({(point.experiment_hash, *point.method_keys.values()) for point in config.points}) == 2


def test_a_sweep_that_is_taken_away(tmp_path):
    """The resolved configuration has none either."""
    path = write(tmp_path, sweep="{zip: [{name: changed, seed: 3}, {name: as given}]}")
    config = load_config(path, overrides=["sweep=null"])
    (tmp_path / "again.yaml").write_text(dump(plain(config.resolved)))
    loaded = load_config(tmp_path / "again.yaml")
    assert [point.title for point in loaded.points] == [""]
    assert loaded.full_hash == config.full_hash
