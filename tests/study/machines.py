"""Machines of the map tests."""

import flexopt


def three_links():
    """The excavator with a bucket: a redundant arm."""
    data = flexopt.load("excavator").to_dict()
    bucket = {"name": "bucket", "length": 0.6, "com": 0.3, "mass": 150.0, "inertia": 12.0}
    return flexopt.machine_from_dict(data | {"links": [*data["links"], bucket]})


def limited():
    """The excavator with joint limits that shut out part of its reach."""
    data = flexopt.load("excavator").to_dict()
    limits = ([-0.5, 1.5], [-2.5, -0.5])
    boom, stick = ({**link, "limits": pair} for link, pair in zip(data["links"], limits, strict=True))
    return flexopt.machine_from_dict(data | {"links": [boom, stick]})


def gantry():
    """A column on springs with a lift, a ram and a head that swivels: a lift of 2.6 m, a reach of 0.1 to 1.7 m."""
    springs = {
        "y": ([0.0, 1.0, 0.0], 3e7, 2e4),
        "z": ([0.0, 0.0, 1.0], 6e7, 4e4),
        "pitch": ([0.0, 1.0, 0.0], 2.5e7, 2e4),
    }
    bodies, parent = [], None
    for name, (axis, stiffness, damping) in springs.items():
        kind = "hinge" if name == "pitch" else "slide"
        joint = {"name": f"base.{name}", "kind": kind, "axis": axis, "passive": True}
        bodies.append({"name": name, "parent": parent, "joint": joint | {"stiffness": stiffness, "damping": damping}})
        parent = name
    bodies[-1] |= {"name": "column", "mass": 4200.0, "com": [0.0, 0.0, 1.6], "inertia": [5200, 5400, 900, 0, 0, 0]}
    moved = {
        "saddle": ("lift", "slide", [0, 0, 1], [0, 2.6], [0.45, 0, 0.6], 650, [0.3, 0, 0], [60, 80, 70, 0, 4, 0]),
        "ram": ("reach", "slide", [1, 0, 0], [0.1, 1.7], [0.3, 0, 0], 420, [-0.4, 0, 0], [15, 120, 120, 0, 0, 0]),
        "head": ("swivel", "hinge", [0, 0, 1], [-2.2, 2.2], [0.5, 0, 0], 135, [0.24, 0, -0.14], [3.4, 7, 6, 0, 1.5, 0]),
    }
    parent = "column"
    for name, (joint, kind, axis, limits, position, mass, com, inertia) in moved.items():
        told = {"name": joint, "kind": kind, "axis": axis, "limits": limits}
        numbers = {"position": position, "mass": mass, "com": com, "inertia": inertia}
        bodies.append({"name": name, "parent": parent, "joint": told} | numbers)
        parent = name
    end_point = {"body": "head", "position": [0.5, 0.0, -0.55], "rows": ["x", "y", "z"]}
    return {"name": "gantry", "bodies": bodies, "end_point": end_point}
