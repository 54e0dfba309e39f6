"""Certificates of which one entry of what is free is changed: refused, or nothing gets wrong."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import mbdlft
from mbdlft import LFTModel, StructureError
from mbdlft.system.evidence import NOTHING_FREE
from tests.archive import models
from tests.attack.accelerations import bodies_apart, scene_of

OMEGA, TIMES = 10.0 ** np.arange(-1.0, 3.0), np.array([0.0, 0.1, 1.0])  # rad/s; s
RIGHT, WRONG = 1e-7, 1e-3  # of an entry: it has its digits; it is no rounding
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


def responses(model: LFTModel, seed: int) -> list[np.ndarray]:
    """Over frequency and time, at three values of the parameters."""
    values = mbdlft.random(model.parameters, 3, seed)
    over_time = mbdlft.step_response(model, values, TIMES).values
    return [mbdlft.frequency_response(model, values, OMEGA), over_time]


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
    every, refused = [*forgeries(model)], 0
    for k in random.permutation(len(every))[:MOST]:
        what, fields = every[k]
        try:
            found = responses(forged(model, fields), seed)
        except StructureError:
            refused += 1
            continue
        for f, t, p in zip(found, truth, plain, strict=True):
            has_digits = np.abs(p - t) <= RIGHT * np.abs(t)
            wrong = has_digits & ~(np.abs(f - t) <= WRONG * np.abs(t))
            assert not wrong.any(), (what, *np.argwhere(wrong)[0])
    return "some refused" if refused else "none refused"
