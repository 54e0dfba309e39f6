"""What finite elements or modes of a uniform beam do to its frequencies, against the exact ones.

With s = x/L the frequencies of bending without shear and rotary inertia are z^2 (E I/(rho A))^(1/2)/L^2,
where cos z cosh z = -1 if the tip is free and 1 if it is clamped; those of elongation and torsion are
(k - 1/2) pi and k pi times a velocity over L. So the relative errors depend on no parameter.
"""

from typing import NamedTuple

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from mbdlft.multibody.body.beam import Beam
from mbdlft.multibody.body.beam_elements import Deformation, products, strain, values_at

SUPPORTS = ("free", "clamped")


class FrequencyErrors(NamedTuple):
    """Relative errors of the lowest frequencies of one deformation of a beam clamped at its origin.

    Attributes
    ----------
    deformation : such as ``bending_y``
    tip : ``free`` or ``clamped``, the support of the tip
    errors : (n,), positive where a frequency is too high
    """

    deformation: str
    tip: str
    errors: NDArray[np.float64]


def frequency_errors(beam: Beam, count: int = 4) -> tuple[FrequencyErrors, ...]:
    """Relative errors of the `count` lowest frequencies of each deformation, or of as many as it has.

    A beam with a `shear_coefficient` has no row for bending: its errors depend on its section. Rotary
    inertia and patches are left out.
    """
    found = []
    for name, d, _ in beam.blocks():
        if d.functions == "shear" and name.startswith("bending"):
            continue
        mass, stiffness = products(d, "displacement"), products(d, strain(d))
        for tip in SUPPORTS:
            free = _free(d, tip)
            squares = scipy.linalg.eigvalsh(free.T @ mass @ free, free.T @ stiffness @ free)[::-1]
            frequencies = 1.0 / np.sqrt(squares[:count])
            exact = np.array([_exact(d, tip, k + 1) for k in range(len(frequencies))])
            found.append(FrequencyErrors(name, tip, frequencies / exact - 1.0))
    return tuple(found)


def error_sentence(beam: Beam) -> str:
    """A sentence on the errors of the first four frequencies of each kind of deformation."""
    shapes = f"{beam.elements} elements" if beam.modes is None else f"{beam.modes} modes"
    worst: dict[str, dict[str, float]] = {}
    for name, tip, errors in frequency_errors(beam):
        kind = name.partition("_")[0]
        largest = float(np.max(np.abs(errors), initial=0.0))
        worst.setdefault(kind, {})[tip] = max(largest, worst.get(kind, {}).get(tip, 0.0))
    listed = "; ".join(
        f"{kind} {own['free']:.1e} (tip free), {own['clamped']:.1e} (tip clamped)"
        for kind, own in worst.items()
    )
    return (
        f"beam {beam.name!r}, {shapes}: errors of the first four frequencies by the shape functions: "
        f"{listed or 'not known with shear'}"
    )


def _free(d: Deformation, tip: str) -> NDArray[np.float64]:
    """A basis (n, m) of the deformations that the support of the tip allows."""
    held = [values_at(d, "displacement", d.elements)]
    if d.name.startswith("bending"):
        held.append(values_at(d, "turn", d.elements))
    n = len(held[0])
    return np.asarray(np.eye(n) if tip == "free" else scipy.linalg.null_space(np.array(held)))


def _exact(d: Deformation, tip: str, number: int) -> float:
    """The exact frequency, over what it is proportional to, of one mode, counted from 1."""
    from scipy.optimize import brentq  # here because it is slow to import

    free = tip == "free"
    if not d.name.startswith("bending"):
        return float((number - 0.5 if free else number) * np.pi)
    first = number - 1 if free else number
    sign = 1.0 if free else -1.0
    root = brentq(
        lambda z: np.cos(z) + sign / np.cosh(z),
        first * np.pi + 1e-9,
        (first + 1) * np.pi,
        xtol=1e-14,
    )
    return float(root) ** 2
