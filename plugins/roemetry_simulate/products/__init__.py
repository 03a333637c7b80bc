"""The simulator's products: populations of foods, reference artefacts, and the user's own meshes.

`PRODUCTS` holds every family by name. A family draws a product from a seed and its options; the product is a
solid on the belt with its truth, and with its reference, the same product without its defect.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from roemetry_simulate.products.artefacts import ARTEFACTS
from roemetry_simulate.products.family import Drawn, ProductFamily, ProductOptions
from roemetry_simulate.products.foods import FOODS
from roemetry_simulate.products.herring import HERRING_ROE
from roemetry_simulate.products.mesh import MESH_FAMILY

PRODUCTS: Mapping[str, ProductFamily] = MappingProxyType(
    {family.name: family for family in (HERRING_ROE, *FOODS, *ARTEFACTS, MESH_FAMILY)}
)
"""Every family, by name."""

MODELS = MappingProxyType({name: family.Options for name, family in PRODUCTS.items()})
"""The options of every family."""

__all__ = ["MODELS", "PRODUCTS", "Drawn", "ProductFamily", "ProductOptions"]
