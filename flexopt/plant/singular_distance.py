"""How far a posture is from singular ones: by what angle each joint's motion leaves that of all the others.

In: the end-point and the joints on the way to it, as graphs. Out: one number, the same for every description of a
machine: it is 0 exactly where the rigid Jacobian Jv loses rank, and at most 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import casadi as ca

from flexopt.algebra import safe_norm
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
    rows = columns.shape[0]
    mean = sum(squares, start=ca.SX(0)) / rows
    gram = ca.densify(columns @ columns.T) / mean
    apart = [ca.SX(1), *[ca.SX(0)] * rows]
    for square in squares:
        for k in range(rows, 0, -1):
            apart[k] += apart[k - 1] * square / mean
    identity = ca.SX(ca.DM.eye(rows))
    work, coefficient, before = identity, ca.SX(1), ca.SX(1)
    for k in range(1, rows + 1):
        product = gram @ work
        before, coefficient = coefficient, -ca.trace(product) / k
        work = product + coefficient * identity
    # Coefficients have alternating signs. Where two singular values vanish, or too few lengths are left, both terms of
    # a quotient are rounding.
    return -_quotient(apart[rows - 1], apart[rows]) * _quotient(coefficient, before)


def _quotient(a: ca.SX, b: ca.SX) -> ca.SX:
    return a * b / (b**2 + ROUNDING**2)


def singularity_sine_squared(
    structure: Skeleton, jacobian: ca.SX, joints: Sequence[tuple[ca.SX, ca.SX]], tip: ca.SX, task_length: ca.SX
) -> ca.SX:
    """`sine_squared` of what the bodies of the arm do to the task, each by itself.

    Column i is the motion of the task where body i turns and what hangs on it by a parallel hinge keeps its direction:
    J_i less that of the next joint where both are parallel hinges. In the plane it is the arm's i-th segment, turned by
    90°, and the result the mean sin² of the angles between segments, sin² θ3 of two links. Its length l_i is the
    segment's; where joints beyond change it, the longest there is, slides staying where they are; of a slide the whole
    arm's.

    Args:
        structure: of the machine.
        jacobian: Jv (p, n) by the actuated joints, in their order.
        joints: of each body where its joint is and its axis, (3,), all actuated hinges at zero.
        tip: where the end-point is then, (3,), m.
        task_length: by which orientation rows are multiplied, m.
    """
    way, actuated = structure.actuated_way, structure.actuated
    corners = [*(joints[i][0] for i in way), tip]
    steps = [end - start for start, end in pairwise(corners)]
    whole = sum((safe_norm(step) for step in steps), start=ca.SX(0))
    turned = task_length**2 if any(row not in "xyz" for row in structure.rows) else ca.SX(0)
    columns: list[ca.SX] = []
    squares: list[ca.SX] = []
    for k, i in enumerate(way):
        column, last = jacobian[:, actuated.index(i)], k + 1 == len(way)
        sense = 0.0 if last else structure.sense_along(i, way[k + 1])
        if structure.segments[i].slide:
            length = ca.SX(1) if all(structure.segments[j].slide for j in way) else whole
            column, square = column * length, length**2
        elif sense or last:
            column -= 0 if last else sense * jacobian[:, actuated.index(way[k + 1])]
            square = ca.sumsqr(ca.cross(joints[i][1], steps[k])) + (turned if last else 0)
        else:
            square = sum((safe_norm(step) for step in steps[k:]), start=ca.SX(0)) ** 2 + turned
        columns.append(column)
        squares.append(square)
    return sine_squared(ca.horzcat(*columns), squares) if len(way) >= len(structure.rows) else ca.SX(0)
