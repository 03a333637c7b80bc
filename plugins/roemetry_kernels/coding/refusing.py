"""What coders cannot work with, said in the same words by all of them."""

from __future__ import annotations

from roemetry.errors import StageError
from roemetry.records import Peaks
from roemetry.records.calibration import Calibration


def refuse_uncodable(peaks: Peaks, calibration: Calibration | None) -> None:
    """Raise StageError where there is no peak, or the peaks are of another image size than calibrated."""
    if not len(peaks):
        raise StageError(
            "no stripe was found in the image",
            hint="is the laser on? lower the extractor's threshold, or look at the image",
        )
    if calibration is not None and peaks.image_size != calibration.image_size:
        raise StageError(
            f"the peaks are of an image of {peaks.image_size[0]} rows and {peaks.image_size[1]} columns, "
            f"the calibration of {calibration.image_size[0]} and {calibration.image_size[1]}",
            hint="calibrate this camera, or use the region of interest it was calibrated with",
        )


def required_calibration(calibration: Calibration | None, coder: str, why: str) -> Calibration:
    """Give the calibration; raise StageError where there is none, with the reason why this coder needs it."""
    if calibration is None:
        raise StageError(
            f"the coder `{coder}` needs a calibration: {why}",
            hint="calibrate, or use the coder `window-tracking`",
        )
    return calibration


def refuse_bare_lines(seen: bool, stripes: int) -> None:
    """Raise StageError unless a stripe was seen on one of so many rest lines."""
    if not seen:
        raise StageError(
            f"no stripe lies where the {stripes} rest lines are",
            hint="camera or laser may have been moved: calibrate again, or remove what covers the belt",
        )
