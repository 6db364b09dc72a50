"""What of a log can be used: the part in which the arm stands still, without spikes, and where samples are missing.

In: a `MeasuredLog`. Out: the same, less; every step says what it took away.
"""

from __future__ import annotations

from typing import cast

import numpy as np
from numpy.typing import NDArray

from flexopt.foundation.arrays import Array, Vector
from flexopt.foundation.plain import counted
from flexopt.identification.log import MeasuredLog, refused

SAMPLES_MIN, SAMPLES_MAX = 40, 50_000
# The arm stands still where its joints stay this near to where they end, rad or m, and within their noise.
STILL = 5e-3
# What is left of the stop itself, in pipes and valves, s.
SETTLING = 0.1
# Neighbours on either side that a sample is told from; a spike is so many times farther off than most samples.
NEIGHBOURS, SPIKE, PASSES = 6, 9.0, 4
# The middle of the absolute values of normal noise is this share of its standard deviation.
MEDIAN_SHARE = 0.6745
# A hole is a step this many times longer than most; over one of so many steps a cubic is drawn where an even grid is
# needed.
HOLE, BRIDGED = 1.6, 3.5


def after_stop(log: MeasuredLog) -> MeasuredLog:
    """What comes after the last motion of the arm, where the log has its joints."""
    if log.time.size < SAMPLES_MIN:
        return log
    last = slice(-max(SAMPLES_MIN // 2, log.time.size // 4), None)
    joints = [k for k in log.of("joint") if np.isfinite(log.values[last, k]).any()]
    if not joints:
        return log
    values, tail = log.values[:, joints], log.values[last][:, joints]
    ends, noise = np.nanmedian(tail, axis=0), np.nanstd(tail, axis=0)
    moves = np.any(np.abs(values - ends) > np.maximum(STILL, 6.0 * noise), axis=1)
    if not moves.any():
        return log
    stop = log.time[np.flatnonzero(moves)[-1]]
    note = f"the arm moves until t = {stop:.4g} s; what comes {SETTLING:g} s after is used"
    return log.part(log.time > stop + SETTLING, None, note)


def with_samples(log: MeasuredLog) -> MeasuredLog:
    """From the first to the last sample of what shows a swing; as it is where these are too few."""
    shown = [k for k in range(len(log.channels)) if log.channels[k].kind != "joint"]
    there = np.flatnonzero(np.isfinite(log.values[:, shown]).any(axis=1))
    return log if there.size < SAMPLES_MIN else log.part(slice(there[0], there[-1] + 1))


def held_posture(log: MeasuredLog, joints: int) -> Vector | None:
    """Where the joints stand (n,), in the middle; None where not all are measured."""
    columns = {log.channels[k].index: k for k in log.of("joint") if np.isfinite(log.values[:, k]).any()}
    if len(columns) < joints:
        return None
    return np.array([np.nanmedian(log.values[:, columns[j]]) for j in range(joints)])


def swinging(log: MeasuredLog) -> MeasuredLog:
    """The columns that show a swing, each moving and with enough samples.

    Raises:
        InputError: nothing is measured, nothing moves, or there are too few samples.
    """
    kept, notes = list[int](), list[str]()
    shown = [k for k in range(len(log.channels)) if log.channels[k].kind != "joint"]
    for k in shown:
        name, column = log.channels[k].name, log.values[:, k][np.isfinite(log.values[:, k])]
        if column.size < SAMPLES_MIN:
            notes.append(f"{name} has {column.size} samples and is left out")
        elif np.ptp(column) <= 1e-12 * np.abs(column).max():
            notes.append(f"{name} does not move and is left out")
        else:
            kept.append(k)
    if not shown:
        raise refused("measures nothing that swings: rates or coordinates of the base, or the end-point, are needed")
    if log.time.size < SAMPLES_MIN:
        raise refused(f"is too short: {log.time.size} samples, at least {SAMPLES_MIN} are needed")
    if log.time.size > SAMPLES_MAX:
        raise refused(f"is too long: {log.time.size:,} samples, at most {SAMPLES_MAX:,} are read; choose a window")
    if not kept:
        raise refused(f"shows no motion: {'; '.join(notes)}")
    return log.part(slice(None), kept, *notes, *_holes(log.time))


def _holes(time: Vector) -> list[str]:
    step = np.diff(time)
    usual = float(np.median(step))
    wide = step > HOLE * usual
    if wide.any():
        holes, missing = int(wide.sum()), int(np.sum(np.round(step[wide] / usual) - 1))
        gaps = f"{counted(holes, 'gap')}, about {counted(missing, 'sample')} missing"
        return [f"{gaps}; the longest lasts {step.max():.4g} s"]
    even = np.abs(step - usual).max() <= 0.02 * usual
    return [] if even else [f"sampled unevenly, every {step.min():.3g} to {step.max():.3g} s"]


def without_spikes(log: MeasuredLog) -> tuple[MeasuredLog, Array]:
    """The log with single samples that do not go with their neighbours left out, and which they are (N, c)."""
    values, notes = log.values.copy(), list[str]()
    found = np.zeros(values.shape, dtype=bool)
    for k, channel in enumerate(log.channels):
        found[:, k] = spikes(log.time, values[:, k])
        count = int(found[:, k].sum())
        if count:
            at = ", ".join(f"{t:.4g}" for t in log.time[found[:, k]][:3]) + (", …" if count > 3 else "")
            notes.append(f"{channel.name}: {counted(count, 'spike')} left out, at t = {at} s")
    values[found] = np.nan
    return MeasuredLog(log.time, log.channels, values, (*log.notes, *notes)), found


def spikes(time: Vector, values: Vector) -> NDArray[np.bool_]:
    """Samples of a column that its neighbours on both sides do not foretell, by linear interpolation fitted to it.

    A sum of decaying oscillations is foretold exactly by as many neighbours as it has poles. Samples with a hole among
    their neighbours are not judged.
    """
    column, found, wide = values.copy(), np.zeros(values.size, dtype=bool), 2 * NEIGHBOURS + 1
    if column.size < 3 * wide:
        return found
    step = np.diff(time)
    broken = (step > HOLE * float(np.median(step))) | np.isnan(column[1:] + column[:-1])
    holes = np.concatenate([[0], np.cumsum(broken)])
    middle = np.flatnonzero(holes[wide - 1 :] == holes[: 1 - wide]) + NEIGHBOURS
    if middle.size < 3 * wide:
        return found
    column -= float(np.nanmedian(column))
    for _ in range(PASSES):
        windows = np.lib.stride_tricks.sliding_window_view(column, wide)[middle - NEIGHBOURS]
        error = _trimmed_errors(np.delete(windows, NEIGHBOURS, axis=1), column[middle])
        size = np.zeros(column.size)
        size[middle] = np.abs(error)
        scale = float(np.median(np.abs(error))) / MEDIAN_SHARE
        # What one sample of them spoils is seen in all windows that hold it: only the worst is its own.
        worst = np.lib.stride_tricks.sliding_window_view(np.pad(size, NEIGHBOURS), wide).max(axis=1)
        bad = np.flatnonzero((size > SPIKE * scale) & (size >= worst))
        if not bad.size or scale == 0.0 or bad.size > 0.02 * column.size + 1:
            break
        found[bad] = True
        # What was foretold stands in, so that the samples beside it can be judged.
        column[bad] -= error[np.searchsorted(middle, bad)]
    return found


def _trimmed_errors(beside: Array, middle: Vector) -> Vector:
    """What least squares leave of `middle`, fitted to the samples that they foretell well."""
    error = middle - beside @ np.linalg.lstsq(beside, middle, rcond=None)[0]
    for _ in range(2):
        good = np.abs(error) <= 3.0 * float(np.median(np.abs(error))) / MEDIAN_SHARE
        if good.sum() < 2 * beside.shape[1]:
            return error
        error = middle - beside @ np.linalg.lstsq(beside[good], middle[good], rcond=None)[0]
    return error


def evened(time: Vector, values: Array, step: float) -> tuple[Vector, Array]:
    """The columns on an even grid of times, cubic between samples; NaN in holes."""
    from scipy.interpolate import CubicSpline  # noqa: PLC0415  (loads slowly)

    grid = time[0] + step * np.arange(int((time[-1] - time[0]) / step + 1e-9) + 1)
    usual = float(np.median(np.diff(time)))
    found = np.full((grid.size, values.shape[1]), np.nan)
    for k, column in enumerate(values.T):
        there = np.isfinite(column)
        at = time[there]
        found[:, k] = CubicSpline(at, column[there])(grid)
        place = cast(NDArray[np.intp], np.searchsorted(at, grid))
        after = np.clip(place, 1, at.size - 1)
        hole = (at[after] - at[after - 1] > BRIDGED * max(usual, step)) & (np.abs(grid - at[after]) > 1e-9)
        found[hole | (grid < at[0]) | (grid > at[-1] + 1e-9), k] = np.nan
    return grid, found
