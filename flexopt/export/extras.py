"""What surrounds the library: self-test with its vectors, driver, examples, build files, README.

In: the library. Out: texts. Numbers in them (vectors, the example's start posture) come from the same kernels,
evaluated in CasADi's virtual machine.
"""

from __future__ import annotations

import math
from dataclasses import replace

import casadi as ca
import numpy as np

from flexopt.export.closing import DURATION_S, RATE_HZ, settling_start
from flexopt.export.control import damps_self_motion
from flexopt.export.naming import listed, number, template, text_of
from flexopt.export.operations import ACCEPTANCE_COUNT, TOLERANCES, Array, Field, Operation, Samples
from flexopt.export.parts import PARTS
from flexopt.export.sources import STATUSES, WITH_OUTPUT, Library
from flexopt.foundation.documents import package_version

VECTOR_COUNT = 12
VECTOR_SEED = 1
ACCEPTANCE = (
    f"The last column of the functions says how many of {ACCEPTANCE_COUNT} random inputs, evenly inside the machine's "
    "limits, pass the function's\nown tests (singular postures, accuracy), by the same numbers.\n"
)
# rad/s of the closed loop of the ROS 2 node's default gains.
BANDWIDTH = 3.0


class Extras:
    """The texts around one library."""

    def __init__(self, library: Library, bundle_hash: str) -> None:
        self.library = library
        self.bundle_hash = bundle_hash
        self.prefix, self.upper = library.prefix, library.prefix.upper()

    def files(self) -> dict[str, str]:
        """Path -> text."""
        files = {
            f"test/{self.prefix}_table.h": self._table(),
            f"test/{self.prefix}_vectors.h": self._vectors(),
            "test/selftest.c": self._selftest(),
            "test/driver.c": self._template("driver.c"),
            "test/cpp_check.cpp": self._cpp_check(),
            "examples/main.c": self._example(),
            "Makefile": self._template("Makefile", objects=" ".join(f"{name[:-2]}.o" for name in self._sources)),
            "CMakeLists.txt": self._template("CMakeLists.txt", sources="\n".join(f"  {s}" for s in self._sources)),
            "README.md": self._readme(),
            "misra_deviations.json": self._template("misra_deviations.json"),
        }
        if "controller" in self.library.operations:
            files["examples/ros2_node.cpp"] = self._ros2_node()
        for foreign in self.library.foreign.values():
            files |= foreign.test_files
        return files

    @property
    def _sources(self) -> list[str]:
        return [f"src/{self.prefix}_common.c", *(f"src/{self.prefix}_{part}.c" for part in self.library.parts)]

    def _template(self, file: str, /, **values: object) -> str:
        return template(file, prefix=self.prefix, PREFIX=self.upper, **values)

    # Self-test and driver.

    def _table(self) -> str:
        operations = self.library.all_operations
        n_parameters = 0 if self.library.baked else len(self.library.context.parameters.names)
        adapters: list[str] = []
        entries: list[str] = []
        for o in operations:
            name, sizes = f"{self.prefix}_{o.name}", (_length(o.inputs), _length(o.outputs))
            passed = "" if self.library.baked else f"(const {self.prefix}_parameters *)parameters, "
            unused = "  (void)parameters;\n" if self.library.baked else ""
            adapters.append(
                f"/* The structures hold reals alone. */\n"
                f"typedef char {o.name}_in_is_plain[(sizeof({name}_in) == {sizes[0]}U * sizeof({self.prefix}_real)) "
                f"? 1 : -1];\n"
                f"typedef char {o.name}_out_is_plain[(sizeof({name}_out) == {sizes[1]}U * sizeof({self.prefix}_real)) "
                f"? 1 : -1];\n"
                f"static {self.prefix}_status call_{o.name}(const void *in, const void *parameters, void *out,\n"
                f"    {self.prefix}_real *workspace, size_t length)\n{{\n{unused}"
                f"  return {name}((const {name}_in *)in, {passed}({name}_out *)out, workspace, length);\n}}\n"
            )
            entries.append(
                f'  {{"{o.name}", call_{o.name}, {sizes[0]}U, {n_parameters}U, {sizes[1]}U, '
                f"{self.upper}_{o.name.upper()}_WORKSPACE}}"
            )
        return self._template(
            "table.h",
            adapters="\n".join(adapters),
            length=len(operations),
            largest_in=max(_length(o.inputs) for o in operations),
            largest_out=max(_length(o.outputs) for o in operations),
            n_parameters=n_parameters,
            entries=",\n".join(entries),
        )

    def _vectors(self) -> str:
        real, names = self.library.real, [o.name for o in self.library.all_operations]
        tables: list[str] = []
        for operation in self.library.all_operations:
            samples = operation.draw(self.library.context.parameters, VECTOR_COUNT, VECTOR_SEED)
            values = np.hstack([samples.inputs, samples.beyond[:, None], samples.outputs, allowed(samples, real)])
            tables.append(
                f"static const {self.prefix}_real {operation.name}_vectors[{values.size}] = "
                f"{listed(values.ravel().tolist(), real, '')};\n"
            )
        pointers = ", ".join(f"{name}_vectors" for name in names)
        return (
            "/* Rows of inputs, parameters, 1 where a joint lies beyond its limit, outputs computed in Python, and the "
            "errors\n * allowed, for each function. */\n"
            f"#ifndef {self.upper}_VECTORS_H\n#define {self.upper}_VECTORS_H\n\n"
            f'#include "{self.prefix}_control.h"\n\n'
            f"enum {{ VECTOR_COUNT = {VECTOR_COUNT} }};\n\n" + "\n".join(tables) + "\n"
            f"static const {self.prefix}_real *const vectors[{len(names)}] = {{{pointers}}};\n\n#endif\n"
        )

    def _selftest(self) -> str:
        huge = number(1e300 if self.library.real == "double" else 1e30, self.library.real)
        parts = list(self.library.foreign)
        return self._template(
            "selftest.c",
            huge=huge,
            bar=f"{TOLERANCES[self.library.real]:g}",
            foreign_includes="".join(f'#include "{part}_selftest.h"\n' for part in parts),
            foreign_calls="".join(f"  failures += {part}_failures();\n" for part in parts),
        )

    def _cpp_check(self) -> str:
        operation = self.library.all_operations[0]
        passed = "" if self.library.baked else "&parameters, "
        lines = [*self._accepted_call(operation)]
        name = f"{self.prefix}_{operation.name}"
        lines += [
            f"const {self.prefix}_status good = {name}(&in, {passed}&out, workspace.data(), workspace.size());",
            f"const {self.prefix}_status bad = {name}(nullptr, {passed}&out, workspace.data(), workspace.size());",
        ]
        return self._template("cpp_check.cpp", body="\n".join(f"  {line}" for line in lines))

    def _accepted_call(self, operation: Operation) -> list[str]:
        """Declarations of an input that is accepted, an output, and the parameters."""
        lines = [self._parameters_declaration().strip()] if not self.library.baked else []
        values = self._accepted(operation).inputs[0]
        offset, members = 0, list[str]()
        for field in operation.inputs:
            part = [number(v, self.library.real) for v in values[offset : offset + field.length]]
            members.append(f"{{{', '.join(part)}}}" if field.dimensions else part[0])
            offset += field.length
        name = f"{self.prefix}_{operation.name}"
        return [*lines, f"const {name}_in in = {{{', '.join(members)}}};", f"{name}_out out;"]

    def _accepted(self, operation: Operation) -> Samples:
        parameters = self.library.context.parameters
        own = replace(parameters, spread=(0.0,) * len(parameters.spread))
        return operation.draw(own, 1, VECTOR_SEED, displaced=False)

    def _parameters_declaration(self) -> str:
        if self.library.baked:
            return ""
        return f"  const {self.prefix}_parameters parameters = {self.upper}_DEFAULT_PARAMETERS;\n"

    # Examples.

    def _example(self) -> str:
        if not {"kinematics", "controller"} <= set(self.library.operations):
            return self._example_calls()
        operations = {o.name: o for o in self.library.all_operations}
        start = settling_start(self.library.context, operations)
        if start is None and "machine_step" in operations:
            del operations["machine_step"]
            start = settling_start(self.library.context, operations)
        if start is None:
            return self._example_calls()
        real, of_machine = self.library.real, "machine_step" in operations
        set_damping = set_rates = ""
        if start.nullspace_damping:
            d, joints = number(start.nullspace_damping, real), f"{self.upper}_COORDINATES - {self.upper}_JOINTS"
            set_damping = f"  controller.nullspace_damping = {d}; /* of the arm's self-motion */\n"
            measured = f"machine.rates[{joints} + j]" if of_machine else "rate[j]"
            set_rates = f"      controller.joint_rates[j] = {measured};\n"
        return self._template(
            "example_machine.c" if of_machine else "example_loop.c",
            set_damping=set_damping,
            set_rates=set_rates,
            rate=RATE_HZ,
            duration=DURATION_S,
            substeps=start.substeps,
            inertia=f"(({self.prefix}_real){number(start.inertia, real)})",
            start=listed([*start.rest, *start.posture], real),
            kp=number(start.kp, real),
            kv=number(start.kv, real),
            distance=number(float(f"{start.distance:.6g}"), real),
            settled=f"{start.settled:.4g}",
            foreign_includes=self._foreign_includes(),
            foreign_calls=self._foreign_calls(),
            parameters_declaration=self._parameters_declaration(),
            **{"pass": "" if self.library.baked else "&parameters, "},
        )

    def _foreign_calls(self) -> str:
        return "\n".join(each.example_call() for each in self.library.foreign.values())

    def _example_calls(self) -> str:
        passed = "" if self.library.baked else "&parameters, "
        calls: list[str] = []
        for operation in self.library.all_operations:
            name = f"{self.prefix}_{operation.name}"
            declared = self._accepted_call(operation)[0 if self.library.baked else 1 :]
            first = operation.outputs[0]
            value = f"out.{first.name}" + "[0]" * len(first.dimensions)
            lines = [
                *declared,
                f"status = {name}(&in, {passed}&out, workspace, {self.upper}_WORKSPACE);",
                f'printf("{operation.name}: %s", {self.prefix}_status_text(status));',
                f"if ({self.prefix}_has_output(status)) {{",
                f'  printf("; {first.name} %.9g ...", (double){value});',
                "} else {",
                "  ++failures;",
                "}",
                'printf("\\n");',
            ]
            calls.append("  {\n" + "\n".join(f"    {line}" for line in lines) + "\n  }")
        return self._template(
            "example_calls.c",
            calls="\n".join([*calls, self._foreign_calls()]),
            foreign_includes=self._foreign_includes(),
            parameters_declaration=self._parameters_declaration(),
        )

    def _foreign_includes(self) -> str:
        return "".join(f'#include "{self.prefix}_{part}.h"\n' for part in self.library.foreign)

    def _ros2_node(self) -> str:
        posture, inertia = self._start()
        baked, context = self.library.baked, self.library.context
        damped, real = damps_self_motion(context.plant, "inverse"), f"{self.prefix}_real"
        set_placement = declare_placement = ""
        if context.placement_matters:
            set_placement = (
                f"  void set_placement(std::size_t k, double value) {{ input_.placement[k] = "
                f"static_cast<{self.prefix}_real>(value); }}\n"
            )
            declare_placement = (
                f"    // Where the base stands: {', '.join(context.machine.base_coordinates)}.\n"
                f'    const auto placement = declare_parameter("placement", '
                f"std::vector<double>({self.upper}_PLACEMENT, 0.0));\n"
                f"    for (std::size_t k = 0; k < placement.size() && k < {self.upper}_PLACEMENT; ++k) {{\n"
                f"      controller_.set_placement(k, placement[k]);\n    }}\n"
            )
        return self._template(
            "ros2_node.cpp",
            set_placement=set_placement,
            declare_placement=declare_placement,
            joint_names=", ".join(f'"{text_of(j)}"' for j in self.library.context.machine.joints),
            set_rate=f"  void set_rate(std::size_t joint, double rate) {{ input_.joint_rates[joint] = "
            f"static_cast<{self.prefix}_real>(rate); }}\n"
            if damped
            else "",
            set_damping="    // Of the self-motion.\n"
            f"    input_.nullspace_damping = static_cast<{real}>(derivative_gain);\n"
            if damped
            else "",
            pass_rate="      if (index < m.velocity.size()) controller_.set_rate(j, m.velocity[index]);\n"
            if damped
            else "",
            load_parameters="" if baked else f"    {self.prefix}_default_parameters(&parameters_);\n",
            parameters_member="" if baked else f"  {self.prefix}_parameters parameters_{{}};\n",
            pass_member="" if baked else "&parameters_, ",
            kp=f"{inertia * BANDWIDTH**2:.6g}",
            kv=f"{2 * inertia * BANDWIDTH:.6g}",
            start_list=", ".join(repr(float(v)) for v in posture),
        )

    def _start(self) -> tuple[Array, float]:
        """A posture far from singular ones, and the mean inertia of its joints."""
        context = self.library.context
        plant, p, base = context.plant, context.plant.parameter_values, ca.DM.zeros(context.plant.n_base, 1)
        postures = context.joint_angles.draw(np.random.default_rng(VECTOR_SEED), 64)
        sines = plant.singularity_sine_squared.call([base, ca.DM(postures.T), p])[0].full().ravel()
        posture = postures[int(np.argmax(sines))].round(4)
        rest = plant.rest.call([base, ca.DM(posture), p])[0]
        mass = plant.mass.call([rest, base, p])[0].full()
        inertia = float(np.trace(mass[plant.n_passive :, plant.n_passive :])) / plant.n_actuated
        return posture, float(f"{inertia:.4g}")

    # The README.

    def _readme(self) -> str:
        library = self.library
        machine, baked = library.context.machine, library.baked
        operations = [
            f"| `{self.prefix}_{o.name}` | `src/{self.prefix}_{part}.c` | {_cell(o.text)} | {library.workspace(o)} "
            f"| {100 * library.acceptance[o.name]:.0f} % |"
            for part, group in library.operations.items()
            for o in group
        ]
        operations += [
            f"| `{name}` | `src/{self.prefix}_{part}.c` | {PARTS[part].title}, see below | of its own | |"
            for part, foreign in library.foreign.items()
            for name in foreign.functions
        ]
        loop = {"kinematics", "controller"} <= set(library.operations)
        first = library.all_operations[0]
        passed = "" if baked else "&parameters, "
        call = [
            f"static {self.prefix}_real workspace[{self.upper}_WORKSPACE];",
            *self._accepted_call(first),
            f"{self.prefix}_status status =",
            f"    {self.prefix}_{first.name}(&in, {passed}&out, workspace, {self.upper}_WORKSPACE);",
            f"if (!{self.prefix}_has_output(status)) puts({self.prefix}_status_text(status));",
        ]
        return self._template(
            "README.md",
            title=f"{text_of(machine.name)}: {', '.join(PARTS[part].title for part in library.parts)}",
            machine_plain=text_of(machine.name),
            machine_hash=machine.content_hash,
            bundle_hash=self.bundle_hash,
            flexopt=package_version("flexopt"),
            real=library.real,
            real_words="double precision" if library.real == "double" else "single precision throughout",
            parameters_words="constants in the code (baked)"
            if baked
            else f"an argument of every call; `{self.upper}_DEFAULT_PARAMETERS` are those of the export",
            control=library.context.control,
            example_words="closes the loop around the exported controller" if loop else "calls each function once",
            functions="\n".join(operations),
            pass_words="" if baked else "the machine's parameters,",
            call_example="\n".join(call),
            foreign="".join(foreign.readme() for foreign in library.foreign.values()),
            bounded_words="the number of steps does not depend on the numbers"
            + ("; that of the optimiser does, up to its budget" if library.foreign else ""),
            statuses="\n".join(
                f"| `{self.upper}_{name}` | {text} | {'new' if name in WITH_OUTPUT else 'as it was'} |"
                for name, text in STATUSES.items()
            ),
            allowance_deg=f"{math.degrees(library.context.limit_allowance['rad']):g}",
            allowance_m=f"{library.context.limit_allowance['m']:g}",
            counted_max=f"{library.context.counted_max('rad'):g}",
            acceptance="\n" + ACCEPTANCE if any(o.guards for o in library.all_operations) else "",
            ros_words=", and `ros2_node.cpp`, a ROS 2 node (compiles without ROS 2, too)"
            if "controller" in library.operations
            else "",
        )


def allowed(samples: Samples, real: str) -> Array:
    """Largest error allowed of each output, (count, n_out)."""
    return TOLERANCES[real] * samples.scales


def _cell(text: str) -> str:
    """Text in a cell of a table."""
    return text.replace("|", "\\|")


def _length(fields: tuple[Field, ...]) -> int:
    return sum(field.length for field in fields)
