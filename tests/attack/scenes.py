"""Mutated scenes: a model that equals its equations, or an error of the package; random ones, too."""

import tomllib
from pathlib import Path

import numpy as np

import mbdlft
from mbdlft import MbdlftError, WellPosednessError, scene_from_toml, scene_to_toml, to_lft
from mbdlft.multibody.to_problem import problem_of_scene
from tests import kit
from tests.attack.mechanisms import check, points_of
from tests.attack.mutations import changed, check_message
from tests.attack.structures import as_toml, restructured
from tests.close import SCENARIO
from tests.cross.mechanisms import closed_loop, open_tree
from tests.cross.mixed_mechanisms import mixed
from tests.strategies import random_scene

ROOT = Path(__file__).parents[2]
SOURCES = (
    "two_link_arm", "two_link_arm", "pendulum", "crane", "gimbal", "four_bar", "launcher_slosh",
    "double_pendulum_inverted", "balloon_gondola", "spinning_satellite", "flexible_manipulator",
    "launcher_bending", "mast_observatory", "ur5",
)  # fmt: skip
CART = kit.scene(
    "cart",
    mbdlft.Parameter("m", 1.0, percent=20, unit="kg"),
    mbdlft.Parameter("k", 0.1, low=0.05, high=0.3, unit="N/m"),
    kit.body("cart", "m", (0.2, 0.1, 0.2), center_of_mass=(0, 0.1, 0), ports={"tip": (0, 1.0, 0)}),
    mbdlft.Beam(
        name="boom", length=2.0, density=2700.0, modulus=7e10, prestress="neglected", area=1e-3, I_y=1e-7,
        I_z=1e-7, deformations=("bending_z",),
    ),
    kit.rail("rail", "ground", "cart", (0, 1, 0), stiffness="k"),
    kit.hinge("hinge", "cart.tip", "boom", (1, 0, 0), stiffness=2.0, damping=0.1),
    gravity=(0.0, -9.81, 0.0),
)  # fmt: skip


def texts() -> list[str]:
    """The scenes that are mutated."""
    return [(ROOT / "scenarios" / f"{name}.toml").read_text("utf-8") for name in SOURCES] + [
        scene_to_toml(CART)
    ]


def attack(seed: int, folder: Path) -> str:
    """Mutate a scene as a text or as a tree and linearize it, or derive a random one in another way."""
    random = np.random.default_rng(seed)
    way = random.random()
    if way < 0.05:
        return derived(seed, random)
    if way < 0.2:
        makers = (random_scene, mixed, open_tree, closed_loop)
        given = scene_to_toml(makers[int(random.integers(len(makers)))](seed))
    else:
        given = texts()[int(random.integers(len(texts())))]
    if way < 0.6:
        return linearized(as_toml(restructured(tomllib.loads(given), random)), random)
    return linearized(changed(given, random), random)


def linearized(text: str, random: np.random.Generator) -> str:
    """Read a text and linearize the scene; its model equals the equations, solved again elsewhere."""
    try:
        scene = scene_from_toml(text)
    except MbdlftError as error:
        check_message(error)
        return "refused as text"
    try:
        model = to_lft(scene, search=0.0)
    except MbdlftError as error:
        check_message(error)
        return "refused as scene"
    for matrix in (model.lft.M11, model.lft.M12, model.lft.M21, model.lft.M22):
        assert np.isfinite(matrix).all()
    sides = random.uniform(0.0, 1.0, (3, len(model.parameters)))
    sides[:2] = np.rint(sides[:2])
    low, high = (np.array([getattr(p, end) for p in model.parameters]) for end in ("low", "high"))
    points = np.clip(low + sides * (high - low), low, high)
    try:
        found = mbdlft.matrices_at(model, {p.name: points[:, k] for k, p in enumerate(model.parameters)})
        reference = problem_of_scene(scene).reference()
        assert reference.in_digits is not None
        expected = reference.in_digits(points)
    except WellPosednessError as error:
        check_message(error)
        return "linearized, refused at a point"
    blocks = np.block([[found.A, found.B], [found.C, found.D]])
    blocks = np.broadcast_to(blocks, expected.shape)  # one of all points if there is no parameter
    size = np.maximum(reference.scale, np.max(np.abs(expected), axis=0))
    worst = float(np.max(np.abs(blocks - expected) / size[None], initial=0.0))
    allowed = max(SCENARIO, 100.0 * model.certificate.max_relative_error)
    assert worst <= allowed, f"differs by {worst:.1e}, the certificate says {allowed:.1e}\n{text}"
    return "linearized"


def derived(seed: int, random: np.random.Generator) -> str:
    """A random scene as it is, whose equations are derived in another way."""
    scene = (random_scene, open_tree, closed_loop)[int(random.integers(3))](seed)
    try:
        model = to_lft(scene, search=0.0)
    except MbdlftError as error:
        check_message(error)
        return f"refused, not compared: {type(error).__name__}"
    check(scene, model, points_of(scene, seed))
    return "as maximal coordinates"
