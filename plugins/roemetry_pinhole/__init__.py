"""Full calibration of camera, lens, planes of light and belt, and triangulation with it."""

from __future__ import annotations

from collections.abc import Iterable

from roemetry.stages.hookspecs import StageEntry, hookimpl

_STAGES = (
    ("calibrator", "pinhole-plane", "calibrator:PinholeCalibrator",
     "Camera, lens, planes of light and belt from a board in many poses, adjusted together",
     "Zhang (2000), IEEE TPAMI 22:1330; Triggs et al. (2000), LNCS 1883:298; refusals are ours"),
    ("triangulator", "pinhole-plane", "pinhole_plane:PinholePlane",
     "Each peak's undistorted ray meets its stripe's plane of light",
     "Hartley and Zisserman (2004), chapters 6 and 7; the lens model is OpenCV's"),
    ("calibrator", "pinhole-dots", "dot_calibrator:PinholeDotsCalibrator",
     "Camera, lens, a ray of light for each dot, and belt from a board in many poses",
     "As pinhole-plane; rays eliminated as in Triggs et al. (2000); numbering is ours"),
    ("triangulator", "pinhole-dots", "dot_rays:PinholeDots",
     "Each dot's place on its ray, by the covariances of both",
     "Hartley and Zisserman (2004), chapter 12, with one ray known"),
    ("calibrator", "pinhole-grid", "grid:PinholeGridCalibrator",
     "Camera, lens, the planes of both families of a grid, and belt from a board in many poses",
     "As pinhole-plane; families joined by conditional expectation, Rao (1973), 8a.2"),
    ("triangulator", "pinhole-grid", "grid:PinholeGrid",
     "Each peak's undistorted ray meets its line's plane of light, of either family",
     "Hartley and Zisserman (2004), chapters 6 and 7"),
    ("calibrator", "pinhole-two-families", "two_families:PinholeTwoFamiliesCalibrator",
     "Camera, lens, planes of lines of two colours in turn, and belt from a board in many poses",
     "As pinhole-plane; families joined by conditional expectation, Rao (1973), 8a.2"),
    ("calibrator", "pinhole-circles", "circle_calibrator:PinholeCirclesCalibrator",
     "Camera, lens, concentric cones of light, and belt from a board in many poses",
     "As pinhole-plane; cones joined to the marks' adjustment, Triggs et al. (2000)"),
    ("triangulator", "pinhole-circles", "cones:PinholeCircles",
     "Each peak's undistorted ray meets its half circle's cone of light",
     "Hartley and Zisserman (2004), chapter 6; the quadratic is ours"),
)  # fmt: skip


@hookimpl
def roemetry_stages() -> Iterable[StageEntry]:
    """Name the stages."""
    for kind, name, target, summary, reference in _STAGES:
        yield StageEntry(kind, name, f"{__name__}.{target}", summary, reference)
