"""A tuning session of one recipe: the answers to the page's requests, without a network.

An answer holds the frame as a picture, arrays to draw over it, and places to look at: a header of JSON,
then arrays that a browser uses without copying them. The header's length stands first, 4 bytes,
little-endian. The header is padded with blanks, each array with zeros, to a multiple of 8 bytes. `arrays` in
the header says for each: its type, its shape, and where it begins, counted from the end of the header.
"""

from __future__ import annotations

import hashlib
import json
import struct
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.config.recipe import Recipe
from roemetry.errors import ConfigurationError, RoemetryError
from roemetry.io.files import json_values, write_bytes
from roemetry.io.yaml_source import parse, text_of
from roemetry.records import (
    AMBIGUOUS,
    EDGE,
    SATURATED,
    UNLABELLED,
    WIDE,
    Acquisition,
    AcquisitionReference,
    Frame,
    Peaks,
    StripeMap,
    Trace,
)
from roemetry.records.calibration import Calibration
from roemetry.run.pipeline import Pipeline, frame_of
from roemetry.run.rows import measurements_of
from roemetry.run.stage_cache import CachedStages, StageCache
from roemetry.stages.registry import Registry, discover
from roemetry_tools.tune.editing import differences, edited
from roemetry_tools.tune.request import Draft, Fault, TuneRequest, draft_of, faults_of, form_of

_STEPS_KEPT = 64
"""Results of stages: some dozens of MB."""
_LONGEST_NAME = 200
"""Bytes: file systems take 255, of which an ending and a number need some."""
_PICTURES_KEPT = 4
"""Frames between which one goes back and forth."""


_NOT_SERVED = "files neither in the recipe's folder nor in those of what it opened with"


def _options_files(recipe: Recipe) -> list[Path]:
    """Give the files that the options of a recipe's stages name."""
    return [
        value for stage in recipe.stages.values() for _, value in stage.options if isinstance(value, Path)
    ]


class Session:
    """A recipe being tuned: its text, one frame, and the results of stages that need not run again.

    With `debug`, faults of a stage that are no refusal pass through, with their traceback.

    Raises
    ------
    ConfigurationError
        The recipe is not sound as it stands.
    DataError
        Its source has nothing.
    """

    def __init__(self, path: Path, registry: Registry | None = None, *, debug: bool = False) -> None:
        self._debug = debug
        path = path / "recipe.yaml" if path.is_dir() else path
        self.registry = registry or discover()
        self._path = path.resolve()  # a link is followed, so that saving does not put a file in its place
        self._lock = threading.Lock()
        self._memory = StageCache(most=_STEPS_KEPT)
        self._read_calibration = lru_cache(maxsize=2)(_calibration_at)
        self._looked_at: tuple[object, Acquisition] | None = None
        self._listed: tuple[object, Sequence[AcquisitionReference]] | None = None
        self._pictures: dict[str, bytes] = {}
        self._text = text_of(self._path)
        self._own: bytes | None = None
        opened = Recipe.load(self._path, registry=self.registry)
        files = [
            file for one in opened.source.make().references(opened.source_path) for file in one.files.values()
        ]
        source = opened.source_path.resolve()
        self._served = {
            self._path.parent,
            source if source.is_dir() else source.parent,
            *{file.resolve().parent for file in (*files, *_options_files(opened))},
        }
        """Folders of which the page may ask files: the recipe's, and those of what it opened with."""
        self._base = parse(self._text, str(self._path)).data
        self._references(self._recipe(Draft(self._base)))

    @property
    def path(self) -> Path:
        """The file that is being changed."""
        return self._path

    def recipe(self) -> dict[str, Any]:
        """Describe the recipe as it is saved, and what may be chosen instead: all that a form is made of."""
        with self._lock:
            return self._described()

    def warm_up(self) -> None:
        """Load kernels, or compile them, before anybody waits for a slider."""
        self.answer(TuneRequest())
        self._memory.clear()  # or the page would show the times of compiling

    def answer(self, wish: TuneRequest) -> bytes:
        """Run what the wish changes and pack what came out, or what is wrong with it.

        A fault of the form is told with the path of its field; a stage that refuses, or fails, is told with
        its reason.
        """
        with self._lock:
            begin = time.perf_counter()
            header: dict[str, Any] = {"faults": [], "changes": []}
            arrays: dict[str, Any] = {}
            draft = draft_of(self._base, wish)
            header["changes"] = differences(self._base, draft.data)
            try:
                header |= self._evaluated(draft, wish, arrays)
            except ConfigurationError as error:
                header["faults"] = [asdict(fault) for fault in faults_of(draft, error)]
            except RoemetryError as error:
                header["faults"] = [asdict(Fault(("source", "path"), str(error)))]
            # A fault of a plugin (or ours) must not end the page; which one it is, --debug tells.
            except Exception as error:
                if self._debug:
                    raise
                said = f"{type(error).__name__}: {error} (a plugin's fault, or ours; see --debug)"
                header["faults"] = [asdict(Fault((), said))]
            header["seconds_in_all"] = time.perf_counter() - begin
            return packed(header, arrays)

    def picture(self, key: str) -> bytes | None:
        """Give the PNG of a frame that an answer named; None where it is not kept any more."""
        return self._pictures.get(key)

    def save(self, wish: TuneRequest, name: str = "") -> dict[str, Any]:
        """Write the recipe, comments kept, or another file of that name in its folder.

        What the recipe's file held when it was opened is kept beside it; gives where, and the recipe anew.

        Raises
        ------
        ConfigurationError
            The wish is not sound; the file was changed by someone else; the other file is there already.
        OutputError
            It cannot be written; the old file is as it was.
        """
        with self._lock:
            draft = draft_of(self._base, wish)
            self._recipe(draft)
            text = edited(self._text, self._path.name, draft.data)
            target = self._target(name)
            # Once more, from the text: what is written is what would be read.
            Recipe.drafted(target, Draft(parse(text, target.name).data), self.registry)
            old = self._put_aside() if target == self._path else None
            write_bytes(target, text.encode())
            self._path, self._text = target, text
            self._own = text.encode()
            self._base = parse(text, str(target)).data
            return {
                "path": str(target),
                "old": "" if old is None else old.name,
                "recipe": self._described(),
            }

    def _described(self) -> dict[str, Any]:
        recipe = self._recipe(Draft(self._base))
        return {
            "path": str(self._path),
            "name": self._path.name,
            "product": recipe.product,
            "calibrated": recipe.calibration is not None,
            "draws": _method_of(recipe),
            "acquisitions": [reference.id for reference in self._references(recipe)],
            "broken": [str(broken) for broken in self.registry.broken],
            **form_of(self._base, recipe, self.registry),
        }

    def _evaluated(self, draft: Draft, wish: TuneRequest, arrays: dict[str, Any]) -> dict[str, Any]:
        recipe = self._recipe(draft)
        references = self._references(recipe)
        reference = next((one for one in references if one.id == wish.acquisition), references[0])
        acquisition = self._acquisition(recipe, reference)
        draws = None if wish.draws else 0
        remembered = CachedStages(recipe, self._memory, draws)
        settings = recipe.source_choice.model_dump_json(exclude={"path"})

        def frame(given: Acquisition) -> Frame:
            found: Frame = self._memory.recall(("frame", settings), lambda: frame_of(recipe, given))[0]
            return found

        # each line of a scan is a frame of its own
        one_frame = frame if acquisition.lines is None else None
        trace = Pipeline(recipe, stages=remembered.stages, draws=draws, frame=one_frame).trace(acquisition)
        rows = measurements_of(trace, recipe, {})
        extractor = recipe.stages.get("extractor")
        dots = extractor is not None and extractor.stage.capabilities.pattern == "dots"
        places = places_of(trace, arrays, dots=dots)
        return {
            "acquisition": reference.id,
            "acquisitions": [one.id for one in references],
            "image": self._pictured(trace, recipe, reference),
            "absent": {kind: reason.text for kind, reason in trace.absent.items()},
            "rows": [json.loads(row.to_json()) for row in rows],
            "places": places,
            "drawn": _method_of(recipe) if wish.draws else "",
            "seconds": dict(trace.seconds),
            "seconds_fresh": {**trace.seconds, **remembered.seconds},
        }

    def _recipe(self, draft: Draft) -> Recipe:
        recipe = Recipe.drafted(self._path, draft, self.registry, read_calibration=self._calibration)
        if draft.faults:
            raise ConfigurationError([f"{draft.place(fault.path)}: {fault.said}" for fault in draft.faults])
        if not self._is_served(recipe.source_path, *_options_files(recipe)):
            raise ConfigurationError([f"{draft.place(('source', 'path'))}: source.path: {_NOT_SERVED}"])
        return recipe

    def _is_served(self, *files: Path) -> bool:
        return all(any(file.resolve().is_relative_to(folder) for folder in self._served) for file in files)

    def _calibration(self, path: Path) -> Calibration:
        try:
            changed = path.stat().st_mtime_ns
        except OSError:
            return Calibration.load(path)  # says what is wrong
        return self._read_calibration(path, changed)

    def _references(self, recipe: Recipe) -> Sequence[AcquisitionReference]:
        key = _source_key(recipe)
        if self._listed is None or self._listed[0] != key:
            listed = recipe.source.make().references(recipe.source_path)
            if not self._is_served(*{file for one in listed for file in one.files.values()}):
                raise ConfigurationError(f"source: {_NOT_SERVED}")
            self._listed = key, listed
        return self._listed[1]

    def _acquisition(self, recipe: Recipe, reference: AcquisitionReference) -> Acquisition:
        key = (_source_key(recipe), reference.id)
        if self._looked_at is None or self._looked_at[0] != key:
            self._looked_at = key, recipe.source.make().read(reference)
            self._memory.clear()
        return self._looked_at[1]

    def _pictured(self, trace: Trace, recipe: Recipe, reference: AcquisitionReference) -> dict[str, Any]:
        if trace.frame is None:
            return {}
        deciding = [*_source_key(recipe), reference.id, recipe.source_choice.model_dump(mode="json")]
        key = hashlib.sha256(json.dumps(deciding).encode()).hexdigest()[:24]
        if key not in self._pictures:
            while len(self._pictures) >= _PICTURES_KEPT:
                del self._pictures[next(iter(self._pictures))]
            self._pictures[key] = picture_of(trace.frame)
        rows, columns = trace.frame.size
        return {"key": key, "rows": rows, "columns": columns, "white": trace.frame.white}

    def _target(self, name: str) -> Path:
        if name in ("", self._path.name):
            if text_of(self._path) != self._text:
                raise ConfigurationError(
                    f"{self._path.name} was changed by someone else since it was opened here",
                    hint="save under another name, or load the page's recipe again",
                )
            return self._path
        plain = Path(name).name == name and not name.startswith(".") and name.isprintable()
        if not plain or len(name.encode()) > _LONGEST_NAME:
            raise ConfigurationError(f"{name!r:.80} is not a file name", hint="a name without a folder")
        target = self._path.parent / (name if name.endswith((".yaml", ".yml")) else f"{name}.yaml")
        if target.exists():
            raise ConfigurationError(f"{target.name} is there already", hint="choose another name")
        return target

    def _put_aside(self) -> Path | None:
        """Copy the file as someone else wrote it; what this session wrote itself is not kept again."""
        content = self._path.read_bytes()
        if content == self._own:
            return None
        number = 1
        while (old := self._path.with_name(f"{self._path.name}.old-{number}")).exists():
            number += 1
        write_bytes(old, content)
        return old


def _calibration_at(path: Path, changed: int) -> Calibration:
    """Read a calibration; `changed` makes a file that was written again another one."""
    return Calibration.load(path)


def _source_key(recipe: Recipe) -> tuple[str, str, str]:
    described = json.dumps(recipe.source.described(), sort_keys=True)
    return described, str(recipe.source_path), str(recipe.path.parent)


def _method_of(recipe: Recipe) -> str:
    """Say how a recipe's uncertainties are found; "" where they are not."""
    if recipe.uncertainty == "monte-carlo":
        return f"{recipe.draws} draws"
    return {"linear": "linearisation", "none": ""}[recipe.uncertainty]


_GAPS_TOLD = 40
"""More than anybody steps through."""


def places_of(trace: Trace, arrays: dict[str, NDArray[Any]], *, dots: bool = False) -> dict[str, Any]:
    """Fill the arrays to draw, and count the places to look at.

    Arrays are ``peaks.…``, ``stripes.…``, ``profiles.…`` and ``outline.N``. Of gaps the longest are told:
    stripe, first and last row, x at both ends, px, and whether they were bridged. Between `dots` there is
    nothing to be seen, and no gap.
    """
    told: dict[str, Any] = {}
    if trace.peaks is not None:
        told |= _of_peaks(trace.peaks, arrays)
    if trace.stripes is not None:
        told |= _of_stripes(trace.stripes, arrays, dots=dots)
    for outline in trace.outlines:
        arrays[f"outline.{outline.product}"] = outline.xy_px
    if trace.profiles is not None:
        for name in ("xyz_mm", "product", "seen", "stripe", "height_std_mm"):
            arrays[f"profiles.{name}"] = getattr(trace.profiles, name)
    return told


def _of_peaks(peaks: Peaks, arrays: dict[str, NDArray[Any]]) -> dict[str, Any]:
    for name in ("row", "x_px", "x_std_px", "amplitude", "background", "width_px", "flags"):
        arrays[f"peaks.{name}"] = getattr(peaks, name)
    return {
        "peaks": len(peaks),
        "saturated": int(np.count_nonzero(peaks.flags & SATURATED)),
        "edge": int(np.count_nonzero(peaks.flags & EDGE)),
        "wide": int(np.count_nonzero(peaks.flags & WIDE)),
        "peak_reasons": [reason.text for reason in peaks.reasons],
    }


def _of_stripes(stripes: StripeMap, arrays: dict[str, NDArray[Any]], *, dots: bool) -> dict[str, Any]:
    for name in ("x_px", "product", "seen", "margin", "ambiguous", "rest_px"):
        arrays[f"stripes.{name}"] = getattr(stripes, name)
    arrays["peaks.stripe"] = stripes.peak_stripe
    gaps = [] if dots else sorted(_gaps(stripes), key=lambda gap: gap["first"] - gap["last"])
    return {
        "labelled": int(np.count_nonzero(stripes.peak_stripe >= 0)),
        "unlabelled": int(np.count_nonzero(stripes.peak_stripe == UNLABELLED)),
        "ambiguous": int(np.count_nonzero(stripes.peak_stripe == AMBIGUOUS)),
        "gaps": len(gaps),
        "gap_list": gaps[:_GAPS_TOLD],
    }


def _gaps(stripes: StripeMap) -> Iterator[dict[str, Any]]:
    """Give runs of rows, between a stripe's first and last seen row, in which no peak of it was seen."""
    for stripe in range(stripes.stripe_count):
        seen = np.flatnonzero(stripes.seen[stripe])
        for before in np.flatnonzero(np.diff(seen) > 1):
            first, last = int(seen[before]) + 1, int(seen[before + 1]) - 1
            x = stripes.x_px[stripe]
            products = stripes.product[stripe, [first - 1, last + 1]]
            yield {
                "stripe": stripe,
                "first": first,
                "last": last,
                "x_first": float(x[first - 1]),
                "x_last": float(x[last + 1]),
                "bridged": bool(np.isfinite(x[first : last + 1]).all()),
                "product": int(products.max()),
            }


def picture_of(frame: Frame) -> bytes:
    """Give a frame as an 8-bit PNG; deeper grey levels are scaled so that white stays white."""
    import cv2

    pixels = frame.pixels
    if frame.white != 255 or pixels.dtype != np.uint8:
        pixels = np.minimum(pixels.astype(np.float64) * (255.0 / frame.white), 255.0).astype(np.uint8)
    done, encoded = cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    if not done:  # pragma: no cover - an array of bytes can always be encoded
        raise ValueError("the frame cannot be encoded")
    return encoded.tobytes()


_TYPES = {"f": "float32", "i": "int16", "u": "uint8", "b": "uint8"}


def packed(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Pack an answer. Floats become 32 bit, whole numbers 16 bit, flags 8 bit."""
    parts: list[bytes] = []
    told: dict[str, Any] = {}
    place = 0
    for name, array in arrays.items():
        kind = _TYPES[array.dtype.kind]
        data = np.ascontiguousarray(array, dtype=np.dtype(kind).newbyteorder("<")).tobytes()
        told[name] = {"type": kind, "shape": list(array.shape), "at": place}
        parts.append(data + bytes(-len(data) % 8))
        place += len(parts[-1])
    text = json.dumps(json_values({**header, "arrays": told}), allow_nan=False).encode()
    text += b" " * (-(len(text) + 4) % 8)
    return struct.pack("<I", len(text)) + text + b"".join(parts)
