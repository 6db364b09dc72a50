"""Tables of machines: payload, capsules around bodies, what pictures draw of them, what the undercarriage stands on."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from flexopt.foundation.quantities import OFFSET, Length, MassOrZero, pair, vector
from flexopt.model.file_model import FileModel
from flexopt.model.polygons import check_convex_polygon
from flexopt.model.tree_quantities import UNTURNED, Matrix3, Point3, check_matrix

# On a body, in its axes.
BodyPoint = Annotated[
    tuple[float, ...],
    vector("numbers in m: [along, left] in the plane, [x, y, z] in space", OFFSET, ("along", "left"), "xyz"),
]


class Payload(FileModel):
    """A point mass at the end-point.

    Attributes:
        mass: of the point mass, kg.
    """

    mass: MassOrZero = 0.0


class Capsule(FileModel):
    """All points within `radius`, m, of the segment from `start` to `end`: a volume that a body fills.

    The ends are in m, in the body's axes: in the plane (2,), along the body and to its left, from the joint that
    carries it (body `"base"`: from the ground point); in space (3,), in the body's frame. Equal ends make a ball.

    Attributes:
        body: that the capsule moves with: `"base"` or a link's name.
        start: one end of the segment, m, in the body's axes.
        end: its other end; equal ends make a ball.
        radius: around the segment, m.
        label: what constraints call it; the body's name where left out.
    """

    body: str = Field(min_length=1)
    start: BodyPoint
    end: BodyPoint
    radius: Length
    label: str = ""

    @property
    def called(self) -> str:
        """What constraints call it: in space the link that has it, whatever body that is merged into."""
        return self.label or self.body


class Visual(FileModel):
    """What a picture draws of a body in space: a mesh from a file, or a shape. No number depends on it.

    A point v of it lies at `matrix` v + `position` in the body's frame. Shapes are of unit size about their origin.

    Attributes:
        body: that it moves with; the anchor frame where none is given.
        shape: `"mesh"`, `"box"` (edges of 2 m), `"sphere"` (radius 1 m) or `"cylinder"` (radius 1 m, z from −1 to 1 m).
        file: of a mesh, STL, OBJ or COLLADA.
        matrix: what turns and scales it, three rows.
        position: of its origin, m, in the body's frame.
        why: it cannot be drawn, where it cannot.
    """

    body: str | None = None
    shape: Literal["mesh", "box", "sphere", "cylinder"] = "mesh"
    file: str = ""
    matrix: Annotated[Matrix3, check_matrix] = UNTURNED
    position: Point3 = (0.0, 0.0, 0.0)
    why: str = ""


class Span(FileModel):
    """The two ends of what an undercarriage stands on in the plane: [rear, front], m, in the anchor frame.

    Attributes:
        span: [rear, front], in the anchor frame.
    """

    span: Annotated[tuple[float, float], pair(OFFSET)]


class Polygon(FileModel):
    """Corners (x, y), m, in the anchor frame, of the convex polygon that an undercarriage stands on.

    They are kept counter-clockwise seen from above, whichever way they were given.

    Attributes:
        polygon: corners [x, y] of a convex polygon, seen from above, in the anchor frame.
    """

    polygon: Annotated[tuple[tuple[float, float], ...], check_convex_polygon]
