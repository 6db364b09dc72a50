"""Numbers from logs of known truth: plain ones, spoilt ones, and ones that do not say what is asked."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import flexopt
from benchmarks.identification import CASES, pushed
from flexopt.identification.cleaning import spikes
from flexopt.identification.poles import find_poles
from flexopt.model import AnyMachine
from flexopt.model.parameter_values import with_parameters
from flexopt.model.uncertainty import parameters_of
from tests.identification.swings import Swung, planar, spatial
from tests.oracles.free_swing import FreeSwing

TURN = "base.*.rotation"
PLANAR = ("gyro_z", "end_point.x", "end_point.y")
SPATIAL = ("gyro_x", "gyro_y", "gyro_z", "end_point.x", "end_point.y", "end_point.z")


def check(found: flexopt.Identification, swung: Swung, names: Iterable[str] | None = None, times: float = 2.5) -> None:
    """The truth lies within so many half-widths of the interval, which is about `times` 2 standard deviations."""
    for name in found.values if names is None else names:
        interval, true = found.intervals[name], swung.truth[name]
        assert interval is not None, name
        low, high = np.log(np.abs(interval)).min(), np.log(np.abs(interval)).max()
        assert abs(np.log(abs(true)) - 0.5 * (low + high)) < times * 0.5 * (high - low), name


@cache
def identified() -> flexopt.Identification:
    """From the plain log of the machine in the plane."""
    swung = planar()
    return flexopt.identify(swung.machine, swung.log(*PLANAR), posture=swung.posture)


@pytest.mark.long
def test_a_machine_in_the_plane() -> None:
    swung, found = planar(), identified()
    check(found, swung)
    assert found.status == "identified"
    assert found.converged
    assert not found.doubts
    assert set(found.values) == set(swung.truth)
    # The machine's own numbers are the identified ones, and its modes those of the truth.
    held = {each.name: each.value for each in found.machine.parameters}
    assert {name: held[name] for name in found.values} == pytest.approx(found.values)
    roots = np.linalg.eigvals(_matrix(swung))
    hertz = np.sort(np.abs(roots[roots.imag > 0])) / (2 * np.pi)
    assert [mode.frequency_hz for mode in found.modes] == pytest.approx(hertz, rel=5e-3)
    assert "mostly rotation of the base" in found.modes[0].words
    noise = [0.01 * np.abs(column - column.mean()).max() for column in list(swung.log(*PLANAR, noise=0.0).values())[1:]]
    assert [column.residual_rms for column in found.columns] == pytest.approx(noise, rel=0.15)


def _matrix(swung: Swung) -> np.ndarray:
    """The oracle's small motions, by differences."""
    rest, h = swung.swing.rest[: swung.swing.m], 1e-6
    at = np.concatenate([rest, 0 * rest])
    steps = h * np.eye(at.size)
    return np.array([(swung.swing.rate(0, at + e) - swung.swing.rate(0, at - e)) / (2 * h) for e in steps]).T


@pytest.mark.long
def test_a_machine_in_space_and_what_its_log_leaves_open() -> None:
    swung = spatial()
    found = flexopt.identify(swung.machine, swung.log(*SPATIAL), posture=swung.posture)
    check(found, swung, [name for name in found.values if name not in found.unidentified])
    for turn in ("pitch", "yaw"):
        assert found.values[f"stiffness.base.{turn}.base.{turn}"] == pytest.approx(
            swung.truth[f"stiffness.base.{turn}.base.{turn}"], rel=0.05
        )
    # A gyroscope about one axis, of a machine whose other numbers are known.
    few = ["base.y.damping", "base.pitch.damping", "stiffness.base.pitch.base.pitch"]
    known = {name: value for name, value in swung.truth.items() if name not in few}
    alone = flexopt.identify(
        with_parameters(swung.machine, known), swung.log("gyro_y", noise=0.1), posture=swung.posture, unknown=few
    )
    check(alone, swung, [name for name in few if name not in alone.unidentified])
    assert "base.y.damping" in alone.unidentified
    assert "base.pitch.damping" not in alone.unidentified
    assert all(alone.intervals[name] is None and alone.factors[name] is None for name in alone.unidentified)
    assert alone.status == "partly identified"
    assert alone.open_directions == ("base.y.damping",)
    assert alone.to_dict()["values"]["base.y.damping"] is None
    assert "base.y.damping" in repr(alone)
    assert "not identifiable from this log" in repr(alone)


@pytest.mark.long
def test_a_direction_that_is_open() -> None:
    """The machine's gravity moves nothing that swings without it: asked for, it is said to be open."""
    swung = planar()
    found = flexopt.identify(
        swung.machine, swung.log(*PLANAR), posture=swung.posture, unknown=["stiffness", "damping", "gravity"]
    )
    assert found.unidentified == ("gravity",)
    assert found.open_directions == ("gravity",)
    assert {each.name: each.value for each in found.machine.parameters}["gravity"] == pytest.approx(9.81, rel=1e-6)
    check(found, swung, swung.truth)


def one_turn(swung: Swung) -> tuple[AnyMachine, dict[str, object]]:
    """The machine whose other numbers are known, and what asks for the spring and damper of the base's rotation."""
    known = {name: value for name, value in swung.truth.items() if not fnmatchcase(name, TURN)}
    return with_parameters(swung.machine, known), {"posture": swung.posture, "unknown": TURN}


@pytest.mark.long
def test_units_of_headers_and_a_file(tmp_path: Path) -> None:
    swung = planar()
    machine, asked = one_turn(swung)
    log = swung.log(*PLANAR)
    names = ["t [ms]", "gyro_z [deg/s]", "end_point.x [mm]", "end_point.y [cm]"]
    columns = [1e3 * log["t"], np.degrees(log["gyro_z"]), 1e3 * log["end_point.x"], 1e2 * log["end_point.y"]]
    lines = [";".join(names)]
    for k, row in enumerate(np.column_stack(columns)):
        cells = [f"{number:.12g}".replace(".", ",") for number in row]
        # The first line has no comma, by which the decimal comma could be told.
        missing = [(k, j) == (7, 2) or (k == 0 and j > 0) for j in range(len(cells))]
        lines.append(";".join("" if none else cell for none, cell in zip(missing, cells, strict=True)))
    (tmp_path / "swing.csv").write_text("# a comment\n" + "\n".join(lines) + "\n", encoding="utf-8")
    found = flexopt.identify(machine, tmp_path / "swing.csv", **asked)
    log["end_point.x"][7] = np.nan
    for name in PLANAR:
        log[name][0] = np.nan
    same = flexopt.identify(machine, log, **asked)
    assert found.values == pytest.approx(same.values, rel=1e-5)
    assert [column.samples for column in found.columns] == [300, 299, 300]


@pytest.mark.long
def test_a_unit_that_is_told_wrongly() -> None:
    swung = planar()
    log = swung.log(*PLANAR)
    log["gyro_z"] = np.degrees(log["gyro_z"])
    found = flexopt.identify(swung.machine, log, posture=swung.posture)
    assert "is it in deg/s, not rad/s?" in found.doubts[0]
    assert [column.name for column in found.columns] == ["end_point.x", "end_point.y"]
    check(found, swung)
    machine, asked = one_turn(swung)
    alone = flexopt.identify(machine, {"t": log["t"], "gyro_z": log["gyro_z"]}, **asked)
    assert any("tilt the base by" in doubt and "deg/s" in doubt for doubt in alone.doubts)
    far = flexopt.identify(machine, {"t": log["t"], "end_point.x": 1e3 * log["end_point.x"]}, **asked)
    assert any("is it in mm, not m?" in doubt for doubt in far.doubts)
    near = flexopt.identify(machine, {"t": log["t"], "end_point.x": log["end_point.x"]}, **asked)
    assert not any("in mm" in doubt for doubt in near.doubts)


@pytest.mark.long
def test_gaps_spikes_and_uneven_samples() -> None:
    swung = planar()
    log, rng = swung.log(*PLANAR), np.random.default_rng(5)
    log["gyro_z"][[20, 50, 133]] += np.array([0.05, -0.1, 0.03])
    log["end_point.x"][77] = 50.0
    log["end_point.y"][200:203] = np.nan
    keep = np.concatenate([np.arange(0, 100), np.arange(125, 301)])
    found = flexopt.identify(swung.machine, {name: column[keep] for name, column in log.items()}, posture=swung.posture)
    check(found, swung)
    told = "\n".join(found.notes)
    assert "1 gap, about 25 samples missing" in told
    assert "gyro_z: 3 spikes left out, at t = 0.2, 0.5, 1.33 s" in told
    assert "end_point.x: 1 spike left out, at t = 0.77 s" in told
    assert [column.left_out for column in found.columns] == [3, 1, 0]
    time = np.sort(swung.time + rng.uniform(0.0, 5e-3, swung.time.size))
    uneven = swung.swing.log(PLANAR, time, 0.01, seed=3)
    found = flexopt.identify(swung.machine, uneven, posture=swung.posture)
    check(found, swung)
    assert "sampled unevenly" in found.notes[0]


def test_who_waits_is_told_how_much_is_done() -> None:
    t, told = np.arange(200) / 50, list[tuple[int, int]]()
    turn = 2e-3 * np.exp(-0.2 * t) * np.cos(14.4 * t) + 1e-5 * np.random.default_rng(1).standard_normal(t.size)
    flexopt.identify(
        flexopt.load("excavator"), {"t": t, "gyro_z": turn}, posture=[0.5, -1.2], unknown=TURN,
        progress=lambda done, total: told.append((done, total)),
    )  # fmt: skip
    done, (total,) = [part for part, _ in told], {whole for _, whole in told}
    assert done == sorted(set(done))
    assert done[-1] == total
    assert len(done) >= 4


def test_no_spikes_where_there_are_none() -> None:
    t = np.arange(0.0, 5.0, 0.01)
    for seed in range(20):
        noise = np.random.default_rng(seed).standard_normal(t.size)
        assert not spikes(t, np.exp(-0.5 * t) * np.sin(40 * t) + 0.01 * noise).any()


@pytest.mark.long
def test_swing_and_stop() -> None:
    """What comes before the arm stands still is not used; the joints say how it is held."""
    swung = planar()
    log, before = swung.log(*PLANAR), np.arange(150) / 100
    moving = np.where(before < 1.45, -0.6 - 0.4 * (1.45 - before), -0.6)
    rng = np.random.default_rng(1)
    both = {"t": np.concatenate([before, 1.5 + log["t"]])}
    for name in PLANAR:
        both[name] = np.concatenate([log[name][0] + 0.5 * np.sin(4 * before), log[name]])
    for joint, q in zip(swung.machine.joints, swung.posture, strict=True):
        stays = np.full(before.size, q)
        joined = np.concatenate([moving if joint == "boom" else stays, np.full(log["t"].size, q)])
        both[f"{joint} [deg]"] = np.degrees(joined + 1e-4 * rng.standard_normal(joined.size))
    found = flexopt.identify(swung.machine, both)
    assert found.posture == pytest.approx(swung.posture, abs=1e-4)
    assert "the arm moves until t = 1.4" in found.notes[0]
    assert found.time[0] > 1.5
    # Postures off by 1e-5 rad, which shows beside intervals of 1e-3.
    check(found, swung, times=3.0)


@pytest.mark.long
def test_residuals_that_are_not_white_widen_the_intervals() -> None:
    """Slow noise, strongest where the slowest mode is."""
    swung, name = planar(), "base.stiffness.rotation"
    log, clean, rng = swung.log(*PLANAR), swung.log(*PLANAR, noise=0.0), np.random.default_rng(3)
    white = identified()
    for column in PLANAR:
        slow = np.convolve(rng.standard_normal(swung.time.size + 9), np.ones(10), "valid")
        log[column] = clean[column] + 0.01 * np.ptp(clean[column]) * slow / slow.std()
    found = flexopt.identify(swung.machine, log, posture=swung.posture)
    assert any("not white" in doubt for doubt in found.doubts)
    assert not any(column.white for column in found.columns)
    widths = [np.diff(np.log(each.intervals[name]))[0] for each in (white, found)]
    noise = found.columns[0].residual_rms / white.columns[0].residual_rms
    assert widths[1] > 1.3 * noise * widths[0]
    check(found, swung, [name])


@pytest.mark.long
def test_a_fit_that_trusts_a_wrong_damper_says_so() -> None:
    machine = flexopt.load("excavator")
    t = np.arange(0.0, 5.0, 0.01)
    noise = 1e-5 * np.random.default_rng(1).standard_normal(t.size)
    log = {"t": t, "gyro_z": 2e-3 * np.exp(-0.2 * t) * np.cos(12.0 * t) + noise}

    def doubts(unknown: str) -> str:
        return " ".join(flexopt.identify(machine, log, posture=[0.5, -1.2], unknown=unknown).doubts)

    told = doubts("base.stiffness.rotation")
    assert "perhaps the file is wrong in what is not asked for, " in told
    assert "base.damping.rotation" in told
    assert "base.stiffness.rotation" not in told
    assert "not asked for" not in doubts("base.*.rotation")


@pytest.mark.long
def test_other_numbers_that_fit_as_well_are_told() -> None:
    """One column tells poles alone, and which spring makes which of them it does not say."""
    swung = planar()
    found = flexopt.identify(swung.machine, swung.log("gyro_z", seed=2), posture=swung.posture)
    assert "base.stiffness.rotation" in found.unidentified
    assert any("two sets of numbers fit alike" in sentence for sentence in found.open_directions)
    check(found, swung, [name for name in found.values if name not in found.unidentified])


@pytest.mark.long
@pytest.mark.parametrize("seed", [2, 3])
def test_what_no_set_of_numbers_has_does_not_tell_them_apart(seed: int) -> None:
    """A sensor that is not linear makes another set than the true one fit better: by no more than chance has it.

    By the noise alone springs six and seventeen times as stiff as they are were told, to 2 %.
    """
    bent, swung = 0.6, planar()
    log, clean = swung.log("gyro_z", seed=seed), np.asarray(swung.log("gyro_z", noise=0.0)["gyro_z"])
    most = np.abs(clean).max()
    log["gyro_z"] = np.asarray(log["gyro_z"]) + bent * most * ((clean - clean[-50:].mean()) / most) ** 3
    found = flexopt.identify(swung.machine, log, posture=swung.posture)
    assert "base.stiffness.rotation" in found.unidentified
    assert any("two sets of numbers fit alike" in sentence for sentence in found.open_directions)


@pytest.mark.long
def test_a_load_and_dampers_that_the_file_does_not_have() -> None:
    """Factors of 0 are none: a load begins at 1 % of the mass, dampers at 2 % of critical."""
    swung = planar()
    data = swung.machine.to_dict()
    del data["base"]["damping"], data["payload"]
    bare = flexopt.machine_from_dict(data)
    load = next(each.value for each in swung.machine.parameters if each.name == "payload.mass")
    known = {key: value for key, value in swung.truth.items() if "stiffness" in key}
    found = flexopt.identify(
        with_parameters(bare, known), swung.log(*PLANAR), posture=swung.posture, unknown=["damping", "payload.mass"]
    )
    low, high = found.intervals["payload.mass"] or (np.nan, np.nan)
    assert low - (high - low) < load < high + (high - low)
    assert high - low < 0.2 * load
    assert found.factors["payload.mass"] is None
    check(found, swung, [name for name in swung.truth if "damping" in name])


def test_poles_of_a_sum_of_oscillations() -> None:
    t = np.arange(0.0, 4.0, 0.01)
    roots = np.array([-0.3 + 8j, -0.5 + 9.5j, -2.0 + 60j])
    shapes = np.array([[1.0, 0.5, 0.2], [0.3, -1.0, 0.4]])
    columns = (np.exp(np.outer(t, roots)) @ shapes.T).real + 3.0
    columns[100:140] = np.nan
    found = find_poles(columns, 0.01, 3)
    assert np.sort_complex(1j * found.values) == pytest.approx(np.sort_complex(1j * roots), rel=1e-6)


def refused(machine: object, log: object, sentence: str, **more: object) -> None:
    with pytest.raises(flexopt.InputError, match=sentence):
        flexopt.identify(machine, log, **{"posture": planar().posture} | more)


@pytest.mark.long
def test_a_swing_too_short_to_show_its_decay_is_told_with_a_doubt() -> None:
    """Dampers as the article's excavator has them take 1 % of a swing in 5 s; its springs are known all the same."""
    machine = flexopt.load("excavator")
    swing = FreeSwing(machine, (0.5, -1.2), [1e-4, -1e-4, 6e-3], np.zeros(3))
    log = swing.log(("gyro_z",), np.arange(501) / 100, 0.01, seed=2)
    found = flexopt.identify(machine, log, posture=(0.5, -1.2), unknown=TURN)
    assert any("may last for ever" in doubt for doubt in found.doubts)
    assert "may last for ever" in str(found)
    low, high = found.intervals["base.stiffness.rotation"] or (np.nan, np.nan)
    truth = next(each.value for each in machine.parameters if each.name == "base.stiffness.rotation")
    assert low < truth < high
    assert high - low < 0.01 * truth


@pytest.mark.long
def test_a_motion_that_the_noise_hides_tells_nothing() -> None:
    """The fit puts its frequency where the noise has one: the spring that it alone feels was told 19 % off, to .5 %."""
    machine, truth, log = pushed(CASES["planar, gyroscope alone"], np.random.default_rng([1, 22]))
    found = flexopt.identify(machine, log, posture=(0.5, -1.2))
    assert any("does not stand out of the noise" in doubt for doubt in found.doubts)
    assert found.values["base.stiffness.y"] is None
    assert any("base.stiffness.y" in told or "base.damping.y" in told for told in found.open_directions)
    for name in ("base.stiffness.x", "base.stiffness.rotation"):
        low, high = found.intervals[name] or (np.nan, np.nan)
        assert low < truth[name] < high


@pytest.mark.long
@pytest.mark.parametrize("along", [0.0, 3e-4])
def test_joints_that_swing_along_are_told(along: float) -> None:
    """An arm that is not held moves other masses; its joints' own noise says nothing."""
    swung, rng = planar(), np.random.default_rng(5)
    log = swung.log(*PLANAR)
    sway = log["gyro_z"] / np.std(log["gyro_z"])
    for k, (name, q) in enumerate(zip(swung.machine.joints, swung.posture, strict=True)):
        log[name] = q + 1e-4 * rng.standard_normal(sway.size) + (along * sway if k == 1 else 0.0)
    found = flexopt.identify(swung.machine, log)
    told = [doubt for doubt in found.doubts if "swings along" in doubt]
    assert [doubt.split()[0] for doubt in told] == ([swung.machine.joints[1]] if along else [])
    assert all("0.0003 rad" in doubt for doubt in told)


@pytest.mark.long
def test_what_is_refused(tmp_path: Path) -> None:
    machine, t, rng = planar().machine, np.arange(0, 4, 0.01), np.random.default_rng(0)
    swing = np.exp(-0.5 * t) * np.sin(20 * t) * 1e-2
    good = {"t": t, "gyro_z": swing + 1e-5 * rng.standard_normal(t.size)}
    steady, turn = 1e-2 * np.sin(20 * t) + 1e-5 * rng.standard_normal(t.size), {"unknown": "base.*.rotation"}
    refused(machine, {"t": t, "gyro_z": rng.standard_normal(t.size)}, "stands out of its noise", **turn)
    refused(machine, {"t": t, "gyro_z": steady}, "shows no decay", **turn)
    refused(machine, {"t": t, "gyro_z": steady * np.exp(0.1 * t)}, "grows", **turn)
    refused(machine, {"t": t, "gyro_z": np.ones(t.size)}, "shows no motion: gyro_z does not move")
    refused(machine, {name: column[:30] for name, column in good.items()}, "too short: 30 samples")
    refused(machine, {"t": t[:60] / 30, "gyro_z": swing[:60]}, "too short: 0.0197 s", **turn)
    refused(machine, {"t": t}, "measures nothing that swings")
    refused(machine, {"gyro_z": swing}, "t: is missing")
    refused(machine, {"t": t, "gyro_x": swing}, "did you mean 'gyro_z'")
    refused(machine, {"t": t, "gyro_z [deg/m]": swing}, "did you mean 'deg/s'")
    refused(machine, {"time [sec]": t, "gyro_z": swing}, "identify: log.*has no unit 'sec'")
    refused(machine, {"t": t, "gyro_z": swing, "gyro_z [rad/s]": swing}, "is there twice")
    refused(machine, {"t": t[::-1], "gyro_z": swing}, "must not run backwards")
    refused(machine, {"t": t, "gyro_z": swing[:-1]}, "must be of one length")
    refused(machine, good, "posture: is needed", posture=None)
    one = {"stick": np.full(t.size, -1.2), "bucket": np.full(t.size, -0.7)}
    refused(machine, good | one, r"joints \(missing: boom\)", posture=None)
    refused(machine, good, "has no loop", unknown="dead_time")
    refused(machine, good, "did you mean 'payload.mass'", unknown="payload.mas")
    refused(machine, good, "is 0: a factor of it cannot be identified", unknown=["boom.joint_damping"])
    refused(machine, good, "window", window=[3, 1])
    refused(machine, good, "imu", imu=[1, 2, 3])
    both = {"t": t[:-1], "gyro_x": swing, "gyro_z [V]": swing}
    with pytest.raises(flexopt.InputError) as caught:
        flexopt.identify(machine, both, posture=planar().posture, base="here")
    assert len(caught.value.faults) == 3
    for text, sentence in (
        ("t,gyro_z\n0,1\n1,oops\n", "line 3, gyro_z"),
        ("# pushed by hand\n\nt,gyro_z\n0,1\n# again\n1\n", "line 6.*must have 2 cells"),
        ("t,gyro_z\n0,1\n1\n", "must have 2 cells"),
        ("t,gyro_z\n", "1 to 1,000,000 lines"),
    ):
        (tmp_path / "bad.csv").write_text(text, encoding="utf-8")
        refused(machine, tmp_path / "bad.csv", sentence)
    refused(machine, tmp_path / "none.csv", "cannot be read")
    refused(machine, tmp_path / "frf.uff", "UFF")


@pytest.mark.long
@pytest.mark.parametrize("more", ["joint without samples", "samples that come late", "columns one after the other"])
@pytest.mark.filterwarnings("error")
def test_samples_may_be_missing_for_long(more: str) -> None:
    t = np.arange(0, 5, 0.01)
    swing = 2e-3 * np.exp(-0.2 * t) * np.cos(12 * t) + 1e-5 * np.random.default_rng(1).standard_normal(t.size)
    late = np.arange(t.size) < 350
    log = {"t": t, "gyro_z": np.where(late, np.nan, swing)}
    if more == "joint without samples":
        log |= {"gyro_z": swing, "boom": np.full(t.size, np.nan), "stick": np.full(t.size, -1.2)}
    if more == "columns one after the other":
        log |= {"base.rotation": np.where(late, np.cumsum(swing) * 0.01, np.nan)}
    machine = flexopt.load("excavator")
    found, plain = (
        flexopt.identify(machine, each, posture=(0.5, -1.2), unknown=TURN) for each in (log, {"t": t, "gyro_z": swing})
    )
    assert found.values == pytest.approx(plain.values, rel=0.03)
    assert not any("would tilt" in doubt for doubt in found.doubts)


def test_joints_may_be_measured_before_the_swing() -> None:
    """The log then has a posture; what it lacks is told of its columns."""
    t = np.arange(0, 5, 0.01)
    early, gyro = t < 0.3, np.where((t > 1) & (t < 1.3), np.cos(12 * t), np.nan)
    log = {"t": t, "gyro_z": gyro, "boom": np.where(early, 0.5, np.nan), "stick": np.where(early, -1.2, np.nan)}
    refused(flexopt.load("excavator"), log, "gyro_z has 29 samples and is left out", posture=None)


@pytest.mark.long
def test_a_column_with_the_wrong_sign_is_told_as_such() -> None:
    """The springs that come nearest to it are no springs: the machine's own modes are not to blame."""
    swung = planar()
    log = swung.log(*PLANAR)
    refused(swung.machine, log | {"gyro_z": -log["gyro_z"]}, "are signs and units of its columns right")


@pytest.mark.long
def test_axes_of_an_accelerometer_that_are_not_those_of_the_body_are_told(capfd: pytest.CaptureFixture[str]) -> None:
    """Its weight shows where it points: springs of two directions would change places unseen."""
    swung = planar()
    log = swung.log("gyro_z", "acc_x", "acc_y")
    sentence = "are its axes those of the body that carries the arm"
    right = flexopt.identify(swung.machine, log, posture=swung.posture)
    assert not any(sentence in doubt for doubt in right.doubts)
    turned = log | {"acc_x": -log["acc_y"], "acc_y": log["acc_x"]}
    try:
        doubts = flexopt.identify(swung.machine, turned, posture=swung.posture).doubts
    except flexopt.InputError as error:
        doubts = (str(error),)
    assert any(sentence in doubt and "acc_x, acc_y" in doubt for doubt in doubts)
    # Weightless columns, as a high-pass filter leaves them, tell no direction; nor does a solver speak on its own.
    filtered = turned | {name: turned[name] - turned[name].mean() for name in ("acc_x", "acc_y")}
    with contextlib.suppress(flexopt.InputError):
        doubts = flexopt.identify(swung.machine, filtered, posture=swung.posture).doubts
        assert not any(sentence in doubt for doubt in doubts)
    assert "DLASCL" not in "".join(capfd.readouterr())


@pytest.mark.long
def test_an_accelerometer_that_sits_beyond_the_machine_is_told() -> None:
    """In mm for m it would take turns for accelerations, and the springs with them."""
    swung, sentence = planar(), "imu is 500 m from the body's origin"
    log = swung.log("gyro_z", "acc_x", "acc_y")
    try:
        doubts = flexopt.identify(swung.machine, log, posture=swung.posture, imu=(500.0, 0.0)).doubts
    except flexopt.InputError as error:  # whether a fit is tried at all is rounding's choice
        doubts = (str(error),)
    assert any(sentence in doubt and "in mm" in doubt for doubt in doubts)
    right = flexopt.identify(swung.machine, log, posture=swung.posture, imu=(0.5, 0.0))
    assert not any(sentence in doubt for doubt in right.doubts)


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "posture", "softer", "columns"),
    [
        ("excavator", (0.9, -2.6), 0.2, ("gyro_z", "acc_x", "acc_y")),
        ("mobile-manipulator", (0.3, 0.5, 0.6, 0.1, 0.2, 0.1), 0.7, ("gyro_x", "gyro_y", "acc_z")),
    ],
)
def test_springs_that_fall_over_on_the_way_are_passed_by(
    name: str, posture: tuple[float, ...], softer: float, columns: tuple[str, ...]
) -> None:
    """Under its weight a machine falls over on springs that a search tries: those of the log hold it."""
    machine = flexopt.load(name)
    springs = [machine.parameters[i] for i in parameters_of(("stiffness",), machine)]
    truth = {each.name: softer * each.value for each in springs if each.value}
    displaced = np.full(len(machine.kinematic_tree.passive), 2e-3)
    swing = FreeSwing(with_parameters(machine, truth), posture, displaced, 0 * displaced, gravity=True)
    log = swing.log(columns, np.arange(301) / 100, noise=0.01)
    found = flexopt.identify(machine, log, posture=posture, gravity=True)
    assert {spring: found.values[spring] for spring in truth} == pytest.approx(truth, rel=0.01)


@pytest.mark.long
def test_joints_in_degrees_are_told() -> None:
    swung = planar()
    names = ("boom", "stick", "bucket")
    held = {name: np.full(swung.time.size, np.degrees(q)) for name, q in zip(names, swung.posture, strict=True)}
    found = flexopt.identify(swung.machine, swung.log(*PLANAR) | held)
    assert "boom stands at -34.38 rad, outside its limits -2.292 … -0.451; is it in degrees?" in found.doubts


@pytest.mark.long
def test_the_picture(tmp_path: Path) -> None:
    swung = planar()
    found = flexopt.identify(swung.machine, swung.log("gyro_z"), posture=swung.posture, unknown="base.*.rotation")
    figure = found.plot(tmp_path / "found.png")
    assert (tmp_path / "found.png").stat().st_size > 10_000
    top, below = figure.axes
    np.testing.assert_array_equal(top.lines[1].get_ydata(), found.fitted[:, 0])
    np.testing.assert_array_equal(below.lines[0].get_ydata(), found.residuals[:, 0])
