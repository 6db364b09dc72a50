"""Nonlinear programs and their solvers: the one place where they are made, confirmed and run.

In: a program with its derivatives as graphs; independent derivatives as numbers. Out: a solver; what it reaches from a
start. Before a solver climbs for the first time with a set of parameters, what it will be told of f, g and their slopes
is compared with the independent numbers: a solver that is told a wrong slope stops where it pleases.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any
from weakref import WeakKeyDictionary

import casadi as ca
import numpy as np

from flexopt.errors import WrongSlope
from flexopt.foundation.arrays import Vector

# Both sides are exact, and agree to rounding: the largest entry of each row counts as 1 and more. On stiff machines the
# slopes of ε_max have rounding that is seen from one point to the next one: so many times as much is no disagreement.
TOLERANCE, NOISY, BESIDE = 1e-6, 10.0, 1e-12
# Points compared at most, and how far they stand from a start in the solver's variables: an optimum tells little of
# slopes, and a point at which one of the two has lost its digits tells nothing.
POINTS, AWAY = 5, 3e-2
REMEMBERED = 256


@dataclass(frozen=True)
class Local:
    """A program at a point x: f, ∂f/∂x (n,), g (k,), ∂g/∂x (k, n)."""

    f: float
    gradient: Vector
    g: Vector
    jacobian: Vector

    def rows(self) -> tuple[Vector, Vector]:
        """Values of f and g, (1 + k,), and their slopes, (1 + k, n)."""
        return np.append(self.f, self.g), np.vstack([self.gradient, self.jacobian])


@dataclass(frozen=True)
class Bounds:
    """Lower and upper bounds of x and of g."""

    x_lower: Vector
    x_upper: Vector
    g_lower: Vector
    g_upper: Vector


def make_solver(name: str, program: dict[str, ca.MX], options: dict[str, Any]) -> ca.Function:
    """Build IPOPT on min f(x, p) with bounds on x and g(x, p); derivatives are given among the options.

    The file of options that IPOPT reads from the working directory by default may load libraries and write files.
    """
    own = options.get("ipopt", {}) | {"option_file_name": ""}
    return ca.nlpsol(name, "ipopt", program, options | {"ipopt": own})


def told(solver: ca.Function, parameters: Vector, x: Vector) -> Local:
    """What a solver is told at x, by its own Functions."""
    f, gradient = solver.get_function("nlp_grad_f").call([x, parameters])
    g, jacobian = solver.get_function("nlp_jac_g").call([x, parameters])
    return Local(float(f), gradient.full().ravel(), g.full().ravel(), jacobian.full())


# Of each program, the parameters with which its slopes were right.
_confirmed: WeakKeyDictionary[ca.Function, set[bytes]] = WeakKeyDictionary()


def run(
    solver: ca.Function, independent: Callable[[Vector], Local], start: Vector, parameters: Vector, bounds: Bounds
) -> tuple[Vector, int, str]:
    """Where the solver stops from a start: x, iterations, its own status.

    Args:
        solver: from `make_solver`.
        independent: the same program at x, by Functions that the solver does not use.
        start: x (n,).
        parameters: p.
        bounds: of x and g.

    Raises:
        WrongSlope: the solver is told something else than `independent` says.
    """
    confirm_once(solver, parameters, partial(told, solver, parameters), independent, start, bounds)
    result = solver(
        x0=start, p=parameters, lbx=bounds.x_lower, ubx=bounds.x_upper, lbg=bounds.g_lower, ubg=bounds.g_upper
    )
    statistics: dict[str, Any] = solver.stats()
    return result["x"].full().ravel(), int(statistics["iter_count"]), str(statistics["return_status"])


def confirm_once(
    function: ca.Function,
    parameters: Vector,
    given: Callable[[Vector], Local],
    independent: Callable[[Vector], Local],
    start: Vector,
    bounds: Bounds,
) -> None:
    """`confirm`, the first time that a function is climbed with these parameters."""
    known, key = _confirmed.setdefault(function, set()), parameters.tobytes()
    if key not in known:
        confirm(function, parameters, given, independent, np.clip(start, bounds.x_lower, bounds.x_upper), bounds)
        if len(known) == REMEMBERED:
            known.clear()
        known.add(key)


def confirm(
    function: ca.Function,  # noqa: ARG001 - for tests that look at all of what a solver is given
    parameters: Vector,  # noqa: ARG001
    given: Callable[[Vector], Local],
    independent: Callable[[Vector], Local],
    start: Vector,
    bounds: Bounds,
) -> None:
    """Compare what a solver is given near a start with independent numbers.

    A slope that is wrong is wrong at every point; where rounding has its say at one, the next one decides. Where none
    of it is a number there is nothing to compare.

    Raises:
        WrongSlope: at no point both agree.
    """
    rng = np.random.default_rng(0)
    worst: tuple[float, int, str] | None = None
    for _ in range(POINTS):
        x = np.clip(start + AWAY * rng.uniform(-1, 1, start.size), bounds.x_lower, bounds.x_upper)
        ours, others = given(x).rows(), independent(x).rows()
        found = [_disagreement(mine, other) for mine, other in zip(ours, others, strict=True)]
        if any(row is None for row in found):
            continue
        size, row, what = max((*each, what) for each, what in zip(found, ("value", "slope"), strict=True) if each)
        if size <= TOLERANCE:
            return
        again = [_disagreement(mine, other) for mine, other in zip(independent(x + BESIDE).rows(), others, strict=True)]
        if size <= NOISY * max((each[0] for each in again if each is not None), default=0.0):
            return
        worst = min(worst or (np.inf, 0, ""), (size, row, what))
    if worst is not None:
        size, row, what = worst
        name = "the objective" if row == 0 else f"constraint {row}"
        raise WrongSlope(
            f"nothing was solved: the {what} of {name} that the solver would climb by differs from an independent one "
            f"by {size:.1e} of its size; this is a fault of flexopt, not of the problem"
        )


def _disagreement(mine: Vector, other: Vector) -> tuple[float, int] | None:
    """The largest difference, relative to the row's largest entry or 1, and its row; None where it is no number."""
    if not (np.isfinite(mine).all() and np.isfinite(other).all()):
        return None
    off = np.abs(mine - other).reshape(mine.shape[0], -1).max(axis=1)
    size = np.maximum(1.0, np.abs(other).reshape(mine.shape[0], -1).max(axis=1))
    row = int(np.argmax(off / size))
    return float((off / size)[row]), row
