"""A planar machine written as URDF and as MJCF, and how far apart results of the three are.

In the robot files the plane is that of x and z, and hinges turn about −y.
"""

from __future__ import annotations

import copy
import warnings
from pathlib import Path
from typing import Any

import numpy as np

import flexopt
from flexopt.errors import FlexoptError, FlexoptWarning
from flexopt.model import AnyMachine, machine_from_dict
from flexopt.model.robots import robot_from_dict
from flexopt.selection.nlp.program import single
from flexopt.selection.proof.check import prove
from flexopt.selection.proof.newton import settled
from tests.export.bundle_library import BundleLibrary
from tests.oracles.machines import NumpySource, Structure, draw_machine, draw_structure

Data = dict[str, Any]
Results = dict[str, tuple[Any, Any]]  # by name: values, and what their differences are relative to
CONDITION, TOLERANCE = 100.0, 1e-12
SLIDES = {"x": "1 0 0", "y": "0 0 1"}


def in_every_format(data: Data, folder: Path) -> dict[str, AnyMachine]:
    """The machine of a planar dictionary, read from each format."""
    machines: dict[str, AnyMachine] = {"TOML": machine_from_dict(data)}
    for name, text in (("urdf", urdf(data)), ("xml", mjcf(data))):
        folder.joinpath(f"machine.{name}").write_text(text, encoding="utf-8")
        told = overlay(data) | {"robot": f"machine.{name}"}
        machines[name] = robot_from_dict(told, folder=folder, origin="machine.toml")
    return machines


def _chain(data: Data) -> list[tuple[str, Data, Data | None, float]]:
    """Name, body, joint's table and distance from the last joint of the base and every link; a rigid base has none."""
    rotation = data["base"]["stiffness"].get("rotation")
    chain: list[tuple[str, Data, Data | None, float]] = [
        ("base", data["base"], None if rotation is None else data["base"], 0.0)
    ]
    for link in data["links"]:
        chain.append((link["name"], link, link, chain[-1][1]["length"]))
    return chain


def _free(data: Data) -> list[str]:
    return [direction for direction in SLIDES if direction in data["base"]["stiffness"]]


def urdf(data: Data) -> str:
    """Slides of the base, its hinge or a fixed joint turned to its rest angle, then the links."""
    parts, parent = ['<link name="ground"/>'], "ground"
    for direction in _free(data):
        parts.append(f'<link name="on.{direction}"/>')
        parts.append(_urdf_joint(f"base.{direction}", "prismatic", parent, f"on.{direction}", SLIDES[direction]))
        parent = f"on.{direction}"
    for name, body, joint, along in _chain(data):
        parts.append(
            f'<link name="{name}"><inertial><origin xyz="{body["com"]!r} 0 {body.get("com_offset", 0.0)!r}"/>'
            f'<mass value="{body["mass"]!r}"/><inertia ixx="{body["inertia"] / 2!r}" ixy="0" ixz="0" '
            f'iyy="{body["inertia"]!r}" iyz="0" izz="{body["inertia"] / 2!r}"/></inertial></link>'
        )
        if joint is None:
            origin = f'<origin rpy="0 {-data["base"]["rest_angle"]!r} 0"/>'
            parts.append(_urdf_joint("base.weld", "fixed", parent, name, "", origin))
        else:
            origin = f'<origin xyz="{along!r} 0 0"/>'
            joint_name = "base.rotation" if name == "base" else name
            parts.append(_urdf_joint(joint_name, "continuous", parent, name, "0 -1 0", origin))
        parent = name
    return f'<?xml version="1.0"?>\n<robot name="machine">\n{chr(10).join(parts)}\n</robot>\n'


def _urdf_joint(name: str, kind: str, parent: str, child: str, axis: str, inside: str = "") -> str:
    limit = f'<limit lower="-{1e3!r}" upper="{1e3!r}" effort="0" velocity="0"/>' if kind == "prismatic" else ""
    direction = f'<axis xyz="{axis}"/>' if axis else ""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f"{inside}{direction}{limit}</joint>"
    )


def mjcf(data: Data) -> str:
    """All joints of the base on one body; the hinge of one that cannot turn is its frame's rotation."""
    opening, closing = "", ""
    for name, body, joint, along in _chain(data):
        turn = "" if joint is not None else f' axisangle="0 -1 0 {data["base"]["rest_angle"]!r}"'
        slides = _free(data) if name == "base" else []
        if slides and joint is None:
            opening += '<body name="on">'
            opening += "".join(f'<joint name="base.{d}" type="slide" axis="{SLIDES[d]}"/>' for d in slides)
            closing, slides = "</body>" + closing, []
        opening += f'<body name="{name}" pos="{along!r} 0 0"{turn}>'
        opening += "".join(f'<joint name="base.{d}" type="slide" axis="{SLIDES[d]}"/>' for d in slides)
        if joint is not None:
            hinge = "base.rotation" if name == "base" else name
            opening += f'<joint name="{hinge}" type="hinge" axis="0 -1 0"/>'
        half = body["inertia"] / 2
        opening += (
            f'<inertial pos="{body["com"]!r} 0 {body.get("com_offset", 0.0)!r}" mass="{body["mass"]!r}" '
            f'diaginertia="{half!r} {body["inertia"]!r} {half!r}"/>'
        )
        closing = "</body>" + closing
    return f'<mujoco model="machine"><compiler angle="radian"/><worldbody>{opening}{closing}</worldbody></mujoco>\n'


def overlay(data: Data) -> Data:
    """The machine file around either."""
    base, links = data["base"], data["links"]
    joints: Data = {}
    for direction, stiffness in base["stiffness"].items():
        damping = base.get("damping", {}).get(direction, 0.0)
        joints[f"base.{direction}"] = {"stiffness": stiffness, "damping": damping}
    if "rotation" in base["stiffness"]:
        joints["base.rotation"]["rest"] = base["rest_angle"]
    for link in links:
        said = {key: link[key] for key in ("limits", "effort", "speed", "stiffness", "rest") if key in link}
        damping = link.get("damping" if link.get("passive") else "joint_damping", 0.0)
        joints[link["name"]] = said | {"damping": damping}
    told = {
        "name": data["name"],
        "actuated": [link["name"] for link in links if not link.get("passive")],
        "gravity": data.get("gravity", 9.81),
        "placement": ["x"],
        "joints": joints,
        "end_point": {"link": links[-1]["name"], "offset": [links[-1]["length"], 0.0, 0.0], "rows": ["x", "z"]},
        "payload": {"mass": data.get("payload", {}).get("mass", 0.0)},
        "capsules": [
            {"link": c["body"], "start": _raised(c["start"]), "end": _raised(c["end"]), "radius": c["radius"]}
            for c in data.get("capsules", ())
        ],
        "cylinders": [_in_space(cylinder) for cylinder in data.get("cylinders", ())],
    }
    if "support" in data:
        rear, front = data["support"]["span"]
        told["support"] = {"polygon": [[rear, -1.0], [front, -1.0], [front, 1.0], [rear, 1.0]]}
    return told


def _raised(point: Any) -> list[float]:
    """Along and left as x and z."""
    return [point[0], 0.0, point[1]]


def _in_space(cylinder: Data) -> Data:
    said = copy.deepcopy(dict(cylinder))
    for table, keys in ((said, ("base_point", "rod_point")), (said.get("rocker") or {}, ("pivot", "coupler_point"))):
        table.update({key: _raised(table[key]) for key in keys if table.get(key) is not None})
    return said


def differences(data: Data, folder: Path, *, seed: int, searches: bool = True) -> dict[str, float]:
    """Largest difference of each result between the planar file and the robot files, relative to its size.

    Args:
        data: of a planar machine.
        folder: to write files to.
        seed: of postures and targets.
        searches: whether to select, map, simulate and export, too.
    """
    found: dict[str, Results] = {}
    for name, machine in in_every_format(data, folder).items():
        with warnings.catch_warnings():
            # Numbers of random machines need not be plausible.
            warnings.simplefilter("ignore", FlexoptWarning)
            rng = np.random.default_rng(seed)
            found[name] = analysis(machine, rng)
            if searches:
                found[name] |= selection(machine, rng) | simulation(machine, rng) | maps(machine)
                found[name] |= exported(machine, folder / name)
    plane, *others = found.values()
    largest: dict[str, float] = {}
    for key, (values, size) in plane.items():
        for other in others:
            assert other.keys() == plane.keys()
            there = np.asarray(other[key][0], dtype=float)
            here = np.asarray(values, dtype=float)
            assert there.shape == here.shape, key
            np.testing.assert_array_equal(np.isnan(there), np.isnan(here), err_msg=key)
            away = float(np.nanmax(np.abs(there - here) / np.where(np.equal(size, 0.0), 1.0, size), initial=0.0))
            largest[key] = max(largest.get(key, 0.0), away)
    return largest


def random_dict(seed: int, structure: Structure | None = None) -> Data:
    """A random planar machine."""
    source = NumpySource(np.random.default_rng(seed))
    return draw_machine(source, structure or draw_structure(source))


def _regular(machine: AnyMachine, rng: np.random.Generator) -> np.ndarray:
    """A posture inside the limits, well away from singular ones."""
    plant = flexopt.build_plant(machine)
    low, high = np.clip(np.array(machine.limits).T, -3.0, 3.0)
    postures = rng.uniform(low, high, (40, low.size))
    sines = [float(plant.singularity_sine_squared(0.0, z, plant.parameter_values)) for z in postures]
    return postures[int(np.argmax(sines))]


def analysis(machine: AnyMachine, rng: np.random.Generator) -> Results:
    """Graphs in any configuration, measures in a regular posture, branches of the arm."""
    plant = flexopt.build_plant(machine)
    assert plant.closed_form
    p, n, base = plant.parameter_values, plant.n_coordinates, rng.uniform(-1.0, 1.0, 1)
    q, v, posture = rng.uniform(-2.0, 2.0, n), rng.uniform(-2.0, 2.0, n), _regular(machine, rng)
    mass = plant.mass(q, base, p).full()
    heavy = np.linalg.norm(mass)
    results: Results = {"mass": (mass, heavy)}
    results["bias"] = plant.bias(q, v, base, p).full(), heavy * (v @ v)
    results["gravity"] = plant.gravity(q, base, p).full(), heavy * machine.gravity
    for name in ("end_point", "jacobian", "rest", "singularity_sine_squared", "singularity_gradient", "arm_segments"):
        given = {"q": q, "base": base, "posture": posture, "p": p}
        function = getattr(plant, name)
        for output, value in function(**{key: given[key] for key in function.name_in()}).items():
            results[f"{name}.{output}"] = value.full(), max(1.0, float(np.linalg.norm(value.full())))
    e = flexopt.evaluate(machine, posture, base=base)
    results |= {
        "frequencies": (e.frequencies_hz, e.frequencies_hz.max()),
        "w": (e.w, e.scale.max()),
        "epsilon_max": (e.epsilon_max, 1.0),
        "condition": (e.rigid, max(1e-3, abs(e.rigid))),
    }
    end_point = plant.end_point(plant.rest(base, posture, p), base, p).full().ravel()
    for elbow in ("up", "down"):
        reached = flexopt.inverse_kinematics(machine, end_point, base=base, elbow=elbow, seed=1)[:8]
        results[f"elbow {elbow}"] = np.array(reached), 1.0
    return results


def selection(machine: AnyMachine, rng: np.random.Generator) -> Results:
    """Candidates for a target that the arm reaches, ranked."""
    plant = flexopt.build_plant(machine)
    posture, base = _regular(machine, rng), np.zeros(1)
    target = plant.end_point(plant.rest(base, posture, plant.parameter_values), base, plant.parameter_values)
    weights = [1.0] * plant.n_passive
    try:
        found = flexopt.select(
            machine, target.full().ravel(), objective="V", weights=weights, base_range=(-2.0, 2.0), seed=1
        )
    except FlexoptError as error:
        return {f"select: {type(error).__name__}": (0.0, 1.0)}
    scale, best = found.problem.objective_scale, {"best": (found.best.objective, found.problem.objective_scale)}
    if plant.n_passive < found.problem.redundancy:
        # All w_i vanish together on a set of that dimension less: where on it a search ends is rounding's choice.
        return best
    z = np.array([c.z for c in found.candidates])
    sines = plant.singularity_sine_squared(z[:, :1].T, z[:, 1:].T, plant.parameter_values).full()
    told = np.array([[_rounded(found.problem, each)] for each in z])
    return best | {
        "candidates": (z, told),
        "objectives": (np.array([c.objective for c in found.candidates]), scale),
        "margins": (np.sqrt(sines), told.T),
    }


def _rounded(problem: flexopt.SelectionProblem, z: np.ndarray) -> float:
    """What 1e-12 of an optimum is told in: 1, or more where it is so flat that rounding alone moves it further.

    By how far apart Newton's steps end that begin within the last digits. Files round a machine's numbers, too, each its
    own way, hence three times that.
    """
    rng, program, proof = np.random.default_rng(0), single(problem), prove(problem, z)
    near = [z + 1e-12 * rng.standard_normal(z.size) * problem.scale for _ in range(8)]
    ends = [settled(program, each, proof)[0] for each in near]
    return max(1.0, 3 * float(np.ptp(ends, axis=0).max()) / TOLERANCE)


def simulation(machine: AnyMachine, rng: np.random.Generator) -> Results:
    """A short run."""
    try:
        run = flexopt.simulate(
            machine, posture=_regular(machine, rng), kp=1e3, kv=1e2, duration=0.2, integrator="gauss", substeps=4,
            offset=[0.01] * len(machine.joints),
        )  # fmt: skip
    except FlexoptError as error:
        return {f"simulate: {type(error).__name__}": (0.0, 1.0)}
    return {
        "run q": (run.q, np.abs(run.q).max()),
        "run torque": (run.torque, np.abs(run.torque).max()),
        "run base": (0.0 if run.peak_base_rotation is None else run.peak_base_rotation, 1.0),
    }


def maps(machine: AnyMachine) -> Results:
    """Maps of the first two joints, and of end-points where these name a posture."""
    others = [0.5] * (len(machine.joints) - 2)
    ranges = {"x_range": (-1.0, -0.6), "y_range": (-1.3, -0.7)}
    # Its doubling for ε_max leaves a residual of 1e-8; `evaluate` has all digits.
    made = [flexopt.map_workspace(machine, over="posture", posture=others, points=(4, 3), epsilon_max=False, **ranges)]
    if not others:
        made.append(flexopt.map_workspace(machine, points=(9, 7), epsilon_max=False))
    results: Results = {}
    for k, each in enumerate(made):
        for name in ("frequency_hz", "w", "posture"):
            # Where the arm is nearly straight, posture and all that it decides have half of the digits.
            values = np.where(each.array("condition") < CONDITION, each.array(name), np.nan)
            results[f"map {k} {name}"] = values, np.nanmax(np.abs(each.array("scale" if name == "w" else name)))
    return results


def exported(machine: AnyMachine, folder: Path) -> Results:
    """What the generated C answers."""
    folder.mkdir(exist_ok=True)
    report = flexopt.export_c(machine, folder / "bundle", parts=("kinematics", "controller", "measures"), prefix="m")
    library, rng, results = BundleLibrary(report, folder), np.random.default_rng(0), Results()
    for name, operation in library.operations.items():
        inputs = {field["name"]: rng.uniform(0.4, 0.8, field["shape"]) for field in operation["inputs"]}
        status, answer = library(name, **inputs)
        results[f"C {name} status"] = float(sum(map(ord, status))), 1.0
        for output, value in answer.items():
            size = answer["w_size"] if output in ("w", "w_error", "value") and "w_size" in answer else value
            results[f"C {name} {output}"] = value, max(1e-30, float(np.abs(size).max()))
    return results
