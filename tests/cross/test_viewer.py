"""Pages of scenes in a real browser: bodies are where equations put them, loads are those of the trim."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

import mbdlft
from mbdlft.multibody.assembly import assemble
from mbdlft.problem.trim import solve_trim
from mbdlft.robot import load_robot
from mbdlft.show.viewer.data import view_data
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


# Pages of scenes on screens of two widths, light and dark: nothing is covered or cut, keys reach all.

SIZES = {"wide": (1280, 800), "phone": (390, 844)}
_TABS = 5  # from the top of the page to the sliders
# names in the picture that are seen, what lies over the picture, and texts that are wider than their room
COVERED = """() => {
  const box = (one) => { const b = one.getBoundingClientRect(); return [b.left, b.top, b.right, b.bottom]; };
  const seen = (all) => [...document.querySelectorAll(all)].filter((one) => one.checkVisibility());
  const names = seen(".labels span").map((one) => [one.textContent, ...box(one)]);
  const others = seen("#tools button, #said, .note").filter((one) => one.textContent).map((one) => [one.textContent, ...box(one)]);
  const apart = ([, a, b, c, d], [, e, f, g, h]) => a >= g || e >= c || b >= h || f >= d;
  const over = names.flatMap((one, k) => [...names.slice(k + 1), ...others].filter((other) => !apart(one, other)).map((other) => [one[0], other[0]]));
  const cut = seen("#panel *, #tools button").filter((one) => one.scrollWidth > one.clientWidth + 1 && one.clientWidth && one.matches("input, span, td, th, p, button, summary, h1, div"));
  const beyond = document.documentElement.scrollWidth > window.innerWidth;
  return { count: names.length, over, cut: cut.map((one) => one.id || one.value || one.textContent), beyond };
}"""  # noqa: E501


def tabbed(loaded: Loaded, count: int) -> list[str]:
    """The roles of what has the focus after each of so many tabs."""
    reached = []
    for _ in range(count):
        loaded.page.keyboard.press("Tab")
        reached.append(loaded.run("() => document.activeElement.type ?? document.activeElement.tagName"))
    return reached


def check_keys(loaded: Loaded) -> None:
    """Within five tabs there is a slider; arrows lead from it to all that are open; all have names."""
    sliders: Any = loaded.page.get_by_role("slider")
    if not sliders.count():
        return
    assert "range" in tabbed(loaded, _TABS)
    loaded.run("() => document.activeElement.blur()")
    loaded.page.locator("#skip").focus()
    loaded.page.keyboard.press("Enter")
    reached = set()
    for _ in range(sliders.count()):
        reached.add(loaded.run("() => document.activeElement.ariaLabel"))
        loaded.page.keyboard.press("ArrowDown")
    assert len(reached) == sliders.count()
    for name in reached:
        assert loaded.page.get_by_role("slider", name=name, exact=True).count() == 1
        assert loaded.page.get_by_role("textbox", name=f"{name}, number", exact=True).count() == 1


def check_layout(load: Callable[..., Loaded], file: Path, size: str, scheme: str) -> None:
    loaded = load(file)
    loaded.page.emulate_media(color_scheme=scheme)
    loaded.page.set_viewport_size(dict(zip(("width", "height"), SIZES[size], strict=True)))
    for look in ("mbdlft.look(0.9, 0.35)", "mbdlft.look(0, 0)", "mbdlft.look(-1.57, 1.5)"):
        loaded.run(f"() => {{ {look}; mbdlft.drawn(); }}")
        measured = loaded.run(COVERED)
        assert measured["count"] > 0
        assert measured["over"] == []
        assert measured["cut"] == []
        assert not measured["beyond"]
    check_keys(loaded)
    assert loaded.complaints == []
    loaded.page.close()


def test_tab_stops_at_no_empty_part(load: Callable[..., Loaded], tmp_path: Path) -> None:
    """The file of a robot has no parameters that one could move."""
    file = ROOT / "scenarios" / "desk_arm.urdf"
    loaded = load(mbdlft.view(load_robot(file)[0]).save(tmp_path / "page.html"))
    check_keys(loaded)
    assert loaded.complaints == []


def test_solids_hide_nothing(load: Callable[..., Loaded], tmp_path: Path) -> None:
    """Three links of the ur5 have solids wider than the arm: together they cover a third."""
    loaded = load(mbdlft.view(scene_called("ur5")).save(tmp_path / "page.html"))
    cover, outside = loaded.run("() => [mbdlft.cover(), mbdlft.outside()]")
    assert len(cover) > 3
    assert 1.0 - np.prod([1.0 - each for each in sorted(cover)[:3]]) < 1.0 / 3.0
    assert outside == 0


@pytest.mark.long
@pytest.mark.parametrize("name", RIGID + ELASTIC + OTHERS)
def test_layouts_of_all_scenarios(name: str, load: Callable[..., Loaded], tmp_path: Path) -> None:
    file = mbdlft.view(scene_called(name)).save(tmp_path / "page.html")
    for size in SIZES:
        for scheme in ("light", "dark"):
            check_layout(load, file, size, scheme)


def test_a_page_on_a_phone(load: Callable[..., Loaded], tmp_path: Path) -> None:
    """Many names on little room; keys; a film; a number that is typed."""
    file = mbdlft.view(scene_called("four_bar")).save(tmp_path / "page.html")
    check_layout(load, file, "phone", "dark")
    loaded = load(file)
    field: Any = loaded.page.get_by_role("textbox", name="k, number")
    for typed, expected in (("430", "430"), ("5000", "430"), ("0,41e3", "410")):
        field.focus()
        field.fill(typed)
        loaded.page.keyboard.press("Enter")
        if expected != "430" or typed == "430":
            assert field.input_value() == expected
        else:  # out of range: said, and the value stays
            assert field.get_attribute("aria-invalid") == "true"
            loaded.page.keyboard.press("Escape")
            assert field.input_value() == "430"


def test_numbers_have_units_of_their_size(load: Callable[..., Loaded], tmp_path: Path) -> None:
    file = mbdlft.view(scene_called("pendulum")).save(tmp_path / "page.html")
    loaded = load(file)
    spelled = {
        (2e7, "N/m"): "20 MN/m", (3e-4, "kg m^2"): "3·10⁻⁴ kg m²", (0.0, "N"): "0 N",
        (-1.5e4, "N m/rad"): "-15 kN m/rad",
        (999999.99999, "Pa"): "1 MPa", (5.0, "1"): "5",
        (2.5e-5, "m^4"): "2.5·10⁻⁵ m⁴", (4e-5, "m"): "40 µm", (120.0, "deg"): "120 deg",
    }  # fmt: skip
    for (value, unit), text in spelled.items():
        assert loaded.run("([value, unit]) => spelled(value, unit)", [value, unit]) == text
    for text, value in (("3·10⁻⁴", 3e-4), ("2,5", 2.5), ("−7", -7.0), ("1e3", 1e3)):
        target(loaded.run("(text) => numberOf(text)", text), value, PAGE)
    assert loaded.run("() => Number.isNaN(numberOf('')) && Number.isNaN(numberOf('x'))")
    assert loaded.complaints == []


@pytest.mark.parametrize(
    "name", ["two_link_arm", "half_car", pytest.param("flexible_manipulator", marks=pytest.mark.long)]
)
def test_poles_and_steps_are_those_of_the_model(
    name: str, load: Callable[..., Loaded], tmp_path: Path
) -> None:
    """At values of the sliders; against the linear model of the package and its step response."""
    scene = scene_called(name)
    model = mbdlft.to_lft(scene, search=0.0, prove=0.0)
    point = {key: float(value[0]) for key, value in mbdlft.random(scene.parameters, 1, seed=7).items()}
    page = mbdlft.view(scene, over=model, places={"there": point}, response="step")
    loaded = load(page.save(tmp_path / "page.html"))
    loaded.page.get_by_role("button", name="there", exact=True).click()
    found = np.array(loaded.run("() => mbdlft.poles()")) @ np.array([1.0, 1j])
    A, B, C, D = (matrix[0] for matrix in mbdlft.matrices_at(model, {k: [v] for k, v in point.items()}))
    expected = list(np.linalg.eigvals(A))
    swinging = [pole for pole in expected if abs(pole) > 1e-3 * max(np.abs(expected))]
    for pole in swinging:
        target(found[np.argmin(abs(found - pole))], pole, PAGE, abs(pole))
    values, vectors = np.linalg.eig(A)
    moving = len(loaded.run("() => mbdlft.shape([1, 1])")[0])
    for k in np.flatnonzero((values.imag > 0) & np.isin(values, swinging)):
        shape = vectors[:moving, k] / vectors[np.argmax(abs(vectors[:moving, k])), k]
        drawn = loaded.run("(pole) => mbdlft.shape(pole)", [values[k].real, values[k].imag])
        shown = np.array(drawn[0]) + 1j * np.array(drawn[1])
        target(shown / shown[np.argmax(abs(shape))], shape, PAGE, 1.0)
    dt, count = 0.3 / max(np.abs(expected)), 20
    drawn = loaded.run("([dt, count]) => mbdlft.step(0, dt, count)", [dt, count])
    n = len(A)
    E = expm(np.block([[A, B[:, :1]], [np.zeros((1, n + 1))]]) * dt)
    state = np.eye(n + 1)[n]
    for row in drawn:
        target(row, C @ state[:n] + D[:, 0], PAGE, np.max(np.abs(drawn)))
        state = E @ state
    assert "as large" in loaded.run("() => document.getElementById('played').textContent")
    assert loaded.page.locator("#plane .other").count() > 0
    loaded.run("() => mbdlft.reset()")  # where this model and the other are the same
    same, own = (loaded.page.locator(f"#curve polyline:nth-of-type({k})") for k in (1, 2))
    assert same.get_attribute("class") == "drawn beside"
    assert same.get_attribute("points") == own.get_attribute("points")
    assert loaded.complaints == []


def test_pictures_films_and_distances(load: Callable[..., Loaded], tmp_path: Path) -> None:
    """The link of the pendulum is 0.8 m long; files begin as those of their kinds do."""
    scene = scene_called("pendulum")
    data = view_data(scene)
    (link,) = [item for item in data["items"] if item["name"] == "link"]
    (stick,) = [shape for shape in link["shapes"] if shape["type"] == "stick"]
    loaded = load(mbdlft.view(scene).save(tmp_path / "page.html"))
    page: Any = loaded.page
    for name, begin in (("png", b"\x89PNG"), ("film", b"\x1a\x45\xdf\xa3")):
        button = page.locator("#tools button", has_text=name)
        if name == "film":
            button.click()
            page.wait_for_timeout(300)
        with page.expect_download() as offered:
            button.click()
        assert Path(offered.value.path()).read_bytes().startswith(begin)
    page.locator("#tools button", has_text="measure").click()
    for number in reversed(stick["points"]):
        x, y = loaded.run("(k) => mbdlft.pixel(k)", number)
        page.mouse.click(x, y)
    assert page.locator("#said").inner_text().startswith("0.8 m; along x, y, z: ")
    loaded.run("() => mbdlft.set('L', 0.7)")
    assert page.locator("#said").inner_text().startswith("0.7 m;")
    assert loaded.complaints == []


# A report as it is printed in Chromium: four lines and the scene on the first page, nothing cut.

_MM = 96 / 25.4  # pixels
_WIDE, _HIGH = (210 - 2 * 15) * _MM, (297 - 2 * 16) * _MM  # A4 without the margins of the style sheet
MEASURED = """() => {
  const box = (one) => document.querySelector(one).getBoundingClientRect();
  const cut = [...document.querySelectorAll("h1, p, dd, table, svg")].filter((one) => one.getBoundingClientRect().right > window.innerWidth + 1);
  const unfolded = [...document.querySelectorAll("details")].filter((one) => one.checkVisibility());
  return { lines: document.querySelectorAll(".verdict dt").length, bottom: box(".views").bottom, cut: cut.length, unfolded: unfolded.length, folded: document.querySelectorAll("details").length };
}"""  # noqa: E501


def test_the_first_printed_page_has_four_lines_and_the_scene(
    load: Callable[..., Loaded], tmp_path: Path
) -> None:
    model = mbdlft.to_lft(scene_called("crane"), search=0.0)
    file = mbdlft.model_report(model).save(tmp_path / "report.html")
    loaded = load(file)
    loaded.page.set_viewport_size({"width": int(_WIDE), "height": int(_HIGH)})
    loaded.page.emulate_media(media="print")
    measured = loaded.run(MEASURED)
    assert loaded.complaints == []
    assert measured["lines"] == 4
    assert measured["bottom"] < _HIGH
    assert measured["cut"] == 0
    assert (measured["folded"], measured["unfolded"]) == (1, 0)
