"""The Functions that the posture optimiser evaluates: values and derivatives, exact.

In: a machine's context. Out: Functions with dense outputs, the pieces of `flexopt.selection`'s program without its
solver. The eigenvectors come from `hold`, which the others take as an input, as everywhere in flexopt. Second
derivatives are exact where postures have a closed form; elsewhere those of six modes would fill a flash, so that they
are left to differences, and eigenvectors start from those nearby.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from flexopt.export.context import Context
from flexopt.plant.reach import path_to_end_point, slide_reach
from flexopt.robustness.expansion import Expansion
from flexopt.robustness.modes import called_modes


@dataclass(frozen=True)
class OptimiserKernels:
    """Functions of z = [base, posture], p (constants where they are baked: the inputs stay, unread) and weights α.

    Attributes:
        hold: (base, posture, p) -> held; without closed form (base, posture, p, near) -> held and z, `near` of the
            next one.
        value: (base, posture, p, held, weights) -> V = Σ α_i w_i, and its size Σ α_i |a_i||b_i|.
        position: (base, posture, p) -> r (n_task,), ∂r/∂z (n_task, n_z).
        distance, margin: (base, posture, p) -> sin² of the distance from singular postures; its gradient (n_z,).
        derivatives: `model`: (base, posture, p, held, weights) -> ∂V/∂z (n_z,), ∂²V/∂z² (n_z, n_z), the Hessians of
            r's rows side by side (n_z, n_task n_z), that of sin² (n_z, n_z); or `slope`: the same inputs -> ∂V/∂z.
        reach: (p) -> the first actuated joint with the base at 0 (n_task,), 0 in rows of no place, and how far the arm
            reaches, m.
        posture: as `Plant.posture_at`; None where postures have no closed form.
    """

    hold: ca.Function
    value: ca.Function
    position: ca.Function
    distance: ca.Function
    margin: ca.Function
    derivatives: ca.Function
    reach: ca.Function
    posture: ca.Function | None

    @property
    def functions(self) -> tuple[ca.Function, ...]:
        """All of them."""
        closed_form = () if self.posture is None else (self.posture,)
        first = (self.hold, self.value, self.position, self.distance, self.margin, self.derivatives)
        return (*first, self.reach, *closed_form)

    @property
    def exact_second(self) -> bool:
        """Whether second derivatives are among them."""
        return self.derivatives.name() == "model"

    @property
    def unit(self) -> int:
        """Operations of one evaluation of V."""
        return operations(self.hold) + operations(self.value)

    @property
    def projections(self) -> int:
        """Newton's steps onto the target, with their algebra, that cost as much as an evaluation of V."""
        n_z = self.margin.size1_out(0)
        return max(1, self.unit // (operations(self.position) + 20 * n_z**2))

    @property
    def slope_cost(self) -> int:
        """Operations of one step's first derivatives in units of one evaluation of V, rounded up."""
        return -(-operations(self.derivatives) // self.unit)

    @property
    def model_cost(self) -> int:
        """The same with second derivatives: by differences, a point and its slope for each direction of redundancy."""
        if self.exact_second:
            return self.slope_cost
        n_task, n_z = self.position.size1_out(0), self.margin.size1_out(0)
        probe = operations(self.position) + self.unit + operations(self.derivatives)
        return self.slope_cost - (n_z - n_task) * (-probe // self.unit)


def operations(function: ca.Function) -> int:
    """Operations of a Function and of what it calls; of branches those of the shorter one, which is the usual one."""
    if function.is_a("SXFunction"):
        return function.n_instructions()
    if function.class_name() == "Switch":
        return min(operations(branch) for branch in function.find_functions(0))
    calls = (k for k in range(function.n_instructions()) if function.instruction_id(k) == ca.OP_CALL)
    return sum(operations(function.instruction_MX(k).which_function()) for k in calls)


def build_optimiser_kernels(at: Context) -> OptimiserKernels:
    """The Functions of a machine under its controller; its own p become constants where they are baked."""
    plant, g, point = at.plant, at.plant.graph, at.measures.expansion.point
    z = ca.vertcat(g.base, g.posture)
    sine = ca.substitute(g.singularity_sine_squared, g.q, g.rest)

    def function(name: str, inputs: dict[str, ca.SX], outputs: dict[str, ca.SX]) -> ca.Function:
        dense = [ca.densify(ca.vec(each)) for each in outputs.values()]
        if at.baked:
            dense = [ca.substitute(each, g.p, ca.SX(plant.parameter_values)) for each in dense]
        return ca.Function(name, list(inputs.values()), dense, list(inputs), list(outputs), {"cse": True})

    inputs = {"base": g.base, "posture": g.posture, "p": g.p}
    position = function("position", inputs, {"r": point.end_point, "r_z": ca.jacobian(point.end_point, z)})
    distance = function("distance", inputs, {"sine_squared": sine})
    margin = function("margin", inputs, {"sine_squared_z": ca.gradient(sine, z)})
    if not plant.closed_form:
        first_joint, length = path_to_end_point(plant.machine)[0].call([g.p])
        along = dict(zip("xyz", ca.vertsplit(first_joint), strict=True))
        rows = ca.vertcat(*(along.get(row, ca.SX(0)) for row in plant.machine.task_rows))
        reach = function("reach", {"p": g.p}, {"first_joint": rows, "length": length + slide_reach(plant)})
        posture, second = None, None
    else:
        reaching = plant.reaching
        target = {"target": reaching.target, "base": g.base, "unit": reaching.unit, "elbow": reaching.elbow, "p": g.p}
        posture = function("posture", target, {"posture": reaching.posture, "cos_elbow": reaching.cos_elbow})
        at_origin = ca.vertcat(reaching.first_joint_point, ca.sum1(reaching.segment_lengths))
        at_origin = ca.substitute(at_origin, g.base, 0)
        reach = function("reach", {"p": g.p}, {"first_joint": at_origin[:-1], "length": at_origin[-1]})
        end_point_hessians = [ca.hessian(point.end_point[k], z)[0] for k in range(plant.n_task)]
        outputs = {"r_zz": ca.horzcat(*end_point_hessians), "sine_squared_zz": ca.hessian(sine, z)[0]}
        second = function("bent_rows", inputs | {"held": at.measures.expansion.held}, outputs)
    return OptimiserKernels(
        **_of_modes(at, second),
        position=position,
        distance=distance,
        margin=margin,
        reach=reach,
        posture=posture,
    )


def _of_modes(at: Context, second: ca.Function | None) -> dict[str, ca.Function]:
    """`hold`, `value` and the derivatives; second ones where `second` gives those of the rows."""
    plant, g = at.plant, at.plant.graph
    expansion = Expansion(plant, at.control, gravity=False, placed=at.placement_matters, baked=at.baked, compact=True)
    names = ["base", "posture", "p", "held", "weights"]
    symbols = [ca.MX.sym(name, x.shape[0]) for name, x in zip(names, (g.base, g.posture, g.p), strict=False)]
    given = [symbol for name, symbol in zip(names, symbols, strict=False) if name in expansion.inputs]
    held, alpha = ca.MX.sym("held", expansion.held.shape[0]), ca.MX.sym("weights", plant.n_passive)
    if second is None:
        near = [ca.MX.sym("near", plant.n_passive, plant.n_passive)]
        solved, z = expansion.hold(given, called_modes(plant.n_passive, near=True), *near)
    else:
        near, (solved, z) = [], expansion.hold(given, called_modes(plant.n_passive))
    found: list[ca.MX] = [ca.veccat(*list[ca.MX](solved.values())), *z]
    inputs, parts = [*symbols, held, alpha], expansion.parts(held)
    w, by_f = expansion.slopes(parts, alpha)
    value = [ca.dot(alpha, w), ca.dot(alpha, expansion.sizes(parts))]
    if second is None:
        slope = ca.Function("slope", inputs, [expansion.gradient(given, parts, by_f)], names, ["V_z"])
    else:
        outputs = [*expansion.hessian(given, parts, by_f, alpha), *second.call([*symbols, held])]
        slope = ca.Function("model", inputs, outputs, names, ["V_z", "V_zz", "r_zz", "sine_squared_zz"])
    hold_names = [*names[:3], "near"][: 3 + len(near)]
    return {
        "hold": ca.Function("hold", [*symbols, *near], found, hold_names, ["held", "z"][: len(found)]),
        "value": ca.Function("value", inputs, value, names, ["V", "size"]),
        "derivatives": slope,
    }
