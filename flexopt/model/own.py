"""Objectives and constraints of the user's own, as CasADi Functions: what can be said of them without a machine.

In: a `casadi.Function`, a bound. Out: frozen data that can be a key, is sent to other processes, and has a name. Which
quantities a Function may take is told by `flexopt.selection.own`.
"""

from __future__ import annotations

import hashlib
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeAlias

from flexopt.errors import Fault, InputError
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import Document
from flexopt.foundation.boundary import by, check_text, number, public_class
from flexopt.foundation.quantities import Checked, a_list, accepting, entries
from flexopt.model.choices import check_objective

if TYPE_CHECKING:
    import casadi as ca

# What calls take as objective; checked at the boundary.
ObjectiveLike: TypeAlias = "str | ca.Function | Sequence[str | ca.Function]"

NAME_MAX = 60
BOUND_MAX = 1e15


def is_function(value: Any) -> bool:
    """Whether a value is a `casadi.Function`; CasADi is not imported for the question."""
    casadi = sys.modules.get("casadi")
    return casadi is not None and isinstance(value, casadi.Function)


@dataclass(frozen=True)
class OwnFunction:
    """A Function of the user's; two are equal where CasADi writes them alike.

    Attributes:
        digest: of what CasADi writes of it.
        function: itself.
    """

    digest: str
    function: Any = field(compare=False, repr=False)

    @property
    def name(self) -> str:
        """What results call it."""
        return str(self.function.name())

    def takes(self, *names: str) -> bool:
        """Whether any of these is an input."""
        return any(name in names for name in self.function.name_in())


@Checked
def check_function(value: Any) -> OwnFunction:
    """A Function that can be written, and so sent to other processes."""
    if isinstance(value, OwnFunction):
        return value
    if not is_function(value):
        raise ValueError("must be a casadi.Function")
    try:
        written = value.serialize()
        value.deserialize(written)
    except Exception:  # noqa: BLE001, RUF100  # CasADi raises RuntimeError, a user's class whatever it likes
        sentence = (
            "must be made of CasADi's own operations: a Callback has no derivatives, and no other process gets it"
        )
        raise ValueError(sentence) from None
    if value.n_out() != 1:
        raise ValueError(f"must have one output, not {value.n_out()}")
    return OwnFunction(hashlib.sha256(written.encode()).hexdigest(), value)


# Files have words alone.
@accepting({"anyOf": [{"type": "string"}, a_list({"type": "string"}, 1)]})
def check_objectives(value: Any) -> str | tuple[str | OwnFunction, ...]:
    """As `check_objective`; or a Function, or several of both in order of importance."""
    if not isinstance(value, list | tuple) and not is_function(value) and not isinstance(value, OwnFunction):
        try:
            return check_objective(value)
        except ValueError as error:
            # Files and the command line have words alone.
            more = "" if isinstance(value, str | int | float) else "; or a casadi.Function, or a list of both"
            raise ValueError(f"{error}{more}") from None
    found: list[str | OwnFunction] = []
    for part in entries(value) if isinstance(value, list | tuple) else [value]:
        found += check_objective(part).split(",") if isinstance(part, str) else [check_function(part)]
    if not found:
        return check_objective("")
    names = [part if isinstance(part, str) else part.name for part in found]
    if len(set(names)) < len(names):
        raise ValueError("names the same objective twice")
    return ",".join(names) if all(isinstance(part, str) for part in found) else tuple(found)


# What calls that choose take as `objective`.
OBJECTIVES = by(check_objectives)


@Checked
def _check_name(value: Any) -> str:
    if not isinstance(value, str) or not value.strip() or len(value) > NAME_MAX:
        raise ValueError(f"must be a name of at most {NAME_MAX} letters")
    return value


_BOUND = number("", low=-BOUND_MAX, high=BOUND_MAX)


@public_class(function=by(check_function), lower=_BOUND, upper=_BOUND, unit=by(check_text), name=by(_check_name))
@dataclass(frozen=True)
class Constraint:
    """A constraint of the user's own: lower ≤ g ≤ upper, for every entry of what a `casadi.Function` gives.

    Attributes:
        function: g, its inputs named by quantities, such as `base`, `posture`, `p`, `w1`, `sag`, `torques`: the whole
            list, for a machine, is in the message where a name is unknown. One output, of any shape.
        lower, upper: bounds in g's unit; without either lower = 0.
        unit: of g, for results.
        name: of the constraint in results, that of the Function by default.

    Raises:
        InputError: something else than a Function of CasADi's own operations, bounds out of order.

    Example:
        >>> sag = ca.MX.sym("sag", 2)
        >>> g = ca.Function("sag_of_end_point", [sag], [ca.norm_2(sag)], ["sag"], ["length"])
        >>> at_most = flexopt.Constraint(g, upper=0.005, unit="m")
        >>> choice = flexopt.select(flexopt.load("excavator"), (0.0, 1.6), constraints=[at_most], starts=4)
        >>> bool(choice.best.constraints["sag_of_end_point"].value < 0.005)
        True
    """

    function: Any
    lower: float | None = None
    upper: float | None = None
    unit: str = ""
    name: str | None = None

    def __repr__(self) -> str:
        lower, upper = self.bounds
        unit = f" {self.unit}" if self.unit else ""
        return f"Constraint({self.name or self.function.name!r}: {lower:g} to {upper:g}{unit})"

    def __post_init__(self) -> None:
        lower, upper = self.bounds
        if not lower < upper:
            faults = [Fault("upper", "must be above lower: an own constraint leaves an interval", f"{upper:g}")]
            raise InputError(f"Constraint: {faults[0]}", faults, "Constraint")

    @property
    def bounds(self) -> tuple[float, float]:
        """Lower and upper bound, infinite where there is none."""
        if self.lower is None and self.upper is None:
            return 0.0, math.inf
        return -math.inf if self.lower is None else self.lower, math.inf if self.upper is None else self.upper

    @property
    def label(self) -> str:
        """What results call it."""
        return self.name or self.function.name

    def to_dict(self) -> Document:
        """Name, bounds (None where there is none), unit, and what the Function is told from others by.

        Example:
            >>> posture = ca.MX.sym("posture", 2)
            >>> g = ca.Function("boom_angle", [posture], [posture[0]], ["posture"], ["angle"])
            >>> flexopt.Constraint(g, upper=1.0, unit="rad").to_dict()["upper"]
            1.0
        """
        lower, upper = (bound if math.isfinite(bound) else None for bound in self.bounds)
        return {"name": self.label, "lower": lower, "upper": upper, "unit": self.unit, "digest": self.function.digest}


@Checked
def check_own_constraints(value: Any) -> tuple[Constraint, ...]:
    """Functions, each of whose entries is at least 0, and `Constraint`s; names differ."""
    if not isinstance(value, list | tuple):
        raise ValueError("must be a list of casadi.Functions and flexopt.Constraints")
    found: list[Constraint] = []
    for k, part in enumerate(value):  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]
        if isinstance(part, Constraint):
            found.append(part)
            continue
        arguments = Arguments("constraints")
        function: Any = arguments.checked("function", part, check_function, None)
        if arguments.faults:
            wanted = "" if is_function(part) else " or a flexopt.Constraint; files have none"
            raise ValueError(f"entry {k} {arguments.faults[0].sentence}{wanted}")
        found.append(Constraint(function.function))
    names = [constraint.label for constraint in found]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise ValueError(f"has two with the name {twice!r}; names must differ")
    return tuple(found)
