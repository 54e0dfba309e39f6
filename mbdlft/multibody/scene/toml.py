"""Scenes as TOML files of the format `mbdlft-scene/1`.

A scene that is written as TOML and read again is equal to the first one. The JSON schema
(draft 7) of the files, for editors, is made of the same classes. It knows less than the reader: names,
units and expressions are texts.
"""

import inspect
import math
import re
import tomllib
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, cast

import tomli_w

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.description import Description
from mbdlft.base.errors import SceneError, check_known, misspelt, naming, unknown_name
from mbdlft.base.parameter import ROLES, SUBSTITUTIONS, Angle, Parameter
from mbdlft.base.unit import ANGLE_UNITS
from mbdlft.base.worker import content_of
from mbdlft.multibody.body import KINDS as BODIES
from mbdlft.multibody.body import Body
from mbdlft.multibody.contact import KINDS as CONTACTS
from mbdlft.multibody.coupling import KINDS as COUPLINGS
from mbdlft.multibody.force import KINDS as LOADS
from mbdlft.multibody.joint import KINDS as JOINTS
from mbdlft.multibody.loop import KINDS as LOOPS
from mbdlft.multibody.loop import Loop
from mbdlft.multibody.scene.scene import ALL, NEEDED, Constant, Fit, Scene, Spin
from mbdlft.multibody.sensor import KINDS as SENSORS

T = TypeVar("T")
Kind = tuple[Callable[[Any], bool], str]  # whether a value is of the kind; the kind in words

FORMAT = "mbdlft-scene/1"
_LINEARIZE = ("inputs", "outputs", "states")
_TOP = ("format", *(key for key in Scene.model_fields if key not in _LINEARIZE), "linearize")
_PLAIN = ("name", "description", "gravity", "acceleration", "velocity")
_RECORDS: dict[str, type[Description]] = {"spin": Spin, "fit": Fit}
_ITEMS: dict[str, tuple[str, Mapping[str, type[Description]]]] = {
    "bodies": ("body", BODIES),
    "joints": ("joint", JOINTS),
    "loads": ("load", LOADS),
    "sensors": ("sensor", SENSORS),
    "loops": ("loop", dict.fromkeys(LOOPS, Loop)),
    "couplings": ("coupling", COUPLINGS),
    "contacts": ("contact", CONTACTS),
}
_PARAMETER_KEYS = tuple(name for name in inspect.signature(Parameter).parameters if name != "name")


@arguments_checked
def load_scene(path: str | Path) -> Scene:
    """Read the scene of the TOML file at `path`."""
    if str(path).endswith((".mo", ".mof")):
        raise SceneError(
            f"{path}: it is a Modelica model, whose equations have no bodies: no scene, and nothing to "
            "be seen in space. mbdlft linearize and report take it; load_modelica(path) in Python."
        )
    return read_file(path, scene_from_toml)


def scene_from_toml(text: str) -> Scene:
    """Read the scene of a TOML text."""
    return read_table(text, _scene)


@arguments_checked
def scene_to_toml(scene: Scene) -> str:
    """Write a scene as TOML; `scene_from_toml` of this text is an equal scene."""
    table: dict[str, Any] = {"format": FORMAT, "name": scene.name}
    if scene.description:
        table["description"] = scene.description
    table["gravity"] = list(scene.gravity)
    if any(scene.acceleration):
        table["acceleration"] = list(scene.acceleration)
    if any(scene.velocity):
        table["velocity"] = list(scene.velocity)
    if scene.spin:
        table["spin"] = scene.spin.model_dump(mode="json")
    table |= values_table(scene.constants, scene.parameters)
    for key in _ITEMS:
        items = getattr(scene, key)
        if items or key in ("bodies", "joints"):
            table[key] = {item.name: _kind_table(item) for item in items}
    if scene.fit:
        table["fit"] = scene.fit.model_dump()
    chosen = {"inputs": scene.inputs, "outputs": scene.outputs}
    linearize: dict[str, Any] = {key: list(names) for key, names in chosen.items() if names is not None}
    if scene.states != ALL:
        linearize["states"] = scene.states
    if linearize:
        table["linearize"] = linearize
    return tomli_w.dumps(table)


def body_to_toml(body: Body) -> str:
    """Write one body as TOML: the table `bodies.NAME`, which can be pasted into a scene file."""
    return tomli_w.dumps({"bodies": {body.name: _kind_table(body)}})


def read_body(name: str, table: Mapping[str, Any]) -> Body:
    """Body of the entries of a table `bodies.NAME`."""
    (body,) = _kinds("body", "bodies", {"bodies": {name: dict(table)}}, BODIES)
    return cast(Body, body)


_MOST_PARTS = 500
_LONG_KEY = re.compile(rf"^[ \t\[]*(?:[\w-]+[ \t]*\.[ \t]*){{{_MOST_PARTS}}}", re.MULTILINE)


def read_file(path: str | Path, read: Callable[[str], T]) -> T:
    """The result of `read` for the text of a file; errors of `read` are raised with the file's name."""
    file = Path(path)
    content = content_of(file, SceneError)
    if content.startswith(b"\x89HDF"):
        raise SceneError(
            f"{file}: it is an archive (HDF5), not a text. mbdlft.load(path) reads its models."
        )
    try:
        text = content.decode("utf-8").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise SceneError(f"{file}: cannot be read: it is not UTF-8 text: {error}.") from None
    with naming(file):
        return read(text)


def read_table(text: str, read: Callable[[dict[str, Any]], T]) -> T:
    """The result of `read` for the table of a TOML text.

    Errors of `read` are raised with the line of the body, joint, ... that they name.
    """
    if match := _LONG_KEY.search(text):  # tomllib takes the square of the number of its parts
        place = text.count("\n", 0, match.end()) + 1
        raise SceneError(f"line {place}: not valid TOML: expected a key of at most {_MOST_PARTS} parts.")
    try:
        table = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also numbers of thousands of digits
        quotes = ' Texts stand in quotes, names and expressions, too: mass = "2*m".'
        hint = quotes if "Invalid value" in str(error) else ""
        raise SceneError(f"not valid TOML: {error}.{hint}") from None
    try:
        return read(table)
    except SceneError as error:
        line = _line(text, str(error))
        raise SceneError(f"line {line}: {error}" if line else str(error)) from None


def check_keys(table: Mapping[str, Any], form: str, keys: Collection[str]) -> None:
    """Raise a SceneError if a key is not one of `keys`, or the format is not `form`."""
    if "format" not in table:
        raise SceneError(f"the line format = {form!r} is missing{misspelt('format', table)}.")
    if table["format"] != form:
        raise SceneError(
            f"format: expected {form!r}, got {table['format']!r}. Scenes are for mbdlft linearize "
            "(load_scene), matrices for mbdlft realize (load_matrix)."
        )
    check_known("key", table, keys)


def check_value(where: str, value: Any, kind: Kind) -> None:
    """Raise a SceneError unless a value is of a kind."""
    fits, words = kind
    if not fits(value):
        raise SceneError(f"{where}: expected {words}, got {value!r}.")


def read_constants(table: Mapping[str, Any]) -> dict[str, Any]:
    """Numbers and `Constant`s of the table `constants`."""
    return {
        name: _constant(name, value) if isinstance(value, dict) else value
        for name, value in _table("constants", table.get("constants", {})).items()
    }


def read_parameters(table: Mapping[str, Any]) -> list[Parameter]:
    """Parameters of the table `parameters`."""
    return [
        _parameter(name, value)
        for name, value in _table("parameters", table.get("parameters", {})).items()
    ]


def values_table(
    constants: Mapping[str, float | Constant], parameters: Sequence[Parameter]
) -> dict[str, Any]:
    """The tables `constants` and `parameters`; an empty one is left out."""
    tables = {
        "constants": {
            name: value.model_dump() if isinstance(value, Constant) else value
            for name, value in constants.items()
        },
        "parameters": {p.name: _parameter_table(p) for p in parameters},
    }
    return {key: table for key, table in tables.items() if table}


def _scene(table: dict[str, Any]) -> Scene:
    """The scene of the table of a scene file."""
    check_keys(table, FORMAT, _TOP)
    linearize = _table("linearize", table.get("linearize", {}))
    check_known("key", linearize, _LINEARIZE, "linearize")
    return Scene(
        **{key: table[key] for key in _PLAIN if key in table},
        **{key: _table(key, table[key]) for key in _RECORDS if key in table},
        constants=read_constants(table),
        parameters=read_parameters(table),
        **{key: _kinds(noun, key, table, kinds) for key, (noun, kinds) in _ITEMS.items()},
        **linearize,
    )


def _constant(name: str, fields: dict[str, Any]) -> Constant:
    """The `Constant` of a table; errors name it."""
    try:
        return Constant(**fields)
    except SceneError as error:
        raise SceneError(str(error).replace("constant: ", f"constant {name!r}: ")) from None


def _table(where: str, value: Any) -> dict[str, Any]:
    """The value itself, or a SceneError if it is not a table."""
    check_value(where, value, (lambda x: isinstance(x, dict), "a table"))
    return cast("dict[str, Any]", value)


def _kinds(what: str, key: str, table: dict[str, Any], kinds: Mapping[str, Any]) -> list[Any]:
    """Objects of all entries of the table `key`, each of the class of its kind."""
    items = []
    for name, value in _table(key, table.get(key, {})).items():
        fields = dict(_table(f"{what} {name!r}", value))
        kind = fields.pop("kind", None)
        if kind is None:
            slip = misspelt("kind", fields)
            listed = ", ".join(sorted(kinds))
            raise SceneError(f"{what} {name!r}: 'kind' is missing{slip}. Kinds: {listed}.")
        if not isinstance(kind, str) or kind not in kinds:
            raise SceneError(f"{what} {name!r}: " + unknown_name("kind", str(kind), kinds))
        if "name" in fields:
            raise SceneError(f"{what} {name!r}: the key 'name' is not used; the table has the name.")
        if kinds[kind] is Loop:
            fields["kind"] = kind
        items.append(kinds[kind](**{"name": name, **fields}))
    return items


def _kind_table(item: Any) -> dict[str, Any]:
    """The table of an item: its kind and the fields that are not default."""
    left_out: dict[str, Any] = {"exclude_defaults": True, "exclude_none": True}
    fields: dict[str, Any] = item.model_dump(mode="json", exclude={"name", "kind"}, **left_out)
    return {"kind": item.kind} | fields


def _parameter(name: str, value: Any) -> Parameter:
    """Parameter of a table; it is an `Angle` if its unit is one of angles."""
    where = f"parameter {name!r}"
    fields = _table(where, value)
    for key, entry in fields.items():
        check_known("key", [key], _PARAMETER_KEYS, where)
        text = key in ("unit", "role", "substitution")
        if not isinstance(entry, str if text else int | float) or isinstance(entry, bool):
            raise SceneError(f"{where}: {key}: expected a {'text' if text else 'number'}, got {entry!r}.")
    if "nominal" not in fields:
        raise SceneError(f"{where}: 'nominal' is missing.")
    if fields.get("unit") not in ANGLE_UNITS:
        return Parameter(name, **fields)
    if "percent" in fields:
        raise SceneError(f"{where}: percent has no meaning for an angle; give low and high.")
    chosen = fields.get("substitution", "half-angle")
    check_known("substitution", [chosen], SUBSTITUTIONS[1:], f"{where}: substitution")
    return Angle(name, **fields)


def _parameter_table(parameter: Parameter) -> dict[str, Any]:
    p, keys = parameter, ("nominal", "low", "high", "unit", "role")
    table = {key: getattr(parameter, key) for key in keys}
    if p.is_angle:
        table |= {"substitution": p.substitution, "reference": _in_unit(p.reference, p.factor)}
    return table


def _in_unit(radians: float, factor: float) -> float:
    """An angle in a unit of `factor` rad, such that its conversion gives exactly `radians`."""
    value = radians / factor
    for candidate in (value, math.nextafter(value, math.inf), math.nextafter(value, -math.inf)):
        if candidate * factor == radians:
            return candidate
    raise SceneError(
        f"a reference angle of {radians!r} rad has no equal in the unit of its parameter; "
        "give the parameter the unit 'rad'."
    )


def _line(text: str, message: str) -> int | None:
    """Line of the body, joint, ... that an error message names; None if it names none."""
    match = re.search(
        r"(parameter|constant|body|joint|load|sensor|loop|coupling|contact) '([^']+)'", message
    )
    if match is None:
        return None
    section = {"parameter": "parameters", "body": "bodies"}.get(match[1], match[1] + "s")
    name = re.escape(match[2])
    header = re.compile(rf"^\s*\[{section}\.\"?{name}\"?[.\]]|^\s*{section}\.{name}\b")
    inside = ""
    for number, line in enumerate(text.splitlines(), start=1):
        if header.match(line):
            return number
        if line.lstrip().startswith("["):
            inside = line.strip().strip("[]")
        if inside == section and re.match(rf"\s*\"?{name}\"?\s*[.=]", line):
            return number
    return None


Schema = dict[str, Any]
_DRAFT = "http://json-schema.org/draft-07/schema#"
_TEXTS = {"role": list(ROLES), "substitution": list(SUBSTITUTIONS[1:]), "unit": None}
_NUMBERS = ("nominal", "low", "high", "percent", "plus", "minus", "reference")


def scene_schema() -> Schema:
    """The schema of the format ``mbdlft-scene/1``, as plain data for JSON.

    Returns
    -------
    dict
        Whatever `scene_from_toml` reads fits it; a file that fits may still be no scene.
    """
    definitions: Schema = {}
    names = {"type": "array", "items": {"type": "string"}, "minItems": 1}
    parameter: Schema = {name: {"type": "number"} for name in _NUMBERS}
    for name, words in _TEXTS.items():
        parameter[name] = {"type": "string"} if words is None else {"enum": words}
    scene = _of(Scene, definitions)["properties"]
    properties: Schema = {
        "format": {"const": FORMAT},
        **{key: scene[key] for key in _PLAIN},
        **{key: _of(record, definitions) for key, record in _RECORDS.items()},
        "constants": _named({"anyOf": [{"type": "number"}, _of(Constant, definitions)]}),
        "parameters": _named({**_strict(parameter), "required": ["nominal"]}),
        **{key: _named(_kinds_schema(kinds, definitions)) for key, (_, kinds) in _ITEMS.items()},
        "linearize": _strict({"inputs": names, "outputs": names, "states": {"enum": [ALL, NEEDED]}}),
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


def _strict(properties: Schema) -> Schema:
    """A table with these keys and no others."""
    return {"type": "object", "properties": properties, "additionalProperties": False}


def _of(record: type[Description], definitions: Schema) -> Schema:
    """The schema of a record; what it refers to goes to `definitions`."""
    whole = record.model_json_schema(ref_template="#/definitions/{model}")
    for name, schema in whole.pop("$defs", {}).items():
        definitions.setdefault(name, _draft_7(schema))
    plain: Schema = _draft_7(whole)
    return plain


def _draft_7(schema: Any) -> Any:
    """A schema without words of later drafts, and without the titles and values that only repeat keys."""
    if isinstance(schema, list):
        return [_draft_7(entry) for entry in schema]
    if not isinstance(schema, dict):
        return schema
    draft: Schema = {}
    for key, entry in schema.items():
        if key == "prefixItems":
            draft["items"] = _draft_7(entry)
        elif key == "properties":
            draft[key] = {name: _draft_7(item) for name, item in entry.items()}
        elif key not in ("title", "default"):
            draft[key] = _draft_7(entry)
    return draft


def _kinds_schema(kinds: Mapping[str, type[Description]], definitions: Schema) -> Schema:
    """A table of one of the kinds: the key ``kind`` says which keys it has."""
    choices = []
    for kind, record in kinds.items():
        choice = _of(record, definitions)
        properties = {name: item for name, item in choice["properties"].items() if name != "name"}
        properties["kind"] = {"const": kind}
        required = {"kind", *choice.get("required", ())} - {"name"}
        choice |= {"properties": properties, "required": sorted(required)}
        choices.append({"if": {"properties": {"kind": {"const": kind}}}, "then": choice})
    return {
        "type": "object",
        "properties": {"kind": {"enum": sorted(kinds)}},
        "required": ["kind"],
        "allOf": choices,
    }
