"""What stands on vibration modes as operations: the measures w_i, the nullspace step, ε_max.

In: a `Context`. Out: operations whose graphs come from `flexopt.robustness`.
"""

from __future__ import annotations

import casadi as ca

from flexopt.algebra import apply_pseudo_inverse
from flexopt.algebra.riccati import lyapunov, riccati_pair, top_eigenpairs
from flexopt.export.context import Context, unit_list
from flexopt.export.control import GAIN_MAX
from flexopt.export.modal_kernels import ModalKernels
from flexopt.export.operations import TOLERANCES, Field, Guard, Operation, operation_of
from flexopt.foundation.control import gain_units
from flexopt.model.choices import WEIGHT
from flexopt.robustness.margin import Margin, build_margin, riccati_residual
from flexopt.robustness.residues import MIXED, residue_unit

SERVO_GAIN_RANGE = (1e-6, 1e15)
# The joints are free to move in a mode, and the arm's inertia holds the end-point still: a_i is a small difference of
# large terms, and its error, like that which the last digit of an angle makes, is a share of these terms, not of a_i.
# That of w_i is an output. Below this |a_i||b_i| relative to its terms it would be a hundredth of |a_i||b_i| or more.
SINGLE_SIGNIFICANCE = 1.6e-4
# Modes whose frequencies are closer than this, relative, keep too few digits in single precision.
SINGLE_GAP = 1e-2
# The rounding of the terms counts by this share, in double and in single precision: times the tolerance it is some
# dozens of units of rounding, which the modes' own make of the terms. Errors of modes are divided by the gap of their
# frequencies; clusters of equal ones are computed as such.
TERMS_SHARE, GAP_MIN = {False: 1e-2, True: 1.6e-2}, 1e-6
# ε_max in single and double precision: the most that the doublings may leave, and the largest X_ii Z_ii, which
# multiplies rounding errors.
LEFT_OVER = {True: 1e-3, False: 1e-6}
CONDITION = {True: 1e3, False: 1e8}
# In single precision fast poles of large servo gains take digits that neither of these shows; so many doublings of the
# Lyapunov equations see them.
FAST_DOUBLINGS = 6


def measures(at: Context) -> tuple[Operation, ...]:
    """The w_i, their weighted sum V and its gradient."""
    field, choice = at.field, unit_list(at.choice_units)
    about = _Weighted(at)
    graph, alpha, size = about.graph, about.alpha, about.size
    frequency = ca.sqrt(graph.omega_squared)
    unit = residue_unit(at.control, at.machine.joint_units)
    unit = "1/(kg m^2) of hinges, 1/kg of slides" if unit == MIXED else unit.replace("m2", "m^2")
    outputs = [
        (field("angular_frequency", "MODES", "rad/s", "undamped, ascending", scale="itself"), frequency, frequency),
        (field("w", "MODES", unit, "w_i = lambda_min(R_i + R_i^T) = a.b - |a||b|; 2ab of one row", scale=about.meaning),
         graph.w, size),
        (field("w_error", "MODES", "as w", "largest error of w_i by rounding", scale="itself over gap_i"), about.error,
         about.error_size),
        (field("w_size", "MODES", "as w", "|a_i||b_i|, the size of R_i = a_i b_i^T", scale="as of w_i"),
         graph.size, size),
        (field("value", "", "as w", "V = sum of weights_i w_i", scale="sum of weights_i times the scale of w_i"),
         ca.dot(alpha, graph.w), ca.dot(alpha, size)),
        (field("gradient", "CHOICE", f"V per {choice}", "dV/dz, z = [placement; joint_angles]",
               scale=f"sum of weights_i (scale of w_i + |dw_i/dz|/gap_i, times {about.share:g} of w_i's terms over "
               "w_size_i where that is more than 1)"), about.gradient, about.gradient_size),
    ]  # fmt: skip
    text = (
        f"Measures of a posture under Jacobian {at.control} control, passive coordinates at rest: w_i of every mode, "
        "their weighted sum V, and its exact gradient. Where the end-point hardly moves in a mode its w_i is a "
        "difference of larger numbers: w_error says how large its rounding error may be. Where a_i or b_i vanishes, "
        "w_i = 0 has a kink: the gradient there is that of one side, rounding decides of which. flexopt select names "
        "optima on kinks."
    )
    return (about.operation("measures", text, [], outputs, []),)


def nullspace(at: Context) -> tuple[Operation, ...]:
    """The step of placement and joints along the self-motion."""
    plant, g, field = at.plant, at.plant.graph, at.field
    about = _Weighted(at)
    slope, factor = ca.SX.sym("slope", plant.n_base + plant.n_actuated), ca.SX.sym("factor")
    jacobian = plant.base_jacobian(g.base, g.posture, g.p)
    projected = factor * (slope - apply_pseudo_inverse(jacobian, jacobian @ slope))
    gram = jacobian @ jacobian.T
    # 1 where all singular values of J_B are equal, 0 where one vanishes.
    isotropy = ca.det(gram) / (ca.trace(gram) / plant.n_task) ** plant.n_task
    project = about.kernels.expansion.of_machine("project", [slope, factor], [projected, isotropy])
    gain = ca.MX.sym("step_gain")
    step, regular = project.call([*about.machine_inputs, about.gradient, gain])
    limit = GAIN_MAX
    gain_field = field("step_gain", "", "z per dV/dz", "k_xi; a step along the gradient of V for k_xi > 0", low=-limit,
                       high=limit, sample=(1.0, 1e3))  # fmt: skip
    output = field("step", "CHOICE", unit_list(at.choice_units), "change of z = [placement; joint_angles]",
                   scale="|k_xi| times the gradient's")  # fmt: skip
    placed = Guard("isotropy", "det(J_B J_B^T) relative to equal singular values, 0 where J_B loses rank",
                   "SINGULAR_POSTURE", minimum=at.singularity_margin**2)  # fmt: skip
    text = (
        "Step of placement and joints that raises V and leaves the end-point where it is, to first order: "
        "(I - J_B^+ J_B) k_xi dV/dz. Metres and radians count alike in the projection."
    )
    outputs = [(output, step, ca.fabs(gain) * about.gradient_size)]
    return (about.operation("nullspace_step", text, [(gain_field, gain)], outputs, [(placed, regular)]),)


def margin(at: Context) -> tuple[Operation, ...]:
    """The robust stability margin."""
    plant, g, field = at.plant, at.plant.graph, at.field
    margin = build_margin(at.machine, at.control, compact=True)
    posture, kr, p = ca.MX.sym("posture", plant.n_actuated), ca.MX.sym("servo_gain"), ca.MX.sym("p", g.p.shape[0])
    base = ca.MX.sym("base", plant.n_base) if at.placement_matters else ca.MX.zeros(plant.n_base, 1)
    values: ca.MX = ca.MX(plant.parameter_values) if at.baked else p
    epsilon, *measured = _margin_with_condition(margin, rounding=at.single).call([base, posture, values, kr])
    guards = [
        Guard("left_over", "what the doublings left", "NOT_ACCURATE", maximum=LEFT_OVER[at.single]),
        Guard("condition", "largest X_ii Z_ii of both Riccati solutions, by which rounding errors grow", "NOT_ACCURATE",
              maximum=CONDITION[at.single]),
    ]  # fmt: skip
    if at.single:
        text = "error of epsilon_max by rounding, estimated from the residuals of both Riccati equations"
        guards.append(Guard("rounding", text, "NOT_ACCURATE", maximum=TOLERANCES["float"]))
    sine = plant.singularity_sine_squared.call([base, posture, values])[0]
    low, high = SERVO_GAIN_RANGE
    unit = gain_units(at.control, at.machine.joint_units)[0]
    gain = field("servo_gain", "", unit, "k_r, which multiplies the plant's input", low=low, high=high,
                 sample=(at.gain / 3, at.gain * 3), logarithmic=True)  # fmt: skip
    inputs = [(at.joint_angles, posture), (gain, kr), *([(at.placement, base)] if at.placement_matters else [])]
    output = field("epsilon_max", "", "", "robust stability margin, in (0, 1)",
                   scale="1, or 1e-3 of the largest X_ii Z_ii where that is more")  # fmt: skip
    # ε_max does not need Jv⁻¹ under transpose control, but there is no margin where the end-point cannot be driven.
    checked = [(at.regular(modal=True), sine), *zip(guards, measured, strict=True)]
    text = (
        f"Robust stability margin epsilon_max of the plant (A, k_r B, C) under Jacobian {at.control} control, passive "
        "coordinates at rest, by structure-preserving doubling of both Riccati equations."
    )
    outputs = [(output, epsilon[0], ca.fmax(1, 1e-3 * measured[1]))]
    return (operation_of("robust_margin", text, inputs, [] if at.baked else [p], outputs, checked),)


def _margin_with_condition(margin: Margin, *, rounding: bool) -> ca.Function:
    """(base, posture, p, kr) -> epsilon (2, 1), what the doublings left, condition, and the error of ε_max by rounding.

    The condition is the largest X_ii Z_ii. The last one is given where it is asked for.
    """
    n, g = margin.n_states, margin.plant.graph
    x, z = (ca.SX.sym(name, n, n) for name in ("X", "Z"))
    condition = ca.Function("condition", [x, z], [ca.mmax(ca.diag(x) * ca.diag(z))])
    b, c = ca.SX.sym("B", n, margin.plant.n_task), ca.SX.sym("C", margin.plant.n_task, n)
    weights = ca.Function("weights", [b, c], [ca.densify(b @ b.T), ca.densify(c.T @ c)], {"cse": True})
    symbols = [ca.MX.sym("base", g.base.shape[0]), ca.MX.sym("posture", g.posture.shape[0]),
               ca.MX.sym("p", g.p.shape[0]), ca.MX.sym("kr")]  # fmt: skip
    plant = margin.scaled_plant.call([*symbols, *margin.hold.call(symbols)])
    solution = riccati_pair(n, compact=True, fixed=True).call([plant[0], *weights.call(plant[1:])])
    values, vectors = top_eigenpairs(n, margin.plant.n_task).call(solution[:2])[:2]
    outputs = [1 / ca.sqrt(1 + values), solution[2], *condition.call(solution[:2])]
    if rounding:
        outputs.append(_rounding(plant, solution[:2], values[0], vectors[:, 0]))
    return ca.Function("margin", symbols, outputs)


def _rounding(plant: list[ca.MX], solution: list[ca.MX], value: ca.MX, vector: ca.MX) -> ca.MX:
    """What the residuals of both Riccati equations are worth in ε_max, to first order: see `flexopt.robustness.margin`.

    The two shares are not set off against each other: of a wrong solution they may cancel by chance.
    """
    (a, b, c), (x, z) = plant, solution
    solve, dual = lyapunov(x.shape[0], FAST_DOUBLINGS, compact=True, fixed=True), z @ vector
    p_x = solve.call([a - b @ (b.T @ x), dual @ dual.T])[0]
    p_z = solve.call([a.T - c.T @ (c @ z), value * (vector @ vector.T)])[0]
    shares = (ca.dot(p_x, riccati_residual(a, b, c, x)[0]), ca.dot(p_z, riccati_residual(a.T, c.T, b.T, z)[0]))
    return (ca.fabs(shares[0]) + ca.fabs(shares[1])) / (2 * ca.sqrt(1 + value) * (1 + value))


class _Weighted:
    """V = Σ α_i w_i at a posture: the inputs that its operations share, and graphs of V's gradient and its size."""

    def __init__(self, at: Context) -> None:
        plant = at.plant
        weights = at.field("weights", "MODES", "", "alpha_i of V, one for each mode", high=WEIGHT.high,
                           sample=(0.0, 1.0))  # fmt: skip
        self.at, self.kernels, self.share = at, ModalKernels(at), TERMS_SHARE[at.single]
        self.meaning = (
            f"|a_i||b_i|, or {self.share:g} of the terms it is summed from where that is more; over gap_i, the "
            "distance of omega_i^2 from the next one relative to their mean, where that is below 1"
        )
        self.alpha, posture = ca.MX.sym("weights", plant.n_passive), ca.MX.sym("posture", plant.n_actuated)
        self.inputs = [(at.joint_angles, posture), (weights, self.alpha)]
        base = ca.MX.sym("base", plant.n_base)
        self.placed = [(at.placement, base)] if at.placement_matters else []
        self.p = [] if at.baked else [ca.MX.sym("p", plant.graph.p.shape[0])]
        self.machine_inputs = [*(symbol for _, symbol in self.placed), posture, *self.p]
        self.graph = self.kernels.graph(self.machine_inputs, self.alpha)
        self.gradient = self.graph.gradient
        gap = ca.fmax(self.graph.gap, GAP_MIN)
        terms = self.share * self.graph.terms
        self.size = ca.fmax(self.graph.size, terms) / gap
        # Where a mode leaves the joints still by symmetry, say, no term is left, but the rounding of what cancelled is.
        rounded = ca.fmax(self.graph.size, self.share * self.graph.parts) / gap
        self.error = TOLERANCES["float" if at.single else "double"] * rounded
        self.error_size = self.error / gap
        # |a_i| has a kink where a_i vanishes, so that there the rounding of a_i turns its gradient.
        slopes = self.graph.gradient_sizes * ca.fmax(1, terms / self.graph.size) / gap
        self.gradient_size = ca.dot(self.alpha, self.size + slopes)

    def operation(
        self,
        name: str,
        text: str,
        inputs: list[tuple[Field, ca.MX]],
        outputs: list[tuple[Field, ca.MX, ca.MX]],
        guards: list[tuple[Guard, ca.MX]],
    ) -> Operation:
        """An operation of the shared inputs and `inputs`; guards of the modes come before `guards`."""
        inputs = [*self.inputs, *inputs, *self.placed]
        return operation_of(name, text, inputs, self.p, outputs, [*self._guards(), *guards])

    def _guards(self) -> list[tuple[Guard, ca.MX]]:
        """Where the w_i can be computed accurately enough."""
        at = self.at
        guards = [(at.regular(modal=True), self.graph.sine_squared)] if at.control == "inverse" or at.single else []
        if not at.single:
            return guards
        guard = Guard("significance", "smallest |a_i||b_i| relative to the terms it is summed from", "NOT_ACCURATE",
                      minimum=SINGLE_SIGNIFICANCE)  # fmt: skip
        apart = Guard("gap", "smallest distance of two squared frequencies relative to their mean", "NOT_ACCURATE",
                      minimum=SINGLE_GAP)  # fmt: skip
        return [*guards, (guard, self.graph.significance), (apart, self.graph.least_gap)]
