"""Arms whose modes move the end-point along one line alone, and where on lines over two joints their a and b say so."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.optimize

import flexopt


def telescope(folds: bool = False, *, rng: Any = None) -> Any:
    """A lift, or a lift and a fold, with a telescope whose mass lies on its line through the end-point.

    With `rng` any such, the telescope's line at an angle and beside the hinge.
    """

    def number(usual: float, low: float, high: float) -> float:
        return float(usual if rng is None else rng.uniform(low, high))

    boom = {"name": "boom", "joint": hinge("lift", (-1.2, 1.3)), "position": [number(0.6, 0.0, 0.6), 0.0, 2.0]}
    boom |= {"mass": 480.0, "com": [1.5, 0.0, number(0.0, -0.1, 0.1)], "inertia": [12.0, 430.0, 430.0, 0.0, 0.0, 0.0]}
    jib = {"name": "jib", "joint": hinge("fold", (-2.8, -0.2)), "position": [number(2.6, 2.0, 3.0), 0.0, 0.0]}
    jib |= {"mass": 330.0, "com": [1.2, 0.0, number(0.1, -0.1, 0.1)], "inertia": [9.0, 190.0, 190.0, 0.0, 0.0, 0.0]}
    angle = number(0.0, -0.7, 0.7)
    line = np.array([np.cos(angle), 0.0, np.sin(angle)])
    slide = {"name": "extend", "kind": "slide", "axis": line.tolist(), "limits": [0.0, 2.0]}
    tube = {"name": "tube", "joint": slide, "position": [number(3.2, -0.5, 1.0), 0.0, number(0.0, -0.5, 0.5)]}
    tube |= {"mass": 240.0, "com": (number(-0.4, -0.8, 0.2) * line).tolist()}
    tube |= {"inertia": [5.0, number(120.0, 50.0, 150.0), 120.0, 0.0, 0.0, 0.0]}
    end = {"body": "tube", "position": (0.9 * line).tolist(), "rows": ["x", "z"]}
    return on_springs([boom, *([jib] if folds else []), tube], end)


def swing(rng: Any) -> Any:
    """A trolley and an arm with the end-point at its centre of percussion: along a circle no mode moves it."""
    slide = {"name": "travel", "kind": "slide", "axis": [1.0, 0.0, 0.0], "limits": [-3.0, 3.0]}
    trolley = {"name": "trolley", "joint": slide, "position": [0.0, 0.0, 2.5], "mass": float(rng.uniform(200, 500))}
    # Off the hinge, or where the arm lies level no mode would move the end-point.
    trolley["com"] = [0.0, 0.0, float(rng.uniform(0.1, 0.3))]
    mass, com, inertia = rng.uniform((100, 0.8, 20), (400, 1.5, 90)).tolist()
    arm = {"name": "arm", "joint": hinge("swing", (-2.5, 2.5)), "mass": mass, "com": [0.0, 0.0, -com]}
    arm |= {"inertia": [inertia, inertia, inertia, 0.0, 0.0, 0.0]}
    end = {"body": "arm", "position": [0.0, 0.0, -com - inertia / (mass * com)], "rows": ["x", "z"]}
    return on_springs([trolley, arm], end)


def hinge(name: str, limits: tuple[float, float]) -> Any:
    return {"name": name, "kind": "hinge", "axis": [0.0, -1.0, 0.0], "limits": list(limits)}


def on_springs(bodies: Any, end_point: Any) -> Any:
    """A chain of bodies on a truck that heaves and pitches."""
    heave = {"name": "base.z", "kind": "slide", "axis": [0.0, 0.0, 1.0], "passive": True, "stiffness": 3e6}
    pitch = {"name": "base.pitch", "kind": "hinge", "axis": [0.0, 1.0, 0.0], "passive": True, "stiffness": 1.2e7}
    truck = {"name": "truck", "parent": "heave", "joint": pitch, "mass": 9e3, "com": [-0.3, 0.0, 1.1]}
    truck |= {"inertia": [9e3, 1.8e4, 2e4, 0.0, 0.0, 0.0]}
    chain = [{"name": "heave", "parent": None, "joint": heave}, truck]
    for body in bodies:
        chain.append({**body, "parent": chain[-1]["name"]})
    data = {"name": "on springs", "bodies": chain, "end_point": end_point, "placement": ["x"], "gravity": 9.81}
    return flexopt.tree_from_dict(data)


class Factors:
    """a and b of a machine's modes by the last joint's column t of Jv, in the plane of the first and the last row."""

    def __init__(self, machine: Any, control: str, *, gravity: bool = False) -> None:
        self.measures = flexopt.build_measures(machine, control, gravity).values
        self.plant = flexopt.build_plant(machine)

    def __call__(self, postures: Any) -> tuple[Any, Any]:
        """(3, m, N): across t a, along t b, and a·b; and the modes, (n_q, m, N)."""
        count, m, p = postures.shape[1], self.plant.n_passive, self.plant.parameter_values
        fixed = np.zeros((self.plant.n_base, count)), np.repeat(p.full(), count, axis=1)
        found = self.measures.map(count).call([fixed[0], postures, fixed[1]])
        names = self.measures.name_out()

        def of(name: str) -> Any:
            return found[names.index(name)].full().reshape(-1, count, m).transpose(0, 2, 1)

        q = found[names.index("q")].full()
        jv = self.plant.rigid_jacobian.map(count).call([q, *fixed])[0].full().reshape(self.plant.n_task, count, -1)
        (tx, tz), a, b = jv[[0, -1], :, -1], of("a"), of("b")
        across, along = a[0] * tz - a[-1] * tx, b[0] * tx + b[-1] * tz
        return np.stack([across, along, np.sum(a * b, axis=0)]), of("modes")

    def roots(
        self, posture: Any, joint: int, ends: tuple[float, float], count: int = 400
    ) -> list[tuple[int, int, Any]]:
        """Along one joint: (0 where a is zero, 1 where a and b are parallel and in phase; mode from 0; posture)."""
        line = np.linspace(*ends, count)

        def at(values: Any) -> Any:
            postures = np.repeat(np.array(posture, dtype=float)[:, None], values.size, axis=1)
            postures[joint] = values
            return self(postures)

        found: list[tuple[int, int, Any]] = []
        values, modes = at(line)
        # A mode's sign is nobody's: it is held by the mode before.
        turn = np.sign(np.sum(modes[:, :, 1:] * modes[:, :, :-1], axis=0))
        for which, mode in np.ndindex(2, values.shape[1]):
            value = values[which, mode]
            for k in np.flatnonzero(value[:-1] * value[1:] * turn[mode] < 0):
                held = modes[:, mode, k]

                def signed(x: float, which: int = which, mode: int = mode, held: Any = held) -> float:
                    here, shapes = at(np.array([x]))
                    return float(here[which, mode, 0] * np.sign(shapes[:, mode, 0] @ held))

                root = np.array(posture, dtype=float)
                root[joint] = scipy.optimize.brentq(signed, line[k], line[k + 1], xtol=1e-13)
                (size,), near = abs(self(root[:, None])[0][which, mode]), np.max(np.abs(value[k : k + 2]))
                # Across a pole the sign changes, too.
                if size < 1e-6 * near and (which == 0 or np.all(values[2, mode, k : k + 2] > 0)):
                    found.append((which, mode, root))
        return found
