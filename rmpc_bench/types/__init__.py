"""Base classes of the components, and the records that they exchange.

Axis 0 of every array is the run; ``k`` is the time index.  A design is frozen and shared by all runs, a state is a
NamedTuple of arrays, a step is pure.  A capability is an attribute with a default value; callers read this value.
The only imports are NumPy, jaxtyping and annotated-types.
"""

from rmpc_bench.types.attribute import attribute
from rmpc_bench.types.basics import (
    Array,
    Count,
    DataFiles,
    FromCode,
    FromCodeOrText,
    FromData,
    Horizon,
    Matrix,
    NonNegative,
    OfTime,
    OverTime,
    Positive,
    SystemMatrix,
    UserFunction,
    UserFunctionOrText,
)
from rmpc_bench.types.compiled import CompiledFilter, CompiledLaw, CompiledPlant
from rmpc_bench.types.controller import Controller
from rmpc_bench.types.errors import (
    ConfigError,
    DesignError,
    InvalidReturnValue,
    OutOfRange,
    Problem,
    SolverError,
    TimeLimit,
)
from rmpc_bench.types.estimator import Estimator
from rmpc_bench.types.figure import Figure, OnePointFigure, SweepFigure
from rmpc_bench.types.input_signal import InputSignal
from rmpc_bench.types.issue import Issue, does_not_fit, issues_of, no_such_component, row_by_row
from rmpc_bench.types.method import Method
from rmpc_bench.types.metric import (
    Bound,
    Direction,
    Metric,
    MetricInfo,
    MetricLayout,
    Record,
    SampleWindow,
    WindowMetric,
)
from rmpc_bench.types.model import Model
from rmpc_bench.types.noise import Noise
from rmpc_bench.types.ode import Ode, Parameters
from rmpc_bench.types.optimised_step import OptimisedStep
from rmpc_bench.types.plant import Plant
from rmpc_bench.types.plant_info import PlantInfo, SignalLimits
from rmpc_bench.types.plot_records import Line, Panel
from rmpc_bench.types.recorded_runs import RecordedRuns
from rmpc_bench.types.records import (
    DISTURBANCES,
    Channel,
    Command,
    Estimate,
    GainSchedule,
    LawState,
    LinearLaw,
    LinearPlant,
    Motion,
    OperatingPoint,
    Period,
    as_command,
    as_estimate,
    as_motion,
    without_disturbances,
)
from rmpc_bench.types.reference import Reference
from rmpc_bench.types.result_layout import ResultLayout
from rmpc_bench.types.run_info import NO_WATCH, Journal, PassedOn, RunFailure, RunInfo, Watch
from rmpc_bench.types.signals import NamedSignals, Signals
from rmpc_bench.types.status import (
    Status,
    Statuses,
)

__all__ = [
    "DISTURBANCES",
    "NO_WATCH",
    "Array",
    "Bound",
    "Channel",
    "Command",
    "CompiledFilter",
    "CompiledLaw",
    "CompiledPlant",
    "ConfigError",
    "Controller",
    "Count",
    "DataFiles",
    "DesignError",
    "Direction",
    "Estimate",
    "Figure",
    "Ode",
    "OnePointFigure",
    "ResultLayout",
    "SweepFigure",
    "Estimator",
    "FromCode",
    "FromCodeOrText",
    "FromData",
    "GainSchedule",
    "Horizon",
    "InputSignal",
    "InvalidReturnValue",
    "Issue",
    "Journal",
    "Line",
    "LawState",
    "LinearLaw",
    "LinearPlant",
    "Matrix",
    "Method",
    "Metric",
    "MetricInfo",
    "MetricLayout",
    "Model",
    "Motion",
    "NamedSignals",
    "Noise",
    "NonNegative",
    "OfTime",
    "OperatingPoint",
    "OutOfRange",
    "OptimisedStep",
    "OverTime",
    "Panel",
    "PassedOn",
    "Parameters",
    "Period",
    "Plant",
    "PlantInfo",
    "Positive",
    "Problem",
    "Record",
    "RecordedRuns",
    "Reference",
    "ResultLayout",
    "RunFailure",
    "RunInfo",
    "SampleWindow",
    "Signals",
    "SignalLimits",
    "SolverError",
    "Status",
    "Statuses",
    "SystemMatrix",
    "TimeLimit",
    "UserFunction",
    "UserFunctionOrText",
    "Watch",
    "WindowMetric",
    "as_command",
    "as_estimate",
    "as_motion",
    "attribute",
    "does_not_fit",
    "issues_of",
    "no_such_component",
    "row_by_row",
    "without_disturbances",
]
