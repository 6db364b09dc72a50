"""What stands on vibration modes as operations: the measures w_i, the nullspace step, ε_max.

In: a `Context`. Out: operations whose graphs come from `flexopt.robustness`.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from flexopt.algebra import apply_pseudo_inverse
from flexopt.algebra.riccati import riccati_pair, top_eigenpairs
from flexopt.export.context import Context, sine_squared
from flexopt.export.control import GAIN_MAX
from flexopt.export.operations import Field, Guard, Operation
from flexopt.robustness.margin import Margin, build_margin

WEIGHT_MAX = 1e6
SERVO_GAIN_RANGE = (1e-6, 1e15)
# In single precision the w_i lose too many digits where a mode is hardly reached or seen; within this bound, and that
# of `Context.regular`, errors stay below 1e-4 of |a_i||b_i|.
SINGLE_SIGNIFICANCE = 4e-3
# ε_max in single and double precision: the most that the doublings may leave, and the largest X_ii Z_ii, which
# multiplies rounding errors.
LEFT_OVER = {True: 1e-3, False: 1e-6}
CONDITION = {True: 1e3, False: 1e8}


def measures(at: Context) -> tuple[Operation, ...]:
    """The w_i, their weighted sum V and its gradient."""
    g, field = at.plant.graph, at.sizes.field
    weights, graphs = _weights(at)
    outputs = [
        (field("angular_frequency", "MODES", "rad/s", "undamped, ascending", scale="itself"),
         ca.sqrt(graphs["omega_squared"]), ca.sqrt(graphs["omega_squared"])),
        (field("w", "MODES", "m/(N s^2)" if at.control == "transpose" else "1/(kg m^2)", "w_i = lambda_min(R_i + "
               "R_i^T) = a.b - |a||b|, at most 0", scale="|a_i||b_i|"), graphs["w"], graphs["size"]),
        (field("w_size", "MODES", "as w", "|a_i||b_i|, the size of R_i = a_i b_i^T", scale="itself"), graphs["size"],
         graphs["size"]),
        (field("value", "", "as w", "V = sum of weights_i w_i", scale="sum of weights_i |a_i||b_i|"), graphs["V"],
         graphs["V_size"]),
        (field("gradient", "CHOICE", "V per m, V per rad", "dV/dz, z = [placement; joint_angles]",
               scale="sum of weights_i (|a_i||b_i| + |dw_i/dz|)"), graphs["V_z"], graphs["V_z_size"]),
    ]  # fmt: skip
    text = (
        f"Measures of a posture under Jacobian {at.control} control, passive coordinates at rest: w_i of every mode, "
        "their weighted sum V, and its exact gradient."
    )
    guards = _modal_guards(at, graphs)
    return (at.operation("measures", text, [(at.joint_angles, g.posture), weights], outputs, guards),)


def nullspace(at: Context) -> tuple[Operation, ...]:
    """The step of placement and joints along the self-motion."""
    plant, g, field = at.plant, at.plant.graph, at.sizes.field
    weights, graphs = _weights(at)
    gain = ca.SX.sym("step_gain")
    jacobian = plant.base_jacobian(at.base, g.posture, g.p)
    slope = graphs["V_z"]
    step = gain * (slope - apply_pseudo_inverse(jacobian, jacobian @ slope))
    gram = jacobian @ jacobian.T
    # 1 where all singular values of J_B are equal, 0 where one vanishes.
    isotropy = ca.det(gram) / (ca.trace(gram) / plant.n_task) ** plant.n_task
    limit = GAIN_MAX
    gain_field = field("step_gain", "", "z per dV/dz", "k_xi; a step along the gradient of V for k_xi > 0", low=-limit,
                       high=limit, sample=(1.0, 1e3))  # fmt: skip
    output = field("step", "CHOICE", "m, rad", "change of z = [placement; joint_angles]",
                   scale="|k_xi| times the gradient's")  # fmt: skip
    placed = Guard("isotropy", "det(J_B J_B^T) relative to equal singular values, 0 where J_B loses rank",
                   "SINGULAR_POSTURE", minimum=at.singularity_margin**2)  # fmt: skip
    guards = _modal_guards(at, graphs)
    text = (
        "Step of placement and joints that raises V and leaves the end-point where it is, to first order: "
        "(I - J_B^+ J_B) k_xi dV/dz. Metres and radians count alike in the projection."
    )
    inputs = [(at.joint_angles, g.posture), weights, (gain_field, gain)]
    outputs = [(output, step, ca.fabs(gain) * graphs["V_z_size"])]
    return (at.operation("nullspace_step", text, inputs, outputs, [*guards, (placed, isotropy)]),)


def margin(at: Context) -> tuple[Operation, ...]:
    """The robust stability margin."""
    plant, g, field = at.plant, at.plant.graph, at.sizes.field
    margin = build_margin(at.machine, at.control, compact=True)
    posture, kr, p = ca.MX.sym("posture", plant.n_actuated), ca.MX.sym("servo_gain"), ca.MX.sym("p", g.p.shape[0])
    base = ca.MX.sym("base", plant.n_base) if at.placement_matters else ca.MX.zeros(plant.n_base, 1)
    values: ca.MX = ca.MX(plant.parameter_values) if at.baked else p
    epsilon, *measured = _margin_of_end_point_states(margin).call([base, posture, values, kr])
    guards = [
        Guard("left_over", "what the doublings left", "NOT_ACCURATE", maximum=LEFT_OVER[at.single]),
        Guard("condition", "largest X_ii Z_ii of both Riccati solutions, by which rounding errors grow", "NOT_ACCURATE",
              maximum=CONDITION[at.single]),
    ]  # fmt: skip
    sine = plant.singularity_sine_squared.call([base, posture, values])[0]
    low, high = SERVO_GAIN_RANGE
    gain = field("servo_gain", "", "", "k_r, which multiplies the plant's input", low=low, high=high,
                 sample=(at.gain / 3, at.gain * 3), logarithmic=True)  # fmt: skip
    fields, symbols = [at.joint_angles, gain], [posture, kr]
    if at.placement_matters:
        fields, symbols = [*fields, at.placement], [*symbols, base]
    symbols = symbols if at.baked else [*symbols, p]
    names = [f.name for f in fields] + ([] if at.baked else ["p"])
    output = field("epsilon_max", "", "", "robust stability margin, in (0, 1)",
                   scale="1, or 1e-3 of the largest X_ii Z_ii where that is more")  # fmt: skip
    # ε_max does not need Jv⁻¹ under transpose control, but there is no margin where the end-point cannot be driven.
    results = [epsilon[0], sine, *measured]
    result_names = ["epsilon_max", "sine_squared", *(guard.name for guard in guards)]
    kernel = ca.Function("robust_margin", symbols, results, names, result_names)
    scales = ca.Function("robust_margin_scales", symbols, [ca.fmax(1, 1e-3 * measured[1])], names, ["epsilon_max"])
    text = (
        f"Robust stability margin epsilon_max of the plant (A, k_r B, C) under Jacobian {at.control} control, passive "
        "coordinates at rest, by structure-preserving doubling of both Riccati equations."
    )
    return (
        Operation("robust_margin", text, tuple(fields), (output,), (at.regular(modal=True), *guards), kernel, scales),
    )


def _margin_of_end_point_states(margin: Margin) -> ca.Function:
    """(base, posture, p, kr) -> epsilon (2, 1), what the doublings left, condition: `Margin.values` of other states.

    With the end-point itself and its rate as states, in place of the arm's contribution r_a to it, the products
    X_ii Z_ii, which amplify rounding errors, are some thirty times smaller: single precision needs that.
    """
    plant, n, k, m = margin.plant, margin.n_states, margin.n_rates, margin.plant.n_passive
    r = plant.n_task
    a, b, c = ca.SX.sym("A", n, n), ca.SX.sym("B", n, r), ca.SX.sym("C", r, n)
    # y = Cp η + Ca r_a, and Ca is diagonal; rates of r_a are scaled like r_a itself unless all joint rates are kept.
    share = ca.diag(1 / ca.diag(c[:, k + m :])) @ c[:, k : k + m]
    rate_share = ca.SX.zeros(k - m, m) if margin.keeps_joint_rates else share
    forward, back = (ca.diagcat(_lower(sign * rate_share, k), _lower(sign * share, n - k)) for sign in (1, -1))
    into, out = forward @ b, ca.horzcat(ca.SX.zeros(r, k + m), c[:, k + m :])
    outputs = [ca.densify(x) for x in (forward @ a @ back, into @ into.T, out.T @ out)]
    change = ca.Function("end_point_states", [a, b, c], outputs, {"cse": True})
    x, z = (ca.SX.sym(name, n, n) for name in ("X", "Z"))
    condition = ca.Function("condition", [x, z], [ca.mmax(ca.diag(x) * ca.diag(z))])
    g = plant.graph
    symbols = [ca.MX.sym("base", g.base.shape[0]), ca.MX.sym("posture", g.posture.shape[0]),
               ca.MX.sym("p", g.p.shape[0]), ca.MX.sym("kr")]  # fmt: skip
    plant_matrices = margin.scaled_plant.call([*symbols, *margin.hold.call(symbols)])
    solution = riccati_pair(n, margin.doublings, compact=True).call(change.call(plant_matrices))
    values = top_eigenpairs(n).call(solution[:2])[0]
    outputs_of = [1 / ca.sqrt(1 + values), solution[2], *condition.call(solution[:2])]
    return ca.Function("margin", symbols, outputs_of)


def _lower(block: ca.SX, size: int) -> ca.SX:
    """The identity with `block` in its lower left corner."""
    matrix = ca.SX.eye(size)
    rows, columns = block.shape
    matrix[size - rows :, :columns] = block
    return matrix


def _weights(at: Context) -> tuple[tuple[Field, ca.SX], Mapping[str, ca.SX]]:
    """The input α, and graphs of w, V = Σ α_i w_i, its gradient and their sizes."""
    g, measures = at.plant.graph, at.measures
    arguments = {"base": at.base, "posture": g.posture, "p": g.p}
    alpha = ca.SX.sym("weights", at.plant.n_passive)
    values, slopes = measures.w(**arguments), measures.gradients(**arguments)["w_z"]
    w, size, all_values = values["w"], values["scale"], measures.values(**arguments)
    graphs = {
        "modes": all_values["modes"],
        "w": w,
        "size": size,
        "omega_squared": all_values["omega_squared"],
        "V": ca.dot(alpha, w),
        "V_size": ca.dot(alpha, size),
        "V_z": slopes.T @ alpha,
        "V_z_size": ca.dot(alpha, size + ca.sqrt(ca.sum2(slopes**2))),
    }
    field = at.sizes.field("weights", "MODES", "", "alpha_i of V, one for each mode", high=WEIGHT_MAX,
                           sample=(0.0, 1.0))  # fmt: skip
    return (field, alpha), graphs


def _modal_guards(at: Context, graphs: Mapping[str, ca.SX]) -> list[tuple[Guard, ca.SX]]:
    """Where the w_i can be computed accurately enough."""
    guards = [] if at.control == "transpose" and not at.single else [(at.regular(modal=True), sine_squared(at))]
    if not at.single:
        return guards
    # |a_i||b_i| relative to the terms that a_i = J φ_i and b_i are summed from.
    plant, g, m = at.plant, at.plant.graph, at.plant.n_passive
    arguments = (plant.rest(at.base, g.posture, g.p), at.base, g.p)
    jacobian, rigid, modes = plant.jacobian(*arguments), plant.rigid_jacobian(*arguments), graphs["modes"]
    into = rigid if at.control == "transpose" else apply_pseudo_inverse(rigid, ca.SX.eye(plant.n_task)).T
    sizes = [ca.sqrt(ca.sum1(matrix**2)) for matrix in (jacobian, into)]
    terms = (sizes[0] @ ca.fabs(modes)) * (sizes[1] @ ca.fabs(modes[m:, :]))
    guard = Guard("significance", "smallest |a_i||b_i| relative to the terms it is summed from", "NOT_ACCURATE",
                  minimum=SINGLE_SIGNIFICANCE)  # fmt: skip
    return [*guards, (guard, ca.mmin(graphs["size"] / terms.T))]
