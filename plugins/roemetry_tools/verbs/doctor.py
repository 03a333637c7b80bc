"""``roemetry doctor``."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Annotated

import typer


def doctor(
    as_json: Annotated[
        bool,
        typer.Option(
            "--json",
            help="Print as JSON: a list of `what`, `verdict` (`ok`, `missing`, `wrong`), `found`, `remedy`.",
        ),
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Say what is installed and what is missing, and whether this machine gives the numbers it should.

    Exit code: 0 nothing is wrong (something optional may be missing); 2 something is.
    """
    from roemetry_tools.doctor import examine

    findings = []
    for finding in examine():
        findings.append(finding)
        if not as_json:
            _show(finding.what, finding.verdict, finding.found, finding.remedy)
    if as_json:
        typer.echo(json.dumps([asdict(finding) for finding in findings], indent=2))
    wrong = sum(finding.verdict == "wrong" for finding in findings)
    if wrong:
        if not as_json:
            typer.echo(f"{wrong} wrong")
        raise typer.Exit(2)
    if not as_json:
        typer.echo("all well")


def _show(what: str, verdict: str, found: str, remedy: str) -> None:
    mark = {"ok": "ok     ", "missing": "missing", "wrong": "WRONG  "}[verdict]
    typer.secho(mark, nl=False, fg={"ok": "green", "missing": "yellow", "wrong": "red"}[verdict])
    typer.echo(f"  {what}: {found}" + (f"\n           → {remedy}" if remedy else ""))
