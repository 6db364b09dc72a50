"""Random problems of one degree of redundancy, and certificates of their best beside a scan of the whole redundancy."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

import flexopt
from flexopt.foundation.arrays import Vector
from flexopt.plant.inverse_kinematics import branch, inside_limits
from flexopt.robustness.batches import evaluate_w
from tests.oracles.machines import DIRECTIONS, Structure, arm_at_rest, random_machine

# What rounding in doubles may do to V at a point, as a share of the scale.
ROUNDING = 1e-11


class Case(NamedTuple):
    """A problem and what it is called."""

    name: str
    machine: Any
    target: Vector
    options: dict[str, Any]


def random_case(seed: int) -> Case:
    """A machine with two actuated joints, and a target that it reaches."""
    rng = np.random.default_rng([seed, 14])
    free = tuple(d for d in DIRECTIONS if rng.uniform() < 0.75)
    passive = int(rng.integers(0, 3)) if free else int(rng.integers(1, 3))
    n = 2 + passive
    places = tuple(sorted(rng.permutation(n)[:passive].tolist()))
    _, machine = random_machine(rng, Structure(n, free, places))
    posture = rng.uniform(-3.0, 3.0, 2)
    posture[1] = rng.uniform(0.3, 2.8) * rng.choice([-1.0, 1.0])
    target = arm_at_rest(machine, posture)[1]
    m = machine_modes(machine)
    options: dict[str, Any] = {"control": ("inverse", "transpose", "damped:0.3")[int(rng.integers(0, 3))]}
    if rng.uniform() < 0.3:
        options["objective"] = f"w{rng.integers(1, m + 1)}"
    else:
        weights = np.where(rng.uniform(size=m) < 0.75, 10 ** rng.uniform(-2, 0, m), 0.0)
        weights[int(rng.integers(m))] = 1.0
        options |= {"objective": "V", "weights": weights.tolist()}
    if rng.uniform() < 0.4:
        options["base_range"] = sorted(rng.uniform(-2.0, 2.0, 2).tolist())
        options["base_range"] = [min(options["base_range"][0], -0.05), max(options["base_range"][1], 0.05)]
    if rng.uniform() < 0.3:
        travel = {"cost": 10 ** rng.uniform(-3, 0), "base": [0.0], "posture": posture.tolist()}
        options["constraints"] = {"travel": travel}
    if rng.uniform() < 0.3:
        options["singularity_margin_deg"] = 10 ** rng.uniform(-1, 1.4)
    if rng.uniform() < 0.5:
        data = machine.to_dict()
        for link, angle in zip((one for one in data["links"] if not one.get("passive")), posture, strict=True):
            link["limits"] = [angle - rng.uniform(0.05, 2.5), angle + rng.uniform(0.05, 2.5)]
        machine = flexopt.machine_from_dict(data)
    return Case(f"random {seed}", machine, target, options)


def machine_modes(machine: Any) -> int:
    """Number of passive coordinates."""
    return flexopt.build_plant(machine).n_passive


def contradictions(selection: flexopt.Selection, certificate: flexopt.Certificate, points: int) -> tuple[int, float]:
    """Allowed points that have more than their cell's bound allows, or than the certificate's; the best V seen."""
    problem, covering = selection.problem, certificate.covering
    plant, variable = problem.measures.plant, problem.variables[0]
    x = np.linspace(variable.lower, variable.upper, max(2, points // 2))
    wrong, best, rounding = 0, -math.inf, ROUNDING * problem.objective_scale
    for elbow in (-1.0, 1.0):
        posture, reaches = branch(plant, problem.target, x[None, :], np.zeros((0, x.size)), elbow)
        sines = plant.singularity_sine_squared(x[None, :], posture, plant.parameter_values).full().ravel()
        allowed = reaches & inside_limits(problem.machine, posture) & (sines >= problem.constraints[2].lower)
        w = evaluate_w(problem.measures, x[None, allowed], posture[:, allowed], threads=2).w
        value = np.array(problem.objective.alpha) @ w
        if problem.travel is not None:
            z = np.vstack([x[None, allowed], posture[:, allowed]]).T
            value = value - problem.travel_cost(problem.objective, z)[0]
        limit = np.full(value.size, certificate.upper)
        if covering is not None:
            side = covering.elbow == elbow
            lows, bounds = covering.low[side], covering.bound[side]
            number = np.searchsorted(lows, x[allowed], side="right") - 1
            # A point on the edge of two cells, or within rounding of bounds, may count for either.
            beside = (np.searchsorted(lows, x[allowed] + shift, side="right") - 1 for shift in (1e-9, -1e-9))
            limit = np.minimum(limit, np.maximum.reduce([bounds[number], *(bounds[np.maximum(k, 0)] for k in beside)]))
        known = np.isfinite(value)
        wrong += int(np.sum(value[known] > limit[known] + rounding))
        best = max(best, float(value[known].max(initial=-math.inf)))
    return wrong, best
