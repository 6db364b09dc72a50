"""What the atlas of a machine traces, as smooth functions of two of its joints, the others held.

In: a machine under a controller, with the joints that vary. Out: the functions with exact slopes, at many postures.

With two task rows w_i = a_i·b_i − |a_i||b_i| is 0 where a_i × b_i = 0 and a_i·b_i > 0. There w_i has a maximum, but the
cross product changes its sign; neither depends on the sign of the mode's eigenvector. Under inverse control b_i is
infinite at singular postures; what is traced has b_i times det Jv, of a redundant arm det Jv Jvᵀ, and is smooth there.
Where a_i keeps to a `LineOfMotion` it is 0 on curves, and w_i with it, whatever a_i·b_i is beside them. Its signed size
s_i on the line is a factor of a_i × b_i; the other one is what b_i has along a column of Jv. Each is traced by itself.
With three task rows a_i × b_i is a vector of two degrees of freedom: two of its components, in directions that no
machine has a reason to know, are zero together where it is, and else where it is at right angles to both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from flexopt.compiled import Economical
from flexopt.foundation.arrays import Vector
from flexopt.foundation.control import Control
from flexopt.foundation.kept import by_structure, structural_property
from flexopt.model import AnyMachine
from flexopt.plant import Plant, build_plant
from flexopt.plant.singularity import conditions
from flexopt.plant.statics import left_over
from flexopt.robustness.expansion import Expansion
from flexopt.robustness.measures import NAMES as INPUTS
from flexopt.robustness.measures import SOLVE_TOLERANCE
from flexopt.robustness.modes import modes_function

# Task rows with which robust postures over two joints are curves, and points.
ROWS = 2, 3
# Directions (2, 3) of the two components.
DIRECTIONS = np.array([[0.5393, 0.3214, 0.7784], [-0.6477, 0.7429, 0.1694]])
# Modes whose frequency fewer have stand alone.
SHARED = 1.5


@dataclass(frozen=True)
class LineOfMotion:
    """A mode whose a_i is at right angles to a column of Jv, in one plane with it and with b_i, in all postures.

    So is that of a telescope behind all other joints, whose mass lies on its line through the end-point: along a joint
    that nothing holds a mode has no momentum.

    Attributes:
        mode: i, from 0.
        joint: of the column, from 0.
        normal: of the plane, (3,); of two task rows the third direction.
    """

    mode: int
    joint: int
    normal: Vector


@dataclass(frozen=True)
class Slice:
    """A plane of postures: two joints vary.

    Attributes:
        machine, control, gravity: as in `flexopt.evaluate`.
        varies: indices of the two joints.
        rest: (n − 2,), the others, in order, rad or m.
        base: placement (n_b,).
        threads: how many to compute with.
        left_out: modes, from 0, that are not traced: in place of their a_i × b_i stands 1.
        lines: of the modes whose a_i keeps to one.
    """

    machine: AnyMachine
    control: Control
    gravity: bool
    varies: tuple[int, int]
    rest: Vector
    base: Vector
    threads: int = 1
    left_out: tuple[int, ...] = ()
    lines: tuple[LineOfMotion, ...] = ()

    @cached_property
    def plant(self) -> Plant:
        """The machine's, asked for once: a slice is called many times with few points."""
        return build_plant(self.machine)

    @property
    def modes(self) -> int:
        """Number of modes."""
        return self.plant.n_passive

    @property
    def turning(self) -> bool:
        """Whether b_i is multiplied by `edge`, which may be negative."""
        return self.control == "inverse" and len(self.machine.joints) == len(self.machine.task_rows)

    @property
    def spatial(self) -> bool:
        """Whether the task has three rows."""
        return len(self.machine.task_rows) == ROWS[1]

    # Where what stands among the fields.

    @property
    def edge(self) -> int:
        """The determinant of the two varying columns of Jv, in the order of the joints; of three task rows det Jv.

        1 where three task rows have more joints.
        """
        return self.modes

    @property
    def traced(self) -> int:
        """How many fields, the first, are traced: a_i × b_i, `edge`, and a size for each line."""
        return self.modes + 1 + len(self.lines)

    def mode_of(self, function: int) -> int:
        """Whose a_i × b_i or s_i a field is."""
        return function if function < self.modes else self.lines[function - self.modes - 1].mode

    def on_line(self, mode: int) -> bool:
        """Whether a_i keeps to a line."""
        return any(line.mode == mode for line in self.lines)

    def dot(self, mode: int) -> int:
        """a_i·b_i."""
        return self.traced + mode

    def minor(self, k: int) -> int:
        """The determinant of the first varying column of Jv and the k-th that does not vary, of two task rows."""
        return self.traced + self.modes + k

    def second(self, mode: int) -> int:
        """Of three task rows the second component of a_i × b_i."""
        return self.traced + self.modes + mode

    def postures(self, points: Vector) -> Vector:
        """Postures (n, N) of points (2, N)."""
        return postures_of(self.varies, self.rest, points)

    def expect(self, points: int) -> None:
        """Have the code compiled where so many points are worth it."""
        _function(self.machine, self.control, self.gravity).expect(points)

    def values(self, points: Vector) -> SliceValues:
        """Everything at points (2, N)."""
        plant, r = self.plant, len(self.machine.task_rows)
        p = plant.parameter_values.full().ravel()
        postures = np.array(self.postures(points), order="C")
        found = _function(self.machine, self.control, self.gravity)(
            np.repeat(self.base[:, None], points.shape[1], axis=1), postures, p, threads=self.threads
        )
        f, f_z, omega_squared, same, divisor, jv, jv_z, end_point, left_over = found
        m, n, count = self.modes, plant.n_actuated, points.shape[1]
        moving = [plant.n_base + k for k in self.varies]
        slopes = f_z.reshape(plant.n_base + n, m, 2, r, count)[moving].transpose(1, 2, 3, 0, 4)
        factors = f.reshape(m, 2, r, count)
        unsound = (left_over[0] > SOLVE_TOLERANCE) | (same.reshape(m, m, count).sum(axis=0) > SHARED)
        factors = np.where(unsound[:, None, None, :], np.nan, factors)
        columns = jv.reshape(n, r, count)
        column_slopes = jv_z.reshape(n, n, r, count)[list(self.varies)].transpose(1, 2, 0, 3)
        joint_motion = None
        if self.turning:
            joint_motion = factors[:, 1].copy(), slopes[:, 1].copy()
            factors[:, 1], slopes[:, 1] = _without_division(*joint_motion, columns, column_slopes)
        frequency = np.sqrt(np.maximum(omega_squared, 0.0)) / (2 * np.pi)
        return SliceValues(factors, slopes, divisor[0], columns, column_slopes, frequency, end_point, joint_motion)

    def __call__(self, points: Vector) -> tuple[Vector, Vector]:
        """a_i × b_i (m), `edge`, s_i, a_i·b_i (m), minors or second components, and their slopes; see `zero_curves`.

        Under inverse control b_i is multiplied as said above. Of modes on a line there is s_i, in their order, and what
        b_i has along the line's column of Jv stands for a_i × b_i.
        """
        at = self.values(points)
        (a, b), (a_z, b_z) = at.factors.swapaxes(0, 1), at.slopes.swapaxes(0, 1)
        cross, *second = _components(*(each.swapaxes(0, 1) for each in (a, b, a_z, b_z)))
        dot = np.sum(a * b, axis=1), np.einsum("mrzn,mrn->mzn", a_z, b) + np.einsum("mrn,mrzn->mzn", a, b_z)
        sizes: list[tuple[Vector, Vector]] = []
        for line in self.lines:
            along, size = self._on_line(at, line)
            for whole, part in zip(cross, along, strict=True):
                whole[line.mode] = part
            sizes.append(size)
        for each, constant in zip(cross, (1.0, 0.0), strict=True):
            each[list(self.left_out)] = constant
        edge, *minors = self._determinants(at)
        both = [cross, edge, *sizes, dot, *minors, *second]
        return np.concatenate([value for value, _ in both]), np.concatenate([slope for _, slope in both])

    def _on_line(self, at: SliceValues, line: LineOfMotion) -> list[tuple[Vector, Vector]]:
        """What b_i has along the line's column of Jv, (N,), and s_i, (1, N), with their slopes."""
        (a, b), (a_z, b_z) = at.factors[line.mode], at.slopes[line.mode]
        t, t_z = at.columns[line.joint], at.column_slopes[line.joint]
        if at.joint_motion is None:
            along = _product(b, t, b_z, t_z)
        else:
            # Jvᵀ b_i is how the joints move. That of b_i times det Jv would be zero all along the edge, too.
            motion, motion_z = at.joint_motion
            along = motion[line.mode, line.joint], motion_z[line.mode, line.joint]
        across, across_z = (_normal_to(each, line.normal)[: len(t)] for each in (t, t_z))
        size, size_z = _product(a, across, a_z, across_z)
        return [along, (size[None], size_z[None])]

    def _determinants(self, at: SliceValues) -> list[tuple[Vector, Vector]]:
        """`edge`, and of two task rows the minors."""
        columns, slopes = at.columns, at.column_slopes
        if self.spatial:
            if len(columns) > ROWS[1]:
                return [(np.ones((1, columns.shape[-1])), np.zeros((1, 2, columns.shape[-1])))]
            beyond = _cofactors(columns)
            slope = np.einsum("krn,krzn->zn", beyond, slopes)
            return [(np.sum(columns[0] * beyond[0], axis=0)[None], slope[None])]
        i, j = self.varies
        others = [k for k in range(len(columns)) if k not in self.varies]
        pairs = [(min(i, j), max(i, j)), *((i, k) for k in others)]
        found = (_crossed(columns[k], columns[n], slopes[k], slopes[n]) for k, n in pairs)
        return [(value[None], slope[None]) for value, slope in found]


@dataclass(frozen=True)
class SliceValues:
    """N postures; r task rows, m modes, n joints.

    Attributes:
        factors: a_i, and b_i times `divisor`, (m, 2, r, N); NaN where a mode shares its frequency, or nothing holds
            the machine.
        slopes: by the two joints that vary, (m, 2, r, 2, N).
        divisor: (N,).
        columns: of Jv, (n, r, N).
        column_slopes: (n, r, 2, N).
        frequency_hz: (m, N).
        end_point: (r, N), m.
        joint_motion: the actuated parts of the modes, (m, n, N), and their slopes (m, n, 2, N): of square Jv under
            inverse control.
    """

    factors: Vector
    slopes: Vector
    divisor: Vector
    columns: Vector
    column_slopes: Vector
    frequency_hz: Vector
    end_point: Vector
    joint_motion: tuple[Vector, Vector] | None = None

    @property
    def condition(self) -> Vector:
        """Of Jv, (N,)."""
        n, r, count = self.columns.shape
        return conditions(self.columns.reshape(n * r, count), n)[0]

    @property
    def scale(self) -> Vector:
        """|a_i||b_i|, (m, N)."""
        with np.errstate(all="ignore"):
            return np.prod(np.linalg.norm(self.factors, axis=2), axis=1) / np.abs(self.divisor)

    @property
    def crossed(self) -> Vector:
        """|a_i × b_i|, (m, N)."""
        a, b = self.factors.swapaxes(0, 1)
        pairs = [(0, 1), (1, 2), (2, 0)] if a.shape[1] == ROWS[1] else [(0, 1)]
        with np.errstate(all="ignore"):
            return np.linalg.norm([(a[:, k] * b[:, n] - a[:, n] * b[:, k]) / self.divisor for k, n in pairs], axis=0)

    @property
    def w(self) -> Vector:
        """w_i = a·b − |a||b|, (m, N), without cancellation near 0."""
        a, b = self.factors.swapaxes(0, 1)
        crossed, scale = self.crossed, self.scale
        with np.errstate(all="ignore"):
            dot: Vector = np.sum(a * b, axis=1) / self.divisor
            found: Vector = np.where(dot > 0, -crossed / (scale + dot) * crossed, dot - scale)
        return found


def postures_of(varies: Sequence[int], rest: Vector, points: Vector) -> Vector:
    """Postures (n, N) of points (2, N): those joints vary, the others (n − 2,) rest."""
    posture = np.empty((2 + rest.size, points.shape[1]))
    posture[[k for k in range(len(posture)) if k not in varies]] = rest[:, None]
    posture[list(varies)] = points
    return posture


def _crossed(a: Vector, b: Vector, a_z: Vector, b_z: Vector) -> tuple[Vector, Vector]:
    """The product a × b (…, N) of vectors (2, …, N), and its slope (…, 2, N)."""
    (ax, ay), (bx, by) = (each[..., None, :] for each in (a, b))
    return a[0] * b[1] - a[1] * b[0], a_z[0] * by + ax * b_z[1] - a_z[1] * bx - ay * b_z[0]


def _product(a: Vector, b: Vector, a_z: Vector, b_z: Vector) -> tuple[Vector, Vector]:
    """The product a·b (N,) of vectors (r, N), and its slope (2, N)."""
    slope: Vector = np.einsum("rzn,rn->zn", a_z, b) + np.einsum("rn,rzn->zn", a, b_z)
    return np.sum(a * b, axis=0), slope


def _normal_to(vectors: Vector, normal: Vector) -> Vector:
    """The products normal × v, (3, …), of vectors v (r, …); what two rows lack is 0."""
    whole = np.concatenate([vectors, np.zeros((ROWS[1] - len(vectors), *vectors.shape[1:]))])
    return np.cross(normal, whole, axisb=0, axisc=0)


def _cofactors(columns: Vector) -> Vector:
    """Columns (r, r, …) of the matrix det Jv Jv⁻ᵀ from those of Jv."""
    if len(columns) == ROWS[0]:
        first, second = columns
        return np.array([[second[1], -second[0]], [-first[1], first[0]]])
    beyond: list[Vector] = [np.cross(columns[k - 2], columns[k - 1], axis=0) for k in range(3)]
    return np.stack(beyond)


def _cofactor_slopes(columns: Vector, slopes: Vector) -> Vector:
    """Their slopes (r, r, 2, N): they are linear, of three rows bilinear, in the columns."""
    if len(columns) == ROWS[0]:
        return _cofactors(slopes)
    wide, pairs = columns[:, :, None, :], [(k - 2, k - 1) for k in range(3)]
    return np.stack([np.cross(slopes[i], wide[j], axis=0) + np.cross(wide[i], slopes[j], axis=0) for i, j in pairs])


def _without_division(x: Vector, x_z: Vector, columns: Vector, slopes: Vector) -> tuple[Vector, Vector]:
    """The b_i times det Jv, (m, r, N), and their slopes (m, r, 2, N), from x_i = Jvᵀ b_i and Jv with theirs."""
    turned, turned_z = _cofactors(columns), _cofactor_slopes(columns, slopes)
    value = np.einsum("mkn,krn->mrn", x, turned)
    return value, np.einsum("mkzn,krn->mrzn", x_z, turned) + np.einsum("mkn,krzn->mrzn", x, turned_z)


def _components(a: Vector, b: Vector, a_z: Vector, b_z: Vector) -> list[tuple[Vector, Vector]]:
    """The product a × b of vectors (r, …, N) and its slope; of three rows its components in `DIRECTIONS`."""
    if len(a) < ROWS[1]:
        return [_crossed(a, b, a_z, b_z)]
    parts = [_crossed(*(np.stack([x[k - 2], x[k - 1]]) for x in (a, b, a_z, b_z))) for k in range(3)]
    values, slopes = (np.stack(each) for each in zip(*parts, strict=True))
    return [(np.tensordot(e, values, 1), np.tensordot(e, slopes, 1)) for e in DIRECTIONS]


class _Smooth(Expansion):
    """As `Expansion` under inverse control, but in place of b_i = S⁻ᵀ x_i what is smooth at singular postures.

    Of a square Jv that is x_i itself, the actuated part of the mode; of a redundant arm b_i times det Jv Jvᵀ.
    """

    @structural_property
    def divided(self) -> ca.SX:
        """S: Jv, or Jv Jvᵀ."""
        jv = self.point.rigid_jacobian
        return jv if jv.is_square() else jv @ jv.T

    @structural_property
    def graphs(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """K_p, M̄ (m, m) and F (2r, m)."""
        stiffness, mass, factors = super().graphs
        jv, follow, matrix = self.point.rigid_jacobian, self.pencil.follow, self.divided
        r = matrix.shape[0]
        if jv.is_square():
            return stiffness, mass, ca.vertcat(factors[:r, :], follow)
        cofactors = ca.SX(r, r)
        for i in range(r):
            for j in range(r):
                rest = matrix[[k for k in range(r) if k != i], [k for k in range(r) if k != j]]
                cofactors[i, j] = (-1) ** (i + j) * ca.det(rest)
        return stiffness, mass, ca.vertcat(factors[:r, :], cofactors @ (jv @ follow))


@by_structure
def _function(machine: AnyMachine, control: Control, gravity: bool) -> Economical:
    """(base, posture, p) -> what `SliceValues` is made of, by name; matrices are stacked by columns.

    `f` and `f_z` are as of `Measures.factors`, but of `_Smooth` under inverse control; `left_over`, by the static
    deflection, is relative to the weight.
    """
    plant = build_plant(machine)
    expansion = (_Smooth if control == "inverse" else Expansion)(plant, control, gravity)
    sizes, m = (plant.n_base, plant.n_actuated, len(plant.parameter_names)), plant.n_passive
    at = [ca.MX.sym(*name_and_size) for name_and_size in zip(INPUTS, sizes, strict=True)]
    held, _ = expansion.hold(at, modes_function(m))
    point = expansion.point
    divisor = ca.det(expansion.divided) if isinstance(expansion, _Smooth) else ca.SX(1)
    jv = ca.vec(ca.densify(point.rigid_jacobian))
    residual = left_over(plant, point.q, point.static_residual) if gravity else ca.SX(0)
    outputs = [divisor, jv, ca.jacobian(jv, plant.graph.posture), point.end_point, residual]
    geometry = expansion.of_machine("atlas_geometry", [], outputs)
    found = geometry.call([*at, held["deflection"]] if gravity else at)
    factors = [held["f"], expansion.factor_slopes(at, held), held["omega_squared"], held["same"]]
    dense = [ca.densify(each) for each in (*factors, *found)]
    names = ["f", "f_z", "omega_squared", "same", "divisor", "jv", "jv_z", "end_point", "left_over"]
    return Economical(ca.Function("atlas_fields", at, dense, INPUTS, names))
