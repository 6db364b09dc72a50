"""What a Function costs: to evaluate in CasADi's virtual machine, and to compile.

In: a Function. Out: seconds, estimated by counting operations, so that what is decided by them does not depend on what
else the computer does at that moment.
"""

from __future__ import annotations

from typing import Any, cast

import casadi as ca

# Of an ordinary core of the 2020s; right within a factor of two, which is all that a choice needs.
OPERATION_SECONDS = 2.5e-9
COMPILE_SECONDS = 0.25e-3
# A call whose function is chosen by a number stands for an iteration that may have ended: such a share is made.
_CHOSEN = 0.25


def evaluation_seconds(function: ca.Function) -> float:
    """Seconds that the virtual machine takes for one point."""
    return OPERATION_SECONDS * _executed(function, {})


def compilation_seconds(function: ca.Function) -> float:
    """Seconds that a compiler takes: every function that is called counts once, however often it is called."""
    reached: dict[str, ca.Function] = {}
    waiting = [function]
    while waiting:
        each = waiting.pop()
        if each.name() not in reached:
            reached[each.name()] = each
            waiting += _called(each)
    return COMPILE_SECONDS * sum(each.n_instructions() for each in reached.values() if _is_listed(each))


def _is_listed(function: ca.Function) -> bool:
    return function.is_a("SXFunction") or function.is_a("MXFunction")


def _executed(function: ca.Function, known: dict[str, float]) -> float:
    """Scalar operations of one evaluation."""
    name = function.name()
    if name in known:
        return known[name]
    if function.is_a("SXFunction"):
        total = float(function.n_instructions())
    elif function.is_a("MXFunction"):
        total = sum(_of_matrices(function, k, known) for k in range(function.n_instructions()))
    else:
        inner = [_executed(each, known) for each in _called(function)]
        times = _CHOSEN if function.class_name() == "Switch" else float(cast(Any, function).info().get("n", 1))
        total = times * max(inner, default=0.0)
    known[name] = total
    return total


def _of_matrices(function: ca.Function, k: int, known: dict[str, float]) -> float:
    """Scalar operations of one instruction on matrices."""
    code = function.instruction_id(k)
    node = function.instruction_MX(k)
    if code == ca.OP_CALL:
        return _executed(node.which_function(), known)
    try:
        size = float(node.nnz())
    except RuntimeError:  # inputs and outputs, and what has several outputs
        return 0.0
    return 2 * size * node.dep(1).shape[1] if code == ca.OP_MTIMES else size


def _called(function: ca.Function) -> list[ca.Function]:
    """The Functions that one calls."""
    if function.is_a("MXFunction"):
        return [
            function.instruction_MX(k).which_function()
            for k in range(function.n_instructions())
            if function.instruction_id(k) == ca.OP_CALL
        ]
    if function.is_a("SXFunction"):
        return []
    info = cast(dict[str, Any], cast(Any, function).info())
    # One that is mapped, or those among which a number chooses and the last of them.
    of_it, last = info.get("f"), info.get("f_def")
    found = [*cast(list[Any], of_it), last] if isinstance(of_it, list | tuple) else [of_it, last]
    return [each for each in found if isinstance(each, ca.Function)]
