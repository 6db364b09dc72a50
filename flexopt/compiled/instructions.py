"""An expanded CasADi Function as a plain list of operations on earlier results, for whoever evaluates it otherwise."""

from __future__ import annotations

import casadi as ca


class Instructions:
    """What an SX Function does, one operation after the other.

    Attributes:
        rows_in: entries of each input; shapes_out: of each output.
        instructions: (operation, first operand, second operand), numbers of earlier instructions, a single operand
            twice; of OP_INPUT the number of the input and of its entry, of OP_CONST nothing.
        constants: of each OP_CONST, by its number.
        results: (instruction, output, entry), entries column by column.
    """

    def __init__(self, function: ca.Function) -> None:
        self.rows_in = [function.numel_in(k) for k in range(function.n_in())]
        self.shapes_out = [function.size_out(k) for k in range(function.n_out())]
        self.instructions: list[tuple[int, int, int]] = []
        self.constants: dict[int, float] = {}
        self.results: list[tuple[int, int, int]] = []
        where: dict[int, int] = {}
        for k in range(function.n_instructions()):
            operation = function.instruction_id(k)
            if operation == ca.OP_OUTPUT:
                output, element = function.instruction_output(k)
                self.results.append((where[function.instruction_input(k)[0]], output, element))
                continue
            target, node = function.instruction_output(k)[0], len(self.instructions)
            if operation == ca.OP_CONST:
                self.constants[node] = function.instruction_constant(k)
                self.instructions.append((operation, 0, 0))
            elif operation == ca.OP_INPUT:
                source, element = function.instruction_input(k)
                self.instructions.append((operation, source, element))
            else:
                operands = [where[index] for index in function.instruction_input(k)]
                self.instructions.append((operation, operands[0], operands[-1]))
            where[target] = node
