"""A tree of bodies prepared for recursions: who carries whom, in frames that leave few constants.

In: a `KinematicTree`. Out: its `Skeleton`, numbers and words only. Each body gets a frame of its own choice. A slide's
keeps the orientation of its parent's, a hinge's turns about its z axis, so that the rotation from parent to body is
E Rz(q) with a constant E; where axes are parallel E = 1, where they are at right angles E is a signed permutation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexopt.foundation.arrays import Array
from flexopt.model.kinematic_tree import UNTURNED, KinematicTree
from flexopt.model.tree_quantities import axes_about, snapped_rows

MatrixRows = tuple[tuple[float, float, float], ...]
PLANES = ("xy", "xz", "yz")
# Axes that lie in one plane but for this, or along one line, give no further direction.
PARALLEL = 1e-6
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
        held: whether it stays at its rest value and is no coordinate.
        in_row: whether it is a hinge parallel to the last one before it: E = 1; in a plane also to its normal.
        parallel: whether it is a hinge parallel to all between it and the ground.
    """

    parent: int
    slide: bool
    turn: MatrixRows
    axis: tuple[float, float, float]
    passive: bool
    held: bool
    in_row: bool
    parallel: bool


@dataclass(frozen=True)
class Skeleton:
    """What decides the graphs of a tree: all but the values of its parameters. Equal ones share compiled code.

    Attributes:
        segments: the bodies, each after its parent.
        tip: index of the end-point's body; tip_rotation: of its frame in that body's.
        rows, reference, placement: as in `EndPoint` and `KinematicTree`.
        ground: the axes in which the recursions see the ground, as columns in the anchor frame's: those of the task's
            plane first, where it has one.
        up: which of these points up.
        coupled_springs, coupled_dampers: pairs of bodies whose joints have a stiffness or damping, i ≤ j.
        base: bodies on passive joints from the ground up to the first joint that gives as the base does already: that
            is the arm's, as an elastic root of a boom, which turns about an axis of the base.
        constants: names of all that its motion has;  zeros: those that are exactly zero and are left out.
        chain: whether it is a chain of parallel hinges in a vertical plane, on passive slides along its axes, without
            rotors and with all its mass beyond the slides: `ChainMotion` then has its motion in closed form.
        local: whether the placement's x and y count in the axes in which the anchor frame stands at first, instead of
            inertial ones: slides take them up although the frame is turned.
        also: what the anchor frame is driven along besides its placement: of x and y what that leaves out, `TURN`.
    """

    segments: tuple[Segment, ...]
    tip: int
    tip_rotation: MatrixRows
    rows: tuple[str, ...]
    reference: MatrixRows
    placement: tuple[str, ...]
    coupled_springs: tuple[tuple[int, int], ...]
    coupled_dampers: tuple[tuple[int, int], ...]
    base: tuple[int, ...] = ()
    ground: MatrixRows = UNTURNED
    up: int = 2
    constants: tuple[str, ...] = ()
    zeros: frozenset[str] = frozenset()
    chain: bool = False
    local: bool = False
    also: tuple[str, ...] = ()

    @property
    def n(self) -> int:
        """Number of bodies."""
        return len(self.segments)

    @property
    def drive(self) -> tuple[str, ...]:
        """Names of all that places the anchor frame during a motion."""
        return self.placement + self.also

    @property
    def order(self) -> list[int]:
        """Bodies in the order of q: on passive joints, then on actuated ones."""
        return self.passive + self.actuated

    @property
    def passive(self) -> list[int]:
        """Bodies on passive joints that move."""
        return [i for i, segment in enumerate(self.segments) if segment.passive and not segment.held]

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
    def hinges(self) -> list[int]:
        """Bodies on hinges."""
        return [i for i, segment in enumerate(self.segments) if not segment.slide]

    @property
    def axes_of_chain(self) -> list[MatrixRows]:
        """Of each hinge of a chain, the axes of its body where all joints are at zero, as columns in the ground's."""
        found: list[MatrixRows] = []
        for i in self.hinges:
            turn = np.array(self.segments[i].turn)
            found.append(snapped_rows(np.array(found[-1]) @ turn if found else turn))
        return found

    @property
    def has_plane(self) -> bool:
        """Whether the task's rows are two positions in order, whose plane the placement does not turn."""
        return "".join(self.rows) in PLANES and "yaw" not in self.placement

    def is_across(self, bodies: Sequence[int]) -> bool:
        """Whether there are hinges among the bodies of one branch, all parallel to the normal of the task's plane."""
        hinges = [self.segments[i] for i in bodies if not self.segments[i].slide]
        parallel = bool(hinges) and all(hinge.parallel for hinge in hinges)
        return self.has_plane and parallel and abs(hinges[0].turn[2][2]) == 1

    def sense_across(self, body: int) -> float:
        """1 where a body's hinge across the task's plane turns the first row towards the second, else −1."""
        hinges = [i for i in self.way_to(body) if not self.segments[i].slide]
        return self.segments[hinges[0]].turn[2][2] * self.sense_along(hinges[0], body)

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
            for name, direction in zip("xy", self.ground, strict=False):
                along = sum(a * b for a, b in zip(self.segments[i].axis, direction, strict=True))
                if name in self.drive and self.segments[i].passive and abs(along) == 1 and name not in found:
                    found[name] = (i, along)
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
        level = [self.segments[i] for i in slides if abs(self.segments[i].axis[self.up]) != 1]
        axes = sorted(tuple(abs(part) for part in segment.axis) for segment in level if segment.passive)
        sign = self.segments[after[0]].turn[2][2]
        if len(level) != len(axes) or axes != [(0.0, 1.0, 0.0), (1.0, 0.0, 0.0)] or abs(sign) != 1:
            return None
        return after[0], sign


def skeleton(tree: KinematicTree) -> Skeleton:
    """The structure of a tree, every constant kept."""
    segments, frames = segments_and_frames(tree)
    ground = snapped_rows(ground_frame(tree))
    tip = next(i for i, body in enumerate(tree.bodies) if body.name == tree.end_point.body)
    own = [(i, i) for i in range(len(tree.bodies))]
    springs = [pair for pair in own if f"stiffness{pair[0]}.{pair[0]}" in tree.entries]
    springs = [pair for pair in springs if pair[0] not in tree.coupled_springs] + _pairs(tree.coupled_springs)
    dampers = [pair for pair in own if pair[0] not in (*tree.coupled_dampers, *tree.held)]
    whole = Skeleton(
        segments=segments,
        tip=tip,
        tip_rotation=snapped_rows(frames[tip].T @ np.array(tree.end_point.rotation)),
        rows=tuple(tree.end_point.rows),
        reference=tree.end_point.reference,
        placement=tuple(tree.placement),
        coupled_springs=tuple(springs),
        coupled_dampers=(*dampers, *_pairs(tree.coupled_dampers)),
        base=_base(tree),
        ground=ground,
        up=[abs(part) for part in ground[tree.up]].index(1.0),
    )
    return replace(whole, chain=_is_chain(whole, tree))


def _base(tree: KinematicTree) -> tuple[int, ...]:
    """See `Skeleton.base`."""
    names = [body.name for body in tree.bodies]
    turned, given = dict[int, Array](), dict[int, dict[str, list[Array]]]()
    for i, body in enumerate(tree.bodies):
        before = -1 if body.parent is None else names.index(body.parent)
        if not body.joint.passive or (before >= 0 and before not in given):
            continue
        turned[i] = turned.get(before, np.eye(3)) @ np.array(body.rotation)
        kind, axis = body.joint.kind, turned[i] @ np.array(body.joint.axis)
        known = given.get(before, {"hinge": [], "slide": []})
        if not known[kind] or np.linalg.matrix_rank(np.array([*known[kind], axis]), tol=PARALLEL) > len(known[kind]):
            given[i] = known | {kind: [*known[kind], axis]}
    return tuple(given)


def _is_chain(s: Skeleton, tree: KinematicTree) -> bool:
    slides, hinges = s.leading_slides, s.hinges
    if not s.actuated or not s.is_across(hinges) or s.up != 1 or s.placement not in ((), s.rows[:1]):
        return False
    in_line = [segment.parent for segment in s.segments] == list(range(-1, s.n - 1)) and s.tip == s.n - 1
    upright = [tuple(abs(part) for part in s.segments[i].axis) for i in slides]
    standing = all(axis in UNTURNED[:2] and upright.count(axis) == 1 for axis in upright)
    plain = not tree.coupled_springs and not tree.coupled_dampers
    loaded = any(f"armature{i}" in tree.entries for i in range(s.n))
    loaded = loaded or any(f"mass{i}" in tree.entries for i in slides[:-1])
    passive = all(s.segments[i].passive for i in slides)
    return in_line and slides + hinges == list(range(s.n)) and standing and plain and passive and not loaded


def _pairs(members: tuple[int, ...]) -> list[tuple[int, int]]:
    return [(min(a, b), max(a, b)) for i, a in enumerate(members) for b in members[i:]]


def ground_frame(tree: KinematicTree) -> Array:
    """See `Skeleton.ground`."""
    rows = tree.end_point.rows
    if "".join(rows) not in PLANES or "yaw" in tree.placement:
        return np.eye(3)
    first, second = (UNTURNED["xyz".index(row)] for row in rows)
    return np.array([first, second, np.cross(first, second)]).T


def segments_and_frames(tree: KinematicTree) -> tuple[tuple[Segment, ...], list[Array]]:
    """The segments, and of each body the rotation from its new frame to the one that the tree gives it."""
    index = {body.name: i for i, body in enumerate(tree.bodies)}
    segments: list[Segment] = []
    frames: list[Array] = []
    after_hinge: list[bool] = []  # between the ground and the body, itself included, there is a hinge
    only_parallel: list[bool] = []  # … and all such hinges are parallel
    for number, body in enumerate(tree.bodies):
        parent = -1 if body.parent is None else index[body.parent]
        of_parent = ground_frame(tree) if parent < 0 else frames[parent]
        placed = of_parent.T @ np.array(body.rotation)
        axis = snapped_rows(np.atleast_2d(placed @ np.array(body.joint.axis)))[0]
        slide = body.joint.kind == "slide"
        turn = snapped_rows(np.eye(3) if slide else np.array(axes_about(axis)).T)
        frames.append(np.array(snapped_rows(placed.T @ np.array(turn))))
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
                held=number in tree.held,
                in_row=hinged and not slide and turn[2][2] == 1,
                parallel=not slide and only_parallel[-1],
            )
        )
    if all(segment.slide or segment.parallel for segment in segments):
        # What turns about the normal needs no axes of its own.
        unturned = [not segment.slide and segment.turn == UNTURNED for segment in segments]
        segments = [replace(s, in_row=s.in_row or same) for s, same in zip(segments, unturned, strict=True)]
    return tuple(segments), frames
