"""The bundle's C library: header, checks, and one file for each part.

In: the operations and the options. Out: texts. The functions that users call are written from templates around the
generated kernels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca

from flexopt.export.context import Context
from flexopt.export.kernels import Kernel, KernelText, Real, kernel_text
from flexopt.export.naming import CWriter, constants
from flexopt.export.operations import TURN, Operation
from flexopt.export.parts import PARTS
from flexopt.export.task_rows import orientation_texts
from flexopt.foundation.documents import build_version, package_version

STATUSES = {
    "OK": "success: every output is written and finite",
    "NULL_POINTER": "a pointer is NULL",
    "BAD_WORKSPACE": "the workspace is misaligned, too short, or overlaps another argument",
    "NOT_FINITE": "an input or a parameter is NaN or infinite",
    "OUT_OF_RANGE": "an input or a parameter is outside its range",
    "SINGULAR_POSTURE": "the arm is too close to a posture where its Jacobian loses rank",
    "NOT_ACCURATE": "the result would not be accurate: an iteration has not converged, or digits cancel",
    "NUMERICAL_FAILURE": "a result is not finite",
    "BEYOND_LIMIT": "a warning: every output is written and finite, but a measured joint lies beyond its limit, by no "
    "more than is allowed",
}
# Those after which the outputs are new; the others leave them as they were.
WITH_OUTPUT = ("OK", "BEYOND_LIMIT")
SIZE_TEXTS = {
    "TASK": "rows of the end-point task",
    "COORDINATES": "all coordinates q, passive first",
    "JOINTS": "actuated joints",
    "PLACEMENT": "placement coordinates of the base",
    "CHOICE": "z = [placement; joint angles]",
    "MODES": "vibration modes, as many as passive coordinates, ordered by frequency",
    "PARAMETERS": "machine parameters",
}


@dataclass(frozen=True)
class Library:
    """The C library of one bundle.

    Attributes:
        context: the machine and the options.
        prefix: of every public name.
        real: precision.
        operations: by part, in the order of `PARTS`.
    """

    context: Context
    prefix: str
    real: Real
    operations: dict[str, tuple[Operation, ...]]

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of all parts, in the order of `PARTS`."""
        return tuple(self.operations)

    @property
    def baked(self) -> bool:
        """Whether the parameters are constants."""
        return self.context.baked

    @cached_property
    def all_operations(self) -> tuple[Operation, ...]:
        """Of every part."""
        return tuple(operation for group in self.operations.values() for operation in group)

    @cached_property
    def kernels(self) -> dict[str, Kernel]:
        """The kernel behind each operation."""
        return {name: kernel for text in self._kernel_texts.values() for name, kernel in text.kernels.items()}

    @cached_property
    def _kernel_texts(self) -> dict[str, KernelText]:
        real_type = f"{self.prefix}_real"
        return {
            part: kernel_text([operation.kernel for operation in group], self.real, real_type)
            for part, group in self.operations.items()
        }

    @cached_property
    def sizes(self) -> dict[str, int]:
        """Array sizes by name."""
        sizes = self.context.sizes
        return sizes if self.baked else sizes | {"PARAMETERS": len(self.context.parameters.names)}

    @cached_property
    def parameter_constants(self) -> list[str]:
        """Names of the parameters' indices."""
        return [f"{self.writer.upper}_PARAMETER_{word}" for word in constants(self.context.parameters.names)]

    def workspace(self, operation: Operation) -> int:
        """Length of an operation's workspace, in reals: results, guards, then the kernel's own."""
        kernel = self.kernels[operation.name]
        return operation.n_out + len(operation.guards) + (kernel.sz_w if "w" in kernel.parameters else 0)

    @cached_property
    def acceptance(self) -> dict[str, float]:
        """Share of random inputs that each operation's own tests let through."""
        return {o.name: o.acceptance(self.context.parameters) for o in self.all_operations}

    def kernel_digest_text(self) -> str:
        """What decides the bundle's content, to be hashed: kernels, documentation, ranges."""
        return "\n".join([*(text.text for text in self._kernel_texts.values()), self.header(bundle_hash="")])

    @cached_property
    def writer(self) -> CWriter:
        """What writes the bundle's texts."""
        return CWriter(self.prefix, self.real)

    def files(self, bundle_hash: str) -> dict[str, str]:
        """Path -> text of the library's files."""
        texts = {
            f"include/{self.prefix}_control.h": self.header(bundle_hash),
            f"src/{self.prefix}_internal.h": self.writer.render("internal.h", turn=2 * math.pi, turn_parts=TURN),
            f"src/{self.prefix}_common.c": self.writer.render("common.c", **self.described),
        }
        return texts | {f"src/{self.prefix}_{part}.c": self._part(part) for part in self.operations}

    @cached_property
    def described(self) -> dict[str, Any]:
        """What templates of the header, of the tests and of the README ask for."""
        return {
            "machine": self.context.machine,
            "baked": self.baked,
            "parts": self.parts,
            "titles": {part: PARTS[part].title for part in self.parts},
            "operations": self.all_operations,
            "statuses": STATUSES,
            "sizes": self.sizes,
            "orientation": orientation_texts(self.context.machine),
            "parameters": self.context.parameters.values,
            "allowance": self.context.limit_allowance,
            "counted_max": self.context.counted_max("rad"),
            "workspaces": {o.name: self.workspace(o) for o in self.all_operations},
            "flexopt": build_version(),
            "pass": "" if self.baked else "&parameters, ",
        }

    def header(self, bundle_hash: str) -> str:
        """The public header."""
        return self.writer.render(
            "header.h",
            **self.described,
            bundle_hash=bundle_hash,
            size_texts=SIZE_TEXTS,
            enumerations=self._enumerations(),
        )

    def _enumerations(self) -> list[tuple[str, str, list[tuple[str, str]]]]:
        """What each is for, its word in the names, its entries with their units."""
        plant = self.context.plant
        axes, machine = plant.machine.task_rows, plant.machine
        groups: list[tuple[str, str, Sequence[str], Sequence[str]]] = [
            ("Rows of points and rates, inertial frame.", "AXIS", axes, [""] * len(axes)),
            ("Actuated joints, from the base outwards.", "JOINT", machine.joints, machine.joint_units),
            ("Coordinates q: passive ones, then actuated ones.", "COORDINATE", plant.coordinates,
             plant.graph.coordinate_units),
            ("Placement of the base, which the operator chooses.", "PLACEMENT", machine.base_coordinates,
             machine.base_units),
        ]  # fmt: skip
        if not self.baked:
            p = self.context.parameters
            groups.append(("Machine parameters.", "PARAMETER", p.names, p.units))
        return [(text, kind, list(zip(constants(names), units, strict=True))) for text, kind, names, units in groups]

    def _part(self, part: str) -> str:
        text, title = self._kernel_texts[part], PARTS[part].title
        return self.writer.render(
            "part.c",
            title=title[0].upper() + title[1:],
            casadi=package_version("casadi"),
            kernels=text.text,
            baked=self.baked,
            operations=[(o, text.kernels[o.name], self._read(o)) for o in self.operations[part]],
        )

    def _read(self, operation: Operation) -> list[tuple[str, float, float]]:
        """Parameters that the kernel reads: the constant that is their index, and their range."""
        p = self.context.parameters
        used = [] if self.baked else self.used_parameters(operation)
        return [(self.parameter_constants[k], p.low[k], p.high[k]) for k in used]

    def used_parameters(self, operation: Operation) -> list[int]:
        """Indices of the parameters that the kernel reads."""
        kernel = operation.kernel
        n = len(self.context.parameters.names)
        if not kernel.is_a("SXFunction"):
            # Derivatives that are declared zero hide what an iteration depends on.
            return list(range(n))
        symbols = kernel.sx_in()
        graph = ca.veccat(*kernel.call(symbols))
        return [k for k in range(n) if ca.depends_on(graph, symbols[-1][k])]
