"""One run of a configuration with its full trace; the exception of a crashing component is raised."""

import pdb
import traceback

import numpy as np
import pytest
from own_experiment import write_own
from small_experiment import write

import rmpc_bench
from rmpc_bench import Estimator, load_config, replay, run, run_one
from rmpc_bench.types import DesignError, InvalidReturnValue


def test_the_trace_is_that_of_the_experiment(tmp_path):
    path = write(tmp_path, record="{runs: 6, signals: [x, y, u, x_hat, P]}")
    config = load_config(path)
    results = run(config, directory=tmp_path / "out", jobs=1)
    for method in ("S-MPC", "R-MPC"):
        one, recorded = run_one(config, method, run=4), results.traces[method].signals
        for name in ("x", "y", "x_hat"):
            np.testing.assert_array_equal(getattr(one, name), recorded[name][4])
        np.testing.assert_array_equal(one.u, recorded["u"][4][: len(one.u)])
        np.testing.assert_array_equal(one.P.reshape(len(one.x), -1), recorded["P"][4])
        stored = replay(tmp_path / "out", 4, method)
        assert one.metrics == stored.metrics == stored.stored and one.status == "ok"
        frame = one.to_frame()
        assert len(frame) == 11 and {"k", "t", "r", "y", "u", "x.0", "x_hat.0", "P.15"} <= {*frame}
        # The file of `replay --export` keeps its columns.
        assert [*stored.to_frame()] == [name for name in frame if name[:2] != "P."]


def test_a_file_or_a_mapping_stands_for_a_configuration(tmp_path):
    path = write(tmp_path)
    by_file, overridden = run_one(path, "R-MPC", run=5), load_config(path, overrides="methods.R-MPC.estimator.c=0.2")
    assert run_one(str(path), "R-MPC", run=5).metrics == by_file.metrics != run_one(overridden, "R-MPC", 5).metrics


def test_the_exception_of_a_single_run_component_is_raised_at_its_place(tmp_path, monkeypatch):
    opened = []
    monkeypatch.setattr(pdb, "post_mortem", lambda place: opened.append(place.tb_frame))
    config = load_config(write_own(tmp_path))
    assert run_one(config, "raises", run=1).status == "ok"
    with pytest.raises(ValueError, match=r"negative level -1\.0") as caught:
        run_one(config, "raises", run=2)
    assert traceback.extract_tb(caught.value.__traceback__)[-1].name == "update" and not opened
    with pytest.raises(ValueError, match="negative level"):
        run_one(config, "raises", run=2, debug=True)
    [frame] = opened
    assert frame.f_code.co_name == "update" and frame.f_locals["level"] == -1.0


def test_held_steps_and_failures_of_solvers_are_no_exceptions(tmp_path):
    config = load_config(write_own(tmp_path))
    assert run_one(config, "holds", run=3).status == "ok"
    assert run_one(config, "stops", run=3).status == "not-converged"


class Vector(Estimator):
    """An estimator of a block, which raises or answers with another shape."""

    def __init__(self, model, n_steps, *, x0, P0, fails: str):
        self.start, self.fails = np.asarray(x0), fails

    def init(self, n_runs):
        return np.tile(self.start, (n_runs, 1))

    def correct(self, k, state, y):
        if k == 3 and self.fails == "raise":
            raise ArithmeticError("at the fourth sample")
        return state, state[:, :1] if k == 3 else state

    def predict(self, k, state, u):
        return state


@pytest.mark.parametrize(
    ("fails", "error", "text"),
    [("raise", ArithmeticError, "at the fourth sample"), ("shape", InvalidReturnValue, "correct returned x_hat as")],
)
def test_the_exception_of_a_component_for_blocks_is_raised(fails, error, text, tmp_path):
    rmpc_bench.register("estimator", "vector", Vector)
    config = load_config(write(tmp_path, methods=f"{{V: {{estimator: {{kind: vector, fails: {fails}}}}}}}"))
    with pytest.raises(error, match=text):
        run_one(config, "V")


def test_an_invalid_answer_of_a_single_run_component_is_raised(tmp_path):
    path = write_own(tmp_path)
    module = tmp_path / "mine.py"
    module.write_text(module.read_text().replace("raise ValueError(f", "return (f"))
    with pytest.raises(InvalidReturnValue, match=r"update returned .* \(k = 4\)"):
        run_one(path, "raises", run=2)


def test_what_does_not_exist_is_refused(tmp_path):
    config = load_config(write(tmp_path))
    for arguments, text in (
        (("S-MCP", 0), "did you mean 'S-MPC'"),
        (("S-MPC", 6), "there is no run 6"),
        (("S-MPC", -1), "-1"),
    ):
        with pytest.raises(DesignError, match=text):
            run_one(config, *arguments)
    with pytest.raises(DesignError):
        run_one(config, "S-MPC", at={"plant.kind": "none"})
