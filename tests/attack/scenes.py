"""Mutated texts of scenes: a model whose numbers are finite, or an error of the package."""

from pathlib import Path

import numpy as np

from mbdlft import MbdlftError, scene_from_toml, to_lft
from tests.attack.mutations import changed, check_message

ROOT = Path(__file__).parents[2]
SOURCES = ("two_link_arm.toml",)
CART = """
format = "mbdlft-scene/1"
name = "cart"
gravity = [0.0, -9.81, 0.0]

[parameters]
m = { nominal = 1.0, percent = 20, unit = "kg" }
k = { nominal = 0.1, low = 0.05, high = 0.3, unit = "N/m" }

[bodies.cart]
kind = "rigid"
mass = "m"
center_of_mass = [0, 0.1, 0]
inertia = { xx = 0.2, yy = 0.1, zz = 0.2 }
ports.tip = [0, 1.0, 0]

[bodies.boom]
kind = "beam"
length = 2.0
density = 2700.0
modulus = 7e10
prestress = "neglected"
area = 1e-3
I_y = 1e-7
I_z = 1e-7
deformations = ["bending_z"]

[joints.rail]
kind = "prismatic"
parent = "ground"
child = "cart"
axis = [0, 1, 0]
stiffness = "k"

[joints.hinge]
kind = "revolute"
parent = "cart.tip"
child = "boom"
axis = [1, 0, 0]
stiffness = 2.0
damping = 0.1
"""


def texts() -> list[str]:
    """The scenes that are mutated."""
    return [(ROOT / "scenarios" / name).read_text(encoding="utf-8") for name in SOURCES] + [CART]


def attack(seed: int, folder: Path) -> str:
    """Mutate the text of a scene, read it, linearize it."""
    random = np.random.default_rng(seed)
    given = texts()
    text = changed(given[int(random.integers(len(given)))], random)
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
    assert np.isfinite(model.lft.M22).all()
    return "linearized"
