"""Magnitude of the numbers that a value is computed from, entry by entry.

The difference of two numbers near 30 is known to about 1e-15 only: a difference of 6e-15 is 0 up to rounding, although
6e-15 is far above the smallest float.  The magnitude of ``a - b`` is therefore ``|a| + |b|``; of a product it is the
product, of a determinant the sum of its terms, and functions that are linear or that pick entries keep it.
"""

from __future__ import annotations

import numpy as np

from rmpc_bench.claims import tree
from rmpc_bench.claims.evaluator import Evaluator
from rmpc_bench.claims.functions import applied
from rmpc_bench.claims.values import EvaluationError, Value, aligned, combine, listed
from rmpc_bench.expressions.arithmetic import Call, Negation, Node, Operation, Percent
from rmpc_bench.types import Array

_EXACT = Value(np.array(0.0))
_KEEPING = "abs last at since upto entry diag trace mean median min max quantile".split()


def magnitude(node: Node, evaluator: Evaluator) -> Value:
    """Compute the magnitude of every entry of an expression, none below its absolute value."""
    value = evaluator.value(node)
    size = value.of(np.abs(value.array))
    found = _of_parts(node, evaluator)
    return size if found is None else combine(np.fmax, found, size)


def of_sides(link: tree.Link, evaluator: Evaluator, left: Value) -> tuple[Array, Array]:
    """Compute the magnitudes of both sides of a comparison, in the shape of `left`; 0 for a side without terms."""
    found = [magnitude(node, evaluator) if tree.terms(node) else _EXACT for node in (link.left, link.right)]
    parts = aligned(*found, left)
    first, second = (np.broadcast_to(part.array, left.array.shape) for part in parts[:2])
    return first, second


def _of_parts(node: Node, evaluator: Evaluator) -> Value | None:
    """Magnitude that comes from the parts of an expression; None where only its value is known."""
    match node:
        case Negation():
            return magnitude(node.operand, evaluator)
        case Percent():
            return combine(np.divide, magnitude(node.operand, evaluator), Value(np.array(100.0)))
        case tree.Listing():
            return listed([magnitude(item, evaluator) for item in node.items])
        case Operation():
            return _of_operation(node, evaluator)
        case Call(function="mean", arguments=(tree.Term() as term,)) if evaluator.is_signal(term):
            return _of_mean(node, term, evaluator)
        case Call(function="det", arguments=(matrix,)):
            return _of_det(magnitude(matrix, evaluator))
        case Call() if node.function in _KEEPING:
            first, *others = node.arguments
            return applied(node.function, [magnitude(first, evaluator), *map(evaluator.value, others)])
    return None


def _of_operation(node: Operation, evaluator: Evaluator) -> Value:
    found = magnitude(node.first, evaluator)
    for operand in node.rest:
        if operand.operator == "/":
            divisor = evaluator.value(operand.node)
            found = combine(np.divide, found, divisor.of(np.abs(divisor.array)))
        else:
            function = np.multiply if operand.operator == "*" else np.add
            found = combine(function, found, magnitude(operand.node, evaluator))
    return found


def _of_det(matrix: Value) -> Value:
    """Magnitude of a determinant: the product of the row sums bounds all of its terms together."""
    return matrix.of(matrix.array.sum(axis=-1).prod(axis=-1)) if matrix.entry else matrix


def _of_mean(node: Call, term: tree.Term, evaluator: Evaluator) -> Value | None:
    """Magnitude of the mean of a signal: its rounding error is that of the signal, hence of its spread, too."""
    try:
        deviation = evaluator.value(Call("std", (term,)))
    except EvaluationError:
        return None
    mean = evaluator.value(node)
    return combine(np.add, mean.of(np.abs(mean.array)), deviation)
