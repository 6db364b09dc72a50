"""Numbers of a machine that are allowed but hardly meant: in kN, mm, tonnes or degrees, about the pivot, placeholders.

In: a validated machine. Out: an `ImplausibleNumber` for each, with what was probably meant. The bounds are orders of
magnitude that hold for machines of any size: lengths against each other, inertia against length, weight against springs
and drives, mass against the square of the reach. `flexopt.robustness.plausibility` adds what needs the modes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from flexopt.errors import ImplausibleMachine
from flexopt.foundation.results import Result
from flexopt.foundation.warned import warn_user
from flexopt.model.body_numbers import ASIDE, BodyNumbers, body_numbers
from flexopt.model.machine import AnyMachine
from flexopt.model.planar import Machine
from flexopt.model.tree import Tree
from flexopt.model.uncertainty import LATE, Uncertainty, parameters_of

REACH_MAX = 100.0  # m: the longest booms are about as long
EVEN = 0.35  # radius of gyration over the length of a body whose mass lies along it; a rod's is 0.29
FAR = 10.0  # a centre of mass so many lengths away
LONGER = 100.0  # a length so many times the others' median
# A share of the reach: of a wrist, whose joints' axes meet, no length tells the size.
SMALL = 0.1
WIDE = 4.0  # radius of gyration over what is known of a body's size
MASS_PER_AREA = (0.7, 2e4)  # kg/m²: total mass over the square of the reach
SAG = 0.1  # of the reach, under the machine's own weight
TILT = 0.7  # rad, under its weight at full reach
PREFIXES = ((1e3, "k", "N/mm"), (1e6, "M", "kN/mm"))  # what stiffnesses may be in; per metre and per millimetre
WEAK = 0.01  # of the torque or force that holds the weight beyond a joint at full reach
TIP_SPEED_MAX = 100.0  # m/s
# Where uncertain numbers are given.
RANGE, WITHIN = "range", "constraints.within"
GRAVITY = (0.5, 30.0)  # m/s², where there is any
LIGHT = 0.01  # mass of the base over that of the arm that it carries
HEAVY = 10.0  # payload over the machine's own mass
CONCENTRATED = 0.03  # radius of gyration over a body's size in the plane
LIKELY = 0.1  # the same, of what a guess makes of a body; a ball's is 0.32 of its diameter
FLAT = 0.1  # height of the first joint over the base's length
BASE_MASS = ("base.mass", "mass of the base")  # the field's name, of planar machines and in space
ALIKE, UNLIKE = 3, 1.1  # bodies of one mass and inertia, and longest over shortest of these
LEVERS = 9  # lever arms of a cylinder, of which the longest counts
NAMED = 7  # of them, in a sentence
BEYOND = 1.5  # times the way to the next joint, from which on capsules say how large a body is
DISTANT = 10.0  # times that a range may lie away from the file's number


@dataclass(frozen=True)
class ImplausibleNumber(Result):
    """A number that is allowed but hardly meant.

    Attributes:
        field: where it stands, with the name of the link, body or joint.
        value: the number with its unit.
        sentence: why it is not plausible.
        meant: what was probably meant.
    """

    field: str
    value: str
    sentence: str
    meant: str

    def __str__(self) -> str:
        return f"{self.field} = {self.value}: {self.sentence}; {self.meant}"


def implausible_numbers(machine: AnyMachine) -> tuple[ImplausibleNumber, ...]:
    """Every number of the machine's file that is hardly meant, in the order of the bodies."""
    parts, reach = body_numbers(machine)
    lengths = [*_lengths(machine, parts, reach), *_volumes(machine, reach)]
    found = [*lengths, *_angles(parts)]
    if isinstance(machine, Machine):
        found += _lying(machine)
    if not lengths:
        # What follows compares with lengths.
        for part in parts:
            found += [
                *_inertia(part, reach, isinstance(machine, Machine)),
                *_springs(part, machine.gravity, reach),
                *_drives(part, machine, reach),
            ]
        found += [*_cylinders(machine, parts, reach), *_totals(machine, parts, reach), *_placeholders(parts)]
    if machine.gravity and not GRAVITY[0] < machine.gravity < GRAVITY[1]:
        found.append(
            ImplausibleNumber("gravity", f"{machine.gravity:g} m/s²", "is far from 9.81 m/s²", "in other units?")
        )
    return tuple(found)


def distant_ranges(
    machine: AnyMachine, known: Sequence[Uncertainty], field: str = RANGE
) -> Iterator[ImplausibleNumber]:
    """What of the uncertain numbers of a field lies far from the file's own: a value for a factor, or per cent."""
    for each in known:
        low, high = each.factor or each.value or (0.0, 0.0)
        chosen = () if each.of == (LATE,) else parameters_of(each.of, machine)
        own, unit = 1.0, ""
        if each.value is not None:
            parameter = machine.parameters[chosen[0]] if chosen else None
            own, unit = (parameter.value, f" {parameter.unit}") if parameter is not None else (0.0, "")
        near, ends = min(max(low, own), high), f"[{low:g}, {high:g}]"
        of_centre = any(".com." in name for name in each.of)
        if own == 0 or 1 / DISTANT < near / own < DISTANT or (of_centre and near / own <= 0):
            if of_centre and near != own:
                # Of robot files the frame is hardly the one that the range was measured in.
                sentence = f"does not contain the file's own number, {own:.4g}{unit}"
                meant = "it counts from the body's joint, of a root link from [base] point"
                yield ImplausibleNumber(f"{field} of {each.name}", f"{ends}{unit}", sentence, meant)
            continue
        meant = "is it in another unit?"
        if each.value is not None and low <= 1 <= high:
            meant = f"as a factor of it that would be [{low * own:g}, {high * own:g}]{unit}"
        elif each.factor is not None and low >= DISTANT:
            meant = f"probably in per cent: [{low / 100:g}, {high / 100:g}]"
        what = f"the file's own number, {own:.4g}{unit}" if each.value is not None else "1, the file's own number"
        yield ImplausibleNumber(f"{field} of {each.name}", f"{ends}{unit}", f"lies far from {what}", meant)


def warn_weightless(machine: AnyMachine, *, asked: bool) -> None:
    """Tell that gravity, where it is asked for, changes nothing: robot files for kinematics often have it at zero."""
    if asked and machine.gravity == 0:
        _tell_weightless(machine)


@lru_cache
def _tell_weightless(machine: AnyMachine) -> None:
    """Once for each machine: one call of the user's is made of many, in several threads."""
    sentence = "the file has gravity = 0 m/s², so that measures and motions under gravity are those without"
    warn_user(f"machine {machine.name!r}: {sentence}", ImplausibleMachine)


def _lying(machine: Machine) -> Iterator[ImplausibleNumber]:
    """A base that lies on the ground, as where its angle is from the vertical."""
    base, height = machine.base, machine.base.length * math.sin(machine.base.rest_angle)
    if base.length > 0.1 * sum(link.length for link in machine.links) and abs(height) < FLAT * base.length:
        sentence = f"the first joint lies {abs(height):.3g} m above the ground point and {base.length:.3g} m beside it"
        meant = f"it is from the horizontal: {math.pi / 2:.4f} is upright"
        yield ImplausibleNumber("base.rest_angle", f"{base.rest_angle:g} rad", sentence, meant)


def _lengths(machine: AnyMachine, parts: Sequence[BodyNumbers], reach: float) -> Iterator[ImplausibleNumber]:
    given = [part.length for part in parts if part.length > 0]
    for part in parts:
        lengths = sorted([length for length in given if length != part.length] or given or [0.0])
        others = (lengths[(len(lengths) - 1) // 2] + lengths[len(lengths) // 2]) / 2  # the median
        if len(given) > 1 and part.length > LONGER * others:
            yield ImplausibleNumber(
                part.reached,
                f"{part.length:g} m",
                f"is {part.length / others:.0f} times as long as the other bodies",
                f"probably in mm: {part.length / 1000:g} m",
            )
        # A body that carries nothing, or has the end-point in its joint, has no length to compare with.
        known = max(part.length, part.size)
        # Its inertia may say that it is as large as that: a rod ends √3 radii of gyration from its centre.
        large = part.com < min(reach, math.sqrt(3 * (part.variance + part.across)))
        if 0 < FAR * (max(known, 0.02 * reach) if known else reach) < part.com and not large:
            compared = f"{part.com / known:.0f} lengths" if known else f"{part.com / reach:.0f} times the arm's reach"
            across = isinstance(machine, Machine) and abs(part.aside) > abs(part.along)
            far = part.aside if across else part.com
            yield ImplausibleNumber(
                f"{part.where}.{'com_offset' if across else 'com'}",
                f"{far:g} m",
                f"the centre of mass lies {compared} away from the joint",
                f"probably in mm: {far / 1000:g} m",
            )
    if reach > REACH_MAX:
        longest = max(parts, key=lambda part: part.length)
        yield ImplausibleNumber(
            "end-point",
            f"up to {reach:.0f} m",
            f"machine {machine.name!r} reaches beyond {REACH_MAX:g} m, the longest step being {longest.reached}",
            "lengths are probably in mm, not m",
        )


def _volumes(machine: AnyMachine, reach: float) -> Iterator[ImplausibleNumber]:
    """Capsules, what the machine stands on and where its root link is, beyond many times the arm's reach."""
    capsules = [
        (f"capsules[{number}] of {c.called}, {key}", math.hypot(*numbers))
        for number, c in enumerate(machine.capsules)
        for key, numbers in (("start", c.start), ("end", c.end), ("radius", (c.radius,)))
    ]
    corners = [("support", math.hypot(*corner)) for corner in machine.support_points]
    root = machine.bodies[:1] if isinstance(machine, Tree) else ()
    placed = [("position of the root link", math.hypot(*body.position)) for body in root]
    for name, far in [*placed, *capsules, *sorted(corners, key=lambda corner: -corner[1])[:1]]:
        if far > FAR * reach > 0:
            yield ImplausibleNumber(
                name, f"{far:g} m", f"is {far / reach:.0f} times the arm's reach", f"probably in mm: {far / 1000:g} m"
            )


def _angles(parts: Sequence[BodyNumbers]) -> Iterator[ImplausibleNumber]:
    for part in parts:
        if part.hinge and part.limits is not None and max(map(abs, part.limits)) > 2 * math.pi + 0.01:
            low, high = part.limits
            yield ImplausibleNumber(
                f"{part.joint}.limits",
                f"[{low:g}, {high:g}] rad",
                "reach beyond a whole turn",
                f"probably degrees: [{math.radians(low):.4g}, {math.radians(high):.4g}] rad",
            )
        if part.rest is not None and abs(part.rest[1]) > math.pi + 0.01:
            yield ImplausibleNumber(
                part.rest[0],
                f"{part.rest[1]:g} rad",
                "is more than half a turn",
                f"probably degrees: {math.radians(part.rest[1]):.4g} rad",
            )


def _inertia(part: BodyNumbers, reach: float, planar: bool) -> Iterator[ImplausibleNumber]:
    if part.mass <= 0 or part.inertia <= 0:
        return
    # About the axis that it is largest about, wherever its length points.
    radius = math.sqrt(part.inertia / part.mass)
    given = f"{part.inertia:g} kg m² at {part.mass:g} kg"
    size = max(part.length, part.size, 2 * part.com)
    if not part.link:
        size = max(size, 0.25 * reach)
    # A slide has no pivot, and where its axis passes says nothing of where its mass is.
    # Nor does the next joint where capsules say that the body reaches far beyond it, as a mast with its sledge.
    # Nor where they say that it is as long as its radius of gyration asks for, as a beam held in its middle.
    spans = part.link and part.hinge and part.length > 0 and part.size < BEYOND * part.length
    spans = spans and radius > EVEN * part.extent
    if spans and part.across < part.variance / 3 and part.variance > _most_variance(part):
        words = (
            f"the radius of gyration, {radius:.3g} m, is beyond what a link of {part.length:.3g} m has, unless it is "
            "wider than it is long"
        )
        pivot = part.variance - part.along**2 - (part.aside**2 if part.across == 0 else 0.0)
        if pivot > (0.02 * part.length) ** 2 and radius < WIDE * size:
            # None has such moments about its centre: it is wide.
            if math.isnan(part.about_centre):
                return
            about_centre = f"about which it is some {part.about_centre:.3g} kg m²"
            meant = f"probably about the pivot, not the centre of mass, {about_centre}"
            yield ImplausibleNumber(f"{part.where}.inertia", given, words, meant)
            return
        yield ImplausibleNumber(f"{part.where}.inertia", given, words, _unit_of_inertia(part, radius, size))
    elif planar and radius < CONCENTRATED * max(part.length, part.com):
        # In space a vendor's file may have a dummy's inertia on purpose.
        words = f"the radius of gyration, {radius:.2g} m, is {radius / max(part.length, part.com):.1%} of the length"
        meant = f"the inertia is probably in t m²: {1000 * part.inertia:g} kg m²"
        yield ImplausibleNumber(f"{part.where}.inertia", given, words, meant)
    elif size > 0 and radius > max(WIDE * size, SMALL * reach):
        words = f"the radius of gyration, {radius:.3g} m, is {radius / size:.0f} times the size of the body"
        yield ImplausibleNumber(f"{part.where}.inertia", given, words, _unit_of_inertia(part, radius, size))


def _most_variance(part: BodyNumbers) -> float:
    """Of mass between the joints x = 0 and L with its centre at c: c (L − c); c² where it reaches beyond, to 2 c."""
    length, centre = part.length, part.along
    most = max(centre * (length - centre), length**2 / 6)
    if centre > 0:
        most = max(most, 1.1 * centre**2)
    return most + part.aside**2


def _unit_of_inertia(part: BodyNumbers, radius: float, size: float) -> str:
    """By which units the radius of gyration would fit a body of that size."""
    slips = (
        (1e3, f"the mass may be in tonnes, {1000 * part.mass:g} kg"),
        (1e4, f"the inertia in kg cm², {part.inertia / 1e4:g} kg m²"),
        (1e6, f"the inertia in kg mm², {part.inertia / 1e6:g} kg m²"),
    )
    share = 1.0 if not part.link else 0.6 if part.hinge else WIDE
    fit = [words for factor, words in slips if LIKELY * size < radius / math.sqrt(factor) < share * size]
    return ", or ".join(fit) if fit else "mass and inertia are probably in different units"


def _springs(part: BodyNumbers, gravity: float, reach: float) -> Iterator[ImplausibleNumber]:
    mass, moment = part.weight
    g = gravity or 9.81
    for name, (turns, stiffness, bears) in part.springs.items():
        unit, most = ("N m/rad", TILT) if turns else ("N/m", SAG * reach)
        give = bears * (moment if turns else mass) * g / stiffness
        if give > most:
            factor, prefix, per_mm = next((each for each in PREFIXES if give / each[0] <= most), PREFIXES[-1])
            hint = f"{prefix}{unit}" + ("" if turns else f" or {per_mm}")
            what = f"turns by {give:.3g} rad" if turns else f"gives by {give:.3g} m"
            # Weight holds what hangs: m g / l of ropes of length l.
            ropes = f" by ropes of some {mass * g / stiffness:.3g} m" * (not turns)
            hangs = f", unless it hangs{ropes}" * (turns or bears <= ASIDE)
            yield ImplausibleNumber(
                name,
                f"{stiffness:g} {unit}",
                f"the spring {what} under {_pushed(bears)}the {mass:.4g} kg that it carries",
                f"probably in {hint}: {factor * stiffness:g} {unit}{hangs}",
            )


def _pushed(bears: float) -> str:
    """How what a joint does not hold is told."""
    return f"a push of {100 * bears:.0f} % of " if bears <= ASIDE else ""


def _drives(part: BodyNumbers, machine: AnyMachine, reach: float) -> Iterator[ImplausibleNumber]:
    needed = _weight(part, machine)
    if part.effort < WEAK * needed:
        unit, far = ("N m", ", at its full reach") if part.hinge else ("N", "")
        yield ImplausibleNumber(
            f"{part.joint}.effort",
            f"{part.effort:g} {unit}",
            f"is little beside {_pushed(part.bears)}the weight that the joint carries, {needed:.3g} {unit}{far}",
            f"probably in k{unit}: {1000 * part.effort:g} {unit}",
        )
    tip = part.speed * (reach if part.hinge else 1.0)
    if math.isfinite(part.speed) and tip > TIP_SPEED_MAX:
        unit, meant = ("rad/s", "degrees") if part.hinge else ("m/s", "mm")
        speed = math.radians(part.speed) if part.hinge else part.speed / 1000
        yield ImplausibleNumber(
            f"{part.joint}.speed",
            f"{part.speed:g} {unit}",
            f"the end-point would move at up to {tip:.0f} m/s",
            f"probably in {meant}/s: {speed:.4g} {unit}",
        )


def _weight(part: BodyNumbers, machine: AnyMachine) -> float:
    """What the weight asks of the body's joint at its full reach, N m or N."""
    mass, moment = part.weight
    return part.bears * (moment if part.hinge else mass) * (machine.gravity or 9.81)


def _cylinders(machine: AnyMachine, parts: Sequence[BodyNumbers], reach: float) -> Iterator[ImplausibleNumber]:
    """Forces and speeds of cylinders, by the longest lever arm that they have on the way of their joint."""
    of_joint = {part.driven: part for part in parts if part.driven}
    for k, (cylinder, (ends, _)) in enumerate(zip(machine.cylinders, machine.stroke_ranges, strict=True)):
        part, where = of_joint[cylinder.joint], f"cylinders[{k}] ({cylinder.name})"
        lever = float(np.nanmax(np.abs(machine.travel(cylinder).ratios(np.linspace(*ends, LEVERS)))))
        force, speed = max(cylinder.force or (math.inf,)), max(cylinder.speed)
        needed = _weight(part, machine) / lever
        if force < WEAK * needed:
            yield ImplausibleNumber(
                f"{where}.force",
                f"{force:g} N",
                f"is little beside {_pushed(part.bears)}what the joint carries, {needed:.3g} N at its full reach",
                f"probably in kN: {1000 * force:g} N",
            )
        beyond = max(path + max(carried.length, carried.com) for carried, path in part.outward())
        tip = speed / lever * (min(beyond, reach) if part.hinge else 1.0)
        if tip > TIP_SPEED_MAX:
            yield ImplausibleNumber(
                f"{where}.speed",
                f"{speed:g} m/s",
                f"the end-point would move at up to {tip:.0f} m/s",
                f"probably in mm/s: {speed / 1000:.4g} m/s",
            )


def _totals(machine: AnyMachine, parts: Sequence[BodyNumbers], reach: float) -> Iterator[ImplausibleNumber]:
    payload = next(p.value for p in machine.parameters if p.name == "payload.mass")
    total = sum(part.mass for part in parts)
    low, high = (bound * reach**2 for bound in MASS_PER_AREA)
    if 0 < total < low:
        meant = f"probably in tonnes: {1000 * total:g} kg"
        yield ImplausibleNumber(
            "mass", f"{total:g} kg in all", f"is little for a machine that reaches {reach:.3g} m", meant
        )
    if total > high:
        meant = f"probably in g: {total / 1000:g} kg"
        yield ImplausibleNumber(
            "mass", f"{total:g} kg in all", f"is much for a machine that reaches {reach:.3g} m", meant
        )
    base, arm = (sum(part.mass for part in parts if part.link is link) for link in (False, True))
    if 0 < base < LIGHT * arm and any(part.springs for part in parts if not part.link):
        yield ImplausibleNumber(
            BASE_MASS[not isinstance(machine, Machine)],
            f"{base:g} kg",
            f"is little for what carries an arm of {arm:.4g} kg",
            f"probably in tonnes, {1000 * base:g} kg, or an arm's foot without the vehicle under it",
        )
    if payload > HEAVY * total > 0:
        meant = f"probably in g: {payload / 1000:g} kg"
        yield ImplausibleNumber(
            "payload.mass", f"{payload:g} kg", f"is {payload / total:.0f} times the machine's mass", meant
        )


def _placeholders(parts: Sequence[BodyNumbers]) -> Iterator[ImplausibleNumber]:
    """Bodies that carry one another and have one mass and inertia, though one is longer than another.

    Legs, wheels and fingers beside each other are alike in earnest, and so are a snake's modules, which are as long.
    """
    above = {id(child): part for part in parts for child in part.children}
    found: dict[tuple[str, ...], list[BodyNumbers]] = {}
    for part in parts:
        alike, at = list[BodyNumbers](), part
        while at is not None:
            if at.same == part.same:
                alike.append(at)
            at = above.get(id(at))
        if part.mass > 0 and len(alike) > len(found.get(part.same, ())):
            found[part.same] = alike[::-1]
    for alike in found.values():
        lengths = [part.length for part in alike if part.length > 0]
        if len(alike) < ALIKE or not lengths or max(lengths) < UNLIKE * min(lengths):
            continue
        more = f" and {len(alike) - NAMED} more" if len(alike) > NAMED else ""
        yield ImplausibleNumber(
            "mass and inertia",
            f"{alike[0].mass:g} kg and {alike[0].inertia:g} kg m²",
            f"are exactly the same of {', '.join(part.where for part in alike[:NAMED])}{more}, which are "
            f"{min(lengths):.3g} to {max(lengths):.3g} m long",
            "probably placeholders: modes and loads are those of other machines until the file has measured ones",
        )
