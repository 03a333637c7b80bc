"""Acquisitions from image files, and results to files."""

from __future__ import annotations

from collections.abc import Iterable

from roemetry.stages.hookspecs import StageEntry, hookimpl


@hookimpl
def roemetry_stages() -> Iterable[StageEntry]:
    """Name the file source and the file sinks."""
    yield StageEntry(
        kind="source",
        name="image-files",
        target="roemetry_files.image_files:ImageFiles",
        summary="Image files from a folder or a pattern, with plain-light and dark partners by name",
        reference="our own",
    )
    yield StageEntry(
        kind="source",
        name="dataset",
        target="roemetry_files.dataset_source:DatasetSource",
        summary="The items of a data set (a folder with dataset.yaml), with bit depth, time, encoder count",
        reference="our own",
    )
    yield StageEntry(
        kind="weigher",
        name="scale",
        target="roemetry_files.scale:Scale",
        summary="The mass that the line's own scale gave, and the specific volume",
        reference="our own",
    )
    yield StageEntry(
        kind="sink",
        name="csv",
        target="roemetry_files.csv_table:CsvTable",
        summary="results.csv: a line a product, units in the headings",
        reference="our own",
    )
    yield StageEntry(
        kind="sink",
        name="points",
        target="roemetry_files.points:Points",
        summary="points/<acquisition>.csv: every coded point, in pixels and, where calibrated, millimetres",
        reference="our own",
    )
    yield StageEntry(
        kind="sink",
        name="parquet",
        target="roemetry_files.parquet:Parquet",
        summary="results.parquet: a line a product with every feature, typed, for data frames",
        reference="our own",
        requires=(("pyarrow", "pip install 'roemetry[export]'"),),
    )
    yield StageEntry(
        kind="sink",
        name="point-cloud",
        target="roemetry_files.point_cloud:PointCloud",
        summary="point_clouds/<acquisition>.ply: every calibrated point, with uncertainty and stripe",
        reference="our own",
    )
    yield StageEntry(
        kind="sink",
        name="height-map",
        target="roemetry_files.height_map:HeightMap",
        summary="height_maps/<acquisition>.tif: 16-bit heights over the belt, and what was seen of them",
        reference="our own",
        requires=(("tifffile", "pip install 'roemetry[export]'"),),
    )
