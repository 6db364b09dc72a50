"""What an FMU computes: the Functions behind its variables.

In: a `Scenario` and its run. Out: an `FmuModel`. The loop is that of `flexopt.simulate`; what `Scenario` computes from
numbers before a run (constants, equilibrium, start) is here one Function of the parameters, so that a master may change
them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca

from flexopt.export.fmu.interface import Interface
from flexopt.plant.motion import Motion, constants
from flexopt.plant.singularity import CONDITION_MAX
from flexopt.simulation.directions import Computed
from flexopt.simulation.flow import Flow
from flexopt.simulation.integrators import State
from flexopt.simulation.run import RESIDUAL_MAX
from flexopt.simulation.scenario import RK4_LIMIT, RK4_REAL_LIMIT, STATIC_TOLERANCE
from flexopt.simulation.structure import N_TASK, Layout

# Squarings of M⁻¹K: its trace then bounds the fastest mode from above, within a fifth of a percent for 3 modes.
SQUARINGS = 8
# The bound's excess and rounding must not refuse what `simulate` accepts.
STEP_SLACK = 1.01


@dataclass(frozen=True)
class Guard:
    """A number that the parameters give, and the range in which the model may be used."""

    text: str
    low: float = -math.inf
    high: float = math.inf


@dataclass(frozen=True)
class FmuModel(Interface):
    """Variables and Functions of one FMU."""

    @property
    def n_values(self) -> int:
        """Entries of a."""
        return len(self.parameters) + self.placement_moves

    @cached_property
    def guards(self) -> tuple[Guard, ...]:
        """When the parameters are refused, in the order of `setup`'s."""
        found = [Guard("the posture is singular: the end-point can only move along one line", low=CONDITION_MAX**-2)]
        if self.loop.structure.gravity:
            found += [
                Guard("the springs do not hold the machine in this posture", low=0.0),
                Guard("the static deflection under gravity did not converge", high=STATIC_TOLERANCE),
            ]
        if self.kind == "co-simulation" and self.loop.structure.method == "rk4":
            text = "RK4 is unstable for the fastest mode or servo: softer springs, or export with more substeps"
            found.append(Guard(text, high=STEP_SLACK))
        return tuple(found)

    @property
    def residual_max(self) -> float:
        """Largest monitor of a step that converged."""
        return RESIDUAL_MAX**2

    @cached_property
    def setup(self) -> ca.Function:
        """What the parameters give. Input a; outputs c, x (at the start), point (rest end-point), guards."""
        s, plant, loop = self.scenario, self.plant, self.loop
        sizes = {"p": len(s.machine.parameters)} | {name: len(group) for name, group in self.settings.items()}
        layout = Layout(sizes | ({"placement": 1} if self.placement_moves else {}))
        a = ca.SX.sym("a", layout.total)
        of = layout.split(a)
        p, posture, base, m = of["p"], of["posture"], of["placement"], plant.n_passive
        rest = plant.rest(base, posture, p)
        passive = plant.deflected(base, posture, p) if loop.structure.gravity else rest[:m]
        design = ca.vertcat(passive, posture)
        value = constants(s.machine)
        parts: dict[str, Any] = dict(zip(value.name_out(), value.call([p]), strict=True))
        motion = Motion(loop.structure.motion, parts)
        hinges = passive[motion.n_translations :]
        relative = ca.SX(passive)
        if "x" in loop.structure.motion.translations:
            relative[0] -= base
        parts |= {"h": s.parts["h"], "base": base, "design": relative}
        parts["design_directions"] = ca.vec(ca.horzcat(ca.cos(hinges), ca.sin(hinges)).T)
        parts |= {name: of[name] for name in loop.constants.sizes if name in of}
        parts |= {name: ca.repmat(of[name], N_TASK, 1) for name in ("resolution", "rate_resolution") if name in of}
        if "bandwidth_hz" in of:
            parts["bandwidth"] = 2 * math.pi * of["bandwidth_hz"]
        parts |= {name: ca.SX(s.parts[name]) for name in "ABCD" if name in loop.constants.sizes}
        # What judges a run is not computed here.
        parts |= {name: ca.SX.zeros(loop.constants.sizes[name], 1) for name in ("u_design", "modes", "omega_squared")}
        c = ca.vertcat(*[ca.SX(parts[name]) for name in loop.constants.sizes])
        q = ca.vertcat(passive, posture + of["offset"])
        point = plant.end_point(design, base, p)
        outputs = [c, self._start(motion, q, base, p), point, self._checks(of, design, base, p)]
        dense = [ca.densify(output) for output in outputs]
        return ca.Function("setup", [a], dense, ["a"], ["c", "x", "point", "guards"], {"cse": True})

    def _start(self, motion: Motion, q: ca.SX, base: ca.SX, p: ca.SX) -> ca.SX:
        """States at rest in q; see `simulation.scenario.start_states`."""
        loop, plant = self.loop, self.plant
        shift = ca.SX(motion.offset)
        if "x" in loop.structure.motion.translations:
            shift[0] += base
        u = ca.inv(motion.to_q) @ (q - shift)
        parts = {name: ca.SX.zeros(size, 1) for name, size in loop.states.sizes.items()} | {"u": u}
        if loop.structure.compensated and loop.structure.lagging:
            parts["torque"] = plant.gravity(q, base, p)[plant.n_passive :]
        if loop.structure.delay:
            measured = plant.end_point(q, base, p) - ca.vertcat(base, ca.SX.zeros(N_TASK - 1, 1))
            parts["queue"] = ca.repmat(ca.vertcat(measured, ca.SX.zeros(N_TASK, 1)), loop.structure.delay, 1)
        return ca.vertcat(*parts.values())

    def _checks(self, of: dict[str, ca.SX], q: ca.SX, base: ca.SX, p: ca.SX) -> ca.SX:
        """The numbers behind `guards`."""
        plant, structure, m = self.plant, self.loop.structure, self.plant.n_passive
        jacobian = plant.rigid_jacobian(q, base, p)
        gram = jacobian @ jacobian.T
        found = [ca.det(gram) / ca.trace(gram) ** N_TASK]
        stiffness = ca.SX(plant.stiffness(p))
        if structure.gravity:
            springs = stiffness[:m, :m]
            stiffness[:m, :m] += plant.gravity_stiffness(q, base, p)
            pivots = ca.densify(ca.ldl(ca.densify(stiffness[:m, :m]), False)[0])
            weight = plant.gravity(q, base, p)[:m]
            left = springs @ (q - plant.rest(base, q[m:], p))[:m] + weight
            found += [ca.mmin(pivots), ca.norm_inf(left) / (1 + ca.norm_inf(weight))]
        if self.kind == "co-simulation" and structure.method == "rk4":
            h = float(self.scenario.parts["h"])
            mode = h * ca.sqrt(_largest_eigenvalue(ca.solve(plant.mass(q, base, p), stiffness))) / RK4_LIMIT
            servo = ca.mmax(of["bandwidth_hz"]) * (2 * math.pi * h / RK4_REAL_LIMIT) if "bandwidth_hz" in of else 0
            found.append(ca.fmax(mode, servo))
        return ca.vertcat(*found)

    @cached_property
    def step(self) -> ca.Function:
        """One sample. Inputs x, i, c; outputs x_next and residual, the implicit method's, else 0."""
        function = self.loop.step
        sizes = (self.loop.states.total, self.loop.signals.total, self.loop.constants.total)
        x, i, c = (ca.MX.sym(name, size) for name, size in zip("xic", sizes, strict=True))
        x_next, monitor = function(x, self.signals(i, c), c)
        residual = monitor[-1] if self.loop.structure.method == "gauss" else ca.MX(0)
        outputs = [ca.densify(x_next), ca.densify(residual)]
        whole = ca.Function("sample", [x, i, c], outputs, ["x", "i", "c"], ["x_next", "residual"])
        return whole.expand("sample", {"cse": True}) if function.is_a("SXFunction") else whole

    @cached_property
    def show(self) -> ca.Function:
        """Outputs in their order. Inputs x, i, c; output y."""
        x, i, c = self._symbols
        shown = dict(zip(self.loop.outputs.name_out(), self.loop.outputs.call([x, self.signals(i, c), c]), strict=True))
        names = ("q", "v", "end_point", "error", "torque", "energy", "deflection")
        y = ca.densify(ca.vertcat(*(shown[name] for name in names)))
        return ca.Function("show", [x, i, c], [y], ["x", "i", "c"], ["y"], {"cse": True})

    @cached_property
    def rates(self) -> ca.Function:
        """ẋ of the continuous loop. Inputs x, i, c; output x_rate."""
        x, i, c = self._symbols
        part = self.loop.states.split(x)
        state = State(part["u"], part["w"], ca.vertcat(part["torque"], part["law"]))
        flow = Flow(self.loop.structure, self.loop.layouts, ca.SX.zeros(0, 1), self.signals(i, c), c)
        rate = flow.rates(ca.SX(0), state, Computed(self.motion.angles(state.u)).start.pairs)
        column = ca.densify(ca.vertcat(rate.u, rate.w, rate.z))
        return ca.Function("rates", [x, i, c], [column], ["x", "i", "c"], ["x_rate"], {"cse": True})

    @property
    def functions(self) -> tuple[ca.Function, ...]:
        """What is generated."""
        return (self.setup, self.show, self.rates if self.kind == "model-exchange" else self.step)

    @cached_property
    def _symbols(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        loop = self.loop
        return (
            ca.SX.sym("x", loop.states.total),
            ca.SX.sym("i", loop.signals.total),
            ca.SX.sym("c", loop.constants.total),
        )

    @cached_property
    def signals(self) -> ca.Function:
        """The loop's signals, x from where the base stands at first. Inputs i, c; output e."""
        _, i, c = self._symbols
        layout, e = self.loop.signals, ca.SX(i)
        for name in ("base", "target"):
            if name in layout.slices:
                e[layout.slices[name].start] -= c[self.loop.constants.slices["base"]]
        return ca.Function("signals", [i, c], [e], ["i", "c"], ["e"])


def _largest_eigenvalue(a: ca.SX) -> ca.SX:
    """Of a matrix whose eigenvalues are not negative, a bound from above: tr(A^k)^(1/k), k = 2^`SQUARINGS`."""
    logarithm, share = ca.SX(0), 1.0
    for _ in range(SQUARINGS):
        size = ca.trace(a)
        logarithm += share * ca.log(size)
        a = (a / size) @ (a / size)
        share *= 0.5
    return ca.exp(logarithm + share * ca.log(ca.trace(a)))


def dependencies(function: ca.Function, output: int, inputs: Sequence[int]) -> list[list[list[int]]]:
    """Of each row of an output, for each of `inputs` the entries on which it depends."""
    found: list[list[list[int]]] = [[] for _ in range(function.size1_out(output))]
    for k in inputs:
        rows, columns = function.jac_sparsity(output, k).get_triplet()
        for entries in found:
            entries.append([])
        for row, column in zip(rows, columns, strict=True):
            found[row][-1].append(column)
    return found
