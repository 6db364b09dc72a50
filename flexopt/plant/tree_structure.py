"""A tree of bodies prepared for recursions: who carries whom, in frames that leave few constants.

In: a validated `Tree`. Out: its `Skeleton`, numbers and words only. Each body gets a frame of its own choice. A slide's
keeps the orientation of its parent's, a hinge's turns about its z axis, so that the rotation from parent to body is
E Rz(q) with a constant E; where axes are parallel E = 1, where they are at right angles E is a signed permutation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flexopt.model.tree import Tree
from flexopt.model.tree_quantities import axes_about

Matrix = NDArray[np.float64]
Numbers = tuple[tuple[float, float, float], ...]
# Products of rotations this near to 0 or ±1 are meant to be it.
SNAP = 1e-14
TURN = "turn"  # of the anchor frame since it stood at first


@dataclass(frozen=True)
class Segment:
    """A body and its joint.

    Attributes:
        parent: index of the parent, −1 for the ground.
        slide: whether the joint is a slide.
        turn: E (3, 3), by rows, of a hinge.
        axis: of a slide, in the parent's frame.
        passive: whether the joint is passive.
        in_row: whether it is a hinge parallel to the last one before it: E = 1.
        parallel: whether it is a hinge parallel to all between it and the ground.
    """

    parent: int
    slide: bool
    turn: Numbers
    axis: tuple[float, float, float]
    passive: bool
    in_row: bool
    parallel: bool


@dataclass(frozen=True)
class Skeleton:
    """What decides the graphs of a tree: all but the values of its parameters. Equal ones share compiled code.

    Attributes:
        segments: the bodies, each after its parent.
        tip: index of the end-point's body; tip_rotation: of its frame in that body's.
        rows, reference, placement: as in `EndPoint` and `Tree`.
        coupled_springs, coupled_dampers: pairs of bodies whose joints have a stiffness or damping, i ≤ j.
        zeros: constants that are exactly zero and are left out.
        local: whether the placement's x and y count in the axes in which the anchor frame stands at first, instead of
            inertial ones: slides take them up although the frame is turned.
        also: what the anchor frame is driven along besides its placement: of x and y what that leaves out, `TURN`.
    """

    segments: tuple[Segment, ...]
    tip: int
    tip_rotation: Numbers
    rows: tuple[str, ...]
    reference: Numbers
    placement: tuple[str, ...]
    coupled_springs: tuple[tuple[int, int], ...]
    coupled_dampers: tuple[tuple[int, int], ...]
    zeros: frozenset[str] = frozenset()
    local: bool = False
    also: tuple[str, ...] = ()

    @property
    def drive(self) -> tuple[str, ...]:
        """Names of all that places the anchor frame during a motion."""
        return self.placement + self.also

    @property
    def order(self) -> list[int]:
        """Bodies in the order of q: on passive joints, then on actuated ones."""
        passive = [i for i, segment in enumerate(self.segments) if segment.passive]
        return passive + self.actuated

    @property
    def actuated(self) -> list[int]:
        """Bodies on actuated joints."""
        return [i for i, segment in enumerate(self.segments) if not segment.passive]

    def way_to(self, body: int) -> list[int]:
        """Bodies from the ground to one, itself included."""
        way = [body]
        while self.segments[way[0]].parent >= 0:
            way.insert(0, self.segments[way[0]].parent)
        return way

    @property
    def actuated_way(self) -> list[int]:
        """Bodies on actuated joints between the ground and the end-point."""
        return [i for i in self.way_to(self.tip) if not self.segments[i].passive]

    def sense_along(self, inner: int, outer: int) -> float:
        """±1 where the hinges of both bodies, and all between them, are parallel, −1 where they point apart; else 0."""
        between = self.way_to(outer)
        turning = [self.segments[i] for i in between[between.index(inner) + 1 :] if not self.segments[i].slide]
        if self.segments[inner].slide or self.segments[outer].slide:
            return 0.0
        senses = [segment.turn[2][2] for segment in turning]
        return math.prod(senses) if all(abs(sense) == 1 for sense in senses) else 0.0

    @property
    def leading_slides(self) -> list[int]:
        """Slides between the ground and the first hinge or branching, where only one body stands on the ground."""
        children: dict[int, list[int]] = {}
        for i, segment in enumerate(self.segments):
            children.setdefault(segment.parent, []).append(i)
        leading: list[int] = []
        at = children[-1]
        while len(at) == 1 and self.segments[at[0]].slide:
            leading.append(at[0])
            at = children.get(at[0], [])
        return leading

    @property
    def absorbed(self) -> dict[str, tuple[int, float]]:
        """Placement coordinates that a leading passive slide takes up as its rest value: the slide and its sign.

        Only where the anchor frame is not turned or x and y are `local`; the slide then counts from where the frame
        stood at first, and the springs pull towards `base`.
        """
        found: dict[str, tuple[int, float]] = {}
        if "yaw" in self.placement and not self.local:
            return found
        for i in self.leading_slides:
            for k, name in enumerate("xy"):
                axis = self.segments[i].axis
                if name in self.drive and self.segments[i].passive and abs(axis[k]) == 1 and name not in found:
                    found[name] = (i, axis[k])
        return found

    @property
    def turned_hinge(self) -> tuple[int, float] | None:
        """The passive hinge that takes up a turn of the anchor frame, and its sign; None where none does.

        It is the first joint after the leading slides and vertical. What slides horizontally before it must be two
        passive slides along x and y, whose springs turn with the anchor frame.
        """
        slides = self.leading_slides
        inner = slides[-1] if slides else -1
        after = [i for i, segment in enumerate(self.segments) if segment.parent == inner]
        if len(after) != 1 or self.segments[after[0]].slide or not self.segments[after[0]].passive:
            return None
        level = [self.segments[i] for i in slides if abs(self.segments[i].axis[2]) != 1]
        axes = sorted(tuple(abs(part) for part in segment.axis) for segment in level if segment.passive)
        sign = self.segments[after[0]].turn[2][2]
        if len(level) != len(axes) or axes != [(0.0, 1.0, 0.0), (1.0, 0.0, 0.0)] or abs(sign) != 1:
            return None
        return after[0], sign


def skeleton(tree: Tree) -> Skeleton:
    """The structure of a tree, every constant kept."""
    segments, frames = segments_and_frames(tree)
    index = {body.name: i for i, body in enumerate(tree.bodies)}
    tip = index[tree.end_point.body]
    at = {body.joint.name: i for i, body in enumerate(tree.bodies)}
    own = [(i, i) for i in range(len(tree.bodies))]
    springs, dampers = [pair for pair in own if tree.bodies[pair[0]].joint.stiffness is not None], own
    if tree.stiffness_matrix is not None:
        springs += _pairs([at[name] for name in tree.stiffness_matrix.joints])
    if tree.damping_matrix is not None:
        names = [at[name] for name in tree.damping_matrix.joints]
        dampers = [pair for pair in own if pair[0] not in names] + _pairs(names)
    return Skeleton(
        segments=segments,
        tip=tip,
        tip_rotation=rounded(frames[tip].T @ np.array(tree.end_point.rotation)),
        rows=tuple(tree.end_point.rows),
        reference=tree.end_point.reference,
        placement=tuple(tree.placement),
        coupled_springs=tuple(springs),
        coupled_dampers=tuple(dampers),
    )


def _pairs(members: list[int]) -> list[tuple[int, int]]:
    return [(min(a, b), max(a, b)) for i, a in enumerate(members) for b in members[i:]]


def rounded(matrix: Matrix) -> Numbers:
    """A (k, 3) matrix by rows, what is meant to be 0 or ±1 exactly that."""
    nearest = np.round(matrix)
    snapped = np.where(np.abs(matrix - nearest) < SNAP, nearest, matrix) + 0.0
    return tuple((float(a), float(b), float(c)) for a, b, c in snapped)


def segments_and_frames(tree: Tree) -> tuple[tuple[Segment, ...], list[Matrix]]:
    """The segments, and of each body the rotation from its new frame to the one that the tree gives it."""
    index = {body.name: i for i, body in enumerate(tree.bodies)}
    segments: list[Segment] = []
    frames: list[Matrix] = []
    after_hinge: list[bool] = []  # between the ground and the body, itself included, there is a hinge
    only_parallel: list[bool] = []  # … and all such hinges are parallel
    for body in tree.bodies:
        parent = -1 if body.parent is None else index[body.parent]
        of_parent = np.eye(3) if parent < 0 else frames[parent]
        placed = of_parent.T @ np.array(body.rotation)
        axis = rounded(np.atleast_2d(placed @ np.array(body.joint.axis)))[0]
        slide = body.joint.kind == "slide"
        turn = rounded(np.eye(3) if slide else np.array(axes_about(axis)).T)
        frames.append(np.array(rounded(placed.T @ np.array(turn))))
        hinged = parent >= 0 and after_hinge[parent]
        same = slide or not hinged or abs(turn[2][2]) == 1
        only_parallel.append(same and (parent < 0 or only_parallel[parent]))
        after_hinge.append(hinged or not slide)
        segments.append(
            Segment(
                parent=parent,
                slide=slide,
                turn=turn,
                axis=axis if slide else (0.0, 0.0, 1.0),
                passive=body.joint.passive,
                in_row=hinged and not slide and turn[2][2] == 1,
                parallel=not slide and only_parallel[-1],
            )
        )
    return tuple(segments), frames
