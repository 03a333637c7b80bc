"""The simulator's products: populations of foods, reference artefacts, and the user's own meshes.

`PRODUCTS` holds every family by name. A family draws a product from a seed and its options; the product is a
solid on the belt with its truth, and with its reference, the same product without its defect.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from roemetry_simulate.products.artefacts import ARTEFACTS
from roemetry_simulate.products.bread_roll import BREAD_ROLL
from roemetry_simulate.products.egg import EGG
from roemetry_simulate.products.family import Drawn, ProductFamily, ProductOptions
from roemetry_simulate.products.fillet import FILLET
from roemetry_simulate.products.herring import HERRING_ROE
from roemetry_simulate.products.mesh import MESH_FAMILY
from roemetry_simulate.products.potato import POTATO

PRODUCTS: Mapping[str, ProductFamily] = MappingProxyType(
    {
        family.name: family
        for family in (HERRING_ROE, POTATO, FILLET, BREAD_ROLL, EGG, *ARTEFACTS, MESH_FAMILY)
    }
)
"""Every family, by name."""

__all__ = ["PRODUCTS", "Drawn", "ProductFamily", "ProductOptions"]
