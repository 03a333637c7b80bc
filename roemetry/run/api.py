"""Recipes for Python programs: load one, run it, or hand it images that are in memory already."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roemetry.config.recipe import Recipe as CheckedRecipe
from roemetry.errors import DataError
from roemetry.records import Acquisition, Frame, Measurement, Reason, Role, Trace
from roemetry.run.batch import measure_all
from roemetry.run.control_chart import calibration_doubts
from roemetry.run.executors import Processes
from roemetry.run.pipeline import Pipeline
from roemetry.run.rows import measurements_of, seen_of


@dataclass(frozen=True, repr=False)
class Recipe(CheckedRecipe):
    """A checked recipe that measures: what it names, or arrays.

    Nothing is written; `roemetry.run_recipe` writes what the command line writes. Stages are made, and their
    kernels loaded, when the first image comes, and kept. One recipe may serve several threads.

    Examples
    --------
    >>> for product in Recipe.load("recipe.yaml").run():  # doctest: +SKIP
    ...     print(product.id, product.volume, product.grade)
    """

    def run(self, *, jobs: int = 1, debug: bool = False) -> Iterator[Measurement]:
        """Measure everything the recipe's source has, in its order.

        Parameters
        ----------
        jobs
            Worker processes; more than one needs the caller's script to be guarded by
            ``if __name__ == "__main__"``, as everything that spawns processes.
        debug
            Let every exception through; otherwise what goes wrong stands on the row and the rest goes on.

        Yields
        ------
        Measurement
            One for each product, the same as a line of the record, with a coarse grid of its points for
            notebooks; one that says why where there is none.

        Raises
        ------
        DataError
            The source has nothing.
        """
        references = self.references()
        for found in measure_all(self, references, Processes(jobs), debug, pictures=True):
            pictures = found.pictures or [None] * len(found.lines)
            for line, seen in zip(found.lines, pictures, strict=True):
                yield replace(Measurement.from_json(line), seen_xyz_mm=seen)

    def measure(
        self,
        laser: NDArray[Any],
        *,
        plain: NDArray[Any] | None = None,
        dark: NDArray[Any] | None = None,
        before: NDArray[Any] | None = None,
        name: str = "image",
    ) -> tuple[Measurement, ...]:
        """Measure one image that is in memory.

        Parameters
        ----------
        laser
            (row, column), or (row, column, colour) in the order blue, green, red, as OpenCV reads; uint8 or
            uint16 grey levels; as acquired: the recipe's `source` says how it is turned and which of its
            colours counts.
        plain, dark
            The same scene under plain light, and with the laser off; same size as `laser`.
        before
            The laser image that was taken before this one: an image that holds a part of it is refused.
        name
            What to call it: the measurements' ids begin with it.

        Returns
        -------
        tuple
            One for each product, left to right; one that says why where there is none.

        Raises
        ------
        DataError
            An array is not an image.
        """
        trace = self.trace(laser, plain=plain, dark=dark, before=before, name=name, surfaces=False)
        rows = measurements_of(trace, self, self.hashes, self._doubts)
        each = zip(rows, seen_of(trace, rows), strict=True)
        return tuple(replace(row, seen_xyz_mm=seen) for row, seen in each)

    def trace(
        self,
        laser: NDArray[Any],
        *,
        plain: NDArray[Any] | None = None,
        dark: NDArray[Any] | None = None,
        before: NDArray[Any] | None = None,
        name: str = "image",
        surfaces: bool = True,
    ) -> Trace:
        """Give all that happened to one image in memory, stage by stage; parameters as `measure`.

        `surfaces` keeps the surface behind each volume and the relief beside each grade, which notebooks and
        reports draw; the surface takes as long as the volume.
        """
        given: tuple[tuple[Role, NDArray[Any] | None], ...] = (
            ("laser", laser),
            ("plain", plain),
            ("dark", dark),
        )
        frames = tuple(
            Frame(image, role=role, name=name, bit_depth=8 * image.dtype.itemsize)
            for role, pixels in given
            if pixels is not None
            for image in (_array(pixels, role),)
        )
        return self._pipeline.trace(Acquisition(name, frames, before=before), surfaces=surfaces)

    @cached_property
    def _pipeline(self) -> Pipeline:
        return Pipeline(self)

    @cached_property
    def _doubts(self) -> tuple[Reason, ...]:
        return calibration_doubts(self)

    def __getstate__(self) -> dict[str, Any]:
        # a worker makes stages of its own: they hold compiled code
        return {name: value for name, value in self.__dict__.items() if name != "_pipeline"}


def _array(pixels: Any, role: Role) -> NDArray[Any]:
    try:
        return np.asarray(pixels)
    except ValueError as error:
        raise DataError(
            f"the {role} image is no array: {error}", hint="give (row, column) grey levels, uint8 or uint16"
        ) from error
