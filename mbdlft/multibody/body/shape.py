"""What a body looks like in pictures."""

from typing import ClassVar, Self, final

from pydantic import model_validator

from mbdlft.base.description import Axis, Description, Direction, Many, Number
from mbdlft.base.errors import SceneError

_KINDS = ("box", "cylinder", "sphere")


@final
class Shape(Description):
    """A box, a cylinder or a sphere in the axes of a body, for pictures only: no mass follows from it.

    A `box` has three sides, a `cylinder` its radius and length, a `sphere` its radius (m). The middle is
    `at` (3,), from the origin of the body (m); `axis` (3,) is that of the cylinder, or the third one of
    the box, z by default.
    """

    noun: ClassVar[str] = "shape"

    box: Direction | None = None
    cylinder: Many[Number] | None = None
    sphere: Number | None = None
    at: Direction = (0.0, 0.0, 0.0)
    axis: Axis = (0.0, 0.0, 1.0)

    @model_validator(mode="after")
    def _is_one_of_positive_size(self) -> Self:
        given = [kind for kind in _KINDS if getattr(self, kind) is not None]
        if len(given) != 1:
            raise SceneError(
                f"expected one of {', '.join(_KINDS)}, got {' and '.join(given) or 'none'}. Write, for "
                "example, shape = { box = [1.0, 0.5, 0.2] }."
            )
        size = getattr(self, given[0])
        if given == ["cylinder"] and len(size) != 2:
            raise SceneError(f"cylinder: expected a radius and a length (m), got {list(size)}.")
        if min(size if isinstance(size, tuple) else (size,)) <= 0.0:
            raise SceneError(f"{given[0]}: expected sizes above zero (m), got {size}.")
        return self
