"""The plant of a machine: named Functions, the SX graphs behind them, and the operating point at a posture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from flexopt.algebra import apply_pseudo_inverse, solve_spd
from flexopt.errors import Fault, InputError
from flexopt.foundation.boundary import instance, public, public_class
from flexopt.foundation.control import Control, control_method
from flexopt.foundation.kept import Structural, by_machine, by_structure, structural_property
from flexopt.model import AnyMachine
from flexopt.plant.closed_form import InverseKinematicsGraph, build_inverse_kinematics, has_closed_form
from flexopt.plant.control import task_to_joints
from flexopt.plant.frames import Frames, build_frames
from flexopt.plant.graph import MachineGraph, build_graph, check_mass
from flexopt.plant.mass_centre import centre_of_mass, most_weight

# Newton iterations for the static deflection; it converges quadratically from rest, in 4 or 5 for real machines.
STATIC_ITERATIONS = 12
# Steps along Jv⁺ where the first begins, and along that where each begins, by which an arm is held on its target.
STRAIGHT, BENT = 2, 5
# Parameters that a message names.
NAMED = 4


@dataclass(frozen=True, eq=False)
class OperatingPoint:
    """SX graphs at a configuration where the machine stands still. Shapes as in `Plant`."""

    q: ca.SX
    end_point: ca.SX
    jacobian: ca.SX
    rigid_jacobian: ca.SX
    mass: ca.SX
    stiffness: ca.SX
    damping: ca.SX
    static_residual: ca.SX


_SX = instance(ca.SX, "a ca.SX")


@public_class(graph=instance(MachineGraph, "the MachineGraph of a machine, as flexopt.build_plant makes it"))
@dataclass(frozen=True)
class Plant(Structural):
    """The equations of one machine: M(q) v̇ + h(q, v) + g(q) + K (q − q_rest) + D v = τ (article, section 2).

    Coordinates q (n_q,) list the passive ones first, then the actuated ones, relative angles in rad and
    displacements in m; v (n_q,) is their rate. `base` (n_b,) is the placement, which moves the springs'
    anchor and the rest configuration; p (n_par,) are the machine's parameters. Every Function takes its inputs by
    name; `base` defaults to 0, and one that is forgotten gives NaN; `parameter_values` holds the machine's own p.

    Attributes:
        machine: where it comes from.
        graph: the SX graphs themselves, with their symbols q, v, base, posture, p.

    Example:
        >>> plant = flexopt.build_plant(flexopt.load("excavator"))
        >>> plant.n_passive, plant.n_coordinates
        (3, 5)
        >>> plant.mass
        Function(mass:(q[5],base,p[26])->(M[5x5]) SXFunction)
    """

    machine: AnyMachine
    graph: MachineGraph

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of q, passive first."""
        return self.graph.coordinates

    @property
    def n_passive(self) -> int:
        """m, the number of passive coordinates."""
        return self.graph.n_passive

    @property
    def n_coordinates(self) -> int:
        """n_q, the number of all coordinates."""
        return self.graph.q.shape[0]

    @property
    def n_actuated(self) -> int:
        """n, the number of actuated joints."""
        return self.n_coordinates - self.n_passive

    @property
    def n_base(self) -> int:
        """n_b, the number of placement coordinates."""
        return self.graph.base.shape[0]

    @property
    def n_task(self) -> int:
        """Rows of the end-point task."""
        return self.graph.end_point.shape[0]

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of p."""
        return tuple(parameter.name for parameter in self.machine.parameters)

    @cached_property
    def parameter_values(self) -> ca.DM:
        """The machine's own p (n_par, 1)."""
        return ca.DM([parameter.value for parameter in self.machine.parameters])

    @structural_property
    def end_point(self) -> ca.Function:
        """r(q), (n_task,), m, inertial frame. Inputs q, base, p."""
        return self._of_configuration("end_point", self.graph.end_point, "r")

    @structural_property
    def skeleton(self) -> ca.Function:
        """Ground point, every joint and the end-point in order, a column each, m: (2, n_bodies + 1) in the plane.

        In space (3, n_bodies + 2): anchor frame, bodies' frames, end-point. Inputs q, base, p.
        """
        return self._of_configuration("skeleton", self.graph.skeleton, "points")

    @structural_property
    def frames(self) -> Frames:
        """Frames of the bodies and of the end-point as SX graphs of the graph's q, base and p."""
        return build_frames(self.machine, self.graph)

    @structural_property
    def body_frames(self) -> ca.Function:
        """Frames of all bodies in the order of `frames.names`, d = 2 in the plane, 3 in space. Inputs q, base, p.

        Outputs origins (d, n_bodies), m, inertial frame, and rotations (d, d n_bodies), whose columns k d … are the
        axes of body k in inertial ones.
        """
        g, f = self.graph, self.frames
        outputs = [ca.densify(ca.horzcat(*f.origins)), ca.densify(ca.horzcat(*f.rotations))]
        return self._function("body_frames", {"q": g.q, "base": g.base, "p": g.p}, outputs, ["origins", "rotations"])

    @structural_property
    def end_rotation(self) -> ca.Function:
        """Axes of the end-point's frame in inertial ones, as columns (d, d). Inputs q, base, p."""
        return self._of_configuration("end_rotation", ca.densify(self.frames.tip_rotation), "R")

    @structural_property
    def centre_of_mass(self) -> ca.Function:
        """Of all bodies and the payload, (d,), m, inertial frame. Inputs q, base, p."""
        expression = centre_of_mass(self.machine, self.graph.p, self.frames)
        return self._of_configuration("centre_of_mass", ca.densify(expression), "c")

    @structural_property
    def jacobian(self) -> ca.Function:
        """J = ∂r/∂q, (n_task, n_q); article, section 3.3. Inputs q, base, p."""
        return self._of_configuration("jacobian", ca.densify(ca.jacobian(self.graph.end_point, self.graph.q)), "J")

    @structural_property
    def rigid_jacobian(self) -> ca.Function:
        """Jv = ∂r/∂q_a, (n_task, n), the arm's Jacobian on rigid ground; article, section 3.2. Inputs q, base, p."""
        full = ca.jacobian(self.graph.end_point, self.graph.q)
        return self._of_configuration("rigid_jacobian", ca.densify(full[:, self.n_passive :]), "Jv")

    @structural_property
    def base_jacobian(self) -> ca.Function:
        """J_B = ∂r/∂[base, posture] at rest, (n_task, n_b + n); article, section 4. Inputs base, posture, p."""
        g = self.graph
        at_rest = ca.substitute(g.end_point, g.q, g.rest)
        jacobian = ca.densify(ca.jacobian(at_rest, ca.vertcat(g.base, g.posture)))
        return self._of_posture("base_jacobian", [jacobian], ["J_B"])

    @structural_property
    def mass(self) -> ca.Function:
        """M(q), (n_q, n_q). Inputs q, base, p."""
        return self._of_configuration("mass", self.graph.mass, "M")

    @structural_property
    def bias(self) -> ca.Function:
        """h(q, v), (n_q,): Coriolis and centrifugal terms, no gravity, no damping. Inputs q, v, base, p."""
        g = self.graph
        return self._function("bias", {"q": g.q, "v": g.v, "base": g.base, "p": g.p}, [g.bias], ["h"])

    @structural_property
    def gravity(self) -> ca.Function:
        """g(q), (n_q,): generalised gravity force, the gradient of the potential. Inputs q, base, p."""
        return self._of_configuration("gravity", self.graph.gravity, "g")

    @structural_property
    def most_weight(self) -> ca.Function:
        """The bound g √(m M_ii) ≥ |g_i|, (n_q,), N m or N, m of the whole machine. Inputs q, base, p."""
        most = most_weight(self.machine, self.graph.p, self.graph.mass)
        return self._of_configuration("most_weight", ca.densify(most), "most")

    @structural_property
    def stiffness(self) -> ca.Function:
        """K, (n_q, n_q): springs of the passive coordinates, zero for the actuated ones. Input p."""
        return self._function("stiffness", {"p": self.graph.p}, [self.graph.stiffness], ["K"])

    @structural_property
    def damping(self) -> ca.Function:
        """D, (n_q, n_q). Input p."""
        return self._function("damping", {"p": self.graph.p}, [self.graph.damping], ["D"])

    @structural_property
    def rest(self) -> ca.Function:
        """q_rest, (n_q,): the springs' anchor with the arm at `posture`. Inputs base, posture, p."""
        return self._of_posture("rest", [self.graph.rest], ["q"])

    @structural_property
    def singularity_sine_squared(self) -> ca.Function:
        """Distance from singular postures at rest: 0 where Jv loses rank, at most 1.

        The mean sin² of the angles by which what each body of the arm does to the end-point, alone, leaves what the
        others do: in the plane of the angles between the arm's segments, sin² θ3 for two links. See
        `singular_distance`. Inputs base, posture, p.
        """
        g = self.graph
        at_rest = ca.substitute(g.singularity_sine_squared, g.q, g.rest)
        return self._of_posture("singularity_sine_squared", [at_rest], ["sine_squared"])

    @structural_property
    def singularity_gradient(self) -> ca.Function:
        """Derivative of `singularity_sine_squared` by [base, posture], (1, n_b + n). Inputs base, posture, p."""
        g = self.graph
        at_rest = ca.substitute(g.singularity_sine_squared, g.q, g.rest)
        return self._of_posture(
            "singularity_gradient", [ca.jacobian(at_rest, ca.vertcat(g.base, g.posture))], ["sine_squared_z"]
        )

    @property
    def closed_form(self) -> bool:
        """Whether postures on a target have a closed form (`posture_at`): see `closed_form.has_closed_form`."""
        return has_closed_form(self.graph.at.skeleton)

    @structural_property
    def reaching(self) -> InverseKinematicsGraph:
        """Closed-form inverse kinematics.

        Raises:
            InputError: the machine's structure has none.
        """
        if not self.closed_form:
            sentence = "is a spatial machine; its postures have no closed form, and only planar arms have a known reach"
            raise InputError(f"machine {self.machine.name!r} {sentence}", [Fault("machine", sentence)])
        return build_inverse_kinematics(self.graph)

    @structural_property
    def posture_at(self) -> ca.Function:
        """Posture that puts the end-point on a target, closed form, passive joints at rest.

        Inputs target (n_task,), base, unit (n − 2,) in [0, 1], elbow (−1 up, +1 down), p; outputs posture (n,) and
        cos_elbow, beyond ±1 where the target is out of reach.
        """
        t, g = self.reaching, self.graph
        inputs = {"target": t.target, "base": g.base, "unit": t.unit, "elbow": t.elbow, "p": g.p}
        return self._function("posture_at", inputs, [t.posture, t.cos_elbow], ["posture", "cos_elbow"])

    @structural_property
    def arm_segments(self) -> ca.Function:
        """Where the first actuated joint sits at rest, (n_task,), m, and the lengths between joints, (n,), m.

        Inputs base, p.
        """
        t, g = self.reaching, self.graph
        outputs = [t.first_joint_point, t.segment_lengths]
        return self._function("arm_segments", {"base": g.base, "p": g.p}, outputs, ["first_joint", "lengths"])

    @structural_property
    def elbow(self) -> ca.Function:
        """Angle of the last segment from the one before, −π to π, in `posture_at`'s sense. Inputs base, posture, p."""
        t = self.reaching
        bend = ca.atan2(ca.sin(t.bend), ca.cos(t.bend))
        return self._of_posture("elbow", [bend], ["bend"])

    @structural_property
    def gravity_stiffness(self) -> ca.Function:
        """∂g_p/∂q_p, (m, m): gravity's stiffness in the passive block. Inputs q, base, p."""
        g, m = self.graph, self.n_passive
        block = ca.jacobian(g.gravity[:m], g.q[:m])
        return self._of_configuration("gravity_stiffness", ca.densify(block), "K_g")

    @structural_property
    def _gravity_coupling(self) -> ca.Function:
        """∂g_p/∂q of the actuated joints, (m, n). Inputs q, base, p."""
        g, m = self.graph, self.n_passive
        return self._of_configuration("gravity_coupling", ca.densify(ca.jacobian(g.gravity[:m], g.q[m:])), "K_c")

    @structural_property
    def deflected(self) -> ca.Function:
        """Passive coordinates (m,) at static equilibrium under gravity, the actuators holding `posture`.

        Solves K_p (q_p − q_p,rest) + g_p(q) = 0 by Newton's method from rest; check `static_residual` before use.
        Values only: derivatives are taken by `operating_point`, which adds two steps that are differentiated.
        Inputs base, posture, p.
        """
        g = self.graph
        q_p = self.rest(g.base, g.posture, g.p)[: self.n_passive]
        for _ in range(STATIC_ITERATIONS):
            q_p = self._newton_step(q_p, g.base, g.posture, g.p)
        return self._of_posture("deflected", [q_p], ["q_p"])

    @structural_property
    def static_step(self) -> ca.Function:
        """One of the Newton steps of `deflected`: from q_p (m,) to the next. Inputs q_p, base, posture, p."""
        g, q_p = self.graph, ca.SX.sym("q_p", self.n_passive)
        stepped = self._newton_step(q_p, g.base, g.posture, g.p)
        inputs = {"q_p": q_p, "base": g.base, "posture": g.posture, "p": g.p}
        return self._function("static_step", inputs, [ca.densify(stepped)], ["next"])

    @structural_property
    def held(self) -> ca.Function:
        """The posture (n,), turned by Jv⁺ so that the end-point of the machine as it sags is on a target (n_task,).

        Feedback holds the arm so. Newton's method for posture and passive coordinates q_p (m,) at once, from springs at
        rest: `STRAIGHT` steps along Jv⁺ of the posture given, then `BENT`, each along Jv⁺ where it begins.
        Check where it ends before use: it may miss a posture that holds.
        Inputs base, posture, p, target; outputs held (n,) and q_p.
        """
        g, m, target = self.graph, self.n_passive, ca.SX.sym("target", self.n_task)
        q = self.rest(g.base, g.posture, g.p)
        toward = self._toward(q)
        for _ in range(STRAIGHT):
            q = self._held_step(q, toward, target)
        for _ in range(BENT):
            q = self._held_step(q, self._toward(q), target)
        inputs = {"base": g.base, "posture": g.posture, "p": g.p, "target": target}
        return self._function("held", inputs, [ca.densify(q[m:]), ca.densify(q[:m])], ["held", "q_p"])

    @structural_property
    def held_step(self) -> ca.Function:
        """One more step of `held`, by Jv⁺ where it begins: from q (n_q,) to the next. Inputs q, base, p, target."""
        g, target = self.graph, ca.SX.sym("target", self.n_task)
        stepped = self._held_step(g.q, self._toward(g.q), target)
        inputs = {"q": g.q, "base": g.base, "p": g.p, "target": target}
        return self._function("held_step", inputs, [ca.densify(stepped)], ["next"])

    @structural_property
    def held_rows(self) -> ca.SX:
        """[K_p (q_p − q_p,rest) + g_p; r], (m + n_task,): what springs and weight leave over, and the end-point."""
        g, m = self.graph, self.n_passive
        return ca.vertcat(self._static_force(g.q[:m], g.base, g.q[m:], g.p), g.end_point)

    @structural_property
    def sagging_jacobian(self) -> ca.Function:
        """∂r/∂q_a where springs hold the weight and give way as the arm turns, (n_task, n).

        Jv − J_p K_t⁻¹ ∂g_p/∂q_a, J_p = ∂r/∂q_p, at a static equilibrium q. Inputs q, base, p.
        """
        g, m = self.graph, self.n_passive
        jacobian = self.jacobian(g.q, g.base, g.p)
        sags = ca.solve(self._tangent(g.q, g.base, g.p), self._gravity_coupling(g.q, g.base, g.p))
        return self._of_configuration("sagging_jacobian", ca.densify(jacobian[:, m:] - jacobian[:, :m] @ sags), "J_s")

    def _toward(self, q: ca.SX) -> ca.SX:
        """Jv⁺, (n, n_task)."""
        jv = self.rigid_jacobian(q, self.graph.base, self.graph.p)
        return apply_pseudo_inverse(jv, ca.SX.eye(self.n_task))

    def _held_step(self, q: ca.SX, toward: ca.SX, target: ca.SX) -> ca.SX:
        """A step of Newton's method, (n_q,), to where springs hold the weight, the end-point on a target.

        K_t δq_p + (∂g_p/∂q) T δs = −f and (∂r/∂q) [δq_p; T δs] = r_target − r, where K_t = K_p + ∂g_p/∂q_p holds the
        passive coordinates, f is what springs and weight leave over, and the arm turns by T δs, T = `toward`.
        """
        g, m = self.graph, self.n_passive
        left = self._static_force(q[:m], g.base, q[m:], g.p)
        pulled = self._gravity_coupling(q, g.base, g.p) @ toward
        sags = ca.solve(self._tangent(q, g.base, g.p), ca.horzcat(left, pulled))
        jacobian, off = self.jacobian(q, g.base, g.p), target - self.end_point(q, g.base, g.p)
        moves = jacobian[:, m:] @ toward - jacobian[:, :m] @ sags[:, 1:]
        turn = ca.solve(moves, off + jacobian[:, :m] @ sags[:, 0])
        return q + ca.vertcat(-sags[:, 0] - sags[:, 1:] @ turn, toward @ turn)

    @public(base=_SX, posture=_SX, p=_SX, deflection=_SX)
    def operating_point(self, base: ca.SX, posture: ca.SX, p: ca.SX, deflection: ca.SX | None = None) -> OperatingPoint:
        """Graphs at rest, or under gravity about the passive coordinates `deflection` (m,) from `deflected`.

        Under gravity two Newton steps start from `deflection`, held constant, so that first and second derivatives are
        exact, and gravity's stiffness enters the passive block only: the actuators hold their own weight.

        Example:
            >>> plant = flexopt.build_plant(flexopt.load("excavator"))
            >>> graph = plant.graph
            >>> point = plant.operating_point(graph.base, graph.posture, graph.p)
            >>> type(point).__name__
            'OperatingPoint'
        """
        m = self.n_passive
        q = self.rest(base, posture, p)
        stiffness = self.stiffness(p)
        residual = ca.SX.zeros(m, 1)
        if deflection is not None:
            q_p = deflection
            for _ in range(2):
                q_p = self._newton_step(q_p, base, posture, p)
            residual = self._static_force(deflection, base, posture, p)
            q = ca.vertcat(q_p, posture)
            stiffness = ca.SX(stiffness)
            stiffness[:m, :m] += self.gravity_stiffness(q, base, p)
        return OperatingPoint(
            q=q,
            end_point=self.end_point(q, base, p),
            jacobian=self.jacobian(q, base, p),
            rigid_jacobian=self.rigid_jacobian(q, base, p),
            mass=self.mass(q, base, p),
            stiffness=stiffness,
            damping=self.damping(p),
            static_residual=residual,
        )

    @public()
    def linearisation(self, control: Control = "inverse", *, gravity: bool = False) -> ca.Function:
        """The linear plant that the task-space controller sees: x = [q̇; q − q_d], ẋ = A x + B f, y = C x.

        A = [[−M⁻¹D, −M⁻¹K], [I, 0]], B = [M⁻¹E; 0] Jvᵀ (transpose), [M⁻¹E; 0] Jv⁺ (inverse; Moore–Penrose for a
        redundant arm) or [M⁻¹E; 0] J⁺_λ (damped), C = [0, J]; article, section 3.3 and eq. (2).

        Returns:
            Function of base, posture, p with outputs A (2 n_q, 2 n_q), B (2 n_q, n_task), C (n_task, 2 n_q).

        Example:
            >>> plant = flexopt.build_plant(flexopt.load("excavator"))
            >>> found = plant.linearisation("inverse")(base=0, posture=[0.99, -2.63], p=plant.parameter_values)
            >>> found["A"].shape, found["B"].shape, found["C"].shape
            ((10, 10), (10, 2), (2, 10))
        """
        g, n, m = self.graph, self.n_coordinates, self.n_passive
        deflection = self.deflected(g.base, g.posture, g.p) if gravity else None
        at = self.operating_point(g.base, g.posture, g.p, deflection)
        identity = ca.SX(ca.DM.eye(n))
        jv = at.rigid_jacobian
        into = identity[:, m:] @ task_to_joints(jv, control, ca.SX(ca.DM.eye(self.n_task)))
        accelerations = solve_spd(at.mass, ca.horzcat(-at.damping, -at.stiffness, into))
        a = ca.vertcat(accelerations[:, : 2 * n], ca.horzcat(identity, ca.SX.zeros(n, n)))
        b = ca.vertcat(accelerations[:, 2 * n :], ca.SX.zeros(n, self.n_task))
        c = ca.horzcat(ca.SX.zeros(self.n_task, n), at.jacobian)
        return self._of_posture(f"linearisation_{control_method(control)}", [a, b, c], ["A", "B", "C"])

    def _static_force(self, q_p: ca.SX, base: ca.SX, posture: ca.SX, p: ca.SX) -> ca.SX:
        m = self.n_passive
        rest = self.rest(base, posture, p)[:m]
        return self.stiffness(p)[:m, :m] @ (q_p - rest) + self.gravity(ca.vertcat(q_p, posture), base, p)[:m]

    def _newton_step(self, q_p: ca.SX, base: ca.SX, posture: ca.SX, p: ca.SX) -> ca.SX:
        tangent = self._tangent(ca.vertcat(q_p, posture), base, p)
        return q_p - ca.solve(tangent, self._static_force(q_p, base, posture, p))

    def _tangent(self, q: ca.SX, base: ca.SX, p: ca.SX) -> ca.SX:
        """K_t = K_p + ∂g_p/∂q_p, (m, m)."""
        m = self.n_passive
        return self.stiffness(p)[:m, :m] + self.gravity_stiffness(q, base, p)

    def _of_configuration(self, name: str, expression: ca.SX, output: str) -> ca.Function:
        g = self.graph
        return self._function(name, {"q": g.q, "base": g.base, "p": g.p}, [expression], [output])

    def _of_posture(self, name: str, expressions: list[ca.SX], outputs: list[str]) -> ca.Function:
        g = self.graph
        dense = [ca.densify(expression) for expression in expressions]
        return self._function(name, {"base": g.base, "posture": g.posture, "p": g.p}, dense, outputs)

    def _function(
        self, name: str, inputs: dict[str, ca.SX], expressions: list[ca.SX], outputs: list[str]
    ) -> ca.Function:
        # A forgotten input would silently be 0; NaN shows.
        default = [0.0 if key == "base" else float("nan") for key in inputs]
        options = {"cse": True, "default_in": default}
        return ca.Function(name, list(inputs.values()), expressions, list(inputs), outputs, options)

    def __repr__(self) -> str:
        return (
            f"Plant({self.machine.name!r}: {self.n_passive} passive ({', '.join(self.coordinates[: self.n_passive])}), "
            f"{self.n_actuated} actuated ({', '.join(self.machine.joints)}), {len(self.parameter_names)} parameters)"
        )


@public()
def build_plant(machine: AnyMachine) -> Plant:
    """The plant of a machine (its graphs are built once for each structure and kept).

    Args:
        machine: from `flexopt.load`.

    Raises:
        ModelError: the joints of a spatial machine are not independent.

    Example:
        >>> plant = flexopt.build_plant(flexopt.load("excavator"))
        >>> plant.mass(q=[0, 0, 1.2451, 0.99, -2.63], p=plant.parameter_values)["M"].shape
        (5, 5)
    """
    return _built(machine)


@by_machine
def _built(machine: AnyMachine) -> Plant:
    plant = Plant(machine, _graph(machine))
    if machine is not machine.symbolic:
        check_mass(machine, plant.mass)
    return plant


@by_structure
def _graph(machine: AnyMachine) -> MachineGraph:
    return build_graph(machine)


def moving_end_point(plant: Plant, entries: Sequence[int]) -> str:
    """Names of the first few of these entries of p that the end-point depends on, as lengths; empty where none."""
    moving = _end_point_entries(plant.machine) & set(entries)
    return ", ".join(plant.machine.parameters[i].name for i in sorted(moving)[:NAMED])


@by_structure
def _end_point_entries(machine: AnyMachine) -> frozenset[int]:
    """Entries of p on which the end-point at rest depends; asked for every interval of every call."""
    plant = build_plant(machine)
    g = plant.graph
    point = plant.end_point(plant.rest(g.base, g.posture, g.p), g.base, g.p)
    return frozenset(ca.jacobian_sparsity(point, g.p).get_triplet()[1])
