"""Pages of scenes in a real browser: bodies are where equations put them, loads are those of the trim."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdlft
from mbdlft.multibody.assembly import assemble
from mbdlft.problem.trim import solve_trim
from tests.browser import Loaded
from tests.close import PAGE, target
from tests.cross.maximal import Bodies
from tests.cross.poses import array

ROOT = Path(__file__).parents[2]
RIGID = [
    "balloon_gondola", "crane", "double_pendulum_hanging", "double_pendulum_inverted", "gimbal",
    "launcher_slosh", "pendulum", "spinning_satellite", "two_link_arm", "ur5", "four_bar",
]  # fmt: skip
ELASTIC = [
    "flexible_manipulator", "flexible_pointing", "launcher_bending", "mast_observatory", "piezo_beam",
    "rotatory_spacecraft", "solar_arrays",
]  # fmt: skip
OTHERS = [
    *("ball_turntable", "belt_gantry", "bicycle", "control_moment_gyros", "diff_drive"),
    *("differential_wrist", "half_car", "lander", "motorcycle", "rolling_disk", "segway"),
    *("tower_crane", "wheelset", "whipple_bicycle"),
]
_LARGEST = 6_000_000  # bytes of a page
_DRAWN = 300  # triangles: something is in the picture


def scene_called(name: str) -> mbdlft.Scene:
    return mbdlft.load_scene(ROOT / "scenarios" / f"{name}.toml")


def opened(load: Callable[[Path], Loaded], scene: mbdlft.Scene, folder: Path) -> Loaded:
    file = mbdlft.view(scene).save(folder / "page.html")
    assert file.stat().st_size < _LARGEST
    loaded = load(file)
    assert loaded.run("() => mbdlft.drawn()") > _DRAWN
    return loaded


def check_positions(scene: mbdlft.Scene, loaded: Loaded, point: dict[str, float]) -> Bodies:
    """Compare the frames of all bodies in the picture."""
    bodies = Bodies(scene, point, loaded.run("() => mbdlft.coordinates()"))
    for name in bodies.described:
        if name != "ground":
            drawn = np.array(loaded.run("(name) => mbdlft.placement(name)", name)).reshape(4, 4).T
            target(drawn, bodies.frame(name), PAGE)
    return bodies


def set_all(loaded: Loaded, values: dict[str, float]) -> None:
    loaded.run("(all) => Object.entries(all).forEach(([n, x]) => mbdlft.set(n, x))", values)


def slide(loaded: Loaded, where: str, name: str, value: float) -> None:
    """Move the slider of this name, as a hand would."""
    row = loaded.page.locator(f"{where} .slider", has_text=name).locator("input[type=range]")
    row.evaluate("(input, x) => { input.value = x; input.dispatchEvent(new Event('input')); }", value)


def chosen_point(scene: mbdlft.Scene) -> dict[str, float]:
    """Values of the parameters at which pages are compared."""
    chosen = mbdlft.random(scene.parameters, 1, seed=4) if scene.parameters else {}
    return {name: float(value[0]) for name, value in chosen.items()}


def check_page(scene: mbdlft.Scene, loaded: Loaded) -> None:
    """Sliders of parameters and positions, and loads at equilibrium."""
    point = chosen_point(scene)
    set_all(loaded, point)
    check_positions(scene, loaded, point)
    loads = loaded.run("() => mbdlft.loads()")
    trim = solve_trim(assemble(scene), point)
    found = [loads[signal.name] for signal in trim.signals]
    target(found, trim.values, PAGE)
    rng = np.random.default_rng(1)
    free = [n for n in loaded.run("() => mbdlft.coordinates()") if n not in followers(scene)]
    set_all(loaded, {name: float(rng.uniform(-0.3, 0.3)) for name in free})
    check_positions(scene, loaded, point)


def followers(scene: mbdlft.Scene) -> set[str]:
    """Coordinates that loops determine."""
    e = assemble(scene)
    names = {signal.name for signal in e.x_signals}
    return {
        f"{joint.name}.{freedom.measures[0].name}" for joint in scene.joints for freedom in joint.freedoms
    } - names


def test_bodies_and_loads_of_a_tree(load: Callable[[Path], Loaded], tmp_path: Path) -> None:
    """Free, spherical and universal joints; buoyancy; parameters and positions moved at random."""
    scene = scene_called("balloon_gondola")
    loaded = opened(load, scene, tmp_path)
    check_page(scene, loaded)
    slide(loaded, "#positions", "hook.rotation.y", 0.7)
    slide(loaded, "#parameters", "L_train", 31.0)
    assert loaded.run("() => mbdlft.coordinates()")["hook.rotation.y"] == 0.7
    check_positions(scene, loaded, {**chosen_point(scene), "L_train": 31.0})
    loaded.run("() => mbdlft.pick('gondola')")
    assert "mass = m_gondola kg" in loaded.run("() => document.getElementById('info').innerText")
    loaded.page.locator("#rows tr").last.click()
    assert "Shown at" in loaded.run("() => document.getElementById('moving').textContent")
    assert loaded.complaints == []


@pytest.mark.long
def test_a_loop_stays_closed(load: Callable[[Path], Loaded], tmp_path: Path) -> None:
    scene = scene_called("four_bar")
    loaded = opened(load, scene, tmp_path)
    check_page(scene, loaded)
    loop, coordinates = scene.loops[0], loaded.run("() => mbdlft.coordinates()")
    assert all(abs(value) > 1e-3 for value in coordinates.values())
    bodies = check_positions(scene, loaded, chosen_point(scene))
    ends = [bodies.port(port) for port in (loop.parent, loop.child)]
    first, second = (array(bodies.motion(k).point(r)).astype(float) for k, r in ends)
    target(first, second, PAGE)
    loaded.run("() => mbdlft.reset()")
    assert not any(loaded.run("() => mbdlft.coordinates()").values())
    assert loaded.complaints == []


def test_texts_of_a_scene_are_not_markup(load: Callable[[Path], Loaded], tmp_path: Path) -> None:
    """Nor code; a scene without equilibrium is shown, with the reason."""
    evil = "</script><script>console.log('run')</script><img src=x onerror=console.log(1)>"
    scene = scene_called("pendulum")
    (pivot,) = [joint for joint in scene.joints if joint.kind == "revolute"]
    fallen = pivot.model_copy(update={"preload": 0.0, "position": 1.0})
    joints = tuple(fallen if joint is pivot else joint for joint in scene.joints)
    loaded = opened(load, scene.model_copy(update={"description": evil, "joints": joints}), tmp_path)
    assert evil in loaded.run("() => document.querySelector('.description').textContent")
    assert "no equilibrium" in loaded.run("() => document.getElementById('notes').innerText")
    assert loaded.complaints == []


def test_pages_of_every_scene_are_looked_at() -> None:
    scenes = {
        file.stem
        for file in (ROOT / "scenarios").glob("*.toml")
        if "mbdlft-scene" in file.read_text(encoding="utf-8")
    }
    assert scenes == {*RIGID, *ELASTIC, *OTHERS}


@pytest.mark.long
def test_a_browser_that_draws_nothing(load: Callable[..., Loaded], tmp_path: Path) -> None:
    """Without WebGL there are no pictures; numbers, names and modes are there, and a note."""
    file = mbdlft.view(scene_called("four_bar")).save(tmp_path / "page.html")
    loaded = load(file, "--disable-3d-apis")
    assert "needs WebGL" in loaded.run("() => document.getElementById('notes').innerText")
    loaded.run("() => mbdlft.set('theta', 40)")
    loaded.run("() => mbdlft.pick('spring')")
    loaded.page.locator("#rows tr").first.click()
    assert "Shown at" in loaded.run("() => document.getElementById('moving').textContent")
    assert not loaded.page.locator("#layers").is_visible()


@pytest.mark.long
@pytest.mark.parametrize("name", RIGID + ELASTIC + OTHERS)
def test_pages_of_all_scenarios(name: str, load: Callable[[Path], Loaded], tmp_path: Path) -> None:
    scene = scene_called(name)
    loaded = opened(load, scene, tmp_path)
    if name in RIGID:
        check_page(scene, loaded)
    rows: Any = loaded.page.locator("#rows tr")
    for k in range(min(rows.count(), 4)):
        rows.nth(k).click()
        assert "Shown at" in loaded.run("() => document.getElementById('moving').textContent")
    assert loaded.complaints == []


@pytest.mark.long
@pytest.mark.parametrize("name", RIGID + ELASTIC + OTHERS)
def test_reports_of_all_scenarios(name: str, load: Callable[[Path], Loaded], tmp_path: Path) -> None:
    """No complaints, pictures that are there, and a print of few pages."""
    model = mbdlft.to_lft(scene_called(name), search=0.0, prove=0.0)
    file = mbdlft.model_report(model).save(tmp_path / "report.html")
    assert file.stat().st_size < _LARGEST
    loaded = load(file)
    widths = loaded.run("() => [...document.images].map((image) => image.naturalWidth)")
    assert len(widths) >= 2
    assert all(width > 100 for width in widths)
    assert loaded.run("() => document.documentElement.scrollWidth <= window.innerWidth")
    printed = loaded.page.pdf(prefer_css_page_size=True)
    assert 4 <= len(re.findall(rb"/Type\s*/Page\b", printed)) <= 16
    loaded.page.emulate_media(media="print")
    loaded.page.set_viewport_size({"width": 680, "height": 1000})  # A4 between its margins
    assert not loaded.page.locator("pre").is_visible()
    assert loaded.run("() => document.documentElement.scrollWidth <= window.innerWidth")
    first = loaded.page.locator(".verdict").bounding_box()
    assert first["y"] + first["height"] < 1000
    assert loaded.complaints == []
