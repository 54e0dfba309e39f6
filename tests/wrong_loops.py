"""Planted bugs of loop closures, for comparisons that have to find them."""

from importlib import import_module

import casadi as ca
import pytest

from mbdlft.multibody.assembly.closure import constraint

assembling = import_module("mbdlft.multibody.assembly.newton_euler")
efforts = import_module("mbdlft.multibody.assembly.signals")


def closures_at_rest(patch: pytest.MonkeyPatch) -> None:
    """The generalized forces of the closures are those at rest: no geometric stiffness."""
    original, kept = assembling._dynamics, []

    def no_wrenches(loops, view, multipliers):
        kept[:] = [(loops, multipliers)]
        return []

    def wrong(links, symbols, values, view, u):
        loops, multipliers = kept[0]
        at_rest = ca.jacobian(constraint(loops, view, 0), symbols.q)
        return original(links, symbols, values, view, u) - at_rest.T @ multipliers

    patch.setattr(efforts, "reactions", no_wrenches)
    patch.setattr(assembling, "_dynamics", wrong)


def closures_on_one_body(patch: pytest.MonkeyPatch) -> None:
    """A closure has no reaction on its other body."""
    original = efforts.reactions
    patch.setattr(efforts, "reactions", lambda *arguments: original(*arguments)[::2])
