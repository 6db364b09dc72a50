"""The bundle's C library: header, checks, and one file for each part.

In: the operations and the options. Out: texts. The functions that users call are written from templates around the
generated kernels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from flexopt.export.context import Context
from flexopt.export.definition import Definition
from flexopt.export.foreign import Foreign
from flexopt.export.kernels import Kernel, KernelText, Real, kernel_text
from flexopt.export.naming import comment, constants, listed, number, template, text_of
from flexopt.export.operations import TURN, Field, Guard, Operation
from flexopt.export.parts import PARTS
from flexopt.foundation.documents import package_version

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
        foreign: parts that bring their own sources.
    """

    context: Context
    prefix: str
    real: Real
    operations: dict[str, tuple[Operation, ...]]
    foreign: dict[str, Foreign]

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of all parts, in the order of `PARTS`."""
        return tuple(part for part in PARTS if part in self.operations or part in self.foreign)

    @property
    def upper(self) -> str:
        """The prefix of macros and constants."""
        return self.prefix.upper()

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
        sizes = dict(self.context.sizes.values)
        return sizes if self.baked else sizes | {"PARAMETERS": len(self.context.parameters.names)}

    @cached_property
    def parameter_constants(self) -> list[str]:
        """Names of the parameters' indices."""
        return [f"{self.upper}_PARAMETER_{word}" for word in constants(self.context.parameters.names)]

    def workspace(self, operation: Operation) -> int:
        """Length of an operation's workspace, in reals: results, guards, then the kernel's own."""
        kernel = self.kernels[operation.name]
        return self._n_results(operation) + len(operation.guards) + (kernel.sz_w if "w" in kernel.parameters else 0)

    @staticmethod
    def _n_results(operation: Operation) -> int:
        return sum(field.length for field in operation.outputs)

    @cached_property
    def acceptance(self) -> dict[str, float]:
        """Share of random inputs that each operation's own tests let through."""
        return {o.name: o.acceptance(self.context.parameters) for o in self.all_operations}

    def kernel_digest_text(self) -> str:
        """What decides the bundle's content, to be hashed: kernels, documentation, ranges."""
        parts = [text.text for text in self._kernel_texts.values()]
        parts += [text for foreign in self.foreign.values() for text in foreign.library_files.values()]
        return "\n".join([*parts, self.header(bundle_hash="")])

    def files(self, bundle_hash: str) -> dict[str, str]:
        """Path -> text of the library's files."""
        texts = {
            f"include/{self.prefix}_control.h": self.header(bundle_hash),
            f"src/{self.prefix}_internal.h": self._template("internal.h", **self._constants),
            f"src/{self.prefix}_common.c": self._common(),
        }
        texts |= {f"src/{self.prefix}_{part}.c": self._part(part) for part in self.operations}
        for foreign in self.foreign.values():
            texts |= foreign.library_files
        return texts

    @property
    def _constants(self) -> dict[str, str]:
        """What the checks need in the bundle's precision."""
        values = {"TURN": 2 * math.pi, "TURN_HIGH": TURN[0], "TURN_LOW": TURN[1], "HALF": 0.5}
        numbers = {name: number(value, self.real) for name, value in values.items()}
        largest, floor = ("DBL_MAX", "floor") if self.real == "double" else ("FLT_MAX", "floorf")
        return numbers | {"REAL_MAX": largest, "FLOOR": floor}

    def _template(self, file: str, /, **values: object) -> str:
        return template(file, prefix=self.prefix, PREFIX=self.upper, **values)

    # The header.

    def header(self, bundle_hash: str) -> str:
        """The public header."""
        machine = self.context.machine
        sizes = [f"  {self.upper}_{name} = {value}, {comment(SIZE_TEXTS[name])}" for name, value in self.sizes.items()]
        allowance = self.context.limit_allowance
        statuses = [f"  {self.upper}_{name} = {k}, {comment(text)}" for k, (name, text) in enumerate(STATUSES.items())]
        return self._template(
            "header.h",
            title=text_of(f"Controller functions of the machine {machine.name}: {', '.join(self.parts)}."),
            flexopt=package_version("flexopt"),
            machine=text_of(machine.name),
            machine_hash=machine.content_hash,
            bundle_hash=bundle_hash,
            real="double" if self.real == "double" else "float",
            part_macros="\n".join(f"#define {self.upper}_HAS_{part.upper()} 1" for part in self.parts),
            sizes=_without_last_comma(sizes),
            allowance_rad=number(allowance["rad"], self.real),
            allowance_m=number(allowance["m"], self.real),
            counted_max=f"{self.context.counted_max('rad'):g}",
            statuses=_without_last_comma(statuses),
            enums=self._enums(),
            parameters=self._parameters(),
            workspace=max(self.workspace(operation) for operation in self.all_operations),
            operations="\n".join(self._declaration(operation) for operation in self.all_operations),
            others="".join(f"{self._mention(part)}\n\n" for part in self.foreign),
        )

    def _mention(self, part: str) -> str:
        functions = " and ".join(f"{name}()" for name in self.foreign[part].functions)
        return comment(f"{self.prefix}_{part}.h declares the {PARTS[part].title}: {functions}.")

    def _enums(self) -> str:
        plant = self.context.plant
        axes = plant.machine.task_rows
        groups = [
            ("Rows of points and rates, inertial frame.", "AXIS", axes, [""] * len(axes)),
            ("Actuated joints, from the base outwards.", "JOINT", plant.machine.joints, plant.machine.joint_units),
            ("Coordinates q: passive ones, then actuated ones.", "COORDINATE", plant.coordinates,
             plant.graph.coordinate_units),
            ("Placement of the base, which the operator chooses.", "PLACEMENT", plant.machine.base_coordinates,
             plant.machine.base_units),
        ]  # fmt: skip
        if not self.baked:
            p = self.context.parameters
            groups.append(("Machine parameters.", "PARAMETER", p.names, p.units))
        return "\n".join(self._enum(text, kind, names, units) for text, kind, names, units in groups if names)

    def _enum(self, text: str, kind: str, names: tuple[str, ...], units: list[str] | tuple[str, ...]) -> str:
        lines = [
            f"  {self.upper}_{kind}_{word} = {k},{f' {comment(ascii_unit(unit))}' if unit else ''}"
            for k, (word, unit) in enumerate(zip(constants(names), units, strict=True))
        ]
        return f"{comment(text)}\nenum {{\n{_without_last_comma(lines)}\n}};\n"

    def _parameters(self) -> str:
        if self.baked:
            return "/* The machine's parameters are constants inside the functions. */\n"
        p = self.context.parameters
        values = listed(p.values, self.real, "").replace("\n", " \\\n")
        text = comment(
            "The machine's parameters, indexed by the enumeration above; change them (the payload, say) whenever you "
            "like. They are checked at each call, as far as the function called uses them."
        )
        return (
            f"{text}\ntypedef struct {{\n  {self.prefix}_real value[{self.upper}_PARAMETERS];\n}} "
            f"{self.prefix}_parameters;\n\n{comment('The machine as it was exported.')}\n"
            f"#define {self.upper}_DEFAULT_PARAMETERS {{ {values} }}\n\n"
            f"{comment('Write the same into *parameters.')}\n"
            f"{self.prefix}_status {self.prefix}_default_parameters({self.prefix}_parameters *parameters);\n"
        )

    def _declaration(self, operation: Operation) -> str:
        name = f"{self.prefix}_{operation.name}"
        refusals = [f"{self.upper}_{g.status} where {_condition(g)} ({g.text})" for g in operation.guards]
        about = operation.text + (f" Refused: {'; '.join(refusals)}." if refusals else "")
        inputs = "\n".join(self._member(field, ranges=True) for field in operation.inputs)
        outputs = "\n".join(self._member(field, ranges=False) for field in operation.outputs)
        return (
            f"{comment(about)}\n"
            f"typedef struct {{\n{inputs}\n}} {name}_in;\n\n"
            f"typedef struct {{\n{outputs}\n}} {name}_out;\n\n"
            f"#define {self.upper}_{operation.name.upper()}_WORKSPACE {self.workspace(operation)}U\n\n"
            f"{self.prefix}_status {name}({self._arguments(operation)});\n"
        )

    def _member(self, field: Field, *, ranges: bool) -> str:
        size = "".join(f"[{self.upper}_{d}]" for d in field.dimensions)
        unit = ascii_unit(field.unit) or "dimensionless"
        about = f"{unit}; {field.text}"
        if ranges:
            low, high = set(field.low), set(field.high)
            same = len(low) == len(high) == 1
            about += f"; from {field.low[0]:g} to {field.high[0]:g}" if same else "; each in its own range"
        return f"{comment(about, '  ')}\n  {self.prefix}_real {field.name}{size};"

    def _arguments(self, operation: Operation) -> str:
        name = f"{self.prefix}_{operation.name}"
        listed_arguments = [
            f"const {name}_in *in",
            *([] if self.baked else [f"const {self.prefix}_parameters *parameters"]),
            f"{name}_out *out",
            f"{self.prefix}_real *workspace",
            "size_t workspace_length",
        ]
        start = f"{self.prefix}_status {name}("
        return f",\n{' ' * len(start)}".join(listed_arguments)

    # The sources.

    def _common(self) -> str:
        default = ""
        if not self.baked:
            default = "\n" + self._template(
                "default_parameters.c", values=listed(self.context.parameters.values, self.real)
            )
        cases = [f'  case {self.upper}_{name}:\n    text = "{text}";\n    break;' for name, text in STATUSES.items()]
        return self._template(
            "common.c",
            common_title="" if self.baked else ", default parameters",
            status_cases="\n".join(cases),
            real=self.real,
            parts=", ".join(self.parts),
            default_parameters=default,
        )

    def _part(self, part: str) -> str:
        text = self._kernel_texts[part]
        operations = "\n".join(
            self._definition(operation, text.kernels[operation.name]) for operation in self.operations[part]
        )
        title = PARTS[part].title
        return self._template(
            "part.c",
            title=title[0].upper() + title[1:],
            casadi=package_version("casadi"),
            kernels=text.text,
            operations=operations.rstrip("\n"),
        )

    def _definition(self, operation: Operation, kernel: Kernel) -> str:
        checks: list[str] = []
        for index in [] if self.baked else self.used_parameters(operation):
            p = self.context.parameters
            low, high = number(p.low[index], self.real), number(p.high[index], self.real)
            value = f"parameters->value[{self.parameter_constants[index]}]"
            checks.append(f"{self.prefix}_check_number({value}, {low}, {high})")
        arguments = self._arguments(operation)
        return Definition(operation, kernel, self.prefix, self.real, self.baked, arguments, tuple(checks)).text()

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


def ascii_unit(unit: str) -> str:
    """A unit in ASCII."""
    return unit.replace("²", "^2")


def _condition(guard: Guard) -> str:
    return f"{guard.name} < {guard.minimum:.4g}" if guard.minimum is not None else f"{guard.name} > {guard.maximum:.4g}"


def _without_last_comma(lines: list[str]) -> str:
    """Enumerators: C90 and C++98 take no comma after the last one."""
    *others, last = lines
    head, _, tail = last.partition(",")
    return "\n".join([*others, head + tail])
