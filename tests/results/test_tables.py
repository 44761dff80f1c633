"""Tables that are put together from others, without a store."""

from dataclasses import replace

from comparison_tables import table

from rmpc_bench.analysis.runs import RunNotes
from rmpc_bench.results.tables import with_timings


class Read(tuple):
    """Cells that count how often they are read."""

    n = 0

    def __iter__(self):
        Read.n += 1
        return super().__iter__()


def test_points_get_their_own_times_and_timings_are_read_once():
    """The median of a step of estimator and controller together; a block stands for calls that are not timed alone."""
    one = replace(table({"A": [1.0], "B": [2.0]}), notes={"A": RunNotes(10), "B": RunNotes(10)})
    points = tuple(replace(one, paths=("p", "q"), point={"p": p, "q": "x"}) for p in ("1", "2", "3"))
    rows = [
        ("1", "x", "A", "estimator", "step", 1.0),
        ("1", "x", "A", "estimator", "first step", 9.0),
        ("1", "x", "A", "controller", "block", 0.5),
        (2, "x", "A", "estimator", "block", 2.0),
        (2, "x", "A", "controller", "step", 0.25),
        (2, "x", "B", "controller", "step", 4.0),
    ]
    names = ("p", "q", "method", "component", "phase", "median_s")
    timings = dict(zip(names, map(Read, zip(*rows, strict=True)), strict=True))
    found = with_timings(replace(one, paths=("p", "q"), points=points), timings)
    assert Read.n == len(names)
    times = [[each.seconds_per_step for each in point.notes.values()] for point in found.points]
    assert times == [[1.5, None], [2.25, None], [None, None]]
    alone = {name: timings[name][:3] for name in names[2:]}
    assert with_timings(one, alone).notes["A"].seconds_per_step == 1.5
    assert with_timings(one, {}) is one
