"""The loop for small motions as Functions of placement, posture, parameters and gains, with exact derivatives.

In: a machine and which parts its loop has. Out: the matrices that `assembly` makes one sample of, from the graphs of
the loop that is simulated, at any configuration, and what a derivative by these matrices is by all that they depend on.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

import casadi as ca
import numpy as np

from flexopt.algebra import solve_spd
from flexopt.compiled import ArrayCall
from flexopt.foundation.arrays import Vector
from flexopt.foundation.control import Control, control_damping, control_method
from flexopt.foundation.kept import Structural, structural_property
from flexopt.loop.closed import ClosedLoop, closed_loop
from flexopt.loop.rest import (
    ARRIVED,
    FARTHEST,
    FINER,
    LAST,
    RELIEVED,
    STAGES,
    SUDDEN,
    change_of_rest,
    design_constants,
    design_of,
    held_at,
    placed,
    resting_rows,
    state_at_rest,
    way_to_rest,
)
from flexopt.loop.structure import JACOBIAN_DAMPING, MODEL, LoopStructure
from flexopt.loop.tangent import graphs_about_rest
from flexopt.model import AnyMachine
from flexopt.plant import Plant, build_plant
from flexopt.plant.machine_motion import constants_at, full_structure, motion_of
from flexopt.plant.reach import arm_length

# What the matrices depend on, and are differentiated by; `held` is the static deflection.
INPUTS = (
    "base", "posture", "p", "kp", "kv", "ki", "nullspace_damping", "servo_gain", "filter_hz", "bandwidth_hz",
)  # fmt: skip
CONFIGURATION = INPUTS[:3]
# What the configuration at rest depends on: gains where these hold a weight that the controller does not know.
AT_REST = (*CONFIGURATION, "kp", "ki", "servo_gain")
DEAD_TIME = "dead_time"
# What measures of the sampled loop are differentiated by.
BY = (*INPUTS, DEAD_TIME)
PARTS = ("flow", "drive", "direct", "spread", "force", "law", "measured")


# Of SX, or of MX.
Symbol = TypeVar("Symbol", ca.SX, ca.MX)


def damping_entries(machine: AnyMachine) -> tuple[int, ...]:
    """Where among the parameters the actuated joints' damping stands."""
    names, entries = [parameter.name for parameter in machine.parameters], machine.kinematic_tree.entries
    return tuple(names.index(entries[f"damping{i}.{i}"]) for i in full_structure(machine).actuated)


@dataclass(frozen=True)
class Parts:
    """The linear loop about rest, or what a derivative is by each of its matrices.

    n_s continuous states s = [u, w, torques of servos], k of the sampled law and its filter, r task rows, n joints.

    Attributes:
        flow, drive: A (n_s, n_s) and B (n_s, n) of ṡ = A s + B τ.
        direct, spread: τ = G s + E f, (n, n_s) and (n, r): what the command takes from the joints themselves, and what
            it makes of the law's force f.
        force: f = F [law; m], (r, k + 2r), m the end-point and its rate as measured.
        law: the law's states at the next sample, of [law; m], (k, k + 2r).
        measured: m = C s, (2r, n_s).
    """

    flow: Vector
    drive: Vector
    direct: Vector
    spread: Vector
    force: Vector
    law: Vector
    measured: Vector


class _Rest(NamedTuple):
    """Where a loop rests: all coordinates (n_q,), passive coordinates and end-point of the design, states of the law.

    `unheld` (n,) as of `Held`.
    """

    q: ca.SX
    passive: ca.SX
    target: ca.SX
    law: ca.SX | None
    unheld: ca.SX


@dataclass(frozen=True)
class SmallMotions(Structural):
    """Functions of `INPUTS` (base (n_b,), posture (n,), p (n_par,), kp, kv, ki (n_task,), nullspace_damping,
    servo_gain, filter_hz (1,), bandwidth_hz (n,)), period (1,) and held; of what a loop lacks any numbers.

    `held` is what iteration has found, constant in derivatives: nothing without gravity; the passive coordinates (m,)
    in the static deflection; with `own_model` those by the machine's file, and v (m + n_task,) of `held_at`.

    Attributes:
        machine, control, gravity: as of `flexopt.evaluate`.
        integral, filtered, lagging, damped: whether the law has an integral, measurements a filter, joints a servo, the
            self-motion a damper.
        served: whether joints are velocity-served: gains then ask for rates, and servo_gain damps the joints.
        own_model: under gravity, whether the controller keeps the numbers of the machine's file whatever p: base and
            posture are those by the file, target and weight that it carries, too, and the loop is that about where
            feedback then holds the machine (`rest.Held`). Else it knows p.
    """  # noqa: D205

    machine: AnyMachine
    control: Control
    gravity: bool = False
    integral: bool = False
    filtered: bool = False
    lagging: bool = False
    damped: bool = False
    served: bool = False
    own_model: bool = False

    @property
    def has_own_numbers(self) -> bool:
        """Whether the controller has the numbers of the machine's file."""
        return self.own_model

    @cached_property
    def plant(self) -> Plant:
        """The machine's."""
        return build_plant(self.machine)

    @cached_property
    def structure(self) -> LoopStructure:
        """Of a loop with one measurement on its way, so that it can be told from what joints measure at once."""
        return LoopStructure(
            full_structure(self.machine),
            control=control_method(self.control),
            law="pid" if self.integral else "pd",
            delay=1,
            filtered=self.filtered,
            gravity=self.gravity,
            compensated=self.gravity,
            lagging=self.lagging,
            nullspace_damped=self.damped,
            own_model=self.own_model,
        )

    @structural_property
    def loop(self) -> ClosedLoop:
        """Its graphs."""
        return closed_loop(self.structure)

    @structural_property
    def symbols(self) -> dict[str, ca.SX]:
        """Of `INPUTS`, the period and what is held."""
        plant = self.plant
        g, r, n = plant.graph, plant.n_task, plant.n_actuated
        sizes = dict.fromkeys(INPUTS, 1) | dict.fromkeys(("kp", "kv", "ki"), r) | {"bandwidth_hz": n}
        held = (plant.n_passive + r) * self.own_model + plant.n_passive * self.gravity
        sizes |= {"period": 1, "held": held}
        return {name: ca.SX.sym(name, size) for name, size in sizes.items()} | {
            "base": g.base, "posture": g.posture, "p": g.p,
        }  # fmt: skip

    @structural_property
    def hold(self) -> ca.Function:
        """(base, posture, p, and with `own_model` kp, ki, servo_gain) -> held, by iteration, no derivative.

        NaN where feedback is not found to hold the machine anywhere.
        """
        g, plant = self.plant.graph, self.plant
        options = {"is_diff_out": [False], "never_inline": True}
        if not self.own_model:
            found = plant.deflected(g.base, g.posture, g.p) if self.gravity else ca.SX(0, 1)
            return ca.Function("hold", [g.base, g.posture, g.p], [found], [*CONFIGURATION], ["held"], options)
        s = {name: ca.MX.sym(name, self.symbols[name].shape[0]) for name in AT_REST}
        of_own, deflection = plant.parameter_values, ca.SX.sym("deflection", plant.n_passive)
        of_file = ca.Function(
            "design", [g.base, g.posture, deflection], [*design_of(plant, g.base, g.posture, deflection)]
        )
        sag = plant.deflected(s["base"], s["posture"], of_own)
        asked = [*of_file.call([s["base"], s["posture"], sag]), s["p"], *self.into_forces(s)]
        v, followed = self._followed(STAGES).call(asked)
        with_care = self._followed(FINER * STAGES)
        already = ca.Function("already", with_care.mx_in(), [ca.DM.nan(v.shape), ca.DM(0)])
        again, found = ca.Function.if_else("unless_followed", already, with_care).call([followed, *asked])
        v = ca.if_else(followed, v, ca.if_else(found, again, math.nan))
        return ca.Function("hold", [*s.values()], [ca.vertcat(sag, v)], [*s], ["held"], options)

    def _followed(self, stages: int) -> ca.Function:
        """(the fields of `Design`, other, kp, ki) -> v of `held_at`, and whether the rest was followed there.

        In so many stages from that of the design's parameters to that of others.
        """
        step, plant = self._change_of_rest, self.plant
        v0, *given = step.mx_in()
        s = dict(zip(step.name_in()[1:], given, strict=True))
        del s["springs"]
        m, length = plant.n_passive, arm_length(plant)
        scale = ca.DM([1.0 if unit == "rad" else length for unit in plant.graph.coordinate_units])
        way, begins = way_to_rest(plant, s["other"]), (1, round(RELIEVED * stages) + 1)
        v, size, over = ca.vertcat(s["deflection"], ca.MX.zeros(v0.shape[0] - m, 1)), ca.MX(0), ca.MX(0)
        for stage in range(1, stages + 1):
            p, springs = way(stage / stages)
            there = s | {"other": p, "springs": springs}
            for _ in range(LAST if stage == stages else 1):
                change = step.call({"v": v} | there)["change"]
                v += change
                most = FARTHEST if stage in begins else ca.fmin(FARTHEST, SUDDEN + 2 * size)
                size = ca.norm_inf(ca.vertcat(change[:m], s["toward"] @ change[m:]) / scale)
                over = ca.fmax(over, size - most)
        followed = ca.logic_and(size <= ARRIVED, over <= 0)
        return ca.Function("followed", [*s.values()], [v, followed], [*s], ["v", "followed"])

    def into_forces(self, s: Mapping[str, Any]) -> tuple[Any, Any]:
        """Kp and Ki that make forces of errors: of velocity-served joints, whose gains ask for rates, Kp by servos."""
        return (s["servo_gain"] if self.served else 1) * s["kp"], self.integral * s["ki"]

    @structural_property
    def _change_of_rest(self) -> ca.Function:
        return change_of_rest(self.plant, self.control)

    @structural_property
    def resting_rows(self) -> ca.Function:
        """(…, held) -> rows (m + n_task, n_q) along whose kernel it rests, too; … are `AT_REST`. See `resting_rows`."""
        s = {name: self.symbols[name] for name in (*AT_REST, "held")}
        p, sag = s["p"], s["held"][: self.plant.n_passive]
        file = ca.SX(self.plant.parameter_values) if self.own_model else p
        at = [self._rest(s, p).q, s["base"], sag, file, p, *self.into_forces(s)]
        return ca.Function("resting_rows", [*s.values()], self.rows_at_rest.call(at), [*s], ["rows"], {"cse": True})

    @structural_property
    def rows_at_rest(self) -> ca.Function:
        """The like where it rests, q: see `flexopt.loop.rest.resting_rows`."""
        return resting_rows(self.plant, self.control)

    def _rest(self, s: Mapping[str, ca.SX], p: ca.SX) -> _Rest:
        """Where the loop rests, with p."""
        plant, m = self.plant, self.plant.n_passive
        if not self.own_model:
            at = plant.operating_point(s["base"], s["posture"], p, s["held"] if self.gravity else None)
            return _Rest(at.q, at.q[:m], at.end_point, None, ca.SX.zeros(plant.n_actuated))
        design, v = design_of(plant, s["base"], s["posture"], s["held"][:m]), s["held"][m:]
        kp, ki = self.into_forces(s)
        springs = plant.stiffness(p)[:m, :m]
        # From where iteration ends two more steps, that first and second derivatives are exact.
        for _ in range(2):
            v += self._change_of_rest.call([v, *design, p, springs, kp, ki])[0]
        held = held_at(plant, self.control, design, p, v, kp, ki)
        law = held.force - kp * held.error if self.integral else None
        return _Rest(held.q, design.deflection, design.target, law, held.unheld)

    @structural_property
    def drive_damping(self) -> Vector:
        """∂p/∂(servo gain), (n_par,): where among the parameters the actuated joints' damping stands."""
        found = np.zeros(len(self.plant.parameter_names))
        found[list(damping_entries(self.machine))] = 1.0
        return found

    @structural_property
    def _graphs(self) -> dict[str, ca.SX]:
        s, plant, structure, loop = self.symbols, self.plant, self.structure, self.loop
        gain, p = (s["servo_gain"], s["p"] + self.drive_damping * s["servo_gain"]) if self.served else (1, s["p"])
        rest = self._rest(s, p)
        own = constants_at(self.machine, p)
        motion = motion_of(structure.motion, own)
        x = state_at_rest(loop, plant, motion, rest.q, s["base"], p, rest.law)
        values = own | design_constants(motion, rest.passive, s["base"])
        if self.own_model:
            of_file = constants_at(self.machine, ca.SX(plant.parameter_values))
            values |= {f"{MODEL}{name}": value for name, value in of_file.items()}
        values |= {name: gain * s[name] for name in ("kp", "kv", "ki")}
        values |= {
            "h": s["period"], "target": rest.target - placed(motion, s["base"]), "integral_limit": ca.SX.inf(),
            "nullspace_damping": s["nullspace_damping"], "filter": 2 * math.pi * s["filter_hz"],
            "bandwidth": 2 * math.pi * s["bandwidth_hz"], JACOBIAN_DAMPING: ca.SX(control_damping(self.control) or 0.0),
        }  # fmt: skip
        sizes = loop.constants.sizes
        c = ca.vertcat(*(values.get(name, ca.SX.zeros(size, 1)) for name, size in sizes.items()))
        between, at_sample = graphs_about_rest(structure)
        e, n = ca.SX(0, 1), closed_loop(structure).n_continuous
        here = dict(zip(at_sample.name_out(), at_sample.call([x, e, c]), strict=True))
        # What drives a self-motion its damper carries: about a torque that nothing carries masses that change would
        # count as springs.
        _, flow, drive = between.call([x[:n], here["command"] + rest.unheld, e, c])
        found = (flow, drive, here["direct"][:, :n], here["spread"], here["by_force"][:, n:], here["by_law"][:, n:])
        return dict(zip(PARTS, (*found, here["by_queue"][:, :n]), strict=True))

    @structural_property
    def matrices(self) -> ca.Function:
        """-> the fields of `Parts`, by name."""
        s, graphs = self.symbols, self._graphs
        dense = [ca.densify(graph) for graph in graphs.values()]
        return ca.Function("small_motions", list(s.values()), dense, list(s), list(graphs), {"cse": True})

    @structural_property
    def slopes(self) -> ca.Function:
        """(inputs, ∂V/∂ each field of `Parts` as `by_…`) -> ∂V/∂ each of `INPUTS` as `V_…`."""
        s, graphs = self.symbols, self._graphs
        pulls = {f"by_{name}": ca.SX.sym(f"by_{name}", *graph.shape) for name, graph in graphs.items()}
        total = sum(
            (ca.dot(pull, graph) for pull, graph in zip(pulls.values(), graphs.values(), strict=True)), ca.SX(0)
        )
        slopes = [ca.densify(ca.gradient(total, s[name])) for name in INPUTS]
        given, names = s | pulls, [f"V_{name}" for name in INPUTS]
        return ca.Function("small_motion_slopes", list(given.values()), slopes, list(given), names, {"cse": True})

    @structural_property
    def configuration(self) -> ca.Function:
        """(`AT_REST`, held) -> coordinates at rest (n_q,), what is unheld, carried and carried at most there (n,)."""
        s, names, plant = self.symbols, [*AT_REST, "held"], self.plant
        rest = self._rest(s, s["p"])
        carried, most = (of(rest.q, s["base"], s["p"])[plant.n_passive :] for of in (plant.gravity, plant.most_weight))
        found = [ca.densify(each) for each in (rest.q, rest.unheld, carried, most)]
        given, told = [s[name] for name in names], ["q", "unheld", "carried", "most"]
        return ca.Function("configuration", given, found, names, told, {"cse": True})

    @structural_property
    def _disturbed(self) -> tuple[dict[str, ca.SX], ca.SX]:
        """What B_d depends on, and it: rates of s by unit forces on the passive coordinates (n_s, n_p)."""
        s, plant, to_q = self.symbols, self.plant, self.loop.to_q
        given = {name: s[name] for name in (*AT_REST, "held")}
        q = self._rest(s, s["p"]).q
        n, m = plant.n_coordinates, plant.n_passive
        rates = ca.SX(np.linalg.inv(to_q)) @ solve_spd(plant.mass(q, s["base"], s["p"]), ca.SX.eye(n)[:, :m])
        rest = closed_loop(self.structure).n_continuous - 2 * n
        return given, ca.densify(ca.vertcat(ca.SX.zeros(n, m), rates, ca.SX.zeros(rest, m)))

    @structural_property
    def disturbance(self) -> ca.Function:
        """(`AT_REST`, held) -> B_d (n_s, n_p): rates of s by unit forces on the passive coordinates."""
        given, into = self._disturbed
        return ca.Function("disturbance", list(given.values()), [into], list(given), ["into"], {"cse": True})

    @structural_property
    def disturbance_slopes(self) -> ca.Function:
        """(`AT_REST`, held, ∂V/∂B_d as `by_into`) -> ∂V/∂ each of `AT_REST` as `V_…`."""
        given, into = self._disturbed
        by = ca.SX.sym("by_into", *into.shape)
        slopes = [ca.densify(ca.gradient(ca.dot(by, into), given[name])) for name in AT_REST]
        symbols, names = given | {"by_into": by}, [f"V_{name}" for name in AT_REST]
        return ca.Function("disturbance_slopes", list(symbols.values()), slopes, list(symbols), names, {"cse": True})

    @structural_property
    def _to_hold(self) -> ArrayCall:
        return ArrayCall(self.hold)

    @structural_property
    def _to_parts(self) -> ArrayCall:
        return ArrayCall(self.matrices)

    @structural_property
    def _to_slopes(self) -> ArrayCall:
        return ArrayCall(self.slopes)

    def numbers(self, given: Mapping[str, Vector]) -> dict[str, Vector]:
        """All inputs as arrays, what is left out 0, and what is held."""
        numbers = {name: np.zeros(symbol.shape[0]) for name, symbol in self.symbols.items()}
        numbers |= {name: np.asarray(value, dtype=np.float64).ravel() for name, value in given.items()}
        held = self._to_hold(*(numbers[name] for name in self.hold.name_in()))[0]
        return numbers | {"held": held.ravel()}

    def parts(self, numbers: Mapping[str, Vector]) -> Parts:
        """The matrices at `numbers`."""
        return Parts(*self._to_parts(*(numbers[name] for name in self.symbols)))

    def gradient(self, numbers: Mapping[str, Vector], by: Parts) -> dict[str, Vector]:
        """The derivative by each of `INPUTS`, from that by the matrices."""
        pulls = [getattr(by, name) for name in PARTS]
        found = self._to_slopes(*(numbers[name] for name in self.symbols), *pulls)
        return {name: slope.ravel() for name, slope in zip(INPUTS, found, strict=True)}
