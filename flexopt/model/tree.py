"""A spatial machine as validated data: the tables of `KinematicTree` as a file or a dictionary gives them.

Readers of robot files end here. Gravity acts along −z.
"""

from __future__ import annotations

from flexopt.errors import Fault, ModelError, raise_if_any
from flexopt.foundation.arrays import TableLike
from flexopt.foundation.boundary import public
from flexopt.model.file_model import read_table, validated
from flexopt.model.kinematic_tree import (
    INERTIA_ENTRIES,
    EndPoint,
    JointMatrix,
    KinematicTree,
    Placement,
    TreeBody,
    TreeJoint,
)
from flexopt.model.machine import AnyMachine, NamedParameter, Parameter
from flexopt.model.tables import Payload, Polygon, Visual
from flexopt.model.tree_faults import tree_faults


class Tree(AnyMachine):
    """A spatial machine: bodies in topological order (each after its parent), compliance, end-point, placement.

    Gravity acts along −z. `stiffness_matrix` and `damping_matrix` stand in for `stiffness` and `damping` of the passive
    joints that they name. `placement` lists the coordinates of the anchor frame that the operator chooses. `capsules`
    say what the bodies fill, `support` what the undercarriage stands on, `visuals` what pictures draw.

    Example:
        >>> machine = flexopt.load("slewing-excavator")
        >>> machine.joints, machine.base_coordinates
        (('slew', 'boom', 'stick', 'bucket'), ('x', 'y', 'yaw'))
        >>> len(machine.bodies)
        10
    """

    bodies: tuple[TreeBody, ...]
    end_point: EndPoint
    stiffness_matrix: JointMatrix | None = None
    damping_matrix: JointMatrix | None = None
    placement: tuple[Placement, ...] = ("x", "y", "yaw")
    payload: Payload = Payload.model_construct()
    support: Polygon | None = None
    visuals: tuple[Visual, ...] = ()

    __hash__ = AnyMachine.__hash__

    def structural_faults(self) -> list[Fault]:
        """As of `tree_from_dict`."""
        return tree_faults(self.to_dict()) or self.part_faults()

    @property
    def passive_bodies(self) -> tuple[TreeBody, ...]:
        """Bodies on passive joints, in order."""
        return self.kinematic_tree.passive

    def build_tree(self) -> KinematicTree:
        """The tree as it stands in the file."""
        at = {body.joint.name: i for i, body in enumerate(self.bodies)}
        springs, dampers = (
            () if matrix is None else tuple(at[name] for name in matrix.joints)
            for matrix in (self.stiffness_matrix, self.damping_matrix)
        )
        return KinematicTree(
            bodies=self.bodies,
            end_point=self.end_point,
            placement=self.placement,
            entries={entry: parameter.name for entry, parameter in self.parameter_entries()},
            drawn=(None, *range(len(self.bodies))),
            coupled_springs=springs,
            coupled_dampers=dampers,
        )

    @property
    def support_points(self) -> tuple[tuple[float, ...], ...]:
        """Corners (x, y) of the polygon that the undercarriage stands on, m, counter-clockwise; empty without one."""
        return () if self.support is None else self.support.polygon

    @property
    def visual_shapes(self) -> tuple[Visual, ...]:
        """See `AnyMachine`."""
        return self.visuals

    def parameter_entries(self) -> list[NamedParameter]:
        """See `AnyMachine`.

        Directions (axes, rotations) are no parameters, nor are mass and inertia of a body that has none and a zero
        armature.
        """
        listed: list[NamedParameter] = []
        for i, body in enumerate(self.bodies):
            listed += _vector(f"offset{i}", f"{body.name}.position", body.position)
            if not body.massless:
                listed.append((f"mass{i}", Parameter(f"{body.name}.mass", body.mass, "kg")))
                listed += _vector(f"com{i}", f"{body.name}.com", body.com)
                listed += [
                    (f"inertia{i}.{entry}", Parameter(f"{body.name}.inertia.{entry}", value, "kg m²"))
                    for entry, value in zip(INERTIA_ENTRIES, body.inertia, strict=True)
                ]
            listed += self._joint_entries(i, body.joint)
        for word, coupling in (("stiffness", self.stiffness_matrix), ("damping", self.damping_matrix)):
            listed += self._matrix_entries(word, coupling)
        listed += _vector("tip", "end_point.position", self.end_point.position)
        listed.append(("payload", Parameter("payload.mass", self.payload.mass, "kg")))
        return [*listed, ("gravity", Parameter("gravity", self.gravity, "m/s²"))]

    def _joint_entries(self, i: int, joint: TreeJoint) -> list[NamedParameter]:
        turn, name = joint.kind == "hinge", joint.name
        spring, damper, unit = ("N m/rad", "N m s/rad", "rad") if turn else ("N/m", "N s/m", "m")
        rotor = Parameter(f"{name}.armature", joint.armature, "kg m²" if turn else "kg")
        listed = [(f"armature{i}", rotor)] if joint.armature else []
        if not joint.passive:
            return [*listed, (f"damping{i}.{i}", Parameter(f"{name}.joint_damping", joint.joint_damping, damper))]
        if joint.stiffness is not None:
            listed.append((f"stiffness{i}.{i}", Parameter(f"{name}.stiffness", joint.stiffness, spring)))
        if self.damping_matrix is None or name not in self.damping_matrix.joints:
            listed.append((f"damping{i}.{i}", Parameter(f"{name}.damping", joint.damping, damper)))
        return [*listed, (f"rest{i}", Parameter(f"{name}.rest", joint.rest, unit))]

    def _matrix_entries(self, word: str, coupling: JointMatrix | None) -> list[NamedParameter]:
        """The upper triangle, row by row."""
        if coupling is None:
            return []
        at = {body.joint.name: i for i, body in enumerate(self.bodies)}
        turns = {body.joint.name for body in self.bodies if body.joint.kind == "hinge"}
        per = " s" if word == "damping" else ""
        units = (f"N{per}/m", f"N{per}", f"N m{per}/rad")
        listed: list[NamedParameter] = []
        for i, a in enumerate(coupling.joints):
            for j, b in enumerate(coupling.joints[i:]):
                inner, outer = sorted((at[a], at[b]))
                parameter = Parameter(f"{word}.{a}.{b}", coupling.matrix[i][i + j], units[(a in turns) + (b in turns)])
                listed.append((f"{word}{inner}.{outer}", parameter))
        return listed

    def __repr__(self) -> str:
        passive = ", ".join(body.joint.name for body in self.passive_bodies)
        return f"Tree({self.name!r}: passive joints: {passive}; actuated joints: {', '.join(self.joints)})"


def _vector(entry: str, name: str, values: tuple[float, float, float]) -> list[NamedParameter]:
    return [
        (f"{entry}.{axis}", Parameter(f"{name}.{axis}", value, "m")) for axis, value in zip("xyz", values, strict=True)
    ]


@public(error=ModelError)
def tree_from_dict(data: TableLike, *, origin: str = "tree") -> Tree:
    """Validate a dictionary in the layout of `Tree`; lists may stand for tuples.

    Args:
        data: the fields of `Tree`, nested.
        origin: what the message calls the source.

    Raises:
        ModelError: lists every fault.

    Example:
        >>> data = flexopt.load("truck-crane").to_dict()
        >>> data["payload"] = {"mass": 500.0}
        >>> flexopt.tree_from_dict(data).payload.mass
        500.0
    """
    frozen = read_table(data, origin, "flexopt.Tree")
    tree = validated(Tree, frozen, origin, tree_faults)
    raise_if_any(ModelError, origin, tree.part_faults())
    return tree
