"""The constants of a chain of parallel hinges in a vertical plane, from those of the tree's recursions.

In: a structure and its constants. Out: those of `ChainMotion`, by name. Body k's first moment is (a_k, b_k), its second
one s_kk; what hangs on body l at (c_l, d_l) has s_kl = c_l a_k + d_l b_k and t_kl = d_l a_k − c_l b_k. Quotients are
constants of their own, so that no step divides by what never changes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import casadi as ca

from flexopt.plant.tree_algebra import AXES
from flexopt.plant.tree_structure import MatrixRows, Skeleton


def chain_constants(structure: Skeleton, value: Mapping[str, ca.SX]) -> dict[str, ca.SX]:
    """The constants of the motion by name, from those of the tree's recursions."""
    slides, hinges = structure.leading_slides, structure.hinges
    zero = ca.SX(0)
    result = {"gravity": value["gravity"]}
    carried = [*slides, hinges[0]]
    result |= {f"origin_{axis}": sum_of(value[f"offset{i}.{axis}"] for i in carried) for axis in "xy"}
    total = sum_of(value[f"m{i}"] for i in slides)
    if slides:
        result |= {"total": total, "inverse_total": 1 / total}
    directions = translations_of(structure)
    for (direction, sign), i in zip(directions, slides, strict=True):
        result[f"rest_{direction}"] = sign * value[f"rest{i}"]
        for word in ("stiffness", "damping"):
            result[f"{word}_{direction}"] = value.get(f"{word}{i}.{i}", zero)
            result[f"{word}_{direction}_m"] = result[f"{word}_{direction}"] / total
    both = len(slides) == 2
    axes = structure.axes_of_chain
    a, b = zip(*(_in_plane(axes[k], value, f"c{i}") for k, i in enumerate(hinges)), strict=True)
    ends = [f"offset{i}" for i in hinges[1:]] + ["tip"]
    reach = [_in_plane(axes[k], value, end) for k, end in enumerate(ends)]
    for k, i in enumerate(hinges):
        along, left = reach[k]
        result |= {f"a{k}": a[k], f"b{k}": b[k], f"length{k}": along, f"lateral{k}": left}
        result |= {f"am{k}": a[k] / total, f"bm{k}": b[k] / total} if slides else {}
        for m in range(k + 1):
            along, left = reach[m]
            s = value[f"s{i}.xx"] if m == k else along * a[k] + left * b[k]
            t = zero if m == k else left * a[k] - along * b[k]
            if both:
                s -= (a[k] * a[m] + b[k] * b[m]) / total
                t -= (a[k] * b[m] - b[k] * a[m]) / total
            result |= {f"s{k}_{m}": s} | ({f"t{k}_{m}": t} if m < k else {})
        segment = structure.segments[i]
        result |= {f"rest{k}": structure.sense_across(i) * value[f"rest{i}"]} if segment.passive else {}
        words = ("stiffness",) * segment.passive + ("damping",)
        result |= {} if segment.held else {f"{word}{k}": value.get(f"{word}{i}.{i}", zero) for word in words}
    held = structure.segments[hinges[0]].held
    if held:
        result |= {"base_cos": ca.cos(result["rest0"]), "base_sin": ca.sin(result["rest0"])}
    if both:
        first = 1 if held else 0
        result["inverse_pivot"] = 1 / result[f"s{first}_{first}"]
    return result


def translations_of(structure: Skeleton) -> list[tuple[str, float]]:
    """Of each slide, whether it goes along the first row, "x", or the second, "y", and its sign."""
    axes = [structure.segments[i].axis for i in structure.leading_slides]
    return [("x", axis[0]) if axis[0] else ("y", axis[1]) for axis in axes]


def _in_plane(axes: MatrixRows, value: Mapping[str, ca.SX], name: str) -> tuple[ca.SX, ca.SX]:
    """A constant of a body along the task's rows where all joints are at zero; `axes` are the rows of its frame."""
    first, second = (
        sum_of(row[k] * value[f"{name}.{axis}"] for k, axis in enumerate(AXES) if row[k]) for row in axes[:2]
    )
    return first, second


def sum_of(terms: Iterable[ca.SX]) -> ca.SX:
    """Sum of graphs."""
    return sum(terms, start=ca.SX(0))
