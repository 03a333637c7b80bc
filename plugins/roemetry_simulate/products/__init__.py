"""The simulator's products: populations of foods, reference artefacts, and the user's own meshes.

`PRODUCTS` holds every family by name. A family draws a product from a seed and its options; the product is a
solid on the belt with its truth, and with its reference, the same product without its defect.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from pydantic import ValidationError

from roemetry.config.validation import unknown_key
from roemetry.errors import MisfitError
from roemetry_simulate.products.artefacts import ARTEFACTS
from roemetry_simulate.products.family import Drawn, ProductFamily, ProductOptions
from roemetry_simulate.products.foods import FOODS
from roemetry_simulate.products.herring import HERRING_ROE
from roemetry_simulate.products.mesh import MESH_FAMILY

PRODUCTS: Mapping[str, ProductFamily] = MappingProxyType(
    {family.name: family for family in (HERRING_ROE, *FOODS, *ARTEFACTS, MESH_FAMILY)}
)
"""Every family, by name."""

NONE = "none"
"""The family of an empty belt."""

__all__ = ["NONE", "PRODUCTS", "Drawn", "ProductFamily", "ProductOptions", "family_of", "options_of"]


def family_of(name: str) -> ProductFamily | None:
    """Return a family by name, None for `none`; raise ValueError with a close match for an unknown one."""
    if name == NONE:
        return None
    if name not in PRODUCTS:
        close = difflib.get_close_matches(name, PRODUCTS, n=1)
        mean = f"; did you mean `{close[0]}`?" if close else ""
        raise ValueError(f"there is no product family `{name}`{mean} There are: none, {', '.join(PRODUCTS)}")
    return PRODUCTS[name]


def options_of(
    name: str, options: Mapping[str, Any], at: tuple[str | int, ...] = ("options",)
) -> ProductOptions | None:
    """Check a family's options, which stand at some keys; raise MisfitError with every fault."""
    try:
        family = family_of(name)
    except ValueError as error:
        raise MisfitError((("family",), str(error))) from None
    if family is None:
        if options:
            raise MisfitError((at, "family `none` has no options"))
        return None
    try:
        return family.Options.model_validate(dict(options))
    except ValidationError as error:
        said = []
        for detail in error.errors():
            if detail["type"] == "extra_forbidden":
                why = unknown_key(detail["loc"][-1], list(family.Options.model_fields))
            else:
                why = f"{detail['msg'][0].lower()}{detail['msg'][1:]}".removeprefix("value error, ")
            said.append(((*at, *detail["loc"]), why))
        raise MisfitError(*said) from None
