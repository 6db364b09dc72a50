"""Dynamics by Lagrange's equations: positions written out with relative angles, the rest by differentiation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np


def coordinate_names(data: dict[str, Any]) -> list[str]:
    """Passive coordinates, then actuated ones, as the contract orders them."""
    free = [f"base.{d}" for d in ("x", "y", "rotation") if d in data["base"]["stiffness"]]
    passive = [link["name"] for link in data["links"] if link.get("passive")]
    return free + passive + [link["name"] for link in data["links"] if not link.get("passive")]


def rest_values(data: dict[str, Any], base: float, posture: Any) -> np.ndarray:
    known = {"base.x": base, "base.y": 0.0, "base.rotation": data["base"]["rest_angle"]}
    known |= {link["name"]: link["rest"] for link in data["links"] if link.get("passive")}
    known |= dict(zip((link["name"] for link in data["links"] if not link.get("passive")), posture, strict=True))
    return np.array([known[name] for name in coordinate_names(data)])


def springs_and_dampers(data: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    base = data["base"]
    stiffness = {f"base.{d}": k for d, k in base["stiffness"].items()}
    damping = {f"base.{d}": c for d, c in base.get("damping", {}).items()}
    for link in data["links"]:
        stiffness[link["name"]] = link.get("stiffness", 0.0)
        damping[link["name"]] = link.get("damping", 0.0) + link.get("joint_damping", 0.0)
    names = coordinate_names(data)
    return np.diag([stiffness[n] for n in names]), np.diag([damping.get(n, 0.0) for n in names])


@dataclass(frozen=True)
class Lagrange:
    """Numerical functions of the oracle; q as in the contract, `base` the placement."""

    dynamics: ca.Function  # (q, v, base) -> M, h, g, r, J, points
    tangent: ca.Function  # (q, base) -> ∂g/∂q
    force: ca.Function  # (q, v, base, q_rest) -> F with M v̇ = F + τ, and ∂F/∂q, ∂F/∂v


def lagrange(data: dict[str, Any]) -> Lagrange:
    names = coordinate_names(data)
    q, v, base = ca.SX.sym("q", len(names)), ca.SX.sym("v", len(names)), ca.SX.sym("base")
    at = {name: q[i] for i, name in enumerate(names)}
    rate = {name: v[i] for i, name in enumerate(names)}

    def turned(angle: Any, along: float, left: float = 0.0) -> Any:
        return ca.vertcat(ca.cos(angle) * along - ca.sin(angle) * left, ca.sin(angle) * along + ca.cos(angle) * left)

    body = data["base"]
    angle, spin = at.get("base.rotation", body["rest_angle"]), rate.get("base.rotation", 0.0)
    foot = ca.vertcat(at.get("base.x", base), at.get("base.y", 0.0))
    masses = [(body["mass"], body["inertia"], foot + turned(angle, body["com"], body["com_offset"]), spin)]
    points = [foot, foot + turned(angle, body["length"])]
    for link in data["links"]:
        angle, spin = angle + at[link["name"]], spin + rate[link["name"]]
        centre = points[-1] + turned(angle, link["com"], link["com_offset"])
        masses.append((link["mass"], link["inertia"], centre, spin))
        points.append(points[-1] + turned(angle, link["length"]))
    masses.append((data["payload"]["mass"], 0.0, points[-1], 0.0))

    kinetic, potential = ca.SX(0), ca.SX(0)
    for mass, inertia, position, turning in masses:
        velocity = ca.jtimes(position, q, v)
        kinetic += mass * ca.dot(velocity, velocity) / 2 + inertia * turning**2 / 2
        potential += mass * data["gravity"] * position[1]
    momentum = ca.jacobian(kinetic, v).T
    mass_matrix = ca.jacobian(momentum, v)
    bias = ca.jacobian(momentum, q) @ v - ca.jacobian(kinetic, q).T
    gravity = ca.jacobian(potential, q).T
    jacobian = ca.jacobian(points[-1], q)
    outputs = [mass_matrix, bias, gravity, points[-1], jacobian, ca.horzcat(*points)]
    stiffness, damping = springs_and_dampers(data)
    rest = ca.SX.sym("rest", len(names))
    force = -bias - ca.DM(stiffness) @ (q - rest) - ca.DM(damping) @ v
    return Lagrange(
        ca.Function("lagrange", [q, v, base], [ca.densify(o) for o in outputs]),
        ca.Function("tangent", [q, base], [ca.densify(ca.jacobian(gravity, q))]),
        ca.Function(
            "force", [q, v, base, rest], [force, ca.densify(ca.jacobian(force, q)), ca.densify(ca.jacobian(force, v))]
        ),
    )
