"""Traces that sinks look at again, kept on disk from measuring to drawing: no acquisition is traced twice.

Images are not kept: the source gives them again. What cannot be written or read is traced anew.
"""

from __future__ import annotations

import hashlib
import pickle
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from roemetry.records import Trace


@dataclass(frozen=True)
class KeptTraces:
    """The traces of some acquisitions, in a folder that any process may write to."""

    folder: Path
    acquisitions: frozenset[str]
    """Ids of those that are to be kept."""

    def put(self, trace: Trace) -> None:
        """Keep a trace, if it is one of those that are to be kept and the disk takes it."""
        if trace.acquisition_id not in self.acquisitions:
            return
        path = self._path(trace.acquisition_id)
        try:
            path.write_bytes(pickle.dumps(replace(trace, acquisition=None, frame=None), protocol=5))
        except OSError:
            with suppress(OSError):
                path.unlink()

    def get(self, acquisition_id: str) -> Trace | None:
        """Give a trace that was kept, without its images; None where it was not."""
        if acquisition_id not in self.acquisitions:
            return None
        try:
            found = pickle.loads(self._path(acquisition_id).read_bytes())
        except (OSError, EOFError, pickle.UnpicklingError):
            return None
        return found if isinstance(found, Trace) else None

    def _path(self, acquisition_id: str) -> Path:
        return self.folder / hashlib.sha256(acquisition_id.encode()).hexdigest()
