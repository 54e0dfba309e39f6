"""Certificates of which one entry of what is free is changed: refused, or nothing gets wrong."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import mbdlft
from mbdlft import LFTModel, StructureError
from mbdlft.exact.rounding import EPS
from mbdlft.system.evidence import NOTHING_FREE
from tests.archive import models
from tests.attack.accelerations import bodies_apart, scene_of

OMEGA, TIMES = 10.0 ** np.arange(-1.0, 3.0), np.array([0.0, 0.1, 1.0])  # rad/s; s
RIGHT, WRONG = 1e-7, 1e-3  # of an entry: it has its digits; it is no rounding
ZERO = 1e-6  # of its row and column: what is left of an entry that is zero
MOST = 40  # forgeries of a model


def forgeries(model: LFTModel) -> Iterator[tuple[str, dict[str, Any]]]:
    """Fields with one entry more, or less where that is not less that is known; or one motion more."""
    c, nx, nu, ny = model.certificate, len(model.states), len(model.inputs), len(model.outputs)
    fields = {"accelerations": range(ny), "driven": range(nx), "beside": range(nx)}
    for name, some in {**fields, "unmoved": [(i, j) for i in range(ny) for j in range(nu)]}.items():
        known = {*getattr(c, name)}
        for k in some:
            if k not in known or name in ("driven", "beside"):
                yield (
                    f"{name}: {'without' if k in known else 'with'} {k}",
                    {name: tuple(sorted(known ^ {k}))},
                )
    count = max(map(abs, c.momenta + c.rigid_motions), default=0) or 1
    known = {"momenta": c.momenta or (0,) * nu, "rigid_motions": c.rigid_motions or (-count,) * ny}
    for name, numbers in known.items():
        for k in range(len(numbers)):
            if numbers[k] <= 0:
                yield f"{name}: with {k}", {name: (*numbers[:k], count, *numbers[k + 1 :])}
    more = {name: tuple(k + int(np.sign(k)) for k in numbers) for name, numbers in known.items()}
    yield "one motion more", more


def forged(model: LFTModel, fields: dict[str, Any]) -> LFTModel:
    """The model with other fields in its certificate."""
    return replace(model, certificate=replace(model.certificate, **fields))


def rounded(model: LFTModel, random: np.random.Generator) -> LFTModel:
    """The model with the last bit of each number of its LFT changed."""
    a = model.lft
    M11, M12, M21, M22 = (
        M * (1.0 + EPS * random.choice([-1.0, 1.0], M.shape)) for M in (a.M11, a.M12, a.M21, a.M22)
    )
    return replace(model, lft=replace(a, M11=M11, M12=M12, M21=M21, M22=M22))


def responses(model: LFTModel, seed: int) -> list[np.ndarray]:
    """Over frequency and time, at three values of the parameters."""
    values = mbdlft.random(model.parameters, 3, seed)
    over_time = mbdlft.step_response(model, values, TIMES).values
    return [mbdlft.frequency_response(model, values, OMEGA), over_time]


def size_of(sizes: np.ndarray) -> np.ndarray:
    """Of each entry that of its row times that of its column, over the largest."""
    rows, columns = (np.max(sizes, axis=axis, keepdims=True) for axis in (-1, -2))
    return rows * columns / np.maximum(np.max(rows, axis=-2, keepdims=True), 1e-300)


def model_of(random: np.random.Generator, seed: int) -> LFTModel:
    """A structure that is held, free, of bodies apart, or one beside a filter, and some in a loop."""
    if seed % 4 == 3:
        return models.free()
    scene = bodies_apart(random) if seed % 4 == 2 else scene_of(random, is_free=seed % 4 == 1)
    model = mbdlft.to_lft(scene, search=0.0, prove=0.0)
    if random.random() < 0.5:
        return model
    lag = mbdlft.as_system(mbdlft.low_pass(0.5), name="lag")
    (first, *others), names = ([s.name for s in some] for some in (model.inputs, model.outputs))
    wires = {first: ["M", "-lag.output"], "lag.command": str(random.choice(names))}
    whole = mbdlft.connect([model, lag], wires, inputs=["M", *others], outputs=[*names, "lag.output"])
    assert isinstance(whole, LFTModel)
    return whole


def attack(seed: int, folder: Path) -> str:
    """Forge one model; what is accepted has the digits that it has when nothing is known of it."""
    random = np.random.default_rng(seed)
    model = model_of(random, seed)
    truth, plain = (responses(m, seed) for m in (model, forged(model, NOTHING_FREE)))
    noisy = [responses(rounded(model, random), seed) for _ in range(2)]
    every, refused = [*forgeries(model)], 0
    for k in random.permutation(len(every))[:MOST]:
        what, fields = every[k]
        try:
            found = responses(forged(model, fields), seed)
        except StructureError:
            refused += 1
            continue
        for f, t, p, *others in zip(found, truth, plain, *noisy, strict=True):
            has_digits = np.abs(p - t) <= RIGHT * np.abs(t)
            for other in others:  # those that rounding of the numbers of the LFT makes have none
                has_digits &= np.abs(other - t) <= WRONG * np.abs(t)
            allowed = np.where(t == 0.0, ZERO * size_of(np.abs(t)), WRONG * np.abs(t))
            wrong = has_digits & ~(np.abs(f - t) <= allowed)
            assert not wrong.any(), (what, *np.argwhere(wrong)[0])
    return "some refused" if refused else "none refused"
