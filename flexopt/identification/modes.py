"""A machine's modes with its arm held, before and after a fit, in words; and joints that swing along instead."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import cast

import casadi as ca
import numpy as np

from flexopt.foundation.arrays import Array, Vector
from flexopt.identification.fitting import Fit
from flexopt.identification.log import MeasuredLog
from flexopt.identification.result import IdentifiedMode
from flexopt.identification.small_swing import assurance
from flexopt.identification.swing import HeldSwing, oscillations

# Where one coordinate has this share of the energy it is named alone; below it, all with the lesser share.
MOSTLY, PARTLY = 0.6, 0.15
# A joint swings along from this share of the end-point's motion on, where that takes so many times the variance that as
# many unknowns take of mere noise.
ALONG, STANDS_OUT = 0.01, 10.0


def described_modes(swing: HeldSwing, time: Vector, found: Fit) -> tuple[IdentifiedMode, ...]:
    """The modes of a fit, beside those of the machine's file."""
    from scipy.optimize import linear_sum_assignment  # noqa: PLC0415  (loads slowly)

    m, plant = swing.m, swing.plant
    roots, shapes = swing.excited(found.theta, found.start)
    v, c = swing.modes(found.theta)[1], swing.linear(found.theta)[1]
    waves = oscillations(roots, time)
    springs: Array = plant.stiffness.call([ca.DM(swing.parameters(found.theta))])[0].full()[:m, :m]
    told = replace(swing, unknown=(), reference=np.zeros(0))
    roots0, v0, _ = told.modes(np.zeros(0))
    scale = np.sqrt(np.diag(springs))[:, None]
    a, b = scale * v[:m], scale * v0[:m]
    pairs = dict(zip(*(part.tolist() for part in linear_sum_assignment(-assurance(a, b))), strict=True))
    modes = list[IdentifiedMode]()
    for k, root in enumerate(roots.tolist()):
        energy = np.abs((v[:m, k].conj() * (springs @ v[:m, k])).real)
        share = energy / energy.sum()
        part = 2 * np.outer(waves[:, k], c @ shapes[:, k]).real
        seen = float((np.sqrt(np.mean(part**2, axis=0)) / found.sigma).max())
        hertz, old = abs(root) / (2 * math.pi), pairs.get(k)
        words = f"mode {k + 1}, {hertz:.3g} Hz: {_in_words(share, swing.machine.coordinates)}"
        modes.append(
            IdentifiedMode(
                words=words,
                frequency_hz=hertz,
                damping_ratio=float(-root.real / abs(root)),
                frequency_before_hz=math.nan if old is None else float(abs(roots0[old])) / (2 * math.pi),
                damping_ratio_before=math.nan if old is None else float(-roots0[old].real / abs(roots0[old])),
                shares={name: float(x) for name, x in zip(swing.machine.coordinates, share, strict=False)},
                signal_to_noise=seen,
            )
        )
    return tuple(modes)


def swinging_joints(swing: HeldSwing, log: MeasuredLog, found: Fit) -> list[str]:
    """Measured joints that swing along, and so move the end-point by more than a share of what the base does."""
    theta, m = found.theta, swing.m
    roots, shapes = swing.excited(theta, found.start)
    q, told = np.concatenate([swing.rest(theta)[:m], swing.posture]), list[str]()
    moves: Array = swing.plant.jacobian.call([q, swing.base, swing.parameters(theta)])[0].full()
    waves = oscillations(roots, log.time)
    by_base: Array = 2 * np.real(waves @ (moves[:, :m] @ shapes[:m]).T)
    of_base = math.sqrt(float(np.sum(by_base**2)) / log.time.size)
    swings: Array = np.hstack([waves.real, waves.imag])
    basis: Array = np.hstack([swings, np.ones((log.time.size, 1)), log.time[:, None]])
    for k in log.of("joint"):
        column, there = log.values[:, k], np.isfinite(log.values[:, k])
        if there.sum() <= basis.shape[1]:
            continue
        weights = cast(Vector, np.linalg.lstsq(basis[there], column[there], rcond=None)[0])
        size, joint = float(np.std(swings @ weights[:-2])), log.channels[k].index
        noise = float(np.mean((column - basis @ weights)[there] ** 2)) * weights.size / float(there.sum())
        by_joint = size * float(np.linalg.norm(moves[:, m + joint]))
        if size**2 > STANDS_OUT * noise and by_joint > ALONG * of_base:
            name, unit = swing.machine.joints[joint], swing.machine.coordinate_units[m + joint]
            told.append(
                f"{name} swings along, by {size:.2g} {unit} root mean square, which moves the end-point by "
                f"{by_joint / of_base:.0%} of what the base does: the model takes the arm as held"
            )
    return told


def _in_words(share: Vector, names: tuple[str, ...]) -> str:
    order: list[int] = np.argsort(-share, kind="stable").tolist()
    if share[order[0]] >= MOSTLY:
        return f"mostly {_of_the_base(names[order[0]])}"
    return " with ".join(_of_the_base(names[k]) for k in order if share[k] >= PARTLY)


def _of_the_base(name: str) -> str:
    first, dot, rest = name.partition(".")
    return f"{rest} of the base" if dot and first == "base" else name
