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

from flexopt.algebra.layout import Layout
from flexopt.export.fmu.guards import Guarded, GuardedConfiguration, ModelGuard
from flexopt.export.fmu.interface import Interface
from flexopt.loop.directions import Computed
from flexopt.loop.flow import Flow
from flexopt.loop.integrators import State
from flexopt.loop.rest import design_constants, in_base_axes, placed, state_at_rest
from flexopt.loop.small_motions import damping_entries
from flexopt.loop.structure import JACOBIAN_DAMPING
from flexopt.plant.machine_motion import constants_at, motion_of
from flexopt.simulation.run import RESIDUAL_MAX


@dataclass(frozen=True)
class FmuModel(Interface):
    """Variables and Functions of one FMU."""

    @property
    def n_values(self) -> int:
        """Entries of a."""
        return len(self.parameters) + len(self.moving)

    @cached_property
    def guards(self) -> tuple[ModelGuard, ...]:
        """When the parameters are refused, in the order of `setup`'s."""
        return tuple(guard for guard, _ in self._setup[1])

    @property
    def residual_max(self) -> float:
        """Largest monitor of a step that converged."""
        return RESIDUAL_MAX**2

    @property
    def setup(self) -> ca.Function:
        """What the parameters give. Input a; outputs c, x (at the start), point (rest end-point), guards."""
        return self._setup[0]

    @cached_property
    def _setup(self) -> tuple[ca.Function, Guarded]:
        s, plant, loop, machine = self.scenario, self.plant, self.loop, self.scenario.machine
        sizes = {"p": self.n_machine} | {name: len(group) for name, group in self.settings.items()}
        layout = Layout(sizes | {"moving": len(self.moving)})
        a = ca.SX.sym("a", layout.total)
        of = layout.split(a)
        # Pins of cylinders end the list of parameters; see `Interface.parameters`.
        p = ca.vertcat(of["p"], ca.SX([parameter.value for parameter in machine.parameters[self.n_machine :]]))
        posture, m = of["posture"], plant.n_passive
        base = self._assembled(ca.vertsplit(of["moving"]), ca.vertsplit(of.get("placement", ca.SX(0, 1))))
        rest = plant.rest(base, posture, p)
        passive = plant.deflected(base, posture, p) if loop.structure.gravity else rest[:m]
        design = ca.vertcat(passive, posture)
        parts: dict[str, Any] = dict(constants_at(machine, p))
        motion = motion_of(loop.structure.motion, parts)
        parts |= {"h": s.parts["h"], "early": s.parts["early"]} | design_constants(motion, passive, base)
        parts |= {name: of[name] for name in loop.constants.sizes if name in of}
        resolutions = {name: of[name] for name in ("resolution", "rate_resolution") if name in of}
        parts |= {name: ca.repmat(value, plant.n_task, 1) for name, value in resolutions.items()}
        if loop.structure.served:
            # What a master sets is both; the joints' own is what the machine came with.
            braked = list(damping_entries(machine))
            parts["braking"] = ca.fmax(p[braked] - (plant.parameter_values[braked] - ca.DM(s.parts["braking"])), 0)
        if "filter_hz" in of:
            parts["filter"] = 2 * math.pi * of["filter_hz"]
        if "bandwidth_hz" in of:
            parts["bandwidth"] = 2 * math.pi * of["bandwidth_hz"]
        parts |= {name: ca.SX(s.parts[name]) for name in (*"ABCD", JACOBIAN_DAMPING) if name in loop.constants.sizes}
        # What judges a run is not computed here.
        parts |= {name: ca.SX.zeros(loop.constants.sizes[name], 1) for name in ("u_design", "modes", "omega_squared")}
        c = ca.vertcat(*[ca.SX(parts[name]) for name in loop.constants.sizes])
        q = ca.vertcat(passive, posture + of["offset"])
        limited = self.kind == "co-simulation" and loop.structure.method == "rk4"
        at = GuardedConfiguration(plant, loop.structure, design, base, p)
        guarded = at.guarded(s.longest_step if limited else None, of.get("bandwidth_hz"))
        outputs = [c, state_at_rest(loop, plant, motion, q, base, p), plant.end_point(design, base, p)]
        outputs = [ca.densify(output) for output in (*outputs, ca.vertcat(*(number for _, number in guarded)))]
        names = ["c", "x", "point", "guards"]
        return ca.Function("setup", [a], outputs, ["a"], names, {"cse": True}), guarded

    def _assembled(self, moving: list[ca.SX], still: list[ca.SX]) -> ca.SX:
        """The placement (n_b,) from its coordinates that are inputs and those that are not."""
        names = self.scenario.machine.base_coordinates
        rest = [name for name in names if name not in self.moving]
        at = dict(zip((*self.moving, *rest), (*moving, *still), strict=True))
        return ca.vertcat(ca.SX(0, 1), *(at[name] for name in names))

    @cached_property
    def step(self) -> ca.Function:
        """One sample. Inputs x, i, c; outputs x_next and residual, the implicit method's, else 0."""
        function = self.loop.step
        sizes = (self.loop.states.total, self.given.total, self.loop.constants.total)
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
            ca.SX.sym("i", self.given.total),
            ca.SX.sym("c", loop.constants.total),
        )

    @cached_property
    def signals(self) -> ca.Function:
        """The loop's signals, which count from where the base stands at first. Inputs i, c; output e."""
        _, i, c = self._symbols
        of, start = self.given.split(i), c[self.loop.constants.slices["base"]]
        parts = {name: of.get(name, ca.SX(0, 1)) for name in self.loop.signals.sizes}
        if self.moving:
            still = [start[k] for k, name in enumerate(self.motion.placement) if name not in self.moving]
            nothing = [ca.SX(0)] * len(still)
            moved = self._assembled(ca.vertsplit(of["placement"]), still) - start
            rates = self._assembled(ca.vertsplit(of["placement_rate"]), nothing)
            parts |= {"base": self._turned(moved, start), "base_rate": self._turned(rates, start)}
        parts["target"] = of["target"] - placed(self.motion, start)
        e = ca.vertcat(*(parts[name] for name in self.loop.signals.sizes))
        return ca.Function("signals", [i, c], [e], ["i", "c"], ["e"])

    def _turned(self, column: ca.SX, start: ca.SX) -> ca.SX:
        """A change of placement in the axes in which the anchor frame stands; see `simulation.base_path.moved`."""
        names = self.motion.placement
        if "yaw" not in names:
            return column
        yaw, away = start[names.index("yaw")], dict(zip(names, ca.vertsplit(column), strict=True))
        turned = in_base_axes(away, ca.cos(yaw), ca.sin(yaw), ca.SX(0)) | {"yaw": ca.SX(0)}
        return ca.vertcat(*(turned[name] for name in names))


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
