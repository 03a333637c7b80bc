"""Where what comes with roemetry lies: inside the installed package, or beside it in a checkout."""

from __future__ import annotations

from pathlib import Path

from roemetry.errors import ConfigurationError


def shipped(*parts: str) -> Path:
    """Give the path of a shipped file or folder.

    Parameters
    ----------
    parts
        From the top of the project, e.g. ``"recipes", "herring_roe"``.

    Raises
    ------
    ConfigurationError
        It is not there: the installation is damaged.
    """
    package = Path(__file__).parents[1]
    for home in (package, package.parent):
        path = home.joinpath(*parts)
        if path.exists():
            return path
    raise ConfigurationError(
        f"{'/'.join(parts)} does not lie where roemetry is installed ({package})",
        hint="install roemetry again",
    )
