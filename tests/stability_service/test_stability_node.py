"""The stability node as a real process: its services, its parameters, what it refuses."""

import csv
import math

import numpy as np
import pytest
import ros_harness
from paper import tension
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParameters
from scipy.optimize import brentq
from tss_interfaces.msg import FloquetResult
from tss_interfaces.srv import ComputeFloquet, ComputeGrowth, FindCriticalRates

from tss_ros.core import Propagator, compute_floquet, lyapunov_exponents, tether_state
from tss_ros.scenarios import scenario

# Table 1 of the paper, worked out here and not by the package.
ORBIT_RATE = math.sqrt(3.986e14 / 7378e3**3)


@pytest.fixture(scope="module")
def asked(tmp_path_factory):
    """A running stability node and a way to call its services: `asked(type, name, request)`."""
    directory = tmp_path_factory.mktemp("stability")
    with (
        ros_harness.processes(directory) as start,
        ros_harness.client_node() as (node, spin_until),
    ):
        process = start("stability_node", satellite_mass_kg=120)

        def ask(service_type, name, request):
            response = ros_harness.call(
                node, spin_until, service_type, f"/stability_node/{name}", request
            )
            assert process.running
            return response

        yield ask
        assert process.stop() == 0, process.stderr
        assert "Traceback" not in process.stderr


def compute(asked, rates, method="", fields=None, **overrides):
    """Ask for multipliers; overrides are ParameterValue or float, `fields` other fields."""
    request = ComputeFloquet.Request(spin_rate_ratio=rates, method=method, **(fields or {}))
    request.overrides = messages(overrides)
    return asked(ComputeFloquet, "compute_floquet", request)


def find(asked, ratio_from, ratio_to, tolerance=0.005, **overrides):
    """Ask for critical rates; overrides are ParameterValue or float."""
    request = FindCriticalRates.Request(
        spin_rate_ratio_from=ratio_from, spin_rate_ratio_to=ratio_to, tolerance=tolerance
    )
    request.overrides = messages(overrides)
    return asked(FindCriticalRates, "find_critical_rates", request)


def messages(overrides):
    return [
        Parameter(
            name=name,
            value=value
            if isinstance(value, ParameterValue)
            else ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value),
        )
        for name, value in overrides.items()
    ]


def integer(value):
    return ParameterValue(type=ParameterType.PARAMETER_INTEGER, integer_value=value)


def doubles(*values):
    return ParameterValue(
        type=ParameterType.PARAMETER_DOUBLE_ARRAY, double_array_value=[float(v) for v in values]
    )


def text(value):
    return ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=value)


def test_parameters_describe_themselves_and_refuse_changes(asked):
    names = ["scenario", "satellites", "satellite_mass_kg", "orbit_altitude_m"]
    described = asked(
        DescribeParameters, "describe_parameters", DescribeParameters.Request(names=names)
    ).descriptors
    scenario, satellites, mass, altitude = described
    assert all(d.read_only and d.description and d.additional_constraints for d in described)
    assert "[kg]" in mass.description and "[m]" in altitude.description
    assert satellites.integer_range[0].from_value == 2
    assert altitude.floating_point_range[0].from_value == 0.0
    values = asked(GetParameters, "get_parameters", GetParameters.Request(names=names)).values
    assert values[0].string_value == "three_star"
    assert values[1].integer_value == 3  # the scenario's
    assert values[2].double_value == 120.0  # given as a whole number
    change = Parameter(name="satellites", value=integer(4))
    (result,) = asked(
        SetParameters, "set_parameters", SetParameters.Request(parameters=[change])
    ).results
    assert not result.successful and "read-only" in result.reason


def test_answers_come_in_the_order_of_the_rates(asked):
    rates = [-2.5, 1.5, -3.0]
    for method in ("", "monodromy", "frozen"):
        response = compute(asked, rates, method)
        assert response.success, response.message
        assert [result.spin_rate_ratio for result in response.results] == rates
        for rate, result in zip(rates, response.results):
            assert result.verdict
            assert result.spin_rate_rad_s == pytest.approx(rate * ORBIT_RATE, rel=1e-12)
            assert result.period_s == pytest.approx(2 * math.pi / abs(rate) / ORBIT_RATE, rel=1e-12)
            multiplier = np.array(result.multiplier_real) + 1j * np.array(result.multiplier_imag)
            assert len(multiplier) == len(result.family) == 18
            assert result.max_modulus == pytest.approx(np.abs(multiplier).max(), rel=1e-12)


def test_certificates_are_small_and_can_be_left_out(asked):
    (certified,) = compute(asked, [-2.5]).results
    (plain,) = compute(asked, [-2.5], fields={"certify": False}).results
    for name in ("trivial", "flow", "det_z"):
        assert 0.0 <= getattr(certified, f"{name}_error") < 1e-6
        assert getattr(plain, f"{name}_error") == getattr(certified, f"{name}_error")
    for name in ("segment", "convergence", "liouville"):
        assert 0.0 <= getattr(certified, f"{name}_error") < 1e-6
        assert math.isnan(getattr(plain, f"{name}_error"))
    assert plain.multiplier_real == certified.multiplier_real
    assert not certified.confirmation


def test_a_simulation_confirms_the_verdicts(asked):
    # Strong damping keeps the tethers taut where the axis tilts over: growth is a multiplier's.
    fields = {"confirm_turns": 12, "confirm_disturbance_m": 5.0}
    response = compute(asked, [-2.5, -2.0], fields=fields, damping_n_s_per_m=1450.0)
    tilting = compute(asked, [-1.9], fields=fields, damping_n_s_per_m=5000.0)
    assert response.success and tilting.success
    stable, lost, tilted = *response.results, *tilting.results
    assert stable.verdict == "asymptotically stable" and stable.confirmation[0].held
    assert stable.confirmation[0].turns_to_settle < 12
    assert lost.verdict in ("unstable", "none found") and not lost.confirmation[0].held
    assert tilted.verdict == "unstable" and tilted.max_modulus_nontrivial > 1.05
    for result in (stable, tilted):
        growth = result.confirmation[0].growth_per_turn
        assert growth == pytest.approx(result.max_modulus_nontrivial, rel=0.02)
    again = compute(asked, [-2.5], fields=fields, damping_n_s_per_m=1450.0).results[0]
    other = compute(asked, [-2.5], fields={**fields, "confirm_seed": 1}, damping_n_s_per_m=1450.0)
    assert str(again.confirmation) == str(stable.confirmation)
    assert str(other.results[0].confirmation) != str(stable.confirmation)
    frozen = compute(asked, [-2.5], "frozen", fields)
    assert "confirm_turns has no effect" in frozen.message and not frozen.results[0].confirmation


def test_the_mode_that_decided_comes_with_its_motion_if_asked_for(asked):
    """Over a turn a mode is multiplied by its multiplier, whatever it does meanwhile."""
    fields = {"mode_samples": 12}
    (result,) = compute(asked, [-2.8], fields=fields, satellites=integer(6)).results
    (mode,) = result.mode
    rho = complex(mode.multiplier_real, mode.multiplier_imag)
    assert abs(rho) == pytest.approx(result.deciding_modulus) and abs(rho) > 1.05
    assert (mode.family, mode.direction, mode.wave_number) == ("axis tilt", "out of plane", 1)
    assert mode.resonance.endswith("frequencies add up to twice the spin")
    shape = np.array(mode.shape_real) + 1j * np.array(mode.shape_imag)
    shape = shape.reshape(13, 6, 3)
    np.testing.assert_allclose(shape[-1], rho * shape[0], atol=1e-6)
    position = np.reshape(mode.position_m, (13, 6, 3))
    assert np.abs(position - position[0]).max() < 0.2 * np.abs(position).max()
    assert len(mode.tether_ends) == 12
    (plain,) = compute(asked, [-2.5]).results
    assert not plain.mode


@pytest.mark.parametrize(
    ("rates", "fields", "satellites", "expected"),
    [
        (1, {"confirm_turns": 1001}, 3, ("confirm_turns is 1001", "0 to 1000")),
        (1, {"confirm_turns": 334}, 30, ("confirm_turns is 334", "0 to 333")),
        (134, {"confirm_turns": 1000}, 3, ("134 rates", "1 to 133 for 3 beads and 1000 turns")),
        (30_001, {"certify": False}, 3, ("30001 rates", "1 to 30000")),
        *(
            (
                1,
                {"confirm_turns": 8, "confirm_disturbance_m": value},
                3,
                (f"confirm_disturbance_m is {value}", "1e-06 to 1000000"),
            )
            for value in (math.nan, math.inf, 0.0, -1.0, 2e6)
        ),
    ],
)
def test_a_wrong_confirmation_is_refused_in_words(asked, rates, fields, satellites, expected):
    response = compute(asked, [-2.5] * rates, "", fields, satellites=integer(satellites))
    assert not response.success and len(response.results) == 0
    assert all(part in response.message for part in expected), response.message


def test_the_client_shows_and_writes_errors_and_confirmations(asked, tmp_path):
    arguments = ["-2.5", "-3", "--confirm", "8", "--csv", "a.csv"]
    client = ros_harness.Process("stability", tmp_path, arguments)
    assert client.wait(ros_harness.START_S) == 0, client.stderr
    heading, *lines = client.stdout.splitlines()
    shown = heading.split("closure")[1].split()
    assert shown == ["error", "held", "settled", "[turns]", "growth", "message"]
    with (tmp_path / "a.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(lines) == len(rows) == 2
    fields = {"confirm_turns": 8}
    for line, row, result in zip(lines, rows, compute(asked, [-2.5, -3.0], "", fields).results):
        (confirmation,) = result.confirmation
        assert row["confirmation_held"] == "True" and " True " in line
        assert float(row["confirmation_growth_per_turn"]) == confirmation.growth_per_turn
        assert f"{confirmation.growth_per_turn:.6f}" in line
        assert float(row["segment_error"]) == result.segment_error
        worst = max(
            result.trivial_error,
            result.flow_error,
            result.segment_error,
            result.convergence_error,
            result.liouville_error,
        )
        assert float(row["error"]) == worst and f" {worst:.1e} " in line
    without = ros_harness.Process("stability", tmp_path, ["-2.5", "--method", "frozen"])
    assert without.wait(ros_harness.START_S) == 0, without.stderr
    heading, line = without.stdout.splitlines()
    assert "held" not in heading and " nan" not in line and " - " in line


def test_overrides_replace_the_nodes_own_parameters(asked):
    response = compute(
        asked, [-2.5], satellites=integer(4), satellite_mass_kg=doubles(110, 110, 110, 110)
    )
    assert response.success and len(response.results[0].multiplier_real) == 24
    own, same, other = (
        compute(asked, [-2.5], **overrides).results[0].multiplier_real.tolist()
        for overrides in ({}, {"satellite_mass_kg": integer(120)}, {"satellite_mass_kg": 60.0})
    )
    assert own == same and own != other
    remark = compute(asked, [-2.5], spin_rate_ratio=-3.0)
    assert remark.success and "spin_rate_ratio" in remark.message


def test_results_name_their_law_and_how_often_taut_tethers_push(asked):
    own = compute(asked, [-2.5, 0.0], satellite_mass_kg=100.0).results
    pulling = compute(asked, [-3.5, 0.0], tether_law=text("tension_only")).results
    stiffening = compute(asked, [-3.5], tether_law=text("stiffening"), stiffening=10.0).results
    frozen = compute(asked, [-2.5], "frozen", tether_law=text("kelvin_voigt")).results
    laws = [result.tether_law for result in (*own, *pulling, *stiffening, *frozen)]
    assert laws == [*["kelvin_voigt"] * 2, *["tension_only"] * 2, "stiffening", "kelvin_voigt"]
    # The same turn, integrated and counted here.
    system = scenario.load("three_star").build()
    state = compute_floquet(system, -2.5, certify=False).state
    turn = Propagator(system, -2.5, state).sample(np.linspace(0.0, own[0].period_s, 2001)[:-1])
    _, tension_n, taut = tether_state(system, *turn)
    assert own[0].pushing_share == pytest.approx(np.sum(tension_n < 0) / np.sum(taut), abs=5e-3)
    assert own[0].pushing_share > 0.05 and math.isnan(own[1].pushing_share)
    assert pulling[0].pushing_share == stiffening[0].pushing_share == 0.0


def test_critical_rates_name_their_law(asked):
    # Tethers that only pull are let go and caught again at rates where damping holds others taut.
    request = {"satellite_mass_kg": 100.0, "damping_n_s_per_m": 1450.0}
    for law in ("kelvin_voigt", "tension_only"):
        response = find(asked, -2.3, -1.9, 0.05, tether_law=text(law), **request)
        assert response.success, response.message
        assert all(rate.tether_law == law for rate in response.rates)


@pytest.mark.parametrize(
    ("rate", "expected"),
    [(math.nan, "nan"), (math.inf, "inf"), (1e-4, "0.0001"), (1e9, "1e+09")],
    ids=["NaN", "infinite", "tiny", "huge"],
)
def test_a_wrong_rate_spoils_only_its_own_result(asked, rate, expected):
    response = compute(asked, [-2.5, rate, -3.0])
    assert response.success
    good, bad, also_good = response.results
    assert good.verdict and also_good.verdict
    assert "spin_rate_ratio" in bad.message and expected in bad.message
    assert bad.verdict == "" and len(bad.multiplier_real) == 0 and math.isnan(bad.max_modulus)


@pytest.mark.parametrize(
    ("rates", "method", "overrides", "expected"),
    [
        ([], "", {}, ("spin_rate_ratio", "0 rates", "1 to 10000")),
        ([-2.5] * 10_001, "", {}, ("spin_rate_ratio", "10001 rates", "10000")),
        ([-2.5] * 11, "", {"satellites": integer(30)}, ("11 rates", "1 to 10 for 30 beads")),
        ([-2.5], "exact", {}, ("method", "'exact'", "frozen")),
        ([-2.5], "", {"satellite_mass_kg": -1.0}, ("satellite_mass_kg", "-1", "0.001")),
        ([-2.5], "", {"satellite_mass_kg": math.nan}, ("satellite_mass_kg", "nan")),
        ([-2.5], "", {"satellite_mass_kg": doubles(1, 2)}, ("satellite_mass_kg", "2", "3")),
        ([-2.5], "", {"satellite_mass_kg": doubles(1, -2, 3)}, ("satellite_mass_kg[1]", "-2")),
        ([-2.5], "", {"satellite_mass_kg": text("heavy")}, ("satellite_mass_kg", "'heavy'")),
        ([-2.5], "", {"satellite_mass_kg": ParameterValue()}, ("satellite_mass_kg", "nothing")),
        ([-2.5], "", {"satellite_mass_kg": ParameterValue(type=77)}, ("satellite_mass_kg", "77")),
        ([-2.5], "", {"satellites": integer(1_000_000)}, ("satellites", "1000000", "2 to 1000")),
        ([-2.5], "", {"satellites": integer(101)}, ("satellites", "101", "100")),
        ([-2.5], "", {"satellites": 3.0}, ("satellites", "3.0", "whole number")),
        ([-2.5], "", {"orbit_altitude_m": math.inf}, ("orbit_altitude_m", "inf", "1000000000")),
        (
            [-2.5],
            "",
            {"tether_law": text("kelvin")},
            ("tether_law is 'kelvin'", "kelvin_voigt, tension_only", "did you mean"),
        ),
        ([-2.5], "", {"tether_law": 2.0}, ("tether_law is 2.0", "one of kelvin_voigt")),
        ([-2.5], "", {"j2": -1.0}, ("j2 is -1.0", "a number from 0")),
        ([-2.5], "", {"stiffening": 2.0}, ("only tether_law stiffening uses",)),
        ([-2.5], "", {"mass": 2.0}, ("'mass'", "satellite_mass_kg")),
        ([-2.5], "", {"scenario": text("six_bead")}, ("'scenario'", "satellites")),
    ],
)
def test_a_wrong_request_is_refused_in_words(asked, rates, method, overrides, expected):
    response = compute(asked, rates, method, **overrides)
    assert not response.success and len(response.results) == 0
    assert all(part in response.message for part in expected), response.message
    assert compute(asked, [-2.5]).success


def test_an_override_given_twice_is_refused(asked):
    value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=1.0)
    twice = [Parameter(name="bead_mass_kg", value=value)] * 2
    request = ComputeFloquet.Request(spin_rate_ratio=[-2.5], overrides=twice)
    response = asked(ComputeFloquet, "compute_floquet", request)
    assert not response.success and "'bead_mass_kg' is given twice" in response.message


@pytest.mark.parametrize("ends", [(-2.4, -1.9), (-1.9, -2.4)], ids=["up", "down"])
def test_tethers_first_go_slack_where_the_closed_form_says(asked, ends):
    edge = brentq(tension, -2.4, -1.9, args=(1450.0,))
    assert edge == pytest.approx(-2.17, abs=0.005)
    response = find(asked, *ends, satellite_mass_kg=100.0)
    assert response.success and response.message == ""
    first, *rest = response.rates
    assert first.cause == "first slack" and first.stable_side == -1
    assert 0.0 < first.uncertainty <= 0.005
    assert first.spin_rate_ratio == pytest.approx(edge, abs=first.uncertainty + 0.001)
    assert all(rate.spin_rate_ratio > first.spin_rate_ratio for rate in rest)


def test_with_strong_damping_the_tilting_axis_ends_stability_at_two(asked):
    assert tension(-2.0, 3000.0) > 0.0
    request = {"satellite_mass_kg": 100.0, "damping_n_s_per_m": 3000.0}
    coarse, default = (
        find(asked, -2.4, -1.9, tolerance, **request).rates for tolerance in (0.005, 0.0)
    )
    for rates, tolerance in ((coarse, 0.005), (default, 0.001)):
        (edge,) = rates
        assert edge.cause == "axis tilt" and edge.stable_side == -1
        assert edge.uncertainty <= tolerance
        assert edge.spin_rate_ratio == pytest.approx(-2.0, abs=tolerance)


def test_a_search_remarks_on_what_it_left_out(asked):
    response = find(asked, -0.01, 0.02, spin_rate_ratio=-3.0)
    assert response.success and len(response.rates) == 0
    assert "slower than 0.05" in response.message and "overrides" in response.message


@pytest.mark.parametrize(
    ("request_", "overrides", "expected"),
    [
        ((math.nan, -2.0), {}, ("spin_rate_ratio_from is nan", "-10000 to 10000")),
        ((-2.0, math.inf), {}, ("spin_rate_ratio_to is inf", "-10000 to 10000")),
        ((-2.0, 1e5), {}, ("spin_rate_ratio_to is 100000.0", "-10000 to 10000")),
        ((-2.0, -2.0), {}, ("spin_rate_ratio_from", "0 apart", "more than 0, at most 20")),
        ((-20.0, 20.0), {}, ("spin_rate_ratio_from", "40 apart", "at most 20 for 3 beads")),
        ((-3.0, -2.0), {"satellites": integer(30)}, ("1 apart", "at most 0.02 for 30 beads")),
        ((-3.0, -2.0, -0.01), {}, ("tolerance is -0.01", "1e-06 to 0.1")),
        ((-3.0, -2.0, 1e-9), {}, ("tolerance is 1e-09", "1e-06 to 0.1")),
        ((-3.0, -2.0, math.nan), {}, ("tolerance is nan", "1e-06 to 0.1")),
        ((-3.0, -2.0), {"mass": 2.0}, ("'mass'", "satellite_mass_kg")),
        ((-3.0, -2.0), {"satellites": integer(101)}, ("satellites", "101", "100")),
    ],
)
def test_a_wrong_search_is_refused_in_words(asked, request_, overrides, expected):
    response = find(asked, *request_, **overrides)
    assert not response.success and len(response.rates) == 0
    assert all(part in response.message for part in expected), response.message
    assert find(asked, -2.6, -2.5).success


def test_a_search_waits_for_a_computation_and_ends_with_the_node(tmp_path):
    with (
        ros_harness.processes(tmp_path) as start,
        ros_harness.client_node() as (node, spin_until),
    ):
        process = start("stability_node", "-r", "__ns:=/queue")
        prefix = "/queue/stability_node/"
        compute = node.create_client(ComputeFloquet, prefix + "compute_floquet")
        search = node.create_client(FindCriticalRates, prefix + "find_critical_rates")
        for client in (compute, search):
            spin_until(client.service_is_ready, ros_harness.START_S, "the services")
        begun = []
        node.create_subscription(FloquetResult, "/queue/stability_results", begun.append, 100)
        first = compute.call_async(ComputeFloquet.Request(spin_rate_ratio=[-2.5] * 40))
        spin_until(lambda: begun, 30, "a first result")
        second = search.call_async(
            FindCriticalRates.Request(spin_rate_ratio_from=-2.3, spin_rate_ratio_to=-2.2)
        )
        spin_until(lambda: first.done() or second.done(), 60, "an answer")
        assert first.done() and first.result().success
        spin_until(second.done, 60, "the other answer")
        assert second.result().success
        search.call_async(
            FindCriticalRates.Request(spin_rate_ratio_from=-10.0, spin_rate_ratio_to=10.0)
        )
        process.wait_for_line("% of the interval searched")
        assert process.stop() == 0, process.stderr
    assert "Traceback" not in process.stderr


def test_a_long_request_blocks_neither_parameters_nor_the_end(tmp_path):
    with (
        ros_harness.processes(tmp_path) as start,
        ros_harness.client_node() as (node, spin_until),
    ):
        process = start("stability_node", "-r", "__ns:=/busy")
        client = node.create_client(ComputeFloquet, "/busy/stability_node/compute_floquet")
        spin_until(client.service_is_ready, ros_harness.START_S, "the service")
        rates = np.linspace(-3.5, -1.5, 10_000).tolist()
        answer = client.call_async(ComputeFloquet.Request(spin_rate_ratio=rates))
        request = GetParameters.Request(names=["scenario"])
        values = ros_harness.call(
            node,
            spin_until,
            GetParameters,
            "/busy/stability_node/get_parameters",
            request,
            timeout_s=5,
        ).values
        assert values[0].string_value == "three_star" and not answer.done()
        assert process.stop() == 0, process.stderr
    assert "Traceback" not in process.stderr


# --- growth


def grow(asked, rates, overrides=None, **fields):
    request = ComputeGrowth.Request(spin_rate_ratio=rates, overrides=messages(overrides or {}))
    for name, value in fields.items():
        setattr(request, name, value)
    return asked(ComputeGrowth, "compute_growth", request)


def test_growth_on_an_ellipse_is_that_of_the_core(asked):
    answer = grow(asked, [-2.9, -1.9], {"eccentricity": 0.1}, turns=40, count=3)
    assert answer.success and not answer.message
    system = scenario.load("three_star").build({"satellite_mass_kg": 120.0, "eccentricity": 0.1})
    for result in answer.results:
        expected = lyapunov_exponents(system, result.spin_rate_ratio, 40, 3)
        assert result.verdict == expected.verdict and result.turns == 40
        assert result.turn_s == expected.turn_s and result.switches == expected.switches
        for name in ("exponent_per_s", "error_per_s", "history_per_s"):
            found = np.reshape(getattr(result, name), getattr(expected, name).shape)
            np.testing.assert_array_equal(found, getattr(expected, name))
        assert list(result.position_m) == expected.state.position_m.ravel().tolist()


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"turns": 5}, "turns is 5; allowed: "),
        ({"count": 0}, "count is 0; allowed: a whole number from 1 to 18"),
        ({"count": 19}, "count is 19; allowed: a whole number from 1 to 18"),
        ({"turns": 60_000}, "turns is 60000 and count 2; allowed: a rate or more, and rates times"),
        ({"rates": []}, "spin_rate_ratio has 0 rates"),
        ({"position_m": [1.0]}, "position_m has 1 numbers; allowed: 9"),
    ],
)
def test_questions_about_growth_that_are_refused(asked, fields, said):
    answer = grow(asked, fields.pop("rates", [-2.9]), **fields)
    assert not answer.success and said in answer.message and not answer.results


def test_a_rate_whose_growth_cannot_be_told_says_why(asked):
    answer = grow(asked, [math.nan, -2.9], turns=16)
    assert answer.success
    failed, found = answer.results
    assert "spin_rate_ratio" in failed.message and "nan" in failed.message
    assert not failed.verdict and not failed.exponent_per_s and math.isnan(failed.turn_s)
    assert found.verdict == "no growth seen" and len(found.exponent_per_s) == 2
