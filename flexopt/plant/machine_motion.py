"""From a machine to its equations of motion: structure, constants, graph builders.

In: a machine. Out: its structure, the key under which compiled code is shared, the constants of its motion from its
parameters, and the `Motion` of a structure.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import casadi as ca

from flexopt.foundation.kept import by_machine, by_structure
from flexopt.model import AnyMachine
from flexopt.plant.chain_constants import chain_constants
from flexopt.plant.chain_motion import ChainMotion
from flexopt.plant.motion import Motion
from flexopt.plant.tree_constants import constant_graphs
from flexopt.plant.tree_motion import TreeMotion
from flexopt.plant.tree_structure import Skeleton, skeleton


def motion_of(structure: Skeleton, value: Mapping[str, ca.SX]) -> Motion:
    """The equations of motion; `value` holds the constants by name, symbols or numbers."""
    return ChainMotion(structure, value) if structure.chain else TreeMotion(structure, value)


@by_machine
def structure_of(machine: AnyMachine) -> Skeleton:
    """A machine's structure, with the constants that are zero for its own parameters left out."""
    zeros = frozenset(name for name, value in constant_values(machine).items() if value == 0)
    return replace(full_structure(machine), zeros=zeros)


@by_structure
def full_structure(machine: AnyMachine) -> Skeleton:
    """A machine's structure with every constant kept that some parameters make other than zero."""
    graphs = _graphs(machine)[1]
    zeros = frozenset(name for name, graph in graphs.items() if graph.is_zero())
    return replace(skeleton(machine.kinematic_tree), constants=tuple(graphs), zeros=zeros, local=True)


@by_structure
def constants(machine: AnyMachine) -> ca.Function:
    """The constants from the parameters: input p (n_par,), output constants in the order of `constant_names`."""
    p, graphs = _graphs(machine)
    column = ca.densify(ca.vertcat(*graphs.values()))
    return ca.Function("constants", [p], [column], ["p"], ["constants"], {"cse": True})


def constant_names(machine: AnyMachine) -> tuple[str, ...]:
    """Names of the constants, in order."""
    return tuple(_graphs(machine)[1])


def constants_at(machine: AnyMachine, p: ca.SX) -> dict[str, ca.SX]:
    """The constants by name as graphs of the parameters p (n_par,)."""
    column = constants(machine)(p)
    return {name: column[k] for k, name in enumerate(constant_names(machine))}


def constant_values(machine: AnyMachine) -> dict[str, float]:
    """The constants at the machine's own parameters."""
    return dict(_values(machine))


@by_machine
def _values(machine: AnyMachine) -> tuple[tuple[str, float], ...]:
    column = constants(machine).call([ca.DM([parameter.value for parameter in machine.parameters])])[0]
    return tuple(zip(constant_names(machine), column.full().ravel().tolist(), strict=True))


@by_structure
def _graphs(machine: AnyMachine) -> tuple[ca.SX, dict[str, ca.SX]]:
    """Parameters p as symbols, and the constants that they make."""
    names = [parameter.name for parameter in machine.parameters]
    p = ca.SX.sym("p", len(names))
    value = {name: p[i] for i, name in enumerate(names)}
    tree = machine.kinematic_tree
    structure, graphs = skeleton(tree), constant_graphs(tree, value)
    return p, chain_constants(structure, graphs) if structure.chain else graphs
