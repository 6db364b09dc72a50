"""Gradients of flexopt beside Appendix B's, over random machines and postures: one generator for tests and benchmark."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import casadi as ca
import numpy as np
from scipy.optimize import brentq

from flexopt import Plant, build_measures, build_plant
from flexopt.model import Machine, machine_from_dict
from tests.oracles.appendix_b import AppendixB, Matrices
from tests.oracles.machines import NumpySource, condition_at_rest, draw_structure, random_machine

CONTROLS: tuple[Literal["inverse", "transpose"], ...] = ("inverse", "transpose")


@dataclass(frozen=True)
class Case:
    """A machine at a posture, and where it lies in the range over which accuracy is stated."""

    machine: Machine
    posture: np.ndarray
    spread: float  # largest over smallest stiffness asked for
    gap: float  # smallest |ω_i² − ω_j²| over their mean; 1 for a single mode
    condition: float  # cond Jv


@dataclass(frozen=True)
class Comparison:
    """|∂w_flexopt − ∂w_oracle| / ‖∂R_i‖_F for each mode and variable, and flexopt's gradient along the base."""

    case: Case
    control: str
    errors: np.ndarray  # (m, n_variables)
    values: np.ndarray  # |w_flexopt − w_oracle| / ‖R_i‖_F, (m,)
    base_gradient: np.ndarray  # (m,)


def cases(
    seed: int,
    count: int,
    *,
    spread: float = 1e4,
    gap: float = 1e-3,
    condition: float = 50.0,
    m_max: int = 3,
    postures: int = 2,
) -> Iterator[Case]:
    """`count` cases with relative gaps of ω² above `gap` and cond Jv below `condition`, n and m in turn."""
    rng = np.random.default_rng(seed)
    source = NumpySource(rng)
    found = 0
    while found < count:
        n, m = 2 + found // postures % 4, 1 + found // postures // 4 % m_max
        structure = draw_structure(source, n_min=n, n_max=n, m_max=m_max)
        if structure.n_passive != m:
            continue
        _, machine = random_machine(rng, structure, spread=spread)
        for _ in range(postures):
            case = _regular_case(rng, machine, spread, gap, condition)
            if case is None:
                break
            found += 1
            yield case


def _regular_case(
    rng: np.random.Generator, machine: Machine, spread: float, gap: float, condition: float
) -> Case | None:
    for _ in range(20):
        posture = rng.uniform(-np.pi, np.pi, len(machine.joints))
        cond = condition_at_rest(machine, posture)
        if cond > condition:
            continue
        smallest = relative_gap(omega_squared(machine, posture))
        if smallest >= gap:
            return Case(machine, posture, spread, smallest, cond)
    return None


def omega_squared(machine: Machine, posture: np.ndarray) -> np.ndarray:
    plant = build_plant(machine)
    p, m = plant.parameter_values, plant.n_passive
    mass = plant.mass(plant.rest(0.0, posture, p), 0.0, p).full()
    stiffness = plant.stiffness(p).full()[:m, :m]
    root = np.sqrt(stiffness)
    return np.linalg.eigvalsh(root @ np.linalg.inv(mass)[:m, :m] @ root)


def relative_gap(values: np.ndarray) -> float:
    if len(values) < 2:
        return 1.0
    return float(np.min(np.diff(values) / ((values[1:] + values[:-1]) / 2)))


def near_repeated(rng: np.random.Generator, wanted: float, condition: float = 50.0) -> Case:
    """Two modes whose ω² differ by `wanted`, relative to their mean.

    Frequencies avoid each other, so two things are tuned: a joint, until the passive coordinates decouple (the compliance
    N = (M⁻¹)_pp is diagonal), and then one spring.
    """
    while True:
        n = int(rng.integers(2, 6))
        structure = draw_structure(NumpySource(rng), n_min=n, n_max=n, m_max=2)
        if structure.n_passive != 2:
            continue
        data, machine = random_machine(rng, structure)
        plant, posture = build_plant(machine), rng.uniform(-np.pi, np.pi, len(machine.joints))

        def compliance(angle: float, plant: Plant = plant, posture: np.ndarray = posture) -> np.ndarray:
            at = np.append(posture[:-1], angle)
            q = plant.rest(0.0, at, plant.parameter_values)
            return np.linalg.inv(plant.mass(q, 0.0, plant.parameter_values).full())[:2, :2]

        grid = np.linspace(-np.pi, np.pi, 25)
        coupling = [compliance(angle)[0, 1] for angle in grid]
        signs = np.flatnonzero(np.diff(np.sign(coupling)) != 0)
        if len(signs) == 0:
            continue
        k = int(rng.choice(signs))
        angle = brentq(lambda a, f=compliance: f(a)[0, 1], grid[k], grid[k + 1], xtol=1e-15, rtol=1e-14)
        first, second = np.diag(compliance(angle))
        tables = [data["base"]["stiffness"]] * len(structure[1]) + [data["links"][i] for i in structure[2]]
        keys = [*structure[1], *["stiffness"] * len(structure[2])]
        tables[1][keys[1]] = tables[0][keys[0]] * first / second * (1 + wanted)
        tuned, at = machine_from_dict(data), np.append(posture[:-1], angle)
        if condition_at_rest(tuned, at) <= condition:
            gap = relative_gap(omega_squared(tuned, at))
            return Case(tuned, at, 1e4, gap, condition_at_rest(tuned, at))


def near_singular(rng: np.random.Generator, wanted: float, gap: float = 1e-3) -> Case:
    """A posture with cond Jv near `wanted`: all joints but the first are turned towards straight, or folded."""
    while True:
        structure = draw_structure(NumpySource(rng), m_max=3, passive_joints=False)
        _, machine = random_machine(rng, structure)
        away = rng.uniform(-1.0, 1.0, len(machine.joints))
        singular = np.where(rng.random(len(away)) < 0.5, np.pi, 0.0)
        away[0], singular[0] = 0.0, rng.uniform(-np.pi, np.pi)
        low, high = np.log(1e-7), 0.0
        for _ in range(60):
            middle = (low + high) / 2
            above = condition_at_rest(machine, singular + np.exp(middle) * away) > wanted
            low, high = (middle, high) if above else (low, middle)
        posture = singular + np.exp(low) * away
        smallest = relative_gap(omega_squared(machine, posture))
        condition = condition_at_rest(machine, posture)
        if smallest >= gap and wanted / 2 < condition < wanted * 2:
            return Case(machine, posture, 1e4, smallest, condition)


def compare(case: Case, variables: Literal["posture", "parameters"] = "posture") -> list[Comparison]:
    """Both controllers at one case."""
    at, along = matrices(case.machine, case.posture, variables)
    plant = build_plant(case.machine)
    oracle = AppendixB(at, plant.n_passive)
    derivatives = [oracle.differentiate(each) for each in along]
    out: list[Comparison] = []
    for control in CONTROLS:
        measures = build_measures(case.machine, control)
        gradients = measures.gradients(base=0.0, posture=case.posture, p=plant.parameter_values)
        w_z, w_p = gradients["w_z"].full(), gradients["w_p"].full()
        ours = w_z[:, plant.n_base :] if variables == "posture" else w_p
        theirs = np.stack([d[control].w for d in derivatives], axis=1)
        norms = np.stack([d[control].residue_norm for d in derivatives], axis=1)
        sizes = np.array([np.linalg.norm(oracle.residue(i, control)) for i in range(plant.n_passive)])
        if variables == "parameters":
            # R_i does not depend on the only spring, and hardly on some: 1e-3 of the size of a proportional change is
            # the least that an error is compared with. At p = 0 there is no such size, and ‖∂R_i‖ stands alone.
            p = np.abs(plant.parameter_values.full().ravel())
            norms = np.maximum(norms, 1e-3 * sizes[:, None] / np.where(p > 0, p, np.inf))
        # What moves nothing (gravity, dampers at zero) must have a gradient of exactly zero.
        errors = np.abs(ours - theirs) / np.where(norms > 0, norms, np.finfo(float).tiny)
        w = measures.w(base=0.0, posture=case.posture, p=plant.parameter_values)["w"].full().ravel()
        values = np.array([abs(w[i] - oracle.w(i, control)) / sizes[i] for i in range(plant.n_passive)])
        out.append(Comparison(case, control, errors, values, w_z[:, 0]))
    return out


def matrices(machine: Machine, posture: np.ndarray, variables: str) -> tuple[Matrices, list[Matrices]]:
    """M, K, J, Jv at rest and their derivatives along each posture variable or parameter, by AD of the plant."""
    plant = build_plant(machine)
    g = plant.graph
    q = plant.rest(g.base, g.posture, g.p)
    parts = [plant.mass(q, g.base, g.p), plant.stiffness(g.p), plant.jacobian(q, g.base, g.p)]
    parts.append(plant.rigid_jacobian(q, g.base, g.p))
    symbol = g.posture if variables == "posture" else g.p
    slopes = [ca.densify(ca.jacobian(ca.vec(part), symbol)) for part in parts]
    evaluated = ca.Function("matrices", [g.base, g.posture, g.p], [*parts, *slopes])
    out = [x.full() for x in evaluated(0.0, posture, plant.parameter_values)]
    values, derivatives = out[:4], out[4:]
    along = [
        Matrices(*(d[:, k].reshape(v.shape, order="F") for v, d in zip(values, derivatives, strict=True)))
        for k in range(symbol.shape[0])
    ]
    return Matrices(*values), along
