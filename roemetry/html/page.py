"""Templates of pages: escaped, strict, each package's own beside the common style."""

from __future__ import annotations

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

from roemetry.html.plots import in_words, plain, share


def environment_of(package: str) -> Environment:
    """Give the environment for a package's ``templates`` folder; ``page.css`` is the common style.

    Everything is escaped: templates' names end in ``j2``, so jinja2 would not see that they are HTML.
    """
    environment = Environment(
        loader=ChoiceLoader(
            [PackageLoader(package, "templates"), PackageLoader("roemetry.html", "templates")]
        ),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"plain": plain, "share": share, "zip": zip, "in_words": in_words}
    return environment
