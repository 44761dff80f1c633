"""The linear model checks its matrices before a design trips over them."""

import numpy as np
import pytest

from rmpc_bench.models.linear import LinearModel
from rmpc_bench.types import DesignError


def make(**changes):
    """Make a model with two states, one input and one output."""
    parts = {"A": np.eye(2), "B": [[0.0], [1.0]], "C": [[1.0, 0.0]], "Q_w": [1.0, 2.0], "R_v": 3.0}
    return LinearModel(**{**parts, **changes})


def test_short_forms_are_expanded():
    """Oracle: by hand."""
    model = make()
    assert (model.nx, model.nu, model.ny) == (2, 1, 1)
    np.testing.assert_array_equal(model.Q_w, np.diag([1.0, 2.0]))
    np.testing.assert_array_equal(model.R_v, [[3.0]])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"A": np.ones((2, 3))}, "A: has the shape 2 x 3; a square matrix"),
        ({"B": [[1.0], [1.0], [1.0]]}, "B: has the shape 3 x 1; 2 x nu fits"),
        ({"C": [[1.0, 0.0, 0.0]]}, "C: has the shape 1 x 3; ny x 2 fits"),
        ({"Q_w": [1.0, 2.0, 3.0]}, "Q_w: shape"),
        ({"Q_w": [1.0, -2.0]}, "Q_w: must be positive semidefinite"),
        ({"R_v": [[-1.0]]}, "R_v: must be positive semidefinite"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(changes, message):
    """Oracle: the message must name the matrix."""
    with pytest.raises(DesignError, match=message):
        make(**changes)


def test_a_model_cannot_be_changed():
    """Oracle: designs are frozen."""
    with pytest.raises(AttributeError):
        make().A = np.eye(2)
