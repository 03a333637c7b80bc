"""Skeins measured without a rendered image: rays are traced, peaks drawn, then labelled and triangulated.

What the light planes meet is exact; each peak has noise, faint ones are lost, neighbours merge, and the coder
must find the stripes' numbers: all that stands between a product and its grade but the image itself. A skein
takes about half a second, where a rendered image takes some seconds of two cores.
"""

from benchmarks.traced.skeins import RIGS, Traced, traced
from benchmarks.traced.tables import Row, rows_of

__all__ = ["RIGS", "Row", "Traced", "rows_of", "traced"]
