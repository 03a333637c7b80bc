"""Calibrated slices through the scene."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from roemetry.records.arrays import Checker, Flags, Floats, Integers, Labels
from roemetry.records.display import Shown
from roemetry.records.reasons import Reason
from roemetry.records.scan import ScanFigures


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class Profiles(Shown):
    """Slices in the belt frame. Not assumed: that slices are in order, parallel, or share their points' Y."""

    xyz_mm: Floats
    """(slice, point, 3) position in the belt frame, mm: X along image x, Y towards the image's top, Z up. NaN
    where nothing is known."""
    product: Labels
    """(slice, point) 0 belt, 1…n product, −1 nothing."""
    seen: Flags
    """(slice, point) False where the point was bridged or is NaN."""
    x_px: Floats
    row_px: Floats
    """x_px, row_px: (slice, point) where in the (turned) image the point was seen, px."""
    height_std_mm: Floats
    """(slice, point) random part of the standard uncertainty of Z, mm; NaN where it is not modelled. What the
    calibration contributes is common to all points and is not in here."""
    stripe: Integers
    frame: Integers
    """stripe, frame: (slice,) stripe index and index of the frame in the acquisition that the slice came
    from."""
    plane: Floats
    """(slice, 4) the slice's plane in the belt frame: nx, ny, nz, d with n·X = d (mm), n of length 1."""
    reasons: tuple[Reason, ...] = ()
    scan: ScanFigures | None = None
    """What placing the lines came to, where the slices are lines of a scan."""
    rim_mm: Floats = field(default_factory=lambda: np.empty(0))
    """(product + 1,) height, by the product's number, at which flanks end that bulge over the belt; NaN where
    it is not known. Empty: nobody has looked for it."""
    rim_mm3: Floats = field(default_factory=lambda: np.empty(0))
    """(product + 1,) by the product's number, standard deviation of its volume by the rim's height. Empty:
    nobody has looked for it."""
    unseen_margin_mm3: Floats = field(default_factory=lambda: np.empty(0))
    """(product + 1,) by the product's number, how much larger it is if what is not seen between its slices'
    ends and the belt beside them is as high as these. Empty: nobody has looked for it."""
    flank_rel_std: Floats = field(default_factory=lambda: np.empty(0))
    """(product + 1,) by the product's number, relative standard uncertainty of what was followed of its
    flanks, as the side tells that is seen; NaN where that tells nothing. Empty: nobody has looked for it."""

    def __post_init__(self) -> None:
        check = Checker(self)
        xyz = check.array("xyz_mm", np.float64, (None, None, 3))
        slices, points = xyz.shape[:2] if xyz.ndim == 3 else (0, 0)
        check.array("product", np.int16, (slices, points))
        check.array("seen", np.bool_, (slices, points))
        for name in ("x_px", "row_px", "height_std_mm"):
            check.array(name, np.float64, (slices, points))
        for name in ("stripe", "frame"):
            check.array(name, np.int64, (slices,))
        check.array("rim_mm3", np.float64, (None,))
        check.array("unseen_margin_mm3", np.float64, (None,))
        check.array("flank_rel_std", np.float64, (None,))
        check.array("rim_mm", np.float64, (None,))
        plane = check.array("plane", np.float64, (slices, 4))
        if plane.shape == (slices, 4) and slices:
            length = np.sqrt((plane[:, :3] ** 2).sum(axis=1))
            check.require(bool(np.abs(length - 1.0).max() < 1e-6), "plane normals are not of length 1")
        check.finish()

    @property
    def slice_count(self) -> int:
        """Number of slices."""
        return int(self.xyz_mm.shape[0])
