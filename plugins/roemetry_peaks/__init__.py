"""Sub-pixel extractors with an automatic threshold."""

from __future__ import annotations

from collections.abc import Iterable

from roemetry.stages.hookspecs import StageEntry, hookimpl


@hookimpl
def roemetry_stages() -> Iterable[StageEntry]:
    """Name the extractors, the simplest first."""
    yield StageEntry(
        kind="extractor",
        name="log-parabola",
        target="roemetry_peaks.log_parabola:LogParabola",
        summary="Top of the parabola through the logarithms of three or five pixels: the fastest",
        reference="Fisher, Naidu (1996), A comparison of algorithms for subpixel peak detection",
    )
    yield StageEntry(
        kind="extractor",
        name="centre-of-gravity",
        target="roemetry_peaks.centre_of_gravity:CentreOfGravity",
        summary="Centre of gravity of each stripe's profile above its background",
        reference="Fisher, Naidu (1996), A comparison of algorithms for subpixel peak detection",
    )
    yield StageEntry(
        kind="extractor",
        name="gaussian",
        target="roemetry_peaks.gaussian:Gaussian",
        summary="Gaussian fitted to each stripe by weighted least squares on logarithms",
        reference="Guo (2011), A simple algorithm for fitting a Gaussian function, "
        "IEEE Signal Processing Magazine 28(5):134–137",
    )
    yield StageEntry(
        kind="extractor",
        name="fir-zero-crossing",
        target="roemetry_peaks.zero_crossing:ZeroCrossing",
        summary="Zero crossing of each stripe's filtered derivative",
        reference="Blais, Rioux (1986), Real-time numerical peak detector, Signal Processing 11(2):145–155",
    )
    yield StageEntry(
        kind="extractor",
        name="maximum-likelihood",
        target="roemetry_peaks.maximum_likelihood:MaximumLikelihood",
        summary="Gaussian fit by maximum likelihood; speckle contrast estimated from the image itself",
        reference="Fisher scoring; speckle in the weights after Dorsch, Häusler, Herrmann (1994); ours",
    )
    yield StageEntry(
        kind="extractor",
        name="steger",
        target="roemetry_peaks.steger:Steger",
        summary="Ridges of the smoothed image in any direction, where they cross rows",
        reference="Steger (1998), An unbiased detector of curvilinear structures, IEEE PAMI 20:113–125",
    )
    yield StageEntry(
        kind="extractor",
        name="grid-lines",
        target="roemetry_peaks.grid_lines:GridLines",
        summary="Lines of a grid in both directions, each with the other family's light taken away",
        reference="Bigün, Granlund (1987), Optimal orientation detection of linear symmetry; ours",
    )
    yield StageEntry(
        kind="extractor",
        name="circle-curves",
        target="roemetry_peaks.circle_curves:CircleCurves",
        summary="Left and right halves of circles, traced across rows as far as these tell where they are",
        reference="Guo (2011), as gaussian; tracing is ours",
    )
    yield StageEntry(
        kind="extractor",
        name="two-channels",
        target="roemetry_peaks.two_channels:TwoChannels",
        summary="Lines of two colours, each family in its own channel of the image",
        reference="Guo (2011), as gaussian; the rest is ours",
    )
    yield StageEntry(
        kind="smoother",
        name="local-polynomial",
        target="roemetry_peaks.local_polynomial:LocalPolynomial",
        summary="A bent line through the rows around each row; breaks and steps are kept",
        reference="Local polynomial regression (Savitzky, Golay 1964); steps and bend are ours",
    )
