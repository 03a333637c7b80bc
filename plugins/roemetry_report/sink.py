"""The sink ``report``: one HTML file for people."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pydantic import Field

from roemetry.io.files import write_whole
from roemetry.stages import Run, Sink, StageOptions


class ReportOptions(StageOptions):
    """Options of the report."""

    products_max: int = Field(
        50, ge=0, le=500, description="Products shown with pictures, from the first on (number)."
    )
    worst_max: int = Field(
        10,
        ge=0,
        le=500,
        description="Acquisitions shown besides: failed, most ambiguous or least seen ones (number).",
    )


class Report(Sink[ReportOptions]):
    """Writes ``report.html``: one file that opens offline and shows every step for each product.

    The panels of a product are those of Lee et al. (2000), Figures 16 to 22. Figures come from the run's
    record, pictures from replaying the acquisition; where that is not possible the section says why.
    """

    Options = ReportOptions

    def write(self, run: Run) -> Sequence[Path]:
        """Write the page and give its path.

        Raises
        ------
        OutputError
            The folder cannot be written or the disk is full.
        """
        from roemetry_report.page import page

        path = run.folder / "report.html"
        write_whole(path, page(run, self.options.products_max, self.options.worst_max))
        return (path,)
