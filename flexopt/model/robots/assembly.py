"""A robot's description and its machine file in, the dictionary of a `Tree` out.

Fixed and locked joints merge: their links become one body, whose inertia is composed exactly. A compliant base is a
series of massless bodies under the root link: slides along x, y, z of the anchor frame, then hinges yaw, pitch, roll,
so that its turn is Rz(yaw) Ry(pitch) Rx(roll) and at rest their axes are those of the anchor frame.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from flexopt.errors import Fault
from flexopt.foundation.quantities import degrees_hint
from flexopt.model.hydraulics import Cylinder
from flexopt.model.robots.bodies import Body, body_name, plain, tree_joint
from flexopt.model.robots.description import Description, Frame, Joint, RobotLink
from flexopt.model.robots.elements import there_are
from flexopt.model.robots.geometry import Inertial, Pose, shift
from flexopt.model.robots.overlay import DIRECTIONS, CapsuleTable, Overlay
from flexopt.model.robots.roles import Role, Roles

CHAIN = ("x", "y", "z", "yaw", "pitch", "roll")
AXES = {"x": 0, "y": 1, "z": 2, "roll": 0, "pitch": 1, "yaw": 2}
STANDARD_GRAVITY = 9.81


class Assembly:
    """Builds the bodies; `faults` tells what went wrong, `bodies` is complete where nothing did."""

    def __init__(self, robot: Description, overlay: Overlay, *, from_collisions: bool = False) -> None:
        self.robot = robot
        self.overlay = overlay
        self.faults: list[Fault] = []
        self.warnings: list[str] = []
        self.bodies: list[Body] = []
        self._carriers: dict[str | None, tuple[Body | None, Pose]] = {None: (None, Pose())}
        links = self._subtree()
        if self.faults:
            return
        self._roles = Roles(robot, overlay, links)
        self.faults += self._roles.faults
        for link in links:
            self._place(link)
        for word, blocker in robot.blockers.items():
            lifted = overlay.gravity is not None if word == "gravity" else word in overlay.ignore
            hint = "" if word == "gravity" else f'; ignore = ["{word}"] in the machine file reads the robot without'
            if not lifted:
                self.faults += [Fault(f.field, f.sentence + hint, f.value) for f in blocker.faults]
        self._end_point = self._find_end_point()
        self._cylinders = [self._cylinder(index, table) for index, table in enumerate(overlay.cylinders)]
        self._capsules = [self._capsule(index, table) for index, table in enumerate(overlay.capsules)]
        if from_collisions:
            self._capsules += [capsule for link in links for capsule in self._round(link)]
            if not self._capsules:
                self.warnings.append('capsules = "collision": no link that moves has collision geometry that is read')
        self._note_order()
        self._visuals = [visual for link in links for visual in self._seen(link)]
        massless = not any(body.inertial.mass or body.inertial.tensor.any() for body in self.bodies)
        if links and massless and not (overlay.payload.mass or self.faults):
            sentence = "no link that moves has a mass (<inertial>): this description is of the geometry alone"
            self.faults.append(Fault("robot", sentence, repr(overlay.robot)))

    def tree(self) -> dict[str, Any]:
        """The layout of `Tree`."""
        overlay, end = self.overlay, self.overlay.end_point
        body, pose = self._end_point
        pose = pose @ Pose(np.array(end.offset), np.array(end.rotation))
        gravity = overlay.gravity if overlay.gravity is not None else self.robot.gravity
        return {
            "name": overlay.name,
            "description": overlay.description,
            "source": overlay.source,
            "gravity": STANDARD_GRAVITY if gravity is None else gravity,
            "bodies": tuple(body.to_dict() for body in self.bodies),
            "end_point": {
                "body": body,
                "position": plain(pose.position),
                "rotation": tuple(plain(row) for row in pose.rotation),
                "rows": end.rows,
                "reference": end.reference,
                "length": end.length,
            },
            "placement": overlay.placement,
            "payload": overlay.payload.model_dump(),
            "capsules": tuple(self._capsules),
            "visuals": tuple(self._visuals),
            "cylinders": tuple(self._cylinders),
            "support": overlay.support and overlay.support.model_dump(),
            "loop": overlay.loop and overlay.loop.model_dump(exclude_unset=True),
            "uncertainty": tuple(each.model_dump(exclude_unset=True) for each in overlay.uncertainty),
        } | self._matrices()

    def _subtree(self) -> list[RobotLink]:
        """The links below the root, which is cut from what carries it."""
        overlay, links = self.overlay, self.robot.links
        ground = [link.name for link in links if link.parent is None]
        root = overlay.root
        if root is not None and root not in {link.name for link in links}:
            hint = there_are(root, [link.name for link in links])
            self.faults.append(Fault("root", f"is no link of the robot file{hint}", repr(root)))
            return []
        if root is None and overlay.base is not None:
            if len(ground) > 1:
                listed = ", ".join(map(repr, ground))
                self.faults.append(Fault("root", f"is needed: which of {listed} stands on [base]?"))
            root = ground[0]
        if root is None:
            return list(links)
        kept: dict[str, RobotLink] = {}
        poses: dict[str | None, Pose] = {None: Pose()}
        for link in links:
            poses[link.name] = poses[link.parent] @ link.pose
            if link.name == root:
                own = link.joints if link.parent is None else ()
                kept[root] = replace(link, parent=None, pose=poses[root], joints=own)
            elif link.parent in kept:
                kept[link.name] = link
        if overlay.base is not None:
            kept[root] = self._stand(kept[root])
        return list(kept.values())

    def _stand(self, root: RobotLink) -> RobotLink:
        """Put the base's coordinates under the root link, in place of its free joint if it has one."""
        base = self.overlay.base
        assert base is not None
        position = root.pose.position if base.position is None else np.array(base.position)
        rotation = root.pose.rotation if base.rotation is None else np.array(base.rotation)
        point = rotation @ np.array(base.point)
        own = tuple(joint for joint in root.joints if joint.kind != "free")
        springs, dampers = base.stiffness, base.damping
        free = [d for d in CHAIN if not isinstance(springs, dict) or d in springs]
        place = shift(position + point)
        for index, direction in enumerate(free):
            joint: dict[str, Any] = {
                "name": f"base.{direction}",
                "kind": "slide" if direction in "xyz" else "hinge",
                "axis": plain(np.eye(3)[AXES[direction]]),
                "passive": True,
            }
            if isinstance(springs, dict):
                joint["stiffness"] = springs[direction]
            if isinstance(dampers, dict):
                joint["damping"] = dampers.get(direction, 0.0)
            last = index == len(free) - 1 and not own
            name = body_name(root.name) if last else f"{root.name}.{direction}"
            parent = self.bodies[-1].name if self.bodies else None
            self.bodies.append(Body(name, parent, joint, place, Inertial(), root.element if last else None, None))
            place = Pose()
        carried = Pose(-point, rotation)
        self._carriers[None] = (self.bodies[-1], Pose()) if self.bodies else (None, shift(position + point))
        return replace(root, pose=carried, joints=own)

    def _matrices(self) -> dict[str, Any]:
        """The base's full matrices, over its joints in the order of `DIRECTIONS`."""
        base = self.overlay.base
        names = tuple(f"base.{direction}" for direction in DIRECTIONS)
        found = {} if base is None else {"stiffness_matrix": base.stiffness, "damping_matrix": base.damping}
        return {key: {"joints": names, "matrix": value} for key, value in found.items() if not isinstance(value, dict)}

    def _place(self, link: RobotLink) -> None:
        """Add the bodies of the link's moving joints and merge the link into the last."""
        body, pose = self._carriers[link.parent]
        pose = pose @ link.pose
        moving = [joint for joint in link.joints if self._roles.moves(joint)]
        for joint in link.joints:
            role = self._roles.of[joint.name]
            if role.kind == "locked":
                pose = pose @ joint.displaced(role.value - joint.zero)
                continue
            name = body_name(link.name) if joint is moving[-1] else f"{link.name}.{joint.name}"
            # The joint's frame at coordinate 0, which lies `zero` before the pose that the file describes.
            place = pose @ joint.displaced(-joint.zero) @ shift(joint.anchor)
            parent = body.name if body else None
            self._check_turns(joint, role)
            body = Body(name, parent, tree_joint(joint, role), place, Inertial(), link.element, joint.element)
            self.bodies.append(body)
            pose = shift(-joint.anchor)
        self._carriers[link.name] = (body, pose)
        if body is None:
            return
        if link.inertial is None:
            self.faults.append(Fault(f"{link.element.place}: {link.element.label}", link.why))
        else:
            body.inertial = body.inertial + link.inertial.seen_from(pose)

    def _note_order(self) -> None:
        """Tell what of the file is read otherwise than it may be meant."""
        listed = self.overlay.actuated
        order = [body.joint["name"] for body in self.bodies if body.joint["name"] in listed]
        # The place in the list of the nearest driven joint, of each body.
        place: dict[str | None, int] = {None: -1}
        inward = False
        for body in self.bodies:
            above, name = place[body.parent], body.joint["name"]
            place[body.name] = listed.index(name) if name in listed else above
            inward |= place[body.name] < above
        if inward:
            sentence = "is not in the order from the base outwards, which postures have"
            self.warnings.append(f"actuated: {sentence}: {', '.join(order)}")
        end = self.overlay.end_point
        if "length" in end.model_fields_set and not {"roll", "pitch", "yaw"} & set(end.rows):
            sentence = "scales roll, pitch and yaw among the rows, and there are none; offset says where it is"
            self.warnings.append(f"end_point.length: {sentence}")

    def _check_turns(self, joint: Joint, role: Role) -> None:
        low, high = role.limits or (0.0, 0.0)
        if joint.kind == "hinge" and (degrees_hint("rad", low) or degrees_hint("rad", high)):
            meant = f"in degrees they would be {math.radians(low):.4g} to {math.radians(high):.4g} rad"
            sentence = f"limits {low:g} to {high:g} rad reach beyond two turns and are cut there; {meant}"
            self.warnings.append(f"{joint.element.place}: {joint.element.label}: {sentence}")

    def _find_end_point(self) -> tuple[str, Pose]:
        """Body and pose of the frame that the overlay names."""
        link, site = self.overlay.end_point.link, self.overlay.end_point.site
        word, name = ("link", link) if link is not None else ("site", site or "")
        below = [link for link in self._carriers if link is not None]
        known = {link: Frame(link, Pose()) for link in below}
        if word == "site":
            known = {name: frame for name, frame in self.robot.sites.items() if frame.link in below}
        if name not in known:
            hint = there_are(name, known) if known else "; the file has none"
            self.faults.append(Fault(f"end_point.{word}", f"is no {word} of the robot{hint}", repr(name)))
            return "", Pose()
        frame = known[name]
        body, pose = self._carriers[frame.link]
        if body is None:
            self.faults.append(Fault(f"end_point.{word}", "is fixed to the ground", repr(name)))
        return body.name if body else "", pose @ frame.pose

    def _capsule(self, index: int, table: CapsuleTable) -> dict[str, Any]:
        """In the layout of `Capsule`, its ends in the axes of the body that the link is part of."""
        body, pose = self._carriers.get(table.link, (None, Pose()))
        if body is None:
            links = [link for link in self._carriers if link is not None]
            sentence = f"is no link of the robot{there_are(table.link, links)}"
            if table.link in links:
                sentence = "is fixed to the ground; capsules are of bodies that move"
            self.faults.append(Fault(f"capsules[{index}].link", sentence, repr(table.link)))
            return {}
        start, end = (plain((pose @ Pose(np.array(place))).position) for place in (table.start, table.end))
        return _filled(body, table.link, start, end, table.radius)

    def _round(self, link: RobotLink) -> list[dict[str, Any]]:
        """Capsules round the link's collision geometry; none where it is fixed to the ground."""
        body, pose = self._carriers[link.name]
        found: list[dict[str, Any]] = []
        if body is None:
            return found
        for solid in link.solids:
            if solid.why:
                self.warnings.append(f"{solid.element.place}: {link.element.label}: collision geometry {solid.why}")
                continue
            start, end = (plain((pose @ Pose(place)).position) for place in (solid.start, solid.end))
            found.append(_filled(body, link.name, start, end, solid.radius))
        return found

    def _seen(self, link: RobotLink) -> list[dict[str, Any]]:
        """What pictures draw of the link, in the layout of `Visual`, in the axes of the body that it is part of."""
        body, pose = self._carriers[link.name]
        moved = [visual.seen_from(pose) for visual in link.visuals]
        return [
            {"body": body and body.name, "shape": visual.shape, "file": visual.file, "why": visual.why,
             "matrix": tuple(plain(row) for row in visual.matrix), "position": plain(visual.position)}
            for visual in moved
        ]  # fmt: skip

    def _cylinder(self, index: int, cylinder: Cylinder) -> dict[str, Any]:
        """Its pins in the axes of the bodies that the joint's links are part of."""
        layout = cylinder.model_dump(exclude_unset=True, exclude_none=True)
        link = next((link for link in self.robot.links for j in link.joints if j.name == cylinder.joint), None)
        if link is None or link.name not in self._carriers:
            return layout  # the tree has no such joint, and says so
        if sum(self._roles.moves(joint) for joint in link.joints) > 1:
            sentence = f"moves link {link.name!r} together with others; the cylinder's pins would belong to no link"
            self.faults.append(Fault(f"cylinders[{index}] ({cylinder.name}).joint", sentence, repr(cylinder.joint)))
        parent = self._carriers[link.parent if link.parent in self._carriers else None][1]
        own, rocker = self._carriers[link.name][1], layout.get("rocker", {})
        for table, key, pose in (
            (layout, "base_point", parent), (layout, "rod_point", own),
            (rocker, "pivot", parent), (rocker, "coupler_point", own),
        ):  # fmt: skip
            if len(table.get(key, ())) == 3:
                table[key] = plain((pose @ Pose(np.array(table[key]))).position)
        return layout

    def located(self, fault: Fault) -> Fault:
        """A fault of the tree in the words of the files it was made from."""
        field = fault.field
        if field == "bodies":
            sentence = "no passive coordinate: give [base] a stiffness, or a joint one ([joints.NAME])"
            return Fault("base", sentence) if "passive" in fault.sentence else fault
        for word in ("stiffness", "damping"):
            if field.startswith(f"{word}_matrix"):
                return Fault(f"base.{word}", fault.sentence, fault.value)
        if not field.startswith("bodies["):
            return fault
        body = self.bodies[int(field[len("bodies[") : field.index("]")])]
        _, _, key = field.partition(")")
        element, key = (body.joint_element, key[len(".joint") :]) if key.startswith(".joint") else (body.link, key)
        if element is None:
            return Fault(f"base (joint {body.joint['name']!r}){key}", fault.sentence, fault.value)
        return Fault(f"{element.place}: {element.label}{key.replace('.', ' ')}", fault.sentence, fault.value)


def _filled(body: Body, link: str, start: tuple[float, ...], end: tuple[float, ...], radius: float) -> dict[str, Any]:
    """A capsule of a link, in the layout of `Capsule`; labelled where the body is called otherwise."""
    capsule = {"body": body.name, "start": start, "end": end, "radius": radius}
    return capsule if body.name == body_name(link) else capsule | {"label": link}
