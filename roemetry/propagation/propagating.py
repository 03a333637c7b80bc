"""From what each cause may be wrong by to what a result may be wrong by: Monte Carlo (JCGM 101).

Peak noise is drawn for each point, with its correlation along the stripe; the calibration is redrawn once a
draw, for it is common to all points; an outline moves as one; estimators and weighers draw their own model's
error. One cause drawn at a time gives the budget, all at once the standard uncertainty.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import replace

import numpy as np

from roemetry.propagation.drawing import Drawn, moved
from roemetry.propagation.repeating import Result, again, done, models_alone
from roemetry.propagation.scene import Chain, Scene
from roemetry.propagation.stating import CALIBRATION_NOT_STATED, Unstated, with_uncertainty
from roemetry.records import ProductTrace, Reason


def propagate(
    products: tuple[ProductTrace, ...], scene: Scene, chain: Chain, *, draws: int
) -> tuple[ProductTrace, ...]:
    """Give the products with uncertainties, budgets, intervals and probabilities.

    Parameters
    ----------
    products
        As they were found, without draws.
    scene, chain
        What they were found from, by which stages.
    draws
        Number of draws with all causes together; each cause alone gets a quarter of it, at least 50
        if there are as many.

    Notes
    -----
    The seed comes from the acquisition's id: results are the same for any number of workers.
    """
    seed = int.from_bytes(hashlib.sha256(scene.acquisition_id.encode()).digest()[:8], "little")
    rng = np.random.default_rng(seed)
    if not products:
        return products
    drawn = Drawn(scene, chain, rng)
    own = min(draws, max(_BUDGET_DRAWS_MIN, draws // 4))
    together: dict[int, list[Result]] = {trace.product.number: [] for trace in products}
    alone: dict[str, dict[int, list[Result]]] = {}
    for by_number in drawn.scenes(draws, drawn.causes):
        for trace in products:
            number = trace.product.number
            together[number].append(again(chain, trace, by_number.get(number), rng, model=True))
    for cause in drawn.causes:
        alone[cause] = {trace.product.number: [] for trace in products}
        for by_number in drawn.scenes(own, (cause,)):
            for trace in products:
                number = trace.product.number
                found = again(chain, trace, by_number.get(number), rng, model=False, graded=False)
                alone[cause][number].append(found)
    return tuple(
        with_uncertainty(
            trace,
            together[trace.product.number],
            {cause: found[trace.product.number] for cause, found in alone.items()},
            models_alone(trace, chain, rng, own),
            _unstated(trace, scene, chain, drawn),
        )
        for trace in products
    )


_BUDGET_DRAWS_MIN = 50
_PROBE_PX = 1.0

_PEAKS_NOT_STATED = Reason(
    "peak-noise-not-stated",
    "the extractor does not state the uncertainty of its peaks (some do only where source.sensor says the "
    "camera's noise), so that of volume and weight is not stated",
)
_OUTLINE_NOT_STATED = Reason(
    "outline-error-not-stated",
    "the outliner does not state the uncertainty of its contour, so that of volume and weight is not stated",
)
_VOLUME_NOT_STATED = Reason(
    "volume-model-not-stated",
    "the volume's estimator does not state its own model's error, so no uncertainty and no interval is given",
)
_WEIGHT_NOT_STATED = Reason(
    "weight-model-not-stated",
    "the weigher does not state its own model's error, so no uncertainty and no interval is given",
)


def _unstated(trace: ProductTrace, scene: Scene, chain: Chain, drawn: Drawn) -> Unstated:
    """Give what keeps the uncertainty of volume and weight from being stated."""
    reasons = []
    if not drawn.peaks_stated:
        reasons.append(_PEAKS_NOT_STATED)
    view = scene.calibration.view
    if view is not None and not view.exact:
        reasons.append(CALIBRATION_NOT_STATED)
    if chain.volume and not chain.volume.states_model_error:
        reasons.append(_VOLUME_NOT_STATED)
    outline = trace.product.outline
    if outline is not None and not math.isfinite(outline.xy_std_px) and trace.volume is not None:
        probed = replace(trace.product, outline=moved(outline, _PROBE_PX))
        other = done(lambda: chain.volume.estimate(probed))
        if other is None or other.visible_mm3.value != trace.volume.visible_mm3.value:
            reasons.append(_OUTLINE_NOT_STATED)
    weigher = chain.weigher and not chain.weigher.states_model_error
    return Unstated(tuple(reasons), (_WEIGHT_NOT_STATED,) if weigher else (), points=not drawn.peaks_stated)
