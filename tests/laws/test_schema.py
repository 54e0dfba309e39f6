"""The schema of scene files: whatever is read as a scene fits it, and slips do not."""

import json
import tomllib
from functools import cache
from pathlib import Path
from typing import Any

import fastjsonschema
import numpy as np
import pytest

import mbdlft
from mbdlft.base.errors import MbdlftError
from mbdlft.multibody import scene_from_toml, scene_schema, scene_to_toml
from tests.attack.scenes import texts
from tests.attack.structures import as_toml, restructured
from tests.cross.mechanisms import open_tree
from tests.scenarios.commands import run

ROOT = Path(__file__).parents[2]
SCENES = [
    path
    for path in sorted((ROOT / "scenarios").glob("*.toml"))
    if "mbdlft-scene" in path.read_text(encoding="utf-8")
]


@cache
def schema() -> Any:
    return fastjsonschema.compile(scene_schema())


@pytest.mark.parametrize("path", SCENES, ids=lambda path: str(path.stem))
def test_scenarios_fit(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    schema()(tomllib.loads(text))
    schema()(tomllib.loads(scene_to_toml(scene_from_toml(text))))


def test_what_is_read_fits() -> None:
    """Random trees with all kinds of joints, and scenes that were changed by chance."""
    for seed in range(12):
        schema()(tomllib.loads(scene_to_toml(open_tree(seed))))
    rng, given, read = np.random.default_rng(5), texts(), 0
    for _ in range(150):
        text = as_toml(restructured(tomllib.loads(given[int(rng.integers(len(given)))]), rng))
        try:
            scene_from_toml(text)
        except MbdlftError:
            continue
        read += 1
        schema()(tomllib.loads(text))
    assert read > 20


ARM: dict[str, Any] = tomllib.loads((ROOT / "scenarios" / "two_link_arm.toml").read_text("utf-8"))


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (("format",), "mbdlft-scene/2"),
        (("gravty",), [0, 0, 1]),
        (("gravity",), [0, 0]),
        (("gravity",), [0, 0, True]),
        (("joints", "shoulder", "axis"), ["x", 0, 1]),
        (("joints", "shoulder", "stifness"), 1.0),
        (("joints", "shoulder", "kind"), "hinge"),
        (("bodies", "link1", "inertia", "xz2"), 1.0),
        (("bodies", "link1", "mass"), [1.0]),
        (("parameters", "m1", "role"), "unknown"),
        (("parameters", "m1", "nominal"), "3"),
        (("linearize", "states"), "some"),
    ],
)
def test_slips_do_not_fit(place: tuple[str, ...], value: object) -> None:
    """They are errors of the reader, too."""
    table = json.loads(json.dumps(ARM))
    schema()(table)
    part = table
    for key in place[:-1]:
        part = part[key]
    part[place[-1]] = value
    with pytest.raises(fastjsonschema.JsonSchemaValueException):
        schema()(table)
    with pytest.raises(MbdlftError):
        scene_from_toml(as_toml(table))


def test_what_is_missing_does_not_fit() -> None:
    for place in (("joints", "shoulder", "kind"), ("joints", "shoulder", "parent"), ("name",)):
        table = json.loads(json.dumps(ARM))
        part = table
        for key in place[:-1]:
            part = part[key]
        del part[place[-1]]
        with pytest.raises(fastjsonschema.JsonSchemaValueException):
            schema()(table)


def test_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    code, said, _ = run(monkeypatch, capsys, "schema")
    assert code == 0
    assert json.loads(said) == json.loads(json.dumps(mbdlft.scene_schema()))
    file = tmp_path / "scene.schema.json"
    assert run(monkeypatch, capsys, "schema", "-o", str(file))[0] == 0
    assert file.read_text(encoding="utf-8") == said
    code, _, said = run(monkeypatch, capsys, "schema", "-o", str(tmp_path))
    assert (code, "cannot be written" in said) == (2, True)
