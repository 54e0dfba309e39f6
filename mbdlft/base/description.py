"""The base class of all records of a scene, and the types of their fields.

A record is frozen, and its fields are checked when it is made.
"""

import unicodedata
from collections.abc import Mapping, Sequence
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    NamedTuple,
    TypeAlias,
    TypeVar,
    get_args,
    get_origin,
)

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError
from pydantic.fields import FieldInfo

from mbdlft.base.display import ReadableSignature
from mbdlft.base.errors import MbdlftError, SceneError, unknown_name


def with_length(direction: "Direction", what: str = "axis") -> "Direction":
    """The direction, or a SceneError if its length is zero; `what` names it there."""
    if not any(direction):
        raise SceneError(
            f"{what} has zero length, got {list(direction)}. Give a direction; its length is ignored."
        )
    return direction


def without_controls(text: str, but: str = "") -> str:
    """The text itself, if it can be printed and stored."""
    for character in text:
        if unicodedata.category(character) == "Cc" and character not in but:
            raise SceneError(
                f"{text!r} has the character {character!r}, which cannot be printed and stored. "
                "Leave it out."
            )
    return text


Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Text = Annotated[str, Field(strict=True, min_length=1)]
Name = Annotated[Text, AfterValidator(without_controls)]
Prose = Annotated[str, AfterValidator(lambda text: without_controls(text, "\n\r\t"))]
Quantity = Number | Text
if TYPE_CHECKING:  # lists are taken, too, and become tuples
    T = TypeVar("T", covariant=True)
    Many: TypeAlias = Sequence[T]
    Vector: TypeAlias = Sequence[Quantity]
    Direction: TypeAlias = Sequence[Number]
else:

    class Many:
        """A tuple of any length."""

        def __class_getitem__(cls, item: Any) -> Any:
            return tuple[item, ...]

    Vector = tuple[Quantity, Quantity, Quantity]
    Direction = tuple[Number, Number, Number]
Axis = Annotated[Direction, AfterValidator(with_length)]
# values of quantities by label: SX or float, for an angle a tuple of turns
Values = Mapping[str, Any]

AXES = ("x", "y", "z")
ANY_UNIT = "any"  # the unit of a quantity whose unit is not checked


class Expected(NamedTuple):
    """A quantity as the user gave it, and a unit of the dimension that its value must have."""

    source: Quantity
    unit: str


def vector_quantities(label: str, vector: Vector, unit: str) -> dict[str, Expected]:
    """The three components of a vector as labeled quantities: ``label.x`` and so on."""
    return {f"{label}.{axis}": Expected(entry, unit) for axis, entry in zip(AXES, vector, strict=True)}


class Description(BaseModel):
    """A frozen record; a wrong or unknown field is a `SceneError`."""

    noun: ClassVar[str] = ""  # what messages call it; its name follows, if it has one

    # validators are built when a record is first made: those of all kinds take a tenth of a start
    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)

    def __init__(self, **fields: Any) -> None:
        try:
            super().__init__(**fields)
        except ValidationError as error:
            raise SceneError(self._message(fields, error)) from None

    def __dir__(self) -> list[str]:
        """Fields and properties of the record, without those of every pydantic model."""
        return [name for name in super().__dir__() if name[0] != "_" and not hasattr(BaseModel, name)]

    @classmethod
    def __pydantic_init_subclass__(cls, **kwargs: Any) -> None:
        cls.__signature__ = ReadableSignature()  # type: ignore[assignment]

    @classmethod
    def __pydantic_on_complete__(cls) -> None:
        cls.__signature__ = ReadableSignature()  # type: ignore[assignment]

    @classmethod
    def where(cls, fields: Mapping[str, Any]) -> str:
        """The words by which error messages name the record with these fields."""
        noun = cls.noun or cls.__name__.lower()
        return f"{noun} {fields.get('name', '')!r}" if "name" in cls.model_fields else noun

    @classmethod
    def _message(cls, fields: Mapping[str, Any], error: ValidationError) -> str:
        """The message for fields that pydantic refuses, one line for each."""
        lines: dict[str, None] = {}
        plain: set[str] = set()  # fields whose value is shown: it can be a list of 100 000 wrong entries
        for item in error.errors(include_url=False):
            cause = item.get("ctx", {}).get("error")
            if isinstance(cause, MbdlftError):
                line = f"{cls.where(fields)}: {cause}"
            elif item["type"] == "extra_forbidden" and len(item["loc"]) == 1:
                known = [name for name in cls.model_fields if name != "name"]
                line = f"{cls.where(fields)}: {unknown_name('key', str(item['loc'][0]), known)}"
            elif item["type"] == "missing" and len(item["loc"]) == 1:
                line = f"{cls.where(fields)}: {item['loc'][0]!r} is missing."
            else:
                place = str(item["loc"][0]) if item["loc"] else ""
                if place in plain:
                    continue
                plain.add(place)
                got = f"got {fields.get(place)!r}."
                line = f"{cls.where(fields)}: {place}: expected {_expected(place, cls)}, {got}"
            lines[line] = None
        return "\n".join(lines)


_WORDS = (
    ("shape", "a table such as { box = [1.0, 0.5, 0.2] }"),
    ("gravity acceleration velocity center_of_mass", "three numbers or expressions"),
    ("axis axis1 axis2 direction", "three numbers"),
    ("ports", "a table of positions, three numbers or expressions each"),
    ("inertia", "a table of entries such as { xx = 1.0, yy = 2.0, zz = 2.5 }"),
    ("orientation", "a list of rotations, each with axis and angle"),
    ("imposed", "true, false or 'motion'"),
    ("constants", "numbers by name, or tables with value and unit"),
    ("inputs outputs", "a list of at least one signal name"),
    ("expressions", "numbers or expressions by name"),
    ("parent child about port joint frame name kind description unit", "a text"),
    ("unchecked", "true or false"),
    ("contacts", "a list of contacts"),
    *(
        (name, f"a list of {name}")
        for name in ("parameters", "bodies", "joints", "loads", "sensors", "loops", "couplings")
    ),
)
_EXPECTED = {name: words for names, words in _WORDS for name in names.split()}


def _expected(field: str, owner: type[BaseModel]) -> str:
    """The values that a field takes, in words."""
    if field == "states":
        return "a text" if owner.model_fields[field].annotation is str else "a list of names"
    return _EXPECTED.get(field) or _expected_type(owner.model_fields.get(field))


def _expected_type(field: FieldInfo | None) -> str:
    """The values that a field of numbers takes, in words, by its type."""
    if field is None:
        return "a finite number or an expression"
    annotated = [get_args(kind) for kind in get_args(field.annotation) if get_origin(kind) is Annotated]
    optional = [extra.metadata for kind, extra, *_ in annotated if kind is int]  # its limits stay there
    if field.annotation is int or optional:
        limits = optional[0] if optional else field.metadata
        least, most = (
            next((getattr(item, end) for item in limits if hasattr(item, end)), None)
            for end in ("ge", "le")
        )
        return (
            f"a whole number of at least {least}"
            if most is None
            else f"a whole number from {least} to {most}"
        )
    for kind in (field.annotation, *get_args(field.annotation)):
        entries = get_args(kind) if get_origin(kind) is tuple else ()
        if len(entries) > 1 and ... not in entries:
            words = "numbers or expressions" if Quantity in entries else "numbers"
            return f"a list of {len(entries)} {words}"
    return "a finite number or an expression"
