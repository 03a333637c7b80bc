"""A second maker of stripe images whose answer is known; Mitsuba 3 casts the rays.

It reads the same scene files as the plugin `simulate` and writes the same data sets, and shares no code with
it, so that what both agree on does not come from one maker's assumptions. Frames are those of `conventions`:
belt frame X along image x, Y towards the image's top, Z up from the belt, mm; camera frame OpenCV's; integer
pixel coordinates are pixel centres.
"""

from __future__ import annotations

from collections.abc import Iterable

from roemetry.stages.hookspecs import StageEntry, hookimpl


@hookimpl
def roemetry_stages() -> Iterable[StageEntry]:
    """Name the simulators."""
    yield StageEntry(
        kind="simulator",
        name="mitsuba",
        target="roemetry_mitsuba.simulator:MitsubaSimulator",
        summary="Stripe images by Mitsuba 3: gloss, scattering, interreflection; exact truth",
        reference="Jakob et al., Mitsuba 3 (2022); Jensen et al., dipole (2001); Walter et al., GGX (2007)",
        requires=(("mitsuba", 'pip install "roemetry[mitsuba]"'),),
    )
    yield StageEntry(
        kind="simulator",
        name="mitsuba-belt",
        target="roemetry_mitsuba.moving_belt:MitsubaBelt",
        summary="Belt scans by Mitsuba 3: gloss, scattering, interreflection; frames, counts, exact truth",
        reference="as `mitsuba`",
        requires=(("mitsuba", 'pip install "roemetry[mitsuba]"'),),
    )
