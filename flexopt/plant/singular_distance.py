"""How far a posture is from singular ones: by what angle each joint's motion leaves that of all the others.

In: the end-point and the joints on the way to it, as graphs. Out: one number, the same for every description of a
machine: it is 0 exactly where the rigid Jacobian Jv loses rank, and at most 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import casadi as ca

from flexopt.algebra import determinant, safe_norm
from flexopt.plant.tree_algebra import AXES
from flexopt.plant.tree_structure import Skeleton

# Of sums of products of squared singular values, where the mean of these is 1.
ROUNDING = 1e-9


def sine_squared(columns: ca.SX, squares: Sequence[ca.SX]) -> ca.SX:
    """sin² of the angles between columns s_i (p, n), bounded by lengths l_i, whose `squares` are given: |s_i| ≤ l_i.

    With e_k(G) the coefficients of the characteristic polynomial of G = S Sᵀ, which are the sums of its principal
    minors of order k, and e_k(l²) the elementary symmetric polynomials, which they would be of columns at right angles,

        sin² = [e_p(G) / e_p(l²)] / [e_{p−1}(G) / e_{p−1}(l²)].

    For n = p and |s_i| = l_i it is the mean of sin² α_i, harmonic and weighted with 1/l_i², α_i the angle between s_i
    and the space of all the others; for p = 2 the mean of sin² over all pairs of columns, weighted with (l_i l_j)²; for
    n = p = 2 sin² of the angle between the two. It is at most 1 because e_p/e_{p−1} is increasing and Schur-concave
    (Marcus and Lopes, Canadian Journal of Mathematics 9, 1957) and the eigenvalues of G majorise the |s_i|². The
    coefficients are found without a division by anything but whole numbers (Faddeev and LeVerrier).
    """
    rows, n = columns.shape
    mean = sum(squares, start=ca.SX(0)) / rows
    apart = [ca.SX(1), *[ca.SX(0)] * rows]
    for square in squares:
        for k in range(rows, 0, -1):
            apart[k] += apart[k - 1] * square / mean
    gram = ca.densify(columns @ columns.T) / mean
    # Rounding of a square matrix's determinant grows with its condition, and not with that one's square.
    whole = determinant(columns) ** 2 / mean**rows if n == rows else determinant(gram)
    identity = ca.SX(ca.DM.eye(rows))
    work, before = identity, ca.SX(1)
    for k in range(1, rows):
        product = gram @ work
        coefficient = ca.trace(product) / k
        work, before = coefficient * identity - product, coefficient
    # Where two singular values vanish, or too few lengths are left, both terms of a quotient are rounding.
    return _quotient(apart[rows - 1], apart[rows]) * _quotient(whole, before)


def _quotient(a: ca.SX, b: ca.SX) -> ca.SX:
    return a * b / (b**2 + ROUNDING**2)


@dataclass(frozen=True, eq=False)
class ArmLine:
    """The actuated joints on the way to the end-point, from the ground outwards, in one configuration.

    Attributes:
        steps: from each to the next, and from the last to the end-point, (3,), m.
        axes: of each, (3,).
    """

    steps: Sequence[ca.SX]
    axes: Sequence[ca.SX]


def singularity_sine_squared(
    structure: Skeleton, line: ArmLine, still: ArmLine, task: ca.SX, joints: ca.SX, task_length: ca.SX
) -> ca.SX:
    """`sine_squared` of what the bodies of the arm do to the task, each by itself.

    Column i is the motion of the task where body i turns and what hangs on it by a parallel hinge keeps its direction:
    J_i less that of the next joint where both are parallel hinges. In the plane it is the arm's i-th segment, turned by
    90°, and the result the mean sin² of the angles between segments, sin² θ3 of two links. Its length l_i is the
    segment's; where joints beyond change it, the longest there is, slides staying where they are; of a slide the whole
    arm's.

    Args:
        structure: of the machine.
        line: the arm, inertial axes.
        still: the same, all actuated hinges and what carries the arm at zero, in whatever axes.
        task: the rows r (p,) as graphs of the actuated `joints` (n,), in their order.
        task_length: by which orientation rows are multiplied, m.
    """
    way = structure.actuated_way
    steps, senses = still.steps, [structure.sense_along(i, k) for i, k in pairwise(way)] + [1.0]
    whole = sum((safe_norm(step) for step in steps), start=ca.SX(0))
    positions = [k for k, row in enumerate(structure.rows) if row in AXES]
    turns = [k for k in range(len(structure.rows)) if k not in positions]
    turned = task_length**2 if turns else ca.SX(0)
    by_joint = ca.jacobian(task, joints) if turns else ca.SX(task.shape[0], joints.shape[0])
    columns: list[ca.SX] = []
    squares: list[ca.SX] = []
    for k, (i, sense) in enumerate(zip(way, senses, strict=True)):
        last, column = k + 1 == len(way), by_joint[:, structure.actuated.index(i)]
        moved = line.steps[k] if sense else sum(line.steps[k + 1 :], start=line.steps[k])
        if structure.segments[i].slide:
            length = ca.SX(1) if all(structure.segments[j].slide for j in way) else whole
            motion, column, square = length * line.axes[k], length * column, length**2
        else:
            motion = ca.cross(line.axes[k], moved)
            if sense and not last:
                column = column - sense * by_joint[:, structure.actuated.index(way[k + 1])]
            if sense:
                square = ca.sumsqr(ca.cross(still.axes[k], steps[k])) + (turned if last else 0)
            else:
                square = sum((safe_norm(step) for step in steps[k:]), start=ca.SX(0)) ** 2 + turned
        for row in positions:
            column[row] = motion[AXES.index(structure.rows[row])]
        columns.append(column)
        squares.append(square)
    return sine_squared(ca.horzcat(*columns), squares)
