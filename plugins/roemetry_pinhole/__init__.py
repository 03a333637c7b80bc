"""Full calibration of camera, lens, planes of light and belt, and triangulation with it."""

from __future__ import annotations

from collections.abc import Iterable

from roemetry.stages.hookspecs import StageEntry, hookimpl


@hookimpl
def roemetry_stages() -> Iterable[StageEntry]:
    """Name the stages."""
    yield StageEntry(
        kind="calibrator",
        name="pinhole-plane",
        target="roemetry_pinhole.calibrator:PinholeCalibrator",
        summary="Camera, lens, planes of light and belt from a board in many poses, adjusted together",
        reference="Zhang (2000), IEEE TPAMI 22:1330; Triggs et al. (2000), LNCS 1883:298; refusals are ours",
    )
    yield StageEntry(
        kind="triangulator",
        name="pinhole-plane",
        target="roemetry_pinhole.pinhole_plane:PinholePlane",
        summary="Each peak's undistorted ray meets its stripe's plane of light",
        reference="Hartley and Zisserman (2004), chapters 6 and 7; the lens model is OpenCV's",
    )
    yield StageEntry(
        kind="calibrator",
        name="pinhole-dots",
        target="roemetry_pinhole.dot_calibrator:PinholeDotsCalibrator",
        summary="Camera, lens, a ray of light for each dot, and belt from a board in many poses",
        reference="As pinhole-plane; rays eliminated as in Triggs et al. (2000); numbering is ours",
    )
    yield StageEntry(
        kind="triangulator",
        name="pinhole-dots",
        target="roemetry_pinhole.dot_rays:PinholeDots",
        summary="Each dot's place on its ray, by the covariances of both",
        reference="Hartley and Zisserman (2004), chapter 12, with one ray known",
    )
    yield StageEntry(
        kind="calibrator",
        name="pinhole-grid",
        target="roemetry_pinhole.grid_calibrator:PinholeGridCalibrator",
        summary="Camera, lens, the planes of both families of a grid, and belt from a board in many poses",
        reference="As pinhole-plane; families joined by conditional expectation, Rao (1973), 8a.2",
    )
    yield StageEntry(
        kind="triangulator",
        name="pinhole-grid",
        target="roemetry_pinhole.grid_planes:PinholeGrid",
        summary="Each peak's undistorted ray meets its line's plane of light, of either family",
        reference="Hartley and Zisserman (2004), chapters 6 and 7",
    )
