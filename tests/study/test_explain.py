"""Explanations: what they name is seen by moving a little that way, and by other means of finding it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import null_space
from scipy.optimize import brentq

import flexopt
from flexopt.plant.inverse_kinematics import solve_postures
from flexopt.plant.reach import arm_length
from flexopt.study.explanation import STATIONARY, WHY
from tests.cli.command import Command
from tests.study.machines import three_links

ROOT = Path(__file__).parents[2]
NAMES = ["excavator", "three links", "boom-stick-bucket", "slewing-excavator", "truck-crane", "mobile-manipulator"]


def machine_of(name: str):
    return three_links() if name == "three links" else flexopt.load(name)


def random_posture(machine, seed: int):
    """Inside the limits, away from where the arm is straight."""
    ends = [(low, high) if math.isfinite(low) else (-2.0, 2.0) for low, high in machine.limits]
    low, high = np.array(ends).T
    rng = np.random.default_rng(seed)
    plant = flexopt.build_plant(machine)
    for _ in range(100):
        posture = low + (high - low) * (0.1 + 0.8 * rng.random(len(low)))
        q = plant.rest(np.zeros(plant.n_base), posture, plant.parameter_values)
        sizes = np.linalg.svd(plant.rigid_jacobian(q, np.zeros(plant.n_base), plant.parameter_values).full())[1]
        if sizes[-1] > 0.2 * sizes[0]:
            return posture
    raise AssertionError("no regular posture")


def moved(machine, found, direction, step: float):
    """All w_i after a step that way, the end-point brought back onto its place by inverse kinematics."""
    plant, n_b = flexopt.build_plant(machine), len(found.evaluation.base)
    base, start = found.evaluation.base + step * direction[:n_b], found.evaluation.posture + step * direction[n_b:]
    postures, left = solve_postures(plant, found.evaluation.end_point, base, start[:, None])
    assert left[0] <= 1e-10
    return (
        flexopt.build_measures(machine, found.evaluation.control)
        .w(base, postures[:, 0], plant.parameter_values)[0]
        .full()[:, 0]
    )


@pytest.mark.parametrize("name", NAMES)
def test_w_rises_that_way_by_what_was_predicted(name: str) -> None:
    """What is left of the prediction falls with the square of the step, for every mode and all its effects."""
    machine = machine_of(name)
    for seed in range(2):
        found = flexopt.explain(machine, random_posture(machine, seed), control=("inverse", "transpose")[seed])
        for i, move in enumerate(found.moves):
            assert move.status == "move"
            lead = found.variables.index(move.variable)
            assert abs(move.direction[lead]) == pytest.approx(1.0, abs=1e-15)
            assert move.unit == found.variable_units[lead]
            assert move.effects[i] == move.rate > 0
            # A step that moves nothing by more than a thousandth.
            step = 1e-3 / np.abs(move.direction).max()
            errors = [
                moved(machine, found, move.direction, h) - found.evaluation.w - h * move.effects
                for h in (step, step / 2)
            ]
            rise = moved(machine, found, move.direction, step / 8)[i] - found.evaluation.w[i]
            assert rise > 0
            rounding = 1e-9 * found.evaluation.scale
            assert np.all(np.abs(errors[1]) <= 0.3 * np.abs(errors[0]) + rounding), (name, seed, i)
            assert np.all(np.abs(errors[0]) <= 1e-3 * found.evaluation.scale)


@pytest.mark.parametrize("name", NAMES)
def test_no_other_motion_that_keeps_the_end_point_raises_it_more(name: str) -> None:
    """Among random motions, with slopes by differences, in the metric that counts metres in lengths of the arm."""
    machine = machine_of(name)
    plant = flexopt.build_plant(machine)
    found = flexopt.explain(machine, random_posture(machine, 5))
    scale = np.array([1.0 if unit == "rad" else arm_length(plant) for unit in found.variable_units])
    z, n_b = np.concatenate([found.evaluation.base, found.evaluation.posture]), len(found.evaluation.base)
    p, w = plant.parameter_values, flexopt.build_measures(machine).w

    def both(z):
        q = plant.rest(z[:n_b], z[n_b:], p)
        out = w(z[:n_b], z[n_b:], p)[0].full().ravel()
        return np.concatenate([out, plant.end_point(q, z[:n_b], p).full().ravel()])

    h = 1e-6 * scale
    slopes = np.array([(both(z + h * e) - both(z - h * e)) / 2e-6 for e in np.eye(len(z))]).T
    m = len(found.evaluation.w)
    kept = null_space(slopes[m:], rcond=1e-6)
    others = kept @ np.random.default_rng(2).standard_normal((kept.shape[1], 500))
    others /= np.linalg.norm(others, axis=0)
    for i, move in enumerate(found.moves):
        size = np.linalg.norm(move.direction / scale)
        best = move.rate / size
        assert np.abs(slopes[m:] @ (move.direction / scale)).max() <= 1e-6 * size
        assert (slopes[i] @ others).max() <= best * (1 + 1e-6) + 1e-8 * found.evaluation.scale[i]
        assert best == pytest.approx(np.linalg.norm(slopes[i] @ kept), rel=1e-4, abs=1e-7 * found.evaluation.scale[i])


def test_sizes_and_angles_are_those_of_the_residues() -> None:
    """By the singular value decomposition of R_i, and by w_i = −2 |a||b| sin²(angle/2)."""
    machine = flexopt.load("slewing-excavator")
    posture = random_posture(machine, 3)
    found, evaluation = flexopt.explain(machine, posture), flexopt.evaluate(machine, posture)
    u, sizes, v = np.linalg.svd(evaluation.residues)
    np.testing.assert_allclose(found.evaluation.scale, sizes[:, 0], rtol=1e-10)
    cosines = np.sum(u[:, :, 0] * v[:, 0, :], axis=1)
    np.testing.assert_allclose(np.cos(found.angle), cosines, atol=1e-10)
    np.testing.assert_allclose(
        found.evaluation.w, -2 * found.evaluation.scale * np.sin(found.angle / 2) ** 2, rtol=1e-9
    )


def test_words_on_unequal_gains_are_those_of_the_residue() -> None:
    """To first order velocity gains K of the rows add tr(K R_i) to the damping term of mode i."""
    seen = set[bool]()
    for seed in range(8):
        found = flexopt.explain(flexopt.load("excavator"), random_posture(flexopt.load("excavator"), seed))
        for sentence, residue, angle in zip(found.sentences, found.evaluation.residues, found.angle, strict=True):
            if not math.radians(1) < angle < math.radians(89):
                continue
            assert np.trace(residue) > 0
            assert np.linalg.eigvalsh(residue + residue.T)[0] < 0
            whatever = bool((np.diag(residue) >= 0).all())
            assert ("gains of the rows damp it, equal or not" in sentence) == whatever
            assert ("some unequal ones excite it" in sentence) == (not whatever)
            seen.add(whatever)
    assert seen == {True, False}


def test_under_gravity_the_deflected_end_point_stays() -> None:
    machine = flexopt.load("excavator")
    found = flexopt.explain(machine, [0.4, -1.8], gravity=True)
    w = flexopt.build_measures(machine, "inverse", True).w
    for i, move in enumerate(found.moves):
        errors = []
        for h in (1e-3, 5e-4):
            base, wanted = (
                found.evaluation.base + h * move.direction[:1],
                found.evaluation.posture + h * move.direction[1:],
            )
            reached = flexopt.inverse_kinematics(machine, found.evaluation.end_point, base=base, gravity=True)
            posture = min(reached, key=lambda q, wanted=wanted: np.abs(q - wanted).max())
            after = w(base, posture, flexopt.build_plant(machine).parameter_values)[0].full().ravel()
            errors.append(after[i] - found.evaluation.w[i] - h * move.rate)
        assert abs(errors[1]) <= 0.3 * abs(errors[0])


def test_at_an_optimum_no_direction_is_named() -> None:
    machine = flexopt.load("excavator")
    best = flexopt.select(machine, [0.0, 1.6], workers=1).best.evaluation
    found = flexopt.explain(machine, best.posture, base=best.base)
    assert found.moves[0].status == "optimum"
    assert found.moves[0].variable is None
    assert np.isnan(found.moves[0].direction).all()
    assert {move.status for move in found.moves[1:]} == {"move"}
    assert "its greatest value" in found.sentences[0]


def test_where_the_slope_along_all_that_is_free_vanishes_no_direction_is_named() -> None:
    """A point of which another means says so: a root of the slope along the curve that keeps the end-point."""
    machine = flexopt.load("excavator")
    target = np.array([0.0, 1.6])

    def at(x: float):
        (posture,) = flexopt.inverse_kinematics(machine, target, base=x, elbow="up")
        return flexopt.explain(machine, posture, base=x)

    def slope(x: float) -> float:
        move = at(x).moves[0]
        # The lead changes from place to place: per metre of the base.
        return 0.0 if move.status != "move" else move.rate / move.direction[0]

    places = np.linspace(-1.5, 1.5, 7)
    slopes = [slope(x) for x in places]
    turning = next(
        k
        for k in range(6)
        if slopes[k] * slopes[k + 1] < 0 and abs(slopes[k]) < 1 and at(places[k]).evaluation.w[0] < -1e-7
    )
    root = brentq(slope, places[turning], places[turning + 1], xtol=1e-14)
    found = at(root)
    assert found.evaluation.w[0] < -1e-9
    assert found.moves[0].status == "stationary"
    assert at(root + 1e-4).moves[0].status == "move"


def test_a_limit_in_the_way_is_said_and_the_other_way_is_free() -> None:
    data = flexopt.load("excavator").to_dict()
    boom, stick = data["links"]
    posture = [0.9929, -2.6306]
    free = flexopt.explain(flexopt.machine_from_dict(data), posture)
    down = free.moves[0].direction[1]
    assert down < 0 < free.moves[1].direction[1]
    held = flexopt.machine_from_dict(data | {"links": [{**boom, "limits": [0.9929, 1.2]}, stick]})
    found = flexopt.explain(held, posture)
    assert [move.status for move in found.moves[:2]] == ["at a limit", "move"]
    # The straight way until the other end.
    assert found.moves[1].room == pytest.approx(0.2071 / abs(found.moves[1].direction[1]), rel=1e-9)


@pytest.mark.parametrize("beside", [0.0, 7e-8])
def test_limits_leave_the_best_of_what_is_free(beside: float) -> None:
    """Where several motions keep the end-point, a joint at its limit stays and the others move: no sample is better.

    A posture that was solved for stands at its limit to some digits alone.
    """
    machine = flexopt.load("slewing-excavator")
    posture = [0.4, 0.2, -1.4, machine.limits[-1][1] - beside]
    found = flexopt.explain(machine, posture)
    plant, measures = flexopt.build_plant(machine), flexopt.build_measures(machine)
    slopes = measures.gradients.call([found.evaluation.base, found.evaluation.posture, plant.parameter_values])
    scale = np.array([1.0 if unit == "rad" else arm_length(plant) for unit in found.variable_units])
    w_z, kept = slopes[0].full() * scale, null_space(slopes[2].full() * scale)
    others = kept @ np.random.default_rng(3).standard_normal((kept.shape[1], 4000))
    others = others[:, others[-1] <= 0]
    assert others.shape[1] > 1000
    best = (w_z @ (others / np.linalg.norm(others, axis=0))).max(axis=1)
    blocked = 0
    for i, move in enumerate(found.moves):
        assert move.direction[-1] <= 1e-12
        blocked += abs(move.direction[-1]) < 1e-12
        reached = move.rate / np.linalg.norm(move.direction / scale)
        assert 0.8 * reached <= best[i] <= reached * (1 + 1e-9)
    assert 0 < blocked < len(found.moves)


def test_an_arm_with_nothing_to_spare_is_told_so(tmp_path: Path) -> None:
    text = (ROOT / "models" / "mobile-manipulator.toml").read_text(encoding="utf-8")
    actuated = 'actuated = ["pan", "shoulder", "elbow", "wrist1", "wrist2", "wrist3"]'
    assert actuated in text
    fixed = (
        'actuated = ["pan", "shoulder", "elbow"]\nplacement = []\nlocked = {wrist1 = 0.0, wrist2 = 0.3, wrist3 = 0.0}'
    )
    text = text.replace(actuated, fixed).replace("robots/", f"{(ROOT / 'models' / 'robots').as_posix()}/")
    lines = [line for line in text.splitlines() if not line.startswith('placement = ["')]
    (tmp_path / "fixed.toml").write_text("\n".join(lines), encoding="utf-8")
    machine = flexopt.load(tmp_path / "fixed.toml")
    found = flexopt.explain(machine, [0.3, -1.0, 1.2])
    assert {move.status for move in found.moves} == {"end-point fixed"}
    assert "nothing can be moved without moving the end-point" in found.sentences[0]


def test_modes_of_one_frequency_have_no_direction() -> None:
    data = flexopt.load("excavator").to_dict()
    base = {**data["base"], "mass": 1e9, "inertia": 1e12, "stiffness": {"x": 4e7, "y": 4e7}, "damping": {}}
    links = [{**link, "mass": 1e-3, "inertia": 1e-3} for link in data["links"]]
    found = flexopt.explain(flexopt.machine_from_dict(data | {"base": base, "links": links}), [1.0, -2.0])
    assert {move.status for move in found.moves} == {"shared"}
    assert np.isnan(found.angle).all()
    assert all(WHY["shared"] in sentence for sentence in found.sentences)


def test_with_a_loop_the_damping_and_lag_are_those_of_the_outcome() -> None:
    machine, loop = flexopt.load("excavator"), {"kp": 1e4, "kv": 1e3, "dead_time": 0.01}
    found = flexopt.explain(machine, [0.9929, -2.6306], loop=loop)
    outcome = flexopt.outcome(machine, [0.9929, -2.6306], loop=loop)
    assert found.outcome is not None
    np.testing.assert_array_equal(found.outcome.lag_reserve, outcome.lag_reserve)
    # κ_i = 4 ζ_i ω_i / |w_i|
    kappa = 4 * found.evaluation.damping_ratios * 2 * np.pi * found.evaluation.frequencies_hz / -found.evaluation.w
    np.testing.assert_allclose(found.outcome.allowance, kappa, rtol=1e-9)
    assert f"allowance κ = {kappa[0]:.4g}" in found.sentences[0]
    assert flexopt.explain(machine, [0.9929, -2.6306]).outcome is None
    assert STATIONARY < 1e-6


def test_command(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    command = Command(capsys, tmp_path)
    asked = ("explain", "excavator", "--posture", "0.9929,-2.6306", "--loop", "kp=1e4", "--loop", "kv=1e3")
    document = command.json(*asked, "--out", "why.json")
    found = flexopt.explain(flexopt.load("excavator"), [0.9929, -2.6306], loop={"kp": 1e4, "kv": 1e3})
    assert document == found.to_dict()
    assert document["moves"][0]["room"] is None
    assert (command.folder / "why.json").is_file()
    assert "Move boom the negative way with x -1.015 m" in command(*asked).stdout
    assert command("explain", "excavator").code == 2


def test_of_modes_that_nearly_meet_it_is_told_how_far_a_slope_reaches() -> None:
    found = flexopt.explain(flexopt.load("excavator"), (0.9929, -2.6306))
    assert "which mix" not in str(found)
    first, second, _ = found.evaluation.frequencies_hz
    near = replace(
        found, evaluation=replace(found.evaluation, frequencies_hz=np.array([first, second, 1.001 * second]))
    )
    assert "which mix" not in near.sentences[0]
    for sentence in near.sentences[1:]:
        assert "w2 and w3 are of modes whose frequencies lie 0.1 % apart" in sentence
