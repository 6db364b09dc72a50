"""Random trees in space, and the same machine in Pinocchio and in MuJoCo.

Both oracles are built from the dictionary that `tree_from_dict` reads, not from the validated `Tree`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

Data = dict[str, Any]


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    return pin.Quaternion(rng.normal(size=4)).normalized().toRotationMatrix()


def right_angled(rng: np.random.Generator) -> np.ndarray:
    """One of the 24 rotations that take axes to axes."""
    while True:
        matrix = np.eye(3)[rng.permutation(3)] * rng.choice([-1.0, 1.0], 3)
        if np.linalg.det(matrix) > 0:
            return matrix


def random_inertia(rng: np.random.Generator) -> np.ndarray:
    """Of a cloud of six points: every inertia that a body can have."""
    points, weights = rng.normal(scale=0.4, size=(6, 3)), rng.uniform(0.5, 2, 6)
    points -= weights @ points / weights.sum()
    return sum(w * (p @ p * np.eye(3) - np.outer(p, p)) for w, p in zip(weights, points, strict=True))


def six(inertia: np.ndarray) -> list[float]:
    return [float(inertia[i, j]) for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]


def matrix_of(entries: list[float]) -> np.ndarray:
    xx, yy, zz, xy, xz, yz = entries
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def random_tree(seed: int, *, rows: tuple[str, ...] = ("x", "y", "z"), counts: tuple[int, int] | None = None) -> Data:
    """2 to 10 joints (or `counts`, passive and actuated ones), hinges and slides, branched or not, axes aligned or not."""
    rng, rotors = np.random.default_rng(seed), np.random.default_rng([seed, 1])
    n = int(rng.integers(2, 11))
    aligned, branched = rng.random() < 0.5, rng.random() < 0.5
    n_passive = int(rng.integers(1, n))
    if counts is not None:
        n_passive, n = counts[0], sum(counts)
    passive = rng.permutation([True] * n_passive + [False] * (n - n_passive))
    bodies = []
    for i in range(n):
        parent = i - 1 if not branched else int(rng.integers(-1, i))
        kind = str(rng.choice(["hinge", "hinge", "slide"]))
        axis = rng.choice([-1.0, 1.0]) * np.eye(3)[rng.integers(3)] if aligned else rng.normal(size=3)
        turn = right_angled(rng) if aligned else random_rotation(rng)
        position = np.where(rng.random(3) < (0.5 if aligned else 0.1), 0.0, rng.uniform(-1, 1, 3))
        joint: Data = {"name": f"j{i}", "kind": kind, "axis": list(axis), "passive": bool(passive[i])}
        if passive[i]:
            joint |= {"stiffness": float(rng.uniform(10, 1e3)), "damping": float(rng.uniform(0, 10))}
            joint["rest"] = float(rng.uniform(-0.5, 0.5))
        else:
            joint["joint_damping"] = float(rng.uniform(0, 5))
        if rotors.random() < 0.3:
            joint["armature"] = float(rotors.uniform(0.1, 5))
        bodies.append(
            {
                "name": f"b{i}",
                "parent": None if parent < 0 else f"b{parent}",
                "joint": joint,
                "position": list(position),
                "rotation": turn.tolist(),
                "mass": float(rng.uniform(0.5, 20)),
                "com": list(rng.uniform(-0.5, 0.5, 3)),
                "inertia": six(random_inertia(rng)),
            }
        )
    tip = n - 1 if not branched else int(rng.integers(n))
    rows = rows[: n - n_passive]
    end_point = {"body": f"b{tip}", "position": list(rng.uniform(-1, 1, 3)), "rotation": random_rotation(rng).tolist()}
    end_point |= {"rows": list(rows), "length": 0.7, "reference": random_rotation(rng).tolist()}
    data: Data = {"name": f"tree{seed}", "bodies": bodies, "end_point": end_point, "gravity": 9.81}
    data["payload"] = {"mass": float(rng.uniform(0, 5))}
    return data


def without_mass(body: Data) -> None:
    body |= {"mass": 0.0, "com": [0.0, 0.0, 0.0], "inertia": [0.0] * 6}


def grounded(arm: int, seed: int, *, coupled: bool = True) -> Data:
    """Six passive ground coordinates (slides x, y, z, hinges z, y, x) and an arm of hinges in a slewing machine's order."""
    rng = np.random.default_rng(seed)
    bodies: list[Data] = []
    for k, (kind, axis) in enumerate(
        [*(("slide", axis) for axis in (0, 1, 2)), *(("hinge", axis) for axis in (2, 1, 0))]
    ):
        spring = {"stiffness": 4e7, "damping": 50.0} if kind == "slide" else {"stiffness": 3e6, "damping": 25.0}
        joint = {"name": f"g{k}", "kind": kind, "axis": list(np.eye(3)[axis]), "passive": True} | spring
        bodies.append({"name": f"ground{k}", "parent": f"ground{k - 1}" if k else None, "joint": joint})
    bodies[-1] |= {
        "name": "chassis",
        "mass": 5291.5,
        "com": [0.1, 0.02, 0.4],
        "inertia": [900.0, 1000.0, 1100.0, 10.0, -20.0, 5.0],
    }
    parent, at = "chassis", [0.0, 0.0, 0.6]
    for k in range(arm):
        joint = {"name": f"a{k}", "kind": "hinge", "axis": [0.0, 0.0, 1.0] if k == 0 else [0.0, -1.0, 0.0]}
        mass = 1500.0 / (k + 1)
        inertia = np.diag([40.0, 300.0, 310.0]) / (k + 1)
        bodies.append({"name": f"arm{k}", "parent": parent, "joint": joint, "position": at, "mass": mass,
                       "com": [0.9, 0.0, 0.1], "inertia": six(inertia)})  # fmt: skip
        parent, at = f"arm{k}", [0.4, 0.0, 0.8] if k == 0 else [1.9, 0.0, 0.0]
    data: Data = {"name": "grounded", "bodies": bodies, "gravity": 9.81,
                  "end_point": {"body": parent, "position": [1.5, 0.0, 0.0], "rows": ["x", "y", "z"]}}  # fmt: skip
    if coupled:
        root = rng.normal(size=(6, 6)) * 0.2 + np.eye(6)
        scale = np.array([6e3] * 3 + [1.7e3] * 3)
        matrix = scale[:, None] * (root @ root.T) * scale
        names = [body["joint"]["name"] for body in bodies[:6]]
        for body in bodies[:6]:
            del body["joint"]["stiffness"], body["joint"]["damping"]
        data["stiffness_matrix"] = {"joints": names, "matrix": matrix.tolist()}
        data["damping_matrix"] = {"joints": names, "matrix": (matrix * 1e-4).tolist()}
    return data


def telescope(seed: int) -> Data:
    """A carriage on springs in the plane x, z, and a boom, a telescope and a blade, which all joints move.

    The telescope's mass and the blade's hinge lie on the slide's axis. As no force passes along that, how the blade moves
    in a mode is told by one number, which may be zero along whole curves of postures.
    """
    rng = np.random.default_rng(seed)
    springs = [("x", "slide", [1.0, 0.0, 0.0], (2e6, 3e6)), ("z", "slide", [0.0, 0.0, 1.0], (4e6, 6e6)),
               ("pitch", "hinge", [0.0, -1.0, 0.0], (4e6, 6e6))]  # fmt: skip
    bodies: list[Data] = []
    for name, kind, axis, stiffness in springs:
        joint = {"name": f"base.{name}", "kind": kind, "axis": axis, "passive": True}
        joint |= {"stiffness": rng.uniform(*stiffness), "damping": rng.uniform(5e3, 1e4)}
        bodies.append({"name": joint["name"], "parent": bodies[-1]["name"] if bodies else None, "joint": joint})
    bodies[-1] |= {"mass": rng.uniform(4e3, 8e3), "com": [rng.uniform(-0.4, 0.1), 0.0, rng.uniform(0.6, 0.9)],
                   "inertia": [2e3, rng.uniform(3e3, 6e3), 3e3, 0.0, 0.0, 0.0]}  # fmt: skip
    # Joint, kind, limits; where it is, how heavy, its centre and inertia between two ends each.
    for name, kind, limits, at, mass, com, inertia in (
        ("lift", "hinge", [-0.5, 0.9], ((0.0, 0.5), (1.2, 2.0)), (800, 1500), ((0.7, 1.2), (-0.1, 0.1)), (900, 1500)),
        ("extend", "slide", [0.1, 2.5], ((2.0, 2.6), (-0.1, 0.1)), (300, 700), ((-0.9, -0.3), (0, 0)), (400, 800)),
        ("tilt", "hinge", [-2.0, 0.8], ((0.0, 0.3), (0, 0)), (100, 250), ((0.3, 0.5), (-0.1, 0.1)), (8, 20)),
    ):
        axis = [0.0, -1.0, 0.0] if kind == "hinge" else [1.0, 0.0, 0.0]
        place, centre = ([rng.uniform(*x), 0.0, rng.uniform(*z)] for x, z in (at, com))
        own = rng.uniform(*inertia)
        joint = {"name": name, "kind": kind, "axis": axis, "limits": limits}
        bodies.append({"name": name, "parent": bodies[-1]["name"], "joint": joint, "position": place, "com": centre,
                       "mass": rng.uniform(*mass), "inertia": [0.1 * own, own, own, 0.0, 0.0, 0.0]})  # fmt: skip
    tip = [rng.uniform(0.7, 1.1), 0.0, rng.uniform(-0.2, 0.2)]
    return {"name": f"telescope{seed}", "bodies": bodies, "gravity": 9.81, "placement": ["x"],
            "end_point": {"body": "tilt", "position": tip, "rows": ["x", "z"]}}  # fmt: skip


def in_space(machine: Data) -> Data:
    """A planar machine's dictionary as a tree in the plane x, z: y becomes z, and hinges turn about −y."""
    base, bodies = machine["base"], []
    springs, dampers = base["stiffness"], base.get("damping", {})
    axes = {"x": ("slide", [1.0, 0.0, 0.0], 0.0), "y": ("slide", [0.0, 0.0, 1.0], 0.0)}
    axes["rotation"] = ("hinge", [0.0, -1.0, 0.0], base["rest_angle"])
    for direction, (kind, axis, rest) in axes.items():
        joint = {"name": f"base.{direction}", "kind": kind, "axis": axis, "passive": True, "rest": rest}
        joint |= {"stiffness": springs[direction], "damping": dampers.get(direction, 0.0)}
        bodies.append({"name": f"base.{direction}", "parent": bodies[-1]["name"] if bodies else None, "joint": joint})
    bodies[-1] |= _planar_body(base)
    at = base["length"]
    for link in machine["links"]:
        joint = {"name": link["name"], "kind": "hinge", "axis": [0.0, -1.0, 0.0]}
        if link.get("passive"):
            joint |= {
                "passive": True,
                "stiffness": link["stiffness"],
                "damping": link.get("damping", 0.0),
                "rest": link["rest"],
            }
        else:
            joint["joint_damping"] = link.get("joint_damping", 0.0)
        body = {"name": link["name"], "parent": bodies[-1]["name"], "joint": joint, "position": [at, 0.0, 0.0]}
        bodies.append(body | _planar_body(link))
        at = link["length"]
    end_point = {"body": bodies[-1]["name"], "position": [at, 0.0, 0.0], "rows": ["x", "z"]}
    return {"name": "planar", "bodies": bodies, "end_point": end_point, "gravity": machine["gravity"],
            "placement": ["x"], "payload": {"mass": machine.get("payload", {}).get("mass", 0.0)}}  # fmt: skip


def _planar_body(body: Data) -> Data:
    # Only yy is seen in the plane; xx and zz are what a thin body has.
    inertia = [0.3 * body["inertia"], body["inertia"], 0.9 * body["inertia"], 0.0, 0.0, 0.0]
    return {"mass": body["mass"], "com": [body["com"], 0.0, body.get("com_offset", 0.0)], "inertia": inertia}


def coordinate_order(data: Data) -> list[int]:
    """Body of each entry of q: passive first."""
    passive = [bool(body["joint"].get("passive")) for body in data["bodies"]]
    return sorted(range(len(passive)), key=lambda i: (not passive[i], i))


def rotation_of(entry: Data) -> np.ndarray:
    return np.array(entry.get("rotation", np.eye(3).tolist()))


@dataclass(frozen=True)
class PinocchioTree:
    model: Any
    data: Any
    order: list[int]
    tip: int
    reference: np.ndarray
    length: float
    rows: list[int]

    def _own(self, q: np.ndarray) -> np.ndarray:
        out = np.zeros(self.model.nv)
        out[self.order] = q
        return out

    def mass(self, q: np.ndarray) -> np.ndarray:
        full = pin.crba(self.model, self.data, self._own(q))
        full = np.triu(full) + np.triu(full, 1).T
        return full[np.ix_(self.order, self.order)]

    def gravity(self, q: np.ndarray) -> np.ndarray:
        return pin.computeGeneralizedGravity(self.model, self.data, self._own(q))[self.order].copy()

    def nonlinear_effects(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """h + g."""
        return pin.nonLinearEffects(self.model, self.data, self._own(q), self._own(v))[self.order].copy()

    def forward(self, q: np.ndarray, v: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Accelerations under joint forces and gravity."""
        return pin.aba(self.model, self.data, self._own(q), self._own(v), self._own(force))[self.order].copy()

    def frame(self, q: np.ndarray, base: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Position and rotation of the end-point's frame, the anchor frame at base = (x, y, yaw)."""
        pin.framesForwardKinematics(self.model, self.data, self._own(q))
        placed = self.data.oMf[self.tip]
        anchor = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, base[2]), np.array([base[0], base[1], 0.0]))
        placed = anchor * placed
        return placed.translation.copy(), placed.rotation.copy()

    def task(self, q: np.ndarray, base: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """All six rows and their Jacobian by q, the chosen ones; and the angle from the reference."""
        position, rotation = self.frame(q, base)
        relative = self.reference.T @ rotation
        local = pin.computeFrameJacobian(self.model, self.data, self._own(q), self.tip, pin.ReferenceFrame.LOCAL)
        local = local[:, self.order]
        rows = np.concatenate([position, self.length * pin.log3(relative)])
        jacobian = np.vstack([rotation @ local[:3], self.length * pin.Jlog3(relative) @ local[3:]])
        return rows[self.rows], jacobian[self.rows], float(np.linalg.norm(pin.log3(relative)))


def depth_first(bodies: list[Data], parent: str | None) -> list[Data]:
    found: list[Data] = []
    for body in bodies:
        if body.get("parent") == parent:
            found += [body, *depth_first(bodies, body["name"])]
    return found


def pinocchio_tree(data: Data) -> PinocchioTree:
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -data["gravity"]])
    ids, rotors = {None: 0}, {}
    for body in depth_first(data["bodies"], None):  # Pinocchio's crba wants each subtree in one piece
        joint, axis = body["joint"], np.array(body["joint"]["axis"])
        axis = axis / np.linalg.norm(axis)
        kind = pin.JointModelRevoluteUnaligned if joint["kind"] == "hinge" else pin.JointModelPrismaticUnaligned
        placement = pin.SE3(rotation_of(body), np.array(body.get("position", [0.0] * 3)))
        ids[body["name"]] = model.addJoint(ids[body.get("parent")], kind(axis), placement, joint["name"])
        mass = pin.Inertia(
            body.get("mass", 0.0), np.array(body.get("com", [0.0] * 3)), matrix_of(body.get("inertia", [0.0] * 6))
        )
        model.appendBodyToJoint(ids[body["name"]], mass, pin.SE3.Identity())
        rotors[ids[body["name"]]] = joint.get("armature", 0.0)
    end = data["end_point"]
    placement, carrier = pin.SE3(rotation_of(end), np.array(end["position"])), ids[end["body"]]
    payload = pin.Inertia(data.get("payload", {}).get("mass", 0.0), np.zeros(3), np.zeros((3, 3)))
    model.appendBodyToJoint(carrier, payload, placement)
    model.armature = np.array([rotors[joint] for joint in range(1, model.njoints)])
    tip = model.addFrame(pin.Frame("tip", carrier, placement, pin.FrameType.OP_FRAME))
    order = [model.joints[ids[data["bodies"][i]["name"]]].idx_v for i in coordinate_order(data)]
    rows = [["x", "y", "z", "roll", "pitch", "yaw"].index(row) for row in end["rows"]]
    reference = np.array(end.get("reference", np.eye(3)))
    return PinocchioTree(model, model.createData(), order, tip, reference, end.get("length", 1.0), rows)


@dataclass(frozen=True)
class MujocoTree:
    model: Any
    data: Any
    order: list[int]

    def set(self, q: np.ndarray, v: np.ndarray) -> None:
        self.data.qpos[self.order], self.data.qvel[self.order] = q, v
        mujoco.mj_forward(self.model, self.data)

    def mass(self) -> np.ndarray:
        full = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, self.data, full)
        return full[np.ix_(self.order, self.order)]

    def nonlinear_effects(self) -> np.ndarray:
        """h + g."""
        return self.data.qfrc_bias[self.order].copy()

    def end_point(self) -> np.ndarray:
        return self.data.site("tip").xpos.copy()

    def jacobian(self) -> np.ndarray:
        """Of the position (3, n) and, in inertial axes, of the orientation (3, n)."""
        position, turning = np.zeros((3, self.model.nv)), np.zeros((3, self.model.nv))
        mujoco.mj_jacSite(self.model, self.data, position, turning, self.model.site("tip").id)
        return np.vstack([position, turning])[:, self.order]

    def forward(self, torque: np.ndarray) -> np.ndarray:
        """Accelerations in the state that was set, springs and dampers acting."""
        self.data.qfrc_applied[self.order] = torque
        mujoco.mj_forward(self.model, self.data)
        return self.data.qacc[self.order].copy()


def mujoco_tree(data: Data, add: Callable[[Any, dict[str | None, Any]], None] | None = None) -> MujocoTree:
    """The machine without its `stiffness_matrix` and `damping_matrix`: MuJoCo has no coupled springs.

    A body without mass must carry one child only: MuJoCo wants its joint on that child. `add` may add to the MjSpec, whose
    bodies it gets by name.
    """
    spec = mujoco.MjSpec()
    spec.compiler.degree, spec.compiler.balanceinertia = False, False
    spec.option.gravity = [0.0, 0.0, -data["gravity"]]
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    made = {None: spec.worldbody}
    waiting: dict[str, list[Data]] = {}
    for entry in data["bodies"]:
        series = [*waiting.get(entry.get("parent"), []), entry]
        if not entry.get("mass", 0.0) and not any(entry.get("inertia", [])):
            waiting[entry["name"]] = series
            continue
        steps = [pin.SE3(rotation_of(one), np.array(one.get("position", [0.0] * 3))) for one in series]
        whole = pin.SE3.Identity()
        for step in steps:
            whole = whole * step
        body = made[series[0].get("parent")].add_body(name=f"body {entry['name']}", pos=whole.translation)
        body.quat = pin_quaternion(whole.rotation)
        body.explicitinertial, body.mass = True, entry.get("mass", 0.0)
        body.ipos, body.fullinertia = entry.get("com", [0.0] * 3), entry.get("inertia", [0.0] * 6)
        before = pin.SE3.Identity()
        for one, step in zip(series, steps, strict=True):
            before = before * step
            add_joint(body, one["joint"], whole.inverse() * before)
        made[entry["name"]] = body
    end = data["end_point"]
    tip = made[end["body"]]
    tip.add_site(name="tip", pos=end["position"], quat=pin_quaternion(rotation_of(end)))
    if data.get("payload", {}).get("mass", 0.0) > 0:
        load = tip.add_body(name="load", pos=end["position"])
        load.explicitinertial, load.mass, load.inertia, load.ipos = True, data["payload"]["mass"], [0.0] * 3, [0.0] * 3
    if add is not None:
        add(spec, made)
    model = spec.compile()
    order = [int(model.joint(data["bodies"][i]["joint"]["name"]).dofadr[0]) for i in coordinate_order(data)]
    return MujocoTree(model, mujoco.MjData(model), order)


def add_joint(body: Any, joint: Data, frame: Any) -> None:
    """A joint that stands at `frame`, seen from the body at zero."""
    kind = mujoco.mjtJoint.mjJNT_HINGE if joint["kind"] == "hinge" else mujoco.mjtJoint.mjJNT_SLIDE
    axis = frame.rotation @ np.array(joint["axis"])
    made = body.add_joint(
        name=joint["name"], type=kind, axis=axis, pos=frame.translation, springref=joint.get("rest", 0.0)
    )
    damping = joint.get("damping", 0.0) + joint.get("joint_damping", 0.0)
    made.armature = joint.get("armature", 0.0)
    made.stiffness = polynomial(made.stiffness, joint.get("stiffness", 0.0))
    made.damping = polynomial(made.damping, damping)


def polynomial(like: Any, linear: float) -> Any:
    """A spring's or damper's linear coefficient, where this MuJoCo has polynomials of them the first of these."""
    if np.ndim(like) == 0:
        return linear
    return [linear] + [0.0] * (np.size(like) - 1)


def pin_quaternion(rotation: np.ndarray) -> list[float]:
    x, y, z, w = pin.Quaternion(rotation).normalized().coeffs()
    return [w, x, y, z]
