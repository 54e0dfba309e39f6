"""Texts and names of other languages, and the places of signals in the arrays that they exchange.

The texts are templates in `assets`: what stands in ``<< >>`` is filled in, and lines with ``<% %>`` say
what only some models have.

Names are identifiers of ASCII letters, digits and underscores.

Greek letters are written out, accents are dropped, dots and blanks become underscores, and what is left
is written as its code, so that ``θ₁`` is ``theta1`` and ``日`` is ``u65E5``.
"""

import re
import unicodedata
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from mbdlft.base.errors import StructureError
from mbdlft.system.model import System
from mbdlft.system.theta import ONE, DeltaThetaModel, allowed_range

_LONGEST = 50  # MATLAB tells names apart by their first 63 letters, and endings are added
_WORDS = """
break case catch classdef continue do else elseif end end_try_catch end_unwind_protect endfor endfunction
endif endparfor endswitch endwhile for function global if otherwise parfor persistent return spmd switch
try until unwind_protect unwind_protect_cleanup while
"""
# of MATLAB and Octave; in C every name has that of the model before it
RESERVED = frozenset(_WORDS.split())


def filled(template: str, entries: Mapping[str, Any]) -> str:
    """The text of a template of `assets` with these entries."""
    import jinja2  # here because it is slow to import

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent / "assets"),
        undefined=jinja2.StrictUndefined,
        variable_start_string="<<",
        variable_end_string=">>",
        block_start_string="<%",
        block_end_string="%>",
        trim_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template(template).render(entries)


def identifier(name: str) -> str:
    """An identifier of C, MATLAB, Octave and Julia for a name."""
    text = "".join(_letter(letter) for letter in unicodedata.normalize("NFKD", name))
    text = re.sub("_{2,}", "_", text)[:_LONGEST].rstrip("_")
    if not text or not text[0].isalpha():
        text = f"x{text}"
    return f"{text}_" if text in RESERVED else text


def prefix(name: str) -> str:
    """What names of C begin with for a model: no word is reserved with more behind it."""
    return identifier(name).rstrip("_")


def _letter(letter: str) -> str:
    """ASCII for one letter."""
    if letter.isascii():
        return letter if letter.isalnum() else "_"
    if unicodedata.combining(letter):
        return ""
    words = unicodedata.name(letter, "").split()
    if words[:1] == ["GREEK"] and "LETTER" in words:
        greek = words[words.index("LETTER") + 1].lower()
        return greek.capitalize() if "CAPITAL" in words else greek
    return f"u{ord(letter):04X}"


def identifiers(names: Sequence[str], where: str) -> dict[str, str]:
    """Identifiers by name, all different; `where` says in a message what they are names of."""
    by_name = {name: identifier(name) for name in names}
    check_different(by_name, where)
    return by_name


def check_different(identifiers: Mapping[str, str], where: str) -> None:
    """Raise a StructureError if two of the names have one identifier."""
    first: dict[str, str] = {}
    for name, text in identifiers.items():
        if text in first:
            raise StructureError(
                f"{where}: the names {first[text]!r} and {name!r} clash: both become {text!r}, as names "
                "there are ASCII letters, digits and underscores. Rename one of them."
            )
        first[text] = name


def one_line(text: str) -> str:
    """A text on one line, without anything that could end a comment of C."""
    line = "".join(c if c.isprintable() else " " for c in text)
    return line.replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?").rstrip("\\ ")


def check_plain_model(model: System, what: str) -> None:
    """Raise an error unless all blocks of a model are real parameters, and all entries real."""
    others = [f"{b.name} ({b.kind})" for b in model.lft.blocks if b.kind != "real"]
    if others:
        raise StructureError(
            f"model {model.name!r}: {what} has no blocks of dynamics of which only a bound is known: "
            f"{', '.join(others)}. Export it as .mat, which carries them, or leave them out of the model."
        )
    if model.lft.is_complex:
        raise StructureError(
            f"model {model.name!r}: {what} has real matrices only, and entries of its matrices are "
            "complex. Export it as .mat."
        )


class Places(NamedTuple):
    """Numbers, from 0 on, of inputs and outputs of the linear part."""

    u: list[int]
    one: list[int]  # empty without the constant 1
    zeta: list[int]
    y: list[int]
    omega: list[int]
    low: list[float]  # of omega, where all functions may be evaluated, with what rounding may add
    high: list[float]


def places_of(model: DeltaThetaModel, what: str) -> Places:
    """Where signals are."""
    if not model.functions:
        raise StructureError(
            f"model {model.name!r}: {what}: it has no nonlinear functions. Export model.linear."
        )
    inputs = [s.name for s in model.linear.inputs]
    outputs = [s.name for s in model.linear.outputs]
    omega = list(model.omega)
    low, high = [-float("inf")] * len(omega), [float("inf")] * len(omega)
    for f in model.functions:
        for name, ends in zip(f.signals, f.ranges, strict=True):
            k, (least, most) = omega.index(name), allowed_range(*ends)
            low[k], high[k] = max(low[k], least), min(high[k], most)
    return Places(
        [inputs.index(s.name) for s in model.inputs],
        [inputs.index(ONE)] if model.has_one else [],
        [inputs.index(name) for name in model.zeta],
        [outputs.index(s.name) for s in model.outputs],
        [outputs.index(name) for name in omega],
        low,
        high,
    )


def listed(model: DeltaThetaModel, begin: str) -> str:
    """Lines of a comment: states, u, y, and each function with the signals that it is of."""
    lines = []
    for what, signals in (("x", model.linear.states), ("u", model.inputs), ("y", model.outputs)):
        lines.append(f"{what}: {', '.join(f'{s.name} ({s.unit})' for s in signals) or 'none'}")
    lines.append(f"omega: {', '.join(model.omega)}")
    for f in model.functions:
        pairs = zip(f.arguments, f.signals, strict=True)
        lines.append(f"{f}, {', '.join(f'{a} = {s}' for a, s in pairs)}")
    return "\n".join(f"{begin}{one_line(line)}" for line in lines)
