"""A planar chain in closed form, in absolute angles: every graph of the plant follows from one table of moments.

With absolute body angles φ_k, unit vectors e(φ) = (cos φ, sin φ) and n(φ) = (−sin φ, cos φ), the position of mass j is
(x, y) + Σ_k [c_jk e(φ_k) + d_jk n(φ_k)]: c_jk is the body's length for k < j, the centre of mass for k = j. With

    a_k = Σ_j m_j c_jk,   b_k = Σ_j m_j d_jk,   s_kl = Σ_j m_j (c_jk c_jl + d_jk d_jl) + δ_kl I_k,
    t_kl = Σ_j m_j (c_jk d_jl − d_jk c_jl)

the mass matrix in u = [x, y, φ_0, …] has the angular block s_kl cos(φ_k − φ_l) + t_kl sin(φ_k − φ_l) and the columns
a_k n(φ_k) − b_k e(φ_k) beside m I; the velocity terms and gravity come from the same constants. Relative angles, rigid
base directions and passive joints are linear maps of u, applied once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import pairwise

import casadi as ca

from flexopt.algebra import safe_norm
from flexopt.model.machine import Machine


@dataclass(frozen=True)
class ChainGraph:
    """SX graphs of a chain. Shapes: n_q coordinates, n_p of them passive, n_b placement coordinates, 2 task rows."""

    q: ca.SX
    v: ca.SX
    base: ca.SX
    posture: ca.SX
    p: ca.SX
    end_point: ca.SX
    skeleton: ca.SX
    mass: ca.SX
    bias: ca.SX
    gravity: ca.SX
    stiffness: ca.SX
    damping: ca.SX
    rest: ca.SX
    singularity_sine_squared: ca.SX
    coordinates: tuple[str, ...]
    coordinate_units: tuple[str, ...]
    n_passive: int


@dataclass(frozen=True)
class _Mass:
    """A rigid body or point mass: `body` carries it at (along, left) of that body's first joint."""

    mass: ca.SX
    inertia: ca.SX
    body: int
    along: ca.SX
    left: ca.SX


def build_chain(machine: Machine) -> ChainGraph:
    """All graphs of a planar machine."""
    names = [parameter.name for parameter in machine.parameters]
    p = ca.SX.sym("p", len(names))
    value = {name: p[i] for i, name in enumerate(names)}

    free = machine.free_base_directions
    passive = [link.name for link in machine.links if link.passive]
    actuated = list(machine.joints)
    coordinates = [f"base.{direction}" for direction in free] + passive + actuated
    units = ["rad" if name == "base.rotation" or not name.startswith("base.") else "m" for name in coordinates]
    n_passive = len(free) + len(passive)
    q, v = ca.SX.sym("q", len(coordinates)), ca.SX.sym("v", len(coordinates))
    base, posture = ca.SX.sym("base", 1), ca.SX.sym("posture", len(actuated))

    rest_of = {"base.x": base[0], "base.y": ca.SX(0), "base.rotation": value["base.rest_angle"]}
    rest_of |= {name: value[f"{name}.rest"] for name in passive}
    rest_of |= {name: posture[i] for i, name in enumerate(actuated)}
    of_q = rest_of | {name: q[i] for i, name in enumerate(coordinates)}

    angles = [of_q["base.rotation"]]
    for link in machine.links:
        angles.append(angles[-1] + of_q[link.name])
    u = ca.vertcat(of_q["base.x"], of_q["base.y"], *angles)
    to_u = ca.jacobian(u, q)

    bodies = ["base", *(link.name for link in machine.links)]
    lengths = [value[f"{body}.length"] for body in bodies]
    mass_u, bias_u, gravity_u = _absolute_dynamics(moments(value, bodies), angles, to_u @ v, value["gravity"])

    points = [ca.vertcat(of_q["base.x"], of_q["base.y"])]
    for length, angle in zip(lengths, angles, strict=True):
        points.append(points[-1] + length * _e(angle))
    skeleton = ca.densify(ca.horzcat(*points))

    springs = [value[f"base.stiffness.{d}"] for d in free] + [value[f"{name}.stiffness"] for name in passive]
    dampers = [value[f"base.damping.{d}"] for d in free] + [value[f"{name}.damping"] for name in passive]
    joint_dampers = [value[f"{name}.joint_damping"] for name in actuated]

    return ChainGraph(
        q=q,
        v=v,
        base=base,
        posture=posture,
        p=p,
        end_point=points[-1],
        skeleton=skeleton,
        mass=ca.densify(to_u.T @ mass_u @ to_u),
        bias=ca.densify(to_u.T @ bias_u),
        gravity=ca.densify(to_u.T @ gravity_u),
        stiffness=ca.densify(ca.diag(ca.vertcat(*springs, ca.SX.zeros(len(actuated))))),
        damping=ca.densify(ca.diag(ca.vertcat(*dampers, *joint_dampers))),
        rest=ca.vertcat(*(rest_of[name] for name in coordinates)),
        singularity_sine_squared=_singularity_sine_squared(points, _first_points(machine)),
        coordinates=tuple(coordinates),
        coordinate_units=tuple(units),
        n_passive=n_passive,
    )


def _masses(value: dict[str, ca.SX], bodies: list[str]) -> list[_Mass]:
    masses = [
        _Mass(value[f"{b}.mass"], value[f"{b}.inertia"], k, value[f"{b}.com"], value[f"{b}.com_offset"])
        for k, b in enumerate(bodies)
    ]
    tip = len(bodies) - 1
    return [*masses, _Mass(value["payload.mass"], ca.SX(0), tip, value[f"{bodies[-1]}.length"], ca.SX(0))]


@dataclass(frozen=True)
class Moments:
    """The constants of a chain in absolute angles, as graphs of p: everything that masses and lengths contribute.

    Attributes:
        total: all masses.
        a, b: a_k, b_k, one for each body.
        s, t: s_kl and t_kl for l ≤ k, as rows; t_kk = 0.
    """

    total: ca.SX
    a: list[ca.SX]
    b: list[ca.SX]
    s: list[list[ca.SX]]
    t: list[list[ca.SX]]


def moments(value: dict[str, ca.SX], bodies: list[str]) -> Moments:
    """From the parameters by name; `bodies` from the base outwards."""
    masses, n = _masses(value, bodies), len(bodies)
    lengths = [value[f"{body}.length"] for body in bodies]
    along = [[lengths[k] if k < j.body else j.along if k == j.body else ca.SX(0) for k in range(n)] for j in masses]
    left = [[j.left if k == j.body else ca.SX(0) for k in range(n)] for j in masses]

    def total_of(term: Callable[[int], ca.SX]) -> ca.SX:
        terms = ((j.mass, term(i)) for i, j in enumerate(masses))
        return _sum(mass * factor for mass, factor in terms if not factor.is_zero())

    s = [
        [total_of(lambda i, k=k, m=m: along[i][k] * along[i][m] + left[i][k] * left[i][m]) for m in range(k + 1)]
        for k in range(n)
    ]
    for k in range(n):
        s[k][k] += _sum(j.inertia for j in masses if j.body == k)
    return Moments(
        total=_sum(j.mass for j in masses),
        a=[total_of(lambda i, k=k: along[i][k]) for k in range(n)],
        b=[total_of(lambda i, k=k: left[i][k]) for k in range(n)],
        s=s,
        t=[
            [total_of(lambda i, k=k, m=m: along[i][k] * left[i][m] - left[i][k] * along[i][m]) for m in range(k)]
            + [ca.SX(0)]
            for k in range(n)
        ],
    )


def _absolute_dynamics(of: Moments, angles: list[ca.SX], u_rate: ca.SX, gravity: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Mass matrix, velocity terms and gravity forces in u = [x, y, φ_0, …]."""
    n = len(angles)
    mass = ca.SX.zeros(n + 2, n + 2)
    bias = ca.SX.zeros(n + 2, 1)
    force = ca.SX.zeros(n + 2, 1)
    mass[0, 0] = mass[1, 1] = of.total
    force[1] = of.total * gravity
    for k in range(n):
        column = of.a[k] * _n(angles[k]) - of.b[k] * _e(angles[k])
        mass[0:2, k + 2] = column
        mass[k + 2, 0:2] = column.T
        bias[0:2] -= (of.a[k] * _e(angles[k]) + of.b[k] * _n(angles[k])) * u_rate[k + 2] ** 2
        force[k + 2] = gravity * column[1]
        mass[k + 2, k + 2] = of.s[k][k]
        for m in range(k):
            cosine, sine = ca.cos(angles[k] - angles[m]), ca.sin(angles[k] - angles[m])
            mass[k + 2, m + 2] = mass[m + 2, k + 2] = of.s[k][m] * cosine + of.t[k][m] * sine
            pull = of.s[k][m] * sine - of.t[k][m] * cosine
            bias[k + 2] += pull * u_rate[m + 2] ** 2
            bias[m + 2] -= pull * u_rate[k + 2] ** 2
    return mass, bias, force


def _singularity_sine_squared(points: list[ca.SX], joints: list[int]) -> ca.SX:
    """Root mean square sine of the angles between the arm's segments, weighted by their lengths squared.

    With s_i the vector from actuated joint i to the next one (the last: to the end-point) it is
    sqrt(Σ_{i<j} |s_i × s_j|² / Σ_{i<j} |s_i|² |s_j|²): zero exactly where all segments are parallel, which is where Jv
    loses rank; |sin θ3| for two links. Returned squared, so that it is smooth.
    """
    segments = [points[end] - points[start] for start, end in zip(joints, [*joints[1:], len(points) - 1], strict=True)]
    pairs = [(s, t) for i, s in enumerate(segments) for t in segments[i + 1 :]]
    crossed = _sum((s[0] * t[1] - s[1] * t[0]) ** 2 for s, t in pairs)
    return crossed / _sum(ca.dot(s, s) * ca.dot(t, t) for s, t in pairs)


def _e(angle: ca.SX) -> ca.SX:
    return ca.vertcat(ca.cos(angle), ca.sin(angle))


def _n(angle: ca.SX) -> ca.SX:
    return ca.vertcat(-ca.sin(angle), ca.cos(angle))


def _sum(terms: Iterable[ca.SX]) -> ca.SX:
    return sum(terms, start=ca.SX(0))


@dataclass(frozen=True)
class ReachingGraph:
    """Closed-form inverse kinematics and the arm's segments, as SX graphs.

    Attributes:
        target: (2,); elbow: −1 or +1; unit: (n − 2,) free coordinates in [0, 1].
        posture: (n,).
        cos_elbow: beyond ±1 where the target is out of reach.
        first_joint_point, segment_lengths: where the arm starts at rest (2,), and the lengths between its joints (n,).
    """

    target: ca.SX
    unit: ca.SX
    elbow: ca.SX
    posture: ca.SX
    cos_elbow: ca.SX
    first_joint_point: ca.SX
    segment_lengths: ca.SX


def build_reaching(machine: Machine, chain: ChainGraph) -> ReachingGraph:
    """Postures that put the end-point on a target, passive joints at rest.

    The last two segments close the chain: with d the vector from their first joint to the target, the cosine of the
    elbow is (|d|² − L1² − L2²) / (2 L1 L2), its sign `elbow` (−1: "up", +1: "down"). Each segment of length l before
    them is turned by ψ from the direction to the target, at distance d; what remains of the arm reaches from there if

        (d² + l² − outer²) / (2 d l) ≤ cos ψ ≤ (d² + l² − inner²) / (2 d l),

    and its unit coordinate runs through exactly those ψ, from −ψ_max over ±ψ_min to ψ_max. So every unit coordinate
    gives a posture wherever there is one.
    """
    joints = _first_points(machine)
    n = len(joints)
    target, elbow, unit = ca.SX.sym("target", 2), ca.SX.sym("elbow"), ca.SX.sym("unit", n - 2)
    straight = ca.substitute(ca.substitute(chain.skeleton, chain.q, chain.rest), chain.posture, ca.SX.zeros(n, 1))
    corners = [straight[:, k] for k in [*joints, straight.shape[1] - 1]]
    segments = [end - start for start, end in pairwise(corners)]
    lengths = [ca.norm_2(segment) for segment in segments]
    # Direction of each segment with all joints at 0; the joints before it add their angles.
    bearings = [ca.atan2(segment[1], segment[0]) for segment in segments]

    angles: list[ca.SX] = []
    turned, point = ca.SX(0), corners[0]
    for k in range(n - 2):
        away = target - point
        distance = safe_norm(away)
        rest = lengths[k + 1 :]
        outer = _sum(rest)
        inner = ca.fmax(0, 2 * _largest(rest) - outer)
        both = distance**2 + lengths[k] ** 2
        least = _acos((both - inner**2) / (2 * distance * lengths[k]))
        most = _acos((both - outer**2) / (2 * distance * lengths[k]))
        side = 2 * unit[k] - 1
        turn = ca.if_else(side < 0, -1.0, 1.0) * (least + (most - least) * ca.fabs(side))
        absolute = ca.atan2(away[1], away[0]) + turn
        angles.append(absolute - bearings[k] - turned)
        turned = turned + angles[-1]
        point = point + lengths[k] * _e(absolute)
    away = target - point
    l1, l2 = lengths[-2:]
    cos_elbow = (ca.dot(away, away) - l1**2 - l2**2) / (2 * l1 * l2)
    bend = elbow * _acos(cos_elbow)
    absolute = ca.atan2(away[1], away[0]) - ca.atan2(l2 * ca.sin(bend), l1 + l2 * ca.cos(bend))
    angles += [absolute - bearings[-2] - turned, bend - (bearings[-1] - bearings[-2])]
    return ReachingGraph(
        target=target,
        unit=unit,
        elbow=elbow,
        posture=ca.vertcat(*(ca.atan2(ca.sin(angle), ca.cos(angle)) for angle in angles)),
        cos_elbow=cos_elbow,
        first_joint_point=corners[0],
        segment_lengths=ca.vertcat(*lengths),
    )


def _largest(values: list[ca.SX]) -> ca.SX:
    largest = values[0]
    for value in values[1:]:
        largest = ca.fmax(largest, value)
    return largest


def _acos(cosine: ca.SX) -> ca.SX:
    return ca.acos(ca.fmax(-1, ca.fmin(1, cosine)))


def _first_points(machine: Machine) -> list[int]:
    """Column of the skeleton where each actuated joint sits."""
    return [1 + index for index, link in enumerate(machine.links) if not link.passive]
