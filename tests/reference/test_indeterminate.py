"""Statically indeterminate elastic structures: clamped and propped beams, and NAFEMS tests.

FV2, FV4 and FV5 are those of F. Abbassian, D. J. Dawswell, N. C. Knowles, Selected benchmarks for natural
frequency analysis, NAFEMS R0015 (1987); E = 200 GPa, rho = 8000 kg/m^3, nu = 0.3. The frequencies are as
the verification manual of OptiStruct quotes them. Those of FV2 are of arms that do not stretch, pinned or
clamped at the hub, z^2 (E I/(rho A))^(1/2)/(2 pi L^2); modes 10 and 11 also stretch the arms, and have an
exact value of their own here (the manual's own modes are 0.56 % below 57.390 Hz there, too).
Those of a propped beam and its loads are closed forms.
"""

import numpy as np
import pytest
from scipy.optimize import brentq

import mbdlft
from mbdlft.problem.linearization import inverse_of_efforts
from tests import kit
from tests.close import BENCHMARK, CLOSED_FORM, SCENARIO, target
from tests.laws import elastic as scenes
from tests.reference.beams import CLAMPED, PINNED, frequencies

E, RHO = 200e9, 8000.0
SHEAR = E / 2.6


def lowest(scene: mbdlft.Scene, count: int) -> np.ndarray:
    """The lowest frequencies (rad/s)."""
    return frequencies_of(mbdlft.to_lft(scene, search=0.0))[:count]


def frequencies_of(model: mbdlft.LFTModel) -> np.ndarray:
    return np.sort(np.abs(np.linalg.eigvals(model.A).imag))[::2]


def held_beam(kind: str, **fields: object) -> mbdlft.Scene:
    """A beam that is clamped at its origin and held by a loop of some kind at its tip."""
    given = {"deformations": ("axial", "bending_y"), "modulus": 1.0, "modes": 8}
    axis = {"axis": (0, 0, 1)} if kind == "revolute" else {}
    beam = {**given, **fields.pop("beam", {})}
    length = beam.get("length", 1.0)
    scene = kit.scene(
        "held",
        *(scenes.beam(**beam), mbdlft.Ground(ports={"wall": (length, 0, 0)})),
        kit.weld("root", "ground", "beam"),
        kit.loop("hold", kind, "ground.wall", "beam.tip", **axis),
    )
    ends = {"inputs": ["ground.acceleration.y"], "outputs": ["beam.bending_y.1.displacement"]}
    return kit.changed(scene, **{**ends, **fields})


@pytest.mark.parametrize(("kind", "end"), [("fixed", CLAMPED), ("revolute", PINNED)])
@pytest.mark.parametrize("shapes", [{"modes": 8}, {"modes": None, "elements": 10}])
def test_beam_that_is_held_at_both_ends(kind: str, end: tuple[int, int], shapes: dict) -> None:
    """Without a load, and with no word on a preload."""
    exact = frequencies(4, CLAMPED, end, length=1.0, line=1.0, bending=1.0, highest=220.0)
    scene = held_beam(kind, beam={**shapes, "deformations": ("bending_y",)})
    model = mbdlft.to_lft(scene, search=0.0)
    target(frequencies_of(model)[:3] / exact[:3] - 1.0, np.zeros(3), BENCHMARK, 1.0)
    assert not np.any(model.trim.nominal), "no load, no preload"


def parameters() -> tuple[mbdlft.Parameter, ...]:
    return (
        mbdlft.Parameter("L", 1.0, percent=20, unit="m"),
        mbdlft.Parameter("E", 1.0, percent=20, unit="Pa"),
    )


@pytest.mark.parametrize(
    ("kind", "expected"),
    [("fixed", {"force.y": 1 / 2, "torque.3": 1 / 12}), ("revolute", {"force.y": 3 / 8})],
)
def test_loads_by_weight_are_those_of_the_books(kind: str, expected: dict[str, float]) -> None:
    """rho A g L/2 and rho A g L^2/12, or 3/8 rho A g L for a propped beam, for all parameters."""
    free = {"length": "L", "modulus": "E", "modes": 5, "deformations": ("bending_y",)}
    weight = {"gravity": (0, -2.0, 0), "parameters": parameters()}
    model = mbdlft.to_lft(held_beam(kind, beam=free, **weight), search=0.0)
    names = [signal.name for signal in model.trim.signals]
    values = {"L": np.array([0.8, 1.0, 1.2]), "E": np.array([1.2, 1.0, 0.9])}
    efforts = mbdlft.trim_at(model, values)
    for name, share in expected.items():
        power = 2 if name.startswith("torque") else 1
        found = np.abs(efforts[:, names.index(f"hold.{name}")])
        target(found, 2.0 * share * values["L"] ** power, SCENARIO)
    # the largest deflection of the middle is rho A g L^4/384 EI between clamps
    if kind == "fixed":
        stations = {**free, "elements": 2, "stations": {"middle": 1}}
        held = mbdlft.to_lft(held_beam(kind, beam=stations, **weight), search=0.0)
        (_, d, _), *_ = scenes.beam(**{**stations, "length": 1.0, "modulus": 1.0}).blocks()
        names = [signal.name for signal in held.trim.signals]
        first = names.index("beam.bending_y.1.displacement.static")
        own = mbdlft.trim_at(held, {})[first : first + 7]
        middle = mbdlft.multibody.body.beam_elements.values_at(d, "displacement", 1) @ own
        target(middle, -2.0 / 384.0, SCENARIO)


def test_axial_load_of_a_column_between_walls() -> None:
    """Half of the weight rests on either wall; both halves change the stiffness, each its own way."""
    own = {"length": "L", "modulus": "E", "modes": 5}
    scene = held_beam("fixed", beam=own, gravity=(-3.0, 0, 0), parameters=parameters())
    model = mbdlft.to_lft(scene, search=0.0)
    assert model.certificate.exact
    names = [signal.name for signal in model.trim.signals]
    target(mbdlft.trim_at(model, {})[names.index("hold.force.x")], 1.5, SCENARIO)


def test_deflections_of_steel_are_small_beside_its_loads() -> None:
    """Axial deflections are 1e-7 m, and loads 1e3 N: half of the weight rests on either wall."""
    own = {"length": "L", "modulus": "E", "density": 7800.0, "area": 1e-2, "I_z": 2e-6, "modes": 5}
    ranges = tuple(
        mbdlft.Parameter(name, value, percent=20, unit=unit)
        for name, value, unit in (("L", 3.0, "m"), ("E", 210e9, "Pa"))
    )
    scene = held_beam("fixed", beam=own, gravity=(-9.81, 0, 0), parameters=ranges)
    model = mbdlft.to_lft(scene, search=0.0)
    names = [signal.name for signal in model.trim.signals]
    target(mbdlft.trim_at(model, {})[names.index("hold.force.x")], 78.0 * 9.81 * 1.5, SCENARIO)


def test_a_truss_of_bars_on_pins() -> None:
    """Three bars meet in a point and carry a weight: forces by their stiffnesses, closed form."""
    half, gravity = 0.6, 10.0
    bars = {"left": -half, "middle": 0.0, "right": half}
    own = {"deformations": ("axial",), "modes": 2, "density": 1e-9, "area": 1.0, "modulus": 300.0}
    lengths = {name: 1.0 / np.cos(angle) for name, angle in bars.items()}
    hooks = {name: (0.0, float(np.tan(angle)), 0.0) for name, angle in bars.items()}
    joints = [kit.weld("hang", "ground.middle", "middle", orientation=())]
    joints += [kit.weld("load", "middle.tip", "bob")]
    joints += [
        kit.hinge(
            name,
            "bob",
            name,
            (0, 0, 1),
            preload=0.0,
            orientation=(kit.turn((0, 0, 1), float(np.pi - bars[name])),),
        )
        for name in ("left", "right")
    ]
    scene = kit.scene(
        "truss",
        *(mbdlft.Beam(name=name, length=float(lengths[name]), **own) for name in bars),
        kit.body("bob", 2.0, zz=1.0),
        mbdlft.Ground(ports={name: hooks[name] for name in bars}),
        *joints,
        *(
            kit.loop(f"{name}_pin", "revolute", f"ground.{name}", f"{name}.tip", axis=(0, 0, 1))
            for name in ("left", "right")
        ),
        gravity=(gravity, 0, 0),
        inputs=["ground.acceleration.x"],
        outputs=["left.angle"],
    )
    model = mbdlft.to_lft(scene, search=0.0)
    efforts = dict(zip([s.name for s in model.trim.signals], model.trim.nominal, strict=True))
    c = np.cos(half)
    middle = 2.0 * gravity / (1.0 + 2.0 * c**3)
    side = middle * c**2
    found = np.hypot(efforts["left_pin.force.x"], efforts["left_pin.force.y"])
    target(found, side, 1e6 * CLOSED_FORM)  # the bars have a mass of 1e-9 kg


# NAFEMS -------------------------------------------------------------------------------------------


def double_cross() -> mbdlft.Scene:
    """FV2: eight arms of 5 m with the section 0.125 m x 0.125 m, pinned at their ends, in their plane."""
    side, arm = 0.125, 5.0
    angles = [k * np.pi / 4.0 for k in range(8)]
    section = {"area": side**2, "I_z": side**4 / 12.0, "deformations": ("axial", "bending_y")}
    arms = [
        mbdlft.Beam(name=f"arm{k}", length=arm, density=RHO, modulus=E, modes=6, **section)
        for k in range(8)
    ]
    ends = {
        f"end{k}": (arm + arm * float(np.cos(a)), arm * float(np.sin(a)), 0) for k, a in enumerate(angles)
    }
    others = [k for k in range(8) if k != 4]
    turns = {k: (kit.turn((0, 0, 1), float(angles[k])),) for k in others}
    joints = [kit.hinge("pin", "ground", "arm4", (0, 0, 1), preload=0.0)]
    joints += [kit.weld(f"hub{k}", "arm4.tip", f"arm{k}", orientation=turns[k]) for k in others]
    loops = [
        kit.loop(f"pin{k}", "revolute", f"ground.end{k}", f"arm{k}.tip", axis=(0, 0, 1))
        for k in others
    ]  # fmt: skip
    return kit.scene(
        "FV2",
        *arms,
        mbdlft.Ground(ports=ends),
        *joints,
        *loops,
        inputs=["ground.acceleration.x"],
        outputs=["pin.angle"],
    )


def force_of_a_moving_hub(w: float) -> float:
    """Of the eight arms on a hub that moves by 1 m at w rad/s, and does not turn: exact, divided by 4."""
    side, arm = 0.125, 5.0
    area, second = side**2, side**4 / 12.0
    b, k = w * (RHO / E) ** 0.5, (RHO * area * w**2 / (E * second)) ** 0.25
    along = E * area * b / np.tan(b * arm)
    # a cos + b sin + c cosh + d sinh of k x: 1 m without slope at the hub, no moment at the pin
    c, s, ch, sh = np.cos(k * arm), np.sin(k * arm), np.cosh(k * arm), np.sinh(k * arm)
    rows = [[1.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 1.0], [c, s, ch, sh], [-c, -s, ch, sh]]
    _, b_, _, d_ = np.linalg.solve(rows, [1.0, 0.0, 0.0, 0.0])
    return float(along + E * second * k**3 * (d_ - b_))


@pytest.mark.long
def test_nafems_fv2_pin_ended_double_cross() -> None:
    """16 frequencies in groups of equal ones."""
    found = lowest(double_cross(), 16) / (2.0 * np.pi)
    published = np.array([11.336, *[17.709] * 7, 45.345, *[57.390] * 7])
    alone = [k for k in range(16) if k not in (9, 10)]
    target(found[alone] / published[alone] - 1.0, np.zeros(14), BENCHMARK, 1.0)
    stretched = brentq(lambda f: force_of_a_moving_hub(2.0 * np.pi * f), 56.0, 57.3)
    target(found[9:11] / stretched - 1.0, np.zeros(2), BENCHMARK, 1.0)


def test_nafems_fv4_cantilever_with_masses_beside_its_end() -> None:
    """A round bar of 10 m and 0.5 m, 10 t and 1 t at 2 m to both sides of its end; a tree."""
    area, second = np.pi * 0.25**2, np.pi * 0.5**4 / 64.0
    beam = mbdlft.Beam(
        name="beam", length=10.0, density=RHO, area=area, modulus=E, shear_modulus=SHEAR, I_y=second,
        I_z=second, torsion_constant=2.0 * second, modes=8,
    )  # fmt: skip
    cross = kit.body("cross", 1e-9, (0, 0, 0), ports={"a": (0, 2, 0), "b": (0, -2, 0)})
    scene = kit.scene(
        "FV4",
        beam,
        cross,
        kit.point("m1", 1e4),
        kit.point("m2", 1e3),
        kit.weld("root", "ground", "beam"),
        kit.weld("end", "beam.tip", "cross"),
        kit.weld("first", "cross.a", "m1"),
        kit.weld("second", "cross.b", "m2"),
        inputs=["ground.acceleration.x", "ground.acceleration.z"],
        outputs=["beam.axial.1.displacement"],
    )
    published = np.array([1.723, 1.727, 7.413, 9.972, 18.155, 26.957])
    found = lowest(scene, 6) / (2.0 * np.pi)
    target(found / published - 1.0, np.zeros(6), BENCHMARK, 1.0)


@pytest.mark.long
def test_nafems_fv5_deep_simply_supported_beam() -> None:
    """10 m with the section 2 m x 2 m, on a ball joint and a slide; torsion with the polar moment."""
    second = 2.0**4 / 12.0
    beam = mbdlft.Beam(
        name="beam", length=10.0, density=RHO, area=4.0, modulus=E, shear_modulus=SHEAR, I_y=second,
        I_z=second, torsion_constant=2.0 * second, shear_coefficient=0.85, elements=12,
    )  # fmt: skip
    shoe = kit.body("shoe", 1e-6, (0, 0, 0))
    pin = kit.cross("pin", "ground", "beam", axis1=(0, 1, 0), axis2=(0, 0, 1), preload=(0, 0))
    slide = kit.rail("slide", "ground.far", "shoe", (1, 0, 0), preload=0.0)
    scene = kit.scene(
        "FV5",
        beam,
        shoe,
        mbdlft.Ground(ports={"far": (10, 0, 0)}),
        pin,
        slide,
        kit.loop("far", "spherical", "shoe", "beam.tip"),
        inputs=["ground.acceleration.x"],
        outputs=["beam.axial.1.displacement"],
    )
    published = np.array([42.649, 42.649, 77.542, 125.0, 148.31, 148.31, 233.10, 284.55, 284.55])
    found = lowest(scene, 9) / (2.0 * np.pi)
    target(found / published - 1.0, np.zeros(9), BENCHMARK, 1.0)


def test_slopes_of_stiffnesses_beside_those_of_gaps_are_inverted() -> None:
    """In units that differ by 2^70, which doubles alone take for a singular matrix."""
    slopes = np.array([[2.0, 1.0], [1.0, -3.0]])
    rows, columns = np.array([[2.0**40], [2.0**-30]]), np.array([2.0**5, 2.0**-9])
    found = inverse_of_efforts((rows * slopes * columns)[None])[0]
    target(columns[:, None] * found * rows.T, np.linalg.inv(slopes), CLOSED_FORM)
