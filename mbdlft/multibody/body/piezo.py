"""A beam with piezoelectric patches: voltages are inputs, charges are outputs.

    M qddot + D qdot + K q = Phi' F - P' a + K_v v,      charge = K_v' q + C v

For a patch of width w, thickness h and modulus E, with the strain S along x and the field v/h across it,

    stress = E (S - d31 v/h),     displacement field = d31 E S + (eps - d31^2 E) v/h,     S = u' - y v''

So K_v v is d31 E w v on the elongation of the patch between its ends, and -y d31 E w v on the change of
slope between them, where y is the distance of its mid-plane from the axis. The capacitance is
C = (eps - d31^2 E) w length/h. Because the same K_v is in both equations, and C > 0, there is a stored
energy. The forces of a patch are in equilibrium, so K_v acts on no rigid motion.

Source: equations (5.21) to (5.33) and (6.1) to (6.3) of the two-port models in
`tests/reference/flexible.py`, with the signs and lever arms of its errata 11 to 14.
"""

from collections.abc import Mapping
from fractions import Fraction
from typing import Annotated, Any, ClassVar, NamedTuple, Self, final

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from mbdlft.base.description import ANY_UNIT, Description, Expected, Many, Quantity, Text, Values
from mbdlft.base.errors import SceneError, check_known
from mbdlft.base.unit import Signal
from mbdlft.multibody.body.beam import Beam
from mbdlft.multibody.body.beam_elements import ONE, cross_products, products, strain, values_at
from mbdlft.multibody.body.elastic import Elastic, Term, elastic_problem, times, times_transposed
from mbdlft.multibody.body.rigid import newton_euler
from mbdlft.multibody.spatial import Coordinate

SIDES = ("top", "bottom", "both")
_UNITS = {
    "width": "m",
    "thickness": "m",
    "density": "kg m^-3",
    "modulus": "Pa",
    "d31": ANY_UNIT,  # units of scenes are products of kg, m and s; this one also needs the ampere
    "permittivity": ANY_UNIT,
}


@final
class PiezoPatch(Description):
    """A patch between the nodes `start` and `end` of its beam, 0 to `elements`.

    Its quantities are `width`, `thickness` (m), `density` (kg/m^3), `modulus` at constant field (Pa),
    `d31` (m/V; negative if a positive voltage shortens the patch) and `permittivity` at constant stress
    (F/m). A patch lies on the `side` ``top`` (+y) or ``bottom`` (-y) of the beam. With ``both`` there are
    two patches, connected in parallel with opposite polarity; the voltage is that of the upper one.
    """

    noun: ClassVar[str] = "patches"

    start: Annotated[int, Field(ge=0, strict=True)]
    end: Annotated[int, Field(ge=1, strict=True)]
    side: Text = "top"
    width: Quantity
    thickness: Quantity
    density: Quantity
    modulus: Quantity
    d31: Quantity
    permittivity: Quantity

    @model_validator(mode="after")
    def _place_is_known(self) -> Self:
        check_known("side", [self.side], SIDES)
        if self.end <= self.start:
            raise SceneError(
                f"expected a node 'end' after 'start', got start = {self.start} and end = {self.end}."
            )
        return self


class _Section(NamedTuple):
    """Section of one patch: number of layers, area, first and second moments of area about the axis."""

    layers: int
    area: Any
    first: Any
    second_y: Any
    second_z: Any


@final
class PiezoBeam(Beam):
    """A `Beam` with `patches` on its faces at y = thickness/2 and -thickness/2.

    Inputs are the voltages of the patches (V), outputs their charges (C): ``NAME.voltage.1``,
    ``NAME.charge.1`` and so on. With `common_voltage` all patches have one voltage, and the output is
    the sum of their charges. A patch on one side couples bending with elongation, so the beam needs both
    deformations. The mass of a patch is taken on the axis of the beam, and a patch adds no torsional
    stiffness.
    """

    kind: ClassVar[str] = "piezo_beam"

    thickness: Quantity
    patches: Many[PiezoPatch]
    common_voltage: bool = False

    @model_validator(mode="after")
    def _patches_fit(self) -> Self:
        if not self.patches:
            raise SceneError("patches: at least one is needed; without any the beam is a 'beam'.")
        if self.shear_coefficient is not None:
            raise SceneError("shear_coefficient: a beam with patches has no shear.")
        for k, patch in enumerate(self.patches, start=1):
            if patch.end > self.elements:
                raise SceneError(
                    f"patch {k}: expected nodes from 0 to {self.elements}, got end = {patch.end}."
                )
            needed = ("bending_y",) if patch.side == "both" else ("axial", "bending_y")
            missing = [name for name in needed if name not in self.deformations]
            if missing:
                raise SceneError(
                    f"patch {k}, side {patch.side!r}: it needs the deformation {missing[0]!r}, which the "
                    "beam does not have: a patch on one side bends and stretches it, two bend it."
                )
        return self

    def own_quantities(self) -> dict[str, Expected]:
        quantities = super().own_quantities() | {"thickness": Expected(self.thickness, "m")}
        for k, patch in enumerate(self.patches, start=1):
            for key, unit in _UNITS.items():
                quantities[f"patch{k}.{key}"] = Expected(getattr(patch, key), unit)
        return quantities

    @property
    def has_geometric_stiffness(self) -> bool:
        return False

    def inputs(self) -> tuple[Signal, ...]:
        return tuple(Signal(f"voltage.{k}", "V") for k in self._channels())

    def outputs(self) -> tuple[Signal, ...]:
        return tuple(Signal(f"charge.{k}", "C") for k in self._channels())

    def _channels(self) -> range:
        return range(1, 2 if self.common_voltage else len(self.patches) + 1)

    def driven(self, values: Values, inputs: ca.SX) -> ca.SX:
        return times(self._coupling(values), self._voltages(inputs))

    def measure(self, values: Values, inputs: ca.SX, at: Coordinate) -> ca.SX:
        """Charges K_v' q + C v of the patches, or their sum (1,)."""
        charges = times_transposed(self._coupling(values), at.q)
        voltages = self._voltages(inputs)
        for k in range(len(self.patches)):
            charges[k] += self._capacitance(k, values) * voltages[k]
        return ca.sum1(charges) if self.common_voltage else charges

    def _voltages(self, inputs: ca.SX) -> ca.SX:
        """Voltage of each patch (number of patches,)."""
        return ca.repmat(inputs, len(self.patches), 1) if self.common_voltage else inputs

    def _of(self, k: int, values: Values) -> dict[str, Any]:
        """Quantities of patch k, counted from 0."""
        return {key: values[f"patch{k + 1}.{key}"] for key in _UNITS}

    def _section(self, k: int, values: Values) -> _Section:
        p, t = self._of(k, values), values["thickness"]
        w, h = p["width"], p["thickness"]
        layers = 2 if self.patches[k].side == "both" else 1
        side = {"top": 1.0, "bottom": -1.0, "both": 0.0}[self.patches[k].side]
        return _Section(
            layers,
            layers * (w * h),
            side * 0.5 * (w * h) * (t + h),
            layers * (w * h) * (0.25 * t * t + 0.5 * t * h + h * h / 3.0),
            layers * (w * h) * (w * w) / 12.0,
        )

    def _capacitance(self, k: int, values: Values) -> Any:
        """Capacitance C of patch k at constant strain (F)."""
        p, patch = self._of(k, values), self.patches[k]
        clamped = p["permittivity"] - p["d31"] * p["d31"] * p["modulus"]
        area = p["width"] * values["length"] * ((patch.end - patch.start) / self.elements)
        return self._section(k, values).layers * (clamped * area / p["thickness"])

    def _coupling(self, values: Values) -> list[Term]:
        """The terms of K_v (n, number of patches)."""
        terms: list[Term] = []
        n, deformations = self._count, {name: (d, columns) for name, d, columns in self.blocks()}
        for k, patch in enumerate(self.patches):
            p = self._of(k, values)
            piezo = p["d31"] * p["modulus"] * p["width"]
            stretch, turn = np.zeros((n, len(self.patches))), np.zeros((n, len(self.patches)))
            for node, sign in ((patch.end, 1.0), (patch.start, -1.0)):
                if node == 0:
                    continue  # the clamp holds this node
                if patch.side != "both":
                    d, columns = deformations["axial"]
                    stretch[columns, k] += sign * values_at(d, "displacement", node)
                d, columns = deformations["bending_y"]
                turn[columns, k] += sign * values_at(d, "turn", node)
            if patch.side != "both":
                terms.append(Term(piezo, stretch))
            arm = {"top": 0.5, "bottom": -0.5, "both": 1.0}[patch.side]
            lever = values["thickness"] + p["thickness"]
            terms.append(Term(piezo * lever / values["length"], -arm * turn))
        return terms

    def elastic(self, values: Values) -> Elastic:
        base = super().elastic(values)
        mass: list[Term] = []
        stiffness: list[Term] = []
        participation: list[Term] = []
        L = values["length"]
        for k in range(len(self.patches)):
            p, section = self._of(k, values), self._section(k, values)
            line = section.area * p["density"] * L
            span = (self.patches[k].start, self.patches[k].end)
            for name, d, columns in self.blocks():
                if name == "torsion":  # patches add no stiffness there
                    continue
                mass.append(Term(line, self._placed(columns, products(d, "displacement", ONE, *span))))
                participation += self._participation(name, d, columns, line, L, span)
                if name == "axial":
                    factor = section.area * p["modulus"] / L
                else:
                    second = section.second_y if name == "bending_y" else section.second_z
                    factor = second * p["modulus"] / (L * L * L)
                strained = self._placed(columns, products(d, strain(d), ONE, *span))
                stiffness.append(Term(factor, strained))
            if self.patches[k].side != "both":
                factor = section.first * p["modulus"] / (L * L)
                stiffness.append(Term(factor, self._stretch_and_bend(k)))
        damping = [*base.damping, *self._damping(mass, stiffness, values)]
        stiffness, participation = [*base.stiffness, *stiffness], [*base.participation, *participation]
        return Elastic([*base.mass, *mass], damping, stiffness, participation)

    def _breaks(self) -> tuple[int, ...]:
        ends = {node for patch in self.patches for node in (patch.start, patch.end)}
        return tuple(sorted({*super()._breaks(), *(ends - {0, self.elements})}))

    def _stretch_and_bend(self, k: int) -> NDArray[np.float64]:
        """A symmetric matrix (n, n): minus the integrals of N_axial' N_bending'' over patch k.

        They couple the axial coordinates with those of bending along y, and the other way round.
        """
        deformations = {name: (d, columns) for name, d, columns in self.blocks()}
        coupling = np.zeros((self._count, self._count))
        (axial, rows), (bending, columns) = deformations["axial"], deformations["bending_y"]
        span = (self.patches[k].start, self.patches[k].end)
        integrals = cross_products(axial, "slope", bending, "bend", ONE, *span)
        coupling[rows, columns] = -integrals
        return coupling + coupling.T

    def total_mass(self, values: Values) -> ca.SX:
        beam = values["density"] * values["area"] * values["length"]
        return ca.SX(beam + sum(mass for mass, _, _ in self._lumps(values)))

    def _lumps(self, values: Values) -> list[tuple[Any, float, float]]:
        """For each patch its mass (kg), and the means of s and s^2 over it, s = x/length."""
        lumps = []
        for k in range(len(self.patches)):
            # fractions: rounded once, constants are recognized (`sx.constants`)
            a, b = (
                Fraction(node, self.elements) for node in (self.patches[k].start, self.patches[k].end)
            )
            line = self._of(k, values)["density"] * self._section(k, values).area * values["length"]
            first, second = (a + b) / 2, (a * a + a * b + b * b) / 3
            lumps.append((line * float(b - a), float(first), float(second)))
        return lumps

    def rigid_wrench(self, motion: ca.SX, values: Values) -> ca.SX:
        total, L = super().rigid_wrench(motion, values), values["length"]
        for mass, first, second in self._lumps(values):
            across = mass * (second * (L * L))
            inertia = ca.diag(ca.vertcat(ca.SX(0), across, across))
            center = ca.vertcat(ca.SX(first * L), ca.SX(2, 1))
            total = total + newton_euler(motion, mass, ca.SX(3, 1), center, inertia)
        return total

    def physical_problem(self, values: Mapping[str, NDArray[np.float64]]) -> str | None:
        plain = Beam(**{key: getattr(self, key) for key in Beam.model_fields})
        problem = plain.physical_problem({key: values[key] for key in plain.quantities()})
        if problem:
            return problem
        for key in ["thickness", *(key for key in values if key.startswith("patch"))]:
            lowest = float(np.min(values[key]))
            if not lowest > 0.0 and not key.endswith("d31"):
                return f"{key} is not positive in the range: {lowest:g}."
        for k in range(len(self.patches)):
            p = self._of(k, values)
            lowest = float(np.min(p["permittivity"] - p["d31"] ** 2 * p["modulus"]))
            if not lowest > 0.0:
                return (
                    f"patch{k + 1}: permittivity - d31^2 modulus, that at constant strain, is not "
                    f"positive in the range: {lowest:.3g} F/m. A patch would give energy without end."
                )
        return elastic_problem(self, values)
