"""A closed loop to be simulated, as validated data: start, controller, sensors, actuators, run."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PrivateAttr

from flexopt.errors import Fault, ModelError
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.boundary import array_of, public
from flexopt.foundation.control import Control, check_control
from flexopt.foundation.coordinates import check_task
from flexopt.foundation.quantities import (
    COORDINATE,
    DURATION,
    JOINT_VALUE,
    BaseRange,
    Quantity,
    Schema,
    list_of,
    numbers_in,
    whole_number,
)
from flexopt.model.file_model import BuiltByCall, FileModel
from flexopt.model.machine import AnyMachine
from flexopt.model.problem import GAIN, SEED, Elbow, check_objective, check_weights

Feedback = Literal["pd", "pid", "robust", "none"]
Method = Literal["rk4", "dop853", "gauss"]
METHODS: tuple[Method, ...] = ("rk4", "dop853", "gauss")
SAMPLES_MAX = 10_000_000
DELAY_MAX = 100  # samples
PART_OF_SAMPLE = 1e-6  # below this share of a sample a dead time is a whole number of them
GAIN_MAX = 1e15

Numbers = tuple[float, ...]


Gains = Annotated[Numbers, numbers_in(Quantity("N/m and the like", low=0.0, high=GAIN_MAX))]
Torques = Annotated[Numbers, numbers_in(Quantity("N m or N", low=0.0, high=1e12))]
# Which of them are angles, and how many there must be, is the machine's to say.
Coordinates = Annotated[Numbers, numbers_in(JOINT_VALUE)]
_POINT = numbers_in(COORDINATE["m"])
_POINTS = list_of("points, each a list of coordinates in m", _POINT, "point {}:", 1, math.inf)


class Sensor(BuiltByCall):
    """How the end-point is measured.

    Attributes:
        noise, rate_noise: standard deviation of white noise on each sample of position, m, and rate, m/s.
        resolution, rate_resolution: steps to which they are rounded, m and m/s; 0: not rounded.
        delay: from measurement to command, s; a whole number of samples.
    """

    noise: Annotated[float, Quantity("m", low=0.0, high=1e3)] = 0.0
    rate_noise: Annotated[float, Quantity("m/s", low=0.0, high=1e3)] = 0.0
    resolution: Annotated[float, Quantity("m", low=0.0, high=1e3)] = 0.0
    rate_resolution: Annotated[float, Quantity("m/s", low=0.0, high=1e3)] = 0.0
    delay: Annotated[float, Quantity("s", low=0.0, high=10.0)] = 0.0


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
            largest at which no full lever asks a joint for more than its effort, in the design posture, and the
            article's 1 where the machine names no effort.
    """

    torque_limit: Torques | None = None
    dead_band: Torques | None = None
    bandwidth_hz: Annotated[Numbers, numbers_in(Quantity("Hz", low=1e-3, high=1e6))] | None = None
    rate_limit: Torques | None = None
    levers: Literal["each", "uniform"] | None = None
    servo_gain: Annotated[float, Quantity("N m s/rad or N s/m", above=0.0, high=1e12)] = 1.0


class Path(BuiltByCall):
    """Points at times, s, joined by straight lines; held before the first and after the last."""

    times: Annotated[Numbers, numbers_in(Quantity("s", low=0.0, high=1e6))]
    points: Annotated[tuple[Numbers, ...], _POINTS]

    def structural_faults(self) -> list[Fault]:
        """What does not fit together."""
        return _shape_faults(self, "")

    @public(times=array_of((), ("K",), unit="s"))
    def at(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points (len(times), size)."""
        columns = [np.interp(times, self.times, column) for column in zip(*self.points, strict=True)]
        return np.array(columns).T


def _shape_faults(path: Path, name: str) -> list[Fault]:
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


def _path_faults(path: Path, name: str, names: tuple[str, ...]) -> list[Fault]:
    """What does not fit together; `names` of a point's coordinates."""
    found = _shape_faults(path, f"{name}.")
    if not names:
        found.append(Fault(name, "has nothing to move: the machine has no placement coordinates"))
    elif any(len(point) != len(names) for point in path.points):
        sentence = f"must have {len(names)} coordinates each, in m or rad: {', '.join(names)}"
        found.append(Fault(f"{name}.points", sentence))
    return found


class SimulationOptions(FileModel):
    """What `flexopt.simulate` takes (keys of `[simulation]`); see there."""

    posture: Coordinates | None = None
    end_point: Annotated[Numbers, _POINT] | None = None
    elbow: Elbow | None = None
    base: Coordinates | None = None
    control: Annotated[Control, check_control] = "inverse"
    feedback: Feedback = "pd"
    kp: Gains = (1e5,)
    kv: Gains = (2e3,)
    ki: Gains = (0.0,)
    integral_limit: Annotated[float, Quantity("N", above=0.0, high=GAIN_MAX)] = GAIN_MAX
    gain: Annotated[float, GAIN] = 5e5
    offset: Coordinates | None = None
    duration: Annotated[float, DURATION] = 10.0
    rate: Annotated[float, Quantity("Hz", above=0.0, high=1e6)] = 200.0
    hold: bool = True
    integrator: Method = "rk4"
    substeps: Annotated[int, whole_number(1, 1000)] | None = None
    gravity: bool = False
    gravity_compensation: bool = True
    nullspace_damping: Annotated[float, Quantity("N m s/rad or N s/m", low=0.0, high=1e12)] = 0.0
    sensor: Sensor = Sensor()
    actuator: Actuator = Actuator()
    base_path: Path | None = None
    target_path: Path | None = None
    seed: Annotated[int, SEED] = 0
    baked: bool = False

    def placement(self, machine: AnyMachine) -> Numbers:
        """The placement (n_b,); the origin where none is given."""
        return (0.0,) * len(machine.base_coordinates) if self.base is None else self.base

    def faults(self, machine: AnyMachine, *, any_delay: bool = False) -> list[Fault]:
        """What does not fit together, or not this machine; `any_delay`: the linear loop takes parts of a sample."""
        found = self._posture_faults(machine) + self._controller_faults(machine) + self._time_faults(any_delay)
        for name, path, names in (
            ("base_path", self.base_path, machine.base_coordinates),
            ("target_path", self.target_path, machine.task_rows),
        ):
            found += [] if path is None else _path_faults(path, name, names)
        return found

    def _posture_faults(self, machine: AnyMachine) -> list[Fault]:
        n, rows, noted = len(machine.joints), machine.task_rows, Arguments("")
        if (self.posture is None) == (self.end_point is None):
            noted.faults.append(Fault("posture, end_point", "give one of the two"))
        if self.end_point is not None:
            point = list(self.end_point)
            noted.checked("end_point", point, lambda v: check_task(v, rows), ())
            if n > len(rows):
                sentence = f"does not name one posture of {n} actuated joints; give the posture"
                noted.faults.append(Fault("end_point", sentence, str(point)))
        if self.posture is not None:
            noted.posture(machine, list(self.posture))
        if self.offset is not None:
            noted.displacement(machine, list(self.offset), "offset")
        if self.base is not None:
            noted.base(machine, list(self.base))
        return noted.faults

    def _controller_faults(self, machine: AnyMachine) -> list[Fault]:
        n, found, axes = len(machine.joints), list[Fault](), len(machine.task_rows)
        for name, gains in (("kp", self.kp), ("kv", self.kv), ("ki", self.ki)):
            if len(gains) not in (1, axes):
                sentence = f"must be one number, or one for each of the {axes} task axes"
                found.append(Fault(name, sentence, str(list(gains))))
        wanted = f"must be one number, or one for each actuated joint ({', '.join(machine.joints)})"
        for name in ("torque_limit", "dead_band", "bandwidth_hz", "rate_limit"):
            value: Numbers | None = getattr(self.actuator, name)
            if value is not None and len(value) not in (1, n):
                found.append(Fault(f"actuator.{name}", wanted, str(list(value))))
        if self.actuator.rate_limit is not None and self.actuator.bandwidth_hz is None:
            sentence = "needs actuator.bandwidth_hz: it limits how fast the servo's torque changes"
            found.append(Fault("actuator.rate_limit", sentence))
        return found + self._lever_faults(machine)

    def _lever_faults(self, machine: AnyMachine) -> list[Fault]:
        if self.actuator.levers is None:
            return []
        found: list[Fault] = []
        if self.control == "transpose":
            sentence = 'set joint rates, and Jacobian transpose control asks for torques; use control = "inverse"'
            found.append(Fault("actuator.levers", sentence, repr(self.actuator.levers)))
        missing = machine.joints_without_speed
        if missing:
            sentence = f"need a cylinder or a speed of every joint; {machine.name} has none for {', '.join(missing)}"
            found.append(Fault("actuator.levers", sentence, repr(self.actuator.levers)))
        return found

    def _time_faults(self, any_delay: bool) -> list[Fault]:
        found: list[Fault] = []
        samples, waits = self.duration * self.rate, self.sensor.delay * self.rate
        if not 0.5 <= samples <= SAMPLES_MAX:
            found.append(Fault("duration, rate", f"must give between 1 and {SAMPLES_MAX} samples", f"{samples:g}"))
        if any_delay and waits > DELAY_MAX:
            sentence = f"must be at most {DELAY_MAX} samples of {1 / self.rate:g} s"
            found.append(Fault("sensor.delay", sentence, f"{self.sensor.delay:g}"))
        elif not any_delay and (abs(waits - round(waits)) > PART_OF_SAMPLE or waits > DELAY_MAX):
            sentence = f"must be a whole number (0 to {DELAY_MAX}) of samples of {1 / self.rate:g} s"
            sentence += "; sampled_loop and stability_border take any time"
            found.append(Fault("sensor.delay", sentence, f"{self.sensor.delay:g}"))
        if not self.hold and self.sensor != Sensor():
            sentence = "noise, resolution and delay belong to a sampled controller: give hold = true"
            found.append(Fault("sensor", sentence))
        return found


def dead_time(options: SimulationOptions) -> tuple[int, float]:
    """Measurements on their way, and how long before a sample the newest was taken, s, of a delay of any length."""
    waits = options.sensor.delay * options.rate
    whole = round(waits)
    if abs(waits - whole) <= PART_OF_SAMPLE:
        return whole, 0.0
    whole = int(waits)
    return whole + 1, (waits - whole) / options.rate


class NullspaceOptions(FileModel):
    """How the base moves by the nullspace law (keys of `[nullspace]`); see `flexopt.nullspace_trajectory`."""

    objective: Annotated[str, check_objective] = "w1"
    weights: Annotated[tuple[float, ...], check_weights] | None = None
    base_range: BaseRange | None = None
    max_base_rate: Annotated[float, Quantity("m/s", above=0.0, high=1e3)] = 0.25
    max_base_acceleration: Annotated[float, Quantity("m/s²", above=0.0, high=1e6)] | None = None
    duration: Annotated[float, DURATION] = 60.0


class Experiment(BuiltByCall):
    """A simulation in a file (`flexopt.load_experiment` reads one)."""

    schema_version: Schema = Field(default=1, alias="schema")
    name: str = Field(min_length=1)
    description: str = ""
    source: str = ""
    machine: str = Field(min_length=1)
    simulation: SimulationOptions
    nullspace: NullspaceOptions | None = None

    _loaded: AnyMachine | None = PrivateAttr(default=None)

    @public()
    def with_machine(self, machine: AnyMachine) -> Experiment:
        """The same experiment, holding its machine."""
        twin = self.model_copy()
        twin._loaded = machine
        return twin

    @property
    def loaded_machine(self) -> AnyMachine:
        """The machine that the file names."""
        if self._loaded is None:
            raise ModelError("holds no machine: flexopt.load_experiment gives one that does, or with_machine")
        return self._loaded
