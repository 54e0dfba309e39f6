"""Models to store, and bit-exact comparison of models and of files."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import h5py
import numpy as np

import mbdlft
from mbdlft.system.model import Provenance, Trim
from tests import kit

ARM = (Path(__file__).parents[2] / "scenarios" / "two_link_arm.toml").read_text(encoding="utf-8")
MATRICES = ("A", "B_w", "B_u", "C_z", "D_zw", "D_zu", "C_y", "D_yw", "D_yu")


@cache
def arm() -> mbdlft.LFTModel:
    """The two-link arm: seven parameters, two of them angles."""
    return mbdlft.to_lft(mbdlft.scene_from_toml(ARM), search=0.0)


@cache
def carried() -> mbdlft.LFTModel:
    """The arm with the straight-line program of its equations."""
    return replace(mbdlft.with_program(arm()), name="carried")


@cache
def turned_arm() -> mbdlft.LFTModel:
    """The arm with a quarter-angle, a reference away from the nominal, and an angle in rad."""
    text = ARM.replace("low = 45.0, high = 90.0, unit", "low = -170.0, high = 200.0, unit")
    text = text.replace('unit = "deg", role', 'unit = "deg", substitution = "quarter-angle", role', 1)
    text = text.replace(
        'nominal = 90.0, low = 45.0, high = 135.0, unit = "deg"',
        'nominal = 1.5, low = 0.8, high = 2.4, reference = 0.3, unit = "rad"',
    )
    return mbdlft.to_lft(mbdlft.scene_from_toml(text.replace("two_link_arm", "turned_arm")), search=0.0)


@cache
def unused() -> mbdlft.LFTModel:
    """The arm with a parameter that no quantity uses, so it has zero repetitions."""
    text = ARM.replace("[parameters]", "[parameters]\nidle = { nominal = 1.0, percent = 5 }")
    return mbdlft.to_lft(mbdlft.scene_from_toml(text), search=0.0)


@cache
def numbers() -> mbdlft.LFTModel:
    """A scene without parameters."""
    rail = mbdlft.Prismatic(name="rail", parent="ground", child="cart", axis=(0, 1, 0), stiffness=0.1)
    cart = mbdlft.PointMass(name="cart", mass=0.7)
    return mbdlft.to_lft(
        mbdlft.Scene(name="numbers", gravity=(0, -9.81, 0), bodies=[cart], joints=[rail]), search=0.0
    )


@cache
def free() -> mbdlft.LFTModel:
    """Two masses, a spring and a motor between them, a push on one; a filter behind an acceleration."""
    scene = kit.scene(
        "free",
        mbdlft.Parameter("m", 2.0, percent=20, unit="kg"),
        *(kit.point("a", "m"), kit.point("b", 1.5)),
        kit.rail("to_a", "ground", "a", (1, 0, 0), position=0.0),
        kit.rail("to_b", "a", "b", (1, 0, 0), position=1.0, stiffness=40.0, damping=0.1),
        kit.force("push", "b", (1, 0, 0), frame="ground", magnitude=0.0),
        inputs=["to_b.force", "push.force"],
        outputs=["to_a.position", "to_a.acceleration", "to_b.position", "to_b.acceleration"],
    )
    lag = mbdlft.as_system(mbdlft.low_pass(0.5), name="lag")
    return mbdlft.series(mbdlft.to_lft(scene, search=0.0), "to_b.acceleration", lag)


def strange(seed: int, sizes: tuple[int, ...] = (2, 0, 3)) -> mbdlft.LFTModel:
    """Random matrices with numbers of every size, and texts of every script; made by hand."""
    random = np.random.default_rng(seed)

    def some(*shape: int) -> np.ndarray:
        return random.standard_normal(shape) * 10.0 ** random.integers(-300, 300, shape)

    n, nx, nu, ny, nt = sum(sizes), *random.integers(1, 4, 4)
    names = [f"p{k}_µ" for k in range(len(sizes))]
    blocks = tuple(mbdlft.Block(*block) for block in zip(names, sizes, strict=True))

    def signals(what: str, count: int) -> tuple[mbdlft.Signal, ...]:
        return tuple(mbdlft.Signal(f"{what} θ₁ {k} \"'\\\n日本", "µm/s^2") for k in range(count))

    return mbdlft.LFTModel(
        name=f"strange model {seed}: λ",
        lft=mbdlft.LFT(some(n, n), some(n, nx + nu), some(nx + ny, n), some(nx + ny, nx + nu), blocks),
        states=signals("x", nx),
        inputs=signals("u", nu),
        outputs=signals("", ny),
        parameters=tuple(
            mbdlft.Parameter(name, 0.1 + 0.2, 0.05 * k, 1.0 / 3.0 + k, unit="kg", role="design")
            for k, name in enumerate(names)
        ),
        trim=Trim(
            signals("effort", nt),
            tuple(float(value) for value in some(nt)),
            mbdlft.LFT(some(n, n), some(n, 1), some(nt, n), some(nt, 1), blocks),
        ),
        certificate=mbdlft.Certificate(
            order=sizes,
            lower_bound=tuple(max(0, size - 1) for size in sizes),
            raw_order=tuple(size + 5 for size in sizes),
            max_relative_error=float(random.random()),
            check_points=123,
            seed=2**40 + 1,
            exact=bool(seed % 2),
            doubtful=tuple(min(1, size) for size in sizes),
            condition=float(1.0 + random.random()),
            sign_changes=seed,
        ),
        provenance=Provenance(
            scene='name = "µ"\n# ' + "日本 " * 30000,
            mbdlft="0.1.0",
            casadi="3.7.0",
            numpy="2.0.0",
            h5py="3.11.0",
            created="2026-01-01T00:00:00+00:00",
        ),
        description="",
    )


def bare() -> mbdlft.LFTModel:
    """The smallest model: no parameters, no inputs, no outputs, no trim."""
    full = strange(0, ())
    return replace(
        full,
        name="bare",
        lft=mbdlft.LFT(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[-0.5]]),
        states=full.states[:1],
        inputs=(),
        outputs=(),
        trim=Trim((), (), None),
    )


def same(a: Any, b: Any) -> None:
    """Equal in every bit of every field, and of all that is in them."""
    assert type(a) is type(b)
    if isinstance(a, float | np.ndarray):
        one, other = np.asarray(a), np.asarray(b)
        assert (one.dtype, one.shape, one.tobytes()) == (other.dtype, other.shape, other.tobytes())
    elif isinstance(a, Mapping):
        assert list(a) == list(b)
        same(list(a.values()), list(b.values()))
    elif isinstance(a, list | tuple):
        for one, other in zip(a, b, strict=True):
            same(one, other)
    elif is_dataclass(a):
        for field in fields(a):
            same(getattr(a, field.name), getattr(b, field.name))
    else:
        assert a == b


def contents(path: Path) -> dict[str, object]:
    """All datasets and attributes of an HDF5 file by path: type, shape and bytes, or texts."""
    found: dict[str, object] = {}

    def visit(name: str, item: object) -> None:
        found[name] = type(item).__name__
        if isinstance(item, h5py.Dataset):
            value = item[()]
            data = list(value.ravel()) if item.dtype == object else value.tobytes()
            found[name] = (item.dtype.str, item.shape, data)
        for key, value in item.attrs.items():
            found[f"{name}@{key}"] = (type(value).__name__, value)

    with h5py.File(path) as file:
        visit("", file)
        file.visititems(visit)
    return found
