"""Classes around an object that a function makes."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from rmpc_bench.components.designs import class_around
from rmpc_bench.components.single_run import design_function
from rmpc_bench.config_file.keys import keys_of
from rmpc_bench.schema.manual import manual_of
from rmpc_bench.types import DesignError, Positive


class Held:
    """Returns what the function has made, plus the start."""

    def __init__(self, made, Ts, offset: float = 0.0):
        self.x_hat, self.Ts, self.offset = np.asarray(made, dtype=float), Ts, offset

    def update(self, y):
        return self.x_hat + self.offset


def constant(model, value: Positive = 2.0):
    """Estimate a constant.

    Parameters
    ----------
    value : the estimate
    """
    return [value * model]


Constant = class_around(Held, constant)
Constant.__qualname__ = "Constant"


def test_keys_are_those_of_the_function_and_of_the_base():
    """Annotations written as text are evaluated where the function stands."""
    fields = keys_of("estimators", "test", design_function("estimators", Constant)).model_fields
    assert {"value", "offset", "on_failure", "max_held"} == {*fields}
    with pytest.raises(ValueError, match="greater than 0"):
        keys_of("estimators", "test", design_function("estimators", Constant))(value=-1.0)


def test_every_object_is_made_anew():
    """The function is called for every run."""
    first, second = (Constant(model=1.0, Ts=0.1, value=3.0, offset=1.0) for _ in range(2))
    first.x_hat[0] = 9.0
    assert second.update(0.0) == [4.0]


def test_an_unknown_argument_of_the_function():
    """Arguments without a standard name are keys; those of `update` must be known."""

    class Wrong(Held):
        def update(self, yy):
            return self.x_hat

    with pytest.raises(DesignError, match="'yy'"):
        design_function("estimators", class_around(Wrong, constant))


def test_it_is_pickled_by_its_name():
    """As every class of a user's file."""
    assert pickle.loads(pickle.dumps(Constant)) is Constant


def test_the_manual_is_that_of_the_file_of_the_function():
    """Not that of the module in which the class is made."""
    manual = manual_of("estimators", "test", design_function("estimators", Constant))
    assert manual.module == __doc__ and manual.text.startswith("Estimate a constant.")


def test_what_a_function_must_not_return_is_named():
    """With what it must return, in the words of the base class."""

    class Numbers(Held):
        returns = "a list of numbers"

        @staticmethod
        def fits(made):
            return isinstance(made, list)

    def nothing():
        return None

    with pytest.raises(TypeError, match="nothing returned None; it must return a list of numbers"):
        class_around(Numbers, nothing)(Ts=0.1)
    assert class_around(Numbers, constant)(model=1.0, Ts=0.1).update(0.0) == [2.0]


def test_an_attribute_that_means_nothing():
    """It is refused with the nearest name; attributes of the base class are known, too."""
    with pytest.raises(TypeError, match="constant: 'deviations' is not a known attribute; did you mean 'deviation'?"):
        class_around(Held, constant, deviations=True)
    assert class_around(Held, constant, deviation=True, update=None).deviation
