"""The figures show the numbers given, with units, and tell curves apart without colour."""

import io
import subprocess
import sys

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from tss_ros import core, plots
from tss_ros.plots.motions import tension_limit
from tss_ros.plots.style import VERDICT_STYLES
from tss_ros.plots.views import views
from tss_ros.scenarios import scenario

NAMES = ("satellite_1", "satellite_2", "satellite_3", "tether_1_bead_1")
IS_SATELLITE = np.array([True, True, True, False])
ENDS = np.array([[0, 3], [3, 1], [1, 2], [2, 0]])


def spinning_positions(steps=50):
    """Three satellites on a circle of 6 km, clockwise, a bead between two, 2 m off the plane."""
    angle = np.pi / 2 + 2 * np.pi / 3 * np.arange(3) - np.linspace(0, 4, steps)[:, None]
    position_m = np.zeros((steps, 4, 3))
    position_m[:, :3, 0], position_m[:, :3, 1] = 6e3 * np.cos(angle), 6e3 * np.sin(angle)
    position_m[:, 3] = (position_m[:, 0] + position_m[:, 1]) / 2
    position_m[..., 2] = 2.0
    return position_m


def lines(axes):
    """The data of the lines on an axes by label."""
    return {line.get_label(): np.array(line.get_data()).T for line in axes.lines}


def legend_box_clear_of_axes(figure):
    """Whether the legend covers no axes (drawn first, so that the layout is final)."""
    FigureCanvasAgg(figure).draw()
    (legend,) = figure.legends
    box = legend.get_window_extent()
    return not any(box.overlaps(axes.get_window_extent()) for axes in figure.axes)


def test_trajectories_show_paths_and_tethers_in_the_orbit_frame():
    position_m = spinning_positions()
    figure = plots.trajectories(position_m, ENDS, NAMES, IS_SATELLITE)
    plan, edge = figure.axes
    assert "x" in plan.get_xlabel() and "[km]" in plan.get_xlabel()
    assert "y" in plan.get_ylabel() and "[km]" in plan.get_ylabel()
    assert "z" in edge.get_xlabel() and "[m]" in edge.get_xlabel()
    assert plan.get_aspect() == 1
    for i, name in enumerate(NAMES[:3]):
        np.testing.assert_allclose(lines(plan)[name], position_m[:, i, :2] / 1e3)
        np.testing.assert_allclose(lines(edge)[name][:, 0], 2.0)
    bead = position_m[:, 3, :2] / 1e3
    assert any(np.array_equal(np.array(line.get_data()).T, bead) for line in plan.lines)
    for label, step in (("start", 0), ("end", -1)):
        (drawn,) = [xy for name, xy in lines(plan).items() if name.startswith(f"tethers, {label}")]
        pairs = drawn.reshape(len(ENDS), 3, 2)
        np.testing.assert_allclose(pairs[:, :2], position_m[step][ENDS][..., :2] / 1e3)
        assert np.isnan(pairs[:, 2]).all()
    assert legend_box_clear_of_axes(figure)


def test_paths_about_a_tilted_axis_are_seen_along_it_and_from_the_side_with_the_axis():
    """The ring that turns about the normal, tilted by 45 degrees about x, out and back."""
    flat_m, half = spinning_positions(), np.sqrt(0.5)
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, half, half], [0.0, -half, half]])
    axis = tilt @ [0.0, 0.0, 1.0]
    np.testing.assert_allclose(axis, [0.0, half, half])
    figure = plots.trajectories(
        flat_m @ tilt.T, ENDS, NAMES, IS_SATELLITE, "", None, spins_about=axis
    )
    along, side = figure.axes
    for i, name in enumerate(NAMES[:3]):
        path = lines(along)[name]
        np.testing.assert_allclose(path, flat_m[:, i, :2] / 1e3, atol=1e-12)
        np.testing.assert_allclose(lines(side)[name], (flat_m @ tilt.T)[:, i, [2, 1]] / 1e3)
    assert "along the spin axis" in along.get_title() and "across" in side.get_title()
    assert along.get_aspect() == side.get_aspect() == 1
    assert side.get_xlabel() == "z, orbit normal [km]"
    assert side.get_ylabel() == "y, radial, up [km]"
    (drawn,) = [line for line in side.lines if line.get_label() == "spin axis"]
    across, up = drawn.get_xy2()
    assert across == pytest.approx(up) and up > 0.0
    assert "spin axis" not in lines(along)
    assert legend_box_clear_of_axes(figure)


def test_a_chain_that_hangs_is_drawn_in_metres_across_and_kilometres_up():
    position_m = np.zeros((401, 4, 3))
    swing = np.sin(np.linspace(0.0, 12.0, 401))
    position_m[..., 1] = np.linspace(15e3, -15e3, 4)
    position_m[..., 0] = 30.0 * swing[:, None] * [3, 1, -1, -3]
    position_m[..., 2] = 4.0 * swing[:, None] * [3, 1, -1, -3]
    turns = np.linspace(0.0, 4.0, 401)
    figure = plots.trajectories(position_m, ENDS, NAMES, IS_SATELLITE, "", turns, spins_about=None)
    for axes, across, name in zip(figure.axes, (0, 2), "xz", strict=True):
        path = lines(axes)[NAMES[0]]
        last = position_m[turns >= 3.0, 0]
        np.testing.assert_allclose(path, last[:, [across, 1]] / [1.0, 1e3])
        assert axes.get_xlabel().startswith(name) and axes.get_xlabel().endswith("[m]")
        assert "not to scale" in axes.get_title()
        low, high = axes.get_xlim()
        assert high - low < 3.0 * np.ptp(position_m[..., across])
        assert "spin axis" not in lines(axes)
    assert "4 orbits" in figure.get_suptitle() and "turn" not in figure.get_suptitle()


@pytest.mark.parametrize("spins_about", [(0.0, 0.0, 1.0), (0.0, 0.6, 0.8), None])
@pytest.mark.parametrize("gone", [slice(20, 22), slice(None)])
def test_paths_with_steps_that_are_not_finite_are_drawn_where_they_are(spins_about, gone):
    position_m = spinning_positions()
    position_m[gone] = np.nan
    figure = plots.trajectories(
        position_m, ENDS, NAMES, IS_SATELLITE, "", None, spins_about=spins_about
    )
    FigureCanvasAgg(figure).draw()
    low, high = figure.axes[1].get_xlim()
    assert np.isfinite([low, high]).all() and low < high


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, -3, 0.1), (1, 2, 3), (-1, 0.1, 0.2)])
def test_views_are_right_handed_with_what_is_up_above(axis):
    axis = np.array(axis) / np.linalg.norm(axis)
    for view in views(axis):
        np.testing.assert_allclose(view.axes @ view.axes.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(view.axes) == pytest.approx(1.0)
        assert all(view.names) and len(set(view.names)) == 2
    along, side = views(axis)
    np.testing.assert_allclose(along.axes[2], axis)
    assert along.axes[1, 1] > 0.1 or along.axes[1, 2] > 0.1
    np.testing.assert_allclose(side.axes[1], [0.0, 1.0, 0.0])
    assert abs(side.axes[2] @ axis) < 1e-12


def test_satellites_differ_in_more_than_colour():
    figure = plots.trajectories(spinning_positions(), ENDS, NAMES, IS_SATELLITE)
    named = [line for line in figure.axes[0].lines if line.get_label() in NAMES[:3]]
    # The dashes themselves, because get_linestyle() calls every dashed line "--".
    assert len({(line._unscaled_dash_pattern[1] or ()) for line in named}) == 3
    assert len({line.get_marker() for line in named}) == 3


def test_deviation_is_in_per_cent_against_turns_and_from_both_centres():
    turns = np.linspace(0, 8, 100)
    origin = 0.02 * np.sin(turns[:, None] + np.arange(3))
    centre = origin / 50
    figure = plots.deviation(turns, origin, NAMES[:3], centre)
    assert len(figure.axes) == 2
    for axes, values, where in zip(
        figure.axes, (centre, origin), ("centre of mass", "origin"), strict=True
    ):
        assert where in axes.get_ylabel() and "[%]" in axes.get_ylabel()
        for i, name in enumerate(NAMES[:3]):
            expected = np.column_stack([turns, 100 * values[:, i]])
            np.testing.assert_allclose(lines(axes)[name], expected)
    assert "turns" in figure.axes[-1].get_xlabel()
    assert legend_box_clear_of_axes(figure)


@pytest.mark.parametrize(
    ("growth", "size", "words"),
    [(-1.0, 0.01, "settles: 1 % at most"), (0.0, 0.01, "holds"), (0.0, 0.5, "lost")],
)
def test_deviation_says_first_what_became_of_the_shape(growth, size, words):
    turns = np.linspace(0, 8, 801)
    shape = size * np.exp(growth * turns)[:, None]
    drift = 0.05 * np.sin(2 * np.pi * turns)[:, None]
    above, below = plots.deviation(turns, shape + drift, ["a"], shape).axes
    assert words in above.get_title(loc="left")
    assert ("harmless" in below.get_title(loc="left")) == (words != "lost")


@pytest.mark.parametrize(
    ("rests_m", "radius", "words"),
    [
        ([100.0, 9e3, 1e4], [1.0, 90.0, 100.0], "Reels move: radii are up to 100 times those at"),
        ([1e4, 5e3, 100.0], [1.0, 0.5, 0.01], "Reels move: radii are down to 0.01 times those at"),
        ([0.0, 0.0, 1e4], [1.0, 1.0, 3.0], "Reels move: radii are up to 3 times those at"),
        ([1e4, 9.95e3, 1e4], [1.0, 1.0, 3.0], "The shape is lost: it deviates by up to 200%"),
        ([1e4, 0.0, 0.0], [1.0, 1.0, 3.0], "The shape is lost"),
        ([1e4, np.nan, 1e4], [1.0, 1.0, 3.0], "The shape is lost"),
    ],
)
def test_deviation_says_when_reels_move_and_takes_no_cut_for_that(rests_m, radius, words):
    moved, rests_m = np.array(radius)[:, None] - 1.0, np.array(rests_m)[:, None]
    rests_m = np.hstack([rests_m, np.full_like(rests_m, 1e4)])
    above, _ = plots.deviation([0, 1, 2], moved, ["a"], moved, rests_m=rests_m).axes
    assert above.get_title(loc="left").startswith(words)


def test_paths_of_many_turns_are_drawn_in_full_at_both_ends_only():
    position_m, turns = spinning_positions(401), np.linspace(0, 8, 401)
    figure = plots.trajectories(position_m, ENDS, NAMES, IS_SATELLITE, "", turns)
    for axes in figure.axes:
        last = lines(axes)[NAMES[0]]
        np.testing.assert_allclose(last[:, 1], position_m[turns >= 7, 0, 1] / 1e3)
    assert "8 turns" in figure.get_suptitle()


@pytest.mark.parametrize(("spikes", "limit_n"), [(0, np.inf), (3, 6.0)])
def test_spikes_of_tension_are_cut_and_counted_where_they_would_flatten_the_rest(spikes, limit_n):
    turns = np.linspace(0, 8, 1001)
    tension_n = np.full((1001, 2), 2.0)
    for i in range(spikes):
        tension_n[100 * i + 50 : 100 * i + 52, i % 2] = 1e4 * (-1) ** i
    figure = plots.tethers(turns, np.ones_like(tension_n), tension_n, ["a", "b"])
    axes = figure.axes[1]
    assert (axes.get_ylim()[1] < 10.0) and tension_limit(tension_n) == limit_n
    title = axes.get_title(loc="left")
    assert title == ("3 spikes beyond ±6 N cut (triangles), the highest 10,000 N" if spikes else "")


def test_rest_lengths_are_drawn_and_their_work_is_told_where_reels_move():
    turns, lengths = np.linspace(0, 2, 5), np.full((5, 2), 1e4)
    moved = lengths + np.linspace(0.0, 3.0, 5)[:, None] * [0.0, 1.0]
    ends = ["length [m]", "tension [N]"]
    for rests_m, panels in ((None, 2), (lengths, 2), (moved, 3)):
        figure = plots.tethers(turns, lengths, lengths, ["a", "b"], rests_m=rests_m)
        assert [axes.get_ylabel() for axes in figure.axes][:: panels - 1] == ends
        assert len(figure.axes) == panels
        title = plots.balance(turns, np.arange(5.0), lengths, rests_m=rests_m).axes[1].get_title
        assert ("reels do work, too" in title(loc="left")) == (rests_m is moved)
    rests = figure.axes[1]
    assert rests.get_ylabel() == "rest length [m]"
    np.testing.assert_array_equal(rests.lines[1].get_ydata(), moved[:, 1])


def test_a_legend_beside_many_curves_names_some_and_counts_the_others():
    names = [f"tether_{i}" for i in range(50)]
    values = np.ones((2, 50))
    figure = plots.tethers([0, 1], values, values, names)
    assert legend_box_clear_of_axes(figure)
    shown = [text.get_text() for text in figure.legends[0].get_texts()]
    assert shown == [*names[:20], "and 30 more"]


def test_deviation_from_the_origin_alone_has_one_panel():
    assert len(plots.deviation([0, 1], np.zeros((2, 1)), ["a"]).axes) == 1


def test_every_verdict_has_a_marker_of_its_own():
    markers = [VERDICT_STYLES[verdict]["marker"] for verdict in core.VERDICTS]
    assert len(set(markers)) == len(markers) == len(VERDICT_STYLES)


VERDICTS = ["neutral", "unstable", "asymptotically stable", "", "none found"]
RATES, MODULI = [-2.5, -1.5, -3.0, -2.0, -1.0], [1.001, 7.9, 1.0, np.nan, 40.0]


def test_stability_marks_each_rate_by_its_verdict():
    nontrivial = [1.0, 7.9, 0.98, np.nan, 40.0]
    figure = plots.stability(RATES, MODULI, nontrivial, VERDICTS)
    (axes,) = figure.axes
    drawn = lines(axes)
    for verdict in VERDICTS:
        if verdict and verdict != "none found":
            i = VERDICTS.index(verdict)
            np.testing.assert_allclose(drawn[verdict], [[RATES[i], MODULI[i]]])
    markers = [line.get_marker() for line in axes.lines if line.get_label() in VERDICTS]
    assert len(set(markers)) == len(markers) == 3
    np.testing.assert_array_equal(drawn["unit modulus"][:, 1], 1)
    np.testing.assert_array_equal(drawn["all multipliers"][:, 0], sorted(RATES))
    order = np.argsort(RATES)
    np.testing.assert_array_equal(
        drawn["without centre of mass\nand spin"][:, 1],
        np.where(np.equal(VERDICTS, "none found"), np.nan, nontrivial)[order],
    )
    assert axes.get_yscale() == "log"
    assert "ω/Ω" in axes.get_xlabel() and "monodromy" in axes.get_ylabel()
    assert legend_box_clear_of_axes(figure)


RATES_IN_ORDER, FOUND = [-3.0, -2.5, -2.0, -1.5], ["asymptotically stable"] * 2 + ["none found"] * 2


def test_curves_of_multipliers_end_where_motions_do_and_say_where_stability_ends():
    """What a search left at rates without a motion is no multiplier of one."""
    moduli, decided = [1.1, 1.2, 9.0, 1.3], [1e-3, 1e-4, np.nan, np.nan]
    figure = plots.stability(RATES_IN_ORDER, moduli, moduli, FOUND, deciding_modulus=decided)
    (axes,) = figure.axes
    drawn = lines(axes)
    np.testing.assert_array_equal(drawn["all multipliers"][:, 1], [1.1, 1.2, np.nan, np.nan])
    np.testing.assert_array_equal(drawn["asymptotically stable"][:, 1], decided[:2])
    np.testing.assert_array_equal(drawn["no motion found"][:, 0], [-2.0, -1.5])
    assert axes.get_xlim()[0] < -3.0 and axes.get_xlim()[1] > -1.5
    assert len(axes.get_xticks()) > 4
    assert "between -2.5 and -2" in figure.get_suptitle()
    (band,) = [patch for patch in axes.patches if patch.get_label() == "the verdict changes here"]
    assert (band.get_x(), band.get_width()) == (-2.5, 0.5)


def test_known_critical_rates_are_lines_with_their_causes():
    moduli = np.ones(4)
    figure = plots.stability(
        RATES_IN_ORDER, moduli, moduli, FOUND, critical=[(-2.17, "first slack"), (-2.1, "spin")]
    )
    (axes,) = figure.axes
    drawn = lines(axes)
    assert drawn["critical: first slack"][0, 0] == -2.17 and drawn["critical: spin"][0, 0] == -2.1
    assert not axes.patches
    assert "-2.17 (first slack), -2.1 (spin)" in figure.get_suptitle()


def test_a_map_of_values_far_apart_has_a_tick_for_each():
    values = np.array([100.0, 300.0, 1000.0, 3000.0])
    stable = np.array(["asymptotically stable"] * 4)
    nothing = (np.array([]),) * 4
    figure = plots.stability_map("damping", (values, -2 * np.ones(4), stable), nothing)
    (axes,) = figure.axes
    assert axes.get_xscale() == "log"
    np.testing.assert_array_equal(axes.get_xticks(), values)
    assert "4 of 4 motions are asymptotically stable" in figure.get_suptitle()
    stable[1] = "none found"
    figure = plots.stability_map("damping", (values, -2 * np.ones(4), stable), nothing)
    assert figure.get_suptitle().startswith("3 of 3 motions are asymptotically stable; none found")


def test_moduli_over_a_parameter_have_a_curve_for_each_rate():
    values = np.array([30000.0, 0.0, 300.0])  # in any order
    moduli = np.array([[0.9, 1.0, 0.5], [np.nan, 1.2, 0.7], [np.nan] * 3])
    verdict = np.array(
        [["asymptotically stable", "neutral", "asymptotically stable"],
         ["none found", "unstable", "asymptotically stable"], ["none found"] * 3], dtype=object,
    )  # fmt: skip
    rates = np.array([-3.0, -2.5, -2.0])
    figure = plots.stability_over_parameter("damping", values, rates, moduli, verdict)
    FigureCanvasAgg(figure).draw()
    (axes,) = figure.axes
    drawn = lines(axes)
    np.testing.assert_array_equal(drawn["ω/Ω = -3"].T, [[0.0, 300.0, 30000.0], [1.0, 0.5, 0.9]])
    np.testing.assert_array_equal(drawn["ω/Ω = -2.5"][:, 1], [1.2, 0.7, np.nan])
    assert "ω/Ω = -2 (none found)" in drawn
    np.testing.assert_array_equal(axes.get_xticks(), [0.0, 300.0, 30000.0])
    assert axes.get_xlim()[0] > -200.0
    title = figure.get_suptitle()
    assert title.startswith("3 of 5 motions are asymptotically stable; none found at 4 of 9 points")
    assert "the least modulus is 0.5, at 300 and -3 Ω" in title


def test_stability_of_like_moduli_is_drawn_on_a_plain_scale():
    figure = plots.stability([-3, -2], [1.000001, 1.000002], [1, 1], ["neutral"] * 2, "frozen")
    assert figure.axes[0].get_yscale() == "linear"
    FigureCanvasAgg(figure).draw()
    # An offset such as "+1" above the axis is easily overlooked.
    assert figure.axes[0].yaxis.get_major_formatter().get_offset() == ""
    assert "frozen" in figure.axes[0].get_ylabel()


def test_stability_survives_rates_that_all_failed():
    figure = plots.stability([-2.0], [np.nan], [np.nan], [""])
    figure.savefig(io.BytesIO())


@pytest.mark.parametrize("suffix", ["png", "pdf", "svg"])
def test_figures_need_neither_screen_nor_pyplot(suffix):
    program = (
        "import io, sys; from tss_ros import plots\n"
        f"plots.deviation([0, 1], [[0.0], [0.1]], ['a']).savefig(io.BytesIO(), format={suffix!r})\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_a_mode_is_drawn_from_turn_to_turn_as_its_multiplier_says():
    """A pair out of its plane, twice a turn, that grows by 1.4 a turn."""
    turns = np.linspace(0.0, 1.0, 25)
    place = np.tile([[0.0, 5e3, 0.0], [0.0, -5e3, 0.0]], (25, 1, 1))
    wave = 1.4**turns * np.exp(4j * np.pi * turns)
    shape = np.zeros((25, 2, 3), complex)
    shape[:, 0, 2], shape[:, 1, 2] = wave, -wave
    mode = plots.shown_mode(turns, place, shape, 1.4, [[0, 1]], "a title")
    assert mode.above and mode.turns[-1] == 3.0
    height = 1.4**mode.turns * np.cos(4 * np.pi * mode.turns)
    np.testing.assert_allclose(mode.shift[:, 0, 2], 0.35 * height / height.max(), atol=1e-9)
    figure = plots.mode_shape(mode)
    formation, curves = figure.axes
    drawn = [np.array(line.get_data()).T for line in curves.lines]
    for i, curve in enumerate(drawn):
        np.testing.assert_allclose(curve, np.stack([mode.turns, mode.shift[:, i, 2]], axis=1))
    assert "height" in curves.get_ylabel() and "turns" in curves.get_xlabel()
    assert figure.get_suptitle() == "a title"
    assert len(formation.lines) > 5
    inside = plots.shown_mode(turns, place, shape[..., [2, 0, 1]], 1.4, [[0, 1]], "in the plane")
    assert not inside.above
    assert "sideways" in plots.mode_shape(inside).axes[1].get_ylabel()
    fast = plots.shown_mode(turns, place, shape, 50.0, [[0, 1]], "")
    assert fast.turns[-1] == 1.0


def test_a_mode_along_a_tilted_axis_is_out_of_the_plane_across_it():
    axis = np.array([0.0, 0.6, 0.8])
    place = np.tile(5e3 * np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]), (25, 1, 1))
    turns = np.linspace(0.0, 1.0, 25)
    shape = np.exp(2j * np.pi * turns)[:, None, None] * np.stack([axis, -axis])
    mode = plots.shown_mode(turns, place, shape, 1.0, [[0, 1]], "", axis)
    formation, curves = plots.mode_shape(mode).axes
    assert mode.above and "plane across the axis" in curves.get_ylabel()
    height = 0.35 * np.cos(2 * np.pi * mode.turns)
    np.testing.assert_allclose(curves.lines[0].get_ydata(), height, atol=1e-12)
    across = np.exp(2j * np.pi * turns)[:, None, None] * np.cross(axis, place)
    inside = plots.shown_mode(turns, place, across, 1.0, [[0, 1]], "", axis)
    assert not inside.above
    drawn = plots.mode_shape(inside).axes[1]
    assert "sideways" in drawn.get_ylabel()
    assert np.ptp(drawn.lines[0].get_ydata()) == pytest.approx(0.7)


@pytest.mark.parametrize(
    ("direction", "seen", "name"),
    [("in plane", "the orbit's north", "along x"), ("out of plane", "from ahead", "along z")],
)
def test_a_mode_of_a_chain_that_hangs_swings_to_both_sides_of_the_vertical(direction, seen, name):
    system = scenario.load("vertical_chain_3").build()
    result = core.compute_floquet(system, 0.0)
    modes = core.compute_modes(system, result)
    which = next(
        i for i, m in enumerate(modes) if (m.family, m.direction) == ("libration", direction)
    )
    motion = core.mode_motion(system, result, which)
    mode = plots.shown_motion(motion)
    formation, curves = plots.mode_shape(mode).axes
    rest, *phases = [np.array(line.get_data()) for line in formation.lines]
    np.testing.assert_allclose(rest[0][np.isfinite(rest[0])], 0.0, atol=1e-6)
    first, last = (phases[i][0][np.isfinite(phases[i][0])] for i in (0, -1))
    assert np.abs(first).max() > 0.3 and np.dot(first, last) < -0.9 * np.dot(first, first)
    words = formation.texts[0].get_text()
    assert seen in words and "orbit frame" in words and "turn" not in words
    assert curves.get_xlabel() == "orbits [-]" and name in curves.get_ylabel()
    # A rigid chain swings as a whole: sqrt 3 and 2 times an orbit, Misra and Modi.
    rate = {"in plane": np.sqrt(3.0), "out of plane": 2.0}[direction]
    swing = 0.35 * np.cos(2 * np.pi * rate * mode.turns)
    largest = max(curves.lines, key=lambda line: np.ptp(line.get_ydata())).get_ydata()
    np.testing.assert_allclose(np.abs(largest), np.abs(swing), atol=0.02)


def test_a_family_is_drawn_by_stability_and_slackness_with_its_special_points():
    followed = core.follow(core.ring(), "spin_rate_ratio", -2.2, -2.14)
    special, spin = followed.special
    assert (special.kind, spin.kind) == ("first slack", "spin divergence")
    figure = plots.family(followed, "rate [-]", "kelvin_voigt")
    above, below = figure.axes
    assert below.get_xlabel() == "rate [-]" and "[m]" in above.get_ylabel()
    curves = [line for line in above.lines if len(line.get_xdata()) > 1]
    taut, *slack = curves
    assert len({taut.get_color(), *(line.get_color() for line in slack)}) == 2
    assert taut.get_color() != slack[0].get_color()
    # The colour changes where tethers begin to go slack, not at the motion before or after.
    assert taut.get_xdata()[-1] == slack[0].get_xdata()[0] == special.parameter
    drawn = {x for line in curves for x in line.get_xdata()}
    assert drawn >= {p.parameter for p in followed.points}
    radius = np.linalg.norm(followed.points[0].state.position_m, axis=1).max()
    assert taut.get_ydata()[0] == radius
    marked = [line for line in above.lines if line.get_marker() not in ("None", "")]
    places = [x for line in marked for x in line.get_xdata()]
    assert sorted(places) == sorted([special.parameter, spin.parameter])
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "asymptotically stable" in labels and "first slack" in labels
    assert "tethers go slack" in labels and "fold" not in labels
    assert legend_box_clear_of_axes(figure)
