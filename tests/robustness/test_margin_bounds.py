"""ε_max and its gradient within their bounds, against 420-bit arithmetic; the words where there is no number.

The full run, 200 machines, is `python -m benchmarks.margin_accuracy`.
"""

from __future__ import annotations

import json
import re
import warnings

import numpy as np
import pytest

import flexopt
from flexopt.compiled.extended import digits, exact, extended, rounded
from flexopt.errors import FlexoptWarning
from flexopt.robustness.margin import build_margin
from flexopt.robustness.posture_margin import evaluate_margin
from flexopt.study.maps.points import evaluate_points
from tests.oracles.high_precision import compare
from tests.oracles.margin_cases import margin_case
from tests.oracles.spatial import grounded

# Ordinary ones in the plane and in space, each extreme kind, each controller; in 17, 28 and 93 the free motion of a
# redundant arm is damped at some joints only, in 71 the modes overflow in doubles.
CASES = [0, 2, 3, 7, 9, 11, 12, 15, 17, 19, 23, 27, 28, 31, 39, 43, 47, 71, 93]


@pytest.mark.long("2")
@pytest.mark.parametrize("k", CASES)
def test_every_number_is_within_its_bound(k):
    case = margin_case(k)
    compared = compare(case.margin, case.base, case.posture, case.kr, k)
    assert compared.complete, compared.found.warning
    assert compared.within
    # The bound is worth something, too; what data in doubles are worth is part of it.
    assert compared.found.error <= 1e-6 * compared.epsilon
    for value, _, bound in compared.slopes:
        assert bound <= 1e-7 * (abs(value) + 1e-3)


@pytest.mark.parametrize("gravity", [False, True])
@pytest.mark.parametrize("control", ["inverse", "transpose", "damped:0.1"])
@pytest.mark.parametrize(
    ("name", "posture"),
    [
        ("excavator", [0.99, -2.63]),
        ("boom-stick-bucket", [0.7, -1.4, -0.6]),
        ("slewing-excavator", [0.2, 0.5, -1.2, -0.5]),
    ],
)
def test_exact_and_batched_graphs_agree(name, posture, control, gravity):
    machine = flexopt.load(name)
    margin = build_margin(machine, control, gravity)
    base, p, q = np.zeros(len(machine.base_coordinates)), margin.plant.parameter_values, np.array(posture)
    found = evaluate_margin(margin, base, q, 5e5)
    epsilon, rest, residual = (x.full() for x in margin.values.call([base, q, p, 5e5]))
    assert max(rest[0, 0], residual[0, 0]) < 1e-9
    assert found.epsilon_max == pytest.approx(epsilon[0, 0], rel=1e-9)
    by_z, by_p, by_kr = (x.full()[0] for x in margin.gradients.call([base, q, p, 5e5])[1:])
    np.testing.assert_allclose(found.z, by_z, atol=1e-7 * np.abs(by_z).max())
    scaled = by_p * p.full().ravel()
    np.testing.assert_allclose(found.p * p.full().ravel(), scaled, atol=1e-7 * np.abs(scaled).max())
    assert found.kr == pytest.approx(by_kr[0], rel=1e-6, abs=1e-7 * found.epsilon_max / 5e5)


def test_graphs_in_decimals_round_to_those_in_doubles():
    for k in (0, 2, 5, 6):
        case = margin_case(k)
        p = case.margin.plant.parameter_values.full().ravel()
        given = [case.base, case.posture, p, np.zeros(case.margin.plant.n_passive)]
        with digits():
            outputs = [rounded(x) for x in extended(case.margin.plant_at)(*map(exact, given)).outputs]
        for ours, plain in zip(outputs, case.margin.plant_at.call(given), strict=True):
            np.testing.assert_allclose(ours, plain.full(), rtol=1e-9, atol=1e-11 * np.abs(ours).max())


def test_nothing_stabilises_an_undamped_mode_that_nothing_reaches():
    """Lateral rocking of a plane arm that stands upright in space: exactly out of reach, and undamped."""
    data = grounded(3, 0, coupled=False)
    for body in data["bodies"][:6]:
        body["joint"]["damping"] = 0.0
    data["bodies"][5] |= {"com": [0.1, 0.0, 0.4], "inertia": [900.0, 1000.0, 1100.0, 0.0, 0.0, 0.0]}
    # Without a slewing joint all joints turn about y.
    data["bodies"][6]["joint"]["axis"] = [0.0, -1.0, 0.0]
    data["end_point"]["rows"] = ["x", "z"]
    for body in data["bodies"][7:]:
        body["com"] = [0.9, 0.0, 0.1]
    machine = flexopt.tree_from_dict(data)
    with pytest.warns(FlexoptWarning, match="no feedback .* stabilises .* is not reached by any input"):
        result = flexopt.evaluate(machine, [0.3, 0.7, -0.9])
    assert result.epsilon_max is None
    assert result.epsilon_max_status == "not stabilizable"
    assert np.isnan(result.epsilon_max_error)
    document = json.loads(json.dumps(result.to_dict()))
    assert document["epsilon_max"] is None
    assert document["epsilon_max_status"] == result.epsilon_max_status
    # A little damping, and the mode that nothing reaches does not matter.
    for body in data["bodies"][:6]:
        body["joint"]["damping"] = 25.0
    damped = flexopt.evaluate(flexopt.tree_from_dict(data), [0.3, 0.7, -0.9])
    assert 0 < damped.epsilon_max < 1
    assert damped.epsilon_max_status == "computed"


def test_a_mode_that_only_rounding_lets_the_end_point_see():
    """cos(π/2) is 6e-17 in doubles: the arm all but leaves the base alone."""
    data = flexopt.load("excavator").to_dict()
    data["base"] = data["base"] | {"stiffness": {"rotation": 1e6}, "damping": {}, "length": 0.0}
    data["links"] = [link | {"com": 0.0} for link in data["links"]]
    with pytest.warns(FlexoptWarning, match="is not seen in any output"):
        result = flexopt.evaluate(flexopt.machine_from_dict(data), [0.5, np.pi / 2])
    assert result.epsilon_max_status == "not stabilizable"


def test_the_bound_is_printed_and_holds_for_the_digits_printed():
    result = flexopt.evaluate(flexopt.load("excavator"), [0.99, -2.63])
    text, bound = re.search(r"ε_max = (\S+) ± (\S+) at", repr(result)).groups()
    assert abs(float(text) - result.epsilon_max) + result.epsilon_max_error <= float(bound)
    assert result.epsilon_max_error < 1e-12
    assert result.gradient.epsilon_max_error.shape == result.gradient.epsilon_max.shape
    assert np.all(result.gradient.epsilon_max_error <= 1e-12)
    document = json.loads(json.dumps(result.to_dict()))
    assert document["epsilon_max_error"] == result.epsilon_max_error
    assert len(document["gradient"]["epsilon_max_error"]) == len(document["gradient"]["epsilon_max"])


@pytest.mark.parametrize("k", [17, 28])
def test_maps_take_unsure_points_to_the_bounded_way(k):
    """Undamped free motion never leaves the doubling: the batch is not trusted, and the point is done by itself."""
    case = margin_case(k)
    p = case.margin.plant.parameter_values
    rest, residual = (float(x) for x in case.margin.values.call([case.base, case.posture, p, case.kr])[1:])
    assert max(rest, residual) > 1e-9
    machine = case.margin.plant.machine
    with warnings.catch_warnings():
        warnings.simplefilter("error", FlexoptWarning)
        found = evaluate_points(
            machine,
            case.posture[:, None],
            bases=case.base[:, None],
            control=case.margin.control,
            gain=case.kr,
            threads=1,
        )
    exact_one = evaluate_margin(case.margin, case.base, case.posture, case.kr)
    assert found.epsilon_max[0] == exact_one.epsilon_max
