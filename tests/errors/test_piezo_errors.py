"""Errors of beams with piezoelectric patches."""

from mbdlft import PiezoBeam, PiezoPatch
from tests.errors.table import refused


def patch(**fields: object) -> PiezoPatch:
    given = {
        "start": 0,
        "end": 2,
        "width": 0.02,
        "thickness": 1e-3,
        "density": 7600,
        "modulus": 5e10,
        "d31": -1.5e-10,
        "permittivity": 1.59e-8,
    }
    return PiezoPatch(**(given | fields))


def beam(*patches: PiezoPatch, **fields: object) -> PiezoBeam:
    sizes = {"length": 1, "area": 1e-4, "I_z": 1e-9, "thickness": 0.01}
    given = {"density": 2600, "modulus": 6e10, "elements": 2, "deformations": ["axial", "bending_y"]}
    return PiezoBeam(**({"name": "b", "patches": patches} | sizes | given | fields))


test_messages = refused(
    r"""
patch(side="left") => patches: unknown side 'left'.
patch(start=2) => patches: expected a node 'end' after 'start', got start = 2 and
patch(wdth=1) => patches: unknown key 'wdth'.
beam() => body 'b': patches: at least one is needed; without any the beam is a
beam(patch(end=3)) => patch 1: expected nodes from 0 to 2, got end = 3.
beam(patch(), deformations=["bending_y"])
    => patch 1, side 'top': it needs the deformation 'axial', which the beam does not have
beam(patch(side="both"), deformations=["axial"])
    => patch 1, side 'both': it needs the deformation 'bending_y'
beam(patch(), shear_coefficient=0.8, shear_modulus=2e10)
    => shear_coefficient: a beam with patches has no shear.
> assemble(Scene(name='s', parameters=[Parameter('q', 0.001, low=-0.001, high=0.002, unit='m')],
    bodies=[{}], joints=[Fixed(name='wall', parent='ground', child='b')])) => SceneError: body 'b':
beam(patch(permittivity=1.59e-12))
    => patch1: permittivity - d31^2 modulus, that at constant strain, is not positive
beam(patch(), patch(thickness="q")) => patch2.thickness is not positive in the
beam(patch(), thickness=-0.01) => thickness is not positive in the range: -0.01.
beam(patch(), area=-1e-4) => area is not positive in the range
"""
)
