"""The best of a selection, proven: no allowed configuration of one degree of redundancy is better by more than a gap.

In: a selection. Out: a `Certificate`: the verdict, the bound, and a log of cells that another program can check
(`flexopt.selection.certificate.check`).
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np

from flexopt.errors import Fault
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import Vector
from flexopt.foundation.boundary import instance, number, path, public
from flexopt.foundation.documents import build_version, json_ready
from flexopt.foundation.results import Result
from flexopt.foundation.writing import write_file
from flexopt.model import AnyMachine
from flexopt.plant.inverse_kinematics import ELBOW_SIGN, branch
from flexopt.plant.plant import build_plant
from flexopt.selection.certificate.bound import Covering, branch_and_bound
from flexopt.selection.certificate.curve import CONSTRAINT, RedundancyCurve
from flexopt.selection.problem import SelectionProblem, value_at
from flexopt.selection.result import Selection

FORMAT = "flexopt certificate 2"
# The gap that is asked for, as a share of the objective's scale: of a single mode, and of sums.
GAP_OF_ONE, GAP = 1e-8, 1e-5
ProofStatus = Literal["proven", "undecided", "refuted"]


@dataclass(frozen=True)
class Certificate(Result):
    """How much better than a selection's best any allowed configuration may be.

    Attributes:
        verdict: `"proven"`: none is better by more than `gap`, at most the gap asked for. `"undecided"`: some cells
            could not be bounded so far; the gap is what was reached. `"refuted"`: `better` is.
        objective: what was maximised.
        value: V of the selection's best, a lower bound.
        upper: what V is at most anywhere; infinite where some cell could not be bounded.
        gap: upper − value, at least 0;  gap_asked: the largest that counts as proven;  scale: of the objective.
        better: a better configuration z = [base, posture], (n_z,), or None.
        covering: the cells with their bounds; None where V = 0, the most there is, is reached.
        log: what an independent program needs to check it: machine, target, bounds, and every cell. Constraints of
            one's own are not in it: `flexopt check` calls nothing proven that rests on them.

    Example:
        >>> selection = flexopt.select(flexopt.load("excavator"), (0.0, 1.6), starts=8)
        >>> certificate = flexopt.certify(selection)
        >>> certificate.verdict
        'proven'
    """

    DOCUMENT = "verdict status objective value upper gap gap_asked scale cells better where"

    verdict: ProofStatus
    objective: str
    value: float
    upper: float
    gap: float
    gap_asked: float
    scale: float
    better: Vector | None
    covering: Covering | None = field(repr=False, compare=False)
    _log: Any = field(repr=False, compare=False)

    @property
    def proven(self) -> bool:
        """Whether no allowed configuration is better by more than the gap asked for."""
        return self.verdict == "proven"

    @property
    def cells(self) -> int:
        """How many the redundancy was covered by; 0 where V = 0, the most there is, is reached."""
        return 0 if self.covering is None else self.covering.low.size

    @property
    def where(self) -> tuple[tuple[float, float], ...]:
        """The middles of a few cells that could not be decided, placement and elbow (−1 up, +1 down)."""
        cells = self.covering
        if cells is None:
            return ()
        loose = np.flatnonzero(~(cells.bound <= self.value + self.gap_asked))[:3]
        return tuple((float((cells.low[k] + cells.high[k]) / 2), float(cells.elbow[k])) for k in loose)

    @property
    def status(self) -> str:
        """A sentence."""
        share = f"{100 * self.gap / self.scale:.2g} % of its scale"
        if self.verdict == "proven" and not self.cells:
            return f"proven: no configuration has a larger {self.objective}: 0 is the most there is, and is reached"
        if self.verdict == "proven":
            own = 0 if self.covering is None else self.covering.outside.count(CONSTRAINT)
            return (
                f"proven: no configuration that keeps what was asked has a larger {self.objective} by more than "
                f"{self.gap:.2g} ({share}), by {self.cells} cells over the whole redundancy"
                + (f"; {own} of them rest on constraints, which flexopt check cannot check" if own else "")
            )
        if self.better is not None:
            at = ", ".join(f"{x:.6g}" for x in self.better)
            return f"refuted: {self.objective} is larger by more than {self.gap_asked:.2g} at [{at}]; try more starts"
        near = ", ".join(f"x = {x:.6g} m" for x, _ in self.where)
        known = f"within {self.gap:.2g} ({share}) of the best" if math.isfinite(self.gap) else "nothing is known there"
        return f"undecided: near {near} the largest {self.objective} could not be bounded; {known}"

    @cached_property
    def log(self) -> dict[str, Any]:
        """The log as plain data."""
        return json_ready(self._log())

    @public(path=path(".json", parent=True))
    def write_log(self, path: str | os.PathLike[str]) -> None:
        """Write the log as JSON: `flexopt check PATH` checks it.

        Raises:
            WriteError: the file cannot be written.

        Example:
            >>> certificate.write_log("log.json")
        """
        write_file(path, json.dumps(self.log, allow_nan=False) + "\n")

    def __repr__(self) -> str:
        return self.status


def _refuse(arguments: Arguments, given: Mapping[str, Any]) -> None:
    selection = given["selection"]
    why = None if selection is None or selection.best.unsurpassed else not_provable(selection.problem)
    if selection is not None and selection.measure is not None:
        why = f"maximises {selection.measure}, of which no bound over whole cells is known"
    if why is not None:
        arguments.faults.append(Fault("selection", why))


def not_provable(problem: SelectionProblem) -> str | None:
    """Why the best of a problem cannot be certified, a sentence; None where it can."""
    plant = problem.measures.plant
    if any(objective.has_kinks for objective in problem.objectives):
        return "maximises ε_max, of which no bound over whole cells is known; w_i and their sums can be certified"
    own = [objective.name for objective in problem.objectives if objective.own is not None]
    if own:
        return f"has Functions of its own ({', '.join(own)}), of which no bound over whole cells is known"
    if not plant.closed_form or plant.n_actuated != 2 or problem.redundancy > 1:
        machine = plant.machine
        slides = [name for name, unit in zip(machine.joints, machine.joint_units, strict=True) if unit == "m"]
        told = f" ({', '.join(slides)}: {'a slide' if len(slides) == 1 else 'slides'})" if slides else ""
        return (
            f"is of a kind that cannot be covered: proofs need two actuated joints, both hinges{told} across the plane "
            "of two task rows, and a target that leaves the placement along the first row alone free; elsewhere the "
            "best of all starts is the best that was found"
        )
    if problem.gravity:
        return "asks for the static deflection under gravity, which postures in closed form leave out"
    return None


@public(
    together=_refuse,
    selection=instance(Selection, "a Selection, from flexopt.select"),
    gap=number("", low=1e-12, high=1.0),
)
def certify(selection: Selection, *, gap: float | None = None) -> Certificate:
    """Prove that no allowed configuration is better than a selection's best by more than a gap.

    Of an arm of two hinges in a plane the placement x is covered by cells, for either elbow. In each the objective
    V = Σ αi wi, less the cost of travel, is enclosed by Taylor models with rounding directed outward
    (`flexopt.compiled.taylor`, `flexopt.selection.certificate.modes`), and cells are split until V ≤ best + gap in all
    that may hold a configuration within limits, margin and constraints. V = 0 where it is the most there is needs no
    cells, of any machine.

    Args:
        selection: from `flexopt.select`.
        gap: asked for, as a share of the objective's scale; by default 1e-8 for one w_i, 1e-5 for sums.

    Raises:
        InputError: V < 0 and the arm is not of two actuated hinges across the plane of two task rows, or more is free
            than the placement along the first row; ε_max or own Functions in the objectives; gravity.

    Example:
        >>> selection = flexopt.select(flexopt.load("excavator"), (0.0, 1.6), objective="w3", starts=8)
        >>> certificate = flexopt.certify(selection)
        >>> certificate.proven, certificate.gap <= certificate.gap_asked
        (True, True)
    """
    problem = selection.problem
    scale, best = problem.objective_scale, selection.best
    single = sum(alpha > 0 for alpha in problem.objective.alpha) == 1 and problem.travel is None
    asked = (gap or (GAP_OF_ONE if single else GAP)) * scale
    name = problem.objective.name
    cells: Covering | None = None
    if best.unsurpassed:
        value, upper, better, verdict = value_at(problem, best.z), 0.0, None, "proven"
    else:
        curve = RedundancyCurve(problem)
        value = _value(curve, best.z)
        cells = branch_and_bound(curve, value + asked)
        upper, better = max(cells.upper, value), cells.better
        verdict = "refuted" if better is not None else "proven" if cells.decided else "undecided"
    return Certificate(
        verdict, name, value, upper, max(upper - value, 0.0), asked, scale, better, cells,
        lambda: _log(problem, best.z, value, upper, asked, cells),
    )  # fmt: skip


def _value(curve: RedundancyCurve, z: Vector) -> float:
    """A lower bound on V at the placement and with the elbow of z, exactly on the target."""
    problem, x = curve.problem, z[:1]
    plant = problem.measures.plant
    elbows = list(ELBOW_SIGN.values())
    away: list[float] = []
    for sign in elbows:
        posture = branch(plant, problem.target, x[:, None], np.zeros((0, 1)), sign)[0].ravel()
        away.append(float(np.abs((posture - z[1:] + math.pi) % (2 * math.pi) - math.pi).max()))
    return float(curve.see(x, x, np.array([elbows[int(np.argmin(away))]]), precise=True).low[0])


def _log(
    problem: SelectionProblem, z: Vector, value: float, upper: float, gap: float, cells: Covering | None
) -> dict[str, Any]:
    """All that the proof stands on: the format is told in `flexopt.selection.certificate.check`."""
    count, travel = len(problem.kept) + 1, problem.travel
    sizes = problem.objective_scales[:count]
    return {
        "format": FORMAT,
        "flexopt": build_version(),
        "machine": logged_machine(problem.machine),
        "target": problem.target,
        "control": problem.control,
        "weights": [objective.weights for objective in problem.objectives[:count]],
        "kept": problem.kept,
        "margin": problem.singularity_margin,
        "bounds": [(variable.lower, variable.upper) for variable in problem.variables],
        "travel": travel and {"cost": [travel.cost * s for s in sizes], "now": travel.now, "scale": problem.scale},
        "configuration": z,
        "value": value,
        "upper": upper,
        "gap": gap,
        "cells": [] if cells is None else cells.rows(),
    }


def logged_machine(machine: AnyMachine) -> dict[str, Any]:
    """A machine's numbers as a log has them, with the SHA-256 of their JSON: keys sorted, no spaces, ASCII."""
    tree, plant = machine.kinematic_tree, build_plant(machine)
    tip, m = tree.end_point, plant.n_passive
    numbers = {
        "name": machine.name,
        "bodies": [
            {key: getattr(body, key) for key in ("name", "parent", "position", "rotation", "mass", "com", "inertia")}
            | {key: getattr(body.joint, key) for key in ("kind", "axis", "passive", "rest", "armature")}
            for body in tree.bodies
        ],
        "end_point": {"body": tip.body, "position": tip.position, "rows": tip.rows},
        "placement": tree.placement,
        "payload": next(each.value for each in machine.parameters if each.name == tree.entries["payload"]),
        "passive": [body.name for body in tree.passive],
        "actuated": [body.name for body in tree.actuated],
        "stiffness": plant.stiffness.call([plant.parameter_values])[0].full()[:m, :m],
    }
    numbers = json_ready(numbers)
    text = json.dumps(numbers, sort_keys=True, separators=(",", ":"))
    return numbers | {"sha256": hashlib.sha256(text.encode()).hexdigest()}
