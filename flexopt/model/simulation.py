"""A closed loop to be simulated, as validated data: start, controller, sensors, actuators, run."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Annotated, Any, Literal, TypedDict

import numpy as np
from numpy.typing import NDArray

from flexopt.errors import Fault
from flexopt.foundation.arrays import ArrayLike, BaseLike, GainLike, Numbers, PostureLike, TableLike, TargetLike
from flexopt.foundation.boundary import TABLE, array_of, public
from flexopt.foundation.control import Control, check_control
from flexopt.foundation.quantities import (
    COORDINATE,
    DURATION,
    JOINT_DAMPING,
    JOINT_VALUE,
    BaseRange,
    Quantity,
    list_of,
    numbers_in,
    whole_number,
)
from flexopt.model.boundary import holding_machine
from flexopt.model.choices import BASE_ACCELERATION, BASE_RATE, GAIN, SEED, Elbow, check_objective, check_weights
from flexopt.model.file_model import BuiltByCall, FileModel
from flexopt.model.loop import (
    BANDWIDTH,
    DEAD_TIME,
    KP,
    RATE,
    SERVO_GAIN,
    Bandwidths,
    KiValues,
    KpValues,
    KvValues,
    Loop,
    TorqueRates,
    Torques,
)
from flexopt.model.machine import AnyMachine, OnMachine
from flexopt.model.targets import TIMES

Feedback = Literal["pd", "pid", "robust", "none"]
IntegrationMethod = Literal["rk4", "dop853", "gauss"]
SAMPLES_MAX = 10_000_000
PART_OF_SAMPLE = 1e-6  # below this share of a sample a dead time is a whole number of them
NOISE, RATE_NOISE = (Quantity(unit, low=0.0, high=1e3) for unit in ("m", "m/s"))

# Which of them are angles, and how many there must be, is the machine's to say.
JointValues = Annotated[Numbers, numbers_in(JOINT_VALUE)]
# None of a machine that stands where it stands.
BaseValues = Annotated[Numbers, numbers_in(JOINT_VALUE, least=0)]
_POINT = numbers_in(COORDINATE["m"])
_POINTS = list_of("points, each a list of coordinates in m", _POINT, "point {}:", 1, math.inf)


class Sensor(BuiltByCall):
    """How the end-point is measured.

    Attributes:
        noise, rate_noise: standard deviation of white noise on each sample of position, m, and rate, m/s.
        resolution, rate_resolution: steps to which they are rounded, m and m/s; 0: not rounded.
        delay: from the end-point's measurement to the command, s; any time up to 100 samples.
        filter_hz: corner of a first-order low-pass that the samples run through, Hz; none by default.

    Example:
        >>> late = flexopt.Sensor(delay=0.01, resolution=1e-4)
        >>> machine, posture = flexopt.load("excavator"), (0.0448, -2.0499)
        >>> run = flexopt.simulate(machine, posture, kp=1e4, kv=1e3, sensor=late, duration=2.0)
        >>> run.error.shape
        (401, 2)
    """

    noise: Annotated[float, NOISE] = 0.0
    rate_noise: Annotated[float, RATE_NOISE] = 0.0
    resolution: Annotated[float, NOISE] = 0.0
    rate_resolution: Annotated[float, RATE_NOISE] = 0.0
    delay: Annotated[float, DEAD_TIME] = 0.0
    filter_hz: Annotated[float, BANDWIDTH] | None = None


class Actuator(BuiltByCall):
    """What the joints' drives make of the torque asked for; a number, or a list with one for each actuated joint.

    Attributes:
        torque_limit: largest torque asked for, N m, or force of a slide, N.
        dead_band: command below which nothing happens, and by which larger ones are smaller, N m or N.
        bandwidth_hz: of a first-order servo, Hz.
        rate_limit: largest rate of the servo's torque, N m/s, or force, N/s; needs a bandwidth.
        levers: pass the joint rates that Jacobian inverse control asks for through the machine's levers, and cut what
            exceeds full lever: of `"each"` by itself, or of all by one factor, `"uniform"`, so that the end-point's
            velocity keeps its direction. See `flexopt.plant.Hydraulics`.
        servo_gain: with levers, the torque that follows from a joint rate, N m s/rad, or force, N s/m; by default the
            largest at which no full lever asks a joint for more than its effort, or where a cylinder with a force
            drives it, than that gives, in the design posture, and the article's 1 where the machine names neither.

    Example:
        >>> drives = flexopt.Actuator(torque_limit=5e4, bandwidth_hz=5.0)
        >>> machine, posture = flexopt.load("excavator"), (0.0448, -2.0499)
        >>> run = flexopt.simulate(machine, posture, kp=1e4, kv=1e3, actuator=drives, duration=2.0)
        >>> bool(abs(run.torque).max() <= 5e4)
        True
    """

    torque_limit: Torques | None = None
    dead_band: Torques | None = None
    bandwidth_hz: Bandwidths | None = None
    rate_limit: TorqueRates | None = None
    levers: Literal["each", "uniform"] | None = None
    servo_gain: Annotated[float, SERVO_GAIN] = 1.0


class Path(BuiltByCall):
    """Points at times, s, joined by straight lines; held before the first and after the last.

    Attributes:
        times: s, increasing.
        points: one for each time, each a list of coordinates, m or rad.

    Example:
        >>> way = flexopt.Path(times=[0.0, 4.0], points=[[0.0], [-1.0]])
        >>> way.at([2.0, 10.0]).tolist()
        [[-0.5], [-1.0]]
    """

    times: Annotated[Numbers, TIMES]
    points: Annotated[tuple[Numbers, ...], _POINTS]

    def structural_faults(self) -> list[Fault]:
        """What does not fit together."""
        return shape_faults(self, "")

    @public(times=array_of((), ("K",), unit="s"))
    def at(self, times: ArrayLike) -> NDArray[np.float64]:
        """Points (len(times), size).

        Example:
            >>> flexopt.Path(times=[0.0, 4.0], points=[[0.0], [-1.0]]).at([1.0]).tolist()
            [[-0.25]]
        """
        columns = [np.interp(times, self.times, column) for column in zip(*self.points, strict=True)]
        return np.array(columns).T


def shape_faults(path: Path, name: str) -> list[Fault]:
    """What does not fit together in a path, `name` (and a dot) before its keys."""
    found: list[Fault] = []
    if len(path.times) != len(path.points):
        sentence = f"needs one for each of the {len(path.times)} times"
        found.append(Fault(f"{name}points", sentence, str(len(path.points))))
    if any(later <= earlier for earlier, later in pairwise(path.times)):
        found.append(Fault(f"{name}times", "must increase, in s"))
    if len({len(point) for point in path.points}) > 1:
        found.append(Fault(f"{name}points", "must have as many coordinates each"))
    return found


class SimulationOptions(BuiltByCall):
    """A closed loop and its run: the keys of a file's `[simulation]`.

    `flexopt.simulate`, `simulate_ensemble`, `sampled_loop`, `stability_border` and `export_fmu` take it as their
    argument `options`, and its fields as keywords, too; a keyword goes before the field.

    Attributes:
        posture: actuated joints (n,), rad or m, about which to work; or give `end_point`, and `elbow` of a planar arm.
        end_point: (n_task,), m, inertial frame; for arms with no more joints than task rows.
        elbow: `"up"` (default) or `"down"`.
        base: placement (n_b,), m or rad: of a planar machine x alone; 0 by default.
        control: `"inverse"`, `"transpose"` or `"damped:LAMBDA"`; see `flexopt.evaluate`.
        feedback: `"pd"`, `"pid"`, `"robust"` (the controller that attains ε_max) or `"none"`.
        kp, kv, ki: gains, one number or one for each task row: N/m, N s/m, N/(m s) for transpose control, N m, N m s,
            N m/s for the inverse of hinges.
        integral_limit: largest |∫ ki e dt| for each axis.
        gain: servo gain kr for which `"robust"` is designed.
        offset: displacement of the joints at the start (n,), rad or m; +0.05, −0.05, … by default.
        duration: of the run, s.
        rate: of the samples, Hz.
        hold: True: the command is computed at each sample and held; False: at every stage of the integrator.
        integrator: `"rk4"` (the article's), `"dop853"` (explicit, order 8) or `"gauss"` (Gauss–Legendre, order 6,
            symplectic: the energy of undamped modes stays; where a damper brakes a joint within 1/128 of a sample,
            Radau IIA of order 5, which follows it without ever shorter steps).
        substeps: integration steps in a sample; by default as the fastest mode and damper need; of `"rk4"` 1, more
            only where a damper needs them. Where the newest measurement falls within a sample its two parts have whole
            steps of their own, none longer, so that there is one more.
        gravity: False: the weight is taken to be compensated in all coordinates, as in the article; True: it acts, and
            the machine hangs in its springs.
        gravity_compensation: whether the command carries the arm's weight, where it acts.
        nullspace_damping: of the self-motion of an arm with more joints than task rows, N m s/rad or N s/m.
        sensor: noise, resolution, delay; see `flexopt.Sensor`.
        actuator: limits, dead band, servo; see `flexopt.Actuator`.
        base_path: where the operator drives the base, `flexopt.Path` of placements or a `BaseTrajectory`'s `path`; the
            springs must give along what it moves, and in x, y and yaw where it turns.
        target_path: where the end-point shall be, `flexopt.Path`; by default where it is in the posture.
        seed: of the noise.
        baked: fold this machine's and controller's numbers into code of their own: a little faster, compiled anew for
            every set of numbers.

    Example:
        >>> options = flexopt.SimulationOptions(posture=(0.0448, -2.0499), kp=1e4, kv=1e3, duration=5.0)
        >>> machine = flexopt.load("excavator")
        >>> float(flexopt.simulate(machine, options=options).time[-1])
        5.0
    """

    posture: JointValues | None = None
    end_point: Annotated[Numbers, _POINT] | None = None
    elbow: Elbow | None = None
    base: BaseValues | None = None
    control: Annotated[Control, check_control] = "inverse"
    feedback: Feedback = "pd"
    kp: KpValues = (1e5,)
    kv: KvValues = (2e3,)
    ki: KiValues = (0.0,)
    integral_limit: Annotated[float, Quantity("N", above=0.0, high=KP.high)] = KP.high
    gain: Annotated[float, GAIN] = 5e5
    offset: JointValues | None = None
    duration: Annotated[float, DURATION] = 10.0
    rate: Annotated[float, RATE] = 200.0
    hold: bool = True
    integrator: IntegrationMethod = "rk4"
    substeps: Annotated[int, whole_number(1, 1000)] | None = None
    gravity: bool = False
    gravity_compensation: bool = True
    nullspace_damping: Annotated[float, JOINT_DAMPING] = 0.0
    sensor: Sensor = Sensor.model_construct()
    actuator: Actuator = Actuator.model_construct()
    base_path: Path | None = None
    target_path: Path | None = None
    seed: Annotated[int, SEED] = 0
    baked: bool = False


class LoopKeywords(TypedDict, total=False):
    """Fields of `SimulationOptions` as keywords of a call, for type checkers; one that is None counts as not given."""

    end_point: TargetLike | None
    elbow: Elbow | None
    base: BaseLike | None
    control: Control | None
    feedback: Feedback | None
    kp: GainLike | None
    kv: GainLike | None
    ki: GainLike | None
    integral_limit: float | None
    gain: float | None
    offset: PostureLike | None
    duration: float | None
    rate: float | None
    hold: bool | None
    substeps: int | None
    gravity: bool | None
    gravity_compensation: bool | None
    nullspace_damping: float | None
    sensor: Sensor | TableLike | None
    actuator: Actuator | TableLike | None
    base_path: Path | TableLike | None
    target_path: Path | TableLike | None
    seed: int | None
    baked: bool | None


class SimulationKeywords(LoopKeywords, total=False):
    """Those of a run."""

    integrator: IntegrationMethod | None


class LinearKeywords(LoopKeywords, total=False):
    """Those of the linear loop."""

    integrator: IntegrationMethod | Literal["exact"] | None


class OverrideKeywords(SimulationKeywords, total=False):
    """Those that take the place of a file's."""

    posture: PostureLike | None


def placement_of(options: SimulationOptions, machine: AnyMachine) -> Numbers:
    """The placement (n_b,); the origin where none is given."""
    return (0.0,) * len(machine.base_coordinates) if options.base is None else options.base


def on_their_way(delay: float, rate: float) -> int:
    """How many measurements a delay, s, keeps waiting at a rate of samples, Hz."""
    return math.ceil(delay * rate - PART_OF_SAMPLE)


def taken_early(delay: Any, waits: int, period: float) -> Any:
    """How long before a sample the newest of so many measurements was taken, s: up to a whole sample."""
    return delay - max(0, waits - 1) * period


def dead_time(options: SimulationOptions) -> tuple[int, float]:
    """Measurements on their way, and how long before a sample the newest was taken, s; 0 of whole samples."""
    waits = on_their_way(options.sensor.delay, options.rate)
    early = taken_early(options.sensor.delay, waits, 1 / options.rate)
    return waits, 0.0 if early * options.rate >= 1 - PART_OF_SAMPLE else early


class NullspaceOptions(FileModel):
    """How the base moves by the nullspace law (keys of `[nullspace]`); see `flexopt.nullspace_trajectory`.

    Attributes:
        objective: that the way climbs: `"w1"`, … or `"V"`.
        weights: α of `"V"`, one for each mode.
        base_range: [lower, upper] of the placement.
        max_base_rate: of the placement.
        max_base_acceleration: of the placement; none by default.
        duration: longest, of the way.
    """

    objective: Annotated[str, check_objective] = "w1"
    weights: Annotated[tuple[float, ...], check_weights] | None = None
    base_range: BaseRange | None = None
    max_base_rate: Annotated[float, BASE_RATE] = 0.25
    max_base_acceleration: Annotated[float, BASE_ACCELERATION] | None = None
    duration: Annotated[float, DURATION] = 60.0


class Experiment(OnMachine):
    """A simulation in a file (`flexopt.load_experiment` reads one).

    With a table `[loop]`, as a machine's, that controller runs, and `[simulation]` says nothing of it.

    Attributes:
        simulation: the closed loop and its run.
        nullspace: how the base moves meanwhile; it stands still where left out.
        loop: the real controller, as a machine's `[loop]`.

    Example:
        >>> experiment = flexopt.load_experiment("article-a")
        >>> experiment.simulation.end_point, experiment.simulation.kp
        ((0.0, 1.6), (100000.0,))
    """

    LOADER = "flexopt.load_experiment"
    simulation: SimulationOptions
    nullspace: NullspaceOptions | None = None
    loop: Loop | None = None


TABLE["experiment"] = holding_machine(Experiment, "an Experiment, from flexopt.load_experiment")
