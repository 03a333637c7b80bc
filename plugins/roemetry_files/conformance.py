"""What the conformance kit cannot make itself: a manifest of two images."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

from roemetry.testing.cases import write_image


def two_images(folder: Path) -> Path:
    """Put two images and their manifest into a folder; give the manifest."""
    rows = []
    for number in (1, 2):
        image = folder / f"p{number}.png"
        write_image(image, number)
        data = image.read_bytes()
        hashed = hashlib.sha256(data).hexdigest()
        rows.append({"id": image.stem, "url": image.name, "sha256": hashed, "size": len(data)})
    path = folder / "manifest.jsonl"
    path.write_text("".join(json.dumps(row) + "\n" for row in rows), "utf-8")
    return path
