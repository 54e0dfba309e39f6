"""Indeterminate structures of steel under weight, thrust and spin, against finite elements of their own.

Chains, rings and stars of beams at right angles, clamped or held by points, and trusses and rings of
equilateral triangles, welded or with pins: up to fifteen redundant loads. Some of them are searched.
`tests/reference/frames.py` has the elements; loads that are linear along a beam are those of their
consistent masses, and one element for each beam is exact at its ends, for any mesh: Przemieniecki, Theory
of matrix structural analysis, 1968, chapters 5 and 6.
"""

import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import mbdlft
from mbdlft import Beam, Fixed, Ground, Loop, Parameter, Revolute, Rotation, Scene
from mbdlft.base.array import Array
from tests import kit
from tests.reference.frames import Section, element

MOST = 1e-7  # of the largest load of its kind
STEEL = {"E": 210e9, "rho": 7800.0, "A": 1e-2, "I": 2e-6}
UNITS = {"h": "m", "E": "Pa", "rho": "kg/m^3", "A": "m^2", "I": "m^4"}
AXES = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0))
MOST_OF_BOUND = (1.0, 1.15, 1.4, 1.4)  # times the proved bound of the order, by the number of parameters
OBLIQUE = 1.6  # the same of bars oblique to a spin, as 1.2 to 1.5 times the order without load
LEVER = 1e-3  # of h, by which the largest force is a torque that is told from none
SECONDS = 15.0  # of the processor: one of 45 takes 10 beside three other programs, all others less than 8
_DIGITS = 3  # of lengths: ends of beams then meet exactly


class Bar(NamedTuple):
    """A beam of the length `share` (m), or h, at the end of another one."""

    parent: int  # -1 is the ground
    axis: int  # of the turn from the parent
    angle: int  # deg
    share: float  # 0 for h
    held: str  # kind of the loop at its end; "" for none
    meets: int = -1  # the bar at whose end that is; -1 is the ground
    joint: str = "fixed"  # or "revolute", about the axis, which nothing holds


class Structure(NamedTuple):
    """Bars, loads, values at nominal, and the names of the parameters."""

    bars: tuple[Bar, ...]
    elements: int
    gravity: tuple[float, ...]  # (m/s^2)
    thrust: tuple[float, ...]
    spin: float  # rad/s about z
    values: dict[str, float]
    names: tuple[str, ...]


def structure(seed: int) -> Structure:
    """A chain, a star or a ring, and what it is made of and what acts on it."""
    random = np.random.default_rng(seed)
    shares = [round(float(random.uniform(0.5, 2.0)), _DIGITS) * (random.random() < 0.5) for _ in range(3)]
    held = "fixed" if random.random() < 0.5 else "spherical"
    angles = [int(random.choice([-90, 90])) for _ in range(3)]
    first = Bar(-1, 0, int(random.choice([0, 90])), 0.0, "")
    match seed % 3:
        case 0:
            axes = [int(axis) for axis in random.integers(2, size=2)]
            middle = [Bar(0, axes[0], angles[0], shares[0], "")][: seed // 3 % 2]
            bars = [first, *middle, Bar(len(middle), axes[1], angles[1], shares[1], held)]
        case 1:
            ends = [
                Bar(0, k, angle, share, held)
                for k, (angle, share) in enumerate(zip(angles, shares, strict=True))
            ]
            bars = [first, *ends[:2]]
        case _:
            axis = int(random.integers(2))
            bars = [first, *(Bar(k, axis, 90, 0.0, held if k == 2 else "") for k in range(3))]
    values = {k: v * float(random.uniform(0.5, 2.0)) for k, v in STEEL.items()}
    names = ["h", "E", *map(str, random.permutation(["rho", "A", "I"]))][: 1 + seed // 2 % 4]
    some = [tuple(random.uniform(-9.81, 9.81, 3).tolist()) for _ in range(2)]
    load = int(random.integers(4))
    return Structure(
        bars=tuple(bars),
        elements=1 + (seed % 6 == 0),
        gravity=some[0] if load in (0, 2) else (0.0, 0.0, 0.0),
        thrust=some[1] if load in (1, 2) else (0.0, 0.0, 0.0),
        spin=float(random.uniform(0.5, 3.0)) if load == 3 else 0.0,
        values={"h": round(float(random.uniform(1.0, 3.0)), _DIGITS), **values},
        names=tuple(sorted(names)),
    )


def truss(seed: int) -> Structure:
    """A triangle or two of equal bars, or a ring of three, welded or with pins."""
    s, random = structure(seed), np.random.default_rng(seed)
    axis, inner, outer = int(random.integers(2)), *random.choice(["fixed", "spherical"], 2).tolist()
    joint, inner = ("revolute", "revolute") if random.random() < 0.3 else ("fixed", inner)
    two = seed // 4 % 3 == 1
    if seed // 4 % 3 == 2:
        first = Bar(-1, axis, int(random.choice([0, 60])), 0.0, "")
        bars = [first, *(Bar(k, axis, 120, 0.0, outer * k) for k in range(2))]
    else:
        bars = [
            Bar(-1, axis, 60, 0.0, ""),
            Bar(0, axis, -120, 0.0, inner, 2, joint),
            Bar(-1, axis, 0, 0.0, outer if random.random() < 0.5 else ""),
        ]
        bars += [Bar(2, axis, 60, 0.0, inner, 4, joint), Bar(0, axis, -60, 0.0, "")][: 2 * two]
    names = s.names[: 2 if two else None]
    return s._replace(bars=tuple(bars), names=names, elements=1 + (seed % 8 == 3 and not two))


def frames_of(s: Structure) -> list[Array]:
    """R of each bar to the ground."""
    frames: list[Array] = []
    for bar in s.bars:
        c, n = (round(float(f(np.deg2rad(bar.angle))), 15) for f in (np.cos, np.sin))
        R = np.array([[[c, -n, 0], [n, c, 0], [0, 0, 1]], [[c, 0, n], [0, 1, 0], [-n, 0, c]]][bar.axis])
        frames.append((frames[bar.parent] if bar.parent >= 0 else np.eye(3)) @ R)
    return frames


def ends_of(s: Structure) -> list[tuple[Array, Array]]:
    """Where each bar ends: numbers of h, and lengths (m)."""
    ends: list[tuple[Array, Array]] = []
    for bar, R in zip(s.bars, frames_of(s), strict=True):
        times, share = ends[bar.parent] if bar.parent >= 0 else (np.zeros(3), np.zeros(3))
        ends.append((times + R[:, 0] * (not bar.share), share + R[:, 0] * bar.share))
    return ends


def scene_of(s: Structure) -> Scene:
    """The scene of a structure."""
    own = {
        "density": "rho", "area": "A", "modulus": "E", "shear_modulus": "E*(1/2.6)", "I_y": "I",
        "I_z": "I", "elements": s.elements, "prestress": "axial",
    }  # fmt: skip
    if s.spin:  # twists of beams that spin are refused
        own["deformations"] = ("axial", "bending_y", "bending_z")
    else:
        own["torsion_constant"] = "1.8*I"
    turns: list[tuple[Rotation, ...]] = []
    joints, loops, ports = list[Fixed | Revolute](), list[Loop](), dict[str, tuple[str, ...]]()
    for k, bar in enumerate(s.bars):
        turn = (kit.turn(AXES[bar.axis], f"{bar.angle}*deg"),) if bar.angle else ()
        turns.append((*(turns[bar.parent] if bar.parent >= 0 else ()), *turn))
        parent = f"b{bar.parent}.tip" if bar.parent >= 0 else "ground"
        pin = {"axis": AXES[bar.axis], "preload": 0.0} if bar.joint == "revolute" else {}
        make = kit.hinge if pin else kit.weld
        joints.append(make(f"f{k}", parent, f"b{k}", orientation=turn, **pin))
    for k, (bar, (times, share)) in enumerate(zip(s.bars, ends_of(s), strict=True)):
        if not bar.held:
            continue
        other, fields = f"b{bar.meets}.tip", dict[str, Any]()
        if bar.meets < 0:
            other = f"ground.w{k}"
            ports[f"w{k}"] = tuple(
                f"{round(n, _DIGITS)!r}*h + {round(x, _DIGITS)!r} [m]"
                for n, x in zip(times.tolist(), share.tolist(), strict=True)
            )
        if bar.held != "spherical":
            back = turns[bar.meets][::-1] if bar.meets >= 0 else ()
            turned = (*(kit.turn(r.axis, f"-({r.angle})") for r in back), *turns[k])
            fields = {"orientation": turned} if turned else {}
        if bar.held == "revolute":
            fields["axis"] = AXES[bar.axis]
        loops.append(kit.loop(f"l{k}", bar.held, other, f"b{k}.tip", **fields))
    return kit.scene(
        "structure",
        *(Parameter(n, s.values[n], percent=20, unit=UNITS[n]) for n in s.names),
        Ground(ports=ports),
        *(Beam(name=f"b{k}", length=bar.share or "h", **own) for k, bar in enumerate(s.bars)),
        *joints,
        *loops,
        gravity=s.gravity,
        acceleration=s.thrust,
        spin=mbdlft.Spin(rate=s.spin, axis=AXES[0]) if s.spin else None,
        constants={n: value for n, value in s.values.items() if n not in s.names},
        inputs=["ground.acceleration.x"],
        outputs=["b0.axial.1.displacement"],
    )


def exact_trim(s: Structure, values: dict[str, float]) -> dict[str, float]:
    """Sizes of the loads at the loops, by an element for each bar and multipliers where bars meet."""
    E, rho, A, second, h = (values[key] for key in ("E", "rho", "A", "I", "h"))
    section = Section(rho, A, E, E / 2.6, second, second, 0.0 if s.spin else 1.8 * second)
    count, frames = len(s.bars), frames_of(s)
    K, f = np.zeros((12 * count, 12 * count)), np.zeros(12 * count)
    ends = [times * h + share for times, share in ends_of(s)]
    meetings = list[Array]()
    for k, (bar, R) in enumerate(zip(s.bars, frames, strict=True)):
        length, start = bar.share or h, ends[bar.parent] if bar.parent >= 0 else np.zeros(3)
        turn, rows = np.kron(np.eye(4), R.T), slice(12 * k, 12 * k + 12)
        mass, stiffness = element(section, length)
        fields = [
            R.T @ (np.array(s.gravity) - s.thrust + s.spin**2 * place * (1, 1, 0))
            for place in (start, ends[k])
        ]
        slope = (fields[1] - fields[0]) / length
        along = np.array([0.0, -slope[2], slope[1]])
        K[rows, rows] = turn.T @ stiffness @ turn
        f[rows] = turn.T @ mass @ np.concatenate([fields[0], along, fields[1], along])
        # the inertia about the own axis, without torsion, is that of a rotor at the origin of a beam
        rotor = 2.0 * second * rho * length * s.spin**2
        f[12 * k + 3 : 12 * k + 6] += rotor * R[2, 0] * np.cross(R[:, 0], (0.0, 0.0, 1.0))
        meetings.append(_meeting(count, bar.parent, 12 * k, bar.joint, R[:, 2 - bar.axis]))
        if s.spin:
            meetings.append(np.zeros((1, 12 * count)))
            meetings[-1][0, rows] = turn[9] - turn[3]
    places, height = dict[int, int](), sum(map(len, meetings))
    for k, bar in enumerate(s.bars):
        if bar.held:
            places[k] = height
            normal = frames[k][:, 2 - bar.axis]
            meetings.append(_meeting(count, bar.meets, 12 * k + 6, bar.held, normal))
            height += len(meetings[-1])
    C, size = np.vstack(meetings), np.abs(K).max()
    system = np.block([[K / size, C.T], [C, np.zeros((height, height))]])
    # bars without twist can say the same twice, of what nothing loads
    loads = np.linalg.lstsq(system, np.append(f, np.zeros(height)))[0][12 * count :]
    found = dict[str, float]()
    for k, place in places.items():
        found[f"l{k}.force"] = float(np.linalg.norm(loads[place : place + 3]))
        if s.bars[k].held != "spherical":
            of_torque = loads[place + 3 : place + 6 - (s.bars[k].held == "revolute")]
            found[f"l{k}.torque"] = float(np.linalg.norm(of_torque))
    return found


def _meeting(count: int, parent: int, place: int, kind: str, normal: Array) -> Array:
    """Rows that are zero where six displacements are those of the end of a bar, or of the ground."""
    same = np.eye(6)
    if kind == "revolute":
        same = np.vstack([same[:3], np.hstack([np.zeros((2, 3)), np.linalg.svd(normal[None])[2][1:]])])
    same = same[: 3 if kind == "spherical" else None]
    rows = np.zeros((len(same), 12 * count))
    rows[:, place : place + 6] = same
    if parent >= 0:
        rows[:, 12 * parent + 6 : 12 * parent + 12] = -same
    return rows


def attack(seed: int, folder: Path) -> str:
    """One structure at two places of its range."""
    s, random = (truss if seed % 4 == 3 else structure)(seed), np.random.default_rng(seed)
    begun, how = time.process_time(), {} if seed % 5 == 1 else {"search": 0.0}
    model = mbdlft.to_lft(scene_of(s), prove=0.0, **how)
    spent = time.process_time() - begun
    names = [signal.name for signal in model.trim.signals]
    for _ in range(2):
        values = {**s.values, **{name: s.values[name] * random.uniform(0.8, 1.2) for name in s.names}}
        at = np.ravel(mbdlft.trim_at(model, {name: values[name] for name in s.names}))
        expected = exact_trim(s, values)
        for name, load in expected.items():
            parts = [x for signal, x in zip(names, at, strict=True) if signal.startswith(f"{name}.")]
            scale = max(x for other, x in expected.items() if other.endswith(name[2:]))
            if name.endswith("torque"):  # some pins feel none
                force = max(x for other, x in expected.items() if other.endswith("force"))
                scale = max(scale, LEVER * values["h"] * force)
            assert abs(np.linalg.norm(parts) - load) <= MOST * scale, (s, name, parts, expected)
    bound = sum(model.certificate.lower_bound)
    most = OBLIQUE if s.spin and seed % 4 == 3 else MOST_OF_BOUND[len(s.names) - 1]
    assert model.order <= most * bound, (s, model.order, bound)
    assert spent <= SECONDS or not how, spent
    return "right"
