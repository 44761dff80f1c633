"""The memory of `remembered_checks` lets nothing through that jaxtyping alone would refuse."""

from concurrent.futures import ThreadPoolExecutor
from threading import Barrier
from typing import NamedTuple

import numpy as np
import pytest
from beartype import beartype
from jaxtyping import Float, TypeCheckError
from remembered_checks import ALWAYS, EVERY, jaxtyped

X = Float[np.ndarray, "runs n"]


class Pair(NamedTuple):
    x: X
    y: X


@jaxtyped(typechecker=beartype)
def step(A: Float[np.ndarray, "n n"], x: X) -> "X":
    return x


GIVEN = []


@jaxtyped(typechecker=beartype)
def given(x: X) -> "tuple[X, float] | None":
    return GIVEN[-1]


@jaxtyped(typechecker=beartype)
def first(rows: list[X]) -> tuple[X, float]:
    return rows[0], 0.0


def test_a_combination_that_has_passed_lets_no_other_one_pass():
    """Oracle: by hand; n is 2, then 3; every call is made twice, so that the second one meets the memory."""
    for n in (2, 2, 3, 3):
        x = np.zeros((5, n))
        assert step(np.eye(n), x) is x
        assert step(np.eye(n), x=x) is x
        for wrong in (np.zeros((5, n + 1)), np.zeros(n), np.zeros((5, n), int), [0.0], None):
            with pytest.raises(TypeCheckError):
                step(np.eye(n), wrong)
            with pytest.raises(TypeCheckError):
                step(np.eye(n), x=wrong)


@pytest.mark.parametrize("wrong", [np.zeros((5, 3)), np.zeros((4, 2)), np.zeros((5, 2), int), [0.0], 1.0, Pair(1, 2)])
def test_a_result_is_checked_after_other_results_have_passed(wrong):
    """The arguments are the same all the time, so that only the result differs from what has passed."""
    x = np.zeros((5, 2))
    for result in (None, (x, 0.0), None, (x + 1.0, 1.0)):
        GIVEN.append(result)
        assert given(x) is result
    for result in (wrong, (wrong, 0.0), (x, x)) * 2:
        GIVEN.append(result)
        with pytest.raises(TypeCheckError, match="return value"):
            given(x)


def test_calls_of_a_long_loop_are_checked_from_time_to_time():
    @jaxtyped(typechecker=beartype)
    def length(x: X) -> int:
        return len(x)

    x, n_refused = np.zeros((5, 2)), 0
    for _ in range(ALWAYS):
        assert length(x) == 5
    for _ in range(3 * EVERY):
        try:
            length(np.zeros(5))
        except TypeCheckError:
            n_refused += 1
    assert n_refused == 3


def test_elements_of_a_list_are_checked_every_time():
    good, bad = np.zeros((5, 2)), np.zeros(5)
    for _ in range(2):
        assert first([good])[0] is good
        with pytest.raises(TypeCheckError):
            first([bad])


def test_functions_that_are_defined_anew_are_checked_once_and_each_gives_its_own_result():
    """Trap: a check that was made for one of them calls that one for all."""

    def defined(factor, result=None):
        @jaxtyped(typechecker=beartype)
        def scaled(x: X, *, depth: object = 0) -> X:
            if depth:
                return defined(factor + 1.0)(factor * x)
            return factor * x if result is None else result

        return scaled

    x = np.ones((5, 2))
    for factor in (1.0, 2.0, 2.0):
        assert (defined(factor)(x) == factor).all()
        # One calls another one.
        assert (defined(factor)(x, depth=[1]) == factor * (factor + 1.0)).all()
    for _ in range(ALWAYS):
        defined(1.0)(x)
    # The calls of others do not count.
    for wrong in (np.ones((5, 3)), np.ones(5), 1.0):
        with pytest.raises(TypeCheckError, match="return value"):
            defined(1.0, wrong)(x)
    for wrong in (np.ones(5), 1.0):
        with pytest.raises(TypeCheckError):
            defined(1.0)(wrong)


def test_threads_that_are_checked_at_the_same_time_call_their_own_functions():
    def defined(value, start):
        @jaxtyped(typechecker=beartype)
        def made(rows: list[X]) -> X:
            start.wait()
            return rows[0] + value

        return made

    start = Barrier(4)
    with ThreadPoolExecutor(4) as pool:
        found = [pool.submit(defined(value, start), [np.zeros((5, 2))]) for value in range(4)]
    assert [each.result()[0, 0] for each in found] == [0, 1, 2, 3]
