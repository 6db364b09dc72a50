"""The Functions that the posture optimiser evaluates: values, first and second derivatives, exact.

In: a machine's measures. Out: SX Functions with dense outputs, the pieces of `flexopt.selection`'s program without its
solver. The eigenvectors come from `hold`, which every other Function takes as an input, as everywhere in flexopt.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from flexopt.robustness.measures import Measures


@dataclass(frozen=True)
class OptimiserKernels:
    """Functions of z = [base, posture], p and weights α (constants where they are baked: the inputs stay, unread).

    Attributes:
        hold: (base, posture, p) -> held, as `Measures.hold`.
        value: (base, posture, p, held, weights) -> V = Σ α_i w_i, and its size Σ α_i |a_i||b_i|.
        model: (base, posture, p, held, weights) -> ∂V/∂z (n_z,), ∂²V/∂z² (n_z, n_z), the Hessians of r's rows side by
            side (n_z, n_task n_z), that of sin² of the distance from singular postures (n_z, n_z).
        position: (base, posture, p) -> r (n_task,), ∂r/∂z (n_task, n_z), sin² and its gradient (n_z,).
        posture: as `Plant.posture_at`.
        reach: (p) -> the first actuated joint with the base at 0 (n_task,), and the arm's length, m.
    """

    hold: ca.Function
    value: ca.Function
    model: ca.Function
    position: ca.Function
    posture: ca.Function
    reach: ca.Function

    @property
    def functions(self) -> tuple[ca.Function, ...]:
        """All of them."""
        return (self.hold, self.value, self.model, self.position, self.posture, self.reach)

    @property
    def model_cost(self) -> int:
        """Instructions of `model` in units of one evaluation of V, rounded up."""
        unit = self.hold.n_instructions() + self.value.n_instructions()
        return -(-self.model.n_instructions() // unit)


def build_optimiser_kernels(measures: Measures, *, weights: Sequence[float] | None, baked: bool) -> OptimiserKernels:
    """The Functions of one machine.

    Args:
        measures: of the machine under its controller.
        weights: α (m,) as constants, or None where they are an input.
        baked: whether the machine's own p become constants.
    """
    plant, graph, g = measures.plant, measures.graph, measures.plant.graph
    z = ca.vertcat(g.base, g.posture)
    alpha = ca.SX.sym("weights", plant.n_passive)
    factors = ca.sqrt(ca.sum1(graph.a**2) * ca.sum1(graph.b**2)).T
    value, size = ca.dot(alpha, graph.w), ca.dot(alpha, factors)
    sine = ca.substitute(g.singularity_sine_squared, g.q, g.rest)
    end_point_hessians = [ca.hessian(graph.end_point[k], z)[0] for k in range(plant.n_task)]
    constants = [(alpha, ca.SX(list(weights)))] if weights is not None else []
    constants += [(g.p, ca.SX(plant.parameter_values))] if baked else []

    def function(name: str, inputs: dict[str, ca.SX], outputs: dict[str, ca.SX]) -> ca.Function:
        graphs = list(outputs.values())
        for symbol, constant in constants:
            graphs = [ca.substitute(each, symbol, constant) for each in graphs]
        dense = [ca.densify(ca.vec(each)) for each in graphs]
        return ca.Function(name, list(inputs.values()), dense, list(inputs), list(outputs), {"cse": True})

    at = {"base": g.base, "posture": g.posture, "p": g.p}
    held = at | {"held": measures.held, "weights": alpha}
    hessian, gradient = ca.hessian(value, z)
    second = {"V_zz": hessian, "r_zz": ca.horzcat(*end_point_hessians), "sine_squared_zz": ca.hessian(sine, z)[0]}
    reaching = plant.reaching
    target = {"target": reaching.target, "base": g.base, "unit": reaching.unit, "elbow": reaching.elbow, "p": g.p}
    to_posture = {"posture": reaching.posture, "cos_elbow": reaching.cos_elbow}
    at_origin = ca.vertcat(reaching.first_joint_point, ca.sum1(reaching.segment_lengths))
    at_origin = ca.substitute(at_origin, g.base, 0)
    return OptimiserKernels(
        hold=function("hold", at, {"held": measures.hold(g.base, g.posture, g.p)}),
        value=function("value", held, {"V": value, "size": size}),
        model=function("model", held, {"V_z": gradient} | second),
        position=function("position", at, _position(measures, z, sine)),
        posture=function("posture", target, to_posture),
        reach=function("reach", {"p": g.p}, {"first_joint": at_origin[:-1], "length": at_origin[-1]}),
    )


def _position(measures: Measures, z: ca.SX, sine: ca.SX) -> dict[str, ca.SX]:
    """End-point and distance from singular postures with their Jacobians; under gravity at the deflection."""
    plant, g = measures.plant, measures.plant.graph
    deflection = ca.SX.sym("deflection", plant.n_passive)
    at = plant.operating_point(g.base, g.posture, g.p, deflection if measures.gravity else None)
    outputs = [at.end_point, ca.jacobian(at.end_point, z), sine, ca.gradient(sine, z)]
    if measures.gravity:
        inner = ca.Function("inner", [g.base, g.posture, g.p, deflection], [ca.densify(each) for each in outputs])
        outputs = list(inner.call([g.base, g.posture, g.p, plant.deflected(g.base, g.posture, g.p)]))
    return dict(zip(("r", "r_z", "sine_squared", "sine_squared_z"), outputs, strict=True))
