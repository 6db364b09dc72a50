"""State-space systems: what the functions of this room take, validated once.

In: a `StateSpace`, another library's system object, a tuple of matrices, or a gain. Out: a checked `StateSpace`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from flexopt.coprime.guard import INSIDE
from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import ComplexLike, MatrixLike
from flexopt.foundation.boundary import ArgumentCheck, anything, array_of, public
from flexopt.foundation.plain import plain, shown
from flexopt.foundation.quantities import Quantity
from flexopt.foundation.results import Result

Matrix = NDArray[np.floating[Any]]


class LinearSystem(Protocol):
    """What python-control and SciPy make of a linear system: it says how it is sampled."""

    @property
    def dt(self) -> float | bool | None:
        """Sampling period, s; None or 0 of continuous time."""
        ...


PERIOD_MAX = 1e100
ENTRY_MAX = 1e100  # squares and products of four entries stay finite


@dataclass(frozen=True, eq=False)
class StateSpace(Result):
    """ẋ = A x + B u, y = C x + D u (dt = 0), or x⁺ = A x + B u (dt > 0).

    Attributes:
        A: (n, n), 1/s in continuous time.
        B: (n, m).
        C: (p, n).
        D: (p, m).
        dt: sampling period, s; 0 for continuous time.

    Raises:
        InputError: entries that are not real, not finite, beyond 1e100, or of wrong shapes (all faults in one message).

    Example:
        >>> flexopt.StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]]).poles()
        array([-1.+0.j])
    """

    DOCUMENT = "A B C D dt[s]"

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    dt: float = 0.0

    def __post_init__(self) -> None:
        if not INSIDE.get():
            parts = _checked_parts(self.A, self.B, self.C, self.D, self.dt, call="StateSpace", prefix="")
            for name, part in zip(("A", "B", "C", "D", "dt"), parts, strict=True):
                object.__setattr__(self, name, part)

    @property
    def n_states(self) -> int:
        """Order of the realisation."""
        return self.A.shape[0]

    @property
    def n_inputs(self) -> int:
        """Number of inputs m."""
        return self.D.shape[1]

    @property
    def n_outputs(self) -> int:
        """Number of outputs p."""
        return self.D.shape[0]

    @property
    def discrete(self) -> bool:
        """Whether time is sampled."""
        return self.dt > 0.0

    def poles(self) -> NDArray[np.complex128]:
        """Eigenvalues of A (n,), rad/s (dimensionless in discrete time).

        Example:
            >>> abs(flexopt.StateSpace([[0.0, 1.0], [-4.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]]).poles())
            array([2., 2.])
        """
        return np.asarray(np.linalg.eigvals(self.A), dtype=complex) if self.n_states else np.zeros(0, complex)

    @public(points=array_of((), ("k",), kinds="iufc"))
    def at(self, points: ComplexLike) -> NDArray[np.complex128]:
        """C (s I − A)⁻¹ B + D at complex `points` (k,) that are no poles; (k, p, m).

        Example:
            >>> flexopt.StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]]).at([0.0, 1j]).ravel()
            array([1. +0.j , 0.5-0.5j])
        """
        s = np.atleast_1d(np.asarray(points, dtype=complex))
        shifted = s[:, None, None] * np.eye(self.n_states) - self.A
        return np.asarray(self.C @ np.linalg.solve(shifted, self.B.astype(complex)[None]) + self.D, dtype=complex)

    def __repr__(self) -> str:
        time = f"sampled every {self.dt:g} s" if self.discrete else "continuous time"
        head = f"StateSpace: {self.n_states} states, {self.n_inputs} inputs, {self.n_outputs} outputs, {time}"
        parts = [f"{name} =\n{np.array2string(getattr(self, name), precision=5)}" for name in "ABCD"]
        return "\n".join([head, *parts])


# What calls take as a linear system, see `state_space`.
SystemLike = StateSpace | LinearSystem | MatrixLike | Sequence[MatrixLike]


def state_space(system: Any, *, call: str = "state_space", field: str = "system") -> StateSpace:
    """Any description of a linear system as a checked `StateSpace`.

    Args:
        system: a `StateSpace`; an object with attributes A, B, C, D and perhaps dt (python-control, SciPy); a transfer
            function of one of those libraries; a tuple (A, B, C), (A, B, C, D) or (A, B, C, D, dt); a number or a
            (p, m) array, taken as a pure gain. dt None means continuous, True means 1 s.
        call: the function that asks, for the message.
        field: the argument's name, for the message.

    Raises:
        InputError: not one of these, or entries that are not real, not finite, beyond 1e100, or of wrong shapes (all
            faults in one message).
    """
    if isinstance(system, StateSpace):
        return system
    try:
        A, B, C, D, dt = _parts(system, call, field)
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001, RUF100  # a foreign object's own methods raise whatever they like
        sentence = f"cannot be read ({type(error).__name__}); pass (A, B, C, D)"
        raise InputError(f"{call}: {field}: {sentence}", [Fault(field, sentence)], call) from None
    return build_system(A, B, C, D, dt, call=call, prefix=f"{field}.")


def from_arguments(A: Any, B: Any, C: Any, D: Any, dt: Any, call: str) -> StateSpace:
    """The plant of a call `f(A, B, C, D, dt=…)`, or `f(system)` when B and C are left out."""
    if B is None and C is None:
        faults: list[Fault] = []
        if D is not None:
            faults.append(Fault("D", "goes with A, B and C; a system brings its own", shown(D)))
        if type(dt) is not float or dt != 0.0:
            faults.append(Fault("dt", "goes with A, B and C; a system brings its own", shown(dt)))
        raise_if_any(InputError, call, faults)
        return state_space(A, call=call)
    return build_system(A, B, C, D, dt, call=call, prefix="")


def build_system(A: Any, B: Any, C: Any, D: Any, dt: Any, *, call: str, prefix: str) -> StateSpace:
    """Check the matrices of one system; every fault goes into one `InputError`."""
    a, b, c, d, period = _checked_parts(A, B, C, D, dt, call=call, prefix=prefix)
    return _made(a, b, c, d, period)


def _made(A: Matrix, B: Matrix, C: Matrix, D: Matrix, dt: float) -> StateSpace:
    """A system of matrices that are checked."""
    outside = INSIDE.set(True)
    try:
        return StateSpace(A, B, C, D, dt)
    finally:
        INSIDE.reset(outside)


def _checked_parts(
    A: Any, B: Any, C: Any, D: Any, dt: Any, *, call: str, prefix: str
) -> tuple[Matrix, Matrix, Matrix, Matrix, float]:
    """A, B, C, D and dt as they are kept."""
    faults: list[Fault] = []
    given = {name: value for name, value in zip("ABCD", (A, B, C, D), strict=True) if name != "D" or value is not None}
    arrays: dict[str, Matrix | None] = {}
    for name, value in given.items():
        arrays[name] = _matrix(prefix + name, value, faults)
    period = _period(prefix + "dt", dt, faults)
    a, b, c, d = (arrays.get(name) for name in "ABCD")
    if a is None or b is None or c is None or ("D" in given and d is None):
        raise_if_any(InputError, call, faults)
        raise AssertionError  # a matrix that is missing left a fault
    a = a.reshape(0, 0) if a.size == 0 else np.atleast_2d(a)
    n = a.shape[0]
    if a.shape != (n, n):
        faults.append(Fault(prefix + "A", f"must be square, not {_shape(a)}"))
    b, c = _vectors(b, c, n, d)
    if b.ndim != 2 or b.shape[0] != n:
        faults.append(Fault(prefix + "B", f"needs as many rows as A has ({n}), not shape {_shape(b)}"))
    if c.ndim != 2 or c.shape[1] != n:
        faults.append(Fault(prefix + "C", f"needs as many columns as A has ({n}), not shape {_shape(c)}"))
    if b.ndim == 2 and c.ndim == 2:
        p, m = c.shape[0], b.shape[1]
        if m == 0 or p == 0:
            faults.append(Fault(prefix.rstrip(".") or "system", "needs at least one input and one output"))
        if d is None or (d.ndim == 0 and d == 0.0):
            d = np.zeros((p, m))
        d = np.atleast_2d(d)
        if d.shape != (p, m):
            faults.append(Fault(prefix + "D", f"must have shape ({p}, {m}) (outputs, inputs), not {_shape(d)}"))
    raise_if_any(InputError, call, faults)
    kept = a, b, c, cast(Matrix, d)
    for matrix in kept:
        matrix.setflags(write=False)
    return *kept, period


def _system(arguments: Arguments, field: str, value: Any) -> StateSpace | None:
    return arguments.collect("", lambda: state_space(value, call=arguments.call, field=field))


# The arguments of a call that takes one plant, which `from_arguments` reads together, and of one that takes two.
PLANT: dict[str, ArgumentCheck] = dict.fromkeys(("A", "B", "C", "D", "dt"), anything)
PAIR: dict[str, ArgumentCheck] = {"P1": _system, "P2": _system}


def system_pair(
    values: tuple[Any, Any], fields: tuple[str, str], call: str, *, feedback: bool
) -> tuple[StateSpace, StateSpace]:
    """Two checked systems that go together: the same time axis, and sizes that fit (as feedback, or side by side).

    A pure gain takes the other's sampling period. The faults of both end in one `InputError`.
    """
    noted, systems = list[Fault](), list[StateSpace]()
    for value, field in zip(values, fields, strict=True):
        try:
            systems.append(state_space(value, call=call, field=field))
        except InputError as error:
            noted += error.faults
    raise_if_any(InputError, call, noted)
    first, second = systems
    if first.n_states == 0:
        first = _made(first.A, first.B, first.C, first.D, second.dt)
    if second.n_states == 0:
        second = _made(second.A, second.B, second.C, second.D, first.dt)
    if not math.isclose(first.dt, second.dt, rel_tol=1e-9):
        noted.append(Fault("dt", f"the systems have different sampling periods, {first.dt:g} and {second.dt:g} s"))
    wanted = first.D.shape[::-1] if feedback else first.D.shape
    if second.D.shape != wanted:
        relation = "the controller needs" if feedback else "the second system needs"
        sentence = f"{relation} {wanted[0]} outputs and {wanted[1]} inputs, not {_shape(second.D)}"
        noted.append(Fault("sizes", sentence))
    raise_if_any(InputError, call, noted)
    return first, second


def _parts(system: Any, call: str, field: str) -> tuple[Any, Any, Any, Any, Any]:
    """A, B, C, D and dt of whatever describes a system."""
    if all(hasattr(system, name) for name in "ABCD"):
        return system.A, system.B, system.C, system.D, getattr(system, "dt", None)
    if isinstance(system, tuple | list) and len(cast(tuple[Any, ...], system)) in {3, 4, 5}:
        A, B, C, *rest = cast(tuple[Any, ...], system)
        D, dt = [*rest, None, None][:2]
        return A, B, C, D, dt
    if hasattr(cast(Any, system), "num") and hasattr(cast(Any, system), "den"):
        return _parts(_realised(system, call, field), call, field)
    if isinstance(system, int | float | np.ndarray | np.number) and not isinstance(system, bool):
        gain = np.atleast_2d(cast(Any, system))
        if gain.ndim == 2 and gain.size:
            return np.zeros((0, 0)), np.zeros((0, gain.shape[1])), np.zeros((gain.shape[0], 0)), gain, 0.0
    sentence = (
        "must be a system with A, B, C, D, a tuple (A, B, C[, D[, dt]]), a transfer function, or a gain (a number or "
        "an array)"
    )
    raise_if_any(InputError, call, [Fault(field, sentence, shown(system))])
    raise AssertionError


def _realised(system: Any, call: str, field: str) -> Any:
    """A transfer function's realisation, by the library that it comes from."""
    try:
        if type(system).__module__.partition(".")[0] == "control":
            library: Any = import_module("control")  # not a dependency: only its own objects need it
            return library.ss(system)
        return system.to_ss()
    except Exception as error:  # noqa: BLE001, RUF100  # whatever the other library raises becomes one sentence
        reason = str(error) or type(error).__name__
        sentence = f"the transfer function cannot be realised in state space ({reason}); pass (A, B, C, D)"
        raise InputError(f"{call}: {field}: {sentence}", [Fault(field, sentence)], call) from None


def _matrix(field: str, value: Any, faults: list[Fault]) -> Matrix | None:
    """A real, finite array of at most two dimensions, or None after noting the fault."""
    sentence, raw = "", cast(NDArray[Any], np.zeros(0))
    try:
        given = plain(value) if isinstance(value, list | tuple) else value
    except ValueError as error:
        faults.append(Fault(field, str(error), shown(value)))
        return None
    try:
        raw = np.asarray(given)
    except ValueError:
        sentence = "must be a matrix: its rows have different lengths"
    except Exception as error:  # noqa: BLE001, RUF100  # a foreign object's own conversion raises whatever it likes
        sentence = f"must be a matrix; it cannot be read ({type(error).__name__})"
    if sentence:
        faults.append(Fault(field, sentence, shown(value)))
        return None
    if value is None:
        sentence = "is missing"
    elif np.ma.isMaskedArray(cast(Any, value)):
        sentence = "must not be masked"
    elif raw.dtype.kind not in "iuf":
        sentence = "must hold real numbers" + (", not complex ones" if raw.dtype.kind == "c" else "")
    elif raw.ndim > 2:
        sentence = f"must have at most two dimensions, not {raw.ndim}"
    elif not np.all(np.isfinite(raw)):
        row = ", ".join(map(str, np.argwhere(~np.isfinite(raw))[0]))
        sentence = f"must be finite, but is not at [{row}]"
    elif raw.size and float(np.max(np.abs(raw.astype(float)))) > ENTRY_MAX:
        sentence = f"must not exceed {ENTRY_MAX:g} in size; choose other units"
    if sentence:
        faults.append(Fault(field, sentence))
        return None
    return np.array(raw, dtype=float)


def _period(field: str, value: Any, faults: list[Fault]) -> float:
    if value is None:
        return 0.0
    if value is True:
        return 1.0
    try:
        return Quantity("s", low=0.0, high=PERIOD_MAX)(value)
    except ValueError:
        sentence = f"must be 0 (continuous) or a sampling period of at most {PERIOD_MAX:g} s"
        faults.append(Fault(field, sentence, shown(value)))
        return 0.0


def _vectors(b: Matrix, c: Matrix, n: int, d: Matrix | None) -> tuple[Matrix, Matrix]:
    """One-dimensional B and C as column and row; empty ones take their size from D."""
    if n == 0:
        gain = np.atleast_2d(d) if d is not None else np.zeros((0, 0))
        b = np.zeros((0, gain.shape[1])) if b.size == 0 and b.ndim < 2 else b
        c = np.zeros((gain.shape[0], 0)) if c.size == 0 and c.ndim < 2 else c
    if b.ndim < 2 and b.size == n:
        b = b.reshape(n, 1)
    if c.ndim < 2 and c.size == n:
        c = c.reshape(1, n)
    return b, c


def _shape(array: Matrix) -> str:
    return "(" + ", ".join(map(str, array.shape)) + ")"
