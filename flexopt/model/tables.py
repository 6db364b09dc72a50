"""Tables that machines of both kinds have: payload, capsules around bodies, what the undercarriage stands on."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from flexopt.errors import Fault, InputError, raise_if_any
from flexopt.foundation.plain import plain_table
from flexopt.foundation.quantities import Length, MassOrZero, checked
from flexopt.model.table_quantities import check_place, check_polygon, check_span


class FileModel(BaseModel):
    """Common to every table of a file: closed (no unknown key), frozen, strict."""

    # Built when first used: a process that reads a machine needs no schema of problems.
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, defer_build=True)


class BuiltByCall(FileModel):
    """A table that users also build by a call, whose faults come in flexopt's own words."""

    def __init__(self, **data: Any) -> None:
        from flexopt.model.faults import model_faults  # noqa: PLC0415  (which knows these tables)

        table = plain_table(data)
        try:
            super().__init__(**table)
        except ValidationError as error:
            raise_if_any(InputError, type(self).__name__, model_faults(type(self), table, error))
            raise
        raise_if_any(InputError, type(self).__name__, self.structural_faults())

    # Pydantic then validates nested tables without it: their faults are the outer table's.
    __init__.__pydantic_base_init__ = True  # pyright: ignore[reportFunctionMemberAccess]

    def structural_faults(self) -> list[Fault]:
        """What does not fit together."""
        return []


class Payload(FileModel):
    """A point mass at the end-point."""

    mass: MassOrZero = 0.0


class Capsule(FileModel):
    """All points within `radius`, m, of the segment from `start` to `end`: a volume that a body fills.

    The ends are in m, in the body's axes: in the plane (2,), along the body and to its left, from the joint that
    carries it (body `"base"`: from the ground point); in space (3,), in the body's frame. Equal ends make a ball.
    """

    body: str = Field(min_length=1)
    start: Annotated[tuple[float, ...], checked(check_place)]
    end: Annotated[tuple[float, ...], checked(check_place)]
    radius: Length


class Span(FileModel):
    """The two ends of what an undercarriage stands on in the plane: [rear, front], m, in the anchor frame."""

    span: Annotated[tuple[float, float], checked(check_span)]


class Polygon(FileModel):
    """Corners (x, y), m, in the anchor frame, of the convex polygon that an undercarriage stands on.

    They are kept counter-clockwise seen from above, whichever way they were given.
    """

    polygon: Annotated[tuple[tuple[float, float], ...], checked(check_polygon)]
