"""Pages of scenes without a browser: tapes, frames, loads and modes against other ways to them."""

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import mbdlft
from mbdlft.base.errors import SceneError
from mbdlft.multibody.assembly import assemble
from mbdlft.problem.trim import solve_trim
from mbdlft.show.viewer import page as page_of_scene
from mbdlft.show.viewer.data import OPERATIONS, tape_of, view_data
from mbdlft.show.viewer.drawing import draw, solid_of
from mbdlft.show.viewer.poses import scene_poses
from tests import kit
from tests.close import CROSS, EVALUATION, FINITE_ELEMENTS, target
from tests.cross.maximal import Bodies
from tests.cross.mechanisms import open_tree

ROOT = Path(__file__).parents[2]
# what the operations of a page mean, besides + - * /
MEANING = {
    "assign": lambda a: a, "neg": lambda a: -a, "sq": lambda a: a * a, "twice": lambda a: 2 * a,
    "inv": lambda a: 1 / a, "sqrt": np.sqrt, "sin": np.sin, "cos": np.cos, "tan": np.tan,
    "atan": np.arctan, "add": lambda a, b: a + b, "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b, "div": lambda a, b: a / b,
}  # fmt: skip


def interpret(tape: Mapping[str, Any], *given: Sequence[float]) -> np.ndarray:
    """The twin of `interpret` in interpret.js."""
    registers, results = [0.0] * tape["registers"], np.zeros(tape["outputs"])
    steps = np.array(tape["steps"]).reshape(-1, 4)
    for code, target_, first, second in steps.tolist():
        name = OPERATIONS[code]
        if name == "const":
            registers[target_] = tape["constants"][first]
        elif name == "input":
            registers[target_] = given[first][second]
        elif name == "output":
            results[target_] = registers[first]
        elif name in ("add", "sub", "mul", "div"):
            registers[target_] = MEANING[name](registers[first], registers[second])
        else:
            registers[target_] = MEANING[name](registers[first])
    return results


def test_a_tape_is_its_function() -> None:
    """All operations, repeated constants, entries that are nowhere, several arguments."""
    x, y = ca.SX.sym("x", 3), ca.SX.sym("y", 2)
    parts = [ca.sin(x[0]) + ca.cos(y[1]), x[1] * y[0] - 0.3, -ca.sqrt(x[2]), ca.tan(x[0]) / y[0]]
    parts += [ca.atan(x[1]), x[2] * x[2], 2 * y[1], 1 / x[0], ca.SX(0), ca.SX(0.3), x[1]]
    function = ca.Function("all", [x, y], [ca.densify(ca.vertcat(*parts))])
    at = [0.7, -1.3, 2.1], [0.4, 5.0]
    target(interpret(tape_of(function), *at), function(*at).full().ravel(), EVALUATION)


def test_the_page_has_the_operations_of_the_tape() -> None:
    script = (ROOT / "mbdlft/show/viewer/assets/interpret.js").read_text(encoding="utf-8")
    assert re.findall(r"case (\d+):", script) == [str(k) for k in range(len(OPERATIONS))]
    x = ca.SX.sym("x")
    with pytest.raises(NotImplementedError, match="'exp' of 'growth'"):
        tape_of(ca.Function("growth", [x], [ca.exp(x)]))


@pytest.mark.parametrize(
    "seed", [3, *(pytest.param(k, marks=pytest.mark.long) for k in (0, 1, 2, 4, 5, 6, 7))]
)
def test_frames_of_random_trees(seed: int) -> None:
    """All kinds of joints, orientations and ports, displaced far, against maximal coordinates."""
    scene = open_tree(seed)
    rng = np.random.default_rng(seed)
    data = view_data(scene)
    q = rng.uniform(-1.0, 1.0, len(data["coordinates"]))
    displaced = dict(zip((one["name"] for one in data["coordinates"]), q.tolist(), strict=True))
    chosen = mbdlft.random(scene.parameters, 1, seed) if scene.parameters else {}
    p = [float(chosen[parameter["name"]][0]) for parameter in data["parameters"]]
    point = {parameter["name"]: value for parameter, value in zip(data["parameters"], p, strict=True)}
    vectors = interpret(data["tape"], p, q).reshape(-1, 3)
    bodies = Bodies(scene, point, displaced)
    items = {item["name"]: item for item in data["items"] if item["group"] == "bodies"}
    for name in bodies.described:
        if name == "ground":
            continue
        expected = bodies.frame(name)
        (frame,) = [s for s in items[name]["shapes"] if s["type"] == "frame"]
        r, *axes = vectors[frame["at"]]
        target(r, expected[:3, 3], CROSS, 1.0)
        target(np.array(axes).T, expected[:3, :3], CROSS)
    check_loads(scene, data, p, point)


def check_loads(
    scene: mbdlft.Scene, data: dict[str, Any], p: list[float], point: dict[str, float]
) -> None:
    """The equations of the trim in the page, solved here."""
    trim = solve_trim(assemble(scene), point)
    n = len(data["trim"]["unknown"])
    found = interpret(data["trim"]["tape"], p)
    offset, slopes = found[:n], found[n : n + n * n].reshape(n, n).T
    if n:
        target(-np.linalg.solve(slopes, offset), trim.values, CROSS)
    names = [data["trim"]["efforts"][k]["name"] for k in data["trim"]["unknown"]]
    assert names == [signal.name for signal in trim.signals]


def test_arrows_of_loads_are_forces_on_bodies() -> None:
    """A thrust turns with its body, a spring pulls its ports together, buoyancy is up."""
    scene = mbdlft.load_scene(ROOT / "scenarios" / "four_bar.toml")
    data = view_data(scene)
    nominal = [p["nominal"] for p in data["parameters"]]
    check_loads(scene, data, nominal, {})
    (item,) = [item for item in data["items"] if item["name"] == "spring"]
    vectors = interpret(data["tape"], nominal, [0.0] * 3)
    vectors = vectors.reshape(-1, 3)
    first, second = (s for s in item["shapes"] if s["type"] == "force")
    apart = vectors[second["at"]] - vectors[first["at"]]
    target(vectors[first["along"]], apart, EVALUATION)
    target(vectors[second["along"]], -apart, EVALUATION)
    data = view_data(mbdlft.load_scene(ROOT / "scenarios" / "balloon_gondola.toml"))
    (item,) = [item for item in data["items"] if item["name"] == "lift"]
    (shape,) = item["shapes"]
    p = [q["nominal"] for q in data["parameters"]]
    upright = [0.0] * len(data["coordinates"])
    tilted = [0.4 if one["turns"] else 0.0 for one in data["coordinates"]]
    for q in (upright, tilted):
        along = interpret(data["tape"], p, q).reshape(-1, 3)[shape["along"]]
        assert along[2] > 0.0
        target(along[:2], [0.0, 0.0], EVALUATION, along[2])


def chain(damping: float = 0.0, **first: Any) -> mbdlft.Scene:
    """Two masses one after the other on springs along x."""
    along = {"axis": (1, 0, 0)}
    return kit.scene(
        "chain",
        mbdlft.Parameter("k", 2.0, low=1.0, high=3.0, unit="N/m"),
        *(kit.point(name, 1.0) for name in "ab"),
        kit.rail("first", "ground", "a", **along | {"stiffness": "k"} | first),
        kit.rail("second", "a", "b", **along, stiffness="k", damping=damping),
    )


def test_modes_of_a_chain() -> None:
    """Relative coordinates of two masses: [2 1; 1 1] q'' + k q = 0, omega^2 = k (3 -+ sqrt 5)/2."""
    data = view_data(chain(), {"k": 2.5})
    assert [sample["point"] for sample in data["modes"][:4]] == [[2.5], [2.0], [1.0], [3.0]]
    for sample in data["modes"]:
        k = sample["point"][0]
        squares = k * np.array([(3 - np.sqrt(5)) / 2, (3 + np.sqrt(5)) / 2])
        target([m["imag"] for m in sample["modes"]], np.sqrt(squares), EVALUATION * 10)
        assert [m["real"] for m in sample["modes"]] == [0.0, 0.0]
    damped = view_data(chain(0.1))["modes"][0]["modes"]
    assert all(m["real"] < 0.0 for m in damped)


def test_modes_at_zero_are_listed_once_for_each_shape() -> None:
    for sample in view_data(chain(stiffness=0.0))["modes"]:
        still, swinging = sample["modes"]
        assert (still["real"], still["imag"]) == (0.0, 0.0)
        assert still["shape"] == [[1.0, 0.0], [0.0, 0.0]]
        target(swinging["imag"], np.sqrt(2 * sample["point"][0]), EVALUATION * 10)


def pair() -> mbdlft.Scene:
    """Masses side by side that differ by a million, with a spring between them."""
    return kit.scene(
        "pair",
        kit.point("a", 1.0),
        kit.point("b", 1e6),
        kit.rail("first", "ground", "a", (1, 0, 0)),
        kit.rail("second", "ground", "b", (1, 0, 0), position=2.0),
        kit.spring("between", "a", "b", stiffness=1.0, force_density=0.0),
    )


def test_a_mode_at_zero_of_unequal_masses_moves_them_together() -> None:
    (sample,) = view_data(pair())["modes"]
    still, _ = sample["modes"]
    target(still["shape"], [[1.0, 1.0], [0.0, 0.0]], FINITE_ELEMENTS)


def test_center_line_of_a_beam_ends_at_its_tip() -> None:
    """Elements and modes; the tip is the frame of the port, which the model itself uses."""
    for name in ("flexible_manipulator", "mast_observatory", "rotatory_spacecraft"):
        scene = mbdlft.load_scene(ROOT / "scenarios" / f"{name}.toml")
        data = view_data(scene)
        rng = np.random.default_rng(3)
        q = 0.01 * rng.standard_normal(len(data["coordinates"]))
        p = [parameter["nominal"] for parameter in data["parameters"]]
        vectors = interpret(data["tape"], p, q).reshape(-1, 3)
        curves = 0
        for item in data["items"]:
            for shape in item["shapes"]:
                if shape["type"] == "curve":
                    curves += 1
                    (tip,) = [s["at"] for s in item["shapes"] if s.get("label") == "tip"]
                    target(vectors[shape["points"][-1]], vectors[tip], CROSS)
        assert curves


def test_center_of_mass_of_elastic_bodies() -> None:
    """The momentum of all bodies is the mass times the velocity of the drawn centers."""
    scene = mbdlft.load_scene(ROOT / "scenarios" / "solar_arrays.toml")
    scene = scene.model_copy(
        update={"sensors": (mbdlft.CenterOfMass(name="all"),), "outputs": ("all.x", "all.y", "all.z")}
    )
    model = mbdlft.to_lft(scene, search=0.0)
    data = view_data(scene)
    p = [parameter["nominal"] for parameter in data["parameters"]]
    shapes = [s for item in data["items"] for s in item["shapes"] if s["type"] == "mass"]
    total = sum(shape["mass"] for shape in shapes)

    def center(q: np.ndarray) -> np.ndarray:
        vectors = interpret(data["tape"], p, q).reshape(-1, 3)
        return sum(shape["mass"] * vectors[shape["at"]] for shape in shapes) / total

    n, step = len(data["coordinates"]), 1e-5
    slopes = np.array([(center(step * e) - center(-step * e)) / (2 * step) for e in np.eye(n)]).T
    C = mbdlft.matrices_at(model, {}).C
    names = [one["name"] for one in data["coordinates"]]
    columns = [[state.name for state in model.states].index(name) for name in names]
    target(slopes, C[:, columns], CROSS, 1.0)


def test_texts_end_no_element() -> None:
    evil = "</script><script>alert(1)</script>"
    html = mbdlft.view(chain().model_copy(update={"description": evil})).html
    assert evil not in html
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', html, re.DOTALL)
    assert found is not None
    assert json.loads(found[1])["description"] == evil


def test_a_page_asks_for_nothing() -> None:
    """Own parts have no address; the library has those of its comments only."""
    for file in (ROOT / "mbdlft/show/viewer/assets").iterdir():
        assert "http" not in file.read_text(encoding="utf-8"), file.name


def test_a_notebook_shows_a_page() -> None:
    page = mbdlft.view(chain())
    assert page._repr_html_().startswith('<iframe srcdoc="&lt;!doctype html&gt;')
    assert re.fullmatch(r"Page\('chain', \d\.\d MB\)", repr(page))


def test_the_scene_of_a_model() -> None:
    scene = mbdlft.load_scene(ROOT / "scenarios" / "pendulum.toml")
    assert mbdlft.show.scene_of(mbdlft.to_lft(scene, search=0.0)) == scene


def test_axes_turn_the_way_they_point() -> None:
    """For each coordinate that turns: a small turn moves the body about the drawn axis."""
    scene = mbdlft.load_scene(ROOT / "scenarios" / "gimbal.toml")
    found = scene_poses(scene)
    p = np.array([parameter.nominal for parameter in found.resolved.parameters])
    for k, joint in enumerate(scene.joints):
        child = joint.child.partition(".")[0]
        (axis,) = found.joints[joint.name].axes
        function = found.as_function(ca.vec(found.frames[child].R), "turned")
        along = found.as_function(axis.axis, "axis")(p, 0.0).full().ravel()
        step = 1e-6 * np.eye(len(scene.joints))[k]
        before, after = (function(p, at).full().reshape(3, 3).T for at in (0 * step, step))
        target(Rotation.from_matrix(after @ before.T).as_rotvec() / 1e-6, along, FINITE_ELEMENTS)


def test_a_page_without_its_library(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page_of_scene, "_PACKAGE", "no-such-package")
    page_of_scene._library.cache_clear()
    scene = mbdlft.load_scene(ROOT / "scenarios" / "pendulum.toml")
    with pytest.raises(SceneError, match=r"not installed.*pip install 'mbdlft\[viewer\]'"):
        mbdlft.view(scene)
    page_of_scene._library.cache_clear()


def test_of_a_bundle_the_modules_of_three_are_kept() -> None:
    """What those need is kept, too; a bundle of another form stays whole."""
    heads = "1(e,t,n){n(2)},2(e,t,n){n.d(t,{WebGLRenderer:()=>r});n(3)},3(e){},4(e){}"
    bundle = f"define(()=>{{var e={{{heads}}};const t={{}};function n(r){{}}return n(1)}});"
    kept = (
        bundle.replace("1(e,t,n){n(2)},", "").replace(",4(e){}", "").replace("return n(1)", "return n(2)")
    )
    assert page_of_scene.three_of(bundle) == kept
    other = bundle.replace("WebGLRenderer", "WebGPURenderer")
    assert page_of_scene.three_of(other) == other
    assert page_of_scene.three_of("define(()=>{});") == "define(()=>{});"


def test_rims_touch_the_ground_and_couplings_are_listed() -> None:
    """Wheels of the bicycle are circles about their hubs that turn with them and touch the ground."""
    scene = mbdlft.load_scene(ROOT / "scenarios" / "bicycle.toml")
    gear = mbdlft.multibody.Gear(name="gear", joints=("rear", "front"), ratio=1.5, stiffness=1.0)
    scene = scene.model_copy(update={"couplings": (gear,)})
    poses = scene_poses(scene)
    drawing = draw(poses, np.array([p.nominal for p in scene.parameters]))
    (coupling,) = [item for item in drawing.items if item["group"] == "couplings"]
    assert [(shape["type"], len(shape["points"])) for shape in coupling["shapes"]] == [("line", 2)]
    assert coupling["lines"][0] == "couples rear and front"
    rims = {item["name"]: item["shapes"] for item in drawing.items if item["group"] == "contacts"}
    assert len(rims) == len(scene.contacts) == 2
    for contact in scene.contacts:
        (rim,) = rims[contact.name]
        body, _, _ = contact.port.partition(".")
        points = drawing.numbers(ca.horzcat(*(drawing.vectors[k] for k in rim["points"]))).reshape(-1, 3)
        hub = drawing.numbers(poses.frames[body].r)
        radius = drawing.numbers(ca.SX(poses.values[f"contact {contact.name!r}"]["radius"]))[0]
        target(np.linalg.norm(points - hub, axis=1), np.full(len(points), radius), EVALUATION)
        assert abs(min(points[:, 2])) < 0.02 * radius  # 24 points
        assert np.ptp(points[:, 1]) < 1e-12


@pytest.mark.parametrize("seed", range(3))
def test_solids_have_the_inertia_of_their_bodies(seed: int) -> None:
    """Boxes, cylinders and a plate, turned and about a port, have the sizes from which they were made."""
    rng = np.random.default_rng(seed)
    (a, b, c, r, h), mass = rng.uniform(0.2, 2.0, 5), float(rng.uniform(1.0, 9.0))
    R, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    side = mass * (3.0 * r * r + h * h) / 12.0
    made = {
        "box": (np.array([b * b + c * c, a * a + c * c, a * a + b * b]) * mass / 12.0, [a, b, c]),
        "plate": (np.array([b * b, a * a, a * a + b * b]) * mass / 12.0, [a, b, 0.0]),
        "cylinder": (np.array([side, mass * r * r / 2.0, side]), [r, h]),
    }
    for name, (moments, sizes) in made.items():
        d, at = rng.standard_normal((2, 3))
        J = R @ np.diag(moments) @ R.T + mass * ((d @ d) * np.eye(3) - np.outer(d, d))
        entries = {"xyz"[i] + "xyz"[j]: float(J[i, j]) for i in range(3) for j in range(i, 3)}
        body = mbdlft.RigidBody(name="b", mass=mass, center_of_mass=tuple((at + d).tolist()),
                                ports={"p": tuple(at.tolist())},
                                inertia=mbdlft.Inertia(**entries, about="p"))  # fmt: skip
        free = mbdlft.Free(name="f", parent="ground", child="b")
        data = view_data(mbdlft.Scene(name="one", bodies=[body], joints=[free]))
        (shape,) = [s for item in data["items"] for s in item["shapes"] if s["layer"] == "solids"]
        kind = "cylinder" if name == "cylinder" else "box"
        found = shape["geometry"][kind] if kind == "cylinder" else sorted(shape["geometry"][kind])
        target(found, sizes if kind == "cylinder" else sorted(sizes), FINITE_ELEMENTS, 1.0)
        place = np.array(shape["geometry"]["place"]).reshape(4, 4)
        target(place[:3, 3], at + d, EVALUATION, 1.0)
        if kind == "cylinder":
            target(abs(place[:3, 2] @ R[:, 1]), 1.0, FINITE_ELEMENTS)


def test_an_inertia_that_no_solid_has_is_not_drawn() -> None:
    assert solid_of(1.0, np.diag([1.0, 1.0, 3.0])) is None
    assert solid_of(1.0, np.zeros((3, 3))) is None
    assert solid_of(0.0, np.eye(3)) is None


def test_shapes_of_a_scene_are_drawn_instead() -> None:
    """Of all bodies; the least and largest corner are those of the turned shape."""
    table, rod = (
        mbdlft.Shape(box=(4.0, 3.0, 0.1), at=(0.0, 0.0, -0.05)),
        mbdlft.Shape(cylinder=(0.1, 2.0), at=(0.5, 0.0, 0.0), axis=(1.0, 0.0, 0.0)),
    )
    nose = mbdlft.Shape(box=(0.2, 0.2, 1.0), at=(0.0, 0.0, 0.3), axis=(0.0, 0.0, -2.0))
    scene = kit.scene(
        "shapes",
        mbdlft.Ground(shape=table),
        kit.body("rod", 1.0, (1, 2, 2), shape=rod),
        kit.point("nose", 1.0, shape=nose),
        kit.hinge("a", "ground", "rod", (0, 0, 1)),
        kit.weld("b", "rod", "nose"),
    )
    data = view_data(scene)
    drawn = {
        item["name"]: shape["geometry"]
        for item in data["items"]
        for shape in item["shapes"]
        if shape["layer"] == "solids"
    }
    assert drawn["rod"]["cylinder"] == [0.1, 2.0]
    target(drawn["ground"]["extent"], [[-2.0, -1.5, -0.1], [2.0, 1.5, 0.0]], EVALUATION, 1.0)
    target(drawn["rod"]["extent"], [[-0.5, -0.1, -0.1], [1.5, 0.1, 0.1]], EVALUATION, 1.0)
    target(drawn["nose"]["extent"], [[-0.1, -0.1, -0.2], [0.1, 0.1, 0.8]], EVALUATION, 1.0)
    place = np.array(drawn["nose"]["place"]).reshape(4, 4)
    target(place[:3, 2], [0.0, 0.0, -1.0], EVALUATION)
    for wrong in ({}, {"sphere": -1.0}, {"sphere": 1.0, "box": (1.0, 1.0, 1.0)}):
        with pytest.raises(SceneError, match=r"expected (one of box|sizes above zero)"):
            mbdlft.Shape(**wrong)
