"""The `workbench fleet` and `workbench fleet-demo` commands: options, progress, and what is printed."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from workbench.cli.input import in_options, quantity
from workbench.errors import InvalidValue, OutputError

if TYPE_CHECKING:
    from workbench.fleet.loops import Sources
    from workbench.fleet.pool import Limits
    from workbench.fleet.run import Outcome
    from workbench.model.fleet import Settings

__all__ = ["fleet", "fleet_demo", "parted", "run_site"]

FAILED, INTERRUPTED = 1, 130

Source = Annotated[
    Path,
    typer.Argument(metavar="SOURCE", help="A folder of records, a file of many loops, or a manifest (.yaml, .csv)."),
]
Out = Annotated[Path, typer.Option("--out", metavar="DIR", help="Where the report and the rows go.")]


def fleet(
    source: Source,
    out: Out,
    depth: Annotated[
        str | None, typer.Option("--depth", help="screen (default), estimate (adds models) or tune (adds tunings).")
    ] = None,
    workers: Annotated[int | None, typer.Option("--workers", help="Processes (default: one for a processor).")] = None,
    scheduler: Annotated[
        str | None, typer.Option("--scheduler", metavar="ADDRESS", help="A Dask scheduler, such as tcp://host:8786.")
    ] = None,
    begin: Annotated[
        str | None,
        typer.Option(
            "--from",
            metavar="TIME",
            help="By each record's own clock, as 2024-10-17T06:00, or at a zone's, as 2024-10-17T06:00+02:00.",
        ),
    ] = None,
    end: Annotated[str | None, typer.Option("--to", metavar="TIME", help="The end of the window of time.")] = None,
    last: Annotated[str | None, typer.Option("--last", metavar="TIME", help='Of each record, such as "8 h".')] = None,
    include: Annotated[
        list[str] | None, typer.Option("--include", metavar="PATTERN", help="Loops by name, such as 'FIC*'.")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with an interrupted run in DIR.")] = False,
    previous: Annotated[
        Path | None, typer.Option("--previous", metavar="DIR", help="An earlier run, to tell what changed.")
    ] = None,
    time_limit: Annotated[str, typer.Option("--time-limit", metavar="TIME", help="For one loop.")] = "300 s",
    memory_limit: Annotated[float, typer.Option("--memory-limit", metavar="MIB", help="For one worker.")] = 1024.0,
) -> int:
    """Screen every loop of a site, rank them, and say which valves to repair and which loops to tune."""
    from workbench.fleet.pool import Limits
    from workbench.fleet.source import only, sources_of
    from workbench.model.fleet import Settings
    from workbench.scenario import units

    sources = only(sources_of(source), include or [])
    first = None if begin is None else _time("--from", begin)
    final = None if end is None else _time("--to", end)
    zoned = {at.tzinfo is not None for at in (first, final) if at is not None}
    if len(zoned) > 1:
        raise InvalidValue("--to", end, f"must have a zone as --from ({begin}) has, or neither")
    settings = Settings(
        depth or sources.depth or "screen",
        None if first is None else _seconds(first),
        None if final is None else _seconds(final),
        None if last is None else quantity("--last", last, units.time),
        True in zoned,
    )
    limits = Limits(quantity("--time-limit", time_limit, units.time), memory_limit)
    return _run(sources, out, settings, limits, workers, scheduler, resume, previous)


def parted(files: Sequence[Path]) -> tuple[dict[str, Sources], list[Path]]:
    """Return the manifests among YAML files, read, by their names, and the other files, which are scenarios."""
    from workbench.fleet.manifest import is_manifest, read_manifest

    ours = [path for path in files if is_manifest(path)]
    sites = {path.stem: read_manifest(path) for path in ours}
    if len(sites) < len(ours):
        raise InvalidValue("SCENARIO", ", ".join(str(path) for path in ours), "must differ in name, as reports do")
    return sites, [path for path in files if path not in ours]


def check_site(sources: Sources) -> int:
    """Read a manifest's loops and say which ones a run would refuse; return the exit code, 1 where there are such."""
    from workbench.fleet.task import checked
    from workbench.model.numbers import counted

    refused: list[str] = []
    warned: list[str] = []
    with _progress() as show:
        for done, loop in enumerate(sources.loops, 1):
            refusal, warning = checked(loop)
            refused += [f"{loop.name}: {refusal}"] if refusal else []
            warned += [f"{loop.name}: warning: {warning}"] if warning else []
            show(done, len(sources.loops), len(refused))
    loops = counted(len(sources.loops), "loop")
    typer.echo(f"{sources.shown}: " + (f"{len(refused)} of {loops} cannot be read" if refused else f"ok ({loops})"))
    for line in (*refused, *warned):
        typer.echo(f"{sources.shown}: {line}", err=True)
    return 1 if refused else 0


def run_site(sources: Sources, out: Path) -> int:
    """Run a manifest's loops as `workbench run` does: with its own depth and the defaults of everything else."""
    from workbench.fleet.pool import Limits
    from workbench.model.fleet import Settings

    return _run(sources, out, Settings(sources.depth or "screen"), Limits(), None, None, False, None)


def _run(
    sources: Sources,
    out: Path,
    settings: Settings,
    limits: Limits,
    workers: int | None,
    scheduler: str | None,
    resume: bool,
    previous: Path | None,
) -> int:
    from workbench.fleet.pool import processors
    from workbench.fleet.run import run_fleet

    if workers is not None and not 1 <= workers <= 1024:
        raise InvalidValue("--workers", workers, "must be 1 to 1024")
    if workers is not None and scheduler is not None:
        raise InvalidValue("--workers", workers, "is for this machine; a Dask cluster has its own workers")
    started = False

    def tell(done: int, total: int, failed: int) -> None:
        nonlocal started
        started = True
        show(done, total, failed)

    try:
        with _progress() as show:
            outcome = run_fleet(
                sources,
                out,
                settings,
                limits=limits,
                workers=workers or processors(),
                scheduler=scheduler,
                resume=resume,
                previous=previous,
                progress=tell,
            )
    except OutputError as error:
        if not started:
            raise
        typer.echo(f"workbench: {error}; rows found so far are in {out}: go on with --resume", err=True)
        return FAILED
    except KeyboardInterrupt:
        typer.echo(f"workbench: interrupted; rows found so far are in {out}: go on with --resume", err=True)
        return INTERRUPTED
    for line in (*sources.notes, *_lines(outcome, out)):
        typer.echo(line)
    return FAILED if outcome.site.failures else 0


def _lines(outcome: Outcome, out: Path) -> Iterator[str]:
    from workbench.model.numbers import counted, figure

    site = outcome.site
    if outcome.dropped:
        yield f"An unfinished run in {out} was begun anew (--resume would have gone on with it)"
    if outcome.resumed:
        yield f"{counted(outcome.resumed, 'loop')} had been looked at before"
    sticky = [row for row in site.rows if row.sticks]
    many = len(site.looked_at)
    fresh = many + len(site.failures) - outcome.resumed
    took = f" in {outcome.seconds:.1f} s ({fresh / max(outcome.seconds, 1e-9):.1f} a second)" if fresh else ""
    yield (
        f"{counted(many, 'loop')} looked at{took}: "
        f"{counted(sum(row.oscillates for row in site.looked_at), 'oscillates', 'oscillate')}, "
        f"{counted(len(sticky), 'shows', 'show')} stiction, "
        f"{counted(len(site.groups), 'group oscillates', 'groups oscillate')} together"
    )
    for row in sticky[:5]:
        cycle = f", period {figure(row.period / 60.0, 3)} min" if row.oscillates else ""
        yield f"  {row.name}: stiction {figure(row.stiction, 3)} %{' (a hint)' if row.vague else ''}{cycle}"
    for row in site.failures[:5]:
        yield f"  {row.name}: not looked at: {row.reason}"
    if len(site.failures) > 5:
        yield f"  and {len(site.failures) - 5} more not looked at"
    yield f"Written: {out / 'report.html'}, fleet.csv, fleet.parquet"


def fleet_demo(
    out: Out,
    loops: Annotated[int, typer.Option("--loops", help="How many.")] = 20,
    hours: Annotated[float, typer.Option("--hours", help="Of data at 1 s.")] = 24.0,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the site.")] = 0,
) -> int:
    """Write a synthetic site of known truth, to try `workbench fleet` on: tall Parquet, and _truth.csv beside it."""
    from workbench.fleet.demo import write_site
    from workbench.model.numbers import counted

    with in_options(), _progress() as show:
        truths = write_site(out, loops, hours, seed, lambda share: show(round(share * loops), loops, 0))
    sticky = sum(truth.kind == "sticky" for truth in truths)
    typer.echo(
        f"Written: {out}, {counted(loops, 'loop')}, {sticky} with a valve that sticks; "
        f"now: workbench fleet {out} --out DIR"
    )
    return 0


def _time(option: str, text: str) -> datetime:
    """Return a time of the window as it is given, with or without a zone."""
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        raise InvalidValue(option, text, "must be a time such as 2024-10-17T06:00 or 2024-10-17") from None


def _seconds(at: datetime) -> float:
    """Return a time as s since 1970, of the same clock where it has no zone."""
    return (at if at.tzinfo is not None else at.replace(tzinfo=UTC)).timestamp()


def _silent(done: int, total: int, failed: int) -> None:
    """Tell nobody."""


@contextmanager
def _progress() -> Iterator[Callable[[int, int, int], None]]:
    """Show loops done, rate, remaining time and failures on stderr while it is a terminal."""
    if not sys.stderr.isatty():
        yield _silent
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    bar = Progress(
        TextColumn("loops"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[failed]}"),
        console=Console(stderr=True),
        transient=True,
    )
    with bar:
        task = bar.add_task("", total=None, rate="", failed="")

        def show(done: int, total: int, failed: int) -> None:
            speed = bar.tasks[0].speed
            rate = f"{speed:.1f}/s" if speed else ""
            words = f"{failed} failed" if failed else ""
            bar.update(task, completed=done, total=total, rate=rate, failed=words)

        yield show
