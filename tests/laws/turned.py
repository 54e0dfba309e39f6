"""The inward pass as it is in the books: a displaced joint turns the forces that pass it."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from unittest.mock import patch

import casadi as ca

from mbdlft.scene.placed import Motions, Passed, Placed, pass_inward


@contextmanager
def forces_turned_on_the_way() -> Iterator[None]:
    """Scenes are assembled with it, also where weights could be felt in the axes of each lever."""
    assembled = patch.object(import_module("mbdlft.scene.assemble"), "pass_weights_inward", _pass)
    with assembled, one_order_only():
        yield


@contextmanager
def one_order_only() -> Iterator[None]:
    """Scenes are assembled once, with the weights in one order of products."""
    none = patch.object(import_module("mbdlft.build"), "assemble_by_products", lambda scene: None)
    with none:
        yield


def _pass(
    placed: Placed,
    found: Motions,
    inertial: Mapping[str, ca.SX],
    loads: Mapping[str, ca.SX],
    load: ca.SX,
) -> Passed:
    return pass_inward(placed, found, {name: inertial[name] + loads[name] for name in inertial})
