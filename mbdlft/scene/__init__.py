"""The user's description of a system, and its way to equations."""

from mbdlft.scene.assemble import assemble as assemble
from mbdlft.scene.assemble import assemble_by_products as assemble_by_products
from mbdlft.scene.scene import NEEDED as NEEDED
from mbdlft.scene.scene import Constant as Constant
from mbdlft.scene.scene import Fit as Fit
from mbdlft.scene.scene import Scene as Scene
from mbdlft.scene.scene import Spin as Spin
from mbdlft.scene.toml import load_scene as load_scene
from mbdlft.scene.toml import scene_from_toml as scene_from_toml
from mbdlft.scene.toml import scene_to_toml as scene_to_toml
from mbdlft.scene.urdf import ImportReport as ImportReport
from mbdlft.scene.urdf import JointLimit as JointLimit
from mbdlft.scene.urdf import load_urdf as load_urdf
