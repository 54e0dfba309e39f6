"""The page of the architecture names the rooms that exist; new kinds are one line in one list."""

import re
import subprocess
import sys
import tomllib
from fractions import Fraction
from pathlib import Path
from typing import ClassVar, final

import casadi as ca
import numpy as np
import pytest

from benchmarks.moves import TARGET_FILES, TARGET_MOVES
from mbdlft.base.description import Expected, Quantity, Values
from mbdlft.base.expression import evaluate, parse
from mbdlft.base.unit import Freedom, Signal
from mbdlft.exact.operators import Operators
from mbdlft.multibody import body, force, joint, scene_from_toml, scene_to_toml, sensor
from mbdlft.multibody.body import Body
from mbdlft.multibody.force import BodyWrench, Load
from mbdlft.multibody.joint.kinds import MovingJoint, sliding
from mbdlft.multibody.joint.move import Move, Slide, shifted
from mbdlft.multibody.sensor import Sensor
from mbdlft.multibody.spatial import Coordinate, Space, move_motion, move_wrench
from mbdlft.pipeline import to_lft
from mbdlft.problem.sx.tapes import arithmetic, fold

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
CONTRACTS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
    "contracts"
]
ROOMS = [room.strip() for layer in CONTRACTS[0]["layers"] for room in layer.split("|")]


def test_rooms_are_those_of_the_page_in_the_order_of_the_contract() -> None:
    there = {path.name for path in (ROOT / "mbdlft").iterdir() if (path / "__init__.py").exists()}
    there |= {path.stem for path in (ROOT / "mbdlft").glob("*.py")} - {"__init__", "__main__"}
    section = PAGE.partition("## Rooms")[2].partition("## ")[0]
    assert re.findall(r"^\| `(\w+)` \|", section, re.MULTILINE) == ROOMS
    assert set(ROOMS) == there


def test_main_types_and_functions_are_in_their_rooms() -> None:
    rows = re.findall(r"^\| `(\w+)` \|.*\| ([^|]*) \|$", PAGE.partition("## Rooms")[2], re.MULTILINE)
    assert [room for room, _ in rows] == ROOMS
    for room, names in rows:
        files = [*(ROOT / "mbdlft" / room).rglob("*.py"), ROOT / "mbdlft" / f"{room}.py"]
        text = "\n".join(path.read_text(encoding="utf-8") for path in files if path.is_file())
        for name in re.findall(r"`(?:[\w.]+\.)?(\w+)`", names):
            assert re.search(rf"^(?:(?:def|class) {name}\b|{name} = )", text, re.MULTILINE), name


def test_picture_has_every_room_once_and_few_boxes() -> None:
    picture = PAGE.split("```")[1]
    boxes = re.findall(r"\[([\w ]+)\]", picture)  # rooms of one floor may share a box
    assert sorted(room for box in boxes for room in box.split()) == sorted(ROOMS)
    assert len(boxes) <= 20
    # a room of the upper part stands in the line of its floor
    floors = {
        room: len(CONTRACTS[0]["layers"]) - k
        for k, layer in enumerate(CONTRACTS[0]["layers"])
        for room in map(str.strip, layer.split("|"))
    }
    for line in picture.splitlines():
        for room in " ".join(re.findall(r"\[([\w ]+)\]", line)).split():
            assert int(line.split()[0]) == floors[room], line


def test_files_and_lists_of_the_page_exist() -> None:
    section = PAGE.partition("## How to add")[2]
    files = set(re.findall(r"`(mbdlft/[\w/.]+\.py)`", section)) - set(
        re.findall(r"`(mbdlft/[\w/.]*NAME\.py)`", section)
    )
    assert files
    for file in files:
        assert (ROOT / file).is_file(), file
    for name, file in re.findall(r"`(\w+)` in `(mbdlft/[\w/.]+\.py)`", section):
        assert name in (ROOT / file).read_text(encoding="utf-8"), (name, file)


@pytest.mark.parametrize("page", sorted((ROOT / "docs").glob("*.md")), ids=lambda page: str(page.name))
def test_files_that_a_page_names_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for file in re.findall(r"`((?:mbdlft|tests|benchmarks)/[\w/]+\.py)`", text):
        assert file.endswith("/NAME.py") or (ROOT / file).is_file(), file


class Exact(Operators):
    """A rational number."""

    def __init__(self, value: Fraction) -> None:
        self.value = value

    @staticmethod
    def of(number: "Exact | float") -> "Exact":
        return number if isinstance(number, Exact) else Exact(Fraction(number))

    def __add__(self, other: "Exact | float") -> "Exact":
        return Exact(self.value + Exact.of(other).value)

    def __neg__(self) -> "Exact":
        return Exact(-self.value)

    def __mul__(self, other: "Exact | float") -> "Exact":
        return Exact(self.value * Exact.of(other).value)

    def __truediv__(self, other: "Exact | float") -> "Exact":
        return Exact(self.value / Exact.of(other).value)


def test_a_number_system_needs_no_list() -> None:
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    tape = ca.Function("tape", [x, y], [x * y - 2 / x])
    values = {"x": Exact(Fraction(1, 3)), "y": Exact(Fraction(1, 7))}
    ((folded,),) = fold(tape, arithmetic(Exact.of, {}), [values["x"]], [values["y"]])
    written = evaluate(parse("x*y - 2/x"), values, Exact.of)
    assert folded.value == written.value == Fraction(1, 21) - 6


@final
class Rail(MovingJoint):
    kind: ClassVar[str] = "rail"
    freedoms: ClassVar[tuple[Freedom, ...]] = (sliding(),)
    position: Quantity = 0.0
    stiffness: Quantity = 0.0
    damping: Quantity = 0.0
    actuator_inertia: Quantity = 0.0
    preload: Quantity | None = None

    def own_moves(self, values: Values, at: Coordinate) -> tuple[Move, ...]:
        axis = ca.SX.eye(3)[:, 0]
        slide = Slide(axis, at.part(0), values["actuator_inertia"])
        return (*shifted(axis * values["position"]), slide)


@final
class Weight(Body):
    kind: ClassVar[str] = "weight"
    half: Quantity

    def own_quantities(self) -> dict[str, Expected]:
        return {"half": Expected(self.half, "kg")}

    def wrench(self, motion: ca.SX, values: Values, inboard: ca.SX, at: Coordinate) -> ca.SX:
        acceleration = move_motion(motion, -inboard)[:, 2]
        return move_wrench(ca.horzcat(2.0 * values["half"] * acceleration, ca.SX(3, 1)), -inboard)


@final
class Wind(Load):
    kind: ClassVar[str] = "wind"
    signal: ClassVar[Signal] = Signal("force", "N")
    magnitude_key: ClassVar[str] = "magnitude"
    port: str
    magnitude: Quantity | None = None

    def quantities(self) -> dict[str, Expected]:
        return {} if self.magnitude is None else {"magnitude": Expected(self.magnitude, "N")}

    def ports(self) -> dict[str, str]:
        return {"port": self.port}

    def wrenches(self, values: Values, magnitude: ca.SX, space: Space) -> list[BodyWrench]:
        where, r = space.port(self.port)
        along = space.outward(ca.SX([1.0, 0.0, 0.0]), where) * magnitude
        return [BodyWrench(where, move_wrench(ca.horzcat(along, ca.SX(3, 1)), r))]


@final
class Odometer(Sensor):
    kind: ClassVar[str] = "odometer"
    components: ClassVar[tuple[Signal, ...]] = (Signal("way", "m"),)
    port: str

    def measure(self, view: Space) -> ca.SX:
        owner, small = view.small(self.port, 0)
        return view.across(small.displacement, owner, "ground")[0]


CART = """
format = "mbdlft-scene/1"
name = "cart"
[parameters.half]
nominal = 1.5
low = 1.0
high = 2.0
unit = "kg"
[bodies.cart]
{body}
[joints.track]
{joint}
parent = "ground"
child = "cart"
stiffness = 3.0
[loads.gust]
{load}
port = "cart"
magnitude = 0.0
[sensors.way]
{sensor}
port = "cart"
[linearize]
inputs = ["gust.force"]
outputs = ["{output}"]
"""
NEW = {
    "body": 'kind = "weight"\nhalf = "half"',
    "joint": 'kind = "rail"',
    "load": 'kind = "wind"',
    "sensor": 'kind = "odometer"',
    "output": "way.way",
}
OLD = {
    "body": 'kind = "point_mass"\nmass = "2*half"',
    "joint": 'kind = "prismatic"\naxis = [1.0, 0.0, 0.0]',
    "load": 'kind = "force"\ndirection = [1.0, 0.0, 0.0]\nframe = "ground"',
    "sensor": 'kind = "position"',
    "output": "way.x",
}


def test_new_kinds_are_one_line_in_a_list(monkeypatch: pytest.MonkeyPatch) -> None:
    for room, cls in ((joint, Rail), (body, Weight), (force, Wind), (sensor, Odometer)):
        monkeypatch.setitem(room.KINDS, cls.kind, cls)
    made = scene_from_toml(CART.format(**NEW))
    assert scene_from_toml(scene_to_toml(made)) == made
    new, old = (to_lft(scene, search=0.0) for scene in (made, scene_from_toml(CART.format(**OLD))))
    assert new.lft.blocks == old.lft.blocks
    for name in ("A", "B_w", "B_u", "C_z", "D_zw", "D_zu", "C_y", "D_yw", "D_yu"):
        assert np.array_equal(getattr(new, name), getattr(old, name)), name
    assert new.A[1, 0] == -1.0  # -k/(2 half) = -3/3


def test_how_far_a_parameter_travels() -> None:
    """In a process of its own: what others have looked up is not called again."""
    command = [sys.executable, "-m", "benchmarks.moves", "--pairs", "1"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    rows = re.findall(r"^\| (.+?) \| .*\| (\d+)(?: \(missed\))? \|$", done.stdout, re.MULTILINE)
    counts = {what: int(count) for what, count in rows}
    assert 40 <= counts["files"] <= TARGET_FILES
    assert 900 <= counts["moves between files"] <= TARGET_MOVES
