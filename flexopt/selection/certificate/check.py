"""Check the log of a certificate.

Run: python -m flexopt.selection.certificate.check LOG.json (needs the extra `certificates`), or flexopt check LOG.json

A program of its own, which shares no line with what wrote the log: it imports nothing of flexopt but `balls`, which
nothing else does, takes the machine's numbers from the log, and computes in the ball arithmetic of Arb (python-flint).
It needs no start and no solver, and believes no result that it can compute.

- The machine has the SHA-256 that the log says, of its JSON without it: keys sorted, no spaces, ASCII. It is of two
  actuated hinges across the plane of two task rows, its anchor moved along the first.
- The scale of an objective is the median of Σ |α_i| |a_i||b_i| / μ_i over `SAMPLES` placements within bounds, in the
  middles of as many equal parts, with either elbow inside the margin, and over the configuration. `ROUNDING` of it is
  what doubles may have done to V.
- The configuration is one that reaches the target, with its joints to within `NEAR`. It is inside bounds and margin, V
  there is `value` or up to `NEAR` of the scale more, and earlier objectives have what is `kept`.
- The cells cover every placement within bounds once, with either elbow. Those that are left out hold no allowed
  configuration; in all others V stays below `upper`, which is at most `gap` above `value`. A log needs no cells where
  no α_i is negative and V = 0 is attained: no w_i is positive, and travel costs something.
- Cells that are left out for constraints are not shown: the log does not carry these.

How: joint angles enter by sine and cosine alone, from the triangle of the two arm segments. Positions, Jacobians and
M = Σ m Jᵀ J + Ωᵀ I Ω are summed body by body; K_p = L Lᵀ and C = L⁻¹ (M_pp − M_pa M_aa⁻¹ M_ap) L⁻ᵀ; its eigenvalues are
roots of its characteristic polynomial, found and enclosed by Weierstrass' corrections, and with the eigenprojectors P_i
w_i = (tr A P_i Bᵀ − sqrt(tr A P_i Aᵀ · tr B P_i Bᵀ)) / μ_i. All are polynomials in the placement, whose coefficients
are balls.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple, cast

from flexopt.selection.certificate.balls import (
    DEGREE,
    BallMatrix,
    BallNumber,
    BallSeries,
    BallVector,
    Unknown,
    added,
    cross,
    dot,
    identity,
    inverse_of_lower,
    inverted,
    minus,
    number,
    numbers,
    pivots_of,
    plus,
    product,
    root,
    rotation,
    solved,
    span,
    times,
    total,
    transposed,
    zero,
)

# After `balls`, which says so where it is missing.
from flint import arb, arb_mat, arb_poly, ctx  # isort: skip

FORMAT = "flexopt certificate 2"
# Bits of a ball; into how many parts a cell is halved at most; placements that give the scale; bytes of a log.
BITS, PARTS, SAMPLES, LARGEST = 128, 400, 32, 1 << 24
# The largest number of a log.
MOST = 1e60
# What rounding in doubles may have done to V, as a share of the scale, and to a configuration, rad or m.
ROUNDING, NEAR = 1e-9, 1e-6
REASONS = ("", "reach", "margin", "limit", "kept", "constraint")
# Faults that are named in one sentence.
NAMED = 10
UNCOMPUTED = (Unknown, ArithmeticError, ValueError)
# Of a log: keys, lists of one kind or of so many entries, (None, what may be missing).
THREE, LONG = [float] * 3, [float]
SHAPE: dict[str, Any] = {
    "format": str,
    "flexopt": (None, str),
    "machine": {
        "name": str,
        "bodies": [
            {"name": str, "parent": (None, str), "position": THREE, "rotation": [THREE] * 3, "mass": float,
             "com": THREE, "inertia": [float] * 6, "kind": str, "axis": THREE, "passive": bool, "rest": float,
             "armature": float}
        ],
        "end_point": {"body": str, "position": THREE, "rows": [str]},
        "placement": [str],
        "payload": float,
        "passive": [str],
        "actuated": [str],
        "stiffness": [LONG],
        "sha256": str,
    },
    "target": LONG,
    "control": str,
    "weights": [LONG],
    "kept": LONG,
    "margin": float,
    "bounds": [[(None, float), (None, float)]],
    "travel": (None, {"cost": LONG, "now": LONG, "scale": LONG}),
    "configuration": LONG,
    "value": float,
    "upper": float,
    "gap": float,
    "cells": [[float, float, float, str]],
}  # fmt: skip
Terms = tuple[BallMatrix, BallMatrix, BallMatrix]


class Refused(Exception):
    """No log, or none that this program computes."""


class Answer(NamedTuple):
    """Sentences about what does not hold; V at the configuration, and the scale, NaN where they were not computed."""

    faults: list[str]
    value: float = math.nan
    scale: float = math.nan


def read(path: str) -> dict[str, Any]:
    """A file's JSON, each key once."""

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        if len(found := dict(pairs)) < len(pairs):
            raise Refused("a key stands twice")
        return found

    try:
        # A pipe would be waited for.
        if not Path(path).is_file() and Path(path).exists():
            raise Refused("is no file")
        with Path(path).open("rb") as file:
            text = file.read(LARGEST + 1)
        if len(text) > LARGEST:
            raise Refused(f"has more than {LARGEST} bytes")
        return json.loads(text, object_pairs_hook=once)
    except OSError as error:
        raise Refused(f"cannot be read ({error.strerror})") from None
    except (ValueError, RecursionError) as error:
        raise Refused(f"is no JSON ({error if isinstance(error, ValueError) else 'nested too deeply'})") from None


def misfits(value: Any, shape: Any, at: str) -> list[str]:
    """Sentences about what of a value has another shape."""
    pairs: list[tuple[str, Any, Any]] = []
    found: list[str] = []
    if isinstance(shape, tuple):
        return [] if value is None else misfits(value, cast(tuple[None, Any], shape)[1], at)
    if isinstance(shape, dict):
        if not isinstance(value, dict):
            return [f"{at}: must be a table"]
        table, keys = cast(dict[str, Any], value), cast(dict[str, Any], shape)
        pairs = [(f"{at}.{key}", table[key], of) for key, of in keys.items() if key in table]
        wrong = sorted(table.keys() ^ keys.keys())
        found = [f"{at}: {key[:40]!r} is {'unknown' if key in table else 'missing'}" for key in wrong]
    elif isinstance(shape, list):
        kinds = cast(list[Any], shape)
        if not isinstance(value, list) or len(kinds) not in (1, len(cast(list[Any], value))):
            return [f"{at}: must be a list{f' of {len(kinds)}' if len(kinds) > 1 else ''}"]
        entries = cast(list[Any], value)
        of_each = kinds * len(entries) if len(kinds) == 1 else kinds
        pairs = [(f"{at}[{k}]", each, kind) for k, (each, kind) in enumerate(zip(entries, of_each, strict=True))]
    elif shape is float:
        return [] if type(value) in (int, float) and abs(value) <= MOST else [f"{at}: must be a finite number"]
    else:
        return [] if isinstance(value, shape) else [f"{at}: must be {'text' if shape is str else 'true or false'}"]
    return found + [fault for name, each, kind in pairs for fault in misfits(each, kind, name)]


def unfit(log: dict[str, Any]) -> list[str]:
    """Sentences about values that a log of this shape cannot have."""
    of, bodies, travel = log["machine"], log["machine"]["bodies"], log["travel"]
    names, m, n = [body["name"] for body in bodies], len(of["passive"]), len(log["bounds"])
    numbers = {key: value for key, value in of.items() if key != "sha256"}
    text = json.dumps(numbers, sort_keys=True, separators=(",", ":"))
    method, _, damping = log["control"].partition(":")
    rules = {
        f"format: must be {FORMAT!r}": log["format"] == FORMAT,
        "machine.sha256: is not that of the machine's numbers": of["sha256"]
        == hashlib.sha256(text.encode()).hexdigest(),
        "machine.bodies: each needs a name of its own, and a parent before it": len({*names}) == len(names)
        and all(body["parent"] in (None, *names[:k]) for k, body in enumerate(bodies)),
        "machine.end_point.body: must be one of the bodies": of["end_point"]["body"] in names,
        "machine.passive, actuated: must be bodies with such joints, once each": all(
            len({*of[kind]}) == len(of[kind]) and {*of[kind]} <= {b["name"] for b in bodies if b["passive"] == passive}
            for kind, passive in (("passive", True), ("actuated", False))
        )
        and len(of["actuated"]) == sum(not body["passive"] for body in bodies),
        "machine.stiffness: must be a symmetric matrix of the passive joints": m > 0
        and [len(row) for row in of["stiffness"]] == [m] * m
        and of["stiffness"] == transposed(of["stiffness"]),
        "target: needs a number a row": len(log["target"]) == len(of["end_point"]["rows"]),
        "control: must be inverse, transpose or damped:LAMBDA": log["control"] in ("inverse", "transpose")
        or (method == "damped" and bool(re.fullmatch(r"[0-9.e+-]{1,30}", damping)) and _positive(damping)),
        "weights: need a row for each of kept and one more, with a number a mode": [len(row) for row in log["weights"]]
        == [m] * (len(log["kept"]) + 1),
        "margin: must be from 0 to π/2 rad": 0 <= log["margin"] <= math.pi / 2,
        "bounds: must be from low to high, the first finite": n > 0
        and None not in log["bounds"][0]
        and all(None in ends or ends[0] <= ends[1] for ends in log["bounds"]),
        "configuration: needs as many numbers as bounds": len(log["configuration"]) == n,
        "travel: needs costs from 0 on, scales above 0, one for each": travel is None
        or (
            [len(travel[key]) for key in ("cost", "now", "scale")] == [len(log["weights"]), n, n]
            and min(travel["cost"]) >= 0
            and min(travel["scale"]) > 0
        ),
        "gap: must be at least 0": log["gap"] >= 0,
        "machine: masses, payload and armatures must be at least 0": min(
            [of["payload"], *(body[key] for body in bodies for key in ("mass", "armature"))]
        )
        >= 0,
        "machine.bodies: joints must be hinges or slides": all(body["kind"] in ("hinge", "slide") for body in bodies),
        "cells: must be of elbow -1 or 1, left out for a known reason": all(
            cell[0] in (-1, 1) and cell[3] in REASONS for cell in log["cells"]
        ),
    }
    return [sentence for sentence, holds_ in rules.items() if not holds_] + [
        f"machine.bodies[{k}]: its {what}"
        for k, body in enumerate(bodies)
        for what, good in (
            ("axis must be of length 1", abs(math.hypot(*body["axis"]) - 1) <= ROUNDING),
            ("rotation must be one", _turns(body["rotation"])),
            ("inertia must be that of a body", _inertia(body["inertia"])),
        )
        if not good
    ]


def _positive(text: str) -> bool:
    try:
        return 0 < float(text) <= MOST
    except ValueError:
        return False


def _turns(rows: list[list[float]]) -> bool:
    """Whether a matrix is a rotation to rounding."""
    square = [[sum(a * b for a, b in zip(x, y, strict=True)) for y in rows] for x in rows]
    right = dot(cross(rows[0], rows[1]), rows[2])
    return abs(right - 1) <= ROUNDING and all(
        abs(square[i][j] - (i == j)) <= ROUNDING for i in range(3) for j in range(3)
    )


def _inertia(of: list[float]) -> bool:
    """Whether a matrix has no negative eigenvalue, to rounding."""
    xx, yy, zz, xy, xz, yz = of
    more = ROUNDING * max(map(abs, of))
    a, b, c = xx + more, yy + more, zz + more
    first, second = a * b - xy * xy, a * b * c + 2 * xy * xz * yz - a * yz * yz - b * xz * xz - c * xy * xy
    return not more or (a > 0 and first > 0 and second > 0)


class LoggedMachine:
    """The machine of a log, standing on an anchor that is moved along x."""

    def __init__(self, log: dict[str, Any]) -> None:
        of = log["machine"]
        self.log, self.bodies, self.tip, self.control = log, of["bodies"], of["end_point"], log["control"]
        self.index = {body["name"]: k for k, body in enumerate(self.bodies)}
        self.parent = [self.index.get(body["parent"]) for body in self.bodies]
        self.passive, self.actuated = ([self.index[name] for name in of[kind]] for kind in ("passive", "actuated"))
        self.rows = ["xyz".index(row) for row in self.tip["rows"]]
        self.payload, self.target = number(of["payload"]), [arb(x) for x in log["target"]]
        self.lower = inverse_of_lower([[arb(x) for x in row] for row in of["stiffness"]])
        self.ways: list[set[int]] = []
        for k, parent in enumerate(self.parent):
            self.ways.append({k} if parent is None else self.ways[parent] | {k})
        _, origins, axes, tip = self.placed({k: (arb(1), 0) for k in self.actuated})
        first, second, end = (
            [point[row] for row in self.rows] for point in (*(origins[k] for k in self.actuated), tip)
        )
        self.start = first
        self.one, self.two = (
            [minus(x, y) for x, y in zip(*ends, strict=True)] for ends in ((second, first), (end, second))
        )
        normal = cross(*([arb(1) if k == row else 0 for k in range(3)] for row in self.rows))
        along = [dot(normal, axes[k]) for k in self.actuated]
        self.senses = [1 if each > 0 else -1 for each in along]
        chain = [*self.actuated, self.index[self.tip["body"]]]
        inside = all(above in self.ways[below] for above, below in pairwise(chain)) and chain[0] != chain[1]
        hinges = all(self.bodies[k]["kind"] == "hinge" for k in self.actuated)
        if not (inside and hinges and all(abs(span(each)) > 1 - ROUNDING for each in along)):
            raise Refused("its actuated joints are no two hinges across the plane of the task")
        self.lengths = [root(dot(v, v)) for v in (self.one, self.two)]

    def placed(
        self, turned: dict[int, tuple[BallNumber, BallNumber]]
    ) -> tuple[list[BallMatrix], BallMatrix, BallMatrix, BallVector]:
        """Rotations, origins and joint axes of all bodies, and the end-point, the anchor at x = 0."""
        rotations, origins, axes = list[BallMatrix](), list[BallVector](), list[BallVector]()
        for k, body in enumerate(self.bodies):
            parent = self.parent[k]
            around = identity(3) if parent is None else rotations[parent]
            origin = [0, 0, 0] if parent is None else origins[parent]
            origin = [plus(o, dot(row, numbers(body["position"]))) for o, row in zip(origin, around, strict=True)]
            own = product(around, [numbers(row) for row in body["rotation"]])
            axis = [dot(row, numbers(body["axis"])) for row in own]
            rest = number(body["rest"] if body["passive"] else 0.0)
            if body["kind"] == "slide":
                origin = [plus(o, times(a, rest)) for o, a in zip(origin, axis, strict=True)]
            else:
                still = (arb(1), 0) if zero(rest) else (rest.cos(), rest.sin())
                own = product(own, rotation(body["axis"], *turned.get(k, still)))
            rotations.append(own)
            origins.append(origin)
            axes.append(axis)
        last = self.index[self.tip["body"]]
        reach = numbers(self.tip["position"])
        tip = [plus(o, dot(row, reach)) for o, row in zip(origins[last], rotations[last], strict=True)]
        return rotations, origins, axes, tip

    def elbow_cosine(self, x: BallNumber) -> tuple[BallNumber, BallVector]:
        """Cosine of the angle between the arm's segments, and the way from the first joint to the target."""
        away = [minus(t, s) for t, s in zip(self.target, self.start, strict=True)]
        away[0] = minus(away[0], x)
        one, two = self.lengths
        return (dot(away, away) - one * one - two * two) * inverted(2 * one * two), away

    def reaching(self, x: BallNumber, elbow: int) -> list[tuple[BallNumber, BallNumber]]:
        """(cos, sin) of both joints that put the end-point on the target."""
        cosine, away = self.elbow_cosine(x)
        sine = elbow * root(1 - cosine * cosine)
        # In complex numbers: the second turn is e^{iθ} conj(w) / |w|, w = conj(u) v, and the first d / (u + turn v).
        (u0, u1), (v0, v1) = self.one, self.two
        w0, w1 = plus(times(u0, v0), times(u1, v1)), minus(times(u0, v1), times(u1, v0))
        size = inverted(self.lengths[0] * self.lengths[1])
        c, s = (
            times(plus(times(cosine, w0), times(sine, w1)), size),
            times(minus(times(sine, w0), times(cosine, w1)), size),
        )
        a0 = plus(u0, minus(times(c, v0), times(s, v1)))
        a1 = plus(u1, plus(times(s, v0), times(c, v1)))
        over = inverted(a0 * a0 + a1 * a1)
        first = times(away[0] * a0 + away[1] * a1, over), times(away[1] * a0 - away[0] * a1, over)
        return [(cos, sense * sin) for (cos, sin), sense in zip((first, (c, s)), self.senses, strict=True)]

    def terms(self, x: BallNumber, elbow: int) -> Terms:
        """C, A L⁻ᵀ and B L⁻ᵀ."""
        turned = dict(zip(self.actuated, self.reaching(x, elbow), strict=True))
        rotations, origins, axes, tip = self.placed(turned)
        order = [*self.passive, *self.actuated]

        def moved(body: int, point: BallVector) -> tuple[BallMatrix, BallMatrix]:
            """What each coordinate does to a point of a body, and to its direction."""
            linear, angular = list[BallVector](), list[BallVector]()
            for k in order:
                slide, on = self.bodies[k]["kind"] == "slide", k in self.ways[body]
                away = [minus(a, b) for a, b in zip(point, origins[k], strict=True)]
                linear.append([0, 0, 0] if not on else axes[k] if slide else cross(axes[k], away))
                angular.append([0, 0, 0] if slide or not on else axes[k])
            return linear, angular

        n, m = len(order), len(self.passive)
        mass: BallMatrix = [[0] * n for _ in range(n)]
        for k, body in enumerate(self.bodies):
            xx, yy, zz, xy, xz, yz = numbers(body["inertia"])
            inertia = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
            arm = [dot(row, numbers(body["com"])) for row in rotations[k]]
            linear, angular = moved(k, [plus(o, c) for o, c in zip(origins[k], arm, strict=True)])
            own = product(angular, rotations[k])
            heavy = [[times(number(body["mass"]), a) for a in row] for row in linear]
            mass = added(
                mass, added(product(heavy, transposed(linear)), product(product(own, inertia), transposed(own)))
            )
            if k in order:
                at = order.index(k)
                mass[at][at] = plus(mass[at][at], number(body["armature"]))
        of_tip = moved(self.index[self.tip["body"]], tip)[0]
        mass = added(mass, product([[times(self.payload, a) for a in row] for row in of_tip], transposed(of_tip)))
        inner, coupling = [row[m:] for row in mass[m:]], [row[:m] for row in mass[m:]]
        follow = [[times(-1, a) for a in row] for row in solved(inner, coupling)]
        reduced = added([row[:m] for row in mass[:m]], product(transposed(coupling), follow))
        jacobian = transposed([[column[row] for row in self.rows] for column in of_tip])
        jv = [row[m:] for row in jacobian]
        a = added([row[:m] for row in jacobian], product(jv, follow))
        b = product(task_map(jv, self.control), follow)
        back = transposed(self.lower)
        return product(product(self.lower, reduced), back), product(a, back), product(b, back)


def task_map(jv: BallMatrix, control: str) -> BallMatrix:
    """Jv, Jv⁻ᵀ, or (Jv Jvᵀ + λ² I)⁻¹ Jv."""
    if control == "transpose":
        return jv
    if control.startswith("damped"):
        square = arb(float(control.partition(":")[2])) ** 2
        gram = added(product(jv, transposed(jv)), [[times(square, x) for x in row] for row in identity(len(jv))])
        return solved(gram, jv)
    (p, q), (r, s) = jv
    over = inverted(minus(times(p, s), times(q, r)))
    return [[times(s, over), times(times(-1, r), over)], [times(times(-1, q), over), times(p, over)]]


def shifted(c: BallMatrix, z: BallNumber, order: list[int]) -> BallMatrix:
    """Rows and columns of z I − C, in an order."""
    return [[minus(z if j == k else 0, c[j][k]) for k in order] for j in order]


def eigenvectors(c: BallMatrix, z: BallNumber, i: int) -> tuple[BallVector, BallVector]:
    """V and u with C v = z v, Cᵀ u = z u and v_i = u_i = 1."""
    others = [j for j in range(len(c)) if j != i]
    block = shifted(c, z, others)
    right = solved(block, [[c[j][i]] for j in others])
    left = solved(transposed(block), [[c[i][j]] for j in others])
    v, u = ([x for (x,) in each] for each in (right, left))
    return [*v[:i], arb(1), *v[i:]], [*u[:i], arb(1), *u[i:]]


def eigenvalues(c: BallMatrix, h: arb) -> BallVector:
    """All eigenvalues of C, whose diagonal is near them: polynomials, and how far off they are at most.

    With z_i the polynomials and W_i = p(z_i) / Π (z_i − z_j), a root of p lies within n |W_i| of z_i, one in each of
    these discs where they are apart (Smith, Journal of the ACM 17(1), 1970).
    """
    n = len(c)
    found: BallVector = [BallSeries(arb_poly([middle_of(c[i][i])]), h) for i in range(n)]

    def corrections() -> BallVector:
        steps: BallVector = []
        for i, value in enumerate(found):
            # The i-th last: its pivot is what vanishes.
            *pivots, rest = pivots_of(shifted(c, value, [*(j for j in range(n) if j != i), i]))
            others = (value - other for j, other in enumerate(found) if j != i)
            for pivot, away in zip(pivots, others, strict=True):
                rest = times(rest, times(pivot, inverted(away)))
            steps.append(rest)
        return steps

    for _ in range(DEGREE.bit_length()):
        better = [value - step for value, step in zip(found, corrections(), strict=True)]
        found = [BallSeries(arb_poly([x.mid() for x in value.polynomial.coeffs()]), h) for value in better]
    off = [arb(0, (n * span(step).abs_upper()).upper()) for step in corrections()]
    for i in range(n):
        for j in range(i):
            if not abs(span(found[i] - found[j])) > off[i].abs_upper() + off[j].abs_upper():
                raise Unknown
    return [value + wrong for value, wrong in zip(found, off, strict=True)]


def middle_of(x: BallNumber) -> arb:
    """What a number is in the middle of the cell, a double and more."""
    return (x.polynomial[0] if isinstance(x, BallSeries) else arb(x)).mid()


def shares(terms: Terms, h: arb, weights: list[float]) -> Iterator[tuple[arb, BallVector]]:
    """Of every mode with a weight, by ascending frequency: α_i, and |a|², |b|², a·b, 1 / μ."""
    (c, a, b), n = terms, len(terms[0])
    # In axes in which C is nearly diagonal, its eigenvalues are nearly its entries; largest first.
    values, vectors = arb_mat([[middle_of(x) for x in row] for row in c]).eig(right=True, algorithm="approx")
    order = sorted(range(n), key=lambda j: -float(values[j].real.mid()))
    axes = arb_mat([[vectors[i, j].real.mid() for j in order] for i in range(n)])
    x, back = ([[each[i, j] for j in range(n)] for i in range(n)] for each in (axes, axes.inv()))
    c = product(product(back, c), x)
    (a_right, b_right), (a_left, b_left) = (
        [product(each, axes_of) for each in (a, b)] for axes_of in (x, transposed(back))
    )
    for i, mu in enumerate(eigenvalues(c, h)):
        if not weights[i]:
            continue
        v, u = eigenvectors(c, mu, i)
        products = [
            total(times(dot(p, v), dot(q, u)) for p, q in zip(right, left, strict=True))
            for right, left in ((a_right, a_left), (b_right, b_left), (a_right, b_left))
        ]
        yield arb(weights[i]), [*products, inverted(dot(u, v) * mu)]


def size(aa: BallNumber, bb: BallNumber, share: BallNumber) -> arb:
    """|a||b| / μ at most."""
    return (span(aa).abs_upper() * span(bb).abs_upper()).sqrt() * span(share).abs_upper()


def objective(terms: Terms, h: arb, weights: list[float]) -> BallNumber:
    """Σ α_i w_i."""
    value: BallNumber = arb(0)
    for weight, (aa, bb, ab, share) in shares(terms, h, weights):
        try:
            value = value + weight * (ab - root(aa * bb)) * share
        except Unknown:
            # At a kink, |a| or |b| = 0: w_i lies between −2|a||b| and 0.
            value = value + weight * (arb(-1) + arb(0, 1)) * size(aa, bb, share)
    return value


def within(low: float, high: float) -> tuple[arb, arb]:
    """A cell's middle, and what is to be added to it."""
    middle = arb((low + high) / 2)
    return middle, arb(0, max((arb(high) - middle).abs_upper(), (arb(low) - middle).abs_upper()))


def upper_bound(machine: LoggedMachine, low: float, high: float, elbow: int, j: int) -> float:
    """An upper bound on the j-th V in a cell, less the cost of travel."""
    middle, h = within(low, high)
    x = BallSeries(arb_poly([middle, 1]), h)
    try:
        value = objective(machine.terms(x, elbow), h, machine.log["weights"][j])
        value = value - travel_cost(machine, [x, *angles(machine, x, elbow)], j) if machine.log["travel"] else value
    except UNCOMPUTED:
        return math.inf
    bound = float(span(value).upper())
    return math.inf if math.isnan(bound) else bound


def angles(machine: LoggedMachine, x: BallNumber, elbow: int) -> BallVector:
    """Both joint angles over a cell, each on one turn."""
    found: BallVector = []
    for c, s in machine.reaching(x, elbow):
        c0, s0 = (each.polynomial[0].mid() if isinstance(each, BallSeries) else each for each in (c, s))
        tangent = (s * c0 - c * s0) * inverted(c * c0 + s * s0)
        if not span(c * c0 + s * s0) > 0:
            raise Unknown
        # atan t = t − t³ / (3 (1 + τ²)³) · …: |atan t − t| ≤ |t|³ / 3.
        found.append(tangent + arb.atan2(s0, c0) + arb(0, (span(tangent).abs_upper() ** 3 / 3).upper()))
    return found


def turns_of(angle: BallNumber) -> int:
    """The whole turns next to an angle."""
    return round(float(span(angle).mid()) / math.tau)


def travel_cost(machine: LoggedMachine, z: BallVector, j: int, *, turned: bool = True) -> BallNumber:
    """What the way from the present configuration costs; `turned`: each joint on its nearest turn, from below."""
    travel = machine.log["travel"]
    if travel is None:
        return 0
    cost: BallNumber = 0
    for k, (value, now, scale) in enumerate(zip(z, travel["now"], travel["scale"], strict=True)):
        away = value - arb(now)
        if k and turned:
            away = away - 2 * arb.pi() * turns_of(away)
            if not abs(span(away)) < arb.pi():
                least, other = span(away).abs_lower(), (2 * arb.pi() - span(away).abs_upper()).lower()
                away = max(min(least, other), arb(0))
        cost = plus(cost, away * away * (1 / (arb(scale) * arb(scale))))
    return cost * arb(travel["cost"][j])


def left_out(machine: LoggedMachine, low: float, high: float, elbow: int, why: str) -> bool:
    """Whether no placement of the cell allows the target to be reached inside margin and limits."""
    (middle, h), log = within(low, high), machine.log
    if why == "margin":
        return bool(abs(span(machine.elbow_cosine(middle + h)[0])) > arb(log["margin"]).cos())
    if why == "limit":
        try:
            found = angles(machine, BallSeries(arb_poly([middle, 1]), h), elbow)
        except Unknown:
            return False
        turn = 2 * arb.pi()
        # How many whole turns bring an angle into its limits, at least and at most.
        return any(
            bool(((high - angle) / turn).upper().floor() < ((low - angle) / turn).lower().ceil())
            for angle, (low, high) in zip(map(span, found), log["bounds"][1:], strict=True)
            if low is not None and high is not None
        )
    if why == "kept":
        return any(upper_bound(machine, low, high, elbow, j) < least for j, least in enumerate(log["kept"]))
    return False


def holds(machine: LoggedMachine, cell: tuple[float, float, int, str], bound: float) -> bool:
    """Whether a cell is what the log says, halved where that does not show at once."""
    low, high, elbow, why = cell
    left = [(low, high)]
    for _ in range(PARTS):
        if not left:
            return True
        low, high = left.pop()
        if any(left_out(machine, low, high, elbow, each) for each in ("margin", why)):
            continue
        if not why and upper_bound(machine, low, high, elbow, len(machine.log["kept"])) <= bound:
            continue
        middle = (low + high) / 2
        if not low < middle < high:
            return False
        left += [(low, middle), (middle, high)]
    return not left


def uncovered(log: dict[str, Any]) -> list[str]:
    """Sentences about where the cells do not cover the placements exactly once."""
    lower, upper = log["bounds"][0]
    faults: list[str] = []
    for elbow in (-1, 1):
        spans = [(low, high) for side, low, high, _ in log["cells"] if side == elbow]
        ends, starts = [lower, *(high for _, high in spans)], [*(low for low, _ in spans), upper]
        faults += [
            f"elbow {elbow}: its cells do not go on from {end} m but from {start} m"
            for end, start in zip(ends, starts, strict=True)
            if end != start
        ]
        faults += [f"elbow {elbow}: the cell from {low} to {high} m is none" for low, high in spans if not low <= high]
        if not spans:
            faults.append(f"elbow {elbow}: has no cells")
    return faults


def at(x: float) -> BallSeries:
    """A placement as a polynomial."""
    return BallSeries(arb_poly([arb(x)]), arb(0))


def typical(machine: LoggedMachine, places: list[tuple[float, int]], weights: list[float]) -> float:
    """The scale of an objective: see the head of the file."""
    found: list[float] = []
    for x, elbow in places:
        try:
            terms = machine.terms(at(x), elbow)
            found.append(
                float(sum(abs(w) * size(a, b, share) for w, (a, b, _, share) in shares(terms, arb(0), weights)))
            )
        except UNCOMPUTED:
            continue
    return sorted(found)[len(found) // 2] if found else math.nan


def standing(machine: LoggedMachine) -> tuple[int, BallVector]:
    """The elbow of the log's configuration, and the one that reaches the target exactly next to it."""
    x, *posture = machine.log["configuration"]
    for elbow in (-1, 1):
        try:
            found = angles(machine, at(x), elbow)
        except UNCOMPUTED:
            continue
        turned = [angle - 2 * arb.pi() * turns_of(angle - arb(z)) for angle, z in zip(found, posture, strict=True)]
        if all(abs(span(angle) - z) < NEAR for angle, z in zip(turned, posture, strict=True)):
            return elbow, [at(x), *turned]
    raise Refused("the configuration does not reach the target")


def check(log: dict[str, Any]) -> Answer:
    """What holds of a log. `Refused`: it is no log, or of a machine that this program does not compute."""
    faults = misfits(log, SHAPE, "log") or unfit(log)
    if faults:
        raise Refused("; ".join(faults[:NAMED]) + (f"; and {len(faults) - NAMED} more" if faults[NAMED:] else ""))
    # The library has one precision for all that a process does with it.
    before = ctx.prec, ctx.cap
    ctx.prec = BITS
    try:
        return _answer(log)
    except (Refused, *UNCOMPUTED) as error:
        return Answer([str(error) if isinstance(error, Refused) else "its numbers cannot be computed with"])
    finally:
        ctx.prec, ctx.cap = before


def _answer(log: dict[str, Any]) -> Answer:
    of, last = log["machine"], len(log["kept"])
    rows = of["end_point"]["rows"]
    plane = len(rows) == len({*rows} & {*"xyz"}) == 2 and of["placement"] == rows[:1]
    if not (plane and len(log["bounds"]) == 3 and len(of["actuated"]) == 2):
        raise Refused("the machine is of a kind that this program does not compute: see the head of the file")
    machine = LoggedMachine(log)
    elbow, z = standing(machine)
    x, (lower, upper) = log["configuration"][0], log["bounds"][0]
    straight, middles = (
        arb(log["margin"]).cos(),
        [lower + (upper - lower) * ((k + 0.5) / SAMPLES) for k in range(SAMPLES)],
    )
    inside = [place for place in middles if abs(span(machine.elbow_cosine(at(place))[0])) < straight]
    places = [(x, elbow), *((place, side) for place in inside for side in (-1, 1))]
    scales = [typical(machine, places, weights) for weights in log["weights"]]
    terms = machine.terms(at(x), elbow)
    values = [
        span(objective(terms, arb(0), weights) - travel_cost(machine, z, j, turned=False))
        for j, weights in enumerate(log["weights"])
    ]
    rounding, value, faults = ROUNDING * scales[last], values[last], list[str]()
    if not abs(span(machine.elbow_cosine(at(x))[0])) < straight + NEAR:
        faults.append("the configuration is nearer to a singular posture than the margin")
    faults += [
        f"bounds[{k}]: the configuration is outside them"
        for k, (each, (low, high)) in enumerate(zip(map(span, z), log["bounds"], strict=True))
        if not ((low is None or each > low - NEAR) and (high is None or each < high + NEAR))
    ]
    faults += [
        f"kept[{j}]: the configuration has only {float(values[j]):.9g}"
        for j, least in enumerate(log["kept"])
        if not values[j] >= least - ROUNDING * scales[j]
    ]
    if not -rounding <= value - log["value"] <= NEAR * scales[last]:
        faults.append(f"value: the configuration has {float(value):.9g}")
    if not -rounding <= log["upper"] - log["value"] <= log["gap"] + rounding:
        faults.append("upper: is not between value and value + gap")
    if not log["gap"] <= scales[last]:
        faults.append(f"gap: is more than the scale, {scales[last]:.3g}")
    attained = all(weight >= 0 for weight in log["weights"][last]) and log["upper"] == 0 and bool(value > -rounding)
    if log["cells"] or not attained:
        faults += uncovered(log)
    assumed = sum(why == "constraint" for *_, why in log["cells"])
    if assumed:
        faults.append(f"{assumed} cells are left out for constraints that the log does not carry")
    # What costs little first, and no cell after one that fails.
    cells: list[Any] = [] if faults else log["cells"]
    for side, low, high, why in cells:
        if not holds(machine, (low, high, int(side), why), log["upper"] + rounding if not why else math.inf):
            faults.append(f"[{low}, {high}], elbow {side:g}: not shown to be {why or 'below the bound'}")
            break
    return Answer(faults, float(value), scales[last])


def statement(log: dict[str, Any], answer: Answer) -> str:
    """What was shown of a log, or what was not."""
    if answer.faults:
        return "\n".join(["not proven:", *(f"  {fault}" for fault in answer.faults)])
    machine, share = log["machine"], 100 * max(log["upper"] - answer.value, 0) / (answer.scale or 1)
    rows, ends = [f"{weights}" for weights in log["weights"]], log["bounds"][0]
    kept = [f", at least {least:.9g} of the sum with {row}" for row, least in zip(rows, log["kept"], strict=False)]
    return "\n".join([
        f"proven by {len(log['cells'])} cells: no configuration has more than {log['upper']:.9g}, {share:.2g} % of the "
        f"scale above {log['value']:.9g}",
        f"  of Σ αi wi with α = {rows[-1]}{', less the cost of travel' if log['travel'] else ''}{''.join(kept)}",
        f"  target {log['target']} m, x from {ends[0]} to {ends[1]} m, control {log['control']}, "
        f"singularity margin {math.degrees(log['margin']):.6g}°",
        f"  machine {machine['name']!r}, SHA-256 of its numbers {machine['sha256']}",
    ])  # fmt: skip


def main(arguments: list[str]) -> int:
    """Exit code 0 if all is as the log says, 3 if not, 2 if there is no log."""
    if len(arguments) != 1:
        print("usage: python -m flexopt.selection.certificate.check LOG.json", file=sys.stderr)
        return 2
    try:
        log = read(arguments[0])
        answer = check(log)
    except Refused as error:
        print(f"{arguments[0]}: no log of a certificate: {error}", file=sys.stderr)
        return 2
    print(statement(log, answer))
    return 3 if answer.faults else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
