"""What is computed of a finished model: all names of `mbdlft.response` and `mbdlft.robust`."""

from typing import TYPE_CHECKING, Any

from mbdlft import response, robust

if TYPE_CHECKING:
    from mbdlft.response import *
    from mbdlft.robust import *

__all__: list[str] = sorted([*vars(response)["__all__"], *vars(robust)["__all__"]])


def __getattr__(name: str) -> Any:
    for room in (response, robust):
        if name in vars(room)["__all__"]:
            return getattr(room, name)
    raise AttributeError(f"module 'mbdlft.analyze' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
