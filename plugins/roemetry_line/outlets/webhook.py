"""Rows posted to an HTTP address, as a JSON list; taken once the answer is one of success."""

from __future__ import annotations

import hashlib
import hmac
import json
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from pydantic import Field

from roemetry.errors import OutputError
from roemetry.records.live import LineRow
from roemetry.stages import Capabilities, Outlet, StageOptions


class WebhookOptions(StageOptions):
    """Where rows are posted to."""

    url: str = Field(
        default="http://127.0.0.1:8080/rows",
        pattern="^https?://.+$",
        description="address that takes the rows",
    )
    secret_file: Path | None = Field(
        default=None,
        description="file with a secret: the header X-Roemetry-Signature then has the HMAC-SHA-256 of the "
        "body, in hexadecimal; none: no header",
    )
    timeout_s: float = Field(default=5.0, gt=0, le=60, description="how long an answer may take, s")


class Webhook(Outlet[WebhookOptions]):
    """Posts rows in order, up to a hundred at once."""

    capabilities = Capabilities(fixture="roemetry_line.conformance:webhook")

    @contextmanager
    def open(self) -> Iterator[Callable[[Sequence[LineRow]], None]]:
        """Post nothing, to see that somebody is there; OutputError where nobody is."""
        secret = None if self.options.secret_file is None else self.options.secret_file.read_bytes().strip()

        def deliver(rows: Sequence[LineRow]) -> None:
            """Post rows; OutputError where the answer is none of success."""
            told = [json.loads(row.text) | {"key": row.key, "summary": dict(row.summary)} for row in rows]
            body = json.dumps(told, ensure_ascii=False).encode()
            headers = {"Content-Type": "application/json"}
            if secret is not None:
                headers["X-Roemetry-Signature"] = hmac.new(secret, body, hashlib.sha256).hexdigest()
            request = urllib.request.Request(self.options.url, body, headers, method="POST")
            try:
                with urllib.request.urlopen(request, timeout=self.options.timeout_s):
                    return
            except urllib.error.HTTPError as error:
                why = f"answers {error.code} {error.reason}"
                error.close()
            except (OSError, ValueError) as error:
                why = str(getattr(error, "reason", error))
            raise OutputError(
                f"{self.options.url}: {why}", hint="does the receiver run, and answer 200 to 299?"
            )

        deliver([])
        yield deliver
