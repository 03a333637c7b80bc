"""A folder to begin with: a shipped product line's, or one for an own product and an own rig."""

from roemetry_tools.init_project.answers import Answers, Layout, lay_out
from roemetry_tools.init_project.folder import Started, start_like, start_own
from roemetry_tools.init_project.product_lines import shipped_lines

__all__ = ["Answers", "Layout", "Started", "lay_out", "shipped_lines", "start_like", "start_own"]
