"""New plugins: an installable package with a working stage and its tests."""

from roemetry_tools.init_plugin.plugin import TEMPLATES, new_plugin

__all__ = ["TEMPLATES", "new_plugin"]
