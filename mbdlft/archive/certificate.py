"""Certificates as items of a file, and what each of their numbers rests on."""

import itertools
import math
from typing import Any

import numpy as np

from mbdlft.archive.items import Items, floats, integers, texts, word, words
from mbdlft.archive.items import text as text_item
from mbdlft.base.errors import ArchiveError
from mbdlft.system.model import Certificate

PROVED, CHECKED, OPEN = "proved", "checked", "open"
_PLACES = ("order", "lower_bound", "raw_order")
_ERRORS = (
    "max_relative_error",
    "truncation_error",
    "fit_error_bound",
    "condition",
    "transfer_error",
)
_COUNTS = ("check_points", "seed", "sign_changes")


def rests_on(certificate: Certificate) -> dict[str, str]:
    """What each number of a certificate rests on.

    Returns
    -------
    dict of names to "proved" (a theorem, in exact or outward-rounded arithmetic), "checked" (computed in
    floating point, or compared at points) or "open" (nothing is known)
    """
    c = certificate
    found = {
        "lower_bound": PROVED if c.exact_bound else CHECKED,
        "max_relative_error": CHECKED,
        "well_posed": PROVED if c.well_posed == PROVED else OPEN if c.open_boxes else CHECKED,
    }
    if c.truncation_error > 0.0:
        found["truncation_error"] = OPEN if math.isinf(c.truncation_error) else PROVED
    if c.fit_error_bound > 0.0:
        found["fit_error_bound"] = PROVED
    if c.condition > 0.0:
        found["condition"] = CHECKED
    if c.frequencies:
        found["transfer_error"] = CHECKED
    return dict(sorted(found.items()))


def items_of_certificate(certificate: Certificate) -> Items:
    """The items of a certificate, their paths below the group ``certificate``."""
    c = certificate
    items: Items = {name: np.array(getattr(c, name), dtype="<i8") for name in _PLACES}
    if c.doubtful:
        items["doubtful"] = np.array(c.doubtful, dtype="<i8")
    if c.open_boxes:
        items["open"] = np.array(c.open_boxes, dtype="<f8").reshape(
            len(c.open_boxes), len(c.order), 2
        )
    basis = rests_on(c)
    items["evidence/number"] = texts(list(basis))
    items["evidence/basis"] = texts(list(basis.values()))
    items["@max_relative_error"] = np.array(c.max_relative_error, dtype="<f8")
    items["@check_points"] = np.array(c.check_points, dtype="<i8")
    items["@seed"] = np.array(c.seed, dtype="<i8")
    items["@exact"] = np.array(c.exact, dtype=bool)
    items["@truncation_error"] = np.array(c.truncation_error, dtype="<f8")
    items["@well_posed"] = text_item(c.well_posed)
    if c.exact_bound:
        items["@exact_bound"] = np.array(True)  # noqa: FBT003
    if c.fit_error_bound > 0.0:
        items["@fit_error_bound"] = np.array(c.fit_error_bound, dtype="<f8")
    if c.order_bound > sum(c.lower_bound):
        items["@order_bound"] = np.array(c.order_bound, dtype="<i8")
    if c.condition > 0.0:
        items["@condition"] = np.array(c.condition, dtype="<f8")
        items["@sign_changes"] = np.array(c.sign_changes, dtype="<i8")
    if c.frequencies:
        items["@transfer_error"] = np.array(c.transfer_error, dtype="<f8")
        items["frequencies"] = np.array(c.frequencies, dtype="<f8")
    if c.by_terms:
        items["by_terms"] = np.array(c.by_terms, dtype="<i8")
    if c.near:
        items["near"] = texts(list(c.near))
    return items


def certificate_of(items: Items, sizes: tuple[int, ...]) -> Certificate:
    """The certificate of items whose paths begin with ``certificate``.

    `sizes` are the repetitions of the parameters in the model.

    Raises
    ------
    ArchiveError
        An attribute is missing that others need, or values do not agree.
    """
    names = [name for name in (*_ERRORS, *_COUNTS, "exact", "exact_bound", "order_bound")]
    given = {
        name: items[f"certificate@{name}"].item()
        for name in names
        if f"certificate@{name}" in items
    }
    if ("condition" in given) != ("sign_changes" in given):
        raise ArchiveError(
            "is not whole: 'condition' and 'sign_changes' of 'certificate': one is missing."
        )
    has_frequencies = "certificate/frequencies" in items
    if ("transfer_error" in given) != has_frequencies:
        absent = ("'certificate/frequencies'", "'transfer_error' of 'certificate'")
        raise ArchiveError(f"is not whole: {absent[has_frequencies]} is missing.")
    if not given["exact"] and "truncation_error" not in given:
        # the first files do not have it; what is in them is exact
        raise ArchiveError(
            "is not whole: the attribute 'truncation_error' of 'certificate' is missing."
        )
    places: dict[str, Any] = {name: integers(items, f"certificate/{name}") for name in _PLACES}
    doubtful = integers(items, "certificate/doubtful") if "certificate/doubtful" in items else ()
    boxes = floats(items, "certificate/open").tolist() if "certificate/open" in items else []
    by_frequency = floats(items, "certificate/frequencies") if "transfer_error" in given else None
    by_terms = items["certificate/by_terms"].tolist() if "certificate/by_terms" in items else []
    made = Certificate(
        **places,
        **given,
        doubtful=doubtful,
        well_posed=word(items, "certificate@well_posed", "sampled"),
        open_boxes=tuple(tuple((low, high) for low, high in box) for box in boxes),
        frequencies=() if by_frequency is None else tuple(by_frequency.tolist()),
        near=tuple(words(items, "certificate/near")) if "certificate/near" in items else (),
        by_terms=tuple((row, column) for row, column in by_terms),
    )
    _check(made, sizes)
    if "certificate/evidence/number" in items:
        stated = words(items, "certificate/evidence/number")
        basis = words(items, "certificate/evidence/basis")
        if len(set(stated)) != len(stated) or set(basis) - {PROVED, CHECKED, OPEN}:
            raise ArchiveError(
                "certificate/evidence: expected proved, checked or open for each number once."
            )
    return made


def _check(c: Certificate, sizes: tuple[int, ...]) -> None:
    """Raise an ArchiveError unless the values of a certificate can be true."""

    def needs(condition: bool, what: str) -> None:  # noqa: FBT001
        if not condition:
            raise ArchiveError(f"certificate: {what}.")

    needs(c.order == sizes, f"order is {c.order}, and the blocks of Delta have {sizes}")
    for name in (*_PLACES, "doubtful"):
        needs(min(getattr(c, name), default=0) >= 0, f"{name} has a negative number")
    for name in _COUNTS:
        needs(getattr(c, name) >= 0, f"{name} is {getattr(c, name)}, expected at least 0")
    for name in _ERRORS:
        value = getattr(c, name)
        needs(value >= 0.0, f"{name} is {value}, expected at least 0")
    for name in ("max_relative_error", "fit_error_bound", "transfer_error"):
        needs(math.isfinite(getattr(c, name)), f"{name} is {getattr(c, name)}, expected a number")
    if c.exact:
        above = [(a, b) for a, b in zip(c.lower_bound, c.order, strict=True) if a > b]
        needs(
            not above and c.order_bound <= sum(c.order),
            f"the lower bound {c.lower_bound}, together {c.order_bound}, is more than the order "
            f"{c.order} of a model that is exact",
        )
        needs(
            c.truncation_error == 0.0 == c.fit_error_bound,
            "exact is true, and there is an error of truncation or of a fit",
        )
    needs(
        c.well_posed in (PROVED, "sampled"),
        f"well_posed is {c.well_posed!r}, expected 'proved' or 'sampled'",
    )
    needs(not (c.well_posed == PROVED and c.open_boxes), "well_posed is 'proved', with open boxes")
    ends = (0.0, *c.frequencies, math.inf)
    needs(
        all(a < b for a, b in itertools.pairwise(ends)),
        f"frequencies are {c.frequencies}, expected larger and larger ones",
    )
    needs(
        all(row >= 0 and column >= 0 for row, column in c.by_terms),
        "by_terms has a negative number",
    )
    needs(
        all(low <= high for box in c.open_boxes for low, high in box),
        "an open box has a lower end above its upper end, or none",
    )
