"""The real controller as data: law, gains, sampling, dead time, filters and drives, the table `[loop]` of a machine.

In: a table. Out: a frozen `Loop`, and what of it does not go together or not with its machine.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import Annotated, Any, Literal

from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import Numbers, TableLike
from flexopt.foundation.control import Control, check_control
from flexopt.foundation.quantities import JOINT_DAMPING, Quantity, milliseconds_hint, numbers_in, pair
from flexopt.model.file_model import BuiltByCall, read_table, validated

Drive = Literal["torque", "velocity"]
DELAY_MAX = 100  # samples
DECADES = 6.0  # of a range of gains from 0
# By which share a gain may be off an end of what is tried and lie there: searches by logarithms end with steps of 1e-4.
NEAR_END = 1e-3
# In place of a table: everything follows from the machine.
DEFAULT_LOOP = "default"
# Where none is given: the article's, and that of teleoperated excavators.
RATES: dict[Drive, float] = {"torque": 200.0, "velocity": 100.0}
GAINS = {"kp": "proportional gain Kp", "kv": "velocity gain Kv", "ki": "integral gain Ki"}
# With the transpose, with the inverse of hinges, of velocity-served joints.
KP = Quantity("N/m, N m or 1/s", low=0.0, high=1e15)
KV = Quantity("N s/m, N m s or 1", low=0.0, high=1e15)
KI = Quantity("N/(m s), N m/s or 1/s²", low=0.0, high=1e15)
LOOP_GAINS = {"kp": KP, "kv": KV, "ki": KI}
TORQUE = Quantity("N m or N", low=0.0, high=1e12)
TORQUE_RATE = Quantity("N m/s or N/s", low=0.0, high=1e12)
BANDWIDTH = Quantity("Hz", low=1e-3, high=1e6)
SERVO_GAIN = Quantity(JOINT_DAMPING.unit, above=0.0, high=1e12)
RATE = Quantity("Hz", above=0.0, high=1e6)
DEAD_TIME = Quantity("s", low=0.0, high=10.0)
KpValues = Annotated[Numbers, numbers_in(KP)]
KvValues = Annotated[Numbers, numbers_in(KV)]
KiValues = Annotated[Numbers, numbers_in(KI)]
Torques = Annotated[Numbers, numbers_in(TORQUE)]
TorqueRates = Annotated[Numbers, numbers_in(TORQUE_RATE)]
Bandwidths = Annotated[Numbers, numbers_in(BANDWIDTH)]


class Loop(BuiltByCall):
    """The controller that a machine has: the keys of a file's `[loop]`, and the argument `loop` of calls.

    What is left out follows from the machine's masses, springs and drives, not from another `[loop]`;
    `flexopt.evaluate` names each value's source.

    Attributes:
        control: `"inverse"`, `"transpose"` or `"damped:LAMBDA"`; see `flexopt.evaluate`.
        feedback: `"pd"` or `"pid"`.
        kp, kv, ki: gains, one number or one for each task row: N/m, N s/m, N/(m s) for transpose control, N m,
            N m s, N m/s for the inverse of hinges (of an arm with both, the inverse's number is N m at its hinges and
            N/m at its slides). Of velocity-served joints 1/s, 1 and 1/s², from the end-point's error to the rate
            asked for.
        kp_range, kv_range: (lower, upper) between which all entries of a gain may be chosen. It is sought by its
            logarithm: a range from 0 is gone through from 1e-6 of its upper end. A gain given beside its range is
            that of today: the present configuration has it, and a verdict's places, but for its new gains.
        rate: of the samples, Hz.
        dead_time: from the end-point's measurement to command, s; any time of up to 100 samples, not only whole ones.
            Joints, which the Jacobian and the damper of the self-motion need, are measured without.
        filter_hz: corner of a first-order low-pass that the sampled measurement runs through, Hz.
        bandwidth_hz: of a first-order servo, Hz; a number, or one for each actuated joint.
        drive: `"torque"`: joints are asked for torques; `"velocity"`: for rates, which drives with levers serve by the
            torque servo_gain · (rate asked for − rate).
        servo_gain: of velocity-served joints, N m s/rad or N s/m; by default the largest at which no full lever asks a
            joint for more than its effort, or where a cylinder with a force drives it, than that gives.
        torque_limit, rate_limit: of drives that are asked for torques, as in `flexopt.Actuator`; small motions do not
            feel them.
        nullspace_damping: of the self-motion of an arm with more joints than task rows, N m s/rad or N s/m.

    Example:
        >>> loop = flexopt.Loop(kp=1e4, kv=1e3, dead_time=0.01)
        >>> machine = flexopt.load("excavator")
        >>> print(f"{flexopt.outcome(machine, (0.0448, -2.0499), loop=loop).decay:.4f} 1/s")
        0.0099 1/s
    """

    control: Annotated[Control, check_control] | None = None
    feedback: Literal["pd", "pid"] = "pd"
    kp: KpValues | None = None
    kv: KvValues | None = None
    ki: KiValues = (0.0,)
    kp_range: Annotated[tuple[float, float], pair(KP, allow_equal=True)] | None = None
    kv_range: Annotated[tuple[float, float], pair(KV, allow_equal=True)] | None = None
    rate: Annotated[float, RATE] | None = None
    dead_time: Annotated[float, DEAD_TIME] = 0.0
    filter_hz: Annotated[float, BANDWIDTH] | None = None
    bandwidth_hz: Bandwidths | None = None
    drive: Drive | None = None
    servo_gain: Annotated[float, SERVO_GAIN] | None = None
    torque_limit: Torques | None = None
    rate_limit: TorqueRates | None = None
    nullspace_damping: Annotated[float, JOINT_DAMPING] = 0.0

    def structural_faults(self) -> list[Fault]:
        """What does not fit together, whatever the machine."""
        found: list[Fault] = []
        if self.control == "transpose" and self.drive != "torque" and _says_rates(self):
            sentence = 'asks for torques, and velocity-served joints want rates; use control = "inverse"'
            found.append(Fault("control", sentence, repr(self.control)))
        if self.drive == "torque" and self.servo_gain is not None:
            found.append(Fault("servo_gain", 'goes with drive = "velocity"', f"{self.servo_gain:g}"))
        if self.rate_limit is not None and self.bandwidth_hz is None:
            found.append(Fault("rate_limit", "needs bandwidth_hz: it limits how fast the servo's torque changes"))
        if self.feedback == "pd" and any(self.ki):
            found.append(Fault("ki", 'goes with feedback = "pid"', str(list(self.ki))))
        for name, gains, allowed in (("kp", self.kp, self.kp_range), ("kv", self.kv, self.kv_range)):
            if allowed is not None and not allowed[1]:
                found.append(Fault(f"{name}_range", "must end above 0", str(list(allowed))))
            if gains is not None and allowed is not None and not allowed[0] <= min(gains) <= max(gains) <= allowed[1]:
                sentence = f"must lie in {name}_range, [{allowed[0]:g}, {allowed[1]:g}]"
                found.append(Fault(name, sentence, str(list(gains))))
        return found


# What calls take as a loop; checked at the boundary.
LoopLike = Loop | TableLike | str


def gain_ranges(loop: Loop) -> dict[str, tuple[float, float]]:
    """Ranges of the gains that may be chosen, by name."""
    given = {"kp": loop.kp_range, "kv": loop.kv_range}
    return {name: ends for name, ends in given.items() if ends is not None}


def logarithms(ends: tuple[float, float]) -> tuple[float, float]:
    """Ends of a range of gains as logarithms; one that begins at 0 is gone through over six powers of ten."""
    low, high = ends
    return math.log(low if low > 0 else high * 10**-DECADES), math.log(high)


def least_tried(name: str, gain: float, ends: tuple[float, float]) -> str:
    """That a gain is the least that is tried of a range from 0, in words; empty where it is not."""
    least = math.exp(logarithms(ends)[0])
    if ends[0] > 0 or not math.isclose(gain, least, rel_tol=NEAR_END):
        return ""
    return f"{name} is the least of its range that is tried, {least:.3g}, for 0 has no logarithm"


def loop_faults(loop: Loop, machine: Any, prefix: str = "") -> list[Fault]:
    """What does not go together in a loop, or not with its machine; `prefix` before the names of its keys."""
    found = loop.structural_faults() + length_faults(loop, machine)
    missing, rate = machine.joints_without_speed, rate_of(loop, machine)
    if loop.dead_time * rate > DELAY_MAX:
        sentence = f"must be at most {DELAY_MAX} samples of {1 / rate:g} s{milliseconds_hint(loop.dead_time)}"
        found.append(Fault("dead_time", sentence, f"{loop.dead_time:g}"))
    if loop.drive == "velocity" and loop.servo_gain is None and (missing or not any_effort(machine)):
        lacking = f"no speed of {', '.join(missing)}" if missing else "no effort of any joint"
        sentence = f'drive = "velocity" needs it: {machine.name} names {lacking}, from which it would follow'
        found.append(Fault("servo_gain", sentence))
    if _says_rates(loop):
        found += _limit_faults(loop, "")
    return [Fault(f"{prefix}{fault.field}", fault.sentence, fault.value) for fault in found]


def _says_rates(loop: Loop) -> bool:
    return loop.drive == "velocity" or loop.servo_gain is not None


def _limit_faults(loop: Loop, why: str) -> list[Fault]:
    """Limits of torques, of drives that serve rates."""
    sentence = f'goes with drive = "torque"{why}: drives that serve rates give torques of their own, and a run tells '
    sentence += "where these are more than the efforts of its joints"
    limits = {name: getattr(loop, name) for name in ("torque_limit", "rate_limit")}
    return [Fault(name, sentence, str(list(each))) for name, each in limits.items() if each is not None]


def control_of(asked: Control | None, loop: Loop | Mapping[str, Any] | None, machine: Any) -> Control:
    """The control that is asked for, else that of the loop, by default the machine's, else the Jacobian's inverse."""
    real: Loop | Mapping[str, Any] | None = machine.loop if loop is None else loop
    own = real.get("control") if isinstance(real, Mapping) else real and real.control
    return asked or own or "inverse"


def under_control(loop: Loop, machine: Any, control: Control, call: str) -> Loop:
    """The loop with the control that its call is about.

    Raises:
        InputError: the loop has another one, or something else of it does not fit the machine.
    """
    own = loop.model_copy(update={"control": control})
    faults = loop_faults(own, machine, "loop.")
    if loop.control not in (None, control):
        faults = [Fault("loop.control", f"is not the control that is asked for, {control}", repr(loop.control))]
    elif not _says_rates(own) and drive_of(own, machine) == "velocity":
        why = ", which is to be said, as efforts and speeds in the file make it velocity"
        faults += [Fault(f"loop.{each.field}", each.sentence, each.value) for each in _limit_faults(own, why)]
    if loop == machine.loop and control != control_of(None, loop, machine):
        way_out = (
            "the loop is the machine file's own, which loop = 'default' leaves out (--loop default in the shell, an "
            "empty table loop of a study or in a file)"
        )
        faults = [Fault(each.field, f"{each.sentence}; {way_out}", each.value) for each in faults]
    raise_if_any(InputError, call, faults)
    return own


def length_faults(table: Any, machine: Any, prefix: str = "") -> list[Fault]:
    """Lists of gains that are not as long as the task, lists of drives' numbers not as long as the arm."""
    joints, axes = machine.joints, len(machine.task_rows)
    of_rows = (axes, f"must be one number, or one for each of the {axes} task axes")
    of_joints = (len(joints), f"must be one number, or one for each actuated joint ({', '.join(joints)})")
    lengths = dict.fromkeys(("kp", "kv", "ki"), of_rows)
    lengths |= dict.fromkeys(("torque_limit", "dead_band", "bandwidth_hz", "rate_limit"), of_joints)
    found: list[Fault] = []
    for name, (size, sentence) in lengths.items():
        value: Numbers | None = getattr(table, name, None)
        if value is not None and len(value) not in (1, size):
            found.append(Fault(f"{prefix}{name}", sentence, str(list(value))))
    return found


def any_effort(machine: Any) -> bool:
    """Whether the machine says what any of its joints can give."""
    return bool(machine.cylinders) or any(effort != float("inf") for effort in machine.efforts)


def drive_of(loop: Loop, machine: Any) -> Drive:
    """How the joints are driven: where nothing is said of gains either, by rates, of a machine that knows its drives'.

    Gains without a drive, given or between bounds, are those of torques.
    """
    if loop.drive is not None:
        return loop.drive
    gains = (loop.kp, loop.kv, loop.kp_range, loop.kv_range)
    torque = any(each is not None for each in gains) or loop.control == "transpose"
    known = any_effort(machine) and not machine.joints_without_speed
    return "velocity" if loop.servo_gain is not None or (known and not torque) else "torque"


def loop_of_varied(given: Loop | None, machine: Any, names: Collection[str]) -> Loop:
    """The loop in which these numbers vary: that which was given, or the machine's.

    Where there is neither, gains that vary are those of torques, as given ones without a drive are.
    """
    loop = given or machine.loop
    if loop is None:
        return Loop() if {"kp", "kv"}.isdisjoint(names) else Loop(drive="torque")
    return loop


def rate_of(loop: Loop, machine: Any) -> float:
    """Samples in a second, Hz."""
    return RATES[drive_of(loop, machine)] if loop.rate is None else loop.rate


def check_loop(arguments: Arguments, machine: Any, field: str, value: Any) -> Any:
    """Return the loop of an argument, a table of its fields, or the word for the default; note what is wrong."""

    def read() -> Loop:
        given: Any = dict[str, Any]() if isinstance(value, str) and value == DEFAULT_LOOP else value
        if isinstance(given, Loop):
            found = given
        else:
            found = validated(Loop, read_table(given, field, "[loop]", InputError), field, kind=InputError)
        raise_if_any(InputError, field, loop_faults(found, machine))
        return found

    return arguments.collect(field, read)
