"""Figures of results show their numbers, leave gaps where no motion exists, and move."""

import dataclasses
import io

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from tss_ros import core, plots
from tss_ros.plots.animation import _MotionPictures
from tss_ros.scenarios import scenario

RING = core.ring()
RATES = (-2.5, -2.2, -2.1, -2.0, -1.9, -2.4)


@pytest.fixture(scope="module")
def results():
    """Results at `RATES`, in their order; no motion is found at -2.0 and -1.9."""
    found = dict(core.sweep(core.FloquetJob(RING, rate) for rate in RATES))
    return [found[i] for i in range(len(RATES))]


CRITICAL = core.CriticalRate(-2.171, 5e-4, "first slack", -1)


def curves(axes):
    """Data of the lines of an axes by label."""
    return {line.get_label(): np.array(line.get_data()).T for line in axes.lines}


def test_multipliers_lie_where_they_are_by_family_with_the_circle(results):
    (stable, *_) = results
    figure = plots.plot_multipliers(stable)
    (axes,) = figure.axes
    drawn = curves(axes)
    np.testing.assert_allclose(np.hypot(*drawn["unit circle"].T), 1.0)
    for name in dict.fromkeys(stable.family):
        of = stable.multiplier[np.array(stable.family) == name]
        expected = np.stack([of.real, of.imag], axis=1)
        np.testing.assert_array_equal(drawn[f"{name} ({len(of)})"], expected)
    rho = stable.multiplier[stable.deciding]
    np.testing.assert_array_equal(drawn["decided the verdict"], [[rho.real, rho.imag]])
    assert axes.get_aspect() == 1.0
    assert stable.verdict in axes.get_title() and stable.reason in axes.get_title()
    assert figure.get_suptitle().startswith("tether law: kelvin_voigt, taut tethers push")


def test_where_there_are_no_multipliers_there_is_no_figure(results):
    with pytest.raises(core.TssError, match="at spin_rate_ratio -2 has no multipliers: none found"):
        plots.plot_multipliers(results[3])


def test_no_curve_goes_through_rates_without_motions_and_they_are_grey(results):
    figure = plots.plot_modulus(results, [CRITICAL])
    (axes,) = figure.axes
    drawn = curves(axes)
    rates, moduli = drawn["what decided"].T
    assert np.isfinite(moduli[rates < -2.05]).all() and not np.isfinite(moduli[rates > -2.0]).any()
    assert drawn["critical: first slack"][:, 0].tolist() == [-2.171, -2.171]
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert {"critical: first slack", "asymptotically stable", "no motion found"} <= set(labels)
    found = {float(rate) for rate in drawn["no motion found"][:, 0]}
    assert found == {r.spin_rate_ratio for r in results if r.verdict == "none found"}


def test_results_by_several_methods_or_none_are_refused(results):
    frozen = core.compute_floquet(RING, -2.5, "frozen")
    with pytest.raises(core.TssError, match="by one method, got monodromy, frozen"):
        plots.plot_modulus([results[0], frozen])
    with pytest.raises(core.TssError, match="by one method, got none"):
        plots.plot_modulus([])
    with pytest.raises(core.TssError, match="results must be of kind FloquetResult, got .*tooslow"):
        plots.plot_modulus([results[0], core.TssError("tooslow")])


def test_a_chart_places_verdicts_and_critical_rates_over_values_or_names(results):
    chosen = {1000.0: results[:2], 1450.0: results[2:4]}
    figure = plots.plot_chart(chosen, {1450.0: [CRITICAL]}, "damping [N s/m]")
    (axes,) = figure.axes
    drawn = curves(axes)
    for verdict in {r.verdict for rs in chosen.values() for r in rs}:
        expected = [
            [value, r.spin_rate_ratio]
            for value, rs in chosen.items() for r in rs if r.verdict == verdict
        ]  # fmt: skip
        np.testing.assert_array_equal(drawn[verdict], expected)
    assert axes.get_xlabel() == "damping [N s/m]"
    (bar,) = axes.containers
    np.testing.assert_array_equal(np.array(bar.lines[0].get_data()).T, [[1450.0, -2.171]])
    (axes,) = plots.plot_chart({"thin": results[:1], "thick": results[1:2]}).axes
    assert [text.get_text() for text in axes.get_xticklabels()] == ["thin", "thick"]
    for wrong in ({}, {"thin": results, 2.0: results}):
        with pytest.raises(core.TssError, match="by values or by names"):
            plots.plot_chart(wrong)


def test_a_disturbance_is_drawn_on_a_logarithmic_scale():
    turns, history = np.linspace(0, 2, 9), np.append(np.geomspace(1e-1, 1e-7, 8), 0.0)
    (axes,) = plots.disturbance(turns, history).axes
    assert axes.get_yscale() == "log"
    np.testing.assert_array_equal(axes.lines[0].get_ydata()[:8], history[:8])


# ---------------------------------------------------------------- animations


def pictures(animation):
    with Image.open(io.BytesIO(animation.gif)) as gif:
        for number in range(gif.n_frames):
            gif.seek(number)
            yield np.asarray(gif.convert("RGB")).astype(int)


def test_a_motion_moves_and_its_slack_tethers_are_seen(tmp_path):
    motion = core.simulate(RING, -2.0, turns=3.0, disturbance_m=10.0, seed=1)
    assert not motion.taut.all()
    animation = plots.animate(motion, frames=4)
    frames = list(pictures(animation))
    assert len(frames) == animation.frames == 4
    for before, after in zip(frames, frames[1:]):
        assert np.abs(after - before).max() > 100
    animation.save(tmp_path / "motion.gif")
    assert (tmp_path / "motion.gif").read_bytes() == animation.gif
    assert "4 pictures" in repr(animation)
    assert animation._repr_html_().startswith('<img alt="4 pictures" src="data:image/gif;base64,')


def test_a_motion_of_few_states_has_as_many_pictures():
    motion = core.simulate(RING, -2.5, turns=0.04)
    assert plots.animate(motion).frames == len(motion) == 5


def test_the_mode_of_a_multiplier_moves(results):
    motion = core.mode_motion(RING, results[0], results[0].deciding, samples=12)
    frames = list(pictures(plots.animate(motion)))
    assert len(frames) > 10
    assert np.abs(frames[1] - frames[0]).max() > 100


def test_a_motion_about_a_tilted_axis_is_animated_along_it_and_from_the_side():
    """A stiff ring, turned by SciPy: it stands still in the frame that turns with the spin."""
    axis = np.array([0.0, 3.0, 4.0]) / 5.0
    motion = core.simulate(RING, -2.5, turns=1.0)
    turned = Rotation.from_rotvec(-2.0 * np.pi * motion.turns[:, None] * axis)
    tilt = Rotation.align_vectors([axis], [[0.0, 0.0, 1.0]])[0]
    start_m = tilt.apply(motion.position_m[0])
    place_m = np.array([turn.apply(start_m) for turn in turned])
    system = dataclasses.replace(RING, spin_axis=axis)
    motion = dataclasses.replace(motion, system=system, position_m=place_m)
    shown = _MotionPictures(motion, "tilted")
    (turning_km, *_), (orbit_km, *_) = shown.views
    np.testing.assert_allclose(np.ptp(turning_km, axis=0), 0.0, atol=1e-9)
    distance_km = np.linalg.norm(start_m, axis=1) / 1e3
    np.testing.assert_allclose(np.linalg.norm(turning_km[0], axis=1), distance_km)
    np.testing.assert_allclose(orbit_km, place_m[..., [2, 1]] / 1e3, atol=1e-12)
    along, side = shown.figure.axes[:2]
    assert side.get_xlabel() == "z, orbit normal [km]"
    assert len(side.lines) == len(along.lines) + 1  # the axis
    assert plots.animate(motion, frames=2).frames == 2


def test_a_chain_that_hangs_is_animated_from_the_north_and_from_ahead_in_orbits():
    system = scenario.load("vertical_chain_2").build()
    motion = core.simulate(system, 0.0, turns=0.5, disturbance_m=30.0)
    shown = _MotionPictures(motion, "hanging")
    shown.draw(20)
    north, ahead = shown.figure.axes[:2]
    for axes, (seen, *_), across in zip((north, ahead), shown.views, (0, 2)):
        np.testing.assert_allclose(seen, motion.position_m[..., [across, 1]] / [1.0, 1e3])
        low, high = axes.get_xlim()
        assert low < seen[..., 0].min() and seen[..., 0].max() < high
        assert "[m]" in axes.get_xlabel() and "not to scale" in axes.get_title()
    assert shown.heading.get_text() == "hanging: orbit 0.2"
    assert shown.figure.axes[2].get_xlabel() == "orbits [-]"


def test_what_cannot_be_animated_is_named():
    motion = core.simulate(RING, -2.5, turns=0.001)
    with pytest.raises(core.TssError, match="at least 2 states to be animated, got 1"):
        plots.animate(motion)
    with pytest.raises(core.TssError, match="shown must be a Trajectory.*, got <System of 3"):
        plots.animate(RING)
    with pytest.raises(core.TssError, match="frames must be a whole number from 2 .*, got 1.5"):
        plots.animate(core.simulate(RING, -2.5, turns=0.1), frames=1.5)


def test_the_plots_show_their_public_names_alone():
    assert dir(plots) == sorted(plots.__all__)
    assert {"animate", "plot_chart", "plot_modulus", "plot_multipliers"} <= set(dir(plots))
