"""Check the log of a certificate.

Run: python -m flexopt.selection.certificate.check LOG.json (needs the extra `certificates`)

A program of its own, which shares no line with what wrote the log: it imports nothing of flexopt but `balls`, which
nothing else does, takes the machine's numbers from the log, and computes in the ball arithmetic of Arb (python-flint).
It needs no start and no solver; it checks that the cells cover every placement with either elbow, that cells which are
left out hold no allowed configuration, and that V stays below the certificate's bound in all others.

How: joint angles enter by sine and cosine alone, from the triangle of the two arm segments. Positions, Jacobians and
M = Σ m Jᵀ J + Ωᵀ I Ω are summed body by body; K_p = L Lᵀ and C = L⁻¹ (M_pp − M_pa M_aa⁻¹ M_ap) L⁻ᵀ; its eigenvalues are
roots of its characteristic polynomial, found and enclosed by Weierstrass' corrections, and with the eigenprojectors P_i
w_i = (tr A P_i Bᵀ − sqrt(tr A P_i Aᵀ · tr B P_i Bᵀ)) / μ_i. All are polynomials in the placement, whose coefficients
are balls.
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

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

# Bits of a ball; into how many parts a cell is halved at most; what rounding in doubles may have done to the log's
# numbers, as a share of the scale.
FORMAT = "flexopt certificate 1"
BITS, PARTS, ROUNDING = 128, 400, 1e-9
Terms = tuple[BallMatrix, BallMatrix, BallMatrix]


class LoggedMachine:
    """The machine of a log, standing on an anchor that is moved along x."""

    def __init__(self, log: dict[str, Any]) -> None:
        of = log["machine"]
        self.bodies, self.tip, self.control = of["bodies"], of["end_point"], log["control"]
        self.index = {body["name"]: k for k, body in enumerate(self.bodies)}
        self.parent = [self.index.get(body["parent"]) for body in self.bodies]
        self.passive, self.actuated = ([self.index[name] for name in of[kind]] for kind in ("passive", "actuated"))
        self.rows = ["xyz".index(row) for row in self.tip["rows"]]
        self.payload, self.target = number(of["payload"]), [arb(x) for x in log["target"]]
        self.lower = inverse_of_lower([[arb(x) for x in row] for row in of["stiffness"]])
        _, origins, axes, tip = self.placed({k: (arb(1), 0) for k in self.actuated})
        first, second, end = (
            [point[row] for row in self.rows] for point in (*(origins[k] for k in self.actuated), tip)
        )
        self.start = first
        self.one, self.two = (
            [minus(x, y) for x, y in zip(*ends, strict=True)] for ends in ((second, first), (end, second))
        )
        normal = cross(*([arb(1) if k == row else 0 for k in range(3)] for row in self.rows))
        self.senses = [1 if dot(normal, axes[k]) > 0 else -1 for k in self.actuated]
        self.lengths = [root(dot(v, v)) for v in (self.one, self.two)]

    def placed(
        self, turned: dict[int, tuple[BallNumber, BallNumber]]
    ) -> tuple[list[BallMatrix], BallMatrix, BallMatrix, BallVector]:
        """Rotations, origins and joint axes of all bodies, and the end-point, the anchor at x = 0."""
        rotations, origins, axes = list[BallMatrix](), list[BallVector](), list[BallVector]()
        for k, body in enumerate(self.bodies):
            joint, parent = body["joint"], self.parent[k]
            around = identity(3) if parent is None else rotations[parent]
            origin = [0, 0, 0] if parent is None else origins[parent]
            origin = [plus(o, dot(row, numbers(body["position"]))) for o, row in zip(origin, around, strict=True)]
            own = product(around, [numbers(row) for row in body["rotation"]])
            axis = [dot(row, numbers(joint["axis"])) for row in own]
            rest = number(joint["rest"] if joint["passive"] else 0.0)
            if joint["kind"] == "slide":
                origin = [plus(o, times(a, rest)) for o, a in zip(origin, axis, strict=True)]
            else:
                still = (arb(1), 0) if zero(rest) else (rest.cos(), rest.sin())
                own = product(own, rotation(joint["axis"], *turned.get(k, still)))
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
        ways: list[set[int]] = []
        for k, parent in enumerate(self.parent):
            ways.append({k} if parent is None else ways[parent] | {k})

        def moved(body: int, point: BallVector) -> tuple[BallMatrix, BallMatrix]:
            """What each coordinate does to a point of a body, and to its direction."""
            linear, angular = list[BallVector](), list[BallVector]()
            for k in order:
                slide, on = self.bodies[k]["joint"]["kind"] == "slide", k in ways[body]
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
                mass[at][at] = plus(mass[at][at], number(body["joint"]["armature"]))
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


def objective(terms: Terms, h: arb, weights: list[float]) -> BallNumber:
    """Σ α_i w_i."""
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
    value: BallNumber = arb(0)
    for i, mu in enumerate(eigenvalues(c, h)):
        if not weights[i]:
            continue
        v, u = eigenvectors(c, mu, i)
        aa, bb, ab = (
            total(times(dot(p, v), dot(q, u)) for p, q in zip(right, left, strict=True))
            for right, left in ((a_right, a_left), (b_right, b_left), (a_right, b_left))
        )
        share = inverted(dot(u, v) * mu)
        try:
            value = value + arb(weights[i]) * (ab - root(aa * bb)) * share
        except Unknown:
            # At a kink, |a| or |b| = 0: w_i lies between −2|a||b| and 0.
            size = (span(aa).abs_upper() * span(bb).abs_upper()).sqrt() * span(share).abs_upper()
            value = value + arb(weights[i]) * (arb(-1) + arb(0, 1)) * size
    return value


def within(low: float, high: float) -> tuple[arb, arb]:
    """A cell's middle, and what is to be added to it."""
    middle = arb((low + high) / 2)
    return middle, arb(0, max((arb(high) - middle).abs_upper(), (arb(low) - middle).abs_upper()))


def upper_bound(
    machine: LoggedMachine, log: dict[str, Any], low: float, high: float, elbow: int, weights: list[float]
) -> float:
    """An upper bound on V in a cell, less the cost of travel."""
    middle, h = within(low, high)
    x = BallSeries(arb_poly([middle, 1]), h)
    try:
        value = objective(machine.terms(x, elbow), h, weights) - travel_cost(machine, log, x, elbow)
    except (Unknown, ZeroDivisionError):
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


def travel_cost(machine: LoggedMachine, log: dict[str, Any], x: BallNumber, elbow: int) -> BallNumber:
    """What the way from the present configuration costs, each joint on its nearest turn; from below, where unsure."""
    travel = log["travel"]
    if travel is None:
        return 0
    cost: BallNumber = 0
    for k, (value, now, scale) in enumerate(
        zip([x, *angles(machine, x, elbow)], travel["now"], travel["scale"], strict=True)
    ):
        away = value - arb(now)
        if k and machine.bodies[machine.actuated[k - 1]]["joint"]["kind"] == "hinge":
            turns = round(float(span(away).mid()) / math.tau)
            away = away - 2 * arb.pi() * turns
            if not abs(span(away)) < arb.pi():
                away = arb((arb.pi() - (span(away).abs_upper() - arb.pi())).lower())
        cost = plus(cost, away * away * (1 / (arb(scale) * arb(scale))))
    return cost * arb(travel["cost"])


def left_out(machine: LoggedMachine, log: dict[str, Any], low: float, high: float, elbow: int, why: str) -> bool:
    """Whether no placement of the cell allows the target to be reached inside margin and limits."""
    middle, h = within(low, high)
    if why == "margin":
        return bool(abs(span(machine.elbow_cosine(middle + h)[0])) > arb(log["margin"]).cos())
    if why == "limit":
        try:
            found = angles(machine, BallSeries(arb_poly([middle, 1]), h), elbow)
        except Unknown:
            return False
        for angle, (lower, upper) in zip(map(span, found), log["bounds"][1:], strict=True):
            if lower is None or upper is None:
                continue
            shifted = [angle + 2 * arb.pi() * turn for turn in range(-4, 5)]
            if all(bool(each < lower) or bool(each > upper) for each in shifted):
                return True
        return False
    if why == "kept":
        return any(
            upper_bound(machine, log, low, high, elbow, weights) < least
            for weights, least in zip(log["weights"], log["kept"], strict=False)
        )
    return False


def holds(machine: LoggedMachine, log: dict[str, Any], cell: tuple[float, float, int, str], bound: float) -> bool:
    """Whether a cell is what the log says, halved where that does not show at once."""
    low, high, elbow, why = cell
    left = [(low, high)]
    for _ in range(PARTS):
        if not left:
            return True
        low, high = left.pop()
        if any(left_out(machine, log, low, high, elbow, each) for each in ("margin", why)):
            continue
        if not why and upper_bound(machine, log, low, high, elbow, log["weights"][-1]) <= bound:
            continue
        middle = (low + high) / 2
        if not low < middle < high:
            return False
        left += [(low, middle), (middle, high)]
    return not left


def uncovered(log: dict[str, Any]) -> list[str]:
    """Sentences about what the cells leave out of the placements."""
    lower, upper = log["bounds"][0]
    faults: list[str] = []
    for elbow in (-1, 1):
        spans = sorted((low, high) for side, low, high, *_ in log["cells"] if side == elbow)
        ends = [lower, *(high for _, high in spans)]
        gaps = [(end, low) for end, (low, _) in zip(ends, spans, strict=False) if low > end]
        faults += [f"elbow {elbow}: nothing covers {end} to {low} m" for end, low in gaps]
        if ends[-1] < upper or not spans:
            faults.append(f"elbow {elbow}: nothing covers {ends[-1]} to {upper} m")
    return faults


def check(log: dict[str, Any]) -> tuple[list[str], int]:
    """What is wrong with a log, a sentence each; and how many cells were left out for constraints it does not tell."""
    # The library has one precision for all that a process does with it.
    before = ctx.prec, ctx.cap
    ctx.prec = BITS
    try:
        return _faults(log)
    finally:
        ctx.prec, ctx.cap = before


def _faults(log: dict[str, Any]) -> tuple[list[str], int]:
    if not log["cells"]:
        zero_is_most = all(weight >= 0 for weight in log["weights"][-1])
        reached = -ROUNDING * log["scale"] <= log["value"] <= 0 == log["upper"]
        return ([] if zero_is_most and reached else ["no cells, and 0 is not reached"]), 0
    machine, faults, trusted = LoggedMachine(log), uncovered(log), 0
    tolerance = ROUNDING * log["scale"]
    for elbow, low, high, why, bound in log["cells"]:
        if why == "constraint":
            trusted += 1
            continue
        least = log["upper"] if not why else math.inf
        if not why and (bound is None or bound > least):
            faults.append(f"[{low}, {high}], elbow {elbow:g}: its bound is above that of the certificate")
        elif not holds(machine, log, (low, high, int(elbow), why), least + tolerance):
            faults.append(f"[{low}, {high}], elbow {elbow:g}: not shown to be {why or 'below the bound'}")
    return faults, trusted


def main(arguments: list[str]) -> int:
    """Exit code 0 if all is as the log says, 3 if not, 2 if there is no log."""
    if len(arguments) != 1:
        print("usage: python -m flexopt.selection.certificate.check LOG.json", file=sys.stderr)
        return 2
    try:
        log = json.loads(Path(arguments[0]).read_text(encoding="utf-8"))
        if log["format"] != FORMAT:
            raise ValueError(f"its format is {log['format']!r}, not {FORMAT!r}")
        faults, trusted = check(log)
        share = 100 * (log["upper"] - log["value"]) / log["scale"]
    except (OSError, ValueError, KeyError, TypeError, IndexError) as error:
        print(f"{arguments[0]}: no log of a certificate: {type(error).__name__}: {error}", file=sys.stderr)
        return 2
    for fault in faults:
        print(fault)
    if not faults:
        most = f"no allowed configuration has more than {log['upper']:.9g}"
        print(f"{len(log['cells'])} cells: {most}, {share:.2g} % of the scale above {log['value']:.9g}")
    if trusted:
        print(f"{trusted} cells are left out for constraints that the log does not tell: not checked")
    return 3 if faults else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
