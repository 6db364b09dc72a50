"""All measures of one posture, as numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from flexopt.coprime.margin import with_bound
from flexopt.errors import FlexoptWarning, InputError, NoSolutionFound
from flexopt.foundation.arrays import BaseLike, Document, PostureLike, Vector
from flexopt.foundation.boundary import public
from flexopt.foundation.control import Control, gain_units
from flexopt.foundation.documents import provenance
from flexopt.foundation.later import later
from flexopt.foundation.results import Result
from flexopt.foundation.rounding import ROUNDING, without_rounding
from flexopt.foundation.warned import warn_user
from flexopt.model import AnyMachine
from flexopt.model.loop import Loop, LoopLike, control_of, under_control
from flexopt.plant.hydraulics import CylinderState, build_hydraulics
from flexopt.plant.singularity import check_regular
from flexopt.plant.statics import check_held, check_settled
from flexopt.robustness.margin import build_margin
from flexopt.robustness.measures import SOLVE_TOLERANCE, Measures, build_measures
from flexopt.robustness.plausibility import warn_implausible
from flexopt.robustness.posture_margin import evaluate_margin, prepare_margin
from flexopt.robustness.residues import MIXED, residue_unit, unit_in_words

if TYPE_CHECKING:
    from flexopt.robustness.damped import DampedModes

# What is told of how the machine sags, m or rad.
LEAST_SAG = 1e-5
# What a rigid part that is not passive means.
EXCITES = "equal gains in all rows damp the rigid part, some other gains excite it"
# Below this share of the largest |a_i||b_i| a mode is not reached: what is left where a_i = 0 was sought is rounding,
# and its direction chance.
UNREACHED = 1e-11


@dataclass(frozen=True)
class Gradient:
    """Exact derivatives of the measures.

    Attributes:
        variables: placement coordinates, then actuated joints.
        w: ∂w_i/∂variables, (m, n_b + n), per m or rad, as `base_units` and `joint_units` say.
        epsilon_max: ∂ε_max/∂variables, (n_b + n,); NaN (JSON: null) where it is not known, which a warning says.
        parameters: names of the machine's parameters p.
        w_parameters: ∂w_i/∂p, (m, n_par).
        epsilon_max_parameters: ∂ε_max/∂p, (n_par,).
        epsilon_max_gain: ∂ε_max/∂kr.
        epsilon_max_kink: where the two largest eigenvalues of XZ meet, so that ε_max has a kink, the rows g_11, g_22
            and g_12, (3, n_b + n), of `epsilon_max_along`. None elsewhere.
        epsilon_max_error, epsilon_max_parameters_error, epsilon_max_gain_error: bounds on the errors of ∂ε_max, shaped
            like it, to first order.
    """

    variables: tuple[str, ...]
    w: Vector
    epsilon_max: Vector
    parameters: tuple[str, ...]
    w_parameters: Vector
    epsilon_max_parameters: Vector
    epsilon_max_gain: float
    epsilon_max_kink: Vector | None
    epsilon_max_error: Vector
    epsilon_max_parameters_error: Vector
    epsilon_max_gain_error: float

    def epsilon_max_along(self, direction: Vector) -> tuple[float, float]:
        """Derivatives of the two branches of ε_max along d (n_b + n,), the smaller one that of ε_max itself.

        Eigenvalues of [[g_11·d, g_12·d], [g_12·d, g_22·d]] at a kink; elsewhere twice the gradient's product with d.
        """
        if self.epsilon_max_kink is None:
            slope = float(self.epsilon_max @ direction)
            return slope, slope
        first, second, cross = self.epsilon_max_kink @ direction
        low, high = np.linalg.eigvalsh(np.array([[first, cross], [cross, second]]))
        return float(low), float(high)


@dataclass(frozen=True)
class Evaluation(Result):
    """What one posture is worth. m modes, ordered by frequency; r task rows. SI and rad unless the name says otherwise.

    Attributes:
        machine: the machine's name.
        control: `"inverse"`, `"transpose"` or `"damped:LAMBDA"`.
        base, base_coordinates, base_units: placement (n_b,), its names and units, m or rad.
        posture, joints, joint_units: actuated joints (n,), their names and units, rad or m.
        end_point: the task (r,), m, inertial frame.
        frequencies_hz, damping_ratios: (m,). Undamped frequencies and φᵀDφ/(2ω); with `damped` those of the poles.
        w: w_i = λmin(R_i + R_iᵀ), (m,), article eq. (7); with `damped` λmin(N0 + N0ᵀ).
        scale: |a_i||b_i|, (m,), the size of R_i = a_i b_iᵀ, to compare w_i with; with `damped` that of N0 (Frobenius
            norm, without damping the same).
        rigid: λmin(R_0 + R_0ᵀ); negative values mean that the rigid part is not passive. Of the undamped plant always.
        in_phase: trace R_i > 0;  in_phase_strict: every diagonal element of R_i ≥ 0, to rounding of |a_i||b_i|; with
            `damped` of N0.
        rigid_residue: R_0 (r, r), undamped;  residues: R_i (m, r, r), with `damped` N0, summed over the cluster where
            frequencies (poles) repeat.
        gradient: exact derivatives of w.
        clusters: groups of modes with equal frequencies, for which w is that of the cluster's sum.
        condition: cond Jv; of one task row, the end-point's mobility over that along the row, where that is larger.
        static_deflection: passive coordinates minus their rest values, (m,); zero without gravity.
        passive, passive_units: names and units of these coordinates, rad or m;  sag_told: by how much the machine sags,
            a sentence; empty without gravity.
        self_motion_unstabilised: whether the arm has more joints than task rows, so that a motion exists that the
            end-point neither sees nor controls.
        epsilon_max: ε_max of the damped plant with the servo gain `gain`, Appendix A; None where `epsilon_max_status`
            says so.
        epsilon_max_error: bound on its error: what the residuals of its Riccati equations prove, and to first order
            what evaluating the plant in double precision would change; NaN without ε_max.
        epsilon_max_status: `"computed"`; `"not stabilizable"` where no feedback of the end-point stabilises the plant
            (proven: ε_max < 1e-12, or a mode at 0 that no input reaches or no output sees, to thirty digits);
            `"not computed"` where no bound below 1e-6 was reached, which says nothing about the plant.
        epsilon_max_residual: largest relative residual of its Riccati equations, in extended precision.
        gain: servo gain kr.
        damped: numerators N0, N1 and poles with damping, where asked for.
        damped_difference: largest |w_damped − w_undamped| / (|a||b|), where damping was asked for.
        skeleton: points to draw, a column each, m, inertial frame, as in `Plant.skeleton`.
        cylinders: hydraulic cylinders in this posture, of a machine that has some.
        outcome: what the controller does, `flexopt.Outcome`, where one is known.
        warnings: sentences about repeated frequencies and the like.

    Example:
        >>> evaluation = flexopt.evaluate(flexopt.load("excavator"), (0.9929, -2.6306))
        >>> evaluation.frequencies_hz.round(2)
        array([ 3.04, 13.26, 22.3 ])
        >>> evaluation.gradient.w.shape  # by base, boom and stick
        (3, 3)
    """

    DOCUMENT = """
    machine control base base_coordinates base_units posture joints joint_units end_point[m] frequencies_hz[Hz]
    damping_ratios w scale rigid in_phase in_phase_strict epsilon_max epsilon_max_error epsilon_max_status
    epsilon_max_residual gain gradient residues.R0=rigid_residue residues.R=residues clusters condition
    static_deflection passive passive_units self_motion_unstabilised damped=_damped warnings provenance
    cylinders=_cylinders outcome
    """

    machine: str
    control: Control
    base: Vector
    base_coordinates: tuple[str, ...]
    base_units: tuple[str, ...]
    posture: Vector
    joints: tuple[str, ...]
    joint_units: tuple[str, ...]
    end_point: Vector
    frequencies_hz: Vector
    damping_ratios: Vector
    w: Vector
    scale: Vector
    rigid: float
    in_phase: tuple[bool, ...]
    in_phase_strict: tuple[bool, ...]
    rigid_residue: Vector
    residues: Vector
    gradient: Gradient
    clusters: tuple[tuple[int, ...], ...]
    condition: float
    static_deflection: Vector
    passive: tuple[str, ...]
    passive_units: tuple[str, ...]
    self_motion_unstabilised: bool
    epsilon_max: float | None
    epsilon_max_error: float
    epsilon_max_status: str
    epsilon_max_residual: float
    gain: float
    damped: DampedModes | None
    damped_difference: float | None
    skeleton: Vector
    warnings: tuple[str, ...]
    cylinders: tuple[CylinderState, ...]
    provenance: Document = field(repr=False)
    outcome: Result | None = None

    @property
    def z(self) -> Vector:
        """[base, posture], (n_b + n,), m or rad."""
        return np.concatenate([self.base, self.posture])

    @property
    def sag_told(self) -> str:
        """See the class."""
        return most_sag_told([self])

    def document(self) -> Document:
        """Values by their keys; cylinders and outcome only where there are some."""
        there = {"cylinders": bool(self.cylinders), "outcome": self.outcome is not None}
        absent = {key for key, is_there in there.items() if not is_there}
        return {key: x for key, x in super().document().items() if key not in absent}

    @property
    def _cylinders(self) -> list[dict[str, Any]]:
        return [cylinder._asdict() for cylinder in self.cylinders]

    @property
    def _damped(self) -> dict[str, Any] | None:
        return self.damped and {
            "poles": self.damped.poles,
            "N0": self.damped.n0,
            "N1": self.damped.n1,
            "difference": self.damped_difference,
            "w_error": self.damped.w_z_error,
            "w_parameters_error": self.damped.w_p_error,
        }

    def __repr__(self) -> str:
        angles = in_words(self.joints, self.posture, self.joint_units)
        placed = in_words(self.base_coordinates, self.base, self.base_units) or "fixed"
        point = ", ".join(f"{x:z.4f}" for x in self.end_point)
        unit = residue_unit(self.control, self.joint_units)
        heading = f"w, {unit}"
        lines = [
            f"{self.machine}, Jacobian {self.control} control: base {placed}; {angles}; end-point ({point}) m",
            f"  mode   frequency    damping {heading:>13}      w/|a||b|   in phase",
        ]
        hidden = unreached(self.scale)
        for i, w in enumerate(without_rounding(self.w, self.scale)):
            start = f"  {i + 1:4d} {self.frequencies_hz[i]:8.4f} Hz {self.damping_ratios[i]:10.3e}"
            if hidden[i]:
                lines.append(f"{start} {0.0:13.5e} {'–':>13}   –")
                continue
            phase = "strictly" if self.in_phase_strict[i] else "yes" if self.in_phase[i] else "no"
            lines.append(f"{start} {w:13.5e} {w / self.scale[i]:13.5e}   {phase}")
        if hidden.any():
            lines.append("    –: the end-point does not move in that mode, or no feedback excites it")
        rigid = f"{self.rigid:.5e} {unit_in_words(unit)}"
        lines.append(f"  rigid part: λmin(R0 + R0ᵀ) = {rigid}; cond Jv = {self.condition:.4g}")
        if excites_rigid(self):
            lines.append(f"    negative: {EXCITES}")
        if self.epsilon_max is not None:
            margin = with_bound(self.epsilon_max, self.epsilon_max_error)
            gain = f"{self.gain:g} {gain_units(self.control, self.joint_units)[0]}"
            lines.append(f"  robust stability margin ε_max = {margin} at gain kr = {gain}")
        if self.damped_difference is not None:
            lines.append(
                f"  with damping; differs from the undamped measures by {self.damped_difference:.2e} of |a||b|"
            )
        if unit == MIXED:
            lines.append(
                "  mixed units: 1/(kg m2) of hinges, 1/kg of slides; they compare postures of this machine alone"
            )
        lines += [f"  {self.sag_told}"] if self.sag_told else []
        lines += [f"  {cylinder}" for cylinder in self.cylinders]
        lines += [] if self.outcome is None else repr(self.outcome).splitlines()
        return "\n".join([*lines, *(f"  warning: {w}" for w in self.warnings)])


def excites_rigid(e: Evaluation) -> bool:
    """Whether λmin(R_0 + R_0ᵀ) is negative, beyond rounding."""
    return bool(e.rigid < -ROUNDING * np.abs(e.rigid_residue).max())


def unreached(scale: Vector) -> NDArray[np.bool_]:
    """Modes (m,) in which the end-point does not move, or that no feedback excites, of |a_i||b_i| (m,).

    Their w_i/|a_i||b_i| and phase have no meaning, and are not shown.
    """
    return np.asarray(scale <= UNREACHED * scale.max(initial=0.0))


def most_sag_told(stands: Sequence[Evaluation]) -> str:
    """By how much a machine sags at each of its targets, of several each coordinate's most, a sentence.

    Empty without gravity.
    """
    sags, first = np.array([each.static_deflection for each in stands]), stands[0]
    if not sags.any():
        return ""
    away = list[str]()
    for name, unit, sag in zip(first.passive, first.passive_units, sags.T, strict=True):
        k, told = int(np.abs(sag).argmax()), [f"{x:.3g}" for x in sag.tolist()]
        alike = " at every target" if len({*told}) == 1 else f" at target {k + 1}"
        if abs(sag[k]) >= LEAST_SAG:
            away.append(f"{name} {told[k]} {unit}{alike if len(stands) > 1 else ''}")
    most = ", each coordinate's most" if len(stands) > 1 else ""
    return f"sag under the weight, from where the file has it with springs unloaded{most}: {', '.join(away) or 'none'}"


def in_words(names: tuple[str, ...], values: Vector, units: tuple[str, ...]) -> str:
    """Names and values, each unit after the last of those that share it."""
    parts: list[str] = []
    for k, (name, value, unit) in enumerate(zip(names, values, units, strict=True)):
        shared = k + 1 < len(units) and units[k + 1] == unit
        parts.append(f"{name} {value:z.4f}" + ("" if shared else f" {unit}"))
    return ", ".join(parts)


@public()
def evaluate(
    machine: AnyMachine,
    posture: PostureLike,
    *,
    base: BaseLike | None = None,
    control: Control | None = None,
    gain: float = 5e5,
    damped: bool = False,
    gravity: bool = False,
    loop: LoopLike | None = None,
) -> Evaluation:
    """Frequencies, residues, measures w_i and their exact gradients at one posture.

    Passive coordinates are at rest, or with `gravity` at static equilibrium, gravity's stiffness in the passive block.

    Args:
        machine: from `flexopt.load`.
        posture: actuated joints (n,), rad or m.
        base: placement (n_b,), m or rad: of a planar machine x alone; the origin by default.
        control: Jacobian `"inverse"` (the default; the Moore–Penrose inverse for a redundant arm), `"transpose"`, or
            `"damped:LAMBDA"`, the inverse Jvᵀ (Jv Jvᵀ + λ² I)⁻¹ with λ in the unit of Jv's entries, which singular
            postures have too.
        gain: servo gain kr of the margin ε_max.
        damped: measures, their gradients, residues, scale and phases from the numerators N0 of the damped plant instead
            of R_i; only the rigid residue stays that of the undamped one.
        gravity: solve for the static deflection.
        loop: the real controller, `flexopt.Loop` or a table of its keys, of which those left out follow from the
            machine, or `"default"`: what it allows and does is then evaluated, too. By default the machine's `[loop]`.

    Raises:
        InputError: an argument has the wrong shape, is not finite or is out of range (all faults in one message); under
            gravity, the springs do not hold the machine; with `damped`, a mode is overdamped.
        SingularPosture: Jv loses rank.
        NoSolutionFound: the static deflection or the modes did not converge.

    Source: ASME Letters in Dynamic Systems and Control 1(2), 021001, eqs. (1)–(10); mode derivatives after Fox and
    Kapoor, AIAA Journal 6(12), 1968.

    Example:
        >>> machine = flexopt.load("excavator")
        >>> evaluation = flexopt.evaluate(machine, (0.9929, -2.6306))
        >>> evaluation.w.round(8)
        array([-2.9675e-04, -3.0860e-05, -9.7000e-07])
        >>> evaluation.frequencies_hz.round(3)
        array([ 3.039, 13.258, 22.298])
        >>> round(evaluation.epsilon_max, 4)
        0.2865
    """
    warn_implausible(machine)
    placement = np.zeros(len(machine.base_coordinates)) if base is None else cast(Vector, base)
    real = cast("Loop | None", machine.loop if loop is None else loop)
    chosen = control_of(control, real, machine)
    where = cast(Vector, posture)
    found = evaluate_checked(
        machine, where, placement, control=chosen, gain=gain, damped=damped, gravity=gravity, gradient_shown=True
    )
    return found if real is None else _with_loop(machine, real, found, gravity=gravity)


def _with_loop(machine: AnyMachine, loop: Loop, stand: Evaluation, *, gravity: bool) -> Evaluation:
    """The same with what the loop does."""
    loop = under_control(loop, machine, stand.control, "evaluate")
    # The loop's room is built on this one.
    evaluate_loop = cast("Callable[..., Result]", later("flexopt.loop", evaluation="evaluate_loop")("evaluate_loop"))
    done = evaluate_loop(machine, loop, stand, gravity=gravity)
    options = stand.provenance["options"] | {"loop": loop.model_dump(exclude_unset=True)}
    return replace(stand, outcome=done, provenance=stand.provenance | {"options": options})


def prepare(machine: AnyMachine, control: Control, *, gravity: bool) -> None:
    """Build the graphs of `evaluate` now, so that it need not."""
    measures, margin = build_measures(machine, control, gravity), build_margin(machine, control, gravity)
    assert measures.values is not None
    assert measures.gradients is not None
    prepare_margin(margin)


def evaluate_checked(
    machine: AnyMachine,
    posture: Vector,
    base: Vector,
    *,
    control: Control,
    gain: float,
    damped: bool,
    gravity: bool,
    gradient_shown: bool = False,
) -> Evaluation:
    """`evaluate` for arguments that are known to be good.

    It warns of gradients where they are shown; the answer's own `warnings` tell of them in any case.
    """
    measures = build_measures(machine, control, gravity)
    plant = measures.plant
    p = plant.parameter_values
    m, r = plant.n_passive, plant.n_task
    rest = plant.rest(base, posture, p).full().ravel()
    condition = check_regular(plant, rest, base, control)
    v = {name: value.full() for name, value in measures.values(base=base, posture=posture, p=p).items()}
    _check_solved(measures, v, base)
    gradients = measures.gradients.call([base, posture, p])
    w_z, w_p = gradients[0].full(), gradients[1].full()

    a, b, same = v["a"], v["b"], v["same"]
    residues = np.stack([(a * same[i]) @ b.T for i in range(m)])
    omega = np.sqrt(v["omega_squared"].ravel())
    w, frequencies, ratios = v["w"].ravel(), omega / (2 * math.pi), v["zeta"].ravel()
    scale = np.linalg.norm(a, axis=0) * np.linalg.norm(b, axis=0)
    groups = sorted({tuple(np.flatnonzero(row > 0.5).tolist()) for row in same})
    clusters = tuple(g for g in groups if len(g) > 1)
    detail, difference = None, None
    if damped:
        from flexopt.robustness.damped import damped_modes  # noqa: PLC0415  (which few calls need)

        detail = damped_modes(machine, base, posture, control, gravity, float(omega[0]))
        difference = float(np.max(np.abs(detail.w - w) / np.where(scale > 0, scale, 1.0)))
        clusters = detail.clusters
        w, w_z, w_p, residues = detail.w, detail.w_z, detail.w_p, detail.summed()
        scale = np.linalg.norm(detail.n0, axis=(1, 2))
        frequencies = np.abs(detail.poles) / (2 * math.pi)
        ratios = -detail.poles.real / np.abs(detail.poles)
    traces = np.trace(residues, axis1=1, axis2=2)
    diagonals = np.diagonal(residues, axis1=1, axis2=2)
    margin = evaluate_margin(build_margin(machine, control, gravity), base, posture, gain)
    alone = [i for i in range(m) if not any(i in c for c in clusters)]
    untold = tuple(i for i in alone if detail is not None and not np.all(np.isfinite(w_z[i])))
    sentences, of_margin = _warnings(clusters, frequencies, damped), ((margin.warning,) if margin.warning else ())
    of_gradient = tuple(
        f"the gradient of w{i + 1} could not be computed to 1e-7: two poles nearly meet" for i in untold
    )
    if margin.epsilon_max is None:
        sentences += of_margin
    else:
        of_gradient = of_margin + of_gradient
    for sentence in sentences + (of_gradient if gradient_shown else ()):
        warn_user(sentence, FlexoptWarning)
    sentences += of_gradient
    _check_finite(w, w_z[[i for i in alone if i not in untold]], frequencies, ratios, traces)
    options = {"gain": gain, "damped": damped, "gravity": gravity}
    return Evaluation(
        machine=machine.name,
        control=control,
        base=base,
        base_coordinates=machine.base_coordinates,
        base_units=machine.base_units,
        posture=posture,
        joints=machine.joints,
        joint_units=machine.joint_units,
        end_point=v["end_point"].ravel(),
        frequencies_hz=frequencies,
        damping_ratios=ratios,
        w=np.where(scale > 0, w, 0.0),  # lengths of nothing are kept from zero in the graphs
        scale=scale,
        rigid=float(np.linalg.eigvalsh(v["rigid"] + v["rigid"].T)[0]),
        in_phase=tuple(bool(t > 0) for t in traces),
        in_phase_strict=tuple(bool(np.all(d >= -ROUNDING * size)) for d, size in zip(diagonals, scale, strict=True)),
        rigid_residue=v["rigid"],
        residues=residues,
        gradient=Gradient(
            variables=(*machine.base_coordinates, *machine.joints),
            w=w_z,
            epsilon_max=margin.z,
            parameters=plant.parameter_names,
            w_parameters=w_p,
            epsilon_max_parameters=margin.p,
            epsilon_max_gain=margin.kr,
            epsilon_max_kink=margin.kink,
            epsilon_max_error=margin.z_error,
            epsilon_max_parameters_error=margin.p_error,
            epsilon_max_gain_error=margin.kr_error,
        ),
        clusters=clusters,
        condition=condition,
        static_deflection=v["q"].ravel()[:m] - rest[:m],
        passive=machine.coordinates[:m],
        passive_units=machine.coordinate_units[:m],
        self_motion_unstabilised=plant.n_actuated > r,
        epsilon_max=margin.epsilon_max,
        epsilon_max_error=margin.error,
        epsilon_max_status=margin.status,
        epsilon_max_residual=margin.residual,
        gain=gain,
        damped=detail,
        damped_difference=difference,
        skeleton=plant.skeleton.call([v["q"], base, p])[0].full(),
        warnings=sentences,
        cylinders=build_hydraulics(machine).states(v["q"].ravel(), base) if machine.cylinders else (),
        provenance=provenance(machine, control=control, **options),
    )


def _check_solved(measures: Measures, v: dict[str, Vector], base: Vector) -> None:
    """Static equilibrium and modes, verified from their own equations."""
    plant, p = measures.plant, measures.plant.parameter_values
    q, modes, values = v["q"].ravel(), v["modes"], v["omega_squared"].ravel()
    m = plant.n_passive
    stiffness = plant.stiffness(p).full()
    if measures.gravity:
        check_settled(plant, q, base)
        stiffness = check_held(plant, q, base)
    _check_finite(modes, values, v["w"], v["a"], v["b"], v["rigid"])
    mass = plant.mass(q, base, p).full()
    worst = float(np.abs(modes.T @ mass @ modes - np.eye(m)).max())
    if np.all(values > 0):
        root = np.sqrt(values)
        worst = max(worst, float(np.abs((modes.T @ stiffness @ modes) / np.outer(root, root) - np.eye(m)).max()))
    else:
        worst = float("inf")
    if not worst <= SOLVE_TOLERANCE:
        raise NoSolutionFound(
            f"the modes did not converge (orthogonality off by {worst:.2g}); the machine's masses or stiffnesses "
            "differ by too many orders of magnitude",
            violations={"mode orthogonality": worst},
            iterate={},
        )


def _check_finite(*arrays: Vector) -> None:
    if not all(np.all(np.isfinite(array)) for array in arrays):
        raise InputError(
            "the machine's numbers are too far apart for double precision: masses, lengths or stiffnesses overflow or "
            "cancel; check their units"
        )


def _warnings(clusters: tuple[tuple[int, ...], ...], frequencies: Vector, damped: bool) -> tuple[str, ...]:
    sentences: list[str] = []
    for group in clusters:
        modes = " and ".join(str(i + 1) for i in group)
        at = float(np.mean(frequencies[list(group)]))
        gradient = " and has no gradient" if damped else ""
        sentences.append(
            f"modes {modes} share the frequency {at:.6g} Hz, so their residues are not unique: "
            f"w is that of their sum{gradient}"
        )
    return tuple(sentences)
