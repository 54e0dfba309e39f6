"""Analyses in an archive: they come back as they were, and belong to their model."""

from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdlft
from mbdlft.robust.evidence import BoxProof, IntervalProof, MotionProof
from tests.archive.plain_digest import edit, without
from tests.close import exact
from tests.laws.random_loops import blocks_system, mixed_system
from tests.laws.test_margins import random_loop_with_channels


@cache
def margin() -> mbdlft.Bounds:
    return mbdlft.robust_stability(random_loop_with_channels(), gap=0.1)


@cache
def mixed_margin() -> mbdlft.Bounds:
    return mbdlft.robust_stability(mixed_system(0), gap=0.1)


def same(a: mbdlft.Bounds, b: mbdlft.Bounds) -> None:
    for field in fields(mbdlft.Bounds):
        if field.name in ("proof", "delta"):
            continue
        one, other = getattr(a, field.name), getattr(b, field.name)
        assert one == other or (one != one and other != other), field.name
    assert list(a.delta) == list(b.delta)
    for name, value in a.delta.items():
        exact(value, b.delta[name])
    assert type(a.proof) is type(b.proof)
    if isinstance(a.proof, BoxProof) and isinstance(b.proof, BoxProof):
        for field in fields(BoxProof):
            assert getattr(a.proof, field.name) == getattr(b.proof, field.name)
    if isinstance(a.proof, IntervalProof) and isinstance(b.proof, IntervalProof):
        assert a.proof.intervals == b.proof.intervals
        for one, other in zip(a.proof.multipliers, b.proof.multipliers, strict=True):
            exact(one.D, other.D)
            exact(one.G, other.G)


def test_round_trip(tmp_path: Path) -> None:
    file = tmp_path / "a.h5"
    loop, mixed = random_loop_with_channels(), mixed_system(0)
    first, second = margin(), mbdlft.worst_case_gain(loop, "f", gap=0.1)
    third = mixed_margin()
    for system, bounds in ((loop, first), (loop, second), (mixed, third)):
        mbdlft.save_analysis(file, system, bounds)
    assert mbdlft.model_names(file) == tuple(sorted([loop.name, mixed.name]))
    names = mbdlft.analysis_names(file)
    assert names == ("matrix: robust stability", "matrix: worst-case gain", "mixed: robust stability")
    for name, bounds in zip(names, (first, second, third), strict=True):
        system, found = mbdlft.load_analysis(file, name)
        same(found, bounds)
        assert mbdlft.verify(system, found) == ""


def test_parts_fixed_blocks_and_first_files(tmp_path: Path) -> None:
    """Proofs of parts come back; those of the first files, with a bound of mu, are read as one part."""
    file, system = tmp_path / "a.h5", blocks_system(2)
    cut, whole = mbdlft.robust_stability(system, gap=0.1), mixed_margin()
    held = mbdlft.robust_stability(random_loop_with_channels(), fixed=["m"], gap=0.1)
    for model, bounds in ((system, cut), (mixed_system(0), whole), (random_loop_with_channels(), held)):
        mbdlft.save_analysis(file, model, bounds, "one")
        found_model, found = mbdlft.load_analysis(file, "one")
        same(found, bounds)
        assert mbdlft.verify(found_model, found) == ""
    assert isinstance(whole.proof, IntervalProof)
    mbdlft.save_analysis(file, mixed_system(0), whole, "one")
    beta = (1.0 - 1e-15) / whole.lower

    def old(group: Any) -> None:
        for name in ("intervals/log", "fixed", "inputs", "outputs"):
            del group[name]
        group["intervals"].attrs["beta"] = beta
        for name in ("G_real", "G_imaginary"):
            group[f"intervals/{name}"][...] *= beta**2

    edit(file, old, "analyses/one")
    model, found = mbdlft.load_analysis(file, "one")
    assert mbdlft.verify(model, found) == ""


def test_round_trip_of_motions(tmp_path: Path) -> None:
    file, loop = tmp_path / "a.h5", random_loop_with_channels()
    for rates in (np.inf, {"k": 0.5}):
        bounds = mbdlft.robust_stability(loop, rates=rates, gap=0.5, work=1.0)
        mbdlft.save_analysis(file, loop, bounds)
        assert mbdlft.analysis_names(file) == ("matrix: robust stability, moving parameters",)
        _, found = mbdlft.load_analysis(file)
        assert found.rates == bounds.rates
        same(replace(found, motion=None), replace(bounds, motion=None))
        assert (found.motion is None) == (bounds.motion is None)
        if found.motion is not None:
            exact(found.motion, bounds.motion)
        assert mbdlft.verify(loop, found) == ""
        assert isinstance(found.proof, MotionProof)
        assert isinstance(bounds.proof, MotionProof)
        for field in fields(MotionProof):
            exact(getattr(found.proof, field.name), getattr(bounds.proof, field.name))


def test_round_trip_of_edges(tmp_path: Path) -> None:
    file, loop = tmp_path / "a.h5", random_loop_with_channels()
    for what in ("real part", "damping"):
        bounds = mbdlft.worst_case(loop, what)
        mbdlft.save_analysis(file, loop, bounds)
        _, found = mbdlft.load_analysis(file, f"matrix: {bounds.kind}")
        same(found, bounds)
        assert mbdlft.verify(loop, found) == ""


def test_no_proof_and_infinite_bounds(tmp_path: Path) -> None:
    bounds = replace(margin(), upper=np.inf, proof=None, worst={}, delta={})
    mbdlft.save_analysis(tmp_path / "a.h5", random_loop_with_channels(), bounds, "mine")
    same(mbdlft.load_analysis(tmp_path / "a.h5")[1], bounds)


def test_an_analysis_belongs_to_its_model(tmp_path: Path) -> None:
    file = tmp_path / "a.h5"
    loop = random_loop_with_channels()
    bounds = margin()
    mbdlft.save_analysis(file, loop, bounds)
    narrower = loop.with_range(k=(1.5, 2.5))
    with pytest.raises(mbdlft.ArchiveError, match="is another one than the one that was analyzed"):
        mbdlft.save_analysis(file, narrower, bounds)
    mbdlft.save(file, narrower)
    with pytest.raises(mbdlft.ArchiveError, match="is not the one that was analyzed"):
        mbdlft.load_analysis(file)


def test_a_changed_analysis_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "a.h5"
    loop = random_loop_with_channels()
    mbdlft.save_analysis(file, loop, margin())
    name = "analyses/matrix: robust stability"

    def claim(group: object) -> None:
        group.attrs["lower"] = 99.0  # type: ignore[attr-defined]

    edit(file, claim, name, right=False)
    with pytest.raises(mbdlft.ArchiveError, match="its digest"):
        mbdlft.load_analysis(file)
    edit(file, claim, name)
    system, bounds = mbdlft.load_analysis(file)
    assert bounds.lower == 99.0
    assert "is not below its upper bound" in mbdlft.verify(system, bounds)
    edit(file, without("rates/value"), name)
    with pytest.raises(mbdlft.ArchiveError, match="rates/value is missing"):
        mbdlft.load_analysis(file)
