"""Which unknown matters: indices beside a function whose indices are known, slopes beside differences."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import flexopt
from flexopt.loop.sensitivity import _indices, _intervals, _Outputs, _saltelli, _slopes_of_loop
from flexopt.loop.uncertain import UncertainLoop
from flexopt.loop.uncertainty_box import UncertaintyBox

RANGES = {"stiffness": (0.5, 2.0), "damping": (0.5, 2.0), "payload.mass": (0.0, 500.0)}
POSTURE = (0.9929, -2.6306)


def test_indices_of_ishigamis_function() -> None:
    """Their values in closed form (Ishigami and Homma, 1990)."""
    a, b = _saltelli(3, 4096, 0)
    mixed = [np.where(np.arange(3) == k, b, a) for k in range(3)]
    x = np.array([a, b, *mixed]) * 2 * math.pi - math.pi
    y = np.sin(x[..., 0]) + 7 * np.sin(x[..., 1]) ** 2 + 0.1 * x[..., 2] ** 4 * np.sin(x[..., 0])
    parts = y[:, None]
    first, total = _indices(parts)
    np.testing.assert_allclose(first[0], [0.3139, 0.4424, 0.0], atol=0.03)
    np.testing.assert_allclose(total[0], [0.5576, 0.4424, 0.2437], atol=0.03)
    ends_first, ends_total = _intervals(parts, 0)
    for truth, ends in (([0.3139, 0.4424, 0.0], ends_first[0]), ([0.5576, 0.4424, 0.2437], ends_total[0])):
        width = ends[:, 1] - ends[:, 0]
        assert ((ends[:, 0] - width / 2 < truth) & (truth < ends[:, 1] + width / 2)).all()


@pytest.fixture(scope="module")
def found() -> flexopt.Sensitivity:
    machine = flexopt.load("excavator")
    return flexopt.sensitivity(machine, POSTURE, ranges=RANGES, loop={"kp": 1e4, "kv": 1e3}, samples=512)


def test_a_factor_of_all_springs_leaves_w_as_it_is(found: flexopt.Sensitivity) -> None:
    """Modes keep their shapes, and w is made of these."""
    assert found.outputs == ("w1", "w2", "w3", "decay")
    np.testing.assert_allclose(found.total[:3, :2], 0.0, atol=1e-9)
    np.testing.assert_allclose(found.bound[:3, :2], 0.0, atol=1e-9)
    assert found.most[:3] == ("payload.mass",) * 3


def test_slopes_bound_the_indices(found: flexopt.Sensitivity) -> None:
    assert (found.total_interval[..., 0] <= found.bound + 2 * found.bound_error + 1e-9).all()
    assert (found.first <= found.total + 0.1).all()
    assert 0.8 < found.first[3].sum() < 1.1  # little happens together


@pytest.mark.long
def test_modes_that_change_places_are_not_judged() -> None:
    """A yaw spring moves its mode past others: their w_i jump, and what moves it there would seem to matter."""
    data = flexopt.load("mobile-manipulator").to_dict()
    stem = next(body for body in data["bodies"] if body.get("parent") is None)
    hinge = {"name": "yaw", "kind": "hinge", "axis": [0.0, 0.0, 1.0], "passive": True, "damping": 40.0}
    stem["parent"] = "vehicle.yaw"

    def machine(stiffness: float) -> flexopt.Tree:
        yaw = {"name": "vehicle.yaw", "joint": hinge | {"stiffness": stiffness}}
        return flexopt.tree_from_dict(data | {"bodies": [yaw, *data["bodies"]]})

    posture = [0.61, 0.6159, 0.0307, -0.4284, -0.8921, -0.2333]
    seen = [flexopt.evaluate(machine(stiffness), posture) for stiffness in (1e4, 1.2e4, 1e6)]
    # From 1e4 N m/rad upwards it passes all others, which stay where they are.
    assert np.allclose(seen[0].frequencies_hz, seen[1].frequencies_hz, rtol=0.1)
    assert np.allclose(seen[0].frequencies_hz[1:], seen[2].frequencies_hz[:-1], rtol=0.1)
    for ends, crossing in (((1e4, 1.2e4), ()), ((1e4, 1e6), ((0, 1, 2, 3),))):
        given = {"payload.mass": (0.0, 4.0), "yaw.stiffness": ends}
        found = flexopt.sensitivity(machine(3e4), posture, ranges=given, samples=64)
        assert found.crossing == crossing
        assert bool(np.isnan(found.bound).all()) == bool(crossing)
        assert found.most == (("",) if crossing else ("payload.mass",)) * 4
        assert ("modes 1, 2, 3 and 4 change places or trade shapes" in repr(found)) == bool(crossing)
        # Of a single number there is no doubt.
        alone = flexopt.sensitivity(machine(3e4), posture, ranges={"yaw.stiffness": ends}, samples=64)
        assert set(alone.most) <= {"", "yaw.stiffness"}
        assert alone.most[0] == "yaw.stiffness" or not crossing
        if not crossing:
            assert (found.total_interval[..., 0] <= found.bound + 2 * found.bound_error + 1e-9).all()


def test_the_share_of_one_is_what_knowing_it_takes_away(found: flexopt.Sensitivity) -> None:
    """1 − E[Var(decay | mass)] / Var(decay), by other samples, mass by mass."""
    machine = flexopt.load("excavator")
    known = [
        flexopt.Uncertainty(of=name, **{"value" if "." in name else "factor": ends}) for name, ends in RANGES.items()
    ]
    settings = flexopt.outcome(machine, POSTURE, loop={"kp": 1e4, "kv": 1e3}).settings
    box = UncertaintyBox(machine, tuple(known), settings.dead_time)
    loops = UncertainLoop(settings, np.zeros(1), np.array(POSTURE), False, box)
    rng = np.random.default_rng(5)
    masses = (np.arange(24) + 0.5) / 24
    members = np.concatenate([np.column_stack([rng.random((48, 2)), np.full(48, u)]) for u in masses])
    decays = loops.decays(members).reshape(24, 48)
    share = 1 - decays.var(axis=1, ddof=1).mean() / decays.var()
    assert found.first[3, 2] == pytest.approx(share, abs=0.1)


def test_slopes_beside_differences() -> None:
    machine = flexopt.load("excavator")
    known = (
        flexopt.Uncertainty(of="stiffness", factor=(0.5, 2.0)),
        flexopt.Uncertainty(of="payload.mass", value=(0, 500)),
    )
    settings = flexopt.outcome(machine, POSTURE, loop={"kp": 1e4, "kv": 1e3}).settings
    box = UncertaintyBox(machine, known, settings.dead_time)
    of, u, step = _Outputs(box, np.array(POSTURE), np.zeros(1), "inverse", gravity=False), np.array([0.3, 0.6]), 1e-4
    moved = np.array([u + s * step * e for e in np.eye(2) for s in (1, -1)])
    values = of.values(moved)
    np.testing.assert_allclose(of.slopes(u), (values[:, ::2] - values[:, 1::2]) / (2 * step), rtol=1e-5, atol=1e-12)
    loops = UncertainLoop(settings, np.zeros(1), np.array(POSTURE), False, box)
    decays = loops.decays(moved)
    np.testing.assert_allclose(_slopes_of_loop(loops, u), (decays[::2] - decays[1::2]) / (2 * step), rtol=1e-4)


def test_what_is_no_loops(tmp_path: Path) -> None:
    machine = flexopt.load("excavator")
    with pytest.raises(flexopt.InputError, match="dead_time goes with a loop"):
        flexopt.sensitivity(machine, POSTURE, ranges={"dead_time": (0.0, 0.01)})
    with pytest.raises(flexopt.InputError, match="power of two"):
        flexopt.sensitivity(machine, POSTURE, samples=100)
    one = flexopt.sensitivity(machine, POSTURE, samples=64, loop={"kp": 1e4, "kv": 1e3})
    assert one.most == ("", "", "", "stiffness")
    assert one.to_dict()["provenance"]["options"]["loop"]["kp"] == [1e4, 1e4]
    assert one.total[3, 0] == pytest.approx(1.0, abs=0.2)
    found = flexopt.sensitivity(machine, POSTURE, samples=64)
    assert found.most == ("", "", "")  # one factor of all springs: nothing varies
    assert "loop" not in found.provenance["options"]
    assert "does not vary" in repr(found)
    found.plot(tmp_path / "what.png")
    assert (tmp_path / "what.png").stat().st_size > 10_000


def test_text_has_units_and_no_rounding() -> None:
    """w_i does not depend on the springs' common factor: "does nothing", and no 1e-30."""
    found = flexopt.sensitivity(
        flexopt.load("excavator"), (0.9929, -2.6306), loop={"kp": 1e4, "kv": 1e3}, samples=64,
        ranges={"stiffness": (0.5, 2.0), "payload.mass": (0.0, 500.0)},
    )  # fmt: skip
    assert found.output_units == ("1/(kg m2)",) * 3 + ("1/s",)
    lines = repr(found).splitlines()
    assert sum(line.endswith("1/(kg m2)") for line in lines) == 3
    assert next(line for line in lines if line.startswith("  decay")).endswith(" 1/s")
    assert "does nothing" in lines[2]
    assert not any(rounded in repr(found) for rounded in ("-0.000 ", "-0.000,", "-0.000]"))


def test_what_is_next_to_nothing_matters_to_none() -> None:
    """An arm that works to the side, but for a turn of a microradian: the modes across it are not seen."""
    machine, ranges = (
        flexopt.load("slewing-excavator"),
        {"payload.mass": (0.0, 500.0), "undercarriage.mass": (1.2e4, 1.4e4)},
    )
    aside = flexopt.sensitivity(machine, (1e-6, 0.5, -1.2, -0.5), ranges=ranges, samples=64)
    sizes = flexopt.evaluate(machine, (1e-6, 0.5, -1.2, -0.5))
    unseen = [k for k, (w, size) in enumerate(zip(sizes.w, sizes.scale, strict=True)) if abs(w) < 1e-9 * size]
    assert unseen
    assert [aside.said[k] for k in unseen] == ["nothing"] * len(unseen)
    assert "nothing" not in [aside.said[k] for k in range(len(sizes.w)) if k not in unseen]
