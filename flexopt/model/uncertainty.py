"""What nobody has measured, as data: numbers of a machine, and its loop's dead time, as intervals; `[[uncertainty]]`.

In: tables. Out: frozen `Uncertainty`s, and what of them does not go with their machine.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Annotated, Any, cast

from pydantic import ConfigDict

from flexopt.errors import Fault
from flexopt.foundation.arrays import TableLike
from flexopt.foundation.nearest import hint_or_list
from flexopt.foundation.plain import listed, shown
from flexopt.foundation.quantities import Quantity, a_list, accepting, pair, several
from flexopt.model.file_model import BuiltByCall
from flexopt.model.loop import DEAD_TIME
from flexopt.model.parameter_ranges import parameter_range

FACTOR = Quantity("", low=1e-3, high=1e3)
VALUE = Quantity("", low=-1e15, high=1e15)
# Words for what every machine has: springs and dampers of the passive coordinates, and the loop's dead time.
SPRINGS, DAMPERS, LATE = "stiffness", "damping", "dead_time"
WORDS = (SPRINGS, DAMPERS, LATE)
UNCERTAIN_MAX, NAME_MAX = 8, 200
# Relative difference of factors that are one, which decimals are rounded to.
ALIKE = 1e-9


_FACTORS = pair(FACTOR, allow_equal=True)


@accepting(_FACTORS.accepts or {})
def _check_factor(value: Any) -> tuple[float, float]:
    """A pair of factors."""
    try:
        return _FACTORS(value)
    except ValueError as error:
        raise ValueError(f"{error}; numbers in their own unit, 0 among them, are a value") from None


@accepting({"anyOf": [{"type": "string", "minLength": 1}, a_list({"type": "string", "minLength": 1}, 1)]})
def _check_names(value: Any) -> tuple[str, ...]:
    """One name or several."""
    names = several(value)
    if not names or not all(
        isinstance(name, str) and 0 < len(name) <= NAME_MAX and name.isprintable() for name in names
    ):
        listed = f"{', '.join(WORDS[:-1])} or {LATE}"
        raise ValueError(f"must be names of parameters, of at most {NAME_MAX} letters, or {listed}")
    return tuple(names)


class Uncertainty(BuiltByCall):
    """One thing that is not known: an entry of a file's `[[uncertainty]]`, and of the argument `ranges` of calls.

    Attributes:
        of: what it concerns, a name or several: parameters of the machine, named as in its `parameters` (`*` stands for
            any letters), `"stiffness"` or `"damping"`, all springs or dampers of the passive coordinates, or
            `"dead_time"`, that of the loop.
        factor: (lower, upper) of one factor that multiplies all of them together, such as one of the soil's. Factors of
            several entries that concern one parameter multiply each other.
        value: (lower, upper) of a single one, in its own unit: of a payload, or of the dead time, s.

    Example:
        >>> soil = flexopt.Uncertainty(of="stiffness", factor=(0.5, 2.0))
        >>> machine, posture = flexopt.load("excavator"), (0.0448, -2.0499)
        >>> region = flexopt.stable_region(machine, posture, loop={"kp": 1e4, "kv": 1e3}, ranges=[soil])
        >>> region.stable, region.critical
        (True, {'stiffness': 0.5})
    """

    model_config = ConfigDict(json_schema_extra={"oneOf": [{"required": ["factor"]}, {"required": ["value"]}]})

    of: Annotated[tuple[str, ...], _check_names]
    factor: Annotated[tuple[float, float], _check_factor] | None = None
    value: Annotated[tuple[float, float], pair(VALUE, allow_equal=True)] | None = None

    @property
    def name(self) -> str:
        """What it concerns, in short."""
        return ", ".join(self.of)

    def structural_faults(self) -> list[Fault]:
        """What does not fit together, whatever the machine."""
        faults = list[Fault]()
        if (self.factor is None) == (self.value is None):
            faults.append(Fault("factor, value", "give one of the two"))
        if LATE in self.of and len(self.of) > 1:
            faults.append(Fault("of", "dead_time stands alone", self.name))
        if self.of == (LATE,):
            try:
                pair(DEAD_TIME, allow_equal=True)(self.value)
            except ValueError as error:
                faults.append(Fault("value", str(error) if self.value else "dead_time needs it, (lower, upper) in s"))
        return faults


# What calls take as what is uncertain; checked at the boundary.
RangesLike = TableLike | Sequence[Uncertainty | TableLike]


def kind_of(name: Any) -> str:
    """Whether (lower, upper) of that name alone are of a factor, as of all springs, or of a value."""
    return "factor" if isinstance(name, str) and name in (SPRINGS, DAMPERS) else "value"


def ranges_by_place(given: Any) -> dict[str, Any]:
    """Entries of ranges by where they stand: of a table from names to (lower, upper), or of a list."""
    if isinstance(given, Mapping) and "of" not in given:
        named = cast(Mapping[Any, Any], given).items()
        return {f"[{shown(name)}]": {"of": name, kind_of(name): ends} for name, ends in named}
    return {f"[{k}]": each for k, each in enumerate(several(given))}


def parameters_of(names: Sequence[str], machine: Any) -> tuple[int, ...]:
    """Which entries of the machine's p are meant by `names`, as `Uncertainty.of` has them, ascending."""
    found = set[int]()
    for word in names:
        passive = _of_passive(machine, word) if word in (SPRINGS, DAMPERS) else set[str]()
        listed = enumerate(parameter.name for parameter in machine.parameters)
        found |= {k for k, name in listed if name == word or name in passive or fnmatchcase(name, word)}
    return tuple(sorted(found))


def told_numbers(machine: Any, p: Sequence[float]) -> str:
    """Those of p (n_par) that are not the machine's own, in words: of all springs or all dampers a common factor."""
    others = {own.name: (own, x) for own, x in zip(machine.parameters, p, strict=True) if own.value != x}
    told = list[str]()
    for word in (SPRINGS, DAMPERS):
        names = {own.name for own in machine.parameters if own.value} & _of_passive(machine, word)
        factors = [others[name][1] / others[name][0].value for name in names if name in others]
        if len(factors) == len(names) > 1 and max(factors) - min(factors) <= ALIKE * max(factors):
            told.append(f"{word} is {factors[0]:.4g} of the file's")
            others = {name: each for name, each in others.items() if name not in names}
    told += [f"{own.name} is {x:.4g} {own.unit}".rstrip() for own, x in others.values()]
    return listed(told) if told else ""


# What is taken where nothing is said of the ground: one factor of all springs. Built without the checks, whose schema
# would be made at every import.
GROUND = (Uncertainty.model_construct(of=(SPRINGS,), factor=(0.5, 2.0)),)


def _of_passive(machine: Any, word: str) -> set[str]:
    """Names of the parameters that are springs ("stiffness") or dampers ("damping") of passive coordinates."""
    tree = machine.kinematic_tree
    passive = {i for i, body in enumerate(tree.bodies) if body.joint.passive}
    found = set[str]()
    for key, name in tree.entries.items():
        places = key.removeprefix(word).split(".")
        if key.startswith(word) and all(int(place) in passive for place in places):
            found.add(name)
    return found


def uncertainty_faults(uncertainty: Sequence[Uncertainty], machine: Any, field: str = "uncertainty") -> list[Fault]:
    """What does not go together, or not with the machine."""
    faults, seen = list[Fault](), dict[int, Uncertainty]()
    values = [parameter.value for parameter in machine.parameters]
    if len(uncertainty) > UNCERTAIN_MAX:
        faults.append(Fault(field or "uncertainty", f"may have at most {UNCERTAIN_MAX} entries", str(len(uncertainty))))
    for k, each in enumerate(uncertainty):
        where = f"{field}[{k}]"
        faults += [Fault(f"{where}.{f.field}", f.sentence, f.value) for f in each.structural_faults()]
        if each.of == (LATE,):
            continue
        chosen = parameters_of(each.of, machine)
        for word in each.of:
            if not parameters_of((word,), machine):
                names = [*WORDS, *(parameter.name for parameter in machine.parameters)]
                faults.append(
                    Fault(f"{where}.of", f"{machine.name} has none such{hint_or_list(word, names, most=40)}", word)
                )
        # Factors of one parameter multiply each other, as a soil's and a spring's own.
        both = sorted({seen[i].name for i in chosen if i in seen and None in (seen[i].factor, each.factor)})
        if both:
            sentence = f"concerns parameters that {', '.join(both)} concerns, too; only factors go together"
            faults.append(Fault(f"{where}.of", sentence, each.name))
        seen |= dict.fromkeys(chosen, each)
        if each.value is not None and len(chosen) > 1:
            faults.append(Fault(f"{where}.value", f"goes with one parameter; give factor for {len(chosen)} of them"))
        if each.factor is not None and chosen and not any(values[i] for i in chosen):
            faults.append(Fault(f"{where}.factor", "multiplies 0; give value, (lower, upper)", each.name))
        if each.value is not None and len(chosen) == 1:
            parameter = machine.parameters[chosen[0]]
            low, high = parameter_range(parameter)
            if not (low <= each.value[0] and each.value[1] <= high):
                allowed = f"must lie between {low:g} and {high:g} {parameter.unit}".rstrip()
                faults.append(Fault(f"{where}.value", allowed, str(list(each.value))))
    return faults
