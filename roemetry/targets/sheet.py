"""A printed sheet as shapes in millimetres, before anybody decides on a file format."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Rectangle:
    """A black rectangle; x, y is its top-left corner, mm."""

    x_mm: float
    y_mm: float
    width_mm: float
    height_mm: float


@dataclass(frozen=True, slots=True)
class Disc:
    """A black disc; x, y is its centre, mm."""

    x_mm: float
    y_mm: float
    radius_mm: float


@dataclass(frozen=True, slots=True)
class Words:
    """A line of text; x, y is the left end of its base line, mm."""

    x_mm: float
    y_mm: float
    size_mm: float
    text: str


Shape = Rectangle | Disc | Words


@dataclass(frozen=True, slots=True)
class Sheet:
    """One page: its size, and what is black on it; x to the right, y down, from the top-left corner."""

    title: str
    width_mm: float
    height_mm: float
    shapes: tuple[Shape, ...]
