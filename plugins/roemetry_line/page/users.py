"""Who may do what on the page: users with roles, their hashed passwords, and their sessions."""

from __future__ import annotations

import hashlib
import hmac
import secrets
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from pydantic import Field

from roemetry.config.recipe_file import Section
from roemetry.config.validation import checked
from roemetry.errors import ConfigurationError
from roemetry.io.files import write_whole
from roemetry.io.yaml_source import dump, read

Role = Literal["viewer", "operator", "engineer"]
MAY = {"viewer": 0, "operator": 1, "engineer": 2}
"""Each may do what those before it may."""
FILE = "users.yaml"

_COST, _BLOCK, _PARALLEL = 2**14, 8, 1
"""scrypt: 16 MB and some 50 ms a password (RFC 7914, the cost for logins)."""
_SESSION_S = 12 * 3600.0  # longer than a shift
_TRIES, _LOCKED_S = 5, 60.0
"""So many wrong passwords in a row, and a name is locked for so long, s."""


class UserSection(Section):
    """One user."""

    role: Role = Field(description="what the user may do")
    password: str = Field(pattern="^scrypt:[0-9a-f]{32}:[0-9a-f]{64}$", description="salt and hash")


class UsersFile(Section):
    """All users."""

    users: dict[str, UserSection] = Field(default_factory=dict, description="by name")


@dataclass
class Session:
    """A user who is logged in."""

    name: str
    role: Role
    until_s: float
    csrf: str = field(default_factory=lambda: secrets.token_urlsafe(24))


class Users:
    """The users of a line, read anew whenever their file has changed, and their sessions."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / FILE
        self._sessions: dict[str, Session] = {}
        self._wrong: dict[str, tuple[int, float]] = {}
        self._lock = threading.Lock()

    def log_in(self, name: str, password: str) -> str | None:
        """Give the key of a new session; None where name or password is wrong, or the name is locked."""
        now = time.monotonic()
        with self._lock:
            tries, since = self._wrong.get(name, (0, now))
            if tries >= _TRIES and now - since < _LOCKED_S:
                return None
        user = read_users(self._path).get(name)
        # A name that is not there takes as long as one that is.
        salt, kept = (user.password.split(":")[1:]) if user is not None else ("00" * 16, "00" * 32)
        right = hmac.compare_digest(_hash(password, salt), kept) and user is not None
        with self._lock:
            if not right or user is None:
                if len(self._wrong) > 1000:
                    self._wrong.clear()
                self._wrong[name] = (tries + 1 if now - since < _LOCKED_S else 1, now)
                return None
            self._wrong.pop(name, None)
            self._sessions = {key: one for key, one in self._sessions.items() if one.until_s > now}
            key = secrets.token_urlsafe(32)
            self._sessions[key] = Session(name, user.role, now + _SESSION_S)
            return key

    def session(self, key: str | None) -> Session | None:
        """Give the session of a key that is still good."""
        with self._lock:
            found = self._sessions.get(key or "")
        return found if found is not None and found.until_s > time.monotonic() else None

    def log_out(self, key: str | None) -> None:
        """End a session."""
        with self._lock:
            self._sessions.pop(key or "", None)


def read_users(path: Path) -> dict[str, UserSection]:
    """Read the users' file; nobody where there is none. ConfigurationError names every fault."""
    if not path.exists():
        return {}
    document = read(path)
    found, faults = checked(UsersFile, document.data, document.place)
    if found is None:
        raise ConfigurationError(faults)
    return dict(found.users)


def set_password(folder: Path, name: str, role: Role, password: str) -> Path:
    """Write a user into the line's users' file, or give one that is there another password and role."""
    users = read_users(folder / FILE)
    salt = secrets.token_hex(16)
    users[name] = UserSection(role=role, password=f"scrypt:{salt}:{_hash(password, salt)}")
    plain = {"users": {one: user.model_dump() for one, user in users.items()}}
    write_whole(folder / FILE, dump(plain))
    (folder / FILE).chmod(0o600)
    return folder / FILE


def _hash(password: str, salt: str) -> str:
    made = hashlib.scrypt(password.encode(), salt=bytes.fromhex(salt), n=_COST, r=_BLOCK, p=_PARALLEL)
    return made.hex()[:64]
