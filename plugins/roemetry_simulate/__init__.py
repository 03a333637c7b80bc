"""A ray caster that makes laser-stripe images whose answer is known.

Everything lives in the belt frame: X along image x, Y towards the image's top, Z up from the belt, in
millimetres. The camera frame is OpenCV's (z forward), and the centre of the top-left pixel is (0, 0).
"""

from __future__ import annotations

from collections.abc import Iterable

from roemetry.stages.hookspecs import StageEntry, hookimpl


@hookimpl
def roemetry_stages() -> Iterable[StageEntry]:
    """Name the simulators and their planners."""
    yield StageEntry(
        kind="simulator",
        name="ray-caster",
        target="roemetry_simulate.ray_caster:RayCaster",
        summary="Stripe images of a rig, with exact truth: float64 rays, 16 samples a pixel, exact shadows",
        reference="our own",
    )
    yield StageEntry(
        kind="simulator",
        name="moving-belt",
        target="roemetry_simulate.moving_belt:MovingBelt",
        summary="Scans of a product that a belt carries through the light: frames, counts, exact truth",
        reference="our own",
    )
    yield StageEntry(
        kind="planner",
        name="ray-caster",
        target="roemetry_simulate.planner:RigPlanner",
        summary="What a rig will give: view, height range, uncertainty, slopes, stripes, from its geometry",
        reference="triangulation; Cramér-Rao bound; speckle limit of Dorsch, Häusler, Herrmann (1994)",
    )
    yield StageEntry(
        kind="planner",
        name="moving-belt",
        target="roemetry_simulate.belt_planner:BeltPlanner",
        summary="What a rig will give over a belt, and which line spacing and belt speed are enough",
        reference="our own",
    )
