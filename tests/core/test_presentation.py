"""Results say what they are: in a line, in a table of a notebook, in a file."""

import dataclasses
import re
import sys
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from tss_ros import core
from tss_ros.scenarios import scenario

RING = core.ring()


@pytest.fixture(scope="module")
def results():
    """A result of every class, by name."""
    result = core.compute_floquet(RING, -2.5)
    family = core.follow(RING, "spin_rate_ratio", -2.2, -2.14)
    curve = core.follow_special(
        RING, "spin_rate_ratio", family.special[0], "damping_n_s_per_m", 1400.0
    )
    found = (
        RING, result.state, core.initial_state(RING, -2.5), result,
        core.compute_floquet(RING, -2.0),
        core.find_critical_rates(RING, -2.2, -2.15)[0],
        core.confirm(RING, -2.5, turns=2), core.confirm(RING, -2.0, turns=4),
        core.compute_modes(RING, result)[-1], core.mode_motion(RING, result, result.deciding),
        family, family.points[0], family.special[0], curve, curve.points[0],
        core.simulate(RING, -2.0, turns=3.0, disturbance_m=10.0, seed=1),
    )  # fmt: skip
    return found


def table(thing):
    """Cells of the table that a notebook shows, row by row, and its title."""
    tree = ElementTree.fromstring(thing._repr_html_())  # well-formed
    rows = [["".join(cell.itertext()) for cell in row] for row in tree.iter("tr")]
    return tree.findtext("b"), rows


def test_every_result_fits_a_line_and_has_a_table(results):
    for thing in results:
        text = repr(thing)
        assert text.startswith(f"<{type(thing).__name__} ") and text.endswith(">")
        lines = text.splitlines()
        assert len(lines) == 1 or isinstance(thing, core.Family)
        assert all(len(line) < 250 for line in lines)
        title, rows = table(thing)
        assert text.splitlines()[0].strip("<>") == title
        assert rows and all(len(row) > 1 for row in rows)


def test_a_verdict_comes_with_its_reason_and_the_number_that_decided(results):
    stable, lost = results[3:5]
    number = f"{stable.deciding_modulus:.6f}"
    assert f"asymptotically stable, shape {number}; closes to" in repr(stable)
    cells = dict(table(stable)[1])
    assert cells["verdict"] == "asymptotically stable"
    assert cells["because"].endswith(f"inside the unit circle: shape {number}")
    assert "kelvin_voigt, taut tethers push" in cells["tether law"]
    assert "none found of the formation's own family: damping takes" in repr(lost)
    assert dict(table(lost)[1])["because"] == lost.message


def test_errors_are_the_largest_that_were_measured(results):
    stable, lost = results[3:5]
    errors = (stable.flow_error, stable.segment_error, stable.convergence_error)
    assert stable.largest_error == max(errors)
    assert np.isnan(lost.largest_error)
    quick = core.compute_floquet(RING, -2.5, certify=False)
    assert quick.largest_error == quick.flow_error


def test_a_simulation_says_why_the_formation_counts_as_lost(results):
    held, lost = results[6:8]
    assert held.held and "no bead left its place by 20%" in repr(held)
    assert not lost.held and dict(table(lost)[1])["because"] == lost.reason
    shares = {
        "a tether shrank": {"shortest": 0.001},
        "it made 1.5 of the turns": {"turned": 1.5},
        "a bead left its distance from the centre by 30.00%": {"deviation_from_centre": 0.3},
        "a bead left its height": {},
    }
    for words, change in shares.items():
        assert words in dataclasses.replace(held, held=False, **change).reason


def test_a_family_shows_its_ends_and_its_special_points(results):
    family = next(thing for thing in results if isinstance(thing, core.Family))
    first_slack = family.special[0]
    assert f"first slack at {first_slack.parameter:.8g}" in repr(family)
    many = dataclasses.replace(family, points=family.points * 20)
    _, rows = table(many)
    numbers = [row[0] for row in rows]
    assert numbers[1:10] == ["0", "1", "2", "3", "...", "56", "57", "58", "59"]
    assert "first slack" in [row[3] for row in rows[10:]]


def test_names_cannot_become_part_of_the_page():
    system = core.assemble(
        [core.Satellite("<b>", 1.0, (0, 0, 0)), core.Satellite("b", 1.0, (1e3, 0, 0))],
        [core.Tether("t", (0, 1), (1e3,), (1e4,), (0.0,))],
    )
    result = core.compute_floquet(system, 2.0, certify=False)
    worse = dataclasses.replace(result, message="<script>alert(1)</script>")
    assert "<script>" not in worse._repr_html_()
    assert "<script>alert(1)</script>" in dict(table(worse)[1])["remarks"]


def test_tables_are_data_frames(results):
    *_, family, point, special, curve, _, motion = results
    stable, confirmed = results[3], results[6]
    frame = stable.to_pandas()
    np.testing.assert_array_equal(frame["multiplier"], stable.multiplier)
    assert list(frame["family"]) == list(stable.family)
    assert family.to_pandas()["parameter"].tolist() == family.columns()["parameter"]
    assert curve.to_pandas()["second"].tolist() == curve.columns()["second"]
    np.testing.assert_array_equal(confirmed.to_pandas()["history"], confirmed.history)


def test_what_is_said_of_a_formation_that_hangs_counts_orbits(tmp_path):
    system = scenario.load("vertical_chain_2").build()
    result = core.compute_floquet(system, 0.0)
    motion = core.mode_motion(system, result, result.deciding)
    confirmed = core.confirm(system, 0.0, turns=2)
    for thing in (result, confirmed, motion, *core.compute_modes(system, result)):
        said = re.sub(r"turns made|taut", "", f"{thing!r} {thing._repr_html_()}")
        assert "orbit" in said and not re.search(r"\bturns?\b", said), said
    assert confirmed.plot().axes[0].get_xlabel() == "orbits [-]"
    assert "of the turns against the stars" in dataclasses.replace(confirmed, turned=0.5).reason
    confirmed.save(tmp_path / "confirmed.npz")
    assert core.Confirmation.load(tmp_path / "confirmed.npz").hangs


def test_results_are_drawn(results):
    drawn = [thing for thing in results if hasattr(thing, "plot") and getattr(thing, "family", 1)]
    kinds = {type(thing).__name__ for thing in drawn}
    assert kinds >= {"FloquetResult", "Family", "SpecialCurve", "Confirmation", "ModeMotion"}
    for thing in drawn:
        picture, shown = thing.plot()._repr_png_()
        assert picture.startswith(b"\x89PNG") and shown["width"] > 300


@pytest.mark.parametrize(
    ("package", "method", "extra"),
    [("matplotlib", "plot", "plots"), ("pandas", "to_pandas", "notebook")],
)
def test_what_is_missing_is_named_with_the_extra_that_has_it(
    results, monkeypatch, package, method, extra
):
    for name in [n for n in sys.modules if n.split(".")[0] == package]:
        monkeypatch.delitem(sys.modules, name)
    for name in [n for n in sys.modules if n.startswith("tss_ros.plots")]:
        monkeypatch.delitem(sys.modules, name)

    class Missing:
        def find_spec(self, name, *_):
            if name.split(".")[0] == package:
                raise ModuleNotFoundError(f"No module named {name!r}", name=name)

    monkeypatch.setattr(sys, "meta_path", [Missing(), *sys.meta_path])
    with pytest.raises(ModuleNotFoundError) as error:
        getattr(results[3], method)()
    assert "\n" not in str(error.value)
    assert f"needs {package}, which is not installed: pip install 'tss_ros[{extra}]'" in str(
        error.value
    )


# ---------------------------------------------------------------- files


def same(a, b):
    """Whether two results are the same, bit for bit."""
    if dataclasses.is_dataclass(a):
        return all(same(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(b))
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    return isinstance(a, type(b)) and (a == b or (a != a and b != b))


def test_results_come_back_from_files_bit_for_bit(results, tmp_path):
    laws = core.ring(tether_law="tension_only", j2=0.001, beads_per_tether=1, bead_mass_kg=0.1)
    kept = [*results[3:8], results[-1], core.simulate(laws, -3.0, turns=0.5)]
    assert {type(thing).__name__ for thing in kept} >= {
        "FloquetResult", "Confirmation", "Trajectory"
    }  # fmt: skip
    for i, thing in enumerate(t for t in kept if hasattr(t, "save")):
        thing.save(path := tmp_path / f"{i}.npz")
        assert same(thing, type(thing).load(path))
    assert {path.suffix for path in tmp_path.iterdir()} == {".npz"}


def test_families_are_saved_as_the_command_saves_them(results, tmp_path):
    from tss_ros.sweeps import families

    family = next(thing for thing in results if isinstance(thing, core.Family))
    family.save(tmp_path / "family.parquet")
    assert same(core.Family.load(tmp_path / "family.parquet").points[-1], family.points[-1])
    assert same(families.load(tmp_path / "family.parquet").special[0], family.special[0])
    curve = next(thing for thing in results if isinstance(thing, core.SpecialCurve))
    curve.save(tmp_path / "curve.parquet")
    assert same(core.SpecialCurve.load(tmp_path / "curve.parquet").points[0], curve.points[0])


def test_files_that_hold_no_such_result_are_named(results, tmp_path):
    whole, other = tmp_path / "result.npz", tmp_path / "other.npz"
    results[3].save(whole)
    np.savez(other, x=np.zeros(3))
    cut, damaged = tmp_path / "cut.npz", tmp_path / "damaged.npz"
    content = whole.read_bytes()
    cut.write_bytes(content[: len(content) // 2])
    damaged.write_bytes(content[:300] + bytes(b ^ 255 for b in content[300:400]) + content[400:])
    reasons = {
        tmp_path / "nowhere.npz": "No such file or directory",
        other: "it holds nothing of tss_ros",
        cut: "it is no .npz file",
        damaged: "it is no .npz file",
    }
    for path, reason in reasons.items():
        with pytest.raises(core.TssError, match=f"FloquetResult '{path}' cannot be read: {reason}"):
            core.FloquetResult.load(path)
    with pytest.raises(core.TssError, match="it holds FloquetResult"):
        core.Trajectory.load(whole)
