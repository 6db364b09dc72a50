"""Figs. 9 to 12 and the gains that postures allow: against theory's figures, the matrices' own poles, and single runs."""

import dataclasses
import json

import numpy as np
import pytest

import flexopt
from flexopt.article import closed_loops, loop_findings
from flexopt.article import loop_pictures as draw
from flexopt.article.closed_loops import OPTIMUM, WITH, WITHOUT
from flexopt.foundation.documents import json_ready
from flexopt.plotting import plot_trajectories
from flexopt.plotting.panels import thinned
from flexopt.simulation import StabilityBorder
from flexopt.simulation.linear import EXACT
from flexopt.study import gains
from flexopt.study.gains import KV_HELD, RATIOS, BorderRow, GainMap, held_words
from tests.oracles.closed_loop_ode import Loop

pytestmark = pytest.mark.filterwarnings("ignore::flexopt.errors.CompilerNotFound")
MACHINE = flexopt.load("excavator")
STATED = {"control": "inverse", "feedback": "pd", "integrator": "rk4", "rate": 200.0, "offset": (0.05, -0.05)}


@pytest.fixture(scope="module")
def loops(result):
    return result.loops


@pytest.fixture(scope="module")
def stands(loops):
    return loops.stands


@pytest.fixture(scope="module")
def gain_map(result):
    return result.gains


def oracle(stand, kp, kv, method):
    loop = Loop(MACHINE, np.array(stand.posture), kp=np.full(2, kp), kv=np.full(2, kv))
    return loop.growth_rate(0.005, method)


@pytest.mark.long
def test_stands_are_table_2(stands):
    np.testing.assert_allclose(stands["A"].posture, [0.9929, -2.6306], atol=5e-4)
    np.testing.assert_allclose(stands["B"].posture, [0.0448, -2.0499], atol=3e-4)
    for name, epsilon in (("A", 0.2869), ("B", 0.3826)):
        assert stands[name].epsilon_max == pytest.approx(epsilon, abs=3e-4)
    for stand, base in zip(stands.values(), (0.0, -1.5, None), strict=True):
        np.testing.assert_allclose(stand.end_point, [0.0, 1.6], atol=1e-9)
        assert base is None or stand.base == base
    assert abs(stands[OPTIMUM].w[0]) < 1e-15


@pytest.mark.long
def test_poles_are_those_of_the_matrices(loops, stands):
    assert [(row.stand, row.kp, row.kv) for row in loops.rows] == [
        (name, *pair) for pair in ((1e5, 2e3), (1e4, 1e3)) for name in stands
    ]
    for row in loops.rows:
        assert row.stated.growth_rate == pytest.approx(oracle(stands[row.stand], row.kp, row.kv, "rk4"), abs=1e-9)
        # DOP853 leaves 1e-8 of the fastest mode's period in a step.
        assert row.accurate.growth_rate == pytest.approx(oracle(stands[row.stand], row.kp, row.kv, "exact"), abs=1e-6)


@pytest.mark.long
def test_poles_of_the_second_pair(loops):
    """Printed in the theory with two digits: A +.07, B −.013."""
    rows = {(row.stand, row.kp): row for row in loops.rows}
    assert rows["A", 1e4].accurate.growth_rate == pytest.approx(0.07, abs=5e-3)
    assert rows["B", 1e4].accurate.growth_rate == pytest.approx(-0.013, abs=5e-4)
    assert (rows["A", 1e4].run.verdict, rows["B", 1e4].run.verdict) == ("grows", "converges")
    # A minute at small motions: the run shows the linear rate.
    for name in ("A", "B"):
        assert rows[name, 1e4].run.growth_rate == pytest.approx(rows[name, 1e4].stated.growth_rate, rel=0.02)


def test_figure_9(loops):
    runs = loops.figure9
    assert {name: run.verdict for name, run in runs.items()} == {
        "A": "grows", "B": "converges", OPTIMUM: "converges",
    }  # fmt: skip
    assert runs["A"].peak_base_rotation > 0.03 > max(runs["B"].peak_base_rotation, runs[OPTIMUM].peak_base_rotation)
    for name, run in runs.items():
        assert run.time[-1] == 10.0
        np.testing.assert_allclose(run.q[0, 3:] - loops.stands[name].posture, [0.05, -0.05], atol=1e-12)
    # The shipped experiment of posture A, run alone.
    alone = flexopt.simulate(MACHINE, end_point=[0.0, 1.6], elbow="up", kp=1e5, kv=2e3, offset=(0.05, -0.05))
    np.testing.assert_array_equal(alone.q, runs["A"].q)


def test_figure_10(loops):
    stop, climb = loops.stopped, loops.climb
    assert stop.base[-1, 0] == -1.5
    np.testing.assert_allclose(stop.posture[-1], loops.stands["B"].posture, atol=1e-9)
    np.testing.assert_allclose(closed_loops.workspace_x(stop), [-0.1733, 1.32687], atol=3e-4)
    # Theory prints 2.145 and ≈ −2.32.
    assert closed_loops.workspace_x(climb)[1] == pytest.approx(2.145, abs=1e-3)
    assert climb.base[-1, 0] == pytest.approx(-2.32, abs=5e-3)
    for way in (stop, climb):
        assert np.all(np.diff(way.V) >= -1e-18)
        assert np.abs(way.base_rate).max() <= loops.stated["max_base_rate"] * (1 + 1e-9)
        assert way.end_point_error.max() < 1e-12
    limit = loops.stated["max_base_acceleration"]
    assert np.abs(np.diff(stop.base_rate[:-1, 0])).max() * 200.0 <= limit * (1 + 1e-6)
    # The law itself leads to an optimum that the nonlinear program finds, too.
    optima = flexopt.select(MACHINE, (0.0, 1.6), base=0.0).candidates
    assert min(abs(c.evaluation.base[0] - climb.base[-1, 0]) for c in optima) < 1e-3


def test_figures_11_and_12(loops):
    adjusted, left = loops.adjustment[WITH], loops.adjustment[WITHOUT]
    assert (adjusted.verdict, left.verdict) == ("converges", "grows")
    assert adjusted.base[0, 0] == 0.0
    assert adjusted.base[-1, 0] == -1.5
    assert np.all(left.base == 0.0)
    np.testing.assert_array_equal(adjusted.q[0], left.q[0])
    assert adjusted.end_error < 0.02 * left.end_error
    assert adjusted.peak_base_rotation < 0.1 * left.peak_base_rotation
    assert loops.low_adjustment.verdict == "converges"
    # After the base has stopped the loop is that of B.
    b = next(row for row in loops.rows if (row.stand, row.kp) == ("B", 1e4))
    assert loops.low_adjustment.growth_rate == pytest.approx(b.stated.growth_rate, rel=0.02)
    assert 1e-4 < closed_loops.peak_error(loops.from_rest) < closed_loops.peak_error(adjusted)


def test_robust_controller(loops):
    rk4, accurate = loops.robust
    assert (rk4.integrator, accurate.integrator) == ("rk4", "exact")
    assert accurate.run.provenance["options"]["integrator"] == "dop853"
    assert accurate.linear.stable
    assert not rk4.linear.stable
    assert rk4.linear.frequency_hz == pytest.approx(22.25, abs=0.1)
    assert accurate.run.verdict == "converges"
    # Where PD control with the same samples has no stable gain.
    assert loops.stands["A"].epsilon_max > 0


@pytest.mark.parametrize("integrator", ["rk4", EXACT])
def test_borders(gain_map, stands, integrator):
    method = "rk4" if integrator == "rk4" else "exact"
    for ratio in (None, *RATIOS):
        for name, stand in stands.items():
            row = gain_map.border(name, held_words(ratio), integrator)
            for _, upper in row.border.intervals:
                below, above = (
                    oracle(stand, kp, KV_HELD if ratio is None else ratio * kp, method)
                    for kp in (0.999 * upper, 1.001 * upper)
                )
                assert below < 0 < above, row
    assert gain_map.border("A", held_words(None), integrator).border.intervals == ()
    for kp in np.geomspace(1e2, 1e7, 26):
        assert oracle(stands["A"], kp, KV_HELD, method) > 0
    # With Kv held B and the optimum end where any double integrator held for T does, at Kp = 2 Kv/T.
    for name in ("B", OPTIMUM):
        assert gain_map.border(name, held_words(None), integrator).border.largest == pytest.approx(8e5, rel=2e-4)


def test_what_the_optimum_allows(gain_map):
    for ratio in RATIOS:
        a, b, best = (gain_map.border(name, held_words(ratio), EXACT).border.largest for name in gain_map.names)
        assert 25 < best / b < 30
        assert b / a > 50
        # RK4 at 5 ms damps the mode that B loses first: it shows B stable nine times too far.
        assert gain_map.border("B", held_words(ratio), "rk4").border.largest / b == pytest.approx(8.8, abs=0.3)
        assert gain_map.border("B", held_words(ratio), EXACT).frequency_hz == pytest.approx(22.73, abs=0.02)


def test_growth_rates_are_those_of_single_loops(gain_map, stands):
    draws = np.random.default_rng(3)
    for i, stand in enumerate(stands.values()):
        for _ in range(4):
            j, k = draws.integers(0, gains.POINTS, 2)
            gains_there = {"kp": gain_map.kp[k], "kv": gain_map.kv[j]}
            for method, rates in (("exact", gain_map.growth_rate), ("rk4", gain_map.stated_growth_rate)):
                single = flexopt.sampled_loop(MACHINE, stand.posture, base=stand.base, integrator=method, **gains_there)
                assert rates[i, j, k] == pytest.approx(single.growth_rate, rel=1e-9, abs=1e-9)
                expected = oracle(stand, *gains_there.values(), method)
                # Poles far beyond the border are ill-conditioned.
                assert rates[i, j, k] == pytest.approx(expected, rel=1e-6, abs=1e-8)


@pytest.mark.filterwarnings("ignore:the run left the finite numbers", "ignore:the arm came close")
def test_verdicts_are_those_of_single_runs(gain_map, stands):
    for i, j, k in ((0, 3, 2), (0, 10, 4), (1, 7, 9), (2, 7, 9), (2, 14, 3)):
        stand = list(stands.values())[i]
        run = flexopt.simulate(
            MACHINE, stand.posture, base=stand.base, kp=gain_map.tested_kp[k], kv=gain_map.tested_kv[j],
            offset=(0.005, -0.005), duration=60.0,
        )  # fmt: skip
        assert (run.run.word == "grows") == gain_map.grows[i, j, k]
        apart = gain_map.grows[i, j, k] != (gain_map.growth_rate[i, 2 * j, 2 * k] > 0)
        assert (run.verdict == "undecided") == apart


def test_verdicts_agree_with_eigenvalues_outside_a_band(gain_map):
    rates = gain_map.stated_growth_rate[:, ::2, ::2]
    assert rates.shape == gain_map.grows.shape
    assert gain_map.band < 0.01
    outside = np.abs(rates) > gain_map.band
    np.testing.assert_array_equal(gain_map.grows[outside], rates[outside] >= 0)
    assert np.count_nonzero(gain_map.grows != (rates >= 0)) == len(gain_map.own_disagreements)
    exact = gain_map.growth_rate[:, ::2, ::2]
    assert np.count_nonzero(gain_map.grows != (exact >= 0)) == len(gain_map.disagreements)
    # RK4 at 5 ms damps the faster modes away: the loop grows where its runs decay.
    assert gain_map.hidden == np.count_nonzero(~gain_map.grows & (exact >= 0) & (rates < 0)) > 30
    assert f"{gain_map.hidden} decay only because RK4 damps" in gain_map.sentence
    # Enough of either kind, and most of them outside the band.
    assert 0.2 < gain_map.grows.mean() < 0.9
    assert outside.mean() > 0.8
    assert f"The {len(gain_map.own_disagreements)} that disagree" in gain_map.sentence


def made_map(grows, rates):
    axis = np.array([1.0, 2.0, 3.0])
    rates = np.array(rates)
    return GainMap(("P",), axis, axis, rates, rates, axis[::2], axis[::2], np.array(grows), 0.005, 60.0, ())


def test_disagreements_are_found():
    rates = np.full((1, 3, 3), -1.0)
    rates[0, 2, 0] = 0.004
    agreeing = made_map([[[False, False], [True, False]]], rates)
    assert (agreeing.disagreements, agreeing.band) == ((), 0.0)
    assert "None disagrees" in agreeing.sentence
    other = made_map([[[False, False], [False, True]]], rates)
    found = {(d.kp, d.kv): (d.growth_rate, d.grows) for d in other.disagreements}
    assert found == {(1.0, 3.0): (0.004, False), (3.0, 3.0): (-1.0, True)}
    assert other.band == 1.0


@pytest.mark.parametrize(
    ("intervals", "text"),
    [
        ((), "none from 10 to 1e+09"),
        (((10.0, 500.0),), "from 10, as low as was looked, up to 500"),
        (((10.0, 1e9),), "from 10, as low as was looked, up to 1e+09, as far as was looked"),
        (((20.0, 30.0), (40.0, 1e9)), "from 20 up to 30; from 40 up to 1e+09, as far as was looked"),
    ],
)
def test_border_in_words(intervals, text):
    border = StabilityBorder(intervals, (10.0, 1e9), 2e3, ratio=False)
    assert BorderRow("P", "Kv = 2000", "rk4", border, None).text == text


def test_findings_follow_the_numbers(loops, gain_map):
    assert loop_findings.better_convergence(loops).holds
    calm = dataclasses.replace(loops.rows[0], run=loops.rows[1].run)
    assert not loop_findings.better_convergence(dataclasses.replace(loops, rows=(calm, *loops.rows[1:]))).holds
    swapped = {WITH: loops.adjustment[WITHOUT], WITHOUT: loops.adjustment[WITH]}
    assert loop_findings.stability_by_moving(loops).holds
    assert not loop_findings.stability_by_moving(dataclasses.replace(loops, adjustment=swapped)).holds
    step = loop_findings.integration_step(loops, gain_map)
    assert not step.holds
    assert step.numbers["B"]["accurate"][0] == pytest.approx(-0.0078, abs=5e-5)
    assert step.numbers["B"]["stated"][0] == pytest.approx(-0.0297, abs=5e-5)
    exact = tuple(dataclasses.replace(row, stated=row.accurate) for row in loops.rows)
    assert loop_findings.integration_step(dataclasses.replace(loops, rows=exact), gain_map).holds
    assert loop_findings.higher_gain(loops, gain_map).holds
    assert "2 Kv/T = 8e+05" in loop_findings.higher_gain(loops, gain_map).sentence
    free = StabilityBorder(((10.0, 1e9),), (10.0, 1e9), 2e3, ratio=False)
    unbounded = tuple(dataclasses.replace(row, border=free, frequency_hz=None) for row in gain_map.borders)
    other = dataclasses.replace(gain_map, borders=unbounded)
    assert not loop_findings.stable_at_high_margin(gain_map).holds
    assert loop_findings.stable_at_high_margin(other).holds
    assert not loop_findings.higher_gain(loops, other).holds
    assert loop_findings.robust_controller(loops, gain_map).holds
    weak = dataclasses.replace(loops.robust[1], linear=loops.robust[0].linear)
    failed = dataclasses.replace(loops, robust=(loops.robust[0], weak))
    assert not loop_findings.robust_controller(failed, gain_map).holds


def test_pictures_show_the_results(loops, gain_map):
    for figure, runs in (
        (plot_trajectories(loops.figure9), loops.figure9),
        (plot_trajectories(loops.adjustment), loops.adjustment),
    ):
        quantities = [run.error.T for run in runs.values()], [run.deflection.T for run in runs.values()]
        panels = [np.stack(rows) for group in quantities for rows in zip(*group, strict=True)]
        for axes, rows in zip(figure.axes, panels, strict=True):
            for line, run, values in zip(axes.lines, runs.values(), rows, strict=True):
                time, drawn = thinned(run.time, 1e3 * values)
                np.testing.assert_array_equal(line.get_xdata(), time)
                np.testing.assert_array_equal(line.get_ydata(), drawn)
    position, _, objective = draw.plot_figure10(loops.stopped, loops.climb).axes[1:]
    for line, way in zip(position.lines, (loops.climb, loops.stopped), strict=True):
        np.testing.assert_array_equal(line.get_ydata(), thinned(way.time, way.base[:, 0])[1])
    assert objective.lines[0].get_ydata()[-1] == loops.climb.V[-1]
    planes = draw.plot_gains(gain_map, loops.pairs, kv=KV_HELD, ratios=RATIOS).axes
    for k, name in enumerate(gain_map.names):
        np.testing.assert_array_equal(planes[k].collections[0].get_array(), -gain_map.growth_rate[k])
        lines = {line.get_label(): line for line in planes[k].lines}
        crosses = lines["run and eigenvalues differ"]
        assert list(zip(crosses.get_xdata(), crosses.get_ydata(), strict=True)) == [
            (d.kp, d.kv) for d in gain_map.disagreements if d.stand == name
        ]
        assert len(lines["run grows"].get_xdata()) == gain_map.grows[k].sum()
        assert list(lines["gains of the other figures"].get_xdata()) == [1e5, 1e4]


def test_documents(loops, gain_map):
    document = json_ready(loops.to_dict())
    assert set(document) == {
        "stated", "postures", "loops", "figure10", "figures11and12", "second_gains_adjustment", "adjustment_from_rest",
        "robust_controller_at_A", "sentence",
    }  # fmt: skip
    stated = document["stated"]
    assert (stated["kp"], stated["kv"], stated["offset"], stated["integrator"]) == (1e5, 2e3, [0.05, -0.05], "rk4")
    assert stated["base_range"] == [-1.5, 0.0]
    assert document["figure10"]["stopped"]["base"][-1] == [-1.5]
    assert document["figure10"]["unlimited"]["workspace_x_end"] == pytest.approx(2.145, abs=1e-3)
    assert [row["run"]["verdict"] for row in document["loops"]] == ["grows", "converges", "converges"] * 2
    plane = json_ready(gain_map.to_dict())
    assert set(plane) == {
        "postures", "kp", "kv", "growth_rate", "stated_growth_rate", "integrator", "tested_kp", "tested_kv", "grows",
        "offset", "duration", "disagreements", "hidden", "band", "borders", "sentence",
    }  # fmt: skip
    assert np.shape(plane["growth_rate"]) == (3, gains.POINTS, gains.POINTS)
    assert plane["band"] == max(abs(d.growth_rate) for d in gain_map.own_disagreements)
    json.dumps([document, plane], allow_nan=False)


@pytest.mark.long
def test_computed_twice_alike(stands, monkeypatch):
    """That runs are, test_figure_9 asks."""
    monkeypatch.setattr(gains, "POINTS", 5)
    monkeypatch.setattr(gains, "RATIOS", ())
    one, two = (gains.map_gains(MACHINE, stands, STATED) for _ in range(2))
    assert json_ready(one.to_dict()) == json_ready(two.to_dict())
