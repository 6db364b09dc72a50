"""What goes into a recurrence, checked: its Functions, and the arrays of its members.

In: Functions and arguments as the caller gave them. Out: the number of rows of each quantity; arrays of one layout; or
one `InputError` that names every fault.
"""

from __future__ import annotations

from collections.abc import Mapping
from numbers import Integral
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.arrays import Array

_KEEP = ("records", "monitors")
# Quantities that go into each Function, and that come out.
_QUANTITIES = {
    "step": (("x", "e", "c"), ("x", "monitor")),
    "fast": (("x", "d", "e", "c"), ("x", "d", "monitor", "turn")),
    "refresh": (("x", "c"), ("d",)),
}


def checked_functions(functions: Mapping[str, ca.Function], every: Any) -> dict[str, int]:
    """Number of rows of x, e, c, d and monitor, on which `step`, `fast` and `refresh` must agree.

    Raises:
        InputError: they do not; `fast` without `refresh` or the reverse; `every` is not a number of steps.
    """
    sizes = {"turn": 1}
    faults: list[Fault] = []
    for name, function in functions.items():
        inputs, outputs = _QUANTITIES[name]
        if (function.n_in(), function.n_out()) != (len(inputs), len(outputs)):
            want = f"must take {', '.join(inputs)} and give {', '.join(outputs)}"
            faults.append(Fault(name, f"{want}, not {function.n_in()} inputs and {function.n_out()} outputs"))
            continue
        shapes = [function.size_in(k) for k in range(len(inputs))] + [function.size_out(k) for k in range(len(outputs))]
        for quantity, (rows, columns) in zip(inputs + outputs, shapes, strict=True):
            known = sizes.setdefault(quantity, rows * columns)
            if rows * columns != known or (columns != 1 and known):
                faults.append(Fault(name, f"{quantity} must have the shape ({known}, 1), not ({rows}, {columns})"))
    if ("fast" in functions) != ("refresh" in functions):
        faults.append(Fault("fast, refresh", "one needs the other"))
    if not _whole(every, 1):
        faults.append(Fault("every", "must be a whole number of steps, at least 1", repr(every)))
    raise_if_any(InputError, f"recurrence of {functions['step'].name()}", faults)
    return {name: sizes.get(name, 0) for name in ("x", "e", "c", "d", "monitor")}


def checked_arguments(
    name: str, sizes: Mapping[str, int], x0: ArrayLike, c: ArrayLike, e: ArrayLike | None, options: Mapping[str, Any]
) -> tuple[list[Array], int]:
    """x0 (n, N or 1), c (n_c, N or 1), e (steps or 1, n_e, N or 1), and the number N of members."""
    faults: list[Fault] = []
    for option, least in (("steps", 0), ("stride", 1), ("threads", 1)):
        if not _whole(options[option], least):
            faults.append(Fault(option, f"must be a whole number, at least {least}", repr(options[option])))
    if options["keep"] not in _KEEP:
        faults.append(Fault("keep", f"must be one of {', '.join(_KEEP)}", repr(options["keep"])))
    arrays = {
        "x0": _columns("x0", x0, sizes["x"], faults),
        "c": _columns("c", c, sizes["c"], faults),
        "e": _entering(e, sizes["e"], options["steps"], faults),
    }
    counts = {field: value.shape[-1] for field, value in arrays.items() if value is not None}
    lengths = set(counts.values()) - {1}
    if len(lengths) > 1:
        given = ", ".join(f"{field}: {count}" for field, count in counts.items())
        faults.append(Fault("members", f"the arrays have different numbers of them ({given})"))
    raise_if_any(InputError, f"recurrence of {name}", faults)
    return [value for value in arrays.values() if value is not None], lengths.pop() if lengths else 1


def densified(function: ca.Function) -> ca.Function:
    """The Function with every entry of its inputs and outputs structurally nonzero."""
    names = function.name_in(), function.name_out()
    inputs = [function.sparsity_in(k) for k in range(function.n_in())]
    outputs = [function.sparsity_out(k) for k in range(function.n_out())]
    if all(sparsity.is_dense() for sparsity in inputs + outputs):
        return function
    if function.is_a("SXFunction"):
        scalars = [ca.SX.sym(name, *s.shape) for name, s in zip(names[0], inputs, strict=True)]
        return ca.Function(function.name(), scalars, [ca.densify(y) for y in function.call(scalars)], *names)
    symbols = [ca.MX.sym(name, *s.shape) for name, s in zip(names[0], inputs, strict=True)]
    return ca.Function(function.name(), symbols, [ca.densify(y) for y in function.call(symbols)], *names)


def _columns(field: str, given: ArrayLike, rows: int, faults: list[Fault]) -> Array | None:
    value = _numbers(field, given, faults)
    if value is None:
        return None
    if value.ndim not in {1, 2} or value.shape[0] != rows:
        faults.append(Fault(field, f"must have the shape ({rows}, number of members) or ({rows},), not {value.shape}"))
        return None
    return value[:, None] if value.ndim == 1 else value


def _entering(given: ArrayLike | None, rows: int, steps: Any, faults: list[Fault]) -> Array | None:
    want = f"({rows},), ({steps}, {rows}) or ({steps}, {rows}, number of members)"
    if given is None:
        if rows:
            faults.append(Fault("e", f"must be given, with the shape {want}"))
        return np.zeros((1, rows, 1))
    value = _numbers("e", given, faults)
    if value is None:
        return None
    if value.shape in {(rows,), (rows, 1)}:
        return value.reshape(1, rows, 1)
    if value.ndim not in {2, 3} or value.shape[:2] != (steps, rows):
        faults.append(Fault("e", f"must have the shape {want}, not {value.shape}"))
        return None
    return value[:, :, None] if value.ndim == 2 else value


def _numbers(field: str, given: ArrayLike, faults: list[Fault]) -> Array | None:
    try:
        return np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        faults.append(Fault(field, "must be numbers, as many in each row"))
        return None


def _whole(value: Any, least: int) -> bool:
    return type(value) is not bool and isinstance(value, Integral) and int(value) >= least
