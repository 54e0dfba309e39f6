"""Systems without evidence, blocks that are no parameters, and what numbers rest on, in archives."""

from dataclasses import fields, replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from mbdlft import ArchiveError, Certificate, LFTModel, load, matrices_at, save
from mbdlft.archive.model import rests_on
from mbdlft.lft.block import Block, ComplexBlock, FullBlock
from mbdlft.lft.lft import LFT
from mbdlft.system.model import Parameters, System
from tests.archive import models
from tests.archive.plain_digest import as_words, edit
from tests.close import exact
from tests.errors.table import says
from tests.scenarios.commands import Output


def mixed(seed: int = 1) -> System:
    """Blocks of all kinds, in an order that is not that of the parameters."""
    random = np.random.default_rng(seed)
    blocks = (
        FullBlock("a", 2, 3),
        ComplexBlock("c", 2),
        Block("p0_µ", 2),
        FullBlock("p1", 1, 2),
        Block("p1_µ", 0),
        Block("p2_µ", 1),
    )
    z, w = sum(b.inputs for b in blocks), sum(b.outputs for b in blocks)
    base = models.strange(seed)
    nx, nu, ny = len(base.states), len(base.inputs), len(base.outputs)

    def some(rows: int, columns: int) -> np.ndarray:
        return random.standard_normal((rows, columns))

    lft = LFT(0.1 * some(z, w), some(z, nx + nu), some(nx + ny, w), some(nx + ny, nx + nu), blocks)
    return System(
        "mixed", lft, base.states, base.inputs, base.outputs, Parameters(base.parameters),
        description="a weight",
    )  # fmt: skip


def same_system(a: System, b: System) -> None:
    assert type(a) is type(b)
    assert a.lft.blocks == b.lft.blocks
    for part in ("M11", "M12", "M21", "M22"):
        exact(getattr(a.lft, part), getattr(b.lft, part))
    for item in fields(System):
        if item.name != "lft":
            assert getattr(a, item.name) == getattr(b, item.name)


def plain() -> System:
    """A system of a model: parameters only."""
    m = models.arm()
    return System(m.name, m.lft, m.states, m.inputs, m.outputs, m.parameters)


@pytest.mark.parametrize("make", [mixed, plain])
def test_systems_come_back(tmp_path: Path, make: object) -> None:
    system = make()  # type: ignore[operator]
    save(tmp_path / "a.h5", system)
    found = load(tmp_path / "a.h5")
    same_system(found, system)
    assert not isinstance(found, LFTModel)
    save(tmp_path / "a.h5", models.arm(), "model")
    same_system(load(tmp_path / "a.h5", system.name), system)
    with h5py.File(tmp_path / "a.h5") as file:
        assert file["models"][system.name].attrs["encoding_type"] == b"system"
        assert not {"trim", "certificate", "provenance"} & set(file["models"][system.name])


def test_values_of_a_mixed_system(tmp_path: Path) -> None:
    save(tmp_path / "a.h5", mixed())
    values = {"p0_µ": 0.31, "c": 0.5j, "a": 0.2 * np.eye(3, 2)}
    found, wanted = (matrices_at(s, values) for s in (load(tmp_path / "a.h5"), mixed()))
    for a, b in zip(found, wanted, strict=True):
        exact(a, b)


def test_blocks_as_documented(tmp_path: Path) -> None:
    save(tmp_path / "a.h5", mixed())
    with h5py.File(tmp_path / "a.h5") as file:
        delta = file["models/mixed/delta"]
        assert as_words(delta["name"]) == ["a", "c", "p0_µ", "p1", "p1_µ", "p2_µ"]
        assert as_words(delta["kind"]) == ["full", "complex", "real", "full", "real", "real"]
        exact(delta["rows"][()], [3, 2, 2, 2, 0, 1])
        exact(delta["columns"][()], [2, 2, 2, 1, 0, 1])
        exact(delta["parameter"][()], [-1] * 5 + [0, 0, -1, -1, 2])
        assert file["models/mixed/D_zw"].shape == (8, 10)


def test_models_with_blocks_that_are_no_parameters(tmp_path: Path) -> None:
    base, system = models.strange(1), mixed()
    model = LFTModel(
        **{item.name: getattr(system, item.name) for item in fields(System)},
        trim=base.trim,
        certificate=replace(base.certificate, order=(2, 0, 1), lower_bound=(0, 0, 1)),
        provenance=base.provenance,
    )
    save(tmp_path / "a.h5", model)
    models.same(load(tmp_path / "a.h5"), model)


def test_full_block_that_does_not_fit(tmp_path: Path) -> None:
    save(tmp_path / "a.h5", mixed())
    edit(tmp_path / "a.h5", lambda g: g["delta/columns"].__setitem__(0, 3), "models/mixed")
    with says(ArchiveError, "model 'mixed' is not as specified: LFT: the sizes of the blocks add up"):
        load(tmp_path / "a.h5")
    save(tmp_path / "a.h5", mixed())
    edit(tmp_path / "a.h5", lambda g: g["delta/parameter"].__setitem__(0, 0), "models/mixed")
    with says(ArchiveError, "does not agree with delta/name and delta/rows"):
        load(tmp_path / "a.h5")


def test_what_could_not_be_read_again_is_not_written(tmp_path: Path) -> None:
    arm = models.arm()
    wrong = replace(arm, certificate=replace(arm.certificate, order=(1,) * 7))
    with says(ArchiveError, "model 'two_link_arm': certificate: order is (1, 1,"):
        save(tmp_path / "a.h5", wrong)
    twice = replace(arm, inputs=(arm.inputs[0],) * 2)
    with says(ArchiveError, "model 'two_link_arm': inputs/name: ", "stands twice"):
        save(tmp_path / "a.h5", twice)
    assert not list(tmp_path.iterdir())


BOXES = tuple(tuple((p.low, p.nominal) for p in models.strange(1).parameters) for _ in range(2))


@pytest.mark.parametrize(
    ("changes", "basis"),
    [
        ({"well_posed": "proved"}, "proved"),
        ({"well_posed": "sampled"}, "checked"),
        ({"well_posed": "sampled", "open_boxes": BOXES}, "open"),
    ],
)
def test_evidence_comes_back(tmp_path: Path, changes: dict[str, object], basis: str) -> None:
    base = models.strange(1)
    model = replace(base, certificate=replace(base.certificate, exact_bound=True, **changes))
    save(tmp_path / "a.h5", model)
    models.same(load(tmp_path / "a.h5"), model)
    with h5py.File(tmp_path / "a.h5") as file:
        certificate = file["models"][model.name]["certificate"]
        evidence = certificate["evidence"]
        stated = dict(zip(as_words(evidence["number"]), as_words(evidence["basis"]), strict=True))
        assert ("open" in certificate) == ("open_boxes" in changes)
        if "open" in certificate:
            exact(certificate["open"][()], BOXES)
    assert stated == rests_on(model.certificate)
    assert stated["well_posed"] == basis
    assert stated["lower_bound"] == "proved"
    assert stated["max_relative_error"] == "checked"


def test_what_a_bound_of_an_error_rests_on() -> None:
    base = Certificate((1,), (1,), (1,), 0.0, 1, 1, exact=False)
    assert rests_on(base)["lower_bound"] == "checked"
    assert "truncation_error" not in rests_on(base)
    assert rests_on(replace(base, truncation_error=0.1))["truncation_error"] == "proved"
    assert rests_on(replace(base, truncation_error=np.inf))["truncation_error"] == "open"
    assert rests_on(replace(base, fit_error_bound=0.1))["fit_error_bound"] == "proved"
    assert rests_on(replace(base, condition=2.0))["condition"] == "checked"


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"well_posed": "proved", "open_boxes": BOXES}, "well_posed is 'proved', with open boxes"),
        ({"open_boxes": (tuple((b, a) for a, b in BOXES[0]),)}, "a lower end above its upper end"),
    ],
)
def test_evidence_that_cannot_be_true(tmp_path: Path, changes: dict[str, object], text: str) -> None:
    base = models.strange(1)
    model = replace(base, certificate=replace(base.certificate, **changes))
    with says(ArchiveError, text):
        save(tmp_path / "a.h5", model)


def test_the_command_line_shows_a_system(tmp_path: Path, output: Output) -> None:
    save(tmp_path / "a.h5", mixed())
    shown = " ".join(output("show", str(tmp_path / "a.h5")).split())
    assert "a (full, 3 x 2)" in shown
    assert "stored without evidence" in shown
