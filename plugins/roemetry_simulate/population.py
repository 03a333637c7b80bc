"""What lies on the belt, item by item: a family's draw, kept where the rig can see it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError

from roemetry.validation import unknown_key
from roemetry_simulate.placing import check_in_view, in_reach
from roemetry_simulate.products import PRODUCTS, Drawn, ProductFamily, ProductOptions
from roemetry_simulate.render import Rig
from roemetry_simulate.scene_file import ProductPart

NONE = "none"


@dataclass(frozen=True, slots=True)
class Lying:
    """One item's product.

    Attributes
    ----------
    seed : int
        What it was drawn from.
    drawn : Drawn or None
        The product; None for an empty belt.
    """

    seed: int
    drawn: Drawn | None


def family_of(name: str) -> ProductFamily | None:
    """Return a family by name, None for `none`; raise ValueError with a close match for an unknown one."""
    import difflib

    if name == NONE:
        return None
    if name not in PRODUCTS:
        close = difflib.get_close_matches(name, PRODUCTS, n=1)
        mean = f"; did you mean `{close[0]}`?" if close else ""
        raise ValueError(f"there is no product family `{name}`{mean} There are: none, {', '.join(PRODUCTS)}")
    return PRODUCTS[name]


def options_of(name: str, options: Mapping[str, Any]) -> ProductOptions | None:
    """Check a family's options; raise ValueError with every fault."""
    family = family_of(name)
    if family is None:
        if options:
            raise ValueError("family `none` has no options")
        return None
    try:
        return family.Options.model_validate(dict(options))
    except ValidationError as error:
        said = []
        for detail in error.errors():
            at = ".".join(map(str, ("options", *detail["loc"])))
            if detail["type"] == "extra_forbidden":
                said.append(f"{at}: {unknown_key(detail['loc'][-1], list(family.Options.model_fields))}")
            else:
                said.append(f"{at}: {detail['msg'][0].lower()}{detail['msg'][1:]}, found {detail['input']!r}")
        raise ValueError("; ".join(said)) from None


def product_of(part: ProductPart, rig: Rig, number: int, seed: int) -> Lying:
    """Draw the product of an item.

    Parameters
    ----------
    part : ProductPart
        The scene's product.
    rig : Rig
        Where it must be seen.
    number : int
        The item's, from 0.
    seed : int
        The set's; items count up from it.

    Raises
    ------
    StageError
        The product is larger than the view.
    """
    family = family_of(part.family)
    chosen = part.items[number] if number < len(part.items) else None
    item_seed = seed + number - len(part.items) if chosen is None else chosen.seed
    if family is None:
        return Lying(item_seed, None)
    options = options_of(part.family, part.options | ({} if chosen is None else chosen.options))
    drawn = family.draw(item_seed, options)
    if part.keep_in_reach:
        drawn = in_reach(drawn, rig, part.most_overhang_spacings)
    check_in_view(drawn, rig, f"item {number + 1}, {part.family} of seed {item_seed}")
    return Lying(item_seed, drawn)
