"""mbdlft: exact, small linear models of multibody systems, with their parameters left in.

What most scripts need is here, some 45 names (``dir(mbdlft)``, ``from mbdlft import *``): `load_scene`,
`to_lft`, `matrices_at`, `feedback`, `robust_stability`, `save`. The rest is in namespaces, in the order
of the path of the data:

- `mbdlft.multibody`: bodies, joints, loads, sensors, scenes and their equilibria
- `mbdlft.elastic`: flexible bodies of finite-element data; `mbdlft.robot`: robots
- `mbdlft.matrix`: matrices that are rational in parameters
- `mbdlft.dae`: differential-algebraic models, and linear ones with nonlinear functions of them
- `mbdlft.modelica`: Modelica models as descriptions of differential-algebraic ones
- `mbdlft.system`: finished models, and what connects, inverts, truncates them
- `mbdlft.library`: actuators, filters, two-ports
- `mbdlft.analyze`: responses at samples, and what is proved on all values
- `mbdlft.synthesis`: controllers tuned for goals at the worst values, with a proof
- `mbdlft.archive`, `mbdlft.batch`: archives and sweeps
- `mbdlft.show`: figures, pages that show a scene, reports on a model
- `mbdlft.export`: files for MATLAB, Octave, C and Julia, and matrices on a grid
- `mbdlft.base`: parameters, samples, signals, errors

Every part is imported when it is first used: reading archives needs numpy and h5py only. In this version
every public name of a namespace is also found here.
"""

import importlib
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mbdlft.analyze import *
    from mbdlft.archive import *
    from mbdlft.base import *
    from mbdlft.batch import *
    from mbdlft.dae import *
    from mbdlft.elastic import *
    from mbdlft.export import *
    from mbdlft.lft import *
    from mbdlft.library import *
    from mbdlft.matrix import *
    from mbdlft.modelica import *
    from mbdlft.multibody import *
    from mbdlft.pipeline import *
    from mbdlft.problem import *
    from mbdlft.robot import *
    from mbdlft.show import *
    from mbdlft.synthesis import *
    from mbdlft.system import *

if TYPE_CHECKING:  # public names that are also those of modules, which come with the lines above
    from mbdlft.archive import load as load
    from mbdlft.batch import sweep as sweep
    from mbdlft.dae import trim as trim
    from mbdlft.system import lft as lft

__version__ = "0.1.0"

# what most scripts need, by the path of the data: the names of README and tutorial
_FIRST = {
    name: namespace
    for namespace, names in {
        "base": "Angle Parameter corners grid random",
        "multibody": "Scene load_scene notes find_equilibrium RigidBody PointMass Inertia Beam Force"
        " Torque Fixed Revolute Prismatic Spherical Free",
        "robot": "load_robot",
        "matrix": "load_matrix",
        "modelica": "load_modelica",
        "pipeline": "to_lft realize linearize_dae",
        "system": "matrices_at trim_at as_system series feedback connect append",
        "analyze": "frequency_response damping_table check_stability robust_stability worst_case"
        " worst_case_gain verify",
        "synthesis": "tune",
        "batch": "sweep",
        "archive": "save load save_analysis load_analysis load_sweep",
        "show": "view",
    }.items()
    for name in names.split()
}
_NAMESPACES = (
    "base",
    "multibody",
    "system",
    "archive",
    "analyze",
    "batch",
    "dae",
    "elastic",
    "export",
    "library",
    "matrix",
    "modelica",
    "robot",
    "show",
    "synthesis",
)
_ELSEWHERE = ("lft", "pipeline", "problem")  # rooms that have names of the list above, and no more
_MODULES = {
    "fit": "mbdlft.multibody.equilibrium.fit",
    "lft": "mbdlft.lft",  # the function of this name is mbdlft.system.lft only
}

__all__ = sorted([*_FIRST, *_NAMESPACES])


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return importlib.import_module(_MODULES[name])
    if name in _NAMESPACES:
        return importlib.import_module(f"mbdlft.{name}")
    if name in _FIRST:
        return getattr(importlib.import_module(f"mbdlft.{_FIRST[name]}"), name)
    if name.startswith("_"):
        raise AttributeError(f"module 'mbdlft' has no attribute {name!r}")
    where: dict[str, str] = {}
    for namespace in (*_NAMESPACES, *_ELSEWHERE):
        module = importlib.import_module(f"mbdlft.{namespace}")
        if name in module.__all__:
            return getattr(module, name)
        where |= dict.fromkeys(module.__all__, namespace)
    near = [
        f"mbdlft.{other}" if where[other] in _ELSEWHERE else f"mbdlft.{where[other]}.{other}"
        for other in get_close_matches(name, where)
    ]
    meant = f" Did you mean {' or '.join(near)}?" if near else " dir(mbdlft) lists what there is."
    raise AttributeError(f"module 'mbdlft' has no attribute {name!r}.{meant}")


def __dir__() -> list[str]:
    return __all__
