"""The JSON schema (draft 7) of scene files, for editors: keys, kinds, and types of values.

It is made of the same classes that read a file, so it has every kind that is in a list of kinds. It knows
less than the reader: names, units and expressions are texts.
"""

from collections.abc import Mapping
from typing import Any

from mbdlft.base.description import Description
from mbdlft.base.parameter import ROLES, SUBSTITUTIONS
from mbdlft.multibody.body import KINDS as BODIES
from mbdlft.multibody.force import KINDS as LOADS
from mbdlft.multibody.joint import KINDS as JOINTS
from mbdlft.multibody.loop import KINDS as LOOPS
from mbdlft.multibody.loop import Loop
from mbdlft.multibody.scene.scene import ALL, NEEDED, Constant, Fit, Scene, Spin
from mbdlft.multibody.scene.toml import FORMAT
from mbdlft.multibody.sensor import KINDS as SENSORS

Schema = dict[str, Any]
_DRAFT = "http://json-schema.org/draft-07/schema#"
_TEXTS = {"role": list(ROLES), "substitution": list(SUBSTITUTIONS[1:]), "unit": None}
_NUMBERS = ("nominal", "low", "high", "percent", "plus", "minus", "reference")
_PLAIN = ("name", "description", "gravity", "acceleration")


def scene_schema() -> Schema:
    """The schema of the format ``mbdlft-scene/1``, as plain data for JSON.

    Returns
    -------
    dict
        Whatever `scene_from_toml` reads fits it; a file that fits may still be no scene.
    """
    definitions: Schema = {}
    scene = _of(Scene, definitions)["properties"]
    loops = dict.fromkeys(LOOPS, Loop)
    properties: Schema = {
        "format": {"const": FORMAT},
        **{key: scene[key] for key in _PLAIN},
        "spin": _of(Spin, definitions),
        "fit": _of(Fit, definitions),
        "constants": _named({"anyOf": [{"type": "number"}, _of(Constant, definitions)]}),
        "parameters": _named(_parameter()),
        "bodies": _named(_kinds(BODIES, definitions)),
        "joints": _named(_kinds(JOINTS, definitions)),
        "loads": _named(_kinds(LOADS, definitions)),
        "sensors": _named(_kinds(SENSORS, definitions)),
        "loops": _named(_kinds(loops, definitions)),
        "linearize": _linearize(),
    }
    for name in ("scene", "Scene"):
        definitions.pop(name, None)
    return {
        "$schema": _DRAFT,
        "title": FORMAT,
        "type": "object",
        "properties": properties,
        "required": ["format", "name"],
        "additionalProperties": False,
        "definitions": definitions,
    }


def _named(schema: Schema) -> Schema:
    """A table whose entries have names."""
    return {"type": "object", "additionalProperties": schema}


def _of(record: type[Description], definitions: Schema) -> Schema:
    """The schema of a record; what it refers to goes to `definitions`."""
    found = record.model_json_schema(ref_template="#/definitions/{model}")
    for name, schema in found.pop("$defs", {}).items():
        definitions.setdefault(name, _draft_7(schema))
    plain: Schema = _draft_7(found)
    return plain


def _draft_7(schema: Any) -> Any:
    """A schema without words of later drafts, and without the titles and values that only repeat keys."""
    if isinstance(schema, list):
        return [_draft_7(entry) for entry in schema]
    if not isinstance(schema, dict):
        return schema
    found: Schema = {}
    for key, entry in schema.items():
        if key == "prefixItems":
            found["items"] = _draft_7(entry)
        elif key == "properties":
            found[key] = {name: _draft_7(part) for name, part in entry.items()}
        elif key not in ("title", "default"):
            found[key] = _draft_7(entry)
    return found


def _kinds(kinds: Mapping[str, type[Description]], definitions: Schema) -> Schema:
    """A table of one of the kinds: the key ``kind`` says which keys it has."""
    choices = []
    for kind, record in kinds.items():
        own = _of(record, definitions)
        properties = {name: part for name, part in own["properties"].items() if name != "name"}
        properties["kind"] = {"const": kind}
        required = {"kind", *own.get("required", ())} - {"name"}
        own |= {"properties": properties, "required": sorted(required)}
        choices.append({"if": {"properties": {"kind": {"const": kind}}}, "then": own})
    return {
        "type": "object",
        "properties": {"kind": {"enum": sorted(kinds)}},
        "required": ["kind"],
        "allOf": choices,
    }


def _parameter() -> Schema:
    """A parameter or an angle."""
    properties: Schema = {name: {"type": "number"} for name in _NUMBERS}
    for name, words in _TEXTS.items():
        properties[name] = {"type": "string"} if words is None else {"enum": words}
    return {
        "type": "object",
        "properties": properties,
        "required": ["nominal"],
        "additionalProperties": False,
    }


def _linearize() -> Schema:
    """Signals and states of the linear model."""
    names = {"type": "array", "items": {"type": "string"}, "minItems": 1}
    return {
        "type": "object",
        "properties": {"inputs": names, "outputs": names, "states": {"enum": [ALL, NEEDED]}},
        "additionalProperties": False,
    }
