"""mbdlft: exact, small linear models of multibody systems, with their parameters left in.

The names below are the public ones. Those that build models need CasADi, those that truncate
them scipy; they are imported when they are first used, so that reading archives needs numpy and h5py
only.
"""

import importlib
from typing import TYPE_CHECKING, Any

from mbdlft.analyze import corners as corners
from mbdlft.analyze import frequency_response as frequency_response
from mbdlft.analyze import grid as grid
from mbdlft.analyze import random as random
from mbdlft.analyze import singular_values as singular_values
from mbdlft.errors import AnalysisError as AnalysisError
from mbdlft.errors import ArchiveError as ArchiveError
from mbdlft.errors import MbdlftError as MbdlftError
from mbdlft.errors import NotRationalError as NotRationalError
from mbdlft.errors import SceneError as SceneError
from mbdlft.errors import StructureError as StructureError
from mbdlft.errors import TrimError as TrimError
from mbdlft.errors import WellPosednessError as WellPosednessError
from mbdlft.lft.lft import LFT as LFT
from mbdlft.lft.lft import Block as Block
from mbdlft.lft.model import Certificate as Certificate
from mbdlft.lft.model import LFTModel as LFTModel
from mbdlft.lft.model import matrices_at as matrices_at
from mbdlft.lft.model import trim_at as trim_at
from mbdlft.parameter import Angle as Angle
from mbdlft.parameter import Parameter as Parameter
from mbdlft.parameter import to_delta as to_delta
from mbdlft.parameter import to_physical as to_physical
from mbdlft.signal import Signal as Signal
from mbdlft.store import load as load
from mbdlft.store import model_names as model_names
from mbdlft.store import save as save

if TYPE_CHECKING:
    from mbdlft.body import Ground as Ground
    from mbdlft.body import Inertia as Inertia
    from mbdlft.body import PointMass as PointMass
    from mbdlft.body import RigidBody as RigidBody
    from mbdlft.build import to_lft as to_lft
    from mbdlft.exact import exact_lower_bound as exact_lower_bound
    from mbdlft.joint import Fixed as Fixed
    from mbdlft.joint import Prismatic as Prismatic
    from mbdlft.joint import Revolute as Revolute
    from mbdlft.lft.truncate import truncate as truncate
    from mbdlft.matrix import MatrixProblem as MatrixProblem
    from mbdlft.matrix import load_matrix as load_matrix
    from mbdlft.matrix import matrix_from_toml as matrix_from_toml
    from mbdlft.matrix import matrix_problem as matrix_problem
    from mbdlft.matrix import matrix_to_toml as matrix_to_toml
    from mbdlft.realization import realize as realize
    from mbdlft.scene import Constant as Constant
    from mbdlft.scene import Scene as Scene
    from mbdlft.scene import assemble as assemble
    from mbdlft.scene import load_scene as load_scene
    from mbdlft.scene import scene_from_toml as scene_from_toml
    from mbdlft.scene import scene_to_toml as scene_to_toml
    from mbdlft.trim import solve_trim as solve_trim

__version__ = "0.1.0"

_ON_FIRST_USE = {
    "Ground": "mbdlft.body",
    "Inertia": "mbdlft.body",
    "PointMass": "mbdlft.body",
    "RigidBody": "mbdlft.body",
    "to_lft": "mbdlft.build",
    "exact_lower_bound": "mbdlft.exact",
    "truncate": "mbdlft.lft.truncate",
    "Fixed": "mbdlft.joint",
    "Prismatic": "mbdlft.joint",
    "Revolute": "mbdlft.joint",
    "MatrixProblem": "mbdlft.matrix",
    "load_matrix": "mbdlft.matrix",
    "matrix_from_toml": "mbdlft.matrix",
    "matrix_problem": "mbdlft.matrix",
    "matrix_to_toml": "mbdlft.matrix",
    "realize": "mbdlft.realization",
    "Constant": "mbdlft.scene",
    "Scene": "mbdlft.scene",
    "assemble": "mbdlft.scene",
    "load_scene": "mbdlft.scene",
    "scene_from_toml": "mbdlft.scene",
    "scene_to_toml": "mbdlft.scene",
    "solve_trim": "mbdlft.trim",
}

__all__ = sorted(
    {name for name, item in globals().items() if name[0] != "_" and hasattr(item, "__module__")}
    - {"Any"}
    | set(_ON_FIRST_USE)
)


def __getattr__(name: str) -> Any:
    if name in _ON_FIRST_USE:
        return getattr(importlib.import_module(_ON_FIRST_USE[name]), name)
    raise AttributeError(f"module 'mbdlft' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_ON_FIRST_USE})
