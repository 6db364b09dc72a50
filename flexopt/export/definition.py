"""One public C function: the checks of its arguments, the call of its kernel, the copies of its results.

In: an operation with its kernel. Out: the text of the definition, around the template `operation.c`.
"""

from __future__ import annotations

from dataclasses import dataclass

from flexopt.export.kernels import Kernel, Real
from flexopt.export.naming import listed, number, template
from flexopt.export.operations import Field, Guard, Operation


@dataclass(frozen=True)
class Definition:
    """The definition of one function.

    Attributes:
        operation, kernel: what it computes, and by which generated function.
        prefix, real, baked: of the bundle.
        arguments: as declared.
        parameter_checks: expressions that give a status, of the machine's parameters that the kernel reads.
    """

    operation: Operation
    kernel: Kernel
    prefix: str
    real: Real
    baked: bool
    arguments: str
    parameter_checks: tuple[str, ...]

    @property
    def upper(self) -> str:
        """The prefix of macros and constants."""
        return self.prefix.upper()

    def text(self) -> str:
        """The whole function."""
        operation, kernel = self.operation, self.kernel
        tables, checks = self._input_checks(operation)
        results = sum(field.length for field in operation.outputs)
        checks = [*self._overlaps(operation), *checks]
        turned = [self._turned(field) for field in operation.inputs if any(field.turning)]
        pointers = [
            f"    arg[{k}] = {f'turned_{field.name}' if any(field.turning) else _address('in', field)};"
            for k, field in enumerate(operation.inputs)
        ]
        if not self.baked:
            pointers.append(f"    arg[{len(operation.inputs)}] = parameters->value;")
        design = [self._design(field) for field in operation.inputs if _has_margin(field)]
        remark = f"{self.upper}_OK" if not design else "remark"
        offset = 0
        for k, length in enumerate([*(f.length for f in operation.outputs), *(1 for _ in operation.guards)]):
            pointers.append(f"    res[{k}] = &workspace[{offset}];")
            offset += length
        passed = {"arg": "arg", "res": "res", "iw": "iw", "w": f"&workspace[{offset}]"}
        call = f"{kernel.name}({', '.join(passed[p] for p in kernel.parameters)})"
        scratch = [f"  const {self.prefix}_real *arg[{kernel.sz_arg}];", f"  {self.prefix}_real *res[{kernel.sz_res}];"]
        if "iw" in kernel.parameters:
            scratch.append(f"  int iw[{kernel.sz_iw}];")
        tables += [line for lines, _ in (*turned, *design) for line in lines]
        scratch += [f"  {self.prefix}_status remark = {self.upper}_OK;"] if design else []
        given = "(in != NULL) && (out != NULL)" + ("" if self.baked else " && (parameters != NULL)")
        return template(
            "operation.c",
            prefix=self.prefix,
            PREFIX=self.upper,
            name=operation.name,
            NAME=operation.name.upper(),
            arguments=self.arguments,
            tables="".join(line + "\n" for line in [*tables, *scratch]),
            given=given,
            checks="\n".join(self._unless_failed(check) for check in checks),
            pointers="\n".join([*(line for _, line in (*turned, *design)), *pointers]),
            remark=remark,
            call=call,
            guards="\n".join(self._guard(guard, results + k) for k, guard in enumerate(operation.guards)),
            results=results,
            copies="\n".join(self._copies(operation)),
        )

    def _input_checks(self, operation: Operation) -> tuple[list[str], list[str]]:
        """Tables of ranges, and expressions that give a status."""
        tables: list[str] = []
        checks: list[str] = []
        for field in operation.inputs:
            low, high = ([number(v, self.real) for v in side] for side in (field.low, field.high))
            if not field.dimensions:
                checks.append(f"{self.prefix}_check_number(in->{field.name}, {low[0]}, {high[0]})")
            elif len(set(low)) == len(set(high)) == 1:
                checks.append(f"{self.prefix}_check_alike(in->{field.name}, {field.length}U, {low[0]}, {high[0]})")
            else:
                tables += self._range_tables(field.name, field.low, field.high)
                checks.append(
                    f"{self.prefix}_check_each(in->{field.name}, {field.length}U, {field.name}_low, {field.name}_high)"
                )
        return tables, [*checks, *self.parameter_checks]

    def _overlaps(self, operation: Operation) -> list[str]:
        """Expressions that refuse a workspace that lies over another argument."""
        given = [
            (_first("in", operation.inputs[0]), "sizeof(*in)"),
            (_first("out", operation.outputs[0]), "sizeof(*out)"),
        ]
        given += [] if self.baked else [("parameters->value", "sizeof(*parameters)")]
        needed = f"{self.upper}_{operation.name.upper()}_WORKSPACE"
        return [f"{self.prefix}_check_apart(workspace, {needed}, {address}, {size})" for address, size in given]

    def _turned(self, field: Field) -> tuple[list[str], str]:
        """Declarations and a call that take whole turns off angles that turn freely."""
        length = field.length
        tables = [
            f"  static const int {field.name}_turns[{length}] = {{{', '.join(str(int(t)) for t in field.turning)}}};",
            f"  {self.prefix}_real turned_{field.name}[{length}];",
        ]
        name = field.name
        return tables, f"    {self.prefix}_unwind(in->{name}, {length}U, {name}_turns, turned_{name});"

    def _design(self, field: Field) -> tuple[list[str], str]:
        """Tables and a call that tell whether a measurement lies beyond the machine's own limits."""
        assert field.design is not None
        name = field.name
        tables = [
            f"  static const {self.prefix}_real {name}_{end}[{field.length}] = {listed(values, self.real)};"
            for end, values in zip(("least", "most"), field.design, strict=True)
        ]
        call = f"{self.prefix}_check_each(in->{name}, {field.length}U, {name}_least, {name}_most)"
        condition = f"    if ({call} != {self.upper}_OK) {{\n      remark = {self.upper}_BEYOND_LIMIT;\n    }}"
        return tables, condition

    def _range_tables(self, name: str, low: tuple[float, ...], high: tuple[float, ...]) -> list[str]:
        return [
            f"  static const {self.prefix}_real {name}_{end}[{len(values)}] = {listed(values, self.real)};"
            for end, values in (("low", low), ("high", high))
        ]

    def _unless_failed(self, check: str) -> str:
        return f"  if (status == {self.upper}_OK) {{\n    status = {check};\n  }}"

    def _guard(self, guard: Guard, index: int) -> str:
        return (
            f"  if ((status == {self.upper}_OK) && !({_condition_text(guard, f'workspace[{index}]', self.real)})) {{\n"
            f"    status = {self.upper}_{guard.status};\n  }}"
        )

    def _copies(self, operation: Operation) -> list[str]:
        lines: list[str] = []
        offset = 0
        if any(field.dimensions for field in operation.outputs):
            lines.append("    size_t i;")
        for field in operation.outputs:
            if not field.dimensions:
                lines.append(f"    out->{field.name} = workspace[{offset}];")
            else:
                target = f"out->{field.name}[i]"
                if len(field.shape) == 2:
                    target = f"out->{field.name}[i / {field.shape[1]}U][i % {field.shape[1]}U]"
                source = f"workspace[{offset}U + i]" if offset else "workspace[i]"
                lines += [f"    for (i = 0U; i < {field.length}U; ++i) {{", f"      {target} = {source};", "    }"]
            offset += field.length
        return lines


def _condition_text(guard: Guard, value: str, real: Real) -> str:
    if guard.minimum is not None:
        return f"{value} >= {number(guard.minimum, real)}"
    assert guard.maximum is not None
    return f"{value} <= {number(guard.maximum, real)}"


def _address(structure: str, field: Field) -> str:
    return f"{structure}->{field.name}" if field.dimensions else f"&{structure}->{field.name}"


def _first(structure: str, field: Field) -> str:
    """Address of the first real of a structure."""
    return f"&{structure}->{field.name}" + "[0]" * len(field.dimensions)


def _has_margin(field: Field) -> bool:
    """Whether measurements may lie beyond the machine's limits."""
    return field.design is not None and field.design != (field.low, field.high)
