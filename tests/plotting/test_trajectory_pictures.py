"""Pictures and films of runs and of base trajectories show the numbers of the results."""

import base64
import io
import json
import re
import subprocess
import sys
import warnings

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.transforms import Affine2D
from PIL import Image

import flexopt
from flexopt.foundation.palette import PALETTES, colors
from flexopt.model.tree import tree_from_dict
from flexopt.plant import build_plant
from flexopt.plotting import animate_trajectory, animation, plot_base_trajectory, plot_trajectories, plot_trajectory
from flexopt.plotting.panels import BINS, thinned
from flexopt.plotting.stage import Stage
from flexopt.plotting.stage_space import SpaceStage
from tests.oracles.spatial import grounded
from tests.plotting.looking import without_pictures

pytestmark = pytest.mark.filterwarnings("ignore::flexopt.errors.CompilerNotFound")
UNSTABLE, STABLE = [0.9929, -2.6306], [0.0448, -2.0499]


@pytest.fixture(scope="module")
def excavator():
    return flexopt.load("excavator")


@pytest.fixture(scope="module")
def grows(excavator):
    return flexopt.simulate(excavator, UNSTABLE)


@pytest.fixture(scope="module")
def short(excavator):
    return flexopt.simulate(excavator, UNSTABLE, duration=2.0)


@pytest.fixture(scope="module")
def converges(excavator):
    return flexopt.simulate(excavator, STABLE)


@pytest.fixture(scope="module")
def base_trajectory(excavator):
    return flexopt.nullspace_trajectory(excavator, UNSTABLE, base_range=(-1.5, 1.0))


@pytest.fixture(scope="module")
def diverged(excavator):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", flexopt.FlexoptWarning)
        return flexopt.simulate(excavator, UNSTABLE, kp=4e6, duration=1.0)


def film(path):
    return Image.open(io.BytesIO(path.read_bytes()))


def panels(figure):
    """Label of the y axis -> name -> (x, y) of its lines."""
    return {axes.get_ylabel(): {line.get_label(): line.get_data() for line in axes.lines} for axes in figure.axes}


def check_run(figure, t):
    """Every quantity of a run is there, in the unit that its axis names."""
    shown = panels(figure)
    for k, axis in enumerate("xy"):
        np.testing.assert_array_equal(shown["end-point error, mm"][axis], [t.time, 1e3 * t.error[:, k]])
    thousands = {name: bool(np.nanmax(np.abs(values)) >= 100) for name, values in (("N m", t.torque), ("J", t.energy))}
    labels = [f"{what}, {'k' * thousands[unit]}{unit}" for what, unit in (("torque", "N m"), ("energy", "J"))]
    torques, energy = (shown[label] for label in labels)
    of_torque, of_energy = (1e-3 if thousands[unit] else 1.0 for unit in ("N m", "J"))
    for k, joint in enumerate(t.joints):
        np.testing.assert_array_equal(torques[joint], [t.time, of_torque * t.torque[:, k]])
    np.testing.assert_array_equal(energy["energy"], [t.time, of_energy * t.energy])
    assert sum(axes.get_xlabel() == "time, s" for axes in figure.axes) == 2
    return shown


def test_run(grows, tmp_path):
    figure = grows.plot(tmp_path / "run.png")
    assert (tmp_path / "run.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    shown = check_run(figure, grows)
    rotation = figure.axes[-1]
    for label, k in (("base x, mm", 0), ("base y, mm", 1), ("base rotation, mrad", 2)):
        np.testing.assert_array_equal(shown[label]["deflection"], [grows.time, 1e3 * grows.deflection[:, k]])
        t, envelope = shown[label]["envelope"]
        # Its rate is the run's, it holds the second half, and touches it.
        np.testing.assert_allclose(np.diff(np.log(envelope)) / np.diff(t), grows.growth_rate, rtol=1e-9)
        late = slice(len(grows.time) // 2 + 1, None)
        share = 1e3 * np.abs(grows.deflection[late, k]) / np.interp(grows.time[late], t, envelope)
        # The chord of 200 points lies above the exponential by up to (rate · step)²/8 = 1e-5.
        assert 1 - 2e-5 < share.max() <= 1 + 1e-12
    low, high = rotation.get_ylim()
    assert low < 1e3 * grows.deflection[:, 2].min()
    assert high > 1e3 * grows.deflection[:, 2].max()
    assert "grows" in figure.get_suptitle()
    assert f"decay −{grows.growth_rate:.3g}" in figure.get_suptitle()
    # An energy that grows exponentially is a straight line.
    assert [axes.get_yscale() for axes in figure.axes if axes.get_ylabel() == "energy, kJ"] == ["log"]


def test_envelopes_of_a_decay_do_not_widen_the_axes(converges):
    figure = plot_trajectory(converges)
    assert "converges" in figure.get_suptitle()
    assert "decay +" in figure.get_suptitle()
    for axes, row in zip(figure.axes[3:], converges.deflection.T, strict=True):
        assert max(map(abs, axes.get_ylim())) < 1.2 * 1e3 * np.abs(row).max()


def test_three_joints_and_a_flexible_one(excavator, tmp_path):
    data = excavator.to_dict()
    boom, stick = data["links"]
    flexible = {"name": "flex", "length": 0.3, "com": 0.1, "mass": 50.0, "inertia": 5.0}
    flexible |= {"passive": True, "stiffness": 2e6, "rest": 0.1}
    bucket = {"name": "bucket", "length": 0.6, "com": 0.3, "mass": 150.0, "inertia": 12.0}
    machine = flexopt.machine_from_dict(data | {"links": [boom, flexible, stick, bucket]})
    t = flexopt.simulate(machine, [0.99, -1.6, -0.7], nullspace_damping=500.0, duration=1.0)
    figure = t.plot()
    shown = check_run(figure, t)
    assert set(shown["torque, kN m"]) == {"boom", "stick", "bucket"}
    np.testing.assert_array_equal(shown["flex, mrad"]["deflection"][1], 1e3 * t.deflection[:, 3])
    t.animate(tmp_path / "three.gif", magnify=10, speed=5.0)
    assert film(tmp_path / "three.gif").n_frames == 5


@pytest.mark.parametrize("rigid", [("rotation",), ("x", "y")])
def test_partly_rigid_base(excavator, rigid, tmp_path):
    data = excavator.to_dict()
    for name in ("stiffness", "damping"):
        data["base"][name] = {key: value for key, value in data["base"][name].items() if key not in rigid}
    t = flexopt.simulate(flexopt.machine_from_dict(data), STABLE, duration=1.0)
    shown = check_run(t.plot(), t)
    assert len(shown) == 6 - len(rigid)
    assert not any(f"base {direction}," in label for direction in rigid for label in shown)
    t.animate(tmp_path / "rigid.gif", magnify=3, speed=5.0)
    assert film(tmp_path / "rigid.gif").n_frames == 5


@pytest.mark.long
def test_diverged_run_is_drawn_up_to_its_last_number(diverged, tmp_path):
    t = diverged
    figure = t.plot(tmp_path / "diverged.png")
    last = t.time[np.flatnonzero(np.isfinite(t.energy))[-1]]
    assert f"no number after {last:.3g} s" in figure.get_suptitle()
    for axes in figure.axes:
        assert axes.get_xlim()[1] <= t.time[np.isfinite(t.deflection[:, 0])][-1] + 1e-12
    # What came before the end fills a good part of the axis.
    error = 1e3 * np.abs(t.error[: int(0.75 * np.isfinite(t.error[:, 0]).sum())])
    assert error.max() > 0.1 * figure.axes[0].get_ylim()[1]
    t.animate(tmp_path / "diverged.gif", speed=0.05)
    duration = sum(durations(tmp_path / "diverged.gif"))
    assert duration == pytest.approx(1e3 * t.time[np.isfinite(t.q).all(axis=1)][-1] / 0.05, abs=40)


def test_comparison(grows, converges, tmp_path):
    figure = plot_trajectories({"posture A": grows, "posture B": converges}, tmp_path / "both.svg")
    shown = panels(figure)
    assert list(shown) == ["error x, mm", "error y, mm", "base x, mm", "base y, mm", "base rotation, mrad"]
    for name, t in (("posture A", grows), ("posture B", converges)):
        for k, label in enumerate(shown):
            values = t.error[:, k] if k < 2 else t.deflection[:, k - 2]
            np.testing.assert_array_equal(shown[label][name], [t.time, 1e3 * values])
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert [text.split(",")[0] for text in texts] == ["posture A: grows", "posture B: converges"]


def test_comparison_faults(excavator, grows):
    data = excavator.to_dict()
    data["base"]["stiffness"].pop("rotation")
    data["base"]["damping"].pop("rotation")
    other = flexopt.simulate(flexopt.machine_from_dict(data), STABLE, duration=0.1)
    with pytest.raises(flexopt.InputError, match="2 faults") as caught:
        plot_trajectories({"a": grows, "b": other, "c": 3})
    assert {fault.field for fault in caught.value.faults} == {"b", "c"}
    for nothing in ({}, None, grows):
        with pytest.raises(flexopt.InputError, match="dictionary"):
            plot_trajectories(nothing)


@pytest.mark.parametrize("call", [plot_trajectory, plot_base_trajectory])
def test_pictures_check_what_they_get(call, grows, base_trajectory, tmp_path):
    with pytest.raises(flexopt.InputError, match="must be a"):
        call("no run")
    with pytest.raises(flexopt.InputError, match=r"path = .*must end in .*\.png"):
        call(grows if call is plot_trajectory else base_trajectory, tmp_path / "x.doc")


def test_base_trajectory(excavator, base_trajectory, tmp_path):
    t = base_trajectory
    figure = t.plot(tmp_path / "base.png")
    assert (tmp_path / "base.png").exists()
    assert "end of base_range" in figure.get_suptitle().replace("\n", " ")
    shown = panels(figure)
    np.testing.assert_array_equal(shown["base position, m"]["x"], [t.time, t.base[:, 0]])
    np.testing.assert_array_equal(shown["base rate, m/s"]["x"], [t.time, t.base_rate[:, 0]])
    np.testing.assert_array_equal(shown["V: w1, 1/(kg m²)"]["V"], [t.time, t.V])
    machines = figure.axes[0]
    corners = [patch.get_path().vertices for patch in machines.patches]
    outlines = [(points.min(axis=0) + points.max(axis=0)) / 2 for points in corners]
    assert len(outlines) == 2 * 4 + 1  # two machines and the ground
    for skeleton in (t.initial.skeleton, t.final.skeleton):
        middle = skeleton[:, -2:].mean(axis=1)
        assert min(np.linalg.norm(outline - middle) for outline in outlines) < 0.25
    marks = [line.get_xydata() for line in machines.lines if line.get_marker() == "+"]
    np.testing.assert_array_equal(marks, [[t.target]])


def test_descents_are_marked(excavator):
    downhill = (-1e3 * np.eye(3)).tolist()
    t = flexopt.nullspace_trajectory(excavator, UNSTABLE, step_gain=downhill, on_descent="continue", duration=0.1)
    assert t.descents
    at = [descent.index for descent in t.descents]
    np.testing.assert_array_equal(panels(t.plot())["V: w1, 1/(kg m²)"]["V descends"], [t.time[at], t.V[at]])


def test_long_runs_are_thinned_to_their_extremes():
    rng = np.random.default_rng(5)
    time = np.arange(100_000) / 200
    values = rng.normal(size=time.size)
    values[777], values[50_001], values[60_000:60_500] = 1e3, -1e3, np.nan
    t, y = thinned(time, values)
    assert len(t) <= 2 * BINS
    assert np.all(np.diff(t) > 0)
    np.testing.assert_array_equal(y, values[np.searchsorted(time, t)])
    assert (y.max(initial=-np.inf, where=np.isfinite(y)), y.min(initial=np.inf, where=np.isfinite(y))) == (1e3, -1e3)
    assert np.isnan(y).any()
    for part in np.array_split(np.arange(100_000), BINS // 2):
        inside = (t >= time[part[0]]) & (t <= time[part[-1]])
        assert inside.any()
    same = thinned(time[: 2 * BINS], values[: 2 * BINS])
    np.testing.assert_array_equal(same, [time[: 2 * BINS], values[: 2 * BINS]])


@pytest.mark.long
def test_long_run_in_a_small_file(excavator, tmp_path):
    t = flexopt.simulate(excavator, STABLE, duration=500.0)
    assert t.time.size == 100_001
    figure = t.plot(tmp_path / "long.svg")
    assert all(len(line.get_xdata()) <= 2 * BINS for axes in figure.axes for line in axes.lines)
    assert (tmp_path / "long.svg").stat().st_size < 1_500_000


def durations(path):
    image, found = film(path), []
    for k in range(image.n_frames):
        image.seek(k)
        found.append(image.info["duration"])
    return found


@pytest.mark.long("0.1-250-80", "1.0-50-40")
@pytest.mark.parametrize(("speed", "count", "each"), [(1.0, 50, 40), (2.0, 25, 40), (0.1, 250, 80)])
def test_gif(short, tmp_path, speed, count, each):
    path = tmp_path / "run.GIF"
    short.animate(path, speed=speed)
    assert durations(path) == [each] * count
    assert path.stat().st_size < 3_000_000


def undercarriage(image):
    """Rows and columns of solid #444444 in the scene: springs and their posts are too thin."""
    pixels = np.asarray(image.convert("RGB"), dtype=int)[:, :370]
    mask = np.abs(pixels - 0x44).max(axis=2) <= 4
    solid = mask.copy()
    for axis in (0, 1):
        for shift in (-2, -1, 1, 2):
            solid &= np.roll(mask, shift, axis)
    return np.argwhere(solid).T


@pytest.mark.long
def test_frames_show_the_machine(grows, tmp_path):
    """The slope of the undercarriage's lower edge in the picture is the base's rotation, magnified."""
    grows.animate(tmp_path / "run.gif", magnify=4.0, speed=5.0)
    image = film(tmp_path / "run.gif")
    rotation = 4 * grows.deflection[::40, 2][:50]
    for frame in (0, int(np.argmax(rotation)), int(np.argmin(rotation))):
        image.seek(frame)
        rows, columns = undercarriage(image)
        # Beside the body that stands on it, whose outline hides a part of its edge.
        there = set(columns.tolist())
        inner = [c for c in range(columns.min() + 12, columns.max() - 12) if there.issuperset(range(c - 8, c + 9))]
        edge = [rows[columns == column].max() for column in inner]
        # The edge is some 80 pixels long and known to half a pixel.
        assert np.arctan(-np.polyfit(inner, edge, 1)[0]) == pytest.approx(rotation[frame], abs=0.02)
    assert rotation.max() > 0.2
    assert rotation.min() < -0.2


def stage_of(run, magnify):
    """The scene of a film, before anything is drawn in it, and the rows that it shows."""
    film = animation._film(run, np.arange(run.time.size), float(run.time[-1]), 1.0, magnify)
    return (Stage if film.skeleton.shape[2] == 2 else SpaceStage)(film), film


def ground_lines(axes):
    """Heights of the ground that is drawn, m."""
    return [line.get_ydata()[0] for line in axes.lines if to_hex(line.get_color()) == colors().ground_line]


@pytest.mark.filterwarnings("ignore:the controller does not brake:flexopt.errors.FlexoptWarning")
@pytest.mark.parametrize("name", ["excavator", "boom-stick-bucket"])
def test_a_films_undercarriage_goes_with_the_base_and_the_ground_stays(name):
    """Under the weight, from where the springs are unloaded: by the planar rotation and shift that its coordinates are."""
    machine, postures = flexopt.load(name), {"excavator": UNSTABLE, "boom-stick-bucket": (-1.0, -1.5, -0.5)}
    run = flexopt.simulate(machine, postures[name], base=0.4, duration=0.3, gravity=True)
    stage, film = stage_of(run, 5.0)
    plant = build_plant(machine)
    boxes = []
    for k in film.frames:
        stage.shot(int(k))
        rest = plant.rest(film.base[k], film.q[k, 3:], plant.parameter_values).full().ravel()
        x, y, turn = film.q[k, :3] - rest[:3]
        back = Affine2D().translate(-x, -y).rotate_around(*film.base[k], 0.0, -turn)
        boxes.append(back.transform(stage.bodies.get_paths()[0].vertices[:4]))
    assert np.ptp(film.q[film.frames, 2]) > 1e-4
    np.testing.assert_allclose(boxes, np.broadcast_to(boxes[0], np.shape(boxes)), atol=1e-12)
    # Unloaded it is level, and above the ground that its springs stand on.
    np.testing.assert_allclose(boxes[0][[0, 2], 1], boxes[0][[1, 3], 1], atol=1e-12)
    assert ground_lines(stage.scene) == [0.0]
    assert boxes[0][:, 1].min() > 0
    assert np.nanmin(stage.springs.get_ydata()) == 0.0


def test_a_film_in_space_has_the_ground_as_low_as_what_stands_still():
    """A hull that reaches 0.3 m below its frame and sags."""
    hull = {"body": "chassis", "start": [-1.0, 0.0, 0.2], "end": [1.0, 0.0, 0.2], "radius": 0.5}
    data = grounded(3, 0, coupled=False) | {"placement": ["x", "y", "yaw"], "capsules": [hull]}
    run = flexopt.simulate(tree_from_dict(data), (0.1, 0.9, -1.4), duration=0.1, gravity=True)
    stage, _ = stage_of(run, 1.0)
    assert ground_lines(stage.scenes[0].axes) == pytest.approx([-0.3], abs=1e-12)
    assert ground_lines(stage.scenes[1].axes) == []


@pytest.mark.parametrize("theme", PALETTES)
def test_films_have_a_theme(grows, theme, tmp_path):
    grows.animate(tmp_path / "run.gif", speed=20.0, theme=theme)
    grows.animate(tmp_path / "run.html", speed=20.0, theme=theme)
    image = film(tmp_path / "run.gif")
    image.seek(image.n_frames - 1)
    colours = {f"#{r:02x}{g:02x}{b:02x}" for _, (r, g, b) in image.convert("RGB").getcolors(1 << 20)}
    inks = PALETTES[theme]
    assert "#{:02x}{:02x}{:02x}".format(*image.convert("RGB").getpixel((2, 2))) == inks.page
    assert near(inks.present, colours)
    assert near(inks.undercarriage, colours)
    page = (tmp_path / "run.html").read_text(encoding="utf-8")
    assert f"color-scheme: {theme}; --page: {inks.page};" in page


def near(color, colours):
    """Whether a colour is among those of a palette, to a few parts in 255."""
    parts = np.array([[int(each[k : k + 2], 16) for k in (1, 3, 5)] for each in (color, *colours)])
    return np.abs(parts[1:] - parts[0]).max(axis=1).min() <= 12


@pytest.mark.long
def test_html(grows, tmp_path):
    path = tmp_path / "run.html"
    grows.animate(path, magnify=5.0)
    text = path.read_text(encoding="utf-8")
    assert path.stat().st_size < 3_000_000
    # Nothing is fetched: no address, and every source is inside.
    words = without_pictures(text)
    assert "http" not in words
    assert "//" not in re.sub(r"^\s*//.*$", "", words, flags=re.M)
    assert all(source.startswith("data:image/png;base64,") for source in re.findall(r'src="([^"]*)"', text))
    assert not re.search(r"@[A-Z]+@", text)
    assert "deflections × 5" in text
    frames = json.loads(re.search(r"const frames = (\[.*?\]), delay = 40;", text).group(1))
    assert len(frames) == 250

    def picture(url):
        return Image.open(io.BytesIO(base64.b64decode(url.split(",")[1]))).convert("RGBA")

    # A frame over the still is the film's frame.
    grows.animate(tmp_path / "run.gif", magnify=5.0)
    frames_of_gif = film(tmp_path / "run.gif")
    still = picture(re.search(r'src="([^"]*)"', text).group(1))
    for k in (0, 120, 249):
        frames_of_gif.seek(k)
        both = Image.alpha_composite(still, picture(frames[k])).convert("RGB")
        np.testing.assert_array_equal(np.asarray(both), np.asarray(frames_of_gif.convert("RGB")))


def test_film_faults_come_at_once(grows):
    with pytest.raises(flexopt.InputError, match="3 faults") as caught:
        animate_trajectory(grows, "film.avi", speed=float("nan"), magnify=-1.0)
    assert [fault.field for fault in caught.value.faults] == ["path", "speed", "magnify"]
    for speed in (0.0, -1.0, "fast", True, None):
        with pytest.raises(flexopt.InputError, match="speed"):
            grows.animate("film.gif", speed=speed)
    with pytest.raises(flexopt.InputError, match=r"would last 1e-05 s.*speed must lie between 0\.0167 and 50"):
        grows.animate("film.gif", speed=1e6)
    with pytest.raises(flexopt.InputError, match="path"):
        grows.animate(7)
    with pytest.raises(flexopt.InputError, match="must be a Trajectory"):
        animate_trajectory(None, "film.gif")
    with pytest.raises(OSError, match="nowhere"):
        grows.animate("nowhere/film.gif")


@pytest.mark.long
def test_no_display_and_no_settings():
    """In a fresh process, since the other tests may have loaded a backend."""
    code = (
        "import sys, flexopt, matplotlib as mpl; before = dict(mpl.rcParams.copy()); "
        f"t = flexopt.simulate(flexopt.load('excavator'), {STABLE}, duration=0.5); "
        "import tempfile, pathlib; d = pathlib.Path(tempfile.mkdtemp()); t.plot(d / 'a.pdf'); t.animate(d / 'a.gif'); "
        "assert 'matplotlib.pyplot' not in sys.modules; after = dict(mpl.rcParams.copy()); "
        "assert all(after[k] == before[k] for k in before if k != 'backend')"
    )
    subprocess.run([sys.executable, "-W", "ignore", "-c", code], check=True)


@pytest.mark.long
def test_legends_stay_inside_the_picture():
    """The names of six joints take two rows above their panel."""
    arm = flexopt.load("mobile-manipulator")
    run = flexopt.simulate(arm, [0.1, -0.8, 1.2, -0.4, 0.3, 0.2], kp=1e3, kv=2e2, nullspace_damping=10.0, duration=0.1)
    figure = run.plot()
    figure.draw_without_rendering()
    for axes in figure.axes:
        legend = axes.get_legend()
        if legend is not None:
            box = legend.get_window_extent()
            assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1
