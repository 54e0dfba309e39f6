"""The gallery: a picture and a few facts of each scenario, written by `python -m docs.site.gallery`.

Pictures of mechanisms are those of `mbdlft report`, as SVG. What has no mechanism, matrices and Modelica
models, is shown by the orders and the singular values of its model. Orders and bounds are those of
docs/scenarios.md and of the models.
"""

import re
import sys
import tempfile
import textwrap
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.linalg import expm

import mbdlft
from mbdlft.base.parameter import Parameter
from mbdlft.modelica import ModelicaTable, load_modelica, load_modelica_table, operating_point
from mbdlft.show.viewer.stills import scene_film, scene_picture
from scenarios import sagging_arm

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
_WIDE = 520  # pixels of a figure
_EYES = {"double_pendulum_inverted": (0.5, 0.2), "double_pendulum_hanging": (0.5, 0.2),
         "pendulum": (0.5, 0.2), "two_link_arm": (0.3, 0.25), "gimbal": (0.5, 0.5)}  # fmt: skip
_HEAD = """# Gallery

Every scenario of the repository: what it is, how large its exact model is, and what may vary. Thin
arrows at joints are their axes, red, green and blue those of the ground, violet is gravity; the
[viewer](viewer.md) shows the same with sliders and moving modes. `python -m docs.site.gallery` writes
this page.
"""
_MATRICES = """## Matrices

A matrix has no mechanism to be seen: the figures show the singular values of samples, or the
repetitions of each parameter.
"""
_MODELICA = """## Modelica models

The singular values of the linear model around the equilibrium.
"""
_GROUPS = {
    "Machines on the ground": [
        "pendulum", "double_pendulum_hanging", "double_pendulum_inverted", "two_link_arm", "sagging_arm",
        "four_bar", "half_car", "crane", "tower_crane", "belt_gantry", "differential_wrist", "gimbal",
        "bicycle", "whipple_bicycle", "motorcycle", "wheelset", "rolling_disk", "segway", "diff_drive",
        "ball_turntable", "ur5", "desk_arm", "flexible_manipulator", "piezo_beam",
    ],
    "Aircraft, launchers, balloons": ["balloon_gondola", "launcher_slosh", "launcher_bending", "lander"],
    "Satellites": [
        "solar_arrays", "rotatory_spacecraft", "spinning_satellite", "control_moment_gyros",
        "mast_observatory", "flexible_pointing",
    ],
}  # fmt: skip


def orders() -> dict[str, tuple[int, int]]:
    """Order and proved bound of each row of docs/scenarios.md."""
    text = (DOCS / "scenarios.md").read_text(encoding="utf-8")
    found = {}
    for line in re.findall(r"^\| `\w+` \|.*$", text, re.MULTILINE):
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        order, bound = (cells[4], cells[5]) if len(cells) == 9 else (cells[7], cells[8])
        found[cells[0].strip("`")] = int(order), int(bound)
    return found


def scene_of_name(name: str) -> mbdlft.Scene:
    """The scene of a scenario."""
    if name == "sagging_arm":
        return sagging_arm.scene()
    if name == "desk_arm":
        return mbdlft.robot.load_robot(ROOT / "scenarios" / "desk_arm.urdf")[0]
    return mbdlft.load_scene(ROOT / "scenarios" / f"{name}.toml")


def picture_of(name: str) -> str:
    """The picture of a mechanism, as SVG."""
    azimuth, height = _EYES.get(name, (0.9, 0.35))
    return scene_picture(scene_of_name(name), azimuth, height) + "\n"


def film_of_bicycle() -> str:
    """The bicycle at 5 m/s after a push: it steers to where it leans, and stays up. Seen from behind."""
    scene, asked = scene_of_name("bicycle"), ("lean.rotation.z", "lean.rotation.x", "steer.angle")
    model = mbdlft.to_lft(scene.model_copy(update={"outputs": asked}), search=0.0)
    at, seconds, count = mbdlft.matrices_at(model, {"v": 5.0}), 4.0, 40
    start = np.array([0.6 * (state.name == "lean.rate.x") for state in model.states])  # rad/s
    moved = []
    for t in np.linspace(0.0, seconds, count, endpoint=False):
        yaw, lean, steer = at.C @ expm(at.A * t) @ start
        # x, y, z, small rotations of the frame; rear wheel, steering, front wheel
        moved.append(np.array([0.0, 0.0, 0.0, lean, 0.0, yaw, 0.0, steer, 0.0]))
    return scene_film(scene, moved, seconds, 2.5, 0.25) + "\n"


def trial_picture(path: Path) -> str:
    """The picture of a scene of docs/trials/, as SVG."""
    return scene_picture(mbdlft.load_scene(path), 0.6, 0.4) + "\n"


def entry(name: str, known: dict[str, tuple[int, int]]) -> str:
    """The paragraph of a mechanism."""
    scene = scene_of_name(name)
    file = {"sagging_arm": "sagging_arm.py", "desk_arm": "desk_arm.urdf"}.get(name, f"{name}.toml")
    about = scene.description or "A desk arm of a URDF file"
    if name in known:
        size = _size(*known[name])
    elif name == "sagging_arm":  # its position is no rational function: a fit with a proved bound
        fitted = mbdlft.fit_positions(scene, ["hinge"], tolerance=1e-4)
        order = mbdlft.to_lft(fitted).order
        size = f"Order {order}, with a rational fit of its angle, proved to 1e-4 rad."
    else:
        size = "Any of its numbers can become a parameter."
    film = {"bicycle": "\n![The bicycle rights itself after a push at 5 m/s](gallery/bicycle_film.svg)\n"}
    text = _entry(name, f"{name}.svg", about, size, scene.parameters, f"scenarios/{file}")
    return text + film.get(name, "")


def matrix_entry(name: str) -> str:
    """The paragraph of a matrix, and its figure."""
    problem = mbdlft.load_matrix(ROOT / "scenarios" / f"{name}.toml")
    model = mbdlft.realize(problem)
    _figure(model, name)
    size = _size(model.order, model.certificate.order_bound)
    about = _first_sentence(ROOT / "scenarios" / f"{name}.toml", "#")
    return _entry(name, f"{name}.webp", about, size, model.parameters, f"scenarios/{name}.toml")


def modelica_entry(path: Path, known: dict[str, tuple[int, int]]) -> str:
    """The paragraph of a Modelica model, and its figure."""
    file = path.with_suffix(".toml")
    asked = load_modelica_table(file) if file.exists() else ModelicaTable()
    dae, report = load_modelica(path, asked)
    model = mbdlft.linearize_dae(operating_point(dae, report, asked), search=0.0)
    _figure(model, path.stem)
    where = f"scenarios/modelica/{path.name}"
    return _entry(
        path.stem, f"{path.stem}.webp", dae.description, _size(*known[path.stem]), model.parameters, where
    )


def _is_scene(path: Path) -> bool:
    return "mbdlft-scene" in path.read_text(encoding="utf-8")


def _figure(model: mbdlft.LFTModel, name: str) -> None:
    """Singular values of a model with channels and states, otherwise bars of its orders."""
    from mbdlft.show import save_orders, save_singular_values

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "figure.png"
        if model.states and model.inputs and model.outputs:
            save_singular_values(file, model, most_samples=60)
        else:
            save_orders(file, model)
        with Image.open(file) as image:
            image.thumbnail((_WIDE, _WIDE))
            image.convert("RGB").save(DOCS / "gallery" / f"{name}.webp", quality=70, method=6)


def _size(order: int, bound: int) -> str:
    """A sentence on an order and its bound."""
    if order == bound:
        return f"Order {order}, proved minimal."
    return f"Order {order}; at least {bound}, proved."


def _first_sentence(path: Path, mark: str) -> str:
    """The first sentence of the comment at the top of a file."""
    lines = []
    for line in path.read_text(encoding="utf-8").splitlines():
        if not line.startswith(mark):
            break
        lines.append(line.lstrip(mark).strip())
    return re.split(r"(?<=[a-z)])[.:]\s", " ".join(lines) + " ")[0].rstrip(". ")


def _entry(
    name: str, picture: str, about: str, size: str, parameters: Sequence[Parameter], file: str
) -> str:
    ranges = ", ".join(
        f"`{p.name}` {p.low:g} to {p.high:g}{'' if p.unit == '1' else ' ' + p.unit}" for p in parameters
    )
    about = about.rstrip(".")
    text = f"{about}. {size} ({f'Parameters: {ranges}' if ranges else 'No parameters'}; `{file}`.)"
    return f"### {name}\n\n![{about}](gallery/{picture})\n\n{textwrap.fill(text, 140)}\n"


def write_gallery() -> None:
    """Write docs/gallery.md and the pictures beside it, and those of docs/trials.md."""
    folder, known = DOCS / "gallery", orders()
    folder.mkdir(exist_ok=True)
    for path in sorted((DOCS / "trials").glob("*.toml")):
        path.with_suffix(".svg").write_text(trial_picture(path), encoding="utf-8")
    (folder / "bicycle_film.svg").write_text(film_of_bicycle(), encoding="utf-8")
    parts = [_HEAD]
    known_names = {name for names in _GROUPS.values() for name in names}
    scenes = [path for path in sorted((ROOT / "scenarios").glob("*.toml")) if _is_scene(path)]
    others = [path.stem for path in scenes if path.stem not in known_names]
    for title, names in {**_GROUPS, **({"Others": others} if others else {})}.items():
        parts.append(f"## {title}\n")
        for name in names:
            (folder / f"{name}.svg").write_text(picture_of(name), encoding="utf-8")
            parts.append(entry(name, known))
    parts.append(_MATRICES)
    parts += [matrix_entry(name) for name in ("lateral_aircraft", "missile")]
    parts.append(_MODELICA)
    files = sorted((ROOT / "scenarios" / "modelica").glob("*.mo"))
    parts += [modelica_entry(path, known) for path in files]
    (DOCS / "gallery.md").write_text("\n".join(parts), encoding="utf-8")


if __name__ == "__main__":
    write_gallery()
    sys.stdout.write(f"{DOCS / 'gallery.md'}\n")
