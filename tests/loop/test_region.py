"""What is guaranteed of uncertain loops, beside eigenvalues of the exact sampled loop computed by other programs."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import flexopt
from flexopt.foundation.arrays import Vector
from flexopt.loop.beside_decay import BesideDecay
from flexopt.loop.certified import characteristic_cells
from flexopt.loop.certified.bernstein import bernstein
from flexopt.loop.certified.certificate import DECAY, RegionProof, certified_radius, certify
from flexopt.loop.certified.characteristic import Characteristic
from flexopt.loop.certified.characteristic_cells import cells_of
from flexopt.loop.evaluation import outcome, settings_at
from flexopt.loop.gains import rigid_gains
from flexopt.loop.spectrum import drifting_self_motion
from flexopt.loop.uncertain import UncertainLoop
from flexopt.loop.uncertainty_box import UncertaintyBox
from flexopt.model.loop import Loop
from flexopt.model.uncertainty import Uncertainty
from tests.oracles.machines import NumpySource, Structure, draw_machine
from tests.oracles.sampled_loop import multipliers

EXCAVATOR, B = flexopt.load("excavator"), np.array((0.0448, -2.0499))
GAINS = {"kp": 1e4, "kv": 1e3}
SPRINGS = [{"of": f"base.stiffness.{name}", "factor": (0.5, 2.0)} for name in ("x", "y", "rotation")]
REDUNDANT = {
    "boom-stick-bucket": (-1.2, -1.5, -0.8), "slewing-excavator": (0.2, 0.5, -1.2, -0.5),
    "truck-crane": (0.3, 0.9, -1.1, 2.5),
}  # fmt: skip
PAYLOAD, LATE = {"of": "payload.mass", "value": (0.0, 50.0)}, {"of": "dead_time", "value": (0.005, 0.009)}
SOFT = Uncertainty(of="stiffness", factor=(0.5, 2.0))
# Of an arm that its weight lets drift.
DRIFTS: dict[str, Any] = {
    "drive": "torque",
    "rate": 200.0,
    "kp": 5.42e5,
    "kv": 3.6e5,
    "nullspace_damping": 200.0,
    "dead_time": 0.0,
}


def uncertain(ranges: list[dict[str, Any]], machine: Any = EXCAVATOR, posture: Any = B, **loop: float) -> UncertainLoop:
    known = tuple(Uncertainty(**each) for each in ranges)
    found = outcome(machine, posture, loop=GAINS | loop).settings
    box = UncertaintyBox(machine, known, found.dead_time)
    return UncertainLoop(found, np.zeros(len(machine.base_coordinates)), np.asarray(posture), False, box)


def wrong(loop: UncertainLoop, proof: RegionProof, samples: int = 200) -> int:
    """Samples in proven leaves that are not as proven."""
    k, found = len(loop.box.uncertainty), 0
    u = np.random.default_rng(1).uniform(size=(samples, k))
    # Corners of leaves are the hardest points.
    u = np.concatenate([u, *(np.array([leaf.low, leaf.high]) for leaf in proof.leaves[:50])])
    decays = loop.decays(u)
    for leaf in proof.leaves:
        here = np.all((u > leaf.low - 1e-15) & (u < leaf.high + 1e-15), axis=1)
        found += 0 if leaf.decays is None else int(np.sum((decays[here] > DECAY) != leaf.decays))
    return found


def characteristic(ranges: list[dict[str, Any]], **loop: float) -> Characteristic:
    return over_whole(uncertain(ranges, **loop))


def over_whole(loop: UncertainLoop) -> Characteristic:
    k = len(loop.box.uncertainty)
    return Characteristic(loop, loop.box.theta(np.zeros(k)), loop.box.theta(np.ones(k)), 1e-6)


def redundant(name: str, *, braked: bool) -> UncertainLoop:
    """A shipped machine with more joints than task rows, torque-served or by levers, which brake its joints."""
    machine, posture = flexopt.load(name), REDUNDANT[name]
    gains = rigid_gains(machine, flexopt.evaluate(machine, posture), 400.0)
    loop: dict[str, Any] = {} if braked else {"kp": gains["kp"], "kv": gains["kv"], "rate": 400.0}
    found = outcome(machine, posture, loop=loop).settings
    box = UncertaintyBox(machine, (Uncertainty(of="stiffness", factor=(0.8, 1.25)),), found.dead_time)
    return UncertainLoop(found, np.zeros(len(machine.base_coordinates)), np.asarray(posture), False, box)


def exact(of: Characteristic, s: complex, theta: np.ndarray) -> complex:
    """det(z − Φ) of the loop's own sample over what makes it p: by eigenvalues, none of the certificate's code."""
    p, late = of.loop.box.numbers_at(theta)
    point = of.loop.settings.outcome(
        of.loop.box.machine, of.loop.base, of.loop.posture, gravity=False, parameters=p, dead_time=late
    )
    z = np.exp(s * point.period)
    free, closed = np.linalg.eigvals(point.parts.flow), np.linalg.eigvals(point.sample.matrix)
    waiting = point.sample.waiting[0] * len(point.parts.force)
    ratio = np.prod(z - closed) / z**waiting
    neutral, unbraked = of.neutral[0].shape[1], of.neutral[1]
    return complex(ratio * np.prod((s - free) / (z - np.exp(free * point.period))) / s ** (neutral + unbraked))


@pytest.mark.parametrize("loop", [{}, {"dead_time": 0.0123}, {"filter_hz": 25.0}, {"bandwidth_hz": 15.0}])
def test_the_characteristic_function_is_that_of_the_sampled_loop(loop: dict[str, float]) -> None:
    """Between members and frequencies it changes as the product over the sampled loop's eigenvalues does."""
    of = characteristic(SPRINGS[:2], **loop)
    rng, found = np.random.default_rng(3), []
    for _ in range(6):
        omega, theta = np.array([rng.uniform(3.0, 600.0)]), rng.uniform(0.5, 2.0, size=2)
        [(machines, ports), _] = of.seen(theta[None, None])
        # Aliases of this very member.
        here = Characteristic(of.loop, theta, theta, of.decay)
        s = 1j * omega - of.decay
        pencil = characteristic_cells._pencil(of, machines, ports, s, here.aliases.at(omega))
        value = complex(np.linalg.det(pencil)[0, 0, 0])
        found.append(value / exact(of, complex(s[0]), theta))
    # Scaled by |det Φ_modes|², the same for all.
    assert np.array(found) == pytest.approx(found[0], rel=1e-8)


@pytest.mark.long("slewing-excavator-False", "slewing-excavator-True", "truck-crane-True")
@pytest.mark.parametrize(
    ("name", "braked"),
    [("boom-stick-bucket", False), ("slewing-excavator", False), ("slewing-excavator", True), ("truck-crane", True)],
)
def test_self_motions_are_divided_out_exactly(name: str, braked: bool) -> None:
    """As above, over as many s as the sampled loop has neutral eigenvalues; and what is proven of such arms holds."""
    loop = redundant(name, braked=braked)
    of, rng, found = over_whole(loop), np.random.default_rng(3), []
    directions, unbraked = of.neutral
    assert directions.shape[1] == loop.posture.size - len(loop.settings.kp)
    assert unbraked == (0 if braked else directions.shape[1])
    for _ in range(5):
        omega, theta = np.array([rng.uniform(3.0, 0.8 * of.nyquist)]), rng.uniform(0.8, 1.25, size=1)
        [(machines, ports), _] = of.seen(theta[None, None])
        here = Characteristic(of.loop, theta, theta, of.decay)
        s = 1j * omega - of.decay
        pencil = characteristic_cells._pencil(of, machines, ports, s, here.aliases.at(omega))
        sign, size = np.linalg.slogdet(pencil)
        value = exact(of, complex(s[0]), theta)
        found.append((sign[0, 0, 0] * abs(value) / value, size[0, 0, 0] - np.log(abs(value))))
    turns, sizes = zip(*found, strict=True)
    # Of some twenty states, free poles at zero among them, eigenvalues hold fewer digits.
    assert np.array(turns) == pytest.approx(turns[0], rel=1e-5)
    assert np.array(sizes) == pytest.approx(sizes[0], abs=1e-5)
    proof = certify(loop, boxes=60)
    assert proof.share(None) < 1.0
    assert wrong(loop, proof, samples=40) == 0


def test_control_points_and_remainders_hold_the_function() -> None:
    """Of random members, frequencies and dead times; the function itself by one sample's exact matrices."""
    for ranges in (
        [*SPRINGS[:2], PAYLOAD],
        [SPRINGS[2], LATE],
        [{"of": "stiffness", "factor": (0.5, 2.0)}, SPRINGS[0]],
    ):
        of = characteristic(ranges)
        low, high = np.array([0.0, 18.0, 100.0]), np.array([2.5, 22.0, 120.0])
        cells, rng = cells_of(of, low, high), np.random.default_rng(5)
        low, high = cells.low, cells.high
        assert len(low) >= 3
        assert float(np.sum(high - low)) == pytest.approx(26.5)
        for k in range(len(low)):
            for _ in range(3):
                t = rng.uniform(size=1 + len(ranges))
                omega, theta = low[k] + (high[k] - low[k]) * t[:1], of.low + (of.high - of.low) * t[1:]
                own, value = Characteristic(of.loop, theta, theta, of.decay), list[complex]()
                for machines, ports in of.seen(theta[None, None]):
                    late = own.dead_times[:1]
                    shifted = replace_dead_times(of, late)
                    pencil = characteristic_cells._pencil(
                        shifted, machines, ports, 1j * omega - of.decay, own.aliases.at(omega)[:, :1]
                    )
                    value.append(complex(np.linalg.det(pencil)[0, 0, 0]))
                points = cells.points[k]
                for x in t:
                    points = np.tensordot(bernstein(points.shape[0] - 1, np.array([x]))[0], points, axes=1)
                assert abs(complex(points) - value[0] * np.conj(value[1])) <= cells.error[k]


def replace_dead_times(of: Characteristic, late: np.ndarray) -> Characteristic:
    """The same frame with one dead time."""
    found = Characteristic(of.loop, of.low, of.high, of.decay)
    found.__dict__.update({**of.__dict__, "dead_times": late})
    return found


def test_stiffness_enters_each_once() -> None:
    """Second differences of the determinant vanish, and third ones of a common factor of three springs do not sooner."""
    of = characteristic(SPRINGS)
    assert of.degrees == (1, 1, 1)
    assert characteristic([{"of": "stiffness", "factor": (0.5, 2.0)}]).degrees == (3,)
    omega = np.array([77.0])
    for axis in range(3):
        thetas = np.tile([0.7, 1.3, 1.1], (3, 1))
        thetas[:, axis] = 0.5, 1.0, 1.5
        [(machines, ports), _] = of.seen(thetas[:, None])
        pencil = characteristic_cells._pencil(of, machines, ports, 1j * omega - 1e-6, of.aliases.at(omega))
        a, b, c = np.linalg.det(pencil)[0, :, 0]
        assert abs(a - 2 * b + c) < 1e-10 * abs(a)
        assert abs(a - b) > 1e-4 * abs(a)


@pytest.mark.parametrize(
    ("ranges", "loop"),
    [
        (SPRINGS, {}),
        (SPRINGS, {"dead_time": 0.02}),
        ([*SPRINGS[:2], LATE], {}),
        ([SPRINGS[2], PAYLOAD], {"dead_time": 0.02}),
    ],
)
def test_nothing_proven_is_wrong(ranges: list[dict[str, Any]], loop: dict[str, float]) -> None:
    found = uncertain(ranges, **loop)
    proof = certify(found, boxes=200)
    assert sum(leaf.volume for leaf in proof.leaves) == pytest.approx(1.0)
    assert proof.share(None) < 1.0
    assert wrong(found, proof) == 0


def test_an_unstable_corner_is_never_certified() -> None:
    """By SciPy's discretisation the loop grows at 20 ms somewhere; its leaf is not one that decays."""
    found = uncertain(SPRINGS, dead_time=0.02)
    u = found.box.members(64)
    worst = u[int(np.argmin(found.decays(u)))]
    factors = found.box.told(worst)
    data = EXCAVATOR.to_dict()
    data["base"]["stiffness"] = {x: v * factors[f"base.stiffness.{x}"] for x, v in data["base"]["stiffness"].items()}
    other = flexopt.machine_from_dict(data)
    kept = multipliers(other, B, control="inverse", kp=1e4, kv=1e3, period=0.005, dead_time=0.02)
    assert abs(kept[0]) > 1
    for leaf in certify(found, boxes=150).leaves:
        if np.all((worst >= leaf.low) & (worst <= leaf.high)):
            assert leaf.decays is not True
    region = flexopt.stable_region(EXCAVATOR, B, loop=GAINS | {"dead_time": 0.02}, ranges=SPRINGS, points=64)
    assert region.stable is False
    assert not region.guaranteed


def test_of_a_loop_that_grows_as_it_is_that_is_told() -> None:
    region = flexopt.stable_region(EXCAVATOR, (0.9929, -2.6306), loop={"kp": 1e5, "kv": 2e3}, points=4, boxes=0)
    assert region.radius == 1.0
    assert "as it is in the file it does not decay" in repr(region)


def test_the_largest_radius_is_that_which_is_looked_up_to() -> None:
    """Not what a logarithm and back leave of it."""
    slack = {"of": "base.stiffness.x", "factor": (0.5, 2.0)}
    region = flexopt.stable_region(EXCAVATOR, B, loop=GAINS, ranges=[slack], points=4, boxes=50)
    assert (region.radius, region.radius_guaranteed) == (10.0, 10.0)


@pytest.mark.parametrize("seed", [0, 2, 3])
def test_random_machines(seed: int) -> None:
    source = NumpySource(np.random.default_rng(seed))
    machine = flexopt.machine_from_dict(draw_machine(source, Structure(2, ("x", "rotation"), ())))
    posture = np.array([source.uniform(-1.0, 1.0), source.uniform(0.5, 2.0)])
    loop = uncertain([{"of": "stiffness", "factor": (0.8, 1.25)}], machine, posture, kp=1e3, kv=1e3, rate=500.0)
    proof = certify(loop, boxes=15)
    assert proof.share(None) < 1.0
    assert wrong(loop, proof, samples=40) == 0


@pytest.mark.long
def test_words_and_what_they_rest_on() -> None:
    proven = flexopt.stable_region(EXCAVATOR, B, loop=GAINS, ranges=SPRINGS, points=16)
    assert proven.stable
    assert proven.guaranteed
    assert proven.certified == pytest.approx(1.0)
    assert 1.0 < proven.radius_guaranteed <= proven.radius
    assert "guaranteed: decays faster than 1e-06/s by zero exclusion" in repr(proven)
    asked = flexopt.stable_region(EXCAVATOR, B, loop=GAINS, ranges=SPRINGS, points=16, boxes=0)
    assert (asked.stable, asked.guaranteed) == (True, False)
    weighed = flexopt.stable_region(EXCAVATOR, B, loop=GAINS, ranges=SPRINGS[:1], points=16, gravity=True)
    assert not weighed.guaranteed
    assert "weight" in weighed.rests_on
    assert set(proven.to_dict()) >= {"guaranteed", "rests_on", "radius_guaranteed"}


def test_a_guaranteed_radius_is_one() -> None:
    """Every sample of that box decays."""
    wide = uncertain([each | {"factor": (0.4, 2.5)} for each in SPRINGS[:2]], dead_time=0.005)
    radius = certified_radius(wide, float(np.log(2.5)), boxes=100)
    assert 1.0 < radius <= 2.5
    inside = uncertain([each | {"factor": (1 / radius, radius)} for each in SPRINGS[:2]], dead_time=0.005)
    assert inside.decays(inside.box.members(100)).min() > 0


def test_machines_are_of_first_degree_or_refused() -> None:
    """A centre of mass stands in the inertia squared."""
    assert "first degree" in certify(uncertain([{"of": "stick.com", "value": (0.5, 0.7)}])).sentence


@pytest.mark.long
def test_degrees_do_not_depend_on_how_stiff_springs_are() -> None:
    """One factor of two springs, one ten digits softer: a degree too few leaves out what grows."""
    slow = 9e4 * float(np.sqrt(7e-10))
    data = EXCAVATOR.to_dict()
    data["base"]["stiffness"] = {"x": 8.1e12, "y": 1e3 * slow**2}
    data["base"]["damping"] = {"x": 9e3, "y": 1e3 * slow * 0.3}
    machine = flexopt.machine_from_dict(data)
    gains = {"kp": 1e3 * slow**2, "kv": 200 * slow, "rate": 3e4}
    loop = uncertain([{"of": "stiffness", "factor": (0.25, 4.0)}], machine, **gains)
    assert over_whole(loop).degrees == (2,)
    u = np.linspace(0, 1, 41)[:, None]
    assert loop.decays(u).min() < 0
    assert wrong(loop, certify(loop, boxes=60)) == 0


@pytest.mark.long
def test_what_is_fixed_or_undamped_is_no_error() -> None:
    fixed = [{"of": "stiffness", "factor": (1, 1)}]
    edge = GAINS | {"kp": 5310.7658853378825, "dead_time": 0.02}
    found = flexopt.stable_region(EXCAVATOR, B, loop=edge, ranges=fixed, points=4, boxes=10)
    assert found.stable is None
    both = [*fixed, {"of": "base.stiffness.rotation", "factor": (0.9, 1.1)}]
    # It decays at 5e-6/s all over.
    assert flexopt.stable_region(EXCAVATOR, B, loop=edge, ranges=both, points=4, boxes=10).stable is not False
    data = flexopt.load("boom-stick-bucket").to_dict()
    del data["base"]["damping"]
    machine, posture = flexopt.machine_from_dict(data), REDUNDANT["boom-stick-bucket"]
    loop = {"kp": 3e5, "kv": 7e5, "rate": 400.0, "control": "transpose"}
    undamped = flexopt.stable_region(machine, posture, loop=loop, ranges=both[:1], points=4, boxes=10)
    assert undamped.certified in (0.0, 1.0)


def test_too_much_at_once_is_refused() -> None:
    bodies = [{"of": f"{body}.mass", "factor": (0.5, 2.0)} for body in ("boom", "stick")]
    found = certify(uncertain([*bodies, PAYLOAD, *SPRINGS]), boxes=2)
    assert "at once" in found.sentence


@pytest.mark.parametrize("pair", [(1, -1), (1j, -1j), (1 + 1e-15j, -1)])
def test_opposite_values_do_not_exclude_zero(pair: tuple[complex, complex]) -> None:
    points = np.array(pair, dtype=complex).reshape(1, 2, 1)
    assert not characteristic_cells.Cells(np.zeros(1), np.ones(1), points, np.full(1, 1e-9)).exclude_zero.any()


def test_progress_reaches_its_end() -> None:
    told = list[tuple[int, int]]()
    options: dict[str, Any] = {"loop": {"kp": 1e4, "kv": 1e3}, "points": 8, "boxes": 30}
    flexopt.stable_region(EXCAVATOR, B, **options, progress=lambda done, total: told.append((done, total)))
    assert len(told) > 5
    assert told == sorted(set(told))
    assert told[-1] == (150, 150)


def test_a_load_over_which_no_norm_bounds_the_aliases() -> None:
    """Over all of it none does, over its parts one does; a warning of NumPy would be an error here."""
    loop = uncertain([{"of": "payload.mass", "value": (0.0, 1000.0)}])
    proof = certify(loop, boxes=200)
    assert [leaf.decays for leaf in proof.leaves] == [True] * len(proof.leaves)
    assert len(proof.leaves) > 1
    assert wrong(loop, proof) == 0


def carried(posture: Vector) -> UncertainLoop:
    """Three links over two rows under their weight, which the controller knows on springs as of the file."""
    machine = flexopt.load("boom-stick-bucket")
    settings, base = settings_at(machine, posture, None, None, Loop(**DRIFTS), gravity=True, call="test")
    return UncertainLoop(settings, base, posture, True, UncertaintyBox(machine, (SOFT,), settings.dead_time))


def eigenvalues(loop: UncertainLoop, factor: float) -> Any:
    """Of one sample of a member, ln μ / T, all of them, the fastest growing first."""
    at = loop.outcome(np.array([np.log(factor / 0.5) / np.log(4.0)]))
    found = np.log(np.linalg.eigvals(at.sample.matrix).astype(complex)) / at.period
    return found[np.argsort(-found.real)]


def test_friction_is_of_the_most_that_a_joint_carries_anywhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """A joint that carries next to nothing on one of more grounds does not move off for that."""
    monkeypatch.setattr(UncertainLoop, "off_target", lambda *_: 0.0)
    monkeypatch.setattr(UncertainLoop, "fastest_drift", lambda *_: (math.nan, None))
    loop, still = carried(np.array([0.5, -1.2, 0.3])), SimpleNamespace(growth_rate=-1.0, rounding=0.0)

    def point(driven: float, carries: float) -> Any:
        return SimpleNamespace(unheld=np.array([0.0, 0.0, driven]), carried=np.array([9.0, 9.0, carries]), loop=still)

    corners, between = [point(0.05, 8.0), point(0.0, 7.0)], point(0.04, 0.6)
    for points in (corners, [*corners, between]):
        assert BesideDecay.of(loop, np.zeros((len(points), 1)), points).unheld == {}
    moved = BesideDecay.of(loop, np.zeros((3, 1)), [*corners, point(0.09, 8.0)])
    assert moved.unheld == dict(zip(loop.box.machine.joints, (0.0, 0.0, 0.09), strict=True))


def test_several_ways_of_a_self_motion_are_told_in_one_sentence() -> None:
    assert drifting_self_motion([-0.1, 0.002, 0.0026]) == [
        "the arm's self-motion drifts, e-fold in 385 s, other ways of it in 500 s"
    ]
    assert drifting_self_motion([0.0026]) == ["the arm's self-motion drifts, e-fold in 385 s"]
    assert drifting_self_motion([-0.1]) == []


# The drift grows faster on softer springs in the one posture, on stiffer ones in the other.
@pytest.mark.parametrize("posture", [(-1.072, -1.225, -0.748), (-1.036, -1.776, -1.351)])
def test_a_drift_over_the_ranges_is_told_with_where(posture: tuple[float, ...]) -> None:
    """Beside eigenvalues of all motions on an even scan: what alone grows there is the arm along its self-motion."""
    loop = carried(np.array(posture))
    factors = np.geomspace(0.5, 2.0, 10)
    rates = [float(eigenvalues(loop, factor)[0].real) for factor in factors]
    fastest, where = max(zip(rates, factors, strict=True))
    found = flexopt.stable_region(
        loop.box.machine, posture, gravity=True, loop=DRIFTS, ranges=[SOFT], points=2, boxes=0
    )
    assert found.stable
    assert found.decay > 0.5
    assert found.drift == pytest.approx(fastest, rel=1e-6)
    assert found.drift_critical == {"stiffness": pytest.approx(where)}
    assert f"self-motion drifts, e-fold in {1 / fastest:.3g} s, the worst found, at stiffness {where:g}" in repr(found)
    assert found.to_dict()["drift"] == found.drift
    # A search leads there from the middle, too.
    beside = BesideDecay.of(loop, np.array([[0.5]]))
    assert (beside.drift, beside.drift_at["stiffness"]) == (pytest.approx(fastest, rel=1e-6), pytest.approx(where))


def test_without_a_drift_none_is_told() -> None:
    """A machine with as many joints as task rows, and an arm whose self-motion nothing acts on."""
    found = flexopt.stable_region(EXCAVATOR, B, loop=GAINS, ranges=[SOFT], points=2, boxes=0)
    assert np.isnan([found.drift, found.self_motion, found.radius_self_motion]).all()
    assert found.drift_critical == {}
    assert "self-motion" not in repr(found)
    machine, posture = flexopt.load("boom-stick-bucket"), REDUNDANT["boom-stick-bucket"]
    free = flexopt.stable_region(
        machine, posture, loop=DRIFTS | {"nullspace_damping": 0.0}, ranges=[SOFT], points=2, boxes=0
    )
    assert np.isnan(free.drift)
    assert "  the loop does not brake the arm's self-motion" in repr(free)
    # Which motion the radius ends with is told where it is mostly the arm's self-motion.
    ends = replace(found, radius=3.0, radius_critical={"stiffness": 0.33}, radius_self_motion=0.85)
    assert "at stiffness 0.33 (to 85 % of its kinetic energy the arm's self-motion" in repr(ends)
    assert "self-motion" not in repr(replace(ends, radius_self_motion=0.2))


def test_two_drifts_that_meet_are_drifts_still() -> None:
    """Where springs are soft they are a pair that dies away long before it swings; the decay goes on as it was."""
    loop = carried(np.array((-1.44, -1.593, -1.366)))
    soft, stiff = eigenvalues(loop, 0.5)[:4], eigenvalues(loop, 2.0)[:4]
    assert 0 < soft[0].imag * np.sign(soft[0].imag) < -soft[0].real
    assert not stiff[:2].imag.any()
    for u, known in (([0.0], soft), ([1.0], stiff)):
        found = loop.outcome(np.array(u)).loop
        assert found.drift == pytest.approx(known[:2].real.tolist(), rel=1e-6)
        assert -found.growth_rate == pytest.approx(-known[2].real, rel=1e-9)
        # Not one of a pair is left behind.
        assert sorted(found.multipliers.imag) == pytest.approx(sorted(-found.multipliers.imag))
    beside = BesideDecay.of(loop, np.array([[0.0]]))
    assert (beside.drift, beside.drift_at["stiffness"]) == (pytest.approx(soft[0].real), 0.5)
