"""The measures of a machine as CasADi Functions of placement, posture and parameters: values and exact derivatives.

The solutions of the iterations (static deflection, eigenvectors) enter as a vector `held` that is not differentiated:
`hold` computes it, and all derivatives come from `expansion`, which is exact about it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca

from flexopt import compiled
from flexopt.foundation.boundary import instance, public, public_class
from flexopt.foundation.control import Control
from flexopt.foundation.kept import Structural, structural_property
from flexopt.model import AnyMachine
from flexopt.plant import Plant, build_plant
from flexopt.plant.singularity import screened
from flexopt.plant.statics import left_over
from flexopt.robustness.expansion import Expansion, HeldGraphs
from flexopt.robustness.modes import WRITTEN_OUT, modes_function, quick_modes
from flexopt.robustness.residues import rigid_residue

NAMES = ["base", "posture", "p"]
# Nodes of a graph up to which equal parts of it are looked for.
CSE_MAX = 20_000
# Of what the static deflection may leave over, relative to the weight, and of the modes' orthogonality.
SOLVE_TOLERANCE = 1e-8


@public_class(plant=instance(Plant, "a Plant, from flexopt.build_plant"))
@dataclass(frozen=True)
class Measures(Structural):
    """Measures of one machine under one controller.

    Functions take base (n_b,), posture (n,) and p (n_par,). The number of modes is m = `plant.n_passive`.

    Example:
        >>> measures = flexopt.build_measures(flexopt.load("excavator"))
        >>> flexopt.evaluate_w(measures, [0.0], [[0.9929], [-2.6306]]).w.shape
        (3, 1)
    """

    plant: Plant
    control: Control
    gravity: bool

    def __repr__(self) -> str:
        under = " under gravity" if self.gravity else ""
        modes = f"{self.plant.n_passive} mode{'s' if self.plant.n_passive > 1 else ''}"
        return f"Measures({self.plant.machine.name!r}: {modes} under Jacobian {self.control} control{under})"

    @cached_property
    def expansion(self) -> Expansion:
        """Where derivatives come from."""
        return Expansion(self.plant, self.control, self.gravity)

    @structural_property
    def hold(self) -> ca.Function:
        """(base, posture, p) -> `held` of `Expansion`: deflection and modes by iteration, and no derivative.

        Of many modes by calls, built in a fraction of the time.
        """
        symbols, called = self._symbols, self.plant.n_passive > WRITTEN_OUT
        parts, _ = self.expansion.hold(symbols, modes_function(self.plant.n_passive))
        held = [ca.veccat(*list[ca.MX](parts.values()))]
        options = {"is_diff_out": [False], "never_inline": called}
        return ca.Function("hold", symbols, held, NAMES, ["held"], options)

    @structural_property
    def values(self) -> ca.Function:
        """(base, posture, p) -> the measures by name. m modes, r task rows.

        `omega_squared` ω_i² (m, 1), ascending; `zeta` φ_iᵀ D φ_i / (2 ω_i) (m, 1), damping ratios to first order in the
        damping; `modes` φ_i (n_q, m), mass-normalised; `a`, `b` (r, m), columns of R_i = a_i b_iᵀ; `same` (m, m),
        clusters of equal frequencies; `w` (m, 1); `rigid` R_0 (r, r); `q` (n_q,) and `end_point` r(q) (r,);
        `static_residual` (m,), the force left over by the static deflection; 0 without gravity.
        """
        at, pencil, held = self.expansion.point, self.expansion.pencil, self.expansion.held_parts
        modes = ca.vertcat(held["modes"], pencil.follow @ held["modes"])
        outputs = {
            "omega_squared": held["omega_squared"],
            "zeta": ca.diag(modes.T @ at.damping @ modes) / (2 * ca.sqrt(held["omega_squared"])),
            "modes": modes,
            "a": held["f"][: self.plant.n_task, :],
            "b": held["f"][self.plant.n_task :, :],
            "same": held["same"],
            "rigid": rigid_residue(at, pencil, self.control),
            "q": at.q,
            "end_point": at.end_point,
            "static_residual": at.static_residual,
        }
        return _function("measures", self._symbols, self._behind_hold(outputs) | {"w": self._w}, cse=False)

    @structural_property
    def w(self) -> ca.Function:
        """(base, posture, p) -> w (m, 1), with |a_i||b_i| beside it as `scale` (m, 1)."""
        outputs = {"w": self._w, "scale": self.expansion.sizes(self._held)}
        outputs |= self._behind_hold({"end_point": self.expansion.point.end_point})
        return _function("w", self._symbols, outputs)

    @structural_property
    def gradients(self) -> ca.Function:
        """(base, posture, p) -> exact derivatives, z = [base, posture].

        Outputs ∂w/∂z (m, n_b + n) as `w_z`, ∂w/∂p (m, n_par) as `w_p`, ∂r/∂z (n_task, n_b + n) as `end_point_z`.
        """
        g = self.plant.graph
        z = ca.vertcat(g.base, g.posture)
        at, held = self._symbols, self._held
        slopes, n_z = self.expansion.jacobian(ca.vertcat(z, g.p), at, held), z.shape[0]
        outputs = {"w_z": slopes[:, :n_z], "w_p": slopes[:, n_z:], "end_point_z": self.end_point_gradient.call(at)[0]}
        return _function("gradients", at, outputs, cse=False)

    @structural_property
    def weighted_gradient(self) -> ca.Function:
        """(base, posture, p, alpha (m,)) -> exact ∂(Σ αi wi)/∂z (1, n_z), z = [base, posture]."""
        slope = self.expansion.slope
        *at, _, alpha = slope.mx_in()
        outputs = [slope.call([*at, *self.hold.call(at), alpha])[1].T]
        return ca.Function("weighted_gradient", [*at, alpha], outputs, [*NAMES, "alpha"], ["V_z"])

    @structural_property
    def factors(self) -> ca.Function:
        """(base, posture, p) -> `f` = [a_i; b_i] (2r, m), exact slopes of its columns by z as `f_z`, and `same`.

        `f_z` is (2r m, n_b + n); `same` (m, m) has 1 where modes have the same frequency.
        """
        at = [ca.MX.sym(name, x.shape[0]) for name, x in zip(NAMES, self.inputs, strict=True)]
        held = self.expansion.parts(self.hold.call(at)[0])
        slopes = self.expansion.factor_slopes(at, held)
        return _function("factors", at, {"f": held["f"], "f_z": slopes, "same": held["same"]})

    @structural_property
    def end_point_gradient(self) -> ca.Function:
        """(base, posture, p) -> exact ∂r/∂z (n_task, n_z), z = [base, posture]."""
        g = self.plant.graph
        outputs = {"end_point_z": ca.jacobian(self.expansion.point.end_point, ca.vertcat(g.base, g.posture))}
        if not self.gravity:
            return _function("end_point_gradient", self.inputs, outputs)
        return _function("end_point_gradient", self._symbols, self._behind_hold(outputs))

    @structural_property
    def w_with_gradient(self) -> ca.Function:
        """(base, posture, p) -> w (m, 1), exact ∂w/∂posture (m, n) as `w_posture`."""
        at, held = self._symbols, self._held
        slopes = self.expansion.jacobian(self.plant.graph.posture, at, held)
        return _function("w_with_gradient", at, {"w": self._w, "w_posture": slopes})

    @structural_property
    def quick(self) -> ca.Function:
        """(base, posture, p) -> w (m, 1) and `gap`: for many points, by `quick_batch`.

        As `w`, but modes come from `solve_modes_quickly` and every frequency counts as simple: error some 3e-15 / gap
        of |a_i||b_i|. Unless gap ≥ `TRUSTED_GAP`, ask `w`; `flexopt.robustness.batches` does.
        """
        w, gap, _ = self._quickly
        return _function("quick", self.inputs, {"w": w, "gap": gap})

    @structural_property
    def quick_with_gradient(self) -> ca.Function:
        """(base, posture, p) -> the outputs of `quick`, and exact ∂w/∂posture (m, n) as `w_posture`."""
        w, gap, held = self._quickly
        slopes = self.expansion.jacobian(self.plant.graph.posture, self.inputs, held)
        return _function("quick_with_gradient", self.inputs, {"w": w, "gap": gap, "w_posture": slopes})

    @structural_property
    def quick_batch(self) -> compiled.Batch:
        """`quick` at many points."""
        return compiled.batch(self.quick)

    @structural_property
    def quick_batch_with_gradient(self) -> compiled.Batch:
        """`quick_with_gradient` at many points."""
        return compiled.batch(self.quick_with_gradient)

    @structural_property
    def sound(self) -> ca.Function:
        """(base, posture, p) -> what tells the points that have no measures; see `flexopt.robustness.batches`.

        Outputs of `flexopt.plant.singularity.screened`; under gravity also `left_over`, of the static deflection
        relative to the weight, and `least_pivot` of the stiffness that holds it, else empty.
        """
        g, plant = self.plant.graph, self.plant
        outputs = screened(plant) | {"left_over": ca.SX(0, 1), "least_pivot": ca.SX(0, 1)}
        if self.gravity:
            m = plant.n_passive
            at = plant.operating_point(g.base, g.posture, g.p, plant.deflected(g.base, g.posture, g.p))
            outputs["left_over"] = left_over(plant, at.q, at.static_residual)
            outputs["least_pivot"] = ca.mmin(ca.ldl(ca.densify(at.stiffness[:m, :m]))[0])
        return _function("sound", self.inputs, outputs)

    @structural_property
    def sound_batch(self) -> compiled.Batch:
        """`sound` at many points."""
        return compiled.batch(self.sound)

    @structural_property
    def _quickly(self) -> tuple[ca.SX, ca.SX, HeldGraphs]:
        """The w_i (m, 1), the gap, and what `hold` would give."""
        expansion = self.expansion
        held, (squares, gap) = expansion.hold(self.inputs, quick_modes(self.plant.n_passive))
        # w is of second degree in the modes: to divide by φᵀ M̄ φ afterwards saves as many square roots.
        w = expansion.slopes(held, ca.DM.ones(self.plant.n_passive))[0] / squares
        lengths = ca.sqrt(ca.SX(squares)).T
        for name in ("modes", "f"):
            held[name] /= ca.repmat(lengths, held[name].shape[0], 1)
        return w, gap, held

    @property
    def inputs(self) -> list[ca.SX]:
        """Symbols base, posture, p."""
        g = self.plant.graph
        return [g.base, g.posture, g.p]

    @structural_property
    def _symbols(self) -> list[Any]:
        """`inputs`, or the like for graphs of calls."""
        if self.plant.n_passive <= WRITTEN_OUT:
            return self.inputs
        return [ca.MX.sym(name, x.shape[0]) for name, x in zip(NAMES, self.inputs, strict=True)]

    @structural_property
    def _held(self) -> HeldGraphs:
        """What `hold` gives there."""
        return self.expansion.parts(self.hold.call(self._symbols)[0])

    @structural_property
    def _w(self) -> Any:
        """The w_i there."""
        return self.expansion.slopes(self._held, ca.DM.ones(self.plant.n_passive))[0]

    def _behind_hold(self, outputs: Mapping[str, ca.SX]) -> dict[str, Any]:
        """Graphs of base, posture, p and held, with what `hold` gives in the place of held."""
        dense = [ca.densify(output) for output in outputs.values()]
        inner = ca.Function("inner", [*self.inputs, *self.expansion.held_parts.values()], dense)
        return dict(zip(outputs, inner.call([*self._symbols, *self._held.values()]), strict=True))


def _function(name: str, at: list[Any], outputs: Mapping[str, Any], *, cse: bool = True) -> ca.Function:
    """A Function of (base, posture, p), in which equal parts are computed once unless it is too large.

    `cse=False` for what is called once for a posture: to search for equal parts takes longer than they do.
    """
    dense: list[Any] = [ca.densify(each) for each in outputs.values()]
    names = list(outputs)
    function = ca.Function(name, at, dense, NAMES, names)
    # On large graphs the search takes a second and finds little.
    if not cse or isinstance(at[0], ca.MX) or function.n_nodes() > CSE_MAX:
        return function
    return ca.Function(name, at, dense, NAMES, names, {"cse": True})


@public()
def build_measures(machine: AnyMachine, control: Control = "inverse", gravity: bool = False) -> Measures:
    """The measures of a machine (their graphs are built once for each structure, and kept).

    Args:
        machine: from `flexopt.load`.
        control: Jacobian `"inverse"`, `"transpose"` or `"damped:LAMBDA"`, as in `flexopt.evaluate`.
        gravity: under static deflection.

    Raises:
        InputError: an argument is not usable.

    Example:
        >>> measures = flexopt.build_measures(flexopt.load("excavator"), "inverse")
        >>> measures.plant.n_passive
        3
    """
    return Measures(build_plant(machine), control, gravity)
