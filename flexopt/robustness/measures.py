"""The measures of a machine as CasADi Functions of placement, posture and parameters: values and exact derivatives.

Every Function stands on one graph, `Measures.graph`, in which the solutions of the iterations (static deflection,
eigenvectors) enter as a vector `held` that is not differentiated; the graph itself is exact to second order about
them (see `flexopt.algebra.eigen`). Composing it with `hold`, which computes that vector, gives values, gradients and
Hessians.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from types import MappingProxyType
from typing import Any

import casadi as ca

from flexopt import compiled
from flexopt.algebra import called_eigen, turned_vectors
from flexopt.foundation.boundary import instance, public, public_class
from flexopt.foundation.control import Control
from flexopt.model import AnyMachine
from flexopt.plant import Plant, build_plant
from flexopt.plant.singularity import screened
from flexopt.robustness.modes import (
    WRITTEN_OUT,
    called_modes,
    continue_modes,
    reduced_pencil,
    solve_modes,
    solve_modes_quickly,
)
from flexopt.robustness.residues import (
    measure,
    rank_one_measure,
    residue_factors,
    rigid_residue,
    summed_residue,
    symmetric_part_vectors,
)

# Nodes of a graph up to which equal parts of it are looked for.
CSE_MAX = 20_000
# Of what the static deflection may leave over, relative to the weight, and of the modes' orthogonality.
SOLVE_TOLERANCE = 1e-8


@dataclass(frozen=True, eq=False)
class MeasureGraph:
    """SX graphs of the measures in `base`, `posture`, `p` and `held`. m modes, r task rows.

    Attributes:
        omega_squared: ω_i², (m, 1), ascending.
        zeta: φ_iᵀ D φ_i / (2 ω_i), (m, 1): damping ratios to first order in the damping.
        modes: φ_i, (n_q, m), mass-normalised.
        a, b: columns of R_i = a_i b_iᵀ, (r, m).
        same: clusters of equal frequencies, (m, m).
        w: w_i, (m, 1).
        rigid: R_0, (r, r).
        q, end_point: configuration (n_q,) and r(q) (r,).
        static_residual: force left over by the static deflection (m,); 0 without gravity.
    """

    omega_squared: ca.SX
    zeta: ca.SX
    modes: ca.SX
    a: ca.SX
    b: ca.SX
    same: ca.SX
    w: ca.SX
    rigid: ca.SX
    q: ca.SX
    end_point: ca.SX
    static_residual: ca.SX

    def outputs(self) -> dict[str, ca.SX]:
        """Name -> graph."""
        return {name: ca.densify(getattr(self, name)) for name in self.__dataclass_fields__}


@public_class(plant=instance(Plant, "a Plant, from flexopt.build_plant"))
@dataclass(frozen=True)
class Measures:
    """Measures of one machine under one controller.

    Functions take base (n_b,), posture (n,) and p (n_par,). The number of modes is m = `plant.n_passive`.
    """

    plant: Plant
    control: Control
    gravity: bool

    @cached_property
    def held_parts(self) -> dict[str, ca.SX]:
        """Symbols of what `hold` computes, by name."""
        m, r = self.plant.n_passive, self.plant.n_task
        sizes = {"deflection": (m if self.gravity else 0, 1)}
        sizes |= {"omega_squared": (m, 1), "modes": (m, m), "same": (m, m), "symmetric_parts": (r, r * m)}
        return {name: ca.SX.sym(name, *size) for name, size in sizes.items()}

    @cached_property
    def held(self) -> ca.SX:
        """All of it as one vector symbol."""
        return ca.veccat(*self.held_parts.values())

    @cached_property
    def hold(self) -> ca.Function:
        """(base, posture, p) -> held: deflection and eigenvectors by iteration; derivative zero by declaration."""
        g, plant = self.plant.graph, self.plant
        deflection = plant.deflected(g.base, g.posture, g.p) if self.gravity else None
        at = plant.operating_point(g.base, g.posture, g.p, deflection)
        pencil = reduced_pencil(at, plant.n_passive)
        values, modes, same = solve_modes(pencil)
        a, b = residue_factors(at, pencil, modes, self.control)
        parts = symmetric_part_vectors(a, b, same)
        held = ca.veccat(*([deflection] if deflection is not None else []), values, modes, same, parts)
        return self._function("hold", [], {"held": held}, {"is_diff_out": [False], "cse": False})

    @cached_property
    def reduced(self) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        """Graphs of base, posture, p and held: K_p and M̄ (m, m), A and B (r, m) of a_i = A φ_i and b_i = B φ_i."""
        g, m = self.plant.graph, self.plant.n_passive
        at = self.plant.operating_point(g.base, g.posture, g.p, self.held_parts["deflection"] if self.gravity else None)
        pencil = reduced_pencil(at, m)
        return pencil.stiffness, pencil.mass, *residue_factors(at, pencil, ca.SX.eye(m), self.control)

    @cached_property
    def called_hold(self) -> ca.Function:
        """What `hold` computes, for numbers and MX: of many modes by calls, built in a fraction of the time."""
        if self.plant.n_passive <= WRITTEN_OUT:
            return self.hold
        g, deflection = self.plant.graph, self.held_parts["deflection"]
        graphs = [ca.densify(graph) for graph in self.reduced]
        reduce = ca.Function("reduced", [g.base, g.posture, g.p, deflection], graphs)
        names = ["base", "posture", "p"]
        symbols = [ca.MX.sym(name, x.shape[0]) for name, x in zip(names, (g.base, g.posture, g.p), strict=True)]
        deflected = self.plant.deflected(*symbols) if self.gravity else ca.MX(0, 1)
        stiffness, mass, a_of, b_of = reduce.call([*symbols, deflected])
        values, modes, same = called_modes(self.plant.n_passive).call([stiffness, mass])
        parts = self._called_parts.call([a_of, b_of, modes, same])[0]
        held = ca.veccat(deflected, values, modes, same, parts)
        assert held.shape == self.held.shape
        return ca.Function("hold", symbols, [held], names, ["held"], {"is_diff_out": [False], "never_inline": True})

    @cached_property
    def _called_parts(self) -> ca.Function:
        """(A, B, modes, same) -> `symmetric_part_vectors`; where no mode needs them, the unit matrix for each."""
        m, r = self.plant.n_passive, self.plant.n_task
        shapes = {"A": (r, m), "B": (r, m), "modes": (m, m), "same": (m, m)}
        a, b, modes, same = symbols = [ca.SX.sym(name, *shape) for name, shape in shapes.items()]
        sums = [summed_residue(a @ modes, b @ modes, same, i) for i in range(m)]
        symmetric = ca.Function("symmetric_parts", symbols, [ca.densify(ca.horzcat(*(x + x.T for x in sums)))])
        given = symmetric.mx_in()
        vectors = called_eigen(r).map(m).call(symmetric.call(given))[1]
        none = ca.Function("no_clusters", symbols, [ca.densify(ca.repmat(ca.SX.eye(r), 1, m))])
        either = ca.Function.if_else("parts", none, ca.Function("clusters", given, [vectors]))
        alone = ca.Function("alone", [same], [ca.sum(ca.vec(same)) <= m + 0.5])
        return ca.Function("parts", given, either.call([*alone.call(given[3:]), *given]))

    @cached_property
    def graph(self) -> MeasureGraph:
        """The measures as SX graphs of base, posture, p and held."""
        g, plant, held = self.plant.graph, self.plant, self.held_parts
        m, n = plant.n_passive, plant.n_actuated
        at = plant.operating_point(g.base, g.posture, g.p, held["deflection"] if self.gravity else None)
        pencil = reduced_pencil(at, m)
        same = held["same"]
        omega_squared, modes = continue_modes(pencil, held["omega_squared"], held["modes"], same)
        a, b = residue_factors(at, pencil, modes, self.control)
        full = ca.vertcat(modes, pencil.follow @ modes)
        zeta = ca.diag(full.T @ at.damping @ full) / (2 * ca.sqrt(omega_squared))
        assert full.shape == (m + n, m)
        return MeasureGraph(
            omega_squared=omega_squared,
            zeta=zeta,
            modes=full,
            a=a,
            b=b,
            same=same,
            w=ca.vertcat(*(measure(a, b, same, held["symmetric_parts"], i) for i in range(m))),
            rigid=rigid_residue(at, pencil, self.control),
            q=at.q,
            end_point=at.end_point,
            static_residual=at.static_residual,
        )

    @cached_property
    def values(self) -> ca.Function:
        """(base, posture, p) -> every output of `MeasureGraph`, by name."""
        return self._composed("measures", self.graph.outputs(), {"cse": False})

    @cached_property
    def w(self) -> ca.Function:
        """(base, posture, p) -> w (m, 1), with |a_i||b_i| beside it as `scale` (m, 1)."""
        g = self.graph
        scale = ca.sqrt(ca.sum1(g.a**2) * ca.sum1(g.b**2)).T
        return self._composed("w", {"w": g.w, "scale": scale, "end_point": g.end_point})

    @cached_property
    def gradients(self) -> ca.Function:
        """(base, posture, p) -> exact derivatives, z = [base, posture].

        Outputs ∂w/∂z (m, n_b + n) as `w_z`, ∂w/∂p (m, n_par) as `w_p`, ∂r/∂z (n_task, n_b + n) as `end_point_z`.
        """
        g, graph = self.plant.graph, self.graph
        z = ca.vertcat(g.base, g.posture)
        slopes = ca.jacobian(graph.w, ca.vertcat(z, g.p))
        outputs = {"w_z": slopes[:, : z.shape[0]], "w_p": slopes[:, z.shape[0] :]}
        return self._composed("gradients", outputs | {"end_point_z": ca.jacobian(graph.end_point, z)}, {"cse": False})

    @cached_property
    def weighted_gradient(self) -> ca.Function:
        """(base, posture, p, alpha (m,)) -> exact ∂(Σ αi wi)/∂z (1, n_z), z = [base, posture]."""
        g, alpha = self.plant.graph, ca.SX.sym("alpha", self.plant.n_passive)
        z = ca.vertcat(g.base, g.posture)
        slope = ca.densify(ca.gradient(ca.dot(alpha, self.graph.w), z).T)
        names = ["base", "posture", "p", "held", "alpha"]
        inner = ca.Function("weighted_gradient", [g.base, g.posture, g.p, self.held, alpha], [slope], names, ["V_z"])
        return self._behind_hold(inner, {"cse": False})

    @cached_property
    def end_point_gradient(self) -> ca.Function:
        """(base, posture, p) -> exact ∂r/∂z (n_task, n_z), z = [base, posture]."""
        g = self.plant.graph
        outputs = {"end_point_z": ca.jacobian(self.graph.end_point, ca.vertcat(g.base, g.posture))}
        if not self.gravity:
            return self._function("end_point_gradient", [], outputs, {})
        return self._composed("end_point_gradient", outputs)

    @cached_property
    def w_with_gradient(self) -> ca.Function:
        """(base, posture, p) -> w (m, 1), exact ∂w/∂posture (m, n) as `w_posture`."""
        w = self.graph.w
        return self._composed("w_with_gradient", {"w": w, "w_posture": ca.jacobian(w, self.plant.graph.posture)})

    @cached_property
    def quick(self) -> ca.Function:
        """(base, posture, p) -> w (m, 1) and `gap`: for many points, by `quick_batch`.

        As `w`, but modes come from `solve_modes_quickly` and every frequency counts as simple: error some 3e-15 / gap
        of |a_i||b_i|. Unless gap ≥ `TRUSTED_GAP`, ask `w`; `flexopt.robustness.batches` does.
        """
        w, gap, _ = self._quickly()
        return self._function("quick", [], {"w": w, "gap": gap}, {})

    @cached_property
    def quick_with_gradient(self) -> ca.Function:
        """(base, posture, p) -> the outputs of `quick`, and exact ∂w/∂posture (m, n) as `w_posture`."""
        g, plant, symbols = self.plant.graph, self.plant, self.held_parts
        m = plant.n_passive
        w, gap, held = self._quickly()
        at = plant.operating_point(g.base, g.posture, g.p, symbols["deflection"] if self.gravity else None)
        pencil = reduced_pencil(at, m)
        modes = turned_vectors(pencil.stiffness, pencil.mass, symbols["omega_squared"], symbols["modes"])
        a, b = residue_factors(at, pencil, modes, self.control)
        near = ca.vertcat(*(rank_one_measure(a[:, i], b[:, i]) for i in range(m)))
        inner = self._function("slope", [self.held], {"w_posture": ca.jacobian(near, g.posture)}, {"cse": False})
        outputs = {"w": w, "gap": gap, "w_posture": inner(g.base, g.posture, g.p, held)}
        return self._function("quick_with_gradient", [], outputs, {})

    @cached_property
    def quick_batch(self) -> compiled.Batch:
        """`quick` at many points."""
        return compiled.batch(self.quick)

    @cached_property
    def quick_batch_with_gradient(self) -> compiled.Batch:
        """`quick_with_gradient` at many points."""
        return compiled.batch(self.quick_with_gradient)

    @cached_property
    def sound_batch(self) -> compiled.Batch:
        """What tells the points that have no measures, for many at once; see `flexopt.robustness.batches`.

        Outputs of `flexopt.plant.singularity.screened`; under gravity also `left_over`, of the static deflection
        relative to the weight, and `least_pivot` of the stiffness that holds it, else empty.
        """
        g, plant = self.plant.graph, self.plant
        outputs = screened(plant) | {"left_over": ca.SX(0, 1), "least_pivot": ca.SX(0, 1)}
        if self.gravity:
            m = plant.n_passive
            at = plant.operating_point(g.base, g.posture, g.p, plant.deflected(g.base, g.posture, g.p))
            weight = ca.norm_inf(plant.gravity(at.q, g.base, g.p)[:m])
            outputs["left_over"] = ca.norm_inf(at.static_residual) / (1 + weight)
            outputs["least_pivot"] = ca.mmin(ca.ldl(ca.densify(at.stiffness[:m, :m]))[0])
        return compiled.batch(self._function("sound", [], outputs, {}))

    def _quickly(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """The w_i (m, 1), the gap, and what `hold` would give."""
        g, plant = self.plant.graph, self.plant
        m, r = plant.n_passive, plant.n_task
        deflection = plant.deflected(g.base, g.posture, g.p) if self.gravity else ca.SX(0, 1)
        at = plant.operating_point(g.base, g.posture, g.p, deflection if self.gravity else None)
        pencil = reduced_pencil(at, m)
        modes = solve_modes_quickly(pencil)
        # w is of second degree in the modes: to divide by φᵀ M̄ φ afterwards saves as many square roots.
        a, b = residue_factors(at, pencil, modes.shapes, self.control)
        w = ca.vertcat(*(rank_one_measure(a[:, i], b[:, i]) for i in range(m))) / modes.squares
        held = ca.veccat(deflection, modes.omega_squared, modes.normalised, ca.DM.eye(m), ca.DM.zeros(r, r * m))
        return w, modes.gap, held

    @cached_property
    def nested(self) -> ca.Function:
        """(base, posture, p) -> w, end_point as an MX Function that can be differentiated twice, exactly (for NLPs)."""
        graph = self.graph
        inner = self._function("of_held", [self.held], {"w": graph.w, "end_point": graph.end_point}, {})
        g = self.plant.graph
        symbols = [ca.MX.sym(name, s.shape[0]) for name, s in (("base", g.base), ("posture", g.posture), ("p", g.p))]
        outputs = inner.call([*symbols, *self.hold.call(symbols)])
        return ca.Function("measures", symbols, outputs, ["base", "posture", "p"], ["w", "end_point"])

    def _composed(
        self, name: str, outputs: Mapping[str, ca.SX], options: Mapping[str, bool] = MappingProxyType({})
    ) -> ca.Function:
        """The Function of (base, posture, p) in which `held` is computed.

        `{"cse": False}` for what is called once for a posture: to search for equal parts takes longer than they do.
        """
        return self._behind_hold(self._function(name, [self.held], outputs, {"cse": False}), dict(options))

    def _behind_hold(self, inner: ca.Function, options: dict[str, Any]) -> ca.Function:
        """A Function of (base, posture, p, held, …) without `held`, which is computed: written out or by a call."""
        written = self.plant.n_passive <= WRITTEN_OUT
        symbols: list[Any] = inner.sx_in() if written else inner.mx_in()
        given, names = [*symbols[:3], *symbols[4:]], [name for name in inner.name_in() if name != "held"]
        held = self.called_hold.call(symbols[:3])
        outputs: list[Any] = inner.call([*symbols[:3], *held, *symbols[4:]])
        if not written:
            return ca.Function(inner.name(), given, outputs, names, inner.name_out())
        return _shared(inner.name(), given, outputs, names, inner.name_out(), options)

    def _function(
        self, name: str, extra: list[ca.SX], outputs: Mapping[str, ca.SX], options: dict[str, Any]
    ) -> ca.Function:
        g = self.plant.graph
        names = ["base", "posture", "p", *(["held"] if extra else [])]
        dense = [ca.densify(output) for output in outputs.values()]
        return _shared(name, [g.base, g.posture, g.p, *extra], dense, names, list(outputs), options)


def _shared(
    name: str, inputs: list[ca.SX], outputs: list[ca.SX], names: list[str], results: list[str], options: dict[str, Any]
) -> ca.Function:
    """A Function in which equal parts are computed once, unless `options` say otherwise or it is too large."""
    function = ca.Function(name, inputs, outputs, names, results, {"cse": False} | options)
    # On large graphs the search takes a second and finds little.
    if "cse" in options or function.n_nodes() > CSE_MAX:
        return function
    return ca.Function(name, inputs, outputs, names, results, {"cse": True} | options)


@public()
def build_measures(machine: AnyMachine, control: Control = "inverse", gravity: bool = False) -> Measures:
    """The measures of a machine (built once for each machine, controller and gravity option, and kept).

    Args:
        machine: from `flexopt.load`.
        control: Jacobian `"inverse"`, `"transpose"` or `"damped:LAMBDA"`, as in `flexopt.evaluate`.
        gravity: under static deflection.

    Raises:
        InputError: an argument is not usable.
    """
    return _built(machine, control, gravity)


@lru_cache(maxsize=64)
def _built(machine: AnyMachine, control: Control, gravity: bool) -> Measures:
    return Measures(build_plant(machine), control, gravity)
