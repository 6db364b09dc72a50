"""What the rows of a task are, in words: for headers and READMEs of bundles, and for variables of FMUs.

In: a machine. Out: sentences; of orientation rows with their numbers, which are constants of what is exported.
"""

from __future__ import annotations

from flexopt.model import AnyMachine
from flexopt.model.kinematic_tree import ORIENTATION_ROWS
from flexopt.model.tree_quantities import UNTURNED, Matrix3


def row_text(machine: AnyMachine, row: str) -> str:
    """Which coordinate of the end-point a task row is."""
    return orientation_texts(machine).get(row, f"{row}, inertial frame")


def orientation_texts(machine: AnyMachine) -> dict[str, str]:
    """What each orientation row of the task is: length · φ_k, m, φ (rad) the rotation vector from the reference."""
    end, found = machine.kinematic_tree.end_point, dict[str, str]()
    length = f"{end.length:.12g} m"
    reference = "the inertial axes" if end.reference == UNTURNED else _listed(end.reference)
    own = "" if end.rotation == UNTURNED else f" times {_listed(end.rotation)}"
    for k, row in enumerate(ORIENTATION_ROWS):
        axis, first, second = ("xyz"[(k + i) % 3] for i in range(3))
        found[row] = (
            f"{row} = {length} * phi_{axis}, phi the rotation vector (unit axis times angle, rad) of R_reference^T "
            "R_end_point, which turns the reference's axes into the end-point's, in the reference's axes; right-handed "
            f"about its +{axis}, so positive from its {first} towards its {second}; of a turn about its {axis} alone "
            f"phi_{axis} is the angle, and the row's rate {length} times the angular velocity, of others in general "
            f"not; R_reference: {reference}; R_end_point: the axes of {end.body}{own}; columns in inertial axes"
        )
    return {row: found[row] for row in machine.task_rows if row in found}


def task_frame(machine: AnyMachine) -> str:
    """The frame of a point or a rate, and where a header tells what its orientation rows are."""
    told = ", ".join(f"AXIS_{row.upper()}" for row in orientation_texts(machine))
    return f"inertial frame, orientation as told at {told}" if told else "inertial frame"


def _listed(matrix: Matrix3) -> str:
    return f"[{', '.join('[' + ', '.join(f'{x + 0.0:.12g}' for x in row) + ']' for row in matrix)}]"
