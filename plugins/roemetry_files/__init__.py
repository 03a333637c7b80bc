"""Acquisitions from image files, and results to files."""

from __future__ import annotations

from collections.abc import Iterable

from roemetry.stages.hookspecs import StageEntry, VerbEntry, hookimpl

_EXPORT = "pip install 'roemetry[export]'"


@hookimpl
def roemetry_stages() -> Iterable[StageEntry]:
    """Name the file sources, the weigher that reads a scale's table, and the file sinks."""
    for kind, name, target, summary, *needs in (
        ("source", "image-files", "image_files:ImageFiles",
         "Image files from a folder or a pattern, with plain-light and dark partners by name"),
        ("source", "dataset", "dataset_source:DatasetSource",
         "The items of a data set (a folder with dataset.yaml), with bit depth, time, encoder count"),
        ("source", "manifest", "manifest:Manifest",
         "The images that a manifest names by URL (S3, HTTP, files), each checked against its hash"),
        ("weigher", "scale", "scale:Scale",
         "The mass that the line's own scale gave, and the specific volume"),
        ("sink", "csv", "product_table:CsvTable",
         "results.csv: a line a product, units in the headings"),
        ("sink", "points", "points:Points",
         "points/<acquisition>.csv: every labelled point, in pixels and, where calibrated, millimetres"),
        ("sink", "parquet", "product_table:Parquet",
         "results.parquet: a line a product with every feature, typed, for data frames", "pyarrow"),
        ("sink", "point-cloud", "points:PointCloud",
         "point_clouds/<acquisition>.ply: every calibrated point, with uncertainty and stripe"),
        ("sink", "height-map", "height_map:HeightMap",
         "height_maps/<acquisition>.tif: 16-bit heights over the belt, and what was seen of them",
         "tifffile"),
        ("sink", "mesh-files", "mesh_files:MeshFiles",
         "meshes/<product>.ply and .stl: closed meshes with each vertex's uncertainty"),
    ):  # fmt: skip
        yield StageEntry(
            kind,
            name,
            f"roemetry_files.{target}",
            summary,
            reference="our own",
            requires=tuple((module, _EXPORT) for module in needs),
        )


@hookimpl
def roemetry_verbs() -> Iterable[VerbEntry]:
    """Register what lists and asks files."""
    for name, summary in (
        ("manifest", "Write a list of a recipe's images: id, URL, hash and size of each."),
        ("query", "Ask the results of a run, or of many, by SQL."),
    ):
        yield VerbEntry(name, f"roemetry_files.{name}:{name}", summary)
