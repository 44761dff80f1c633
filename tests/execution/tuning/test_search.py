"""The searches, against SciPy's own and by their counts of evaluations."""

import math

import numpy as np
import pytest
from conftest import ROUND
from scipy import optimize
from scipy.stats import qmc

from rmpc_bench.execution.tuning.search import plan, row_at, value_at
from rmpc_bench.numerics.direct_search import GOLDEN, first_simplex, golden_section, halton, minimise
from rmpc_bench.types.tuning import TunedParameter

RADIUS = TunedParameter("estimator.radius", 0.01, 10.0)
SHARE = TunedParameter("estimator.fraction", 0.0, 1.0, "linear")
WINDOW = TunedParameter("estimator.window", 1.0, 30.0, integer=True)


def bowl(x):
    """Smallest at 0.0777, the same on both sides of it on a logarithmic scale."""
    return math.log(x / 0.0777) ** 2


def valley(x, y):
    """Smallest at 0.5 and 0.3."""
    return math.log(x / 0.5) ** 2 + 3.0 * (y - 0.3) ** 2


def searched(parameters, budget, function, search="auto"):
    """Evaluate what a search asks for until it ends: values in their order, objectives, and number of rounds."""
    known, rounds = {}, 0
    while (step := plan(parameters, budget, search, known)).wanted:
        rounds += 1
        known |= {each.row: function(*each.row) for each in step.wanted}
    return step.used, known, rounds


UNIMODAL = [lambda z: (z - 0.41) ** 2, lambda z: abs(z - 0.61) ** 0.7, lambda z: -math.exp(-40 * (z - 0.45) ** 2)]


@pytest.mark.parametrize("function", UNIMODAL)
def test_golden_section_finds_what_scipy_finds(function):
    """From the same three points; a square root of the machine precision is all that values can tell."""
    found, value = golden_section(function, 0.2, 0.5, 0.8)
    expected = optimize.golden(function, brack=(0.2, 0.5, 0.8), tol=1e-12)
    assert found == pytest.approx(expected, abs=1e-6)  # values are flat around the minimum of a smooth function
    assert value == pytest.approx(function(expected), abs=1e-6)  # |z - 0.61|^0.7 is steep there


@pytest.mark.parametrize("function", UNIMODAL)
def test_golden_section_asks_for_the_points_that_scipy_asks_for(function):
    """SciPy evaluates the middle point with the first new one, and tests its bracket before."""
    ours, theirs = [], []

    def noted(list_):
        def call(z):
            list_.append(float(z))
            return function(z)

        return call

    golden_section(noted(ours), 0.2, 0.5, 0.8)
    optimize.golden(noted(theirs), brack=(0.2, 0.5, 0.8), tol=1e-12)
    assert np.allclose(distinct(ours)[:15], distinct(theirs[3:])[:15], **ROUND)


def distinct(places):
    """Return the places without those that were asked for before."""
    found = []
    for place in places:
        if not np.any(np.isclose(found, place, **ROUND)):
            found.append(place)
    return found


@pytest.mark.parametrize("budget", [1, 2, 3, 5, 8, 9, 16, 31])
def test_a_search_spends_its_budget_and_no_more(budget):
    for parameters, function in (([RADIUS], bowl), ([RADIUS, SHARE], valley)):
        used, known, _ = searched(parameters, budget, function)
        assert len(used) == len(known) == budget
        assert {each.row for each in used} == set(known)


def test_a_budget_of_16_is_9_grid_points_and_7_golden_steps():
    """The grid in one round, then one value a round; the grid has equal steps of the logarithm and both ends."""
    used, known, rounds = searched([RADIUS], 16, bowl)
    assert [each.stage for each in used] == ["grid"] * 9 + ["golden"] * 7
    assert rounds == 8
    grid = [each.row[0] for each in used[:9]]
    assert grid == [float(f"{value:.4g}") for value in np.geomspace(0.01, 10.0, 9)]
    # Two steps of the grid are divided by golden section, and five more times.
    width = math.log(1000.0) / 8 * 2 * (1 - GOLDEN) ** 6
    assert abs(math.log(min(known, key=known.get)[0] / 0.0777)) <= width


@pytest.mark.parametrize("high", [7.0, 12.0, 30.0])
def test_the_best_integer_is_found_wherever_it_is(high):
    """Oracle: all integers.  Golden section alone passes over 7 of 1 to 12, since equal values tell it no direction."""
    window = TunedParameter("estimator.window", 1.0, high, integer=True)
    for best in np.arange(1.0, high + 0.1, 0.3):
        used, known, _ = searched([window], 16, lambda x, best=best: abs(x - best))
        assert min(known.values()) == min(abs(x - best) for x in range(1, int(high) + 1))
        assert len(used) == len(known) <= 16


@pytest.mark.parametrize(("best", "end"), [(0.001, 0.01), (100.0, 10.0)])
def test_an_optimum_outside_the_range_gives_its_end(best, end):
    """Golden section looks between the end and its neighbour, and does not leave the range."""
    used, known, _ = searched([RADIUS], 16, lambda x: math.log(x / best) ** 2)
    assert min(known, key=known.get) == (end,)
    assert all(0.01 <= each.row[0] <= 10.0 for each in used)


def test_grid_and_golden_section_are_within_a_per_cent_of_brute_force():
    for target in np.geomspace(0.013, 8.0, 23):
        _, known, _ = searched([RADIUS], 24, lambda x, t=target: math.log(x / t) ** 2)
        assert min(known, key=known.get)[0] == pytest.approx(target, rel=0.01)  # four golden steps per factor of 7


def test_integers_are_tried_once():
    used, known, _ = searched([WINDOW], 16, lambda x: (x - 7) ** 2)
    tried = [each.row[0] for each in used]
    assert len(set(tried)) == len(tried) <= 16
    assert all(value == int(value) and 1 <= value <= 30 for value in tried)
    assert min(known, key=known.get) == (7.0,)


def test_a_range_with_fewer_integers_than_the_budget_is_tried_whole():
    used, _, _ = searched([TunedParameter("estimator.window", 1.0, 3.0, integer=True)], 16, lambda x: x)
    assert {each.row[0] for each in used} == {1.0, 2.0, 3.0}


def test_values_are_rounded_without_their_offset():
    """Ends of the range keep all digits."""
    factor = TunedParameter("estimator.alpha", 1.23456e-4, 1.0, offset=1.0)
    assert value_at(factor, 0.0) == pytest.approx(1.000123456, rel=ROUND["rtol"])
    assert value_at(factor, 0.5) == pytest.approx(1.0 + 0.01111, rel=ROUND["rtol"])
    assert value_at(factor, 1.0) == 2.0


@pytest.mark.parametrize("dimensions", [1, 2, 5])
def test_quasi_random_points_are_those_of_halton(dimensions):
    expected = qmc.Halton(dimensions, scramble=False).random(33)
    assert np.allclose([*halton(32, dimensions)], expected[1:], **ROUND, atol=0)
    assert np.allclose([*halton(10, dimensions, start=5)], expected[6:16], **ROUND, atol=0)


def test_nelder_mead_by_replay_is_that_of_scipy():
    """The values in their order, and the best of them."""
    parameters, budget = [RADIUS, SHARE], 40
    used, known, _ = searched(parameters, budget, valley)
    first = [each.row for each in used if each.stage == "quasi-random"]
    places = {row_at(parameters, place): place for place in halton(20, 2)}
    start = places[min(first, key=known.get)]
    asked = []

    def objective(z):
        row = row_at(parameters, z)
        asked.append(row)
        return valley(*row)

    vertices = np.array(first_simplex(start))
    optimize.minimize(
        objective,
        vertices[0],
        method="Nelder-Mead",
        bounds=[(0, 1), (0, 1)],
        options={"initial_simplex": vertices, "xatol": 1e-4, "fatol": 0.0},
    )
    expected = [*dict.fromkeys([*first, *asked])][:budget]
    assert [each.row for each in used] == expected
    assert min(known, key=known.get) == pytest.approx((0.5, 0.3), rel=0.1)  # 20 steps of the simplex


def test_the_simplex_starts_inside_the_range():
    for place in ((0.0, 1.0), (0.95, 0.5)):
        simplex = np.array(first_simplex(place))
        assert np.all((simplex >= 0) & (simplex <= 1))
        assert np.linalg.matrix_rank(simplex[1:] - simplex[0]) == 2


def test_quasi_random_search_asks_once():
    used, known, rounds = searched([RADIUS, SHARE], 12, valley, "quasi-random")
    assert rounds == 1 and len(known) == 12
    assert {each.stage for each in used} == {"quasi-random"}


def test_a_search_where_all_runs_failed_ends():
    for parameters in ([RADIUS], [RADIUS, SHARE]):
        used, _, _ = searched(parameters, 12, lambda *row: math.inf)
        assert len(used) == 12


def test_an_interrupted_search_goes_on_where_it_was():
    """Any part of the evaluations gives the same order."""
    used, known, _ = searched([RADIUS, SHARE], 16, valley)
    for n in (0, 3, 8, 11, 15):
        part = {each.row: known[each.row] for each in used[:n]}
        step = plan([RADIUS, SHARE], 16, "auto", part)
        assert step.used == used[: len(step.used)]
        assert all(each.row not in part for each in step.wanted)


def test_minimise_stays_in_the_unit_cube():
    asked = []
    minimise(lambda z: asked.append(z.copy()) or float(np.sum(z)), first_simplex((0.1, 0.1)), 60)
    assert np.min(asked) >= 0.0
