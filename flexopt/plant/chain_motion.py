"""A chain of parallel hinges in a vertical plane: equations of motion in absolute angles, in closed form.

Coordinates u (n_q,): displacements of the base's slides along the task's rows, horizontal and vertical, then the
absolute angle φ_k of every body that can turn, from the ground outwards and counter-clockwise from the first row to the
second; directions are (cos φ_k, sin φ_k). With unit vectors e(φ) = (cos φ, sin φ) and n(φ) = (−sin φ, cos φ) the
position of mass j is (x, y) + Σ_k [c_jk e(φ_k) + d_jk n(φ_k)], and with

    a_k = Σ_j m_j c_jk,   b_k = Σ_j m_j d_jk,   s_kl = Σ_j m_j (c_jk c_jl + d_jk d_jl) + δ_kl I_k,
    t_kl = Σ_j m_j (c_jk d_jl − d_jk c_jl)

the mass matrix has the angular block s_kl cos(φ_k − φ_l) + t_kl sin(φ_k − φ_l) and the columns a_k n(φ_k) − b_k e(φ_k)
beside m I; `chain_constants` has them from what `tree_constants` has moved inwards.

With both translations free, x and y are eliminated on paper: with p_k = a_k n_k − b_k e_k and Δ = φ_k − φ_l,

    p_k·p_l = (a_k a_l + b_k b_l) cos Δ + (a_k b_l − b_k a_l) sin Δ,

so that the angular block keeps its form S_kl cos Δ + T_kl sin Δ with constants S = s − (aa + bb)/m and
T = t − (ab − ba)/m; the velocity terms are (S_kl sin Δ − T_kl cos Δ) φ̇_l², and gravity leaves it. A rigid direction
changes it: where only one translation is free, its share of p_k p_l is subtracted as it stands.
"""

# ruff: noqa: ARG002
# (trees need u where a chain in a plane does not)
from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from flexopt.plant.chain_constants import sum_of, translations_of
from flexopt.plant.motion import CosSin, Directions, Motion


@dataclass(frozen=True)
class ChainMotion(Motion):
    """See `Motion`. Nothing here depends on u but the springs and where the end-point is."""

    KNOWN = frozenset(("a", "b", "length", "lateral", "gravity", "origin_x", "origin_y", "base_cos", "base_sin"))

    @cached_property
    def translations(self) -> list[tuple[str, float]]:
        """Of each slide, whether it goes along "x", the first task row, or "y", the second, and its sign."""
        return translations_of(self.structure)

    @cached_property
    def senses(self) -> list[float]:
        """Of each hinge, 1 where it turns the first task row towards the second, else −1."""
        return [self.structure.sense_across(i) for i in self.structure.hinges]

    @property
    def n_bodies(self) -> int:
        """Those on hinges."""
        return len(self.structure.hinges)

    @property
    def first(self) -> int:
        """The first body that can turn."""
        return int(self.structure.segments[self.structure.hinges[0]].held)

    @cached_property
    def hinged(self) -> list[int]:
        """The bodies that hang on a passive hinge."""
        segments = [self.structure.segments[i] for i in self.structure.hinges]
        return [k for k, segment in enumerate(segments) if segment.passive and not segment.held]

    @cached_property
    def joints(self) -> list[int]:
        """The bodies that an actuated joint carries."""
        return [k for k, i in enumerate(self.structure.hinges) if not self.structure.segments[i].passive]

    @property
    def absorbed(self) -> dict[str, tuple[int, float]]:
        """See `Motion`."""
        at = [direction for direction, _ in self.translations]
        return {name: (at.index("x"), 1.0) for name in self.placement if "x" in at}

    @property
    def to_q(self) -> ca.DM:
        """A (n_q, n_q) of q = A u + `offset`: relative from absolute angles, passive coordinates first."""
        rows = ca.DM.zeros(self.n, self.n)
        for row, (_, sign) in enumerate(self.translations):
            rows[row, row] = sign
        for row, body in enumerate([*self.hinged, *self.joints], self.n_translations):
            rows[row, self._at(body)] = self.senses[body]
            if body > self.first:
                rows[row, self._at(body - 1)] = -self.senses[body]
        return rows

    @property
    def offset(self) -> ca.SX:
        """The constant part of q: the angle of a base that cannot turn."""
        column = ca.SX.zeros(self.n, 1)
        if self.first:
            row = next(i for i, body in enumerate([*self.hinged, *self.joints]) if body == 1)
            column[self.n_translations + row] = -self.senses[1] * self.of("rest0")
        return column

    def with_base(self, directions: Directions) -> Directions:
        """Directions of all bodies from those that can turn."""
        return directions if not self.first else [(self.of("base_cos"), self.of("base_sin")), *directions]

    def known(
        self, u: ca.SX, along: Directions, design: ca.SX, pairs: Directions, model: Motion
    ) -> tuple[ca.SX, Directions]:
        """See `Motion`.

        A body's direction is turned back by the deflections of all hinges before it, products of the pairs at hand,
        and by what a base that cannot turn stands otherwise than the controller's.
        """
        result = Directions()
        back: CosSin | None = None
        if self.first and model is not self:
            back = _difference(along[0], model.with_base(Directions())[0])
        for k, pair in enumerate(along):
            if k in self.hinged:
                own = _difference(pair, along[k - 1]) if k else pair
                cosine, sine = pairs[self.hinged.index(k)]
                own = _difference(own, (cosine, self.senses[k] * sine))
                back = own if back is None else _total(own, back)
            result.append(pair if back is None else _difference(pair, back))
        return u, result

    def passive(self, u: ca.SX, base: ca.SX) -> ca.SX:
        """See `Motion`."""
        linear = [sign * (u[i] - self._anchor(i, base)) for i, (_, sign) in enumerate(self.translations)]
        return ca.vertcat(*linear, *(self.senses[k] * self._relative(u, k) for k in self.hinged))

    def end_point(self, u: ca.SX, along: Directions, base: ca.SX) -> ca.SX:
        """The end-point r (2,), m."""
        point = self._translation(u, base)
        for k, (c, s) in enumerate(along):
            point += self.of(f"length{k}") * ca.vertcat(c, s) + self.of(f"lateral{k}") * ca.vertcat(-s, c)
        return point

    def end_point_rate(self, u: ca.SX, w: ca.SX, along: Directions, base: ca.SX) -> ca.SX:
        """ṙ = J v (2,), m/s."""
        rate = self._along_rows(w)
        for k in range(self.first, self.n_bodies):
            c, s = along[k]
            rate += self.of(f"length{k}") * w[self._at(k)] * ca.vertcat(-s, c)
            rate -= self.of(f"lateral{k}") * w[self._at(k)] * ca.vertcat(c, s)
        return rate

    def rigid_jacobian(self, u: ca.SX, along: Directions, base: ca.SX) -> ca.SX:
        """Jv (2, n): columns of the actuated joints, the arm pointing along `along`."""
        columns: list[ca.SX] = []
        reach = ca.SX.zeros(2, 1)
        for k in reversed(range(self.joints[0], self.n_bodies)):
            c, s = along[k]
            reach += self.of(f"length{k}") * ca.vertcat(-s, c) - self.of(f"lateral{k}") * ca.vertcat(c, s)
            if k in self.joints:
                columns.insert(0, self.senses[k] * ca.SX(reach))
        return ca.horzcat(*columns)

    def holding_torque(self, u: ca.SX, along: Directions) -> ca.SX:
        """g_a (n,), N m: what the actuated joints must give to carry the weight, the arm pointing along `along`."""
        forces = [self._weight(k, along) for k in range(self.n_bodies)]
        return ca.vertcat(*(self.senses[k] * sum_of(forces[k:]) for k in self.joints))

    def potential(self, u: ca.SX, along: Directions) -> ca.SX:
        """Gravity's potential, J."""
        height = self.of("total") * self._translation(u, ca.SX(0))[1] if self.translations else ca.SX(0)
        for k, (c, s) in enumerate(along):
            height += self.of(f"a{k}") * s + self.of(f"b{k}") * c
        return self.of("gravity") * height

    def spring_energy(self, u: ca.SX, base: ca.SX) -> ca.SX:
        """½ (q − q_rest)ᵀ K (q − q_rest), J."""
        total = ca.SX(0)
        for i, (direction, _) in enumerate(self.translations):
            total += self.of(f"stiffness_{direction}") * (u[i] - self._anchor(i, base) - self._rest(i)) ** 2
        for k in self.hinged:
            total += self.of(f"stiffness{k}") * (self._relative(u, k) - self.of(f"rest{k}")) ** 2
        return 0.5 * total

    def momentum(self, u: ca.SX, w: ca.SX, along: Directions) -> ca.SX:
        """M_u w (n_q,), conjugate to u."""
        moving, columns, axes, block = self._block(along)
        turning = {k: w[self._at(k)] for k in moving}
        linear = [
            self.of("total") * w[i] + sum_of(columns[k][axis] * turning[k] for k in moving)
            for i, axis in enumerate(axes)
        ]
        inverse = self.of("inverse_total") if axes else ca.SX(0)
        angular = [
            sum_of(block[max(k, m), min(k, m)] * turning[m] for m in moving)
            + sum_of(columns[k][axis] * linear[i] for i, axis in enumerate(axes)) * inverse
            for k in moving
        ]
        return ca.vertcat(*linear, *angular)

    def rates_of_momentum(self, u: ca.SX, momentum: ca.SX, along: Directions) -> ca.SX:
        """Rates M_u⁻¹ p (n_q,)."""
        moving, columns, axes, block = self._block(along)
        inverse = self.of("inverse_total") if axes else ca.SX(0)
        right = {
            k: momentum[self._at(k)] - sum_of(columns[k][axis] * momentum[i] for i, axis in enumerate(axes)) * inverse
            for k in moving
        }
        turning = _solve_symmetric(block, right, moving, self._pivot(block))
        linear = [
            (momentum[i] - sum_of(columns[k][axis] * turning[k] for k in moving)) * inverse
            for i, axis in enumerate(axes)
        ]
        return ca.vertcat(*linear, *(turning[k] for k in moving))

    def force(
        self, u: ca.SX, w: ca.SX, along: Directions, torque: ca.SX, base: ca.SX, base_rate: ca.SX, *, gravity: bool
    ) -> ca.SX:
        """Generalised forces on u but those of inertia, (n_q,): springs, dampers, torques, weight."""
        linear = [self._base_force(i, u, w, base, base_rate) for i in range(self.n_translations)]
        angular = self._joint_forces(u, w, torque)
        if gravity:
            linear = [
                f - self.of("gravity") * self.of("total") if direction == "y" else f
                for f, (direction, _) in zip(linear, self.translations, strict=True)
            ]
            angular = {k: f - self._weight(k, along) for k, f in angular.items()}
        return ca.vertcat(*linear, *angular.values())

    def acceleration(
        self, u: ca.SX, w: ca.SX, along: Directions, torque: ca.SX, base: ca.SX, base_rate: ca.SX, *, gravity: bool
    ) -> ca.SX:
        """See `Motion`."""
        # With X_k = φ̇_k² cos φ_k and Y_k = φ̇_k² sin φ_k the right-hand side of body k is
        # Q_k − A_k sin φ_k + B_k cos φ_k; A and B are sums of X, Y and the base's force. Sums end with what is known
        # last.
        free = [direction for direction, _ in self.translations]
        moving = range(self.first, self.n_bodies)
        shares = {k: (self.of(f"am{k}"), self.of(f"bm{k}")) for k in moving} if free else {}
        squares = {k: w[self._at(k)] ** 2 for k in moving}
        spin = {k: (along[k][0] * squares[k], along[k][1] * squares[k]) for k in moving}
        pull = dict.fromkeys("xy", ca.SX(0))  # on the base, per total mass
        for i, direction in enumerate(free):
            pull[direction] = self._base_force(i, u, w, base, base_rate, "_m")
            if len(free) == 1:
                pull[direction] += sum_of(_along(shares[k], spin[k])[direction == "y"] for k in moving)

        right = self._joint_forces(u, w, torque)
        for k in moving:
            a, b = self.of(f"a{k}"), self.of(f"b{k}")
            weight = self.of("gravity") if gravity and "y" not in free else ca.SX(0)
            to_sine, to_cosine = -weight * b, -weight * a
            for m in moving:
                if m != k:
                    more_sine, more_cosine = _along(self._coupling(k, m), spin[m])
                    to_sine, to_cosine = to_sine + more_sine, to_cosine + more_cosine
            to_sine -= a * pull["x"] + b * pull["y"]
            to_cosine -= a * pull["y"] - b * pull["x"]
            c, s = along[k]
            right[k] = right[k] - s * to_sine + c * to_cosine
        block = self._block(along)[3]
        turning = _solve_symmetric(block, right, list(moving), self._pivot(block))

        falling = {"y": self.of("gravity")} if gravity else {}
        linear = {direction: pull[direction] - falling.get(direction, 0) for direction in free}
        for k in moving if free else ():
            (c, s), (x, y) = along[k], spin[k]
            if len(free) == 1:  # `pull` has the first part already
                x, y = ca.SX(0), ca.SX(0)
            drawn = _along(shares[k], (x + s * turning[k], y - c * turning[k]))
            for direction in free:
                linear[direction] += drawn[direction == "y"]
        return ca.vertcat(*linear.values(), *(turning[k] for k in moving))

    def _block(
        self, along: Directions
    ) -> tuple[list[int], dict[int, tuple[ca.SX, ca.SX]], list[int], dict[tuple[int, int], ca.SX]]:
        """Bodies that turn, columns p_k, axes of the free translations, and the block that is left without these."""
        moving = list(range(self.first, self.n_bodies))
        columns = {k: self._column(k, along) for k in moving}
        axes = [0 if direction == "x" else 1 for direction, _ in self.translations]
        block = {(k, m): self._inertia(k, m, along, columns, axes) for k in moving for m in moving if m <= k}
        return moving, columns, axes, block

    def _pivot(self, block: dict[tuple[int, int], ca.SX]) -> ca.SX:
        return self.of("inverse_pivot") if self.n_translations == 2 else 1 / block[self.first, self.first]

    def _base_force(self, i: int, u: ca.SX, w: ca.SX, base: ca.SX, base_rate: ca.SX, per: str = "") -> ca.SX:
        """Spring and damper of the i-th free translation; with "_m" over the total mass."""
        direction, _ = self.translations[i]
        anchor, rate = self._anchor(i, base) + self._rest(i), self._anchor(i, base_rate)
        stiffness, damping = self.of(f"stiffness_{direction}{per}"), self.of(f"damping_{direction}{per}")
        return -stiffness * (u[i] - anchor) - damping * (w[i] - rate)

    def _at(self, body: int) -> int:
        return self.n_translations + body - self.first

    def _relative(self, u: ca.SX, body: int) -> ca.SX:
        """Angle of a body's hinge."""
        angle = self._relative_rate(u, body)
        return angle - self.of("rest0") if body == 1 == self.first else angle

    def _anchor(self, i: int, base: ca.SX) -> ca.SX:
        """What the placement, or its rate, adds to the i-th translation."""
        return base if self.placement and self.translations[i][0] == "x" else ca.SX(0)

    def _rest(self, i: int) -> ca.SX:
        return self.of(f"rest_{self.translations[i][0]}")

    def _relative_rate(self, w: ca.SX, body: int) -> ca.SX:
        rate = w[self._at(body)]
        return rate - w[self._at(body - 1)] if body > self.first else rate

    def _translation(self, u: ca.SX, base: ca.SX) -> ca.SX:
        """Where the first hinge is; `base` where x is rigid."""
        free = any(direction == "x" for direction, _ in self.translations)
        placed = ca.SX(0) if free or not self.placement else base
        return self._along_rows(u) + ca.vertcat(self.of("origin_x") + placed, self.of("origin_y"))

    def _along_rows(self, u: ca.SX) -> ca.SX:
        """The translations along the task's rows."""
        of = {direction: u[i] for i, (direction, _) in enumerate(self.translations)}
        return ca.vertcat(of.get("x", ca.SX(0)), of.get("y", ca.SX(0)))

    def _column(self, k: int, along: Directions) -> tuple[ca.SX, ca.SX]:
        """p_k = a_k n_k − b_k e_k."""
        c, s = along[k]
        a, b = self.of(f"a{k}"), self.of(f"b{k}")
        return -a * s - b * c, a * c - b * s

    def _weight(self, k: int, along: Directions) -> ca.SX:
        return self.of("gravity") * self._column(k, along)[1]

    def _coupling(self, k: int, m: int) -> CosSin:
        """S_km and T_km, which changes sign with the order."""
        high, low = max(k, m), min(k, m)
        t = self.of(f"t{high}_{low}")
        return self.of(f"s{high}_{low}"), t if k > m else -t

    def _inertia(
        self,
        k: int,
        m: int,
        along: Directions,
        columns: dict[int, tuple[ca.SX, ca.SX]],
        axes: list[int],
    ) -> ca.SX:
        """Entry k ≥ m of the angular block, translations eliminated."""
        entry = self.of(f"s{k}_{m}")
        if k != m:
            cosine, sine = _difference(along[k], along[m])
            entry = entry * cosine + self.of(f"t{k}_{m}") * sine
        if len(axes) == 1:
            entry -= columns[k][axes[0]] * columns[m][axes[0]] * self.of("inverse_total")
        return entry

    def _joint_forces(self, u: ca.SX, w: ca.SX, torque: ca.SX) -> dict[int, ca.SX]:
        """Generalised forces of the absolute angles: each hinge acts on its body and back on the one before."""
        actuated = self.joints
        at_hinge: dict[int, ca.SX] = {}
        for k in range(self.first, self.n_bodies):
            force = -self.of(f"damping{k}") * self._relative_rate(w, k)
            if k in actuated:
                force += self.senses[k] * torque[actuated.index(k)]
            else:
                force -= self.of(f"stiffness{k}") * (self._relative(u, k) - self.of(f"rest{k}"))
            at_hinge[k] = force
        return {k: at_hinge[k] - at_hinge.get(k + 1, ca.SX(0)) for k in range(self.first, self.n_bodies)}


def _solve_symmetric(
    block: dict[tuple[int, int], ca.SX], right: dict[int, ca.SX], index: list[int], pivot: ca.SX
) -> dict[int, ca.SX]:
    """Solution of a positive definite system, `pivot` the reciprocal of its first entry.

    The last two unknowns are solved for together, so that few divisions wait for each other.
    """
    if len(index) == 1:
        (k,) = index
        return {k: right[k] * pivot}
    if len(index) == 2:
        i, j = index
        twice = 2 / (block[i, i] * block[j, j] - block[j, i] ** 2)
        ii, ij, jj = (0.5 * block[key] * twice for key in ((j, j), (j, i), (i, i)))
        return {i: ii * right[i] - ij * right[j], j: jj * right[j] - ij * right[i]}
    first, rest = index[0], index[1:]
    factor = {k: block[k, first] * pivot for k in rest}
    onward = {k: right[k] - factor[k] * right[first] for k in rest}
    head = pivot * right[first]
    if len(rest) == 2:
        # The inverse's rows are ready before the right-hand side is. (CasADi turns products with 1/det into divisions,
        # those with s/(s det) it leaves.)
        i, j = rest
        scale = block[first, first]
        a, b, c = (scale * block[k, m] - block[k, first] * block[m, first] for k, m in ((i, i), (j, i), (j, j)))
        reciprocal = scale / (a * c - b * b)
        ii, ij, jj = c * reciprocal, b * reciprocal, a * reciprocal
        head -= (factor[i] * ii - factor[j] * ij) * onward[i]
        head -= (factor[j] * jj - factor[i] * ij) * onward[j]
        return {first: head, i: ii * onward[i] - ij * onward[j], j: jj * onward[j] - ij * onward[i]}
    reduced = {(k, m): block[k, m] - factor[k] * block[m, first] for k in rest for m in rest if m <= k}
    solved = _solve_symmetric(reduced, onward, rest, 1 / reduced[rest[0], rest[0]])
    for k in rest:
        head -= factor[k] * solved[k]
    return {first: head, **solved}


def _difference(a: CosSin, b: CosSin) -> CosSin:
    """Cosine and sine of α − β."""
    return a[0] * b[0] + a[1] * b[1], a[1] * b[0] - a[0] * b[1]


def _total(a: CosSin, b: CosSin) -> CosSin:
    """Cosine and sine of α + β."""
    return a[0] * b[0] - a[1] * b[1], a[1] * b[0] + a[0] * b[1]


def _along(scale: CosSin, vector: CosSin) -> CosSin:
    """(a x − b y, a y + b x)."""
    (a, b), (x, y) = scale, vector
    return a * x - b * y, a * y + b * x
