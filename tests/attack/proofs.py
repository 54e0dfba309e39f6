"""Proofs that are given to other claims: of other systems, ranges, numbers and bounds; none is believed.

Proofs and systems are exchanged between analyses of all kinds; ranges of parameters, and numbers of the
system, are changed under a proof; items of the archive are changed or left out, with a digest that fits;
and of each proof the best bound is looked for, up to the last bit, that `verify` takes it for.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import mbdlft
from mbdlft import Bounds, MbdlftError, Parameters, System
from mbdlft.archive import analysis as stored
from mbdlft.archive import archive, layout
from mbdlft.archive.hdf5 import write_items
from mbdlft.robust.moving.varying import delta_rates
from tests.claims import KINDS, analysis, at_samples, factor_of, is_true

DRAWS, STEPS, FILES = 40, 60, 3
MOST = 1.2  # times the rates of a proof, for which it may be one, too
Forged = tuple[str, System, Bounds]


def attack(seed: int, folder: Path) -> str:
    """Forge the analysis of one kind some eighty times."""
    kind, random = KINDS[seed % len(KINDS)], np.random.default_rng(seed)
    system, bounds = analysis(kind)
    accepted = 0
    for what, other, claimed in (*_given(kind, random), *_stored(system, bounds, folder, random)):
        if _is_accepted(other, claimed):
            accepted += 1
            assert _is_true(system, other, claimed, bounds), f"{kind}, {what}: {claimed.claim}"
    best = _stretched(system, bounds)
    assert is_true(system, best, bounds), f"{kind}: {best.claim.bound!r} is accepted, {bounds}"
    return "some accepted, all true" if accepted else "all refused"


def _is_accepted(system: System, bounds: Bounds) -> bool:
    try:
        return mbdlft.verify(system, bounds) == ""
    except MbdlftError:
        return False


def _given(kind: str, random: np.random.Generator) -> Iterator[Forged]:
    """Proofs, or whole analyses, of another system, or of this one with another range or number."""
    system, bounds = analysis(kind)
    names = random.choice([k for k in KINDS if k != kind], 2)
    for _ in range(DRAWS):
        name = str(random.choice(names))
        other_system, other = analysis(name)
        match int(random.integers(4)):
            case 0:
                yield f"the proof of {name}", system, replace(bounds, proof=other.proof)
            case 1:
                yield f"the system of {name}", other_system, bounds
            case 2:
                own = list(system.parameters)
                k, share = int(random.integers(len(own))), float(random.choice([0.25, 0.9, 1.1, 1.5]))
                p = own[k]
                reach = {"low": p.nominal - share * (p.nominal - p.low)}
                reach |= {"high": p.nominal + share * (p.high - p.nominal)}
                own[k] = replace(p, **reach)
                ranged = replace(_plain(system), parameters=Parameters(tuple(own)))
                yield "another range", ranged, _claiming(bounds, bounds.claim.bound)
            case _:
                part = str(random.choice(["M11", "M12", "M21", "M22"]))
                matrix = getattr(system.lft, part).copy()
                places, factor = np.flatnonzero(matrix), factor_of(random)
                if len(places) and abs(factor) < 1e300:
                    matrix.flat[random.choice(places)] *= factor
                    lft = replace(system.lft, **{part: matrix})
                    yield f"another number in {part}", replace(_plain(system), lft=lft), bounds


def _plain(system: System) -> System:
    """Without evidence, which is that of other numbers."""
    a = system
    return System(a.name, a.lft, a.states, a.inputs, a.outputs, a.parameters)


def _stored(
    system: System, bounds: Bounds, folder: Path, random: np.random.Generator
) -> Iterator[Forged]:
    """What is read of an archive, of which an item has been changed or left out, digest and seal too."""
    file = folder / "forged.h5"
    mbdlft.save_analysis(file, system, bounds, "forged")
    values = {"@model": system.name, "@model_digest": "", **stored._values(bounds)}
    digest = layout.word(stored.items_of_model(system), layout.DIGEST)
    whole = layout.encode(layout.ANALYSIS_TYPE, {**values, "@model_digest": digest})
    for _ in range(FILES):
        path = str(random.choice([key for key in whole if "model" not in key]))
        items = dict(whole)
        item: Any = items.pop(path)
        if item.dtype.kind in "fi" and item.size and random.random() < 0.8:
            item = item.copy()
            with np.errstate(all="ignore"):
                changed = item.flat[random.integers(item.size)] * factor_of(random)
            is_whole = item.dtype.kind == "i"
            place = int(random.integers(item.size))
            item.flat[place] = int(random.integers(-2, 9)) if is_whole else changed
            items[path] = item
        archive.rewrite(file, partial(_filled, layout.with_digest(items)), "analyses/forged")
        try:
            yield path, *mbdlft.load_analysis(file, "forged")
        except MbdlftError:
            continue


def _filled(items: layout.Items, file: Any) -> None:
    write_items(file.require_group("analyses").create_group("forged"), items)


def _is_true(system: System, other: System, claimed: Bounds, fresh: Bounds) -> bool:
    """Whether an accepted claim on a system, this one or a forged one, is true."""
    pairs = zip(_matrices(system.lft), _matrices(other.lft), strict=True)
    if not all(np.array_equal(*pair) for pair in pairs):
        return at_samples(other, claimed)
    if claimed.rates:  # in deltas they may hardly be faster than those that were looked at
        names = list(system.parameters.names)
        ends = [
            delta_rates(s, names, b.rates, b.claim.size) for s, b in ((other, claimed), (system, fresh))
        ]
        if np.any(ends[0] > ends[1] * MOST):
            return False
    return is_true(other, claimed, fresh)


def _matrices(lft: Any) -> tuple[Any, ...]:
    return lft.M11, lft.M12, lft.M21, lft.M22


def _stretched(system: System, bounds: Bounds) -> Bounds:
    """The analysis with the best bound that is accepted with its proof, to the last bit."""
    sign = 0.1 if bounds.is_from_above else -0.1
    good, bad = bounds.claim.bound, bounds.reached - sign * abs(bounds.reached)
    for _ in range(STEPS):
        middle = 0.5 * (good + bad)
        if middle in (good, bad):
            break
        good, bad = (middle, bad) if _is_accepted(system, _claiming(bounds, middle)) else (good, middle)
    return _claiming(bounds, good)


def _claiming(bounds: Bounds, bound: float) -> Bounds:
    """The analysis with another bound, which nothing is said to reach, where that may be."""
    if bounds.kind == "largest real part":
        return replace(bounds, upper=bound)
    ends = {"lower": 0.0, "upper": bound} if bounds.is_from_above else {"lower": bound, "upper": np.inf}
    nothing: dict[str, Any] = {"delta": {}, "worst": {}, "motion": None}
    return replace(bounds, **nothing, **ends)
