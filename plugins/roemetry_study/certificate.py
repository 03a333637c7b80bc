"""Certificates: one file for machines and one page for people, signed, and proved unchanged by `verify`.

The machine-readable file is JSON, shaped after the Digital Calibration Certificate (administrative data, then
items, methods, results with uncertainty and coverage, then statements); it is no DCC, whose schema is XML,
and says so. The signature is Ed25519 over the canonical form of all but the signature: keys sorted, no
blanks, UTF-8. The page holds the same content and the file's SHA-256, so that either can be held against the
other.
"""

from __future__ import annotations

import base64
import hashlib
import json
import platform
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import roemetry
from roemetry.errors import DataError, OutputError, PluginError
from roemetry.html.page import environment_of
from roemetry.io.files import json_values, sha256_of, write_whole

FORMAT = "roemetry-certificate-1"
_KEY_HINT = "install the extra that signs: pip install 'roemetry[sign]'"


@dataclass(frozen=True, slots=True)
class Table:
    """A table of a certificate: what every number means stands in its heading, with the unit."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str | float | int, ...], ...]


@dataclass(frozen=True, slots=True)
class Certificate:
    """What a study found, ready to be written."""

    kind: str
    """``gauge study``, ``acceptance test``, ``calibration``."""
    verdict: str
    statements: tuple[str, ...]
    """The results in sentences, the decision first."""
    method: tuple[str, ...]
    """By which standards, and what was not checked against their text."""
    items: Mapping[str, str]
    """Identity of rig, recipe, calibration and artefacts: hashes, names, serial numbers."""
    tables: tuple[Table, ...]
    decision_rule: str
    coverage: str = "expanded uncertainties and intervals are for a coverage probability of 95 %"
    environment: str = ""

    def document(self) -> dict[str, Any]:
        """Give the content as JSON values, unsigned."""
        content: dict[str, Any] = {
            "format": FORMAT,
            "note": "shaped after the Digital Calibration Certificate; it is not one, and not accredited",
            "administrative": {
                "kind": self.kind,
                "made": datetime.now(UTC).isoformat(timespec="seconds"),
                "software": {
                    "name": "roemetry",
                    "version": version("roemetry"),
                    "sha256": software_sha256(),
                    "python": platform.python_version(),
                },
                "environment": self.environment or "not recorded",
            },
            "items": dict(self.items),
            "method": list(self.method),
            "decision_rule": self.decision_rule,
            "coverage": self.coverage,
            "verdict": self.verdict,
            "statements": list(self.statements),
            "results": [
                {"title": t.title, "columns": list(t.head), "rows": [list(row) for row in t.rows]}
                for t in self.tables
            ],
        }
        made: dict[str, Any] = json_values(content)
        return made


def write(certificate: Certificate, folder: Path, name: str, key: Path | None = None) -> tuple[Path, Path]:
    """Write a certificate's file and page, whole or not at all; sign with the private key if there is one.

    Gives the paths of the JSON file and of the page.

    Raises
    ------
    PluginError
        A key is named and the library that signs is not installed.
    DataError
        The key cannot be read.
    OutputError
        The folder cannot be written.
    """
    document = certificate.document()
    if key is not None:
        private = _private(key)
        document["signature"] = {
            "algorithm": "Ed25519",
            "public_key": _base64(private.public_key().public_bytes_raw()),
            "value": _base64(private.sign(canonical(document))),
        }
    folder.mkdir(parents=True, exist_ok=True)
    path, page = folder / f"{name}.json", folder / f"{name}.html"
    write_whole(path, _text(document))
    template = environment_of("roemetry_study").get_template("certificate.html.j2")
    write_whole(page, template.render(document=document, file=path.name, sha256=sha256_of(path)))
    return path, page


def new_key(path: Path) -> str:
    """Make a private key, readable by its owner alone, and give the public one.

    OutputError where the file is there already.
    """
    ed25519, serialization = _library()
    if path.exists():
        raise OutputError(f"{path}: is there already", hint="a key is never overwritten; name another file")
    private = ed25519.Ed25519PrivateKey.generate()
    path.touch(mode=0o600)
    path.write_bytes(
        private.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        )
    )
    return _base64(private.public_key().public_bytes_raw())


@dataclass(frozen=True, slots=True)
class Verified:
    """What a check of a certificate found."""

    signed_by: str
    """Public key; "" where it is not signed."""
    trusted: bool
    """Whether that is the key that was asked for."""
    words: str


def verify(path: Path, trusted_key: str = "", page: Path | None = None) -> Verified:
    """Prove that a certificate's JSON file is unchanged and, if given, that `page` was made from it.

    It should have been signed with the public key `trusted_key`; "": with any.

    Raises
    ------
    DataError
        It is no certificate, was changed, is not signed, or is signed by another key.
    PluginError
        The library that verifies is not installed.
    """
    try:
        text = path.read_text(encoding="utf-8")
        document = json.loads(text)
        signature = document.get("signature")
        form = document["format"]
    except (OSError, ValueError, KeyError, AttributeError, RecursionError) as error:
        raise DataError(f"{path}: not a certificate: {type(error).__name__}: {error}") from error
    if form != FORMAT:
        raise DataError(f"{path}: format: found {form!r}, expected {FORMAT!r}")
    if page is not None and sha256_of(path) not in page.read_text(encoding="utf-8", errors="replace"):
        raise DataError(f"{page}: was not made of {path.name} as it is now: its hash is another")
    if not isinstance(signature, dict) or signature.get("algorithm") != "Ed25519":
        raise DataError(f"{path}: is not signed: nothing proves that it is unchanged", hint="sign with --key")
    if text != _text(document):
        raise DataError(f"{path}: was changed after it was written: its layout is another")
    ed25519, _ = _library()
    from cryptography.exceptions import InvalidSignature

    try:
        public_key, value = (
            base64.b64decode(signature[name], validate=True) for name in ("public_key", "value")
        )
        if (_base64(public_key), _base64(value)) != (signature["public_key"], signature["value"]):
            raise InvalidSignature  # base64 leaves bits of its last letter unused: they could be changed
        unsigned = {name: part for name, part in document.items() if name != "signature"}
        ed25519.Ed25519PublicKey.from_public_bytes(public_key).verify(value, canonical(unsigned))
    except InvalidSignature as error:
        raise DataError(f"{path}: was changed after it was signed, or the signature was") from error
    except (ValueError, KeyError, TypeError) as error:
        raise DataError(f"{path}: its signature is damaged: {error}") from error
    signer = str(signature["public_key"])
    if trusted_key and signer != trusted_key:
        raise DataError(f"{path}: signed by {signer}, expected {trusted_key}")
    words = "unchanged since it was signed by " + (
        signer if trusted_key else f"{signer} (check that this is the key you expect)"
    )
    return Verified(signer, bool(trusted_key), words)


def canonical(document: Mapping[str, Any]) -> bytes:
    """Give the bytes that are signed: keys sorted, no blanks, UTF-8."""
    return json.dumps(
        document, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False
    ).encode()


def software_sha256() -> str:
    """Give the SHA-256 of all Python sources of roemetry and of the plugins that lie beside it.

    Names and contents count, in the order of the names: two installations of one version have one hash.
    """
    told = hashlib.sha256()
    for package in sorted({Path(roemetry.__file__).parent, *Path(__file__).parents[1].glob("roemetry_*/")}):
        for path in sorted(package.rglob("*.py")):
            told.update(
                f"{package.name}/{path.relative_to(package).as_posix()}\0".encode() + path.read_bytes()
            )
    return told.hexdigest()


def _text(document: Mapping[str, Any]) -> str:
    """Give the file's text: one way to write it, so that not even a blank can change unseen."""
    return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _private(path: Path) -> Any:
    ed25519, serialization = _library()
    try:
        key = serialization.load_pem_private_key(path.read_bytes(), password=None)
    except (OSError, ValueError, TypeError) as error:
        raise DataError(
            f"{path}: cannot be read as a private key: {error}", hint="make one with `roemetry study key`"
        ) from error
    if not isinstance(key, ed25519.Ed25519PrivateKey):
        raise DataError(f"{path}: found a {type(key).__name__}, expected an Ed25519 key")
    return key


def _library() -> tuple[Any, Any]:
    try:
        from cryptography.hazmat.primitives import serialization
        from cryptography.hazmat.primitives.asymmetric import ed25519
    except ImportError as error:
        raise PluginError("signatures need the library `cryptography`", hint=_KEY_HINT) from error
    return ed25519, serialization


def _base64(raw: bytes) -> str:
    return base64.b64encode(raw).decode("ascii")
