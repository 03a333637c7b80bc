"""What lies on the belt, item by item: a family's draw, kept where the rig can see it."""

from __future__ import annotations

from dataclasses import dataclass

from roemetry_simulate.families import family_of, options_of
from roemetry_simulate.group import lying_together
from roemetry_simulate.placing import check_in_view, in_reach
from roemetry_simulate.products import Drawn
from roemetry_simulate.render import Rig
from roemetry_simulate.scene_file import ProductPart
from roemetry_simulate.side_by_side import side_by_side
from roemetry_simulate.solid import EmptyBelt, Solid

_NEXT_IN_FRAME = 1_000_000_000
"""From the seed of a frame's product to that of its next, so that no other item's first has it."""


@dataclass(frozen=True, slots=True)
class Lying:
    """One item's products.

    Attributes
    ----------
    seed : int
        What the first was drawn from.
    products : tuple of Drawn
        From left to right; empty for an empty belt.
    """

    seed: int
    products: tuple[Drawn, ...]

    @property
    def solid(self) -> Solid:
        """All of them as one solid."""
        return lying_together([one.solid for one in self.products]) if self.products else EmptyBelt()


def product_of(part: ProductPart, rig: Rig, number: int, seed: int) -> Lying:
    """Draw the products of an item.

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
        A product is larger than the view, or there is no room for so many.
    """
    family = family_of(part.family)
    chosen = part.items[number] if number < len(part.items) else None
    item_seed = seed + number - len(part.items) if chosen is None else chosen.seed
    if family is None:
        return Lying(item_seed, ())
    options = options_of(part.family, part.options | ({} if chosen is None else chosen.options))
    name = f"item {number + 1}, {part.family} of seed {item_seed}"
    if part.in_frame > 1:
        drawn = [family.draw(item_seed + _NEXT_IN_FRAME * k, options) for k in range(part.in_frame)]
        laid = side_by_side(
            drawn,
            rig,
            gap_mm=part.gap_mm,
            most_overhang_spacings=part.most_overhang_spacings,
            seed=item_seed,
            name=name,
        )
        return Lying(item_seed, laid)
    one = family.draw(item_seed, options)
    if part.keep_in_reach:
        one = in_reach(one, rig, part.most_overhang_spacings)
    check_in_view(one, rig, name)
    return Lying(item_seed, (one,))
