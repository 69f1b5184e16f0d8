"""Formations of other papers: what is computed holds against closed forms, and the page says it."""

import math

import numpy as np
import pytest
from PIL import Image

from tss_ros.reproduction import literature, literature_report
from tss_ros.reproduction.literature import NOT, PARTLY, REPRODUCED


def never():
    return False


@pytest.fixture(scope="module")
def found():
    """All that the page needs, on fewer cases."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(literature, "CHAINS", 12)
        patch.setattr(literature, "AMPLITUDES", (0.05, 0.4))
        patch.setattr(literature, "ORBITS", 3.0)
        patch.setattr(literature, "HUB_RATES", (-5.0, 0.0, 5.0))
        patch.setattr(literature, "HUB_SATELLITES", (3, 4))
        patch.setattr(literature, "TILT_RATES", (-2.5, -12.0))
        patch.setattr(literature, "PYRAMID_RATES", (2.0, 5.0))
        rates = {"tetrahedron": (1.0, 2.5), "hub_and_spoke_earth_facing": (1.2,)}
        patch.setattr(literature, "TILTED", rates)
        yield {name: work(never) for name, work in literature_report.WORK.items()}


def test_chains_have_the_librations_of_their_closed_form(found):
    in_plane, out_of_plane = literature.librations(literature.hanging_chain([7.0] * 4, [500.0] * 3))
    expected = [math.sqrt(1.5 * k * (k + 1)) for k in (1, 2, 3)]
    np.testing.assert_allclose(in_plane, expected, rtol=1e-5)
    np.testing.assert_allclose(out_of_plane, np.sqrt(np.square(expected) + 1.0), rtol=1e-5)
    assert found["chains"]["error"] < 1e-5
    assert set(found["chains"]["verdicts"].values()) <= {"neutral", "asymptotically stable"}


def test_small_curves_of_deputies_stay_taut_and_large_ones_do_not(found):
    small, large = found["bunches"]["rows"]
    assert small["slack"] == 0.0 < large["slack"]
    # The pulls across cancel to the second order of the amplitude.
    assert small["main_m"] < 0.05**2 * literature.TETHER_M < large["main_m"]


def test_deputies_move_on_their_lissajous_curves():
    system, share = literature.bunch(4)
    start = literature.lissajous_start(system, share, 1.0)
    seen = literature.core.simulate(system, 0.0, turns=1.0, state=start, period_s=10.0)
    along, across = (math.sqrt(k + 3.0 * share) * system.orbit_rate_rad_s for k in (0.0, 1.0))
    for i in range(4):
        phase = math.pi / 2.0 * i
        apart = seen.position_m[:, 1 + i] - seen.position_m[:, 0]
        np.testing.assert_allclose(apart[:, 0], np.cos(along * seen.t_s + phase), atol=3e-3)
        np.testing.assert_allclose(apart[:, 2], np.sin(across * seen.t_s + phase), atol=3e-3)


def test_rings_come_to_nod_as_rigid_bodies(found):
    apart = {(row["satellites"], row["rate"]): row["apart"] for row in found["rings"]}
    for count in range(3, 7):
        assert apart[count, -12.0] < 1e-3
        assert apart[count, -12.0] < apart[count, -2.5]


def test_the_pyramid_leans_as_a_rigid_one_does(found):
    slow, fast = found["pyramids"]
    # At 2 its ring would have to push: the apexes' tethers pull it in.
    assert slow["verdict"] == "none found" and fast["verdict"] != "none found"
    assert fast["tilt_deg"] == pytest.approx(literature.conical_tilt_deg(5.0), rel=1e-3)
    # PHYSICS of a rigid body: 88.39 degrees from the orbit normal.
    assert literature.conical_tilt_deg(5.0) == pytest.approx(90.0 - 88.39, abs=5e-3)


def test_shipped_formations_about_other_axes_are_answered_for(found):
    slow, own = found["tilted"]["tetrahedron"]
    assert slow == "none found" and own == "asymptotically stable"
    assert found["tilted"]["hub_and_spoke_earth_facing"] == ["none found"]


def test_every_claim_has_a_verdict_and_what_was_found(found):
    claims = literature_report.claims(found)
    assert len(claims) == 8 and {claim.source.key for claim in claims} == set(literature.SOURCES)
    assert all(claim.verdict in (REPRODUCED, PARTLY, NOT) for claim in claims)
    of = {claim.source.key: claim for claim in claims}
    assert of["misra_modi"].verdict == of["tragesser"].verdict == REPRODUCED
    # An open hub of four was stable at none of the rates.
    assert of["pizarro_misra"].verdict == PARTLY and "open, 4: none" in of["pizarro_misra"].found
    text = literature_report.markdown(found)
    for claim in claims:
        assert claim.says in text and claim.found in text


@pytest.mark.parametrize("name", list(literature_report.FIGURES))
def test_every_picture_is_drawn(found, name, tmp_path):
    draw, words = literature_report.FIGURES[name]
    file = tmp_path / "picture.png"
    draw(found[name]).savefig(file)
    with Image.open(file) as picture:
        assert min(picture.size) > 300 and len(picture.getcolors(1 << 24)) > 20
    assert words.endswith(".")
