"""Whether an own Function suits a machine, and whether its derivatives are those of its values.

In: a Function, a machine. Out: sentences on what is wrong, each naming the input or the output.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from flexopt.errors import Fault
from flexopt.foundation.arrays import Vector
from flexopt.foundation.nearest import hint
from flexopt.model import AnyMachine
from flexopt.model.own import OwnFunction
from flexopt.selection.own.quantities import known_quantities

# Points at which a Function's slopes are compared with differences, how far these reach, relative to the input's size,
# by how much both may differ, relative to the larger, and rounding: a Function may bring slopes of its own.
POINTS, STEPS, ALIKE, ROUNDING = 5, (1e-4, 1e-6), 1e-3, 1e-12
# Names that are asked for and have no second derivatives.
MARGIN = "epsilon_max"


def own_faults(field: str, machine: AnyMachine, own: OwnFunction, *, scalar: bool) -> list[Fault]:
    """What of a Function does not suit a machine; `scalar`: its output is one number."""
    function, known = own.function, known_quantities(machine)
    faults: list[Fault] = []
    names: list[str] = function.name_in()
    unknown = [name for name in names if name not in known and name != MARGIN]
    if MARGIN in names:
        sentence = f"takes {MARGIN}, of which no second derivatives are known: it can go in order with others"
        faults.append(Fault(field, sentence))
    for k, name in enumerate(names):
        wanted, shape = (known[name].size if name in known else 0, 1), tuple(function.size_in(k))
        if name in known and shape != wanted:
            faults.append(Fault(field, f"has an input {name} of shape {shape}; of {machine.name} it has {wanted}"))
    if unknown:
        named = ", ".join(f"{name!r}{hint(name, known).replace(';', ' –').rstrip('?')}" for name in unknown)
        listed = "".join(f"\n  {quantity}" for quantity in known.values())
        sentence = f"has inputs that are no quantities ({named}); {machine.name} has:{listed}"
        faults.append(Fault(field, sentence))
    if not names:
        faults.append(Fault(field, "has no inputs: name them by quantities, such as base, posture, w1"))
    if scalar and function.numel_out(0) != 1:
        faults.append(Fault(field, f"must give one number, not an output of shape {tuple(function.size_out(0))}"))
    if not function.numel_out(0):
        faults.append(Fault(field, "gives nothing: its output has no entries"))
    return faults or _undifferentiable(field, own)


def _undifferentiable(field: str, own: OwnFunction) -> list[Fault]:
    try:
        once = own.function.jacobian()
        once.jacobian()
    except RuntimeError:
        return [Fault(field, "calls something that CasADi cannot differentiate twice")]
    return []


def weights_of(own: OwnFunction, m: int) -> tuple[float, ...] | None:
    """The α of a Function that is Σ αi wi, α ≥ 0, of m modes: all that is known of such sums then holds; else None."""
    function = own.function
    names = ["w", *(f"w{i + 1}" for i in range(m))]
    places = [names.index(name) if name in names else -1 for name in function.name_in()]
    if -1 in places or any(ca.which_depends(*_graph(function), 2, True)):
        return None
    w = np.vstack([np.zeros(m), np.eye(m)])
    given = [w.T if place == 0 else w.T[place - 1 : place] for place in places]
    values = function.call(given)[0].full().ravel()
    alpha = values[1:]
    whole = values[0] == 0.0 and np.isfinite(alpha).all() and bool(np.all(alpha >= 0)) and alpha.any()
    return tuple(alpha.tolist()) if whole else None


def _graph(function: ca.Function) -> tuple[ca.MX, ca.MX]:
    """Output and inputs of a Function, each as one vector."""
    edges = np.cumsum([0, *(function.size1_in(k) for k in range(function.n_in()))]).tolist()
    x = ca.MX.sym("x", edges[-1])
    return function.call(ca.vertsplit(x, edges))[0], x


def wrong_slopes(own: OwnFunction, given: Sequence[Vector]) -> str | None:
    """A sentence where a Function's own derivatives are not those of its values; `given`: its inputs (n, N) at points.

    A slope that is wrong is wrong everywhere: where it is right at one point, or none of it is a number, it counts.
    """
    function = own.function
    sizes = [float(np.abs(x).max(initial=0.0)) or 1.0 for x in given]
    jacobian, nothing = function.jacobian(), np.zeros(function.size_out(0))
    rng, off = np.random.default_rng(0), 0.0

    def value(point: list[Vector]) -> Vector:
        found: Vector = function.call(point)[0].full().ravel(order="F")
        return found

    for k in range(min(POINTS, given[0].shape[1])):
        at = [x[:, k] for x in given]
        way = [size * rng.uniform(-1, 1, x.size) for x, size in zip(at, sizes, strict=True)]
        blocks = [block.full() for block in jacobian.call([*at, nothing])]
        told = sum((block @ part for block, part in zip(blocks, way, strict=True)), np.zeros(nothing.size))
        errors = list[float]()
        for step in STEPS:
            ends = [value([x + side * step * part for x, part in zip(at, way, strict=True)]) for side in (1, -1)]
            seen, rounding = (ends[0] - ends[1]) / (2 * step), ROUNDING / step * np.abs(ends).max(initial=0.0)
            beyond = np.abs(told - seen) - ALIKE * np.maximum(np.abs(told), np.abs(seen)) - rounding
            errors.append(float(np.max(np.where(beyond > 0, np.abs(told - seen), 0.0))))
        off = min(errors)
        if not off > 0:
            return None
    return f"brings derivatives that differ from differences of its values, by {off:.3g}"
