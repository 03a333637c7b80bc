"""``python -m roemetry``."""

from roemetry.cli.main import main

main()
