"""Components of other libraries: through their adapter, and the library alone in a plain loop.

A row has the work of one run and step.  The baseline calls the library and nothing else, so that the ratio shows the
cost of the adapter and of the simulation around it; the difference of both times is what the adapter adds.
"""

from perf import casadi_rows, control_rows, do_mpc_rows, filter_rows, fmu_rows, gymnasium_rows
from perf.row import Row

ROWS: list[Row] = [
    *filter_rows.ROWS,
    *do_mpc_rows.ROWS,
    *control_rows.ROWS,
    *casadi_rows.ROWS,
    *fmu_rows.ROWS,
    *gymnasium_rows.ROWS,
]
