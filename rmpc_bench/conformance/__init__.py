"""Conformance checks: the rules of plants, estimators, controllers, noises, references, metrics and figures.

Every component that the bench ships passes them; run them on a component of your own::

    from rmpc_bench.conformance import EstimatorExample, check_component

    for result in check_component(my_filter, EstimatorExample.random(nu=1, ny=2)):
        print(result)

An example contains the data and the checks for one kind of component.
"""

from typing import Any

from rmpc_bench.conformance.controllers import ControllerExample
from rmpc_bench.conformance.estimators import EstimatorExample
from rmpc_bench.conformance.figures import FigureExample
from rmpc_bench.conformance.metrics import MetricExample
from rmpc_bench.conformance.noises import NoiseExample
from rmpc_bench.conformance.plants import PlantExample
from rmpc_bench.conformance.references import ReferenceExample
from rmpc_bench.conformance.results import Check, CheckResult, run_checks

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
    "check_component",
]


def check_component(component: Any, example: Example) -> tuple[CheckResult, ...]:
    """Check that a component keeps the rules of its kind.

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
