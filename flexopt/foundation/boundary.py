"""The one boundary: what public calls take is checked here, by the argument's name, before anything runs.

`TABLE` says for each name what it must be: type, shape, range, unit. `public` puts a function behind it: every argument
is checked, all faults come in one `InputError`, and the function gets plain values (float, tuple, array, word). A name
that the table lacks needs a check at the function, or its module cannot be imported.
"""

from __future__ import annotations

import inspect
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Container, Mapping, Sequence
from functools import partial, wraps
from pathlib import Path
from typing import Any, NamedTuple, ParamSpec, TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from flexopt.errors import Fault, InputError
from flexopt.foundation.arguments import Arguments, Coordinates
from flexopt.foundation.nearest import hint
from flexopt.foundation.plain import plain, plain_table, shown
from flexopt.foundation.quantities import Quantity, numbers_in, whole_number
from flexopt.foundation.turns import in_turn

P = ParamSpec("P")
T = TypeVar("T")
C = TypeVar("C", bound=type[Any])
# Takes the collector of the call's faults, the argument's name and its value; gives the checked value.
ArgumentCheck = Callable[[Arguments, str, Any], Any]
# Sees the checked values of a call, None in place of the faulty ones; notes what does not go together.
Together = Callable[[Arguments, Mapping[str, Any]], None]

WORKERS_MAX = 1024
# Of names in a path and of whole paths, bytes: what common file systems hold.
NAME_MAX, PATH_MAX = 255, 4095
TEXT_MAX = 5000
PICTURES = (".png", ".svg", ".pdf")


def by(check: Callable[[Any], Any]) -> ArgumentCheck:
    """A function that returns the value or raises `ValueError` with the sentence."""
    return lambda arguments, field, value: arguments.checked(field, value, check, None)


def number(unit: str, *, above: float | None = None, low: float | None = None, high: float) -> ArgumentCheck:
    """A number in a range."""
    return by(Quantity(unit, above=above, low=low, high=high))


def whole(low: int, high: int) -> ArgumentCheck:
    """A whole number in a range."""
    return by(whole_number(low, high))


def numbers(unit: str, *, above: float | None = None, low: float | None = None, high: float) -> ArgumentCheck:
    """One number or several in a range."""
    return by(numbers_in(Quantity(unit, above=above, low=low, high=high)))


def words(*valid: Any) -> ArgumentCheck:
    """One of a few words."""
    return lambda arguments, field, value: arguments.choice(field, value, valid)


def instance(kinds: type | tuple[type, ...], sentence: str) -> ArgumentCheck:
    """An object of a class; `sentence` says of which and where one comes from."""

    def check(arguments: Arguments, field: str, value: Any) -> Any:
        if not isinstance(value, kinds):
            arguments.note(field, f"must be {sentence}", value)
        return value

    return check


def anything(_arguments: Arguments, _field: str, value: Any) -> Any:
    """What the call itself checks with others, in a table of its own, and says so."""
    return value


def table(arguments: Arguments, field: str, value: Any) -> Any:
    """A dictionary of plain data."""
    read = plain_table(value)
    if not isinstance(read, dict):
        arguments.note(field, "must be a dictionary", value)
    return cast(Any, read)


def callback(arguments: Arguments, field: str, value: Any) -> Any:
    """A function of two numbers, done and in all."""
    try:
        fits = callable(value) and not isinstance(value, type) and bool(inspect.signature(value).bind(0, 1))
    except TypeError:  # it takes others
        fits = False
    except ValueError:  # built in, its arguments unknown
        fits = True
    if not fits:
        arguments.note(field, "must be a function of two numbers, (done, in all)", value)
    return value


def of_machine(check: Callable[[Arguments, Any, str, Any], Any]) -> ArgumentCheck:
    """A check that asks the machine of the call; where there is no usable one, its fault is enough."""

    def asked(arguments: Arguments, field: str, value: Any) -> Any:
        return None if arguments.of is None else check(arguments, arguments.of, field, value)

    return asked


def array_of(*shapes: tuple[int | str, ...], unit: str = "", kinds: str = "iuf", finite: bool = True) -> ArgumentCheck:
    """Numbers in one of some shapes; a word in a shape is one of `Arguments.sizes`, or stands for any length."""

    def check(sizes: Mapping[str, int], value: Any) -> NDArray[Any]:
        found = as_array(value, kinds)
        known = [tuple(sizes.get(size, size) if isinstance(size, str) else size for size in shape) for shape in shapes]
        if not any(len(shape) == found.ndim and _fits(shape, found.shape) for shape in known):
            wanted = " or ".join(shape_text(shape) for shape in known)
            raise ValueError(f"must have the shape {wanted}, not {shape_text(found.shape)}")
        if finite and not np.all(np.isfinite(found)):
            at = ", ".join(map(str, np.argwhere(~np.isfinite(found))[0]))
            raise ValueError(f"must be finite, but is not at [{at}]" + (f"; in {unit}" if unit else ""))
        return found

    return lambda arguments, field, value: raw(arguments, field, value, partial(check, arguments.sizes))


def raw(arguments: Arguments, field: str, value: Any, check: Callable[[Any], T]) -> T | None:
    """As `Arguments.checked`, for large arrays: the value is taken as it is."""
    try:
        return check(value)
    except ValueError as error:
        arguments.note(field, str(error), value)
        return None


def as_array(value: Any, kinds: str = "iuf") -> NDArray[Any]:
    """Floating-point numbers, or complex ones where `kinds` allows them, from an array or from lists.

    Raises:
        ValueError: ragged, masked, no numbers, or too large for a double; the sentence says which.
    """
    given = cast(Any, value if isinstance(value, np.ndarray | np.generic) else plain(value))
    if np.ma.isMaskedArray(given):
        raise ValueError("must not be masked")
    try:
        found: NDArray[Any] = np.asarray(given)
    except ValueError:
        raise ValueError("must be numbers, as many in each row") from None
    except Exception as error:  # noqa: BLE001, RUF100  # a foreign object's own conversion raises whatever it likes
        raise ValueError(f"must be numbers; it cannot be read ({type(error).__name__})") from None
    if found.dtype.kind == "O" and all(type(part) is int for part in found.ravel()):
        raise ValueError("must be numbers that fit into double precision")
    if found.dtype.kind not in kinds:
        raise ValueError("must be numbers" + ("" if "c" in kinds else ", real ones"))
    return found.astype(complex if "c" in kinds else float, copy=False)


def _fits(shape: tuple[int | str, ...], found: tuple[int, ...]) -> bool:
    return all(isinstance(wanted, str) or wanted == size for wanted, size in zip(shape, found, strict=True))


def shape_text(shape: Sequence[int | str]) -> str:
    """A shape as it is written in messages."""
    return "(" + ", ".join(map(str, shape)) + ("," if len(shape) == 1 else "") + ")"


def check_text(value: Any) -> str:
    """Some text, of a length that messages can hold."""
    if not isinstance(value, str) or len(value) > TEXT_MAX:
        raise ValueError(f"must be text of at most {TEXT_MAX} letters")
    return value


def path(*suffixes: str, parent: bool = False, limited: bool = True) -> ArgumentCheck:
    """The name of a file or folder, text or `os.PathLike`.

    Args:
        suffixes: it ends in one of them.
        parent: it is a file to be written, in a folder that is there.
        limited: it is as long as file systems allow at most.
    """

    def check(value: Any) -> Any:
        try:
            text: Any = os.fspath(cast("os.PathLike[str]", value)) if isinstance(value, str | os.PathLike) else None
        except Exception:  # noqa: BLE001, RUF100  # somebody else's __fspath__
            text = None
        if not isinstance(text, str):
            raise ValueError("must be a path, text or os.PathLike")
        try:
            bytes_of = os.fsencode(text)
        except UnicodeEncodeError:
            bytes_of = b""
        if not bytes_of.strip() or b"\0" in bytes_of:
            raise ValueError("is empty or an unusable name; a path is wanted")
        longest = max(map(len, bytes_of.replace(b"\\", b"/").split(b"/")))
        if limited and (len(bytes_of) > PATH_MAX or longest > NAME_MAX):
            raise ValueError(f"is too long for a path: at most {PATH_MAX} bytes, {NAME_MAX} in each name")
        if suffixes and Path(text).suffix.lower() not in suffixes:
            raise ValueError("must end in " + ", ".join(suffixes))
        if parent and not Path(text).parent.is_dir():
            raise ValueError(f"there is no folder {str(Path(text).parent)!r} to write a file into")
        if parent and Path(text).is_dir():
            raise ValueError("is a folder")
        return cast(Any, value)

    return lambda arguments, field, value: raw(arguments, field, value, check)


class Bundle(ABC):
    """Several arguments in one object, which a public call takes in place of its first argument, `machine`."""

    @property
    @abstractmethod
    def arguments(self) -> Mapping[str, Any]:
        """The arguments by name, `machine` among them; None and False where nothing is said."""


def _opened(bundle: Bundle, names: Container[str], given: Mapping[str, Any]) -> tuple[dict[str, Any], list[Fault]]:
    """Return the arguments of a call of these names, `given` among them, and what does not go together."""
    faults, found = list[Fault](), dict(given)
    for name, value in bundle.arguments.items():
        said = value is not None and value is not False
        if name in given:
            faults.append(Fault(name, "is part of the configuration", shown(given[name])))
        elif name in names:
            found |= {} if value is None else {name: value}
        elif said:
            faults.append(Fault(name, "of the configuration is not used by this call", shown(value)))
    return found, faults


flag = words(False, True)

# Rooms that know more names add them (`model/boundary.py`: machines and problems).
TABLE: dict[str, ArgumentCheck] = {
    "data": anything,  # `faults.read_table` and `faults.validated` name every fault by its key
    "posture": of_machine(lambda a, machine, field, value: a.posture(machine, value, field)),
    "base": of_machine(lambda a, machine, field, value: a.base(machine, value, field)),
    "start": of_machine(lambda a, machine, field, value: a.base(machine, value, field)),
    "target": of_machine(lambda a, machine, field, value: a.point(value, field, machine)),
    "control": lambda a, _, value: a.control(value),
    "damped": flag,
    "baked": flag,
    "overwrite": flag,
    "gradient": flag,
    "strict": flag,
    "quick": flag,
    "workers": whole(1, WORKERS_MAX),
    "threads": whole(1, WORKERS_MAX),
    "progress": callback,
    "origin": by(check_text),
    "path": path(*PICTURES),
    "folder": path(),
    "name_or_path": path(limited=False),  # a long one is answered with the names that there are
}


class Keywords(NamedTuple):
    """Keywords of a call that are fields of an options object, too: `**keywords` in its signature stands for them.

    Attributes:
        kind: of the options object.
        types: the keywords and their types, a `TypedDict`.
        together: the call checks them together, and takes None for one that is left out.
    """

    kind: type[BaseModel]
    types: type
    together: bool = False

    def spelt_out(self, signature: inspect.Signature) -> inspect.Signature:
        """The signature with a parameter for each keyword."""
        # As they are written, so that signatures stay short.
        fields, types = self.kind.model_fields, _written(self.types)
        word, variable = inspect.Parameter.KEYWORD_ONLY, inspect.Parameter.VAR_KEYWORD
        each = [
            inspect.Parameter(name, word, default=None if self.together else field.default, annotation=types[name])
            for name, field in fields.items()
            if name in types
        ]
        others = [parameter for parameter in signature.parameters.values() if parameter.kind is not variable]
        first = next(k for k, parameter in enumerate(others) if parameter.kind is word)
        return signature.replace(parameters=[*others[:first], *each, *others[first:]])

    @property
    def checks(self) -> dict[str, ArgumentCheck]:
        """Checks of single arguments, in place of the table's."""
        return dict.fromkeys(("options", *(self.kind.model_fields if self.together else ())), anything)

    def spread(self, arguments: Arguments, given: dict[str, Any], names: Container[str]) -> None:
        """What the argument `options` holds becomes arguments of those names, except what is given by itself."""
        options = given.pop("options", None)
        if options is None:
            return
        if not isinstance(options, self.kind):
            arguments.note("options", f"must be {self.kind.__name__}", options)
            return
        for name in sorted(options.model_fields_set):
            value = getattr(options, name)
            if name not in names:
                arguments.note(f"options.{name}", "is no option of this call", value)
            elif name not in given or (self.together and given[name] is None):
                given[name] = value


def _written(types: type) -> dict[str, str]:
    """The annotations of a `TypedDict`, as text."""
    found = inspect.get_annotations(types)
    return {name: getattr(hint, "__forward_arg__", None) or str(hint) for name, hint in found.items()}


def public(
    call: str = "",
    /,
    *,
    together: Together | None = None,
    machine: Callable[[Any], Coordinates] | None = None,
    sizes: Callable[[Any], Mapping[str, int]] | None = None,
    error: type[InputError] = InputError,
    checks: Mapping[str, ArgumentCheck] | None = None,
    keywords: Keywords | None = None,
    turn: bool = True,
    **own: ArgumentCheck,
) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """A function whose arguments are checked before it runs.

    An argument left out, or None where None is its default, is not checked.

    Args:
        call: what messages call it; its own name by default.
        together: notes what concerns several arguments; looked for even where single ones are faulty.
        machine: of a method, the machine of its object.
        sizes: what letters in shapes stand for, from a method's object or a function's first argument.
        error: what is raised.
        checks, own: of arguments, in place of the table's.
        keywords: those that the function takes as `**keywords`, and as fields of its argument `options`.
        turn: whether it computes, and so holds the turn of threads; else it waits for others that compute.
    """

    def decorate(function: Callable[P, T]) -> Callable[P, T]:
        signature = inspect.signature(function)
        signature = signature if keywords is None else keywords.spelt_out(signature)
        heading, parameters = call or function.__name__, dict(signature.parameters)
        owner = parameters.pop("self", None)
        first = next(iter(parameters), "")
        table = {**({} if keywords is None else keywords.checks), **(checks or {}), **own}
        each = {name: table[name] if name in table else TABLE[name] for name in parameters}

        def examined(*args: P.args, **kwargs: P.kwargs) -> tuple[Arguments, inspect.BoundArguments]:
            twice = list[Fault]()
            if args and isinstance(bundle := args[0], Bundle) and first == "machine":
                opened, twice = _opened(bundle, parameters, kwargs)
                args, kwargs = cast(Any, ((opened.pop("machine"), *args[1:]), opened))
            try:
                bound = signature.bind(*args, **kwargs)
            except TypeError as miscall:
                raise _miscalled(heading, list(parameters), kwargs, miscall) from None
            given, values = bound.arguments, dict[str, Any]()
            arguments = Arguments(heading, machine(given["self"]) if machine is not None else None, error)
            arguments.faults += twice
            if sizes is not None and owner is not None:
                arguments.sizes = sizes(given["self"])
            if keywords is not None:
                keywords.spread(arguments, given, parameters)
            for name, check in each.items():
                default = parameters[name].default
                if name not in given or (given[name] is None and default is None):
                    values[name] = {} if parameters[name].kind is parameters[name].VAR_KEYWORD else default
                    continue
                noted = len(arguments.faults)
                values[name] = check(arguments, name, given[name])
                if len(arguments.faults) > noted:
                    values[name] = None
                else:
                    given[name] = values[name]
                    if sizes is not None and owner is None and name == first:
                        arguments.sizes = sizes(values[name])
            if together is not None:
                together(arguments, values | ({"self": given["self"]} if owner is not None else {}))
            return arguments, bound

        @wraps(function)
        def checked(*args: P.args, **kwargs: P.kwargs) -> T:
            arguments, bound = examined(*args, **kwargs)
            arguments.done()
            return function(*bound.args, **bound.kwargs)

        def faults(*args: P.args, **kwargs: P.kwargs) -> list[Fault]:
            return examined(*args, **kwargs)[0].faults

        known = in_turn(checked) if turn else checked
        cast(Any, known).__signature__ = signature
        cast(Any, known).faults = in_turn(faults)
        return known

    return decorate


def faults_of(call: Callable[P, Any], *args: P.args, **kwargs: P.kwargs) -> list[Fault]:
    """What a public function would refuse of these arguments, without running it."""
    return cast(Any, call).faults(*args, **kwargs)


def public_class(**own: ArgumentCheck) -> Callable[[C], C]:
    """A class that users make objects of, its constructor behind the boundary."""

    def decorate(made: C) -> C:
        kind = cast(Any, made)
        kind.__init__ = public(made.__name__, checks=own)(kind.__init__)
        return made

    return decorate


def _miscalled(call: str, names: list[str], given: Mapping[str, Any], error: TypeError) -> InputError:
    """Arguments that are missing, or that there are none of."""
    faults: list[Fault] = []
    for name in given:
        if name not in names:
            meant = hint(name, names, f"; valid: {', '.join(names) or 'none'}")
            faults.append(Fault(name, f"unknown argument{meant}", shown(given[name])))
    faults = faults or [Fault("arguments", str(error))]
    listed = "; ".join(str(fault) for fault in faults)
    return InputError(f"{call}: {listed}", faults, call)
