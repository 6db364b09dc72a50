"""What surrounds the library: self-test with its vectors, driver, examples, build files, README.

In: the library. Out: texts. Numbers in them (vectors, the example's start posture) come from the same kernels,
evaluated in CasADi's virtual machine.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property

import numpy as np

from flexopt.export.closing import AGE_MAX, DURATION_S, RATE_HZ, Start, settling_start, steady_hold
from flexopt.export.context import SINGLE_MARGIN_DEG
from flexopt.export.control import torque_unit
from flexopt.export.operations import ACCEPTANCE_COUNT, TOLERANCES, Field, Operation
from flexopt.export.sources import WITH_OUTPUT, Library

VECTOR_COUNT = 12
VECTOR_SEED = 1


class Project:
    """The texts around one library."""

    def __init__(self, library: Library, bundle_hash: str) -> None:
        self.library, self.bundle_hash, self.prefix = library, bundle_hash, library.prefix

    def files(self) -> dict[str, str]:
        """Path -> text."""
        sources = [f"src/{self.prefix}_common.c", *(f"src/{self.prefix}_{part}.c" for part in self.library.parts)]
        first = {"o": self.library.all_operations[0], "values": self._accepted(self.library.all_operations[0])}
        files = {
            f"test/{self.prefix}_table.h": self._render("table.h"),
            f"test/{self.prefix}_vectors.h": self._vectors(),
            "test/selftest.c": self._selftest(),
            "test/driver.c": self._render("driver.c"),
            "test/cpp_check.cpp": self._render("cpp_check.cpp", **first),
            "examples/main.c": self._example(),
            "Makefile": self._render("Makefile", sources=sources),
            "CMakeLists.txt": self._render("CMakeLists.txt", sources=sources),
            "README.md": self._readme(),
            "misra_deviations.json": self._render("misra_deviations.json"),
        }
        if self._has_node:
            files["examples/ros2_node.cpp"] = self._ros2_node()
        return files

    def _render(self, file: str, /, **values: object) -> str:
        return self.library.writer.render(file, **self.library.described, **values)

    def _vectors(self) -> str:
        parameters, vectors = self.library.context.parameters, dict[str, list[float]]()
        for operation in self.library.all_operations:
            samples = operation.draw(parameters, VECTOR_COUNT, VECTOR_SEED)
            # Largest error allowed of each output.
            bars = TOLERANCES[self.library.real] * samples.scales
            rows = np.hstack([samples.inputs, samples.beyond[:, None], samples.outputs, bars])
            vectors[operation.name] = rows.ravel().tolist()
        return self._render("vectors.h", count=VECTOR_COUNT, vectors=vectors)

    def _selftest(self) -> str:
        real = self.library.real
        huge = self.library.writer.number(1e300 if real == "double" else 1e30)
        return self._render("selftest.c", huge=huge, bar=f"{TOLERANCES[real]:g}")

    def _accepted(self, operation: Operation) -> list[tuple[Field, list[float]]]:
        """An input that is accepted, by members."""
        parameters = self.library.context.parameters
        own = replace(parameters, spread=(0.0,) * len(parameters.spread))
        samples = operation.draw(own, 1, VECTOR_SEED, displaced=False)
        parts = operation.split(samples.inputs)
        return [(field, part[0].tolist()) for field, part in zip(operation.inputs, parts, strict=False)]

    def _keeps_farther(self, operation: Operation) -> bool:
        """Whether it refuses postures that are farther from singular ones than was asked for."""
        asked = self.library.context.singularity_margin**2
        return any(guard.status == "SINGULAR_POSTURE" and (guard.minimum or 0.0) > asked for guard in operation.guards)

    @cached_property
    def _closed(self) -> tuple[Start, bool] | None:
        """A start from which the example's loop settles, and whether with the machine itself, else with a stand-in."""
        if not {"kinematics", "controller"} <= set(self.library.operations):
            return None
        operations = {o.name: o for o in self.library.all_operations}
        for of_machine in (True, False) if "machine_step" in operations else (False,):
            if not of_machine:
                operations.pop("machine_step", None)
            start = settling_start(self.library.context, operations)
            if start is not None:
                return start, of_machine
        return None

    def _example(self) -> str:
        if self._closed is None:
            return self._render("example_calls.c", calls=[(o, self._accepted(o)) for o in self.library.all_operations])
        start, of_machine = self._closed
        inertias = ["kg m^2" if unit == "rad" else "kg" for unit in self.library.context.machine.joint_units]
        return self._render(
            "example_loop.c",
            of_machine=of_machine,
            start=start,
            rate=RATE_HZ,
            duration=DURATION_S,
            coordinates=[*start.rest, *start.posture],
            distance=float(f"{start.distance:.6g}"),
            inertia_unit=" or ".join(dict.fromkeys(inertias)),
        )

    @property
    def _has_node(self) -> bool:
        """Whether there is a ROS 2 node: its messages are points, which have no place for orientation rows."""
        return "controller" in self.library.operations and set(self.library.context.machine.task_rows) <= set("xyz")

    def _ros2_node(self) -> str:
        context = self.library.context
        hold = steady_hold(context)
        damped = hold.gains.nullspace_damping > 0
        gains = {"proportional_gain": repr(hold.gains.kp), "derivative_gain": repr(hold.gains.kv)}
        return self._render(
            "ros2_node.cpp",
            joints=context.machine.joints,
            placement=context.machine.base_coordinates if context.placement_matters else (),
            damped=damped,
            hold=hold,
            gains=gains | ({"nullspace_damping": repr(hold.gains.nullspace_damping)} if damped else {}),
            rate=RATE_HZ,
            age_max=AGE_MAX,
            posture=[repr(float(v)) for v in hold.posture],
            unit=torque_unit(context).replace(", ", " or "),
            joint_units=" or ".join(dict.fromkeys(context.machine.joint_units)),
        )

    def _readme(self) -> str:
        library = self.library
        # What most come for is the torque, by the loop that was given where there is one.
        named = {o.name: o for o in library.all_operations}
        shown = named.get("loop_step") or named.get("torque_inverse") or library.all_operations[0]
        return self._render(
            "README.md",
            o=shown,
            values=self._accepted(shown),
            bundle_hash=self.bundle_hash,
            control=library.context.control,
            groups=library.operations,
            acceptance=library.acceptance,
            acceptance_count=ACCEPTANCE_COUNT,
            guarded=any(o.guards for o in library.all_operations),
            singularity_margin_deg=math.degrees(math.asin(library.context.singularity_margin)),
            single_margin_deg=SINGLE_MARGIN_DEG,
            farther=[o.name for o in library.all_operations if self._keeps_farther(o)],
            has_node=self._has_node,
            loop_closed=self._closed is not None,
            judged=library.context.judged_loop,
            settings=library.context.loop,
            brakes_self_motion=any(field.name == "joint_rates" for field in shown.inputs),
            keeps=any(field.name.startswith("next_") for field in shown.outputs),
            with_output=WITH_OUTPUT,
            allowance_deg=math.degrees(library.context.limit_allowance["rad"]),
        )
