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
from mbdlft.store import Sweep as Sweep
from mbdlft.store import load as load
from mbdlft.store import load_sweep as load_sweep
from mbdlft.store import model_names as model_names
from mbdlft.store import save as save
from mbdlft.store import sweep_names as sweep_names

if TYPE_CHECKING:
    from mbdlft.actuator import ArrayDrive as ArrayDrive
    from mbdlft.actuator import array_drive as array_drive
    from mbdlft.actuator import band_pass as band_pass
    from mbdlft.actuator import delay as delay
    from mbdlft.actuator import imbalance as imbalance
    from mbdlft.actuator import low_pass as low_pass
    from mbdlft.batch import GridSamples as GridSamples
    from mbdlft.batch import RandomSamples as RandomSamples
    from mbdlft.batch import SweepReport as SweepReport
    from mbdlft.batch import read_samples as read_samples
    from mbdlft.batch import sweep as sweep
    from mbdlft.body import Beam as Beam
    from mbdlft.body import FlexibleBody as FlexibleBody
    from mbdlft.body import Ground as Ground
    from mbdlft.body import Inertia as Inertia
    from mbdlft.body import Mode as Mode
    from mbdlft.body import PiezoBeam as PiezoBeam
    from mbdlft.body import PiezoPatch as PiezoPatch
    from mbdlft.body import PointMass as PointMass
    from mbdlft.body import RigidBody as RigidBody
    from mbdlft.build import to_lft as to_lft
    from mbdlft.channel import TunableGain as TunableGain
    from mbdlft.channel import TunablePlant as TunablePlant
    from mbdlft.channel import invert_channels as invert_channels
    from mbdlft.channel import series as series
    from mbdlft.channel import tunable as tunable
    from mbdlft.equilibrium import EquilibriumPoint as EquilibriumPoint
    from mbdlft.equilibrium import at_equilibrium as at_equilibrium
    from mbdlft.equilibrium import eigenvalues_at as eigenvalues_at
    from mbdlft.equilibrium import find_equilibrium as find_equilibrium
    from mbdlft.equilibrium import fit_positions as fit_positions
    from mbdlft.exact import exact_lower_bound as exact_lower_bound
    from mbdlft.force import Buoyancy as Buoyancy
    from mbdlft.force import Force as Force
    from mbdlft.force import Spring as Spring
    from mbdlft.force import Torque as Torque
    from mbdlft.joint import Cylindrical as Cylindrical
    from mbdlft.joint import Fixed as Fixed
    from mbdlft.joint import Free as Free
    from mbdlft.joint import Planar as Planar
    from mbdlft.joint import Prismatic as Prismatic
    from mbdlft.joint import Revolute as Revolute
    from mbdlft.joint import Rotation as Rotation
    from mbdlft.joint import Spherical as Spherical
    from mbdlft.joint import Universal as Universal
    from mbdlft.lft.truncate import truncate as truncate
    from mbdlft.loop import Loop as Loop
    from mbdlft.matrix import MatrixProblem as MatrixProblem
    from mbdlft.matrix import load_matrix as load_matrix
    from mbdlft.matrix import matrix_from_toml as matrix_from_toml
    from mbdlft.matrix import matrix_problem as matrix_problem
    from mbdlft.matrix import matrix_to_toml as matrix_to_toml
    from mbdlft.modal import EffectiveMasses as EffectiveMasses
    from mbdlft.modal import FiniteElements as FiniteElements
    from mbdlft.modal import Interface as Interface
    from mbdlft.modal import ModalModel as ModalModel
    from mbdlft.modal import Nodes as Nodes
    from mbdlft.modal import effective_masses as effective_masses
    from mbdlft.modal import every_dof as every_dof
    from mbdlft.modal import flexible_body as flexible_body
    from mbdlft.modal import load_body as load_body
    from mbdlft.modal import load_matrices as load_matrices
    from mbdlft.modal import load_nastran as load_nastran
    from mbdlft.modal import modal_body as modal_body
    from mbdlft.modal import modal_model as modal_model
    from mbdlft.modal import model_of_results as model_of_results
    from mbdlft.modal import save_matrices as save_matrices
    from mbdlft.modal import to_si as to_si
    from mbdlft.port import two_port as two_port
    from mbdlft.realization import realize as realize
    from mbdlft.scene import Constant as Constant
    from mbdlft.scene import Fit as Fit
    from mbdlft.scene import ImportReport as ImportReport
    from mbdlft.scene import JointLimit as JointLimit
    from mbdlft.scene import Scene as Scene
    from mbdlft.scene import Spin as Spin
    from mbdlft.scene import assemble as assemble
    from mbdlft.scene import load_scene as load_scene
    from mbdlft.scene import load_urdf as load_urdf
    from mbdlft.scene import scene_from_toml as scene_from_toml
    from mbdlft.scene import scene_to_toml as scene_to_toml
    from mbdlft.sensor import Acceleration as Acceleration
    from mbdlft.sensor import Accelerometer as Accelerometer
    from mbdlft.sensor import AngularAcceleration as AngularAcceleration
    from mbdlft.sensor import AngularRate as AngularRate
    from mbdlft.sensor import CenterOfMass as CenterOfMass
    from mbdlft.sensor import Gyro as Gyro
    from mbdlft.sensor import JointWrench as JointWrench
    from mbdlft.sensor import Momentum as Momentum
    from mbdlft.sensor import Position as Position
    from mbdlft.sensor import SmallRotation as SmallRotation
    from mbdlft.sensor import Velocity as Velocity
    from mbdlft.trim import solve_trim as solve_trim

__version__ = "0.1.0"

_ON_FIRST_USE = {
    "ArrayDrive": "mbdlft.actuator",
    "array_drive": "mbdlft.actuator",
    "band_pass": "mbdlft.actuator",
    "delay": "mbdlft.actuator",
    "imbalance": "mbdlft.actuator",
    "low_pass": "mbdlft.actuator",
    "GridSamples": "mbdlft.batch",
    "RandomSamples": "mbdlft.batch",
    "SweepReport": "mbdlft.batch",
    "read_samples": "mbdlft.batch",
    "sweep": "mbdlft.batch",
    "Beam": "mbdlft.body",
    "FlexibleBody": "mbdlft.body",
    "Mode": "mbdlft.body",
    "Ground": "mbdlft.body",
    "Inertia": "mbdlft.body",
    "PiezoBeam": "mbdlft.body",
    "PiezoPatch": "mbdlft.body",
    "PointMass": "mbdlft.body",
    "RigidBody": "mbdlft.body",
    "to_lft": "mbdlft.build",
    "TunableGain": "mbdlft.channel",
    "TunablePlant": "mbdlft.channel",
    "invert_channels": "mbdlft.channel",
    "series": "mbdlft.channel",
    "tunable": "mbdlft.channel",
    "EquilibriumPoint": "mbdlft.equilibrium",
    "at_equilibrium": "mbdlft.equilibrium",
    "eigenvalues_at": "mbdlft.equilibrium",
    "find_equilibrium": "mbdlft.equilibrium",
    "fit_positions": "mbdlft.equilibrium",
    "exact_lower_bound": "mbdlft.exact",
    "Buoyancy": "mbdlft.force",
    "Force": "mbdlft.force",
    "Spring": "mbdlft.force",
    "Torque": "mbdlft.force",
    "Cylindrical": "mbdlft.joint",
    "Fixed": "mbdlft.joint",
    "Free": "mbdlft.joint",
    "Planar": "mbdlft.joint",
    "Prismatic": "mbdlft.joint",
    "Revolute": "mbdlft.joint",
    "Rotation": "mbdlft.joint",
    "Spherical": "mbdlft.joint",
    "Universal": "mbdlft.joint",
    "truncate": "mbdlft.lft.truncate",
    "Loop": "mbdlft.loop",
    "MatrixProblem": "mbdlft.matrix",
    "load_matrix": "mbdlft.matrix",
    "matrix_from_toml": "mbdlft.matrix",
    "matrix_problem": "mbdlft.matrix",
    "matrix_to_toml": "mbdlft.matrix",
    "FiniteElements": "mbdlft.modal",
    "Interface": "mbdlft.modal",
    "ModalModel": "mbdlft.modal",
    "Nodes": "mbdlft.modal",
    "every_dof": "mbdlft.modal",
    "flexible_body": "mbdlft.modal",
    "load_nastran": "mbdlft.modal",
    "load_body": "mbdlft.modal",
    "load_matrices": "mbdlft.modal",
    "save_matrices": "mbdlft.modal",
    "EffectiveMasses": "mbdlft.modal",
    "effective_masses": "mbdlft.modal",
    "modal_body": "mbdlft.modal",
    "modal_model": "mbdlft.modal",
    "model_of_results": "mbdlft.modal",
    "to_si": "mbdlft.modal",
    "two_port": "mbdlft.port",
    "realize": "mbdlft.realization",
    "Constant": "mbdlft.scene",
    "ImportReport": "mbdlft.scene",
    "JointLimit": "mbdlft.scene",
    "Fit": "mbdlft.scene",
    "Scene": "mbdlft.scene",
    "Spin": "mbdlft.scene",
    "assemble": "mbdlft.scene",
    "load_scene": "mbdlft.scene",
    "load_urdf": "mbdlft.scene",
    "scene_from_toml": "mbdlft.scene",
    "scene_to_toml": "mbdlft.scene",
    "Acceleration": "mbdlft.sensor",
    "Accelerometer": "mbdlft.sensor",
    "AngularAcceleration": "mbdlft.sensor",
    "AngularRate": "mbdlft.sensor",
    "CenterOfMass": "mbdlft.sensor",
    "Gyro": "mbdlft.sensor",
    "JointWrench": "mbdlft.sensor",
    "Momentum": "mbdlft.sensor",
    "Position": "mbdlft.sensor",
    "SmallRotation": "mbdlft.sensor",
    "Velocity": "mbdlft.sensor",
    "solve_trim": "mbdlft.trim",
}

_MODULES = ("fit", "plot")  # what they have is named with them: mbdlft.plot.save_singular_values

__all__ = sorted(
    {name for name, item in globals().items() if name[0] != "_" and hasattr(item, "__module__")}
    - {"Any"}
    | set(_ON_FIRST_USE)
)


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return importlib.import_module(f"mbdlft.{name}")
    if name in _ON_FIRST_USE:
        return getattr(importlib.import_module(_ON_FIRST_USE[name]), name)
    raise AttributeError(f"module 'mbdlft' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_ON_FIRST_USE, *_MODULES})
