"""The layout of the archive, version 1.1, with plain h5py: every name, type and shape."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from importlib.metadata import version

import h5py
import numpy as np
import pytest

import mbdlft
from mbdlft import load, save, scene_from_toml, to_lft
from mbdlft.archive.model import rests_on
from tests.archive import models
from tests.archive.plain_digest import attributes, edit, without
from tests.close import exact, roundoff

TEXT, FLOAT, INTEGER = "text", "<f8", "<i8"
DATASETS = {
    name: (kind, *shape.split())
    for kind, shape, names in (
        (FLOAT, "nx nx", "A"),
        (FLOAT, "nx nw", "B_w"),
        (FLOAT, "nx nu", "B_u"),
        (FLOAT, "nw nx", "C_z"),
        (FLOAT, "nw nw", "D_zw"),
        (FLOAT, "nw nu", "D_zu"),
        (FLOAT, "ny nx", "C_y"),
        (FLOAT, "ny nw", "D_yw"),
        (FLOAT, "ny nu", "D_yu"),
        (TEXT, "nx", "states/name states/unit"),
        (TEXT, "nu", "inputs/name inputs/unit"),
        (TEXT, "ny", "outputs/name outputs/unit"),
        (INTEGER, "nw", "delta/parameter"),
        (TEXT, "np", "delta/name delta/kind"),
        (INTEGER, "np", "delta/rows delta/columns"),
        (TEXT, "np", "parameters/name parameters/unit parameters/role parameters/substitution"),
        (FLOAT, "np", "parameters/nominal parameters/low parameters/high parameters/reference"),
        (FLOAT, "np 3", "parameters/map"),
        (TEXT, "nt", "trim/name trim/unit"),
        (FLOAT, "nt", "trim/nominal"),
        (FLOAT, "ntw ntw", "trim/lft/D_zw"),
        (FLOAT, "ntw 1", "trim/lft/D_zu"),
        (FLOAT, "nt ntw", "trim/lft/D_yw"),
        (FLOAT, "nt 1", "trim/lft/D_yu"),
        (INTEGER, "ntw", "trim/lft/delta/parameter"),
        (TEXT, "np", "trim/lft/delta/name trim/lft/delta/kind"),
        (INTEGER, "np", "trim/lft/delta/rows trim/lft/delta/columns"),
        (INTEGER, "np", "certificate/order certificate/lower_bound certificate/raw_order"),
        (INTEGER, "np", "certificate/doubtful"),
        (FLOAT, "nf", "certificate/frequencies"),
        (TEXT, "ne", "certificate/evidence/number certificate/evidence/basis"),
        ("|u1", "ns", "provenance/scene"),
    )
    for name in names.split()
}
OPTIONAL = ("certificate/doubtful",)
CERTIFICATE = {
    name: np.dtype(kind)
    for kind, names in (
        (FLOAT, "max_relative_error truncation_error condition rounding_ratio transfer_error"),
        (INTEGER, "check_points seed sign_changes"),
        ("bool", "exact"),
    )
    for name in names.split()
}
ATTRIBUTES = {
    "": ("encoding_type", "encoding_version", "time_domain", "description", "digest"),
    "certificate": (*CERTIFICATE, "well_posed"),
    "provenance": ("scene", "mbdlft", "casadi", "numpy", "h5py", "created"),
}
MODELS = {"arm": models.arm, "unused": models.unused, "strange": lambda: models.strange(8)}


@pytest.fixture(params=MODELS.values(), ids=MODELS.keys())
def stored(request, tmp_path):
    """A model, and the group of the file that holds it."""
    model = request.param()
    save(tmp_path / "a.h5", model)
    with h5py.File(tmp_path / "a.h5") as file:
        yield model, file["models"][model.name]


def is_text(dtype):
    """Whether a type is UTF-8 of fixed length."""
    info = h5py.check_string_dtype(dtype)
    return info is not None and info.encoding == "utf-8" and info.length is not None


def attribute_type(group, name):
    return group.attrs.get_id(name).dtype


def test_root(stored):
    _, group = stored
    root = group.file
    assert dict(root.attrs) == {
        "format": b"mbdlft-archive",
        "format_version": b"1.1",
        "generator": f"mbdlft {mbdlft.__version__}".encode(),
    }
    assert all(is_text(attribute_type(root, name)) for name in root.attrs)
    assert list(root) == ["models"]


def test_datasets(stored):
    model, group = stored
    sizes = {
        "nx": len(model.states),
        "nu": len(model.inputs),
        "ny": len(model.outputs),
        "nw": model.order,
        "np": len(model.parameters),
        "nt": len(model.trim.signals),
        "ntw": model.trim.lft.order,
        "ne": len(rests_on(model.certificate)),
        "nf": len(model.certificate.frequencies),
        "ns": len(model.provenance.scene.encode()),
        "1": 1,
        "3": 3,
    }
    found = {}
    group.visititems(
        lambda name, item: found.update({name: item} if isinstance(item, h5py.Dataset) else {})
    )
    wanted = dict(DATASETS)
    if not model.certificate.frequencies:
        del wanted["certificate/frequencies"]
    assert sorted(found) == sorted(wanted)
    for name, (kind, *shape) in wanted.items():
        assert found[name].shape == tuple(sizes[size] for size in shape), name
        dtype = found[name].dtype
        assert is_text(dtype) if kind == TEXT else dtype.str == kind, name


def test_attributes(stored):
    model, group = stored
    found = {}
    group.visititems(lambda name, item: found.update({name: set(item.attrs)}))
    found[""] = set(group.attrs)
    wanted = {name: set(names) for name, names in ATTRIBUTES.items()}
    if not model.description:
        wanted[""] -= {"description"}
    if model.certificate.exact_bound:
        wanted["certificate"] |= {"exact_bound"}
    if not model.certificate.frequencies:
        wanted["certificate"] -= {"transfer_error"}
    assert {name: names for name, names in found.items() if names} == wanted
    assert group.attrs["encoding_type"] == b"lft-model"
    assert group.attrs["encoding_version"] == b"1.1"
    assert group.attrs["time_domain"] == b"continuous"
    assert group.attrs.get("description", b"").decode() == model.description
    for name in ("", "provenance"):
        item = group[name] if name else group
        assert all(is_text(attribute_type(item, key)) for key in item.attrs)
    certificate = group["certificate"]
    kinds = {key: attribute_type(certificate, key) for key in certificate.attrs}
    assert is_text(kinds.pop("well_posed"))
    assert kinds.pop("exact_bound", bool) == np.dtype(bool)
    assert kinds == {key: kind for key, kind in CERTIFICATE.items() if key in certificate.attrs}


def test_values(stored):
    model, group = stored
    for name in models.MATRICES:
        exact(group[name][()], getattr(model, name))
    for name in ("states", "inputs", "outputs"):
        signals = getattr(model, name)
        assert list(group[name]["name"].asstr()) == [signal.name for signal in signals]
        assert list(group[name]["unit"].asstr()) == [signal.unit for signal in signals]
    for name in ("name", "unit", "role", "substitution"):
        wanted = [getattr(p, name) for p in model.parameters]
        assert list(group["parameters"][name].asstr()) == wanted
    for name in ("nominal", "low", "high", "reference"):
        exact(group["parameters"][name][()], [getattr(p, name) for p in model.parameters])
    maps = [[p.map.b0, p.map.b1, p.map.a1] for p in model.parameters]
    exact(group["parameters/map"][()], maps)
    for name in ("order", "lower_bound", "raw_order", "doubtful"):
        exact(group["certificate"][name][()], getattr(model.certificate, name))
    exact(group["trim/nominal"][()], model.trim.nominal)
    for name, part in zip(("D_zw", "D_zu", "D_yw", "D_yu"), ("M11", "M12", "M21", "M22"), strict=True):
        exact(group["trim/lft"][name][()], getattr(model.trim.lft, part))


def test_channels_are_sorted_and_counted(stored):
    model, group = stored
    for rows, lft in (
        (group["delta/parameter"][()], model.lft),
        (group["trim/lft/delta/parameter"][()], model.trim.lft),
    ):
        assert np.all(np.diff(rows) >= 0)
        counts = np.bincount(rows, minlength=len(model.parameters))
        exact(counts, [block.size for block in lft.blocks])
    exact(
        np.bincount(group["delta/parameter"][()], minlength=len(model.parameters)),
        group["certificate/order"][()],
    )


def test_provenance(tmp_path):
    before = datetime.now(UTC) - timedelta(seconds=1)
    scene = scene_from_toml(models.ARM)
    save(tmp_path / "a.h5", to_lft(scene, search=0.0))
    with h5py.File(tmp_path / "a.h5") as file:
        provenance = file["models/two_link_arm/provenance"]
        made = {key: value.decode() for key, value in provenance.attrs.items()}
        assert made["scene"] == "in the dataset provenance/scene"
        assert scene_from_toml(provenance["scene"][()].tobytes().decode()) == scene
    for package in ("mbdlft", "casadi", "numpy", "h5py"):
        assert made[package] == version(package)
    created = datetime.fromisoformat(made["created"])
    assert created.utcoffset() == timedelta(0)
    assert before <= created <= datetime.now(UTC)


def test_bound_of_the_order_is_written_if_it_is_more(tmp_path):
    model = models.arm()
    alone = sum(model.certificate.lower_bound)
    save(tmp_path / "a.h5", model)
    assert load(tmp_path / "a.h5").certificate.order_bound == alone
    model = replace(model, certificate=replace(model.certificate, order_bound=alone + 1))
    save(tmp_path / "a.h5", model)
    with h5py.File(tmp_path / "a.h5") as file:
        certificate = file["models/two_link_arm/certificate"]
        assert certificate.attrs["order_bound"] == alone + 1
        assert attribute_type(certificate, "order_bound") == np.dtype("<i8")
    assert load(tmp_path / "a.h5").certificate.order_bound == alone + 1


def test_trim_lft_may_be_missing(tmp_path):
    save(tmp_path / "a.h5", models.bare())
    with h5py.File(tmp_path / "a.h5") as file:
        assert set(file["models/bare/trim"]) == {"name", "unit", "nominal"}
        assert file["models/bare/trim/name"].shape == (0,)
        assert file["models/bare/B_w"].shape == (1, 0)
        assert file["models/bare/parameters/map"].shape == (0, 3)


def test_conditioning_may_be_missing(tmp_path):
    """Files that were written before there was any, and models that are derived from others."""
    save(tmp_path / "a.h5", models.arm())
    change = attributes("certificate", condition=None, rounding_ratio=None, sign_changes=None)
    edit(tmp_path / "a.h5", change, "models/two_link_arm")
    found = load(tmp_path / "a.h5")
    assert (found.certificate.condition, found.certificate.sign_changes) == (0.0, 0)
    save(tmp_path / "b.h5", found)
    with h5py.File(tmp_path / "b.h5") as file:
        assert "condition" not in file["models/two_link_arm/certificate"].attrs


def test_doubtful_ranks_may_be_missing(tmp_path):
    """As in archives written before they were recorded."""
    save(tmp_path / "a.h5", models.arm())
    edit(tmp_path / "a.h5", without("certificate/doubtful"), "models/two_link_arm")
    assert load(tmp_path / "a.h5").certificate.doubtful == ()
