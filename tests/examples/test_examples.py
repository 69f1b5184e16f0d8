"""Every example runs in a process of its own, draws pictures and says what is true."""

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

FOLDER = Path(__file__).parents[2] / "examples"
RUNNER = Path(__file__).with_name("run_example.py")
#: Long enough to compile the numerical core [s]; an example itself takes a few.
PATIENCE_S = 400.0

#: Examples that take longer than most.
LONG = {"plot_two_parameter_chart"}
#: By example, what to ask for at its end.
ASKED = {
    "plot_paper_ring": {
        "end_m": "motions[-2.5].position_m[-1].mean(axis=0)",
        "push_m": "motions[-2.5].position_m[0].mean(axis=0)",
        "angle": "2 * np.pi * TURNS / 2.5",
        "radius_m": "motions[-2.5].reference_radius_m.mean()",
        "orbit_m": "system.orbit_radius_m",
        "held": "abs(motions[-2.5].deviation_from_centre[-100:]).max()",
        "lost": "abs(motions[-2.0].deviation_from_centre).max()",
    },
    "plot_multipliers": {
        "critical": "[boundaries[c][0].spin_rate_ratio for c in DAMPING_N_S_PER_M]",
        "causes": "[boundaries[c][0].cause for c in DAMPING_N_S_PER_M]",
        "tilt": "tilt",
        "families": "[result.family.count(name) for name in families]",
    },
    "plot_own_formation": {
        "same": "same",
        "tension_n": "tension_n",
        "rate": "system.orbit_rate_rad_s",
        "verdicts": "[result.verdict, exchanged.verdict]",
        "least_m": "np.nanmin(least_stretch_m)",
        "missing": "rates[np.isnan(least_stretch_m[:, 0])].min() - critical[0].spin_rate_ratio",
    },
    "plot_deployment": {
        "spin": "[spin.min(), spin.max()]",
        "held": "list(held.values())",
        "tension_n": "[least_n.min(), most_n.max()]",
        "taut": "motion.taut.all()",
        "length_m": "[motion.rests_m[0, 0], motion.rests_m.max(), motion.rests_m[-1, 0]]",
    },
    "plot_two_parameter_chart": {"damping": "sampled", "critical": "critical", "fit": "fitting"},
    "plot_recorded_run": {
        "rows": "[len(beads), len(tethers), len(recording.step)]",
        "tension_n": "table.to_numpy()",
        "rate": "recording.orbit_rate_rad_s",
        "per_turn": "per_turn.to_numpy()",
        "slack": "(~settled['taut']).sum()",
    },
    "plot_animated_motion": {
        "still_m": "np.ptp(simulate(ring(), -2.5, turns=2.0).turning_m, axis=0).max()",
        "moving_m": "np.ptp(simulate(ring(), -2.5, turns=2.0).position_m, axis=0).max()",
        "gif": "animate(motion, frames=5).save(folder / 'small.gif') is None",
    },
    "plot_tour_of_formations": {
        "verdicts": "[result.verdict for _, _, result in answers.values()]",
        "swings": "swings",
        "largest_deg": "abs(angle_deg).max()",
        "growth": "[growth.exponent_per_s[0], growth.error_per_s[0]]",
    },
    "plot_frozen_against_true": {
        "rates": "RATES",
        "true": "true",
        "frozen": "frozen",
        "growth": "growth",
    },
}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A function that runs an example, once, and gives its outcome and its figures' folder."""
    outcomes = {}

    def run_once(name):
        if name not in outcomes:
            folder = tmp_path_factory.mktemp(name)
            command = [sys.executable, RUNNER, FOLDER / f"{name}.py", folder]
            done = subprocess.run(
                [*command, json.dumps(ASKED[name])], cwd=folder, capture_output=True, text=True,
                timeout=PATIENCE_S, env={**os.environ, "MPLBACKEND": "Agg"},
            )
            outcomes[name] = done, folder
        done, folder = outcomes[name]
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout.splitlines()[-1]), folder

    return run_once


@pytest.fixture
def values(run, request):
    """What the example named by the test's parameter had at its end."""
    return run(request.param)[0]["values"]


def of(name):
    """The mark of a test of one example."""
    return pytest.mark.parametrize("values", [_marked(name)], indirect=True)


def _marked(name):
    return pytest.param(name, marks=pytest.mark.long) if name in LONG else name


def test_every_example_is_tested():
    assert {path.stem for path in FOLDER.glob("plot_*.py")} == set(ASKED)


@pytest.mark.parametrize("name", map(_marked, ASKED))
def test_it_ends_in_pictures_with_content(run, name):
    outcome, folder = run(name)
    assert outcome["empty"] == outcome["unlabelled"] == []
    pictures = list(folder.glob("figure_*.png"))
    assert pictures
    for picture in pictures:
        with Image.open(picture) as image:
            pixels = np.asarray(image.convert("RGB")).reshape(-1, 3)
        drawn = np.any(pixels != pixels[0], axis=1)
        assert drawn.mean() > 0.02
        assert len(np.unique(pixels, axis=0)) > 50


@pytest.mark.parametrize("name", map(_marked, ASKED))
def test_it_leaves_no_file_behind(run, name):
    _, folder = run(name)
    left = {path.name for path in folder.iterdir() if not path.name.startswith("figure_")}
    assert left <= {"small.gif"}


@of("plot_paper_ring")
def test_a_pushed_ring_drifts_as_clohessy_and_wiltshire_say(values):
    (x, y, _), angle = values["push_m"], values["angle"]
    # Over a ring of this size the second order of gravity does not cancel: -3/4 r^2/R Omega^2.
    pull = -0.75 * values["radius_m"] ** 2 / values["orbit_m"]
    drifted = [
        x + (6.0 * y + 2.0 * pull) * (angle - math.sin(angle)),
        4.0 * y + pull - (3.0 * y + pull) * math.cos(angle),
    ]
    assert values["end_m"][:2] == pytest.approx(drifted, abs=0.005 * math.hypot(*drifted))


@of("plot_paper_ring")
def test_the_ring_holds_at_two_and_a_half_and_is_lost_at_two(values):
    assert values["held"] < 1e-4
    assert values["lost"] > 0.2


@of("plot_multipliers")
def test_the_axis_tilts_as_that_of_a_rigid_ring(values):
    # rho = exp(2 pi lambda / |w|) at w = -1.95, as on paper
    assert values["tilt"] == pytest.approx(1.63574, rel=1e-3)


@of("plot_multipliers")
def test_first_slack_and_tilt_end_stability_where_they_should(values):
    assert values["causes"] == ["first slack", "axis tilt"]
    assert values["critical"] == pytest.approx([-2.1705, -2.0], abs=3e-3)
    assert values["families"] == [6, 2, 4, 6]


@of("plot_own_formation")
def test_the_rhombus_has_the_tensions_of_a_rigid_one(values):
    outward = values["rate"] ** 2 * (9.0 - 6.0 + 1.5)
    rim, diagonal = 0.5 * 100.0 * outward * 1e4, 0.5 * 200.0 * outward * 1e4
    assert values["tension_n"] == pytest.approx([rim] * 4 + [diagonal], rel=1e-3)


@of("plot_own_formation")
def test_the_rhombus_holds_with_heavy_satellites_on_the_diagonal_only(values):
    assert values["same"]
    assert values["verdicts"] == ["neutral", "none found"]
    assert values["least_m"] > 0.0
    assert values["missing"] > -2e-3


@of("plot_two_parameter_chart")
def test_the_critical_rates_lie_on_the_closed_form(values):
    found = dict(zip(values["damping"], values["critical"]))
    on_paper = {1000.0: -2.306, 2000.0: -2.036, 2500.0: -2.0, 3000.0: -2.0}
    assert {c: found[c] for c in on_paper} == pytest.approx(on_paper, abs=3e-3)
    assert values["fit"] == pytest.approx(1451.5, abs=2.0)


@of("plot_recorded_run")
def test_the_recorded_tension_is_that_of_a_rigid_triangle(values):
    scale = 100.0 * 1e4 / 3.0 * values["rate"] ** 2
    mean = scale * (2.5**2 - 5.0 + 1.5)
    expected = [mean, mean - 3.0 * scale, mean + 3.0 * scale]
    for row in values["tension_n"]:
        assert row == pytest.approx(expected, abs=2e-3 * scale)


@of("plot_recorded_run")
def test_every_recorded_step_is_in_the_tables_and_the_push_dies_out(values):
    beads, tethers, steps = values["rows"]
    assert beads == tethers == 3 * steps
    assert len(values["per_turn"]) == 4
    assert values["per_turn"][-1] < 0.1 * values["per_turn"][0]
    assert values["slack"] == 0


@of("plot_animated_motion")
def test_an_undisturbed_ring_stands_still_in_the_frame_that_turns(values):
    assert values["still_m"] < 100.0 < 10_000.0 < values["moving_m"]


def test_the_animation_is_saved_as_a_gif_of_different_frames(run):
    _, folder = run("plot_animated_motion")
    frames = []
    with Image.open(folder / "small.gif") as gif:
        assert gif.n_frames == 5
        for number in range(5):
            gif.seek(number)
            frames.append(np.asarray(gif.convert("RGB")).copy())
    for before, after in zip(frames, frames[1:]):
        assert np.any(before != after)
    assert (folder / "small.gif").stat().st_size < 100_000


@of("plot_frozen_against_true")
def test_the_tilt_grows_as_on_paper_and_the_frozen_method_misses_it(values):
    true = dict(zip(np.round(values["rates"], 6).tolist(), values["true"]))
    on_paper = {-1.95: 1.63574, -1.75: 3.47819, -1.5: 7.87221, -1.0: 46.2321}
    assert {w: true[w] for w in on_paper} == pytest.approx(on_paper, rel=1e-3)
    assert values["growth"] == pytest.approx(7.87221, rel=0.01)
    assert max(values["frozen"]) < 1.001


@of("plot_tour_of_formations")
def test_formations_of_the_literature_are_answered_for(values):
    assert values["verdicts"] == ["neutral", "none found", "neutral", "asymptotically stable"]
    swings = [1.5 * k * (k + 1) + out for k in (1, 2, 3) for out in (0.0, 1.0)]
    assert values["swings"] == pytest.approx(np.sqrt(swings), abs=1e-3)
    # The odd libration of a rigid dumbbell at e = 0.1.
    assert values["largest_deg"] == pytest.approx(5.956, abs=0.01)
    assert values["growth"][0] < 3.0 * values["growth"][1]


@of("plot_deployment")
def test_a_deployed_ring_stays_taut_and_spins_as_thrusters_balance_coriolis(values):
    assert values["taut"] and 0.0 < values["tension_n"][0] < 0.002 < values["tension_n"][1] < 3.0
    np.testing.assert_allclose(values["spin"], sorted(values["held"]), atol=1e-3)
    np.testing.assert_allclose(values["length_m"], [100.0, 10e3, 100.0], rtol=1e-4)
