"""Names and arguments of the functions of other libraries."""

from rmpc_bench.models.library_systems import ignores_time, usable_names


def test_whether_a_function_reads_the_time():
    assert ignores_time(lambda t, x: 2 * x) and not ignores_time(lambda t, x: t * x)
    assert not ignores_time(len)


def test_names_that_a_configuration_may_write():
    assert usable_names(["P_x[0]", "level"]) == ["P_x_0", "level"]
    assert usable_names(["x[0]", "x[1]"]) == 2 and usable_names(["u"]) == 1
