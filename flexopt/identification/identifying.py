"""`flexopt.identify`: a machine's springs, dampers and load from a log of its free swing."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, cast

import numpy as np

from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.arguments import Arguments
from flexopt.foundation.arrays import Array, ArrayLike, BaseLike, PostureLike, Progress, RangeLike, Vector
from flexopt.foundation.boundary import by, of_machine, public
from flexopt.foundation.documents import provenance
from flexopt.foundation.quantities import Quantity, pair, vector
from flexopt.foundation.stages import Stages
from flexopt.identification.cleaning import after_stop, evened, held_posture, swinging, with_samples, without_spikes
from flexopt.identification.confidence import (
    BETTER_BY,
    Confidence,
    confidence,
    hidden,
    is_open_in_words,
    told_apart,
)
from flexopt.identification.fitting import INTEGRATION, Fit, fit, longest_step
from flexopt.identification.log import FrameLike, MeasuredLog, read_log, refused
from flexopt.identification.modes import described_modes, swinging_joints
from flexopt.identification.poles import Poles, find_poles
from flexopt.identification.result import FittedColumn, Identification
from flexopt.identification.small_swing import (
    SmallSwing,
    axis_doubts,
    grown,
    near_starts,
    place_doubts,
    size_doubts,
    unit_doubts,
)
from flexopt.identification.swing import HeldSwing
from flexopt.identification.unknown import read_unknown, references
from flexopt.model import AnyMachine
from flexopt.model.parameter_values import with_parameters
from flexopt.model.uncertainty import DAMPERS, SPRINGS, parameters_of

# Samples on the even grid that poles are looked for on, at most.
EVEN = 2500
# A log shows motion where the fit explains this share of a column's variance; the slowest motion fits in so often.
EXPLAINED, PERIODS = 0.2, 1.5
# Twice the logarithm of the likelihood by which the strongest motion decays rather than lasts: 3 standard deviations.
DECAYS, SMALLEST = 9.0, 1e-12
# The posture given and the joints measured may differ by, rad or m; a number is far from the file's by this factor.
AWAY, FAR = 0.05, 10.0
ANOTHER = "(a column of another direction would tell them apart)"
# First guess of the noise, of what a column moves.
NOISE = 0.02
# Stages that a caller is told of: after the starts, the small motions, the fits and in all, as long as each other at
# a log of some thousand samples.
STARTED, GROWN, FITTED, STAGES = 5, 11, 19, 20


def _imu(arguments: Arguments, machine: AnyMachine, field: str, value: Any) -> Any:
    axes = machine.kinematic_tree.axes
    place = vector(f"{len(axes)} numbers, {', '.join(axes)} in m", Quantity("m", low=-1e4, high=1e4), axes)
    return arguments.checked(field, value, place, None)


@public(
    log=of_machine(read_log),
    unknown=of_machine(read_unknown),
    window=by(pair(Quantity("s", low=-1e9, high=1e9))),
    imu=of_machine(_imu),
)
def identify(
    machine: AnyMachine,
    log: str | os.PathLike[str] | Mapping[str, ArrayLike] | FrameLike,
    *,
    posture: PostureLike | None = None,
    base: BaseLike | None = None,
    unknown: str | Sequence[str] = (SPRINGS, DAMPERS),
    gravity: bool = False,
    window: RangeLike | None = None,
    imu: ArrayLike | None = None,
    progress: Progress | None = None,
) -> Identification:
    """Parameters of a machine from a log of its free swing with the arm held: after a push, or a swing and stop.

    The machine swings by M_pp v̇ + h_p + K_p (q − q_rest) + D_p v = 0, the actuated joints held. Its modes are brought
    onto the poles of the log, and the simulated swing is then fitted to the samples by nonlinear least squares with
    exact derivatives, its first state and an offset of every column free. Columns are weighed by their own noise, found
    from the residuals. Unknowns are logarithms of factors, so that no parameter changes its sign.

    A log holds `t [s]` and any of these columns; other units in the header ([ms], [deg/s], [mm], [g]) are converted:

    | column | unit | what |
    | --- | --- | --- |
    | `base.pitch` and the other passive coordinates | rad, m | as in `machine.coordinates` |
    | `base.pitch.rate` … | rad/s, m/s | their rates |
    | `gyro_x`, `gyro_y`, `gyro_z` | rad/s | of the body that carries the arm, in its axes; in the plane `gyro_z` |
    | `acc_x`, `acc_y`, `acc_z` | m/s² | what an accelerometer on it shows, in its axes; in the plane x and y |
    | `end_point.x` … | m | the end-point, inertial axes |
    | `boom` and the other actuated joints | rad, m | where the arm is held, and when it stops |

    Args:
        machine: whose numbers these are; its own are the first guess, which may be wrong by several times.
        log: path of a CSV file (a line of names, then numbers; empty cells are missing), dictionary of arrays by name,
            or data frame.
        posture: the actuated joints (n,), rad or m; by default where the log's joints stand.
        base: placement (n_b,); 0 by default.
        unknown: names of parameters as in `machine.parameters` (`*` for any letters), `"stiffness"` and `"damping"`:
            all springs or dampers of passive coordinates that are not 0.
        gravity: whether it swings about its static deflection, as in `flexopt.evaluate`; without, the weight's part in
            the springs is counted to them.
        window: (from, to), s, of the log; by default all that follows the last motion of the measured joints.
        imu: where the accelerometer sits, m, in the axes of the body that carries the arm (in the plane x along it to
            the arm's first joint, y to its left), from the point at which its springs are: of the root link of a robot
            file `[base] point`. By default there. The axes of that link are those of the anchor frame at rest, here
            and in the log, which `[base] rotation` turns the link against.
        progress: called with the number of stages done and of all.

    Returns:
        Values, their 95 % intervals, what the log leaves open, modes, residuals and the machine with these numbers.

    Raises:
        InputError: unusable arguments or columns, all in one message; a log that is too short, does not move or does
            not decay.
        NoSolutionFound: the springs do not hold the machine.

    Source:
        Bates and Watts, Nonlinear Regression Analysis and Its Applications (Wiley, 1988), chapter 2, for the intervals;
        Newey and West, Econometrica 55 (1987), with Kiefer and Vogelsang, Econometric Theory 21 (2005), for residuals
        that are not white.

    Example:
        >>> t = np.arange(0, 5, 0.01)
        >>> turn = 2e-3 * np.exp(-0.2 * t) * np.cos(12 * t) + 1e-5 * np.random.default_rng(1).standard_normal(t.size)
        >>> log = {"t [s]": t, "gyro_z [rad/s]": turn}
        >>> machine = flexopt.load("excavator")
        >>> found = flexopt.identify(machine, log, posture=[0.5, -1.2], unknown="base.*.rotation")
        >>> sorted(found.values)
        ['base.damping.rotation', 'base.stiffness.rotation']
    """
    stages = Stages(progress, STAGES)
    stand = np.zeros(len(machine.base_coordinates)) if base is None else np.asarray(base, dtype=float)
    whole = _windowed(cast(MeasuredLog, log), cast("tuple[float, float] | None", window))
    held, doubts = _held(machine, whole, cast("Vector | None", posture))
    chosen = with_samples(whole)
    shown = swinging(chosen)
    entries, reference = references(machine, _names(machine, unknown))
    shown, spiked = without_spikes(shown)
    place = np.zeros(len(machine.kinematic_tree.axes)) if imu is None else np.asarray(imu, dtype=float)

    def swing_of(log: MeasuredLog) -> HeldSwing:
        return HeldSwing(machine, held, stand, gravity, entries, reference, log.channels, place)

    swing = swing_of(shown)
    if np.isfinite(shown.values).sum() < 2 * (2 * swing.m + len(entries) + len(shown.channels)):
        raise refused(f"has too few samples for {len(entries)} parameters")
    springs = [k for k, i in enumerate(entries) if i in parameters_of((SPRINGS,), machine)]
    small, poles = _small(swing, shown), _poles(shown, swing.m)
    starts, beginning = near_starts(small, poles, springs)
    units = unit_doubts(beginning, starts[0])
    doubts += list(units.values())
    kept = [k for k in range(len(shown.channels)) if k not in units]
    if units and kept:
        shown, spiked = shown.part(slice(None), kept), spiked[:, kept]
        swing = swing_of(shown)
        small, poles = _small(swing, shown), _poles(shown, swing.m)
        starts, beginning = near_starts(small, poles, springs)
    stages.reach(STARTED)
    mounted = axis_doubts(swing, shown) + place_doubts(swing)
    doubts += mounted + size_doubts(small, poles)
    candidates = grown(
        small, starts, beginning, springs, lambda share: stages.reach(STARTED + share * (GROWN - STARTED))
    )
    stages.reach(GROWN)
    noise = _first_noise(small, candidates[0][0])
    _check_motion(shown, noise)
    doubts += _decay_doubts(swing, poles, np.where(np.isin(np.arange(len(entries)), springs), starts[0], 0.0))
    found, others = _fits(swing, shown, candidates, noise, mounted, stages)
    _check_motion(shown, found.sigma)
    doubts += swinging_joints(swing, chosen, found)
    weak, unseen = hidden(swing, found, shown.time)
    doubts += [
        f"a motion of {hertz:.4g} Hz does not stand out of the noise: what it alone would tell is left open"
        for hertz in weak
    ]
    known = confidence(found, shown.values, unseen, others)
    _check_duration(swing, float(np.ptp(shown.time)), found)
    options = {
        "posture": held,
        "base": stand,
        "gravity": gravity,
        "unknown": swing.names,
        "window": window,
        "imu": place,
    }
    result = _result(swing, shown, spiked, found, known, doubts, options)
    stages.reach(STAGES)
    return result


def _fits(
    swing: HeldSwing,
    log: MeasuredLog,
    starts: list[tuple[Vector, Vector]],
    noise: Vector,
    mounted: Sequence[str],
    stages: Stages,
) -> tuple[Fit, list[Fit]]:
    """The best fit and others that the log does not tell from it.

    Of those that mere noise does not tell apart the nearest to the file is the best. What is told by no more than what
    no fit has is no reason to leave the least residuals.

    `mounted`: what is said of the accelerometer's axes and place, which is why a log may have no fit.
    """
    longest_step(swing, np.zeros(len(swing.names)), log.time)
    if not all(_is_slow(swing, theta, log.time) for theta, _ in starts):
        raise refused(
            "shows a motion that this machine does not make with any springs near its file's: are signs and units of "
            "its columns right, and its first and last samples no spikes?" + "".join(f" And {each}" for each in mounted)
        )
    each_of, fits = (FITTED - GROWN) / len(starts), list[Fit]()
    for k, (theta, deviation) in enumerate(starts):

        def told(share: float, begun: float = GROWN + k * each_of) -> None:
            stages.reach(begun + share * each_of)

        fits.append(fit(swing, log, theta, deviation, noise, told))
    stages.reach(FITTED)
    least = min(fits, key=lambda each: each.misfit)
    alike = [each for each in fits if not told_apart(least, each, log.values)]
    as_well = [each for each in fits if each.misfit <= least.misfit + BETTER_BY]
    best = min(as_well, key=lambda each: float(each.theta @ each.theta))
    return best, [each for each in alike if each is not best]


def _is_slow(swing: HeldSwing, theta: Vector, time: Vector) -> bool:
    """Whether its fastest mode is one that can be integrated."""
    try:
        longest_step(swing, theta, time)
    except InputError:
        return False
    return True


def _names(machine: AnyMachine, unknown: Any) -> tuple[str, ...]:
    """The names that were read; by default all springs and dampers."""
    arguments = Arguments("identify", machine)
    names = read_unknown(arguments, machine, "unknown", unknown)
    arguments.done()
    return names or ()


def _windowed(log: MeasuredLog, window: tuple[float, float] | None) -> MeasuredLog:
    if window is None:
        return after_stop(log)
    return log.part((log.time >= window[0]) & (log.time <= window[1]))


def _held(machine: AnyMachine, log: MeasuredLog, posture: Any) -> tuple[Vector, list[str]]:
    """How the arm is held, and where that is doubtful."""
    measured = held_posture(log, len(machine.joints))
    if posture is None and measured is None:
        there = {log.channels[k].index for k in log.of("joint")}
        listed = ", ".join(joint for k, joint in enumerate(machine.joints) if k not in there) or "a joint has no number"
        sentence = f"is needed: the log does not hold all actuated joints (missing: {listed})"
        raise_if_any(InputError, "identify", [Fault("posture", sentence)])
    if posture is None:
        assert measured is not None
        outside = [
            f"{joint} stands at {q:.4g} {unit}, outside its limits {low:.4g} … {high:.4g}"
            + ("; is it in degrees?" if unit == "rad" and abs(q) > math.tau else "")
            for joint, q, (low, high), unit in zip(
                machine.joints, measured, machine.limits, machine.joint_units, strict=True
            )
            if not low <= q <= high
        ]
        return measured, outside
    held = np.asarray(posture, dtype=float)
    if measured is not None and np.abs(held - measured).max() > AWAY:
        worst = int(np.argmax(np.abs(held - measured)))
        return held, [
            f"{machine.joints[worst]} is measured at {measured[worst]:.4g}, while posture says {held[worst]:.4g}"
        ]
    return held, []


def _poles(log: MeasuredLog, m: int) -> Poles:
    """Of the columns, on an even grid."""
    step = max(float(np.median(np.diff(log.time))), float(log.time[-1] - log.time[0]) / EVEN)
    return find_poles(evened(log.time, log.values, step)[1], step, m)


def _small(swing: HeldSwing, log: MeasuredLog) -> SmallSwing:
    return SmallSwing(swing, log.time, log.values, NOISE * np.nanstd(log.values, axis=0))


def _first_noise(small: SmallSwing, theta: Vector) -> Vector:
    """What small motions leave of each column, root mean square."""
    left = small.values - small.fitted(theta)[2]
    return np.maximum(np.nanstd(left, axis=0), 1e-6 * small.sigma)


def _check_motion(log: MeasuredLog, noise: Vector) -> None:
    """Refuse what shows no swing, or that of another machine."""
    explained = 1.0 - (noise / np.maximum(np.nanstd(log.values, axis=0), 1e-300)) ** 2
    if explained.max() < EXPLAINED:
        sentence = "shows no swing that stands out of its noise, or numbers that are not `unknown` do not fit it"
        raise refused(f"{sentence}: what is unknown explains {max(0.0, explained.max()):.0%} of a column at most")


def _check_duration(swing: HeldSwing, duration: float, found: Fit) -> None:
    """Refuse a log that ends before it has swung."""
    roots, shapes = swing.excited(found.theta, found.start)
    if not roots.size:
        return
    strength = (np.abs(swing.linear(found.theta)[1] @ shapes) / found.sigma[:, None]).max(axis=0)
    period = 2 * math.pi / abs(roots[int(np.argmax(strength))])
    if duration < PERIODS * period:
        raise refused(f"is too short: {duration:.3g} s, while its strongest motion takes {period:.3g} s to and fro")


def _decay_doubts(swing: HeldSwing, poles: Poles, theta: Vector) -> list[str]:
    """Whether the strongest motion lasts for ever, where the log does not tell.

    What grows is refused, and what leaves no room for a tenth of the damping that the file's dampers give, θ.
    """
    if not poles.values.size or poles.evidence >= DECAYS:
        return []
    pole, motion = poles.values[0], f"its strongest motion, {poles.values[0].imag / (2 * math.pi):.4g} Hz,"
    # The decay's standard deviation, of a likelihood that falls with its square.
    deviation = abs(pole.real) / math.sqrt(max(abs(poles.evidence), SMALLEST))
    roots = swing.modes(theta)[0]
    own = -roots[int(np.argmin(np.abs(roots.imag - pole.imag)))].real if roots.size else 0.0
    grows = poles.evidence < -DECAYS
    if grows or FAR * (math.sqrt(DECAYS) * deviation - pole.real) < own:
        how = "grows" if grows else "lasts"
        raise refused(f"shows no decay: {motion} {how}; is an engine or a loop still driving it?")
    return [f"{motion} may last for ever, which the log does not tell: the numbers are right only of a free swing"]


def _result(
    swing: HeldSwing,
    log: MeasuredLog,
    spiked: Array,
    found: Fit,
    known: Confidence,
    doubts: list[str],
    options: dict[str, Any],
) -> Identification:
    """The fit in the machine's own words."""
    machine, names = swing.machine, swing.names
    fitted = swing.reference * np.exp(found.theta)
    file = {parameter.name: parameter.value for parameter in machine.parameters}
    values: dict[str, float | None] = {}
    intervals: dict[str, tuple[float, float] | None] = {}
    for k, name in enumerate(names):
        if not known.identified[k]:
            values[name] = intervals[name] = None
            continue
        ends = sorted(float(swing.reference[k] * np.exp(end[k])) for end in (known.low, known.high))
        values[name], intervals[name] = float(fitted[k]), (ends[0], ends[1])
    factors = {name: None if value is None or not file[name] else value / file[name] for name, value in values.items()}
    columns = tuple(
        FittedColumn(
            name=channel.name,
            unit=channel.unit,
            samples=int(found.used[:, k].sum()),
            left_out=int((np.isfinite(log.values[:, k]) & ~found.used[:, k]).sum() + spiked[:, k].sum()),
            offset=float(found.offset[k]),
            residual_rms=float(np.sqrt(np.mean((found.fitted - log.values)[found.used[:, k], k] ** 2))),
            motion_rms=float(np.std(log.values[found.used[:, k], k])),
            white=bool(known.white[k]),
        )
        for k, channel in enumerate(log.channels)
    )
    return Identification(
        machine=with_parameters(machine, dict(zip(names, fitted.tolist(), strict=True))),
        before=machine,
        posture=swing.posture,
        base=swing.base,
        values=values,
        intervals=intervals,
        units={parameter.name: parameter.unit for parameter in machine.parameters if parameter.name in values},
        factors=factors,
        open_directions=(
            *(is_open_in_words(direction, names) for direction in known.directions),
            *_either_or(swing, found, known),
        ),
        modes=described_modes(swing, log.time, found),
        columns=columns,
        notes=log.notes,
        doubts=(*doubts, *_doubts(columns, factors, found, _trusted(swing))),
        duration=float(np.ptp(log.time)),
        converged=found.converged,
        time=log.time,
        measured=np.where(found.used, log.values, np.nan),
        fitted=found.fitted,
        provenance=provenance(machine, **options),
    )


def _either_or(swing: HeldSwing, found: Fit, known: Confidence) -> Iterator[str]:
    """What fits the log as well, in words."""
    units = {parameter.name: parameter.unit for parameter in swing.machine.parameters}
    for other in known.others:
        apart = np.flatnonzero(known.apart(found.theta, other.theta))
        one, two = (swing.reference * np.exp(each.theta) for each in (found, other))
        told = ", ".join(f"{swing.names[k]} {one[k]:.4g} or {two[k]:.4g} {units[swing.names[k]]}" for k in apart)
        if told and other.misfit > found.misfit + BETTER_BY:
            ratio = math.exp(np.average(np.log(other.sigma / found.sigma), weights=found.used.sum(axis=0)))
            told += f", residuals of the second {ratio:.3g} times as large, which may be by what neither has"
        if told:
            yield f"two sets of numbers fit alike, {told} {ANOTHER}"


def _trusted(swing: HeldSwing) -> list[str]:
    """Springs and dampers that are taken from the file."""
    names = [swing.machine.parameters[k].name for k in parameters_of((SPRINGS, DAMPERS), swing.machine)]
    return [name for name in names if name not in swing.names]


def _doubts(
    columns: Sequence[FittedColumn], factors: Mapping[str, float | None], found: Fit, trusted: Sequence[str]
) -> list[str]:
    """What speaks against the numbers; `trusted`: springs and dampers that are taken from the file."""
    told = list[str]()
    coloured = [column.name for column in columns if not column.white]
    if coloured:
        told.append(
            f"residuals of {', '.join(coloured)} are not white: something in the log is not in the model; intervals "
            "are widened by what they have in common"
            + (f"; perhaps the file is wrong in what is not asked for, {', '.join(trusted)}" if trusted else "")
        )
    told += [
        f"{name} is {factor:.3g} times the file's: is the file, or the log, of this machine?"
        for name, factor in factors.items()
        if factor is not None and not 1 / FAR <= factor <= FAR
    ]
    if not found.converged:
        told.append("the least squares did not come to their end")
    if found.integration > INTEGRATION:
        told.append(f"the integrator's error is {found.integration:.2g} of the noise")
    return told
