"""Scenes: the user's description of a system, its TOML form, and its checks."""

from mbdlft.multibody.scene.scene import NEEDED as NEEDED
from mbdlft.multibody.scene.scene import Constant as Constant
from mbdlft.multibody.scene.scene import Fit as Fit
from mbdlft.multibody.scene.scene import Scene as Scene
from mbdlft.multibody.scene.scene import Spin as Spin
from mbdlft.multibody.scene.toml import load_scene as load_scene
from mbdlft.multibody.scene.toml import scene_from_toml as scene_from_toml
from mbdlft.multibody.scene.toml import scene_schema as scene_schema
from mbdlft.multibody.scene.toml import scene_to_toml as scene_to_toml
