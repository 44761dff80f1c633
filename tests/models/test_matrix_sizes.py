"""A matrix that is not square by its meaning is written row by row; a wrong orientation is shown with both shapes."""

import numpy as np
import pytest

from rmpc_bench.models.linear import LinearModel
from rmpc_bench.models.mixed_noise import design as mixed
from rmpc_bench.models.uncertain_linear import design as uncertain
from rmpc_bench.models.uncertain_system import SIZES, uncertain_system
from rmpc_bench.plants.linear import design as linear
from rmpc_bench.types import DesignError

A = [[0.9, 0.1], [0.0, 0.8]]
FLAT_C = (
    "a flat list is ambiguous here: write it row by row: [[1, 0]] is 1 x 2 (1 output, 2 states), "
    "[[1], [0]] is 2 x 1 (2 outputs, 1 state)"
)


def refused(design, **matrices):
    """Return the parameter and the message of the error that a design raises."""
    with pytest.raises(DesignError) as caught:
        design(**matrices)
    return caught.value.parameter, str(caught.value)


@pytest.mark.parametrize("design", [linear, mixed, uncertain], ids=["plant", "mixed-noise", "uncertain-linear"])
def test_a_flat_output_matrix_is_refused_with_both_meanings(design):
    """Oracle: by hand; a list used to stand for a diagonal, so that `C: [1, 0]` gave two outputs."""
    sizes = {"Ts": 0.1, "n_steps": 3} if design is linear else {"n_steps": 3}
    assert refused(design, A=A, C=[1.0, 0.0], **sizes) == ("C", f"{FLAT_C}; the other matrices fit [[1, 0]]")
    assert refused(design, A=0.5, C=[1.0, 0.0], **sizes) == ("C", FLAT_C)


@pytest.mark.parametrize("name", [name for name, (rows, columns) in SIZES.items() if rows != columns])
def test_every_matrix_that_is_not_square_is_written_row_by_row(name):
    """Oracle: the message repeats the list as a row and as a column."""
    given = {"A": 0.5, "C": 1.0, name: [2.0, 3.5]}
    parameter, message = refused(lambda **matrices: uncertain_system(3, matrices), **given)
    assert parameter == name
    assert "[[2, 3.5]] is 1 x 2" in message and "[[2], [3.5]] is 2 x 1" in message


def test_the_meaning_that_fits_the_other_matrices_is_named():
    """Oracle: by hand for two states."""
    parameter, message = refused(linear, Ts=0.1, n_steps=3, A=A, B=[1.0, 0.3], C=[[1.0, 0.0]])
    assert parameter == "B"
    assert message.endswith(
        "[[1, 0.3]] is 1 x 2 (1 state, 2 inputs), [[1], [0.3]] is 2 x 1 (2 states, 1 input); "
        "the other matrices fit [[1], [0.3]]"
    )


def test_a_list_of_one_number_is_refused_too():
    """Oracle: one rule for all lengths, and no choice where both meanings are the same."""
    assert refused(linear, Ts=0.1, n_steps=3, A=0.5, C=[1.0]) == (
        "C",
        "a flat list is ambiguous here: write it row by row: [[1]] is 1 x 1 (1 output, 1 state)",
    )


def test_lists_of_square_matrices_stay_diagonals():
    """Oracle: A, covariances and shapes by hand."""
    model = mixed(3, A=[0.5, 0.6], C=[[1.0, 0.0]], P_w=[1.0, 2.0], M_w=[3.0, 4.0])
    np.testing.assert_array_equal(model.at(0).A, [[0.5, 0.0], [0.0, 0.6]])
    np.testing.assert_array_equal(model.at(0).Q_w, [[1.0, 0.0], [0.0, 2.0]])
    np.testing.assert_array_equal(model.M_w(0), [[3.0, 0.0], [0.0, 4.0]])


@pytest.mark.parametrize(
    ("matrices", "name", "message"),
    [
        ({"C": [[1], [0]]}, "C", "has the shape 2 x 1; ny x 2 fits the other matrices (nx = 2), which its transpose "
         "has: [[1, 0]]"),
        ({"B": [[1, 0.3]], "C": [[1, 0]]}, "B", "has the shape 1 x 2; 2 x nu fits the other matrices (nx = 2), "
         "which its transpose has: [[1], [0.3]]"),
        ({"C": [[1, 0, 2]]}, "C", "has the shape 1 x 3; ny x 2 fits the other matrices (nx = 2)"),
        ({"A": [[1, 2]], "C": [[1, 0]]}, "A", "has the shape 1 x 2; a square matrix is expected (nx x nx)"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("first", [True, False])
def test_a_wrong_orientation_is_shown_with_both_shapes(matrices, name, message, first):
    """Oracle: by hand; the blame does not depend on the order of the keywords."""
    given = {"A": A, **matrices} if first else {**matrices, "A": matrices.get("A", A)}
    assert refused(lambda **matrices: uncertain_system(3, matrices), **given) == (name, message)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"C": [1.0, 0.0]}, f"C: {FLAT_C}; the other matrices fit [[1, 0]]"),
        ({"C": np.array([1.0, 0.0])}, f"C: {FLAT_C}; the other matrices fit [[1, 0]]"),
        (
            {"B": [[0.0, 1.0]]},
            "B: has the shape 1 x 2; 2 x nu fits the other matrices (nx = 2), which its transpose has",
        ),
        ({"C": np.ones((1, 1, 2))}, "C has shape (1, 1, 2); a matrix is expected"),
        ({"S_wv": [[0.0, 0.0]]}, "S_wv has shape (1, 2); (2, 1) fits the other matrices, as its transpose has"),
    ],
)
def test_a_linear_model_reads_its_matrices_in_the_same_way(changes, message):
    """Oracle: by hand."""
    parts = {"A": A, "B": [[0.0], [1.0]], "C": [[1.0, 0.0]], "Q_w": 1.0, "R_v": 1.0}
    with pytest.raises(DesignError) as caught:
        LinearModel(**{**parts, **changes})
    assert str(caught.value).startswith(message)


def test_numbers_and_a_diagonal_make_a_linear_model():
    """Oracle: by hand."""
    assert LinearModel(0.5, 1.0, 2.0, 1.0, 1.0).C.tolist() == [[2.0]]
    assert LinearModel([0.5, 0.6], [[1.0], [0.0]], [[1.0, 0.0]], 1.0, 1.0).A.tolist() == [[0.5, 0.0], [0.0, 0.6]]
