"""Conformance checks: the rules of plants, estimators, controllers, noises, references, metrics and figures.

Every component that the bench ships passes them, or declares which ones it does not pass and why.  Run them on a
component of your own::

    from rmpc_bench.conformance import check_estimator, parametrize_with_checks

    print(check_estimator("my_filters.py:MyFilter", keys={"c": 0.1}))

    @parametrize_with_checks(["my_filters.py:MyFilter"])
    def test_my_filter(check):
        check()

The checks run in a process of their own, so that a component can neither hang nor end the program.  A class declares
failures that are intended: ``expected_failures = {"consistent": "P is an upper bound"}``.

`check_component` checks a design with given data in this process.  An example contains the data and the checks for one
kind of component.
"""

from typing import Any

from rmpc_bench.conformance.controllers import ControllerExample
from rmpc_bench.conformance.evaluation import FigureExample, MetricExample
from rmpc_bench.conformance.kit import (
    check,
    check_controller,
    check_estimator,
    check_figure,
    check_metric,
    check_noise,
    check_plant,
    check_reference,
    parametrize_with_checks,
)
from rmpc_bench.conformance.plants import PlantExample
from rmpc_bench.conformance.results import Check, CheckResult, Report, run_checks
from rmpc_bench.conformance.signals import NoiseExample, ReferenceExample
from rmpc_bench.conformance.stages import CHECKS
from rmpc_bench.conformance.systems import EstimatorExample

Example = (
    PlantExample
    | EstimatorExample
    | ControllerExample
    | NoiseExample
    | ReferenceExample
    | MetricExample
    | FigureExample
)

__all__ = [
    "CHECKS",
    "Check",
    "CheckResult",
    "ControllerExample",
    "EstimatorExample",
    "Example",
    "FigureExample",
    "MetricExample",
    "NoiseExample",
    "PlantExample",
    "ReferenceExample",
    "Report",
    "check",
    "check_component",
    "check_controller",
    "check_estimator",
    "check_figure",
    "check_metric",
    "check_noise",
    "check_plant",
    "check_reference",
    "parametrize_with_checks",
]


def check_component(component: Any, example: Example) -> tuple[CheckResult, ...]:
    """Check a component by the rules of its kind.

    Parameters
    ----------
    component : a plant, an estimator, a controller, a noise law, a reference, a metric or a figure, as designed
    example : the data to check it with; its class says the kind

    Returns
    -------
    one result per rule, in the order of the example's `checks`

    Examples
    --------
    >>> from rmpc_bench import plant
    >>> from rmpc_bench.conformance import PlantExample, check_component
    >>> servo = plant("servo", Ts=0.1)
    >>> {result.status for result in check_component(servo, PlantExample.random(servo))}
    {'passed'}
    """
    return run_checks(example.checks, component, example)
