"""Run one closed loop and show it: `simulate`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Unpack, cast

import numpy as np
from numpy.typing import NDArray

from flexopt.compiled import Batch, Recurrence, batch, is_brief, recurrence
from flexopt.compiled.threaded import Interpreter
from flexopt.errors import FlexoptWarning, NoSolutionFound
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import PostureLike, Vector
from flexopt.foundation.boundary import public
from flexopt.foundation.control import control_damping
from flexopt.foundation.documents import provenance
from flexopt.foundation.kept import by_structure
from flexopt.foundation.warned import warn_user
from flexopt.loop.closed import baked, closed_loop
from flexopt.loop.levers import feeble_levers
from flexopt.loop.settings import LoopSettings
from flexopt.loop.structure import LoopStructure
from flexopt.model import AnyMachine
from flexopt.model.loop import Loop, LoopLike
from flexopt.model.simulation import SimulationKeywords, SimulationOptions
from flexopt.model.simulation_faults import own_loop
from flexopt.plant import Plant, build_plant
from flexopt.simulation.behaviour import GROWN, STILL, Behaviour, behaviour
from flexopt.simulation.beyond import beyond_the_machine
from flexopt.simulation.linear import SampledLoop
from flexopt.simulation.real_loop import in_shorter_steps, note_loop, with_loop
from flexopt.simulation.scenario import SIMULATED, Scenario, build_scenario, checked_options, note_options
from flexopt.simulation.trajectory import Trajectory
from flexopt.simulation.verdict import Ended, grounds_of

# Largest relative change left by the implicit method's iterations.
RESIDUAL_MAX = 1e-10
OUTGREW = "grew beyond what the implicit integrator follows"
# Below this share of its sine squared at the start, the arm was close to singular on its way.
NEAR_SINGULAR = 1e-3


def note_run(arguments: Arguments, given: Mapping[str, Any]) -> None:
    """Note the faults of a run's options, and of those that its loop brings."""
    note_options(arguments, given)
    note_loop(arguments, given)


@public(together=note_run, keywords=SIMULATED)
def simulate(
    machine: AnyMachine,
    posture: PostureLike | None = None,
    *,
    loop: LoopLike | None = None,
    options: SimulationOptions | None = None,  # noqa: ARG001 - its fields come as keywords
    **keywords: Unpack[SimulationKeywords],
) -> Trajectory:
    """The nonlinear closed loop M(q) v̇ + h(q, v) + g(q) + K (q − q_rest) + D v = [0; τ_a], simulated.

    At each sample the controller measures the end-point r and its rate and asks for τ_a = Jvᵀ f (transpose) or Jv⁺ f
    (inverse), f = Kp (r_d − r) + Kv (ṙ_d − ṙ); it knows the joints' angles and takes the passive coordinates for what
    they are at equilibrium: nobody measures the base (article, sections 3.2 and 5).

    The verdict takes the run and the eigenvalues of the linear loop together; see `Trajectory`.

    Args:
        machine: from `flexopt.load`.
        posture: actuated joints (n,), rad or m, about which to work; or give `end_point`.
        loop: the real controller, as of `flexopt.evaluate`, in place of the options that say of it; by default, where
            none of these is given, the machine's own `[loop]`, if it has one. What it leaves out
            follows from the machine, `Trajectory.loop` names it. Drives that serve rates brake their joints, whose
            damping is so much more in the run.
        options: the loop and its run, see `flexopt.SimulationOptions`;  keywords: its fields, in place of its:
            end_point, elbow, base, control, feedback, kp, kv, ki, integral_limit, gain, offset, duration, rate, hold,
            integrator, substeps, gravity, gravity_compensation, nullspace_damping, sensor, actuator, base_path,
            target_path, seed, baked. One that is None counts as not given.

    Raises:
        InputError: arguments are not usable (all faults in one message), or the step is too long for the fastest mode
            or damper by an explicit method.
        SingularPosture: Jv loses rank in the posture.
        UnreachableTarget: no posture reaches `end_point`.
        NotStabilizable: `"robust"`: no controller can stabilise the plant.
        NoSolutionFound: the static deflection, or the implicit integrator, did not converge.

    Example:
        >>> machine = flexopt.load("excavator")
        >>> run = flexopt.simulate(machine, (0.9929, -2.6306), kp=1e5, kv=2e3)
        >>> run.verdict
        'grows'
        >>> flexopt.simulate(machine, (0.0448, -2.0499), kp=1e5, kv=2e3).verdict
        'converges'
    """
    given: dict[str, Any] = {"posture": posture} | keywords
    settings, real = None, cast("Loop | None", loop) or own_loop(machine, given)
    own = machine
    if real is not None:
        machine, given, settings = with_loop(machine, real, given, "simulate")

    def run(given: dict[str, Any]) -> Trajectory:
        scenario = build_scenario(machine, checked_options("simulate", machine, given), settings=settings)
        found = simulate_checked(scenario, settings)
        # What its drives brake makes no other machine of it.
        return replace(found, provenance=found.provenance | {"machine_sha256": own.content_hash})

    return in_shorter_steps(run, given, real)


def simulate_checked(scenario: Scenario, settings: LoopSettings | None = None) -> Trajectory:
    """`simulate` for a scenario that is known to be good; of a `[loop]` its numbers."""
    s, loop = scenario, scenario.loop
    constants, signals = s.constants, s.signals()
    runner, shown, folded = runners(loop.structure, constants if s.options.baked else None, steps=s.samples)
    empty = np.zeros(0)
    records = runner(s.start, empty if folded else constants, steps=s.samples, e=signals)
    x = np.concatenate([s.start[:, None], records.x[:, :, 0].T], axis=1)
    outputs = shown_at(s, shown, x, signals)
    ended = Ended(s.machine, s.options, x[:, -1].copy(), table=table_of_limits(settings))
    left = "left the finite numbers"
    breaks = int(unfollowed(loop.structure, records.monitor)[0])
    if breaks < s.samples:
        if moves(s) or not grew(ended.linear(), np.sum(outputs["error"][:, : breaks + 1] ** 2, axis=0)):
            check_residual(loop.structure, records.monitor, None if moves(s) else ended)
        x[:, breaks + 1 :], left = math.nan, OUTGREW
        outputs = shown_at(s, shown, x, signals)
    end_error, end_rotation = np.sqrt(outputs["monitor"][:2, -1:])
    # As in a watched loop, what is watched at a sample's start stands for the sample.
    watched = outputs["monitor"][:, :-1].T[:, :, None]
    verdict = behaviour(s.times, watched, end_error, grounds_of(s), end_rotation)
    if signals is not None and moves(s):
        ended = replace(ended, x=x[:, -1].copy(), e=signals_at_end(s, signals)[0])
    return _trajectory(s, outputs, verdict, ended, settings, left)


def moves(scenario: Scenario) -> bool:
    """Whether base or target are moved."""
    return scenario.options.base_path is not None or scenario.options.target_path is not None


@by_structure
def _runner(structure: LoopStructure, brief: bool) -> tuple[Recurrence, Batch]:
    loop = closed_loop(structure)
    fast = loop.fast
    refresh = loop.refresh if fast else None
    runner = recurrence(loop.step, fast=fast, refresh=refresh, many=structure.watched, brief=brief)
    return runner, batch(loop.outputs)


def runners(
    structure: LoopStructure, constants: Vector | None = None, *, steps: int | None = None
) -> tuple[Recurrence, Batch, bool]:
    """The compiled run and outputs of a structure; with `constants`, these folded into the run.

    `steps`: of all members that are to be run; None: very many.
    """
    brief = steps is not None and is_brief(closed_loop(structure).step, steps, many=structure.watched)
    runner, shown = _runner(structure, brief)
    if constants is None:
        return runner, shown, False
    return _baked_runner(structure, tuple(constants.tolist())), shown, True


@by_structure
def _baked_runner(structure: LoopStructure, constants: tuple[float, ...]) -> Recurrence:
    loop, c = closed_loop(structure), np.array(constants)
    fast = loop.fast
    return recurrence(
        baked(loop.step, c), fast=fast and baked(fast, c), refresh=baked(loop.refresh, c) if fast else None
    )


def shown_at(scenario: Scenario, shown: Batch, x: Vector, signals: Vector | None) -> dict[str, Vector]:
    """The loop's outputs at every state of a run, (rows, K), and `base` and `target`."""
    s = scenario
    e = np.zeros((0, 1)) if signals is None else np.concatenate([signals, signals_at_end(s, signals)]).T
    values = shown(x, e, s.constants)
    outputs = dict(zip(shown.function.name_out(), values, strict=True))
    n = x.shape[1]
    for name, path, fixed in (("base", s.options.base_path, s.base), ("target", s.options.target_path, s.target)):
        outputs[name] = np.broadcast_to(fixed[:, None], (len(fixed), n)) if path is None else path.at(s.times).T
    return outputs


def signals_at_end(scenario: Scenario, signals: Vector) -> Vector:
    """Signals (1, n_e) at the end of the last sample: where the paths have come to, and no noise.

    Of signals (K, n_e, members) (1, n_e, members).
    """
    layout, last = scenario.loop.signals, signals[-1:].copy()
    for name, path in (("base", scenario.options.base_path), ("target", scenario.options.target_path)):
        if path is not None:
            last[0, layout.slices[name]].T[...] = scenario.along(name, path, scenario.times[-1:])[0]
    if "noise" in layout.sizes:
        last[0, layout.slices["noise"]] = 0.0
    return last


def unfollowed(structure: LoopStructure, monitor: Vector) -> NDArray[np.intp]:
    """The first window (N,) in which the implicit method's iterations do not converge while the states are finite.

    `monitor`: maxima (windows, rows, N); where all converge the number of windows.
    """
    if structure.method != "gauss":
        return np.repeat(len(monitor), monitor.shape[2])
    residual = monitor[:, -1]
    beyond = (residual > RESIDUAL_MAX**2) & np.isfinite(residual)
    first: NDArray[np.intp] = np.where(beyond.any(axis=0), beyond.argmax(axis=0), len(monitor))
    return first


def grew(linear: SampledLoop | str, squared_error: Vector) -> bool:
    """Whether the linear loop grows, and the run's end-point error did, squares (K,): no shorter step would help."""
    if isinstance(linear, str) or linear.growth_rate <= 0:
        return False
    return bool(np.nanmax(squared_error) > GROWN**2 * squared_error[0])


def check_residual(structure: LoopStructure, monitor: Vector, ended: Ended | None = None) -> None:
    """Raise where the implicit method's iterations did not converge while the states were finite.

    `ended`: the loop of a single run about its design, to tell whether it grows.
    """
    if np.all(unfollowed(structure, monitor) == len(monitor)):
        return
    residual = monitor[:, -1]
    worst = float(np.sqrt(np.max(residual, initial=0.0, where=np.isfinite(residual))))
    linear = "" if ended is None else ended.linear()
    remedy = "the loop is faster than its step: give more substeps, or lower gains"
    if not isinstance(linear, str) and linear.growth_rate > 0:
        remedy += f" (the linear loop grows at {linear.growth_rate:.4g}/s)"
    raise NoSolutionFound(
        f"simulate: the implicit integrator's iterations left a relative change of {worst:.2g} (allowed "
        f"{RESIDUAL_MAX:g}); {remedy}",
        violations={"implicit step": worst},
        iterate={},
    )


def _trajectory(
    s: Scenario,
    outputs: dict[str, Vector],
    of: Behaviour,
    ended: Ended,
    settings: LoopSettings | None,
    left: str,
) -> Trajectory:
    plant, loop = build_plant(s.machine), s.loop.structure
    brake = "nullspace_damping" if settings is None else "loop.nullspace_damping"
    if settings is not None and settings.drive == "velocity":
        brake = ""
    sentences = _warnings(s, plant, outputs, of, brake, left)
    joints, rates, torques = (outputs[name][-plant.n_actuated :] for name in ("q", "v", "torque"))
    sentences += (weak,) if (weak := ended.too_weak) else ()
    if of.finite_until[0] >= s.times[-1]:
        # What diverges has no extremes.
        bears = s.options.actuator.torque_limit is not None or s.loop.structure.served
        saturating = "" if bears else f"{ended.table}.torque_limit"
        sentences += beyond_the_machine(s.machine, joints, rates, torques, saturating)
    for sentence in sentences:
        warn_user(sentence, FlexoptWarning)
    rows = {name: value.T for name, value in outputs.items()}
    return Trajectory(
        machine=s.machine.name,
        control=s.options.control,
        coordinates=plant.coordinates,
        joints=s.machine.joints,
        n_passive=plant.n_passive,
        time=s.times,
        q=rows["q"],
        v=rows["v"],
        end_point=rows["end_point"],
        error=rows["error"],
        torque=rows["torque"],
        energy=rows["energy"][:, 0],
        deflection=rows["deflection"],
        base=rows["base"],
        target=rows["target"],
        run=of.shown(),
        ended=ended,
        growth_rate=_finite(of.growth_rate[0]),
        fit_error=_finite(of.growth_rate_error[0]),
        settling_time=_finite(of.settling_time[0]),
        overshoot=None if loop.moving_base or loop.moving_target else _overshoot(rows["error"]),
        end_error=_finite(of.end_error[0]),
        peak_base_rotation=_finite(of.peak_base_rotation[0]),
        residual_oscillation=of.residual_oscillation[:, 0],
        frequencies_hz=s.frequencies_hz,
        self_motion_rate=_self_motion_rate(plant, outputs),
        warnings=sentences,
        provenance=provenance(s.machine, **s.options.model_dump(exclude_unset=True)),
        model=s.machine,
        loop=settings,
    )


def table_of_limits(settings: LoopSettings | None) -> str:
    """Which table of a file the limits of a run's drives are in."""
    return "actuator" if settings is None else "loop"


def _self_motion_rate(plant: Plant, outputs: dict[str, Vector]) -> float | None:
    """Largest rate of a joint at the end that leaves the end-point where it is; None where there is none."""
    q, rates = outputs["q"][:, -1], outputs["v"][plant.n_passive :, -1]
    if plant.n_actuated <= plant.n_task or not (np.all(np.isfinite(q)) and np.all(np.isfinite(rates))):
        return None
    jacobian = plant.rigid_jacobian(q, outputs["base"][:, -1], plant.parameter_values).full()
    seen = np.asarray(np.linalg.pinv(jacobian) @ (jacobian @ rates), dtype=np.float64)
    return float(np.max(np.abs(rates - seen)))


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _overshoot(error: Vector) -> float | None:
    """Largest distance beyond the target along the error at the start, as a share of that error."""
    size = float(np.linalg.norm(error[0]))
    if size < STILL:
        return None
    beyond = float(np.max(-(error @ error[0]) / size**2))
    return max(0.0, beyond) if math.isfinite(beyond) else None


def _warnings(
    s: Scenario, plant: Plant, outputs: dict[str, Vector], of: Behaviour, brake: str, left: str
) -> tuple[str, ...]:
    """Sentences on the run; `left` is how it ended early.

    `brake`: the key by which self-motion is damped; empty where drives that follow rates hold it.
    """
    sentences: list[str] = []
    ended = float(of.finite_until[0])
    if ended < s.times[-1]:
        sentences.append(f"the run {left} at {ended:.4g} s; what follows is not a number")
    m = plant.n_passive
    # A damped inverse may even start at one.
    if control_damping(s.options.control) is None:
        near, at = _closest_to_singular(s, plant, outputs["q"][m:])
        if near < NEAR_SINGULAR:
            sentences.append(
                f"the arm came close to a singular posture at {at:.4g} s (sine squared {near:.2g} of its start)"
            )
    own = np.diag(plant.damping(plant.parameter_values).full())[m:]
    if brake and plant.n_actuated > plant.n_task and not s.options.nullspace_damping and not own.all():
        sentences.append(f"the controller does not brake the arm's self-motion, which may drift; {brake} brakes it")
    sentences += feeble_levers(s.machine, s.options, s.posture)
    if s.loop.structure.noisy:
        sentences.append(
            "noise keeps the base moving, so the run shows no more than whether its oscillation stays bounded; the "
            "linear loop's eigenvalues say whether it would die away"
        )
    return tuple(sentences)


def _closest_to_singular(s: Scenario, plant: Plant, joints: Vector) -> tuple[float, float]:
    """Least distance from singular postures, as a share of that at the design posture, and when."""
    distance, p = _singularity(s.machine), plant.parameter_values.full().ravel()
    values = distance(s.base, joints, p)[0][0]
    start = float(distance(s.base, s.posture, p)[0][0, 0])
    index = int(np.nanargmin(values)) if np.any(np.isfinite(values)) else 0
    return float(values[index]) / start, float(s.times[index])


@by_structure
def _singularity(machine: AnyMachine) -> Interpreter:
    # Of a run's samples: compiling it would take longer than evaluating it at a million.
    return Interpreter(build_plant(machine).singularity_sine_squared)
