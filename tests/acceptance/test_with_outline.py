"""The shipped recipe for volume: stripes and outline, uncertainties by cause, in record, table and report."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from roemetry import Recipe
from roemetry.records import Measurement
from roemetry.run.batch import run_recipe

HOME = Path(__file__).parents[2] / "recipes" / "herring_roe"
