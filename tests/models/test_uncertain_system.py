"""Matrices of an uncertain system: short forms, sizes, matrices over time, and what is refused."""

import inspect

import numpy as np
import pytest
from plants.uncertain_twin import SIZES, at, random_given

from rmpc_bench.models import uncertain_system as module
from rmpc_bench.models.uncertain_system import CHANNELS, Matrices, takes_matrices, uncertain_system
from rmpc_bench.types import DesignError

BENCHMARK = {
    "A": [[0, -0.5], [1, 1]], "Bw": [[-6], [1]], "C": [[-100, 10]], "H_A": [[0], [10]], "H_C": [[50]],
    "G_x": [[0.1, 0.03]], "H_Bw": [[0], [10]], "G_w": [[0.01]], "H_Dv": [[100]], "G_v": [[1]],
}  # fmt: skip


def test_the_benchmark_has_the_sizes_of_the_chapter():
    """Oracle: souto2011, section 5, (84); what is not given is zero, of the size that fits."""
    system = uncertain_system(10, BENCHMARK)
    sizes = {name: system.size(name) for pair in module.SIZES.values() for name in pair}
    assert sizes == {"nx": 2, "nu": 1, "ny": 1, "nw": 1, "nv": 1} | {f"{a}{b}": 1 for a in "rs" for b in "xwv"}
    assert not system.varies
    m = system.at(7)
    for name in Matrices._fields:
        np.testing.assert_array_equal(getattr(m, name), BENCHMARK.get(name, np.zeros(getattr(m, name).shape)))
    assert system.active == frozenset(BENCHMARK) | {"x", "w", "v"}


@pytest.mark.parametrize("sizes", SIZES, ids=lambda sizes: f"nx={sizes['nx']}")
@pytest.mark.parametrize("n_steps", [0, 6])
def test_arrays_are_taken_as_they_are(sizes, n_steps, rng):
    """Oracle: the arrays given, at every k; lengths of the names from their shapes."""
    given = random_given(rng, sizes, n_steps)
    system = uncertain_system(6, given)
    for k in range(7):
        for name, matrix in at(given, k).items():
            np.testing.assert_array_equal(getattr(system.at(k), name), matrix)
    assert system.varies == (n_steps > 0)
    assert {name: system.size(name) for name in ("nx", "nu", "ny", "nw", "nv")} == {
        name: sizes[name] for name in ("nx", "nu", "ny", "nw", "nv")
    }
    assert [(system.size(f"r{c}"), system.size(f"s{c}")) for c in "xwv"] == [sizes[c] for c in "xwv"]


def test_the_arrays_given_are_copied(rng):
    """Oracle: a design is immutable: what the caller does to the array later does not matter."""
    A = 0.5 * np.eye(2)[None]
    system = uncertain_system(4, {"A": A, "C": [[1.0, 0.0]]})
    A[0, 0, 0] = 7.0
    assert system.at(0).A[0, 0] == 0.5


@pytest.mark.parametrize(
    ("short", "full"),
    [
        (0.5, [[0.5, 0.0], [0.0, 0.5]]),
        ([0.5, 2.0], [[0.5, 0.0], [0.0, 2.0]]),
        ([[1, 2], [3, 4]], [[1, 2], [3, 4]]),
        (((1, 2), (3, 4)), [[1, 2], [3, 4]]),
        (np.array([[1, 2], [3, 4]]), [[1, 2], [3, 4]]),
        (lambda at: 0.5, [[0.5, 0.0], [0.0, 0.5]]),
        ([lambda at: 0.5, 2.0], [[0.5, 0.0], [0.0, 2.0]]),
        ([[1, lambda at: 2], [3, 4]], [[1, 2], [3, 4]]),
    ],
)
def test_short_forms(short, full):
    """Oracle: a number is a multiple of the identity, a list the diagonal; entries may be functions of k."""
    system = uncertain_system(3, {"A": short, "C": [[1.0, 0.0]]})
    for k in range(4):
        np.testing.assert_array_equal(system.at(k).A, full)


def test_functions_of_k():
    """Oracle: their values by hand at k = 0..N, as number and matrix; the other matrices stay."""
    given = {
        "A": [[lambda at: at["k"] / 10, 1.0], [0.0, 0.5]], "Bw": lambda at: 2.0 + at["k"],
        "G_x": [[lambda at: -at["k"], 0.0], [0.0, 3.0]], "H_A": 1.0, "C": [[1.0, 0.0]],
    }  # fmt: skip
    system = uncertain_system(5, given)
    assert system.varies
    for k in range(6):
        m = system.at(k)
        np.testing.assert_array_equal(m.A, [[k / 10, 1.0], [0.0, 0.5]])
        np.testing.assert_array_equal(m.Bw, (2.0 + k) * np.eye(2))
        np.testing.assert_array_equal(m.G_x, [[-k, 0.0], [0.0, 3.0]])
        np.testing.assert_array_equal(m.C, [[1.0, 0.0]])


def test_sizes_reach_numbers_through_numbers():
    """Oracle: by hand, only G_v tells a size: nv = 2, so ny = 2 by Dv, nx = 2 by C, nw = 2 by Bw."""
    given = {"A": 0.5, "Bw": 1.0, "C": 1.0, "Dv": 2.0, "H_Dv": 1.0, "G_v": [[1.0, 0.0], [0.0, 1.0]]}
    system = uncertain_system(3, given)
    assert [system.size(name) for name in ("nx", "ny", "nw", "nv", "rv", "sv")] == [2] * 6
    np.testing.assert_array_equal(system.at(0).Bw, np.eye(2))


def test_numbers_alone_make_a_scalar_system():
    """Oracle: every size that nothing tells is 1; a zero fits every size."""
    system = uncertain_system(3, {"A": 0.5, "C": 1.0, "Bw": 0.0})
    assert {system.size(name) for pair in module.SIZES.values() for name in pair} == {1}
    wide = uncertain_system(
        3, {"A": 0.0, "C": [[1.0, 2.0, 3.0]], "Dw": 0.0, "Bw": [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]}
    )
    np.testing.assert_array_equal(wide.at(0).A, np.zeros((3, 3)))
    np.testing.assert_array_equal(wide.at(0).Dw, np.zeros((1, 2)))


def test_a_channel_is_active_if_its_F_changes_anything():
    """Oracle: H_A F G x is nothing if H or G is zero; it counts if it is not at any k."""
    parts = {"A": 0.5, "C": 1.0}
    assert "x" not in uncertain_system(3, {**parts, "H_A": 0.0, "G_x": 1.0}).active
    assert "x" not in uncertain_system(3, {**parts, "H_A": 1.0, "G_x": 0.0}).active
    assert "x" in uncertain_system(3, {**parts, "H_C": 1.0, "G_x": 1.0}).active
    assert "x" in uncertain_system(3, {**parts, "H_A": lambda at: float(at["k"] == 3), "G_x": 1.0}).active


def test_scaling_scales_every_H(rng):
    """Oracle: H F G times the factor, all else as before."""
    given = random_given(rng, SIZES[2], 4)
    system = uncertain_system(4, given)
    scaled, H = system.scaled(0.25), {name for names in CHANNELS.values() for name in names[:2]}
    for name, M in given.items():
        np.testing.assert_array_equal(getattr(scaled.over_time, name), 0.25 * M if name in H else M)
        np.testing.assert_array_equal(getattr(system.over_time, name), M)


def bad_at_3(values):
    """Return a number except at k = 3."""
    if values["k"] == 3:
        raise ValueError("1 / 0")
    return 1.0


@pytest.mark.parametrize(
    ("change", "parameter", "message"),
    [
        ({"A": [[1, 2, 3], [4, 5, 6]]}, "A", "has the shape 2 x 3; a square matrix is expected"),
        ({"Bw": [[1], [2], [3]]}, "Bw", "has the shape 3 x 1; 2 x nw fits the other matrices"),
        ({"C": [[1, 2, 3]]}, "C", "has the shape 1 x 3; ny x 2 fits the other matrices"),
        (
            {"H_Bw": [[1, 0], [0, 1]], "H_Dw": [[1.0, 2.0, 3.0]]},
            "H_Dw",
            "1 x 3; 1 x 2 fits the other matrices \\(ny = 1, rw = 2\\)",
        ),
        ({"G_w": [[1.0, 2.0]]}, "G_w", "1 x 2; sw x 1 fits the other matrices"),
        ({"B": [1.0, 2.0, 3.0]}, "B", "a flat list is ambiguous"),
        ({"A": [[1, 2], [3]]}, "A", "a list of rows of the same length"),
        ({"A": [[[1, 2], [3, 4]]]}, "A", "must be a number or a list of rows"),
        ({"A": [1.0, [2.0]]}, "A", "must be a number or a list of rows"),
        ({"C": 2.0}, "C", "1 x 2 entries are required"),
        ({"A": np.zeros((3, 2, 2))}, "A", "has 3 entries over k; 1 or 6 are required"),
        ({"A": [[1, bad_at_3], [0, 1]]}, "A", "has no value at k = 3: 1 / 0"),
        ({"Bw": bad_at_3, "H_Bw": None, "G_w": None}, "Bw", "has no value at k = 3"),
        ({"H_B": 1.0}, "H_B", "'H_B' is not a matrix of an uncertain system; choose from A, B, Bw"),
        ({"A": None}, "A", "the matrix A is missing"),
        ({"C": None}, "C", "the matrix C is missing"),
        ({"G_x": None}, "H_A", "H_A and H_C need G_x"),
        ({"G_x": None, "H_A": None}, "H_C", "H_A and H_C need G_x"),
        ({"G_w": None}, "H_Bw", "need G_w"),
        ({"G_v": None}, "H_Dv", "need G_v"),
    ],
)
def test_what_does_not_fit_is_refused(change, parameter, message):
    """Oracle: the matrix to blame and words that say what is wrong."""
    given = {**BENCHMARK, **({"H_Dw": [[1.0]], "Dw": [[1.0]]} if parameter == "C" and change["C"] == 2.0 else {})}
    with pytest.raises(DesignError, match=message) as caught:
        uncertain_system(5, {**given, **change})
    assert caught.value.parameter == parameter


def test_an_H_of_zeros_needs_no_G():
    """Oracle: nothing is uncertain."""
    assert "x" not in uncertain_system(5, {**BENCHMARK, "H_A": 0.0, "H_C": 0.0, "G_x": None}).active


@pytest.mark.parametrize("value", [[], [[]], [[], []]])
def test_a_matrix_without_entries_is_refused(value):
    """Oracle: a DesignError, whatever is blamed; not an exception of NumPy."""
    with pytest.raises(DesignError):
        uncertain_system(5, {**BENCHMARK, "A": value})


def test_what_does_not_vary_is_one_object():
    """Oracle: the same Matrices at every k, so that users may compare identities."""
    system = uncertain_system(5, BENCHMARK)
    assert system.at(0) is system.at(5)


def test_every_channel_names_its_matrices():
    """Oracle: (34)-(36): sizes of H, H' and G agree with F."""
    for name, (H, H_out, G) in CHANNELS.items():
        assert module.SIZES[H] == ("nx", f"r{name}") and module.SIZES[H_out] == ("ny", f"r{name}")
        assert module.SIZES[G] == (f"s{name}", {"x": "nx", "w": "nw", "v": "nv"}[name])


def test_a_design_function_gets_the_matrices_as_keywords():
    """Oracle: the signature by hand: A and C are wanted, the others may be missing."""

    @takes_matrices
    def make(n_steps, *, gain=1.0, **matrices):
        """Make.

        Parameters
        ----------
        matrices : the matrices of the system
        """
        return sorted(matrices), gain

    parameters = inspect.signature(make).parameters
    assert set(parameters) == {"n_steps", "gain", *Matrices._fields}
    wanted = {name for name, parameter in parameters.items() if parameter.default is parameter.empty}
    assert wanted == {"n_steps", "A", "C"}
    assert all(name in (make.__doc__ or "") for name in Matrices._fields)
    assert make(3, A=1.0, C=2.0) == (["A", "C"], 1.0)
