"""What reaches Rerun is the recording: read back from the files and the viewer it is sent to."""

import contextlib
import dataclasses
import os
import socket
import subprocess
import sys
import tempfile
import urllib.request
from pathlib import Path

import numpy as np
import pytest
import rerun_cli
from PIL import Image
from rerun.chunk import RrdReader
from ros_harness import wait_until
from tss_interfaces.msg import FloquetResult, Mode

from tss_ros.bags.recording import Recording
from tss_ros.core import TssError
from tss_ros.review import review, viewer

VIEWER = Path(rerun_cli.__file__).with_name("rerun")
TURN_S, STEPS = 1000.0, 40
ENDS = np.array([[0, 1], [1, 2], [2, 3], [3, 0]])


@pytest.fixture(scope="module")
def recording():
    """A made-up run of three satellites and one bead whose tethers take turns to go slack."""
    t_s = np.linspace(0, 2 * TURN_S, STEPS)
    angle = np.pi / 2 + np.array([0, 2, 4, 5]) * np.pi / 3 - 2 * np.pi * t_s[:, None] / TURN_S
    position_m = 6e3 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    taut = (np.arange(STEPS)[:, None] + np.arange(4)) % 4 > 0
    tension_n = np.where(taut, np.geomspace(0.1, 10, STEPS)[:, None] * [1, 2, 3, 4], 0.0)
    ones, rate = np.ones(4), 1e-3
    return Recording(
        scenario="made_up",
        bead_name=("satellite_1", "satellite_2", "satellite_3", "tether_3_bead_1"),
        tether_name=("tether_1", "tether_2", "tether_3_segment_1", "tether_3_segment_2"),
        is_satellite=np.array([True, True, True, False]),
        tether_ends=ENDS,
        mass_kg=ones,
        reference_radius_m=6e3 * ones,
        rest_length_m=1e4 * ones,
        axial_stiffness_n=ones,
        damping_n_s_per_m=ones,
        orbit_altitude_m=1e6,
        orbit_rate_rad_s=rate,
        spin_rate_ratio=-2 * np.pi / TURN_S / rate,
        disturbance_m=0.0,
        publish_period_s=t_s[1],
        disturbance_seed=0,
        step=np.arange(STEPS),
        t_s=t_s,
        position_m=position_m,
        velocity_m_s=np.zeros_like(position_m),
        deviation=np.cos(angle),
        length_m=1e4 + tension_n,
        tension_n=tension_n,
        taut=taut,
        rests_m=np.full((STEPS, 4), 1e4),
        rest_rates_m_s=np.zeros((STEPS, 4)),
    )


#: Where the ring about [0, 3, 4] / 5 has what it has about z: up is [0, 4, -3] / 5, seen along it.
TILT = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, 0.6], [0.0, -0.6, 0.8]])


def tilted(recording):
    """The run about another axis."""
    return dataclasses.replace(
        recording, position_m=recording.position_m @ TILT.T, spin_axis=TILT[:, 2]
    )


def eye_of(path):
    """Position and upward direction of the eye that sees the formation."""
    (layout,) = RrdReader(path).blueprints()
    eyes = {}
    for chunk in RrdReader(path).stream(store=layout).to_chunks():
        batch = chunk.to_record_batch()
        columns = dict(zip(batch.schema.names, batch.columns))
        if "EyeControls3D:position" in columns:
            eyes[str(chunk.entity_path)] = tuple(
                np.array(columns[f"EyeControls3D:{name}"].to_pylist()).ravel()
                for name in ("position", "eye_up")
            )
    (eye,) = eyes.values()
    return eye


def test_the_eye_looks_along_the_axis_of_the_spin_which_an_arrow_shows(recording, tmp_path):
    review.save(recording, tmp_path / "flat.rrd", "made up")
    review.save(tilted(recording), tmp_path / "tilted.rrd", "made up")
    for name, turn in (("flat", np.eye(3)), ("tilted", TILT)):
        position, up = eye_of(tmp_path / f"{name}.rrd")
        # Twice as far along the axis as below it, and the axis's own vertical is up.
        np.testing.assert_allclose(up, turn[:, 1], atol=1e-6)
        np.testing.assert_allclose(
            position, turn @ [0.0, -0.6 * 7.2e3, 2.2 * 7.2e3], rtol=1e-5, atol=1e-2
        )
        _, static = read_back(tmp_path / f"{name}.rrd")
        arrows = static["/formation/axes"]
        labels = ["up", "flight", *["spin axis"] * (name == "tilted")]
        assert arrows["Arrows3D:labels"] == [labels]
        expected = 1.2e3 * np.array([[0, 1, 0], [-1, 0, 0], TILT[:, 2]])[: len(labels)]
        np.testing.assert_allclose(arrows["Arrows3D:vectors"][0], expected, atol=1e-3)
        scale = np.array(static["/formation/scale"]["LineStrips3D:strips"][0])
        np.testing.assert_allclose(scale[..., 0], 1.15 * 7.2e3, rtol=1e-5)
        np.testing.assert_allclose(scale @ turn[:, 2], 0.0, atol=1e-2)


def test_a_formation_that_hangs_is_seen_from_the_north_with_the_vertical_up(recording, tmp_path):
    hanging = dataclasses.replace(recording, spin_rate_ratio=0.0)
    review.save(hanging, tmp_path / "x.rrd", "made up")
    position, up = eye_of(tmp_path / "x.rrd")
    assert position[2] > 2.0 * abs(position[1]) and position[0] == 0.0
    np.testing.assert_array_equal(up, [0.0, 1.0, 0.0])
    temporal, static = read_back(tmp_path / "x.rrd")
    assert static["/formation/axes"]["Arrows3D:labels"] == [["up", "flight"]]
    orbits = np.array(temporal["/plots/shape"]["milliturns"]) / 1000
    np.testing.assert_allclose(orbits, hanging.t_s * 1e-3 / (2 * np.pi), atol=5e-4)


@pytest.mark.parametrize("eccentricity", [0.0, 0.2])
def test_the_earth_is_where_it_is_and_as_large_as_it_is(recording, tmp_path, eccentricity):
    """Kepler's equation, solved here by fixed-point steps, says how far below its centre is."""
    perigee_m, mu = 7378e3, 3.986e14
    axis_m = perigee_m / (1.0 - eccentricity)
    rate = np.sqrt(mu / axis_m**3)
    of = dataclasses.replace(
        recording, law_parameters={"eccentricity": eccentricity}, orbit_rate_rad_s=rate
    )
    review.save(of, tmp_path / "without.rrd", "made up")
    assert "/formation/earth" not in read_back(tmp_path / "without.rrd")[1]
    review.save(of, tmp_path / "x.rrd", "made up", earth=True)
    temporal, static = read_back(tmp_path / "x.rrd")
    anomaly = mean = rate * of.t_s
    for _ in range(60):
        anomaly = mean + eccentricity * np.sin(anomaly)
    radius_m = axis_m * (1.0 - eccentricity * np.cos(anomaly))
    assert (np.ptp(radius_m) > 5e5) == (eccentricity > 0.0)
    earth = temporal["/formation/earth"]
    place = np.array(earth["Transform3D:translation"]).reshape(-1, 3)
    np.testing.assert_allclose(place[:, 1], -radius_m, rtol=1e-6)
    np.testing.assert_array_equal(place[:, [0, 2]], 0.0)
    mesh = static["/formation/earth"]
    vertices = np.array(mesh["Mesh3D:vertex_positions"][0])
    np.testing.assert_allclose(np.linalg.norm(vertices, axis=1), 6378e3, rtol=1e-6)
    corners = vertices[np.array(mesh["Mesh3D:triangle_indices"][0])]
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("ij,ij->i", outward, corners.mean(axis=1)) > -1e6).all()
    # The volume within: none of the surface is missing.
    volume = np.einsum("ij,ij->", outward, corners[:, 0]) / 6.0
    assert volume == pytest.approx(4.0 / 3.0 * np.pi * 6378e3**3, rel=2e-3)


def read_back(path):
    """What a Rerun file holds: {entity path: {component: values per step}}, and statics alike."""
    temporal, static = {}, {}
    for chunk in RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        target = (static if chunk.is_static else temporal).setdefault(str(chunk.entity_path), {})
        for name, values in zip(batch.schema.names, batch.columns):
            # Nanoseconds, which datetime cannot hold, as plain numbers.
            values = values.cast("int64") if name == "sim_time" else values
            target.setdefault(name, []).extend(values.to_pylist())
    return temporal, static


def check_against(recording, path, steps):
    """Compare a Rerun file with the recording, of which it is to hold the first `steps` steps."""
    temporal, static = read_back(path)
    scale = temporal["/formation/scale/numbers"]
    assert scale["step"][0] == 0  # and where what follows was sent
    tension_n = recording.tension_n[:steps]
    typical = np.median(tension_n[recording.taut[:steps] & (tension_n > 0)])
    numbers = [float(text.removesuffix(" N")) for text in scale["Points3D:labels"][-1]]
    np.testing.assert_allclose(numbers, typical * np.array([0.1, 1.0, 10.0]), rtol=0.06)
    for entity, columns in temporal.items():
        if columns is scale:
            continue
        assert columns["step"] == list(range(steps)), entity
        seconds = np.array(columns["sim_time"]) * 1e-9
        np.testing.assert_allclose(seconds, recording.t_s[:steps], atol=1e-9)
        turns = np.array(columns["milliturns"]) / 1000
        np.testing.assert_allclose(turns, recording.t_s[:steps] / TURN_S, atol=5e-4)
    # Rerun keeps positions as float32: half a millimetre at 6 km.
    position_m = recording.position_m[:steps]
    np.testing.assert_allclose(
        temporal["/formation/satellites"]["Points3D:positions"], position_m[:, :3], atol=1e-3
    )
    np.testing.assert_allclose(
        temporal["/formation/beads"]["Points3D:positions"], position_m[:, 3:], atol=1e-3
    )
    assert static["/formation/satellites"]["Points3D:labels"] == [list(recording.bead_name[:3])]
    assert static["/formation/satellites"]["Points3D:show_labels"] == [[True]]
    tethers = temporal["/formation/tethers"]
    np.testing.assert_allclose(tethers["LineStrips3D:strips"], position_m[:, ENDS], atol=1e-3)
    for i, name in enumerate(recording.bead_name[:3]):
        strips = np.array(temporal[f"/formation/trails/{name}"]["LineStrips3D:strips"])[:, 0]
        np.testing.assert_allclose(strips[:, 1], position_m[:, i], atol=1e-3)
        np.testing.assert_array_equal(strips[1:, 0], strips[:-1, 1])
    for plot, values, names in (
        ("deviation", recording.deviation, recording.bead_name),
        ("length", recording.length_m, recording.tether_name),
        ("tension", recording.tension_n, recording.tether_name),
        ("centre_of_mass", recording.position_m.sum(axis=1) / 4, ("x", "y (up)", "z")),
    ):
        shown = temporal[f"/plots/{plot}"]["Scalars:scalars"]
        np.testing.assert_allclose(shown, values[:steps], rtol=1e-12, atol=1e-9)
        assert static[f"/plots/{plot}"]["SeriesLines:names"] == [list(names)]
    (layout,) = RrdReader(path).blueprints()
    views = [v for v in blueprint(path, layout) if v.startswith("/view/") and v.count("/") == 2]
    assert len(views) == 7
    return temporal, static


def blueprint(path, store):
    """The entity paths of a blueprint store."""
    chunks = RrdReader(path).stream(store=store).to_chunks()
    return {str(chunk.entity_path) for chunk in chunks}


def test_saved_review_holds_the_recording_and_a_layout(recording, tmp_path):
    review.save(recording, tmp_path / "x.rrd", "made up")
    _, static = check_against(recording, tmp_path / "x.rrd", STEPS)
    assert static["/__properties"]["RecordingInfo:name"] == [["made up"]]
    checked = subprocess.run(
        [VIEWER, "rrd", "verify", tmp_path / "x.rrd"], capture_output=True, text=True
    )
    assert checked.returncode == 0, checked.stderr


def test_tethers_are_grey_and_thin_when_slack_and_redder_the_more_they_pull(recording, tmp_path):
    review.save(recording, tmp_path / "x.rrd", "made up")
    tethers = read_back(tmp_path / "x.rrd")[0]["/formation/tethers"]
    packed = np.array(tethers["LineStrips3D:colors"], dtype=np.uint32)
    red, green, blue = (packed >> shift & 255 for shift in (24, 16, 8))
    grey = (red == green) & (green == blue)
    np.testing.assert_array_equal(grey, ~recording.taut)
    width = np.abs(np.array(tethers["LineStrips3D:radii"]))
    assert width[~recording.taut].max() < width[recording.taut].min()
    pull = recording.tension_n[recording.taut]
    warmth = red[recording.taut].astype(int) - blue[recording.taut].astype(int)
    assert (np.diff(warmth[np.argsort(pull)]) >= -2).all() and pull.size > 100
    assert warmth.min() < -100 and warmth.max() > 100


@pytest.mark.filterwarnings("ignore:RRD file has no footer")  # the viewer is stopped, not closed
def test_live_review_draws_what_the_file_review_draws(recording, tmp_path):
    with a_viewer(tmp_path / "live.rrd") as port:
        live = review.LiveReview(f"rerun+http://127.0.0.1:{port}/proxy")
        for steps in (slice(0, 1), slice(1, 10), slice(10, 30)):
            live.show(part(recording, steps))
        live.close()
    live_temporal, live_static = check_against(recording, tmp_path / "live.rrd", 30)
    review.save(recording, tmp_path / "file.rrd", "made up")
    temporal, static = read_back(tmp_path / "file.rrd")
    assert live_temporal.keys() == temporal.keys()
    assert live_temporal["/formation/scale/numbers"]["step"] == [0, 1, 10]
    assert live_static.keys() == static.keys()


def part(recording, steps):
    """Some steps of a recording."""
    names = ("step", "t_s", "position_m", "velocity_m_s", "deviation")
    names += ("length_m", "tension_n", "taut", "rests_m", "rest_rates_m_s")
    return dataclasses.replace(recording, **{n: getattr(recording, n)[steps] for n in names})


@contextlib.contextmanager
def a_viewer(path):
    """Rerun without a screen: takes what it is sent into a file; yields its port."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    command = [VIEWER, "--bind", "127.0.0.1", "--port", str(port), "--save", path]
    viewer = subprocess.Popen(command, env={**os.environ, "CI": "1", "RUST_LOG": "error"})
    try:
        wait_until(lambda: answers("127.0.0.1", port), 20, "the viewer's port")
        yield port
        wait_until(lambda: complete(path), 20, "the last step in the file")
    finally:
        viewer.terminate()
        viewer.wait()


def complete(path):
    """Whether a file that is still being written has the last of the plots' 30 steps."""
    with contextlib.suppress(Exception):
        return read_back(path)[0]["/plots/tension"]["step"][-1] == 29


def answers(host, port):
    with socket.socket() as probe:
        return probe.connect_ex((host, port)) == 0


@pytest.fixture
def viewer_without_screen(tmp_path, monkeypatch):
    """In place of Rerun's viewer: the same program told to save to a file; notes its call."""
    fake = tmp_path / "rerun"
    fake.write_text(
        f"#!/bin/sh\necho $$ $CI $@ > {tmp_path}/called\n"
        f'exec {VIEWER} "$@" --save {tmp_path}/seen.rrd\n'
    )
    fake.chmod(0o755)
    monkeypatch.setattr(rerun_cli, "__file__", str(tmp_path / "__init__.py"))
    monkeypatch.setenv("DISPLAY", ":none")
    return tmp_path


def test_viewer_listens_to_this_machine_only_and_sends_no_statistics(viewer_without_screen):
    window = viewer.on_screen()
    try:
        port = int(window.url.rpartition(":")[2].partition("/")[0])
        assert answers("127.0.0.1", port)
        # A server bound to every address answers here too.
        assert not answers("127.0.0.2", port)
        assert (viewer_without_screen / "called").read_text().split()[1] == "1"
    finally:
        window.close()


def test_a_viewer_that_cannot_start_is_reported(viewer_without_screen):
    (viewer_without_screen / "rerun").write_text("#!/bin/sh\nexit 3\n")
    with pytest.raises(TssError, match="status 3"):
        review.LiveReview()


@pytest.mark.parametrize("url", ["rerun+http://127.0.0.1:1/proxy", "nonsense", "rerun+http://[::1"])
def test_a_viewer_that_does_not_answer_is_reported(url):
    with pytest.raises(TssError, match="no Rerun viewer answers"):
        review.LiveReview(url)


def run_review(*arguments):
    """The executable without a screen, with every import of rclpy failing."""
    program = (
        "import sys; sys.modules['rclpy'] = None\n"
        "from tss_ros.review.review import main\nsys.exit(main())"
    )
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    return subprocess.run(
        [sys.executable, "-c", program, *map(str, arguments)],
        env=environment,
        capture_output=True,
        text=True,
    )


def missing(folder):
    return folder / "missing"


def empty_folder(folder):
    return folder


def empty_file(folder):
    (folder / "empty.mcap").touch()
    return folder / "empty.mcap"


def not_mcap(folder):
    (folder / "text.mcap").write_text("no recording at all, but long enough to look at" * 50)
    return folder / "text.mcap"


@pytest.mark.parametrize("make", [missing, empty_folder, empty_file, not_mcap])
def test_what_cannot_be_reviewed_gets_one_clear_line(make, tmp_path):
    path = make(tmp_path)
    result = run_review(path, "--save", tmp_path / "x.rrd")
    assert result.returncode == 1
    assert result.stderr.startswith("review: ") and str(path) in result.stderr
    assert result.stderr.count("\n") == 1 and "Traceback" not in result.stderr
    assert not (tmp_path / "x.rrd").exists()


def test_a_file_that_cannot_be_written_is_named(recording, tmp_path):
    with pytest.raises(TssError, match="missing/x.rrd.*No such file"):
        review.save(recording, tmp_path / "missing" / "x.rrd", "made up")


def test_a_full_disk_is_reported(recording):
    with pytest.raises(TssError, match="/dev/full.*No space left"):
        review.save(recording, "/dev/full", "made up")


def test_two_runs_are_shown_side_by_side_with_their_stability_results(recording, tmp_path):
    result = FloquetResult(
        spin_rate_ratio=-2.25,
        max_modulus=1.5,
        verdict="unstable",
        tether_law="kelvin_voigt",
        pushing_share=0.21,
        deciding_family="axis tilt",
        deciding_modulus=1.5,
    )
    other = dataclasses.replace(part(recording, slice(0, 7)), stability=(result,))
    review._save([recording, other], tmp_path / "x.rrd", ["long", "short"])
    temporal, static = read_back(tmp_path / "x.rrd")
    for root, steps in (("/run_1", STEPS), ("/run_2", 7)):
        tethers = temporal[f"{root}/formation/tethers"]["LineStrips3D:strips"]
        np.testing.assert_allclose(tethers, recording.position_m[:steps][:, ENDS], atol=1e-3)
    ((text,),) = static["/run_2/stability"]["TextDocument:text"]
    law = "kelvin_voigt, taut tethers push 21 %"
    row = f"| -2.25 | 1.500000 | axis tilt 1.500000 | unstable | {law}"
    assert row in text
    assert "/run_1/stability" not in static
    (layout,) = RrdReader(tmp_path / "x.rrd").blueprints()
    views = [v for v in blueprint(tmp_path / "x.rrd", layout) if v.count("/") == 2]
    assert len([v for v in views if v.startswith("/view/")]) == 2 * 7 + 1


def test_without_a_driver_a_picture_is_refused_in_one_line(recording, tmp_path, monkeypatch, capfd):
    for name in ("VK_ICD_FILENAMES", "VK_DRIVER_FILES"):
        monkeypatch.setenv(name, "/nonexistent")
    monkeypatch.setenv("WGPU_BACKEND", "vulkan")
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    with pytest.raises(TssError, match="mesa-vulkan-drivers") as refused:
        review.save_picture([recording], tmp_path / "x.png", ["made up"])
    assert "\n" not in str(refused.value)
    assert capfd.readouterr().err == "" and not (tmp_path / "x.png").exists()
    assert not list((tmp_path / "temporary").iterdir())


@pytest.mark.parametrize(
    ("flag", "name"), [("--png", "x.bmp"), ("--video", "x.avi"), ("--save", "x.txt")]
)
def test_formats_are_checked_before_a_bag_is_read(flag, name, capsys):
    with pytest.raises(SystemExit) as ended:
        review.main(["no_such_bag", flag, name])
    assert ended.value.code == 2
    assert f"{flag}: {name!r} has no known ending" in capsys.readouterr().err


def test_pictures_are_drawn_without_a_screen(recording, tmp_path, monkeypatch):
    monkeypatch.setattr(review, "VIDEO_FRAMES", 3)
    monkeypatch.delenv("DISPLAY", raising=False)
    try:
        review.save_picture([recording], tmp_path / "x.png", ["made up"])
    except TssError as error:
        assert "mesa-vulkan-drivers" in str(error)
        pytest.skip("there is no driver to draw with")
    with Image.open(tmp_path / "x.png") as picture:
        assert picture.size == review.PICTURE_SIZE
        red, green, blue = np.moveaxis(np.asarray(picture.convert("RGB")).astype(int), 2, 0)
    # Satellites and curves in the palette's blue and orange on a dark ground.
    assert np.median(red + green + blue) < 100
    for r, g, b in ((0x56, 0xB4, 0xE9), (0xE6, 0x9F, 0x00)):
        assert (abs(red - r) + abs(green - g) + abs(blue - b) < 30).sum() > 100
    review.save_video([recording], tmp_path / "x.gif", ["made up"])
    with Image.open(tmp_path / "x.gif") as video:
        assert video.n_frames == 3 and video.size == review.VIDEO_SIZE


@pytest.mark.parametrize(
    "name, reason", [("x.mp4", "there is no ffmpeg"), ("x.avi", "x.avi.*allowed: .mp4, .gif")]
)
def test_a_video_that_cannot_be_made_is_refused_at_once(recording, name, reason, monkeypatch):
    monkeypatch.setattr(review.shutil, "which", lambda _: None)
    with pytest.raises(TssError, match=reason):
        review.save_video([recording], name, ["made up"])


def test_the_page_for_browsers_is_served_to_this_machine_only():
    server, address = viewer.in_browser()
    try:
        port = int(address.partition("127.0.0.1:")[2].partition("/")[0])
        wait_until(lambda: answers("127.0.0.1", port), 20, "the page")
        with urllib.request.urlopen(address.partition("?")[0], timeout=10) as page:
            assert b"<html" in page.read().lower()
        assert not answers("127.0.0.2", port)
    finally:
        server.close()


def test_a_mode_moves_in_a_view_of_its_own(recording, tmp_path):
    """Its beads leave their places by the shape, for the eye at most by a third of the radius."""
    turns = np.linspace(0.0, 1.0, 13)
    place = np.tile([[0.0, 6e3, 0.0], [-5e3, -3e3, 0.0], [5e3, -3e3, 0.0]], (13, 1, 1))
    shape = 1.2 ** turns[:, None, None] * np.array([[0, 0, 1.0], [0, 0, -0.5], [0, 0, -0.5]])
    mode = Mode(
        multiplier_real=1.2,
        in_words="axis tilt (k = 1)",
        tether_ends=[0, 1, 1, 2, 2, 0],
        turns=turns.tolist(),
        position_m=place.ravel().tolist(),
        shape_real=shape.ravel().tolist(),
        shape_imag=np.zeros(shape.size).tolist(),
    )
    result = FloquetResult(spin_rate_ratio=-2.25, verdict="unstable", mode=[mode])
    shown = dataclasses.replace(part(recording, slice(0, 7)), stability=(result,))
    review.save(shown, tmp_path / "x.rrd", "made up")
    temporal, static = read_back(tmp_path / "x.rrd")
    beads = np.array(temporal["/mode/beads"]["Points3D:positions"])
    size = np.max(np.linalg.norm(shown.position_m[-1], axis=-1))
    height = beads[:, :, 2] / size
    assert beads.shape == (37, 3, 3)  # three turns
    np.testing.assert_allclose(height[:, 1] / height[:, 0], -0.5, rtol=1e-5)
    assert height[24, 0] / height[0, 0] == pytest.approx(1.2**2, rel=1e-5)
    assert height.max() == pytest.approx(0.35, rel=1e-5)
    tethers = np.array(temporal["/mode/tethers"]["LineStrips3D:strips"])
    np.testing.assert_allclose(tethers[:, 0, 1], beads[:, 1])
    assert len(static["/mode/undisturbed"]["LineStrips3D:strips"][0]) == 3
    (layout,) = RrdReader(tmp_path / "x.rrd").blueprints()
    views = [v for v in blueprint(tmp_path / "x.rrd", layout) if v.count("/") == 2]
    assert len([v for v in views if v.startswith("/view/")]) == 7 + 2
