"""A scene with its names looked up: tree, parameters, quantities as SX. Nothing here moves yet."""

from collections.abc import Mapping
from dataclasses import dataclass

from mbdlft.base.description import Values
from mbdlft.base.parameter import Parameter
from mbdlft.multibody.assembly.aligned import Aligned, align
from mbdlft.multibody.assembly.steady import steady
from mbdlft.multibody.assembly.symbols import Symbols
from mbdlft.multibody.assembly.tree import Link, tree
from mbdlft.multibody.scene.check import check
from mbdlft.multibody.scene.scene import Scene


@dataclass(frozen=True, slots=True, eq=False)
class Resolved:
    """A checked scene.

    Attributes
    ----------
    scene : Scene
        The user's, or the same in other axes (`aligned`).
    links : from the ground outward
    parameters : sorted by name
    symbols : Symbols
        Coordinates and parameters as SX.
    values : quantities by owner and label, in SI units: numbers, SX of the parameters, turns
    aligned : the rotation back to the axes of the user; None if they are those of the user
    """

    scene: Scene
    links: tuple[Link, ...]
    parameters: tuple[Parameter, ...]
    symbols: Symbols
    values: Mapping[str, Values]
    aligned: Aligned | None = None


def resolve(scene: Scene) -> Resolved:
    """Look up names, units and the tree of a scene, check it, and evaluate its quantities once.

    Raises
    ------
    SceneError, NotRationalError, WellPosednessError
        The joints are not a tree, or one of the quantities cannot be used; see `check`.
    """
    links = tree(scene)
    check(scene)
    parameters = tuple(sorted(scene.parameters, key=lambda parameter: parameter.name))
    symbols = Symbols(scene, parameters, links)
    values = symbols.quantities(scene)
    for owner, momenta in steady(scene, links, symbols, values).momenta.items():
        values[owner] = {**values[owner], **momenta}
    return Resolved(scene, links, parameters, symbols, values)


def in_plane(resolved: Resolved) -> Resolved:
    """The same scene in axes along its plane, where it has one that is not a coordinate plane."""
    r = resolved
    aligned = align(r.scene, r.values, r.symbols.evaluate)
    if aligned is None:
        return r
    links = tree(aligned.scene)
    return Resolved(aligned.scene, links, r.parameters, r.symbols, aligned.values, aligned)
