"""The stages of Lee, de Silva, Croft and Wu (2000), and what they compared against: the defaults."""

from __future__ import annotations

from collections.abc import Iterable

from roemetry.stages.hookspecs import StageEntry, hookimpl

_PAPER = "Lee, de Silva, Croft, Wu (2000), Machine Vision and Applications 12:177–188"


@hookimpl
def roemetry_stages() -> Iterable[StageEntry]:
    """Name the paper's stages, in the order of the chain."""
    yield StageEntry(
        kind="extractor",
        name="dominant-peak",
        target="roemetry_paper.dominant_peak:DominantPeak",
        summary="Whole-pixel peaks that rise above the valleys on both sides by a threshold",
        reference=f"{_PAPER}, section 3.2",
    )
    yield StageEntry(
        kind="coder",
        name="window-tracking",
        target="roemetry_paper.window_tracking:WindowTracking",
        summary="Follows stripes with small windows from belt to body, numbers them by order, refuses doubt",
        reference=f"{_PAPER}, section 3.3; rest lines and refusal are ours",
    )
    yield StageEntry(
        kind="calibrator",
        name="block-linear",
        target="roemetry_paper.block_calibrator:BlockCalibrator",
        summary="One block of known height gives each stripe's height per pixel, and the scale",
        reference=f"{_PAPER}, section 3.4; the scale is ours",
    )
    yield StageEntry(
        kind="triangulator",
        name="block-linear",
        target="roemetry_paper.block_linear:BlockLinear",
        summary="Height is proportional to a stripe's displacement from its rest line",
        reference=f"{_PAPER}, equations 3 and 4",
    )
    yield StageEntry(
        kind="volume",
        name="zero-order-hold",
        target="roemetry_paper.zero_order_hold:ZeroOrderHold",
        summary="Each slice's area held until the next stripe",
        reference=f"{_PAPER}, section 3.6",
    )
    yield StageEntry(
        kind="weigher",
        name="density",
        target="roemetry_paper.density:Density",
        summary="Volume times one density",
        reference=f"{_PAPER}, section 4",
    )
    yield StageEntry(
        kind="classifier",
        name="arc-curvature",
        target="roemetry_paper.arc_curvature:ArcCurvature",
        summary="Henkei if an arc along a stripe is sharp and bows the wrong way",
        reference=f"{_PAPER}, section 3.5",
    )
