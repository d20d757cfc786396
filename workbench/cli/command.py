"""The `workbench` command: reads arguments, calls the verbs, prints. Heavy libraries load in the commands alone."""

from __future__ import annotations

import functools
import gc
import io
import os
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from workbench import __version__
from workbench.cli import compare, fleet, ui
from workbench.cli.compiling import tell_compiling
from workbench.cli.input import Reading, in_options, limit, quantity, read_data, scenario_of, span, weights_of
from workbench.errors import InvalidValue, OutputError, ScenarioError, WorkbenchError

if TYPE_CHECKING:
    from workbench.model.results import Estimate
    from workbench.model.study import Study
    from workbench.scenario.plan import Scenario

__all__ = ["app", "main"]

BAD_INPUT, FAILED, INTERRUPTED = 2, 1, 130

app = typer.Typer(
    name="workbench",
    help="Estimate, simulate, analyze and tune control loops whose valve sticks.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)

Progress = Callable[[str, float], None]


def main() -> None:
    """Run the command: exit code 0, 1 for a solve that failed, 2 for bad input, 130 when interrupted."""
    try:
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, io.TextIOWrapper):
                stream.reconfigure(errors="replace")
        gc.set_threshold(20_000, 50, 50)  # what a command makes lasts to its end: collecting took 0.4 s of table_2
        app()
    except KeyboardInterrupt:
        code = INTERRUPTED
        sys.stderr.write("workbench: interrupted\n")
    except SystemExit as end:
        # Typer ends an interrupt that comes before a command does, without a word.
        if end.__context__ is not None and isinstance(end.__context__.__cause__, KeyboardInterrupt):
            sys.stderr.write("workbench: interrupted\n")
        raise
    except OSError as error:
        # Such as a full disk where the output goes; what is left of it must not be tried again at the end.
        code = FAILED
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.stderr.write(f"workbench: the output cannot be written ({error.strerror or error})\n")
    else:
        return
    sys.exit(code)


def guarded(command: Callable[..., int]) -> Callable[..., None]:
    """Turn a command's returned code, and the errors that a user can mend, into the exit code and one clear message."""

    @functools.wraps(command)
    def run(*args: Any, **kwargs: Any) -> None:
        try:
            code = command(*args, **kwargs)
        except ScenarioError as error:
            typer.echo(str(error), err=True)
            code = BAD_INPUT
        except WorkbenchError as error:
            typer.echo(f"workbench: {error}", err=True)
            code = BAD_INPUT
        except (Exception, KeyboardInterrupt) as error:
            # A compiled library may pass Ctrl-C on in an error of its own.
            if not _interrupted(error):
                raise
            typer.echo("workbench: interrupted; the last complete report is left as it was", err=True)
            code = INTERRUPTED
        if code:
            raise typer.Exit(code)

    return run


def _interrupted(error: BaseException | None) -> bool:
    """Whether Ctrl-C is what led to an error, as its cause or in its words."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        if KeyboardInterrupt.__name__ in str(error):
            return True
        error = error.__cause__ or error.__context__
    return error is not None


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"workbench {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Estimate, simulate, analyze and tune control loops whose valve sticks."""


@app.command()
@guarded
def run(
    scenarios: Annotated[list[Path], typer.Argument(metavar="SCENARIO", help="Scenario files (YAML).")],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Where the reports go.")] = Path("reports"),
    interactive: Annotated[
        bool, typer.Option("--interactive", help="Figures in the page can be zoomed; it is 1.2 to 2 MiB larger.")
    ] = False,
) -> int:
    """Run scenarios and write DIR/<scenario>/report.html with its figures, results.json and cases.csv.

    All files are checked before anything runs. A manifest of loops is run as `workbench fleet` runs it.
    """
    sites, others = fleet.parted(scenarios)
    plans = _checked(others)
    names = [*sites, *(plan.name for plan in plans)]
    for name in names:
        if names.count(name) > 1:
            raise InvalidValue("SCENARIO", f"{names.count(name)} files named {name}", "must differ, as reports do")
    for name in names:
        _writable(out / name)
    from workbench.report.page import write_report
    from workbench.scenario.runner import run_scenario

    code = 0
    for plan in plans:
        with _progress() as progress:
            study = run_scenario(plan, progress=progress)
            write_report(study, out / plan.name, interactive=interactive)
        _print_study(study)
        for warning in plan.mistakes:
            typer.echo(f"Warning: {warning}", err=True)
        for name, tuned in study.tunings:
            if not tuned.status.success:
                typer.echo(f"{name}: {tuned.status.value}: {tuned.message}", err=True)
                code = FAILED
        typer.echo(f"Report: {out / plan.name / 'report.html'}")
    for name, sources in sites.items():
        code = max(code, fleet.run_site(sources, out / name))
    return code


@app.command()
@guarded
def check(
    files: Annotated[list[Path], typer.Argument(metavar="FILE", help="Scenario files (YAML).")],
) -> int:
    """Check scenario files, and the data that they name, without running them."""
    sites, others = fleet.parted(files)
    # As the run would end: done, or with loops that failed.
    code = max((fleet.check_site(sources) for sources in sites.values()), default=0)
    for plan in _checked(others):
        parts = [
            f"{len(items)} {word}{'' if len(items) == 1 else 's'}"
            for items, word in ((plan.estimates, "estimate"), (plan.cases, "case"), (plan.cascade, "cascade case"))
            if items
        ]
        typer.echo(f"{plan.path}: ok ({', '.join(parts)})")
        for warning in plan.mistakes:
            typer.echo(f"{plan.path}: warning: {warning}", err=True)
    return code


@app.command()
@guarded
def schema() -> int:
    """Print the JSON Schema of scenario files, for editors."""
    from importlib.resources import files

    typer.echo(files("workbench.scenario").joinpath("schema.json").read_text(encoding="utf-8"), nl=False)
    return 0


METHOD = typer.Option("--method", help="profile (global), joint (that, refined), two_step, complementarity.")
VALVE = typer.Option("--valve", help="Valve model: auto, linear, stenman, choudhury or deadband.")
PLANT = typer.Option("--plant", help="Plant model: fopdt, integrating, or auto: the one that PV shows.")
COLUMN = typer.Option("--column", metavar="SIGNAL=NAME", help="Which column is SP, PV, OP, MODE, time, valve_position.")
TAG = typer.Option("--tag", metavar="SIGNAL=NAME", help="The same for the tags of a historian's tall export.")
SAMPLE_TIME = typer.Option("--sample-time", metavar="TIME", help='Where the data has no even times, such as "5 s".')
PV_RANGE = typer.Option("--pv-range", metavar="LOW:HIGH", help="Of the transmitter, EU; values beyond are left out.")
OP_RANGE = typer.Option("--op-range", metavar="LOW:HIGH", help="What the data calls 0 and 100 % of OP, such as 4:20.")
MAX_GAP = typer.Option("--max-gap", metavar="TIME", help="The longest time without a value that is bridged.")


@app.command()
@guarded
def estimate(
    data: Annotated[Path, typer.Argument(metavar="DATA", help="A loop's record (CSV or Parquet): PV, OP, time.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON; files only with --out.")] = False,
    method: Annotated[str, METHOD] = "profile",
    valve: Annotated[str, VALVE] = "auto",
    plant: Annotated[str, PLANT] = "auto",
    start: Annotated[str | None, typer.Option("--start", help="Initial stiction of two_step, %.")] = None,
    column: Annotated[list[str] | None, COLUMN] = None,
    tag: Annotated[list[str] | None, TAG] = None,
    sample_time: Annotated[str | None, SAMPLE_TIME] = None,
    pv_range: Annotated[str | None, PV_RANGE] = None,
    op_range: Annotated[str | None, OP_RANGE] = None,
    max_gap: Annotated[str | None, MAX_GAP] = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Where figure and CSV go (default: reports).")
    ] = None,
) -> int:
    """Estimate plant and stiction from a record: model, interval, verdict, stem position and a figure."""
    from workbench.cli import output
    from workbench.scenario import units

    how = How(method, valve, plant, None if start is None else quantity("--start", start, units.percent))
    folder = None if as_json and out is None else (out or Path("reports")) / f"{data.stem}_estimate"
    if folder is not None:
        _writable(folder)
    with _progress() as progress:
        reading = Reading(column, tag, sample_time, pv_range, op_range, max_gap)
        found = _found(data, reading, how, progress)
        written = output.write_estimate(found, folder) if folder is not None else []
    if as_json:
        typer.echo(output.estimate_json(found), nl=False)
    else:
        for line in output.estimate_lines(found):
            typer.echo(line)
        for path in written:
            typer.echo(f"Written: {path}")
    return 0


@app.command()
@guarded
def tune(
    source: Annotated[Path, typer.Argument(metavar="SCENARIO|DATA", help="A scenario (.yaml) or a loop's record.")],
    objective: Annotated[
        str | None, typer.Option("--objective", metavar="WEIGHTS", help="Such as w1=0.5,w3=0.5,w4=0.05.")
    ] = None,
    Kc: Annotated[str | None, typer.Option("--Kc", metavar="LOW:HIGH", help="Bounds of the gain, %/EU.")] = None,
    Ti: Annotated[str | None, typer.Option("--Ti", metavar="LOW:HIGH", help='Bounds, such as "5 s:10 min".')] = None,
    Td: Annotated[str | None, typer.Option("--Td", metavar="LOW:HIGH", help='Bounds; "0" for PI.')] = None,
    seed: Annotated[int | None, typer.Option("--seed", min=0, help="Of the global search.")] = None,
    step: Annotated[float | None, typer.Option("--step", help="Setpoint step to tune a record's loop for, EU.")] = None,
    duration: Annotated[
        str | None, typer.Option("--duration", metavar="TIME", help="How long, to tune a record's loop for.")
    ] = None,
    action: Annotated[
        str | None, typer.Option("--action", help="reverse or direct; by default as the estimated gain needs.")
    ] = None,
    max_sensitivity: Annotated[
        str | None, typer.Option("--max-sensitivity", metavar="MS", help="Of a record's loop: 2 by default, or none.")
    ] = None,
    method: Annotated[str, METHOD] = "profile",
    valve: Annotated[str, VALVE] = "auto",
    plant: Annotated[str, PLANT] = "auto",
    column: Annotated[list[str] | None, COLUMN] = None,
    tag: Annotated[list[str] | None, TAG] = None,
    sample_time: Annotated[str | None, SAMPLE_TIME] = None,
    pv_range: Annotated[str | None, PV_RANGE] = None,
    op_range: Annotated[str | None, OP_RANGE] = None,
    max_gap: Annotated[str | None, MAX_GAP] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> int:
    """Tune a scenario's loop, or the loop estimated from a record, and print the settings to type in."""
    from workbench.cli import output
    from workbench.scenario import retune, units

    wishes = retune.Wishes(
        objective=None if objective is None else weights_of(objective),
        Kc=None if Kc is None else span("--Kc", Kc, units.bare),
        Ti=None if Ti is None else span("--Ti", Ti, units.integral_time),
        Td=None if Td is None else span("--Td", Td, units.time),
        seed=seed,
        step=step,
        duration=None if duration is None else quantity("--duration", duration, units.time),
        action=action,
        max_sensitivity=None if max_sensitivity is None else limit("--max-sensitivity", max_sensitivity),
    )
    with _progress() as progress:
        if source.suffix.lower() in (".yaml", ".yml"):
            results = retune.tune_scenario(_checked([source])[0], wishes, progress)
        else:
            reading = Reading(column, tag, sample_time, pv_range, op_range, max_gap)
            found = _found(source, reading, How(method, valve, plant), progress)
            results = [retune.tune_found(found, wishes, progress)]
    code = 0
    if as_json:
        typer.echo(output.tuned_json(results), nl=False)
    for result in results:
        if not as_json:
            for line in output.tuned_lines(result):
                typer.echo(line)
        code = max(code, output.exit_code(result.tuned.status))
    if code == INTERRUPTED:
        typer.echo("workbench: interrupted; the best found so far is shown", err=True)
    return code


@app.command()
@guarded
def score(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Records and labels.csv (file,label[,tag]).")],
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Where score.json goes (default: DIR).")
    ] = None,
) -> int:
    """Estimate every labelled record of a folder and score the verdicts: accuracy, confusion, each loop."""
    from rich.console import Console

    from workbench import score as scoring
    from workbench.cli import output

    lines = scoring.labelled(folder)
    target = folder if out is None else out
    _writable(target)
    with _progress() as progress:
        scored = scoring.score(lines, progress)
    content = scoring.score_content(scored)
    console = Console(width=None if sys.stdout.isatty() else 140, highlight=False, markup=False)
    for part in output.score_parts(scored, content):
        console.print(part)
    typer.echo(f"Written: {scoring.write_score(content, target)}")
    return 0


app.command()(guarded(compare.compare))
app.command()(guarded(fleet.fleet))
app.command("fleet-demo")(guarded(fleet.fleet_demo))
app.command()(guarded(ui.ui))


# arguments ---------------------------------------------------------------------------------------------------------


def _checked(files: Sequence[Path]) -> list[Scenario]:
    """Return the scenarios of all files, or raise one `ScenarioError` that says what is wrong with any of them."""
    plans, wrong = [], []
    for file in files:
        try:
            plans.append(scenario_of(file))
        except ScenarioError as error:
            wrong.append(str(error))
    if wrong:
        raise ScenarioError("\n".join(wrong))
    return plans


CHOICES = {
    "method": ("profile", "joint", "two_step", "complementarity"),
    "valve": ("auto", "linear", "stenman", "choudhury", "deadband"),
    "plant": ("fopdt", "integrating", "auto"),
}


@dataclass(frozen=True, slots=True)
class How:
    """How a record is to be estimated, by the options of their names; start: %, or None."""

    method: str
    valve: str
    plant: str
    start: float | None = None

    def __post_init__(self) -> None:
        for option, allowed in CHOICES.items():
            if getattr(self, option) not in allowed:
                raise InvalidValue(f"--{option}", getattr(self, option), "must be one of " + ", ".join(allowed))


def _found(data: Path, reading: Reading, how: How, progress: Progress) -> Estimate:
    """Return the estimate of a data file."""
    from workbench.estimate.estimate import estimate as estimate_record

    with in_options():
        return estimate_record(
            read_data(data, reading),
            method=how.method,
            valve=how.valve,
            plant=how.plant,
            start=how.start,
            progress=functools.partial(progress, "estimate"),
        )


def _writable(folder: Path) -> None:
    """Raise `OutputError` unless files can be made in `folder`; leaves no trace."""
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise OutputError(f"{folder}: cannot be written ({reason}); give another folder with --out") from None
    finally:
        for path in made:
            try:
                path.rmdir()
            except OSError:
                break


# output ------------------------------------------------------------------------------------------------------------


def _silent(words: str, share: float) -> None:
    """Tell nobody."""


@contextmanager
def _progress() -> Iterator[Progress]:
    """Show a progress bar on stderr while it is a terminal; else say nothing but that kernels compile."""
    tell_compiling()
    if not sys.stderr.isatty():
        yield _silent
        return
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        console=Console(stderr=True),
        transient=True,
    )
    with bar:
        task = bar.add_task("", total=1.0)
        yield lambda words, share: bar.update(task, description=escape(words), completed=share)


def _print_study(study: Study) -> None:
    """Print one scenario's cases and estimates as a short table."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from workbench.report.words import figure, parameter

    width = None if sys.stdout.isatty() else 120
    console = Console(width=width, highlight=False, markup=False)
    console.print(Text(study.title, style="bold"))
    for named in study.estimates:
        from workbench.report.estimates import estimate_sentences

        for sentence in estimate_sentences(named):
            console.print(Text(sentence))
    if study.cascade:
        from workbench.report.summary import summarise

        # Mistakes are told as warnings.
        summary = summarise(replace(study, mistakes=()))
        for sentence in (*summary.found, *summary.advice):
            console.print(Text(sentence))
    if not study.cases:
        return
    table = Table(box=None, pad_edge=False)
    table.add_column("case", overflow="fold")
    costs = [] if study.objective is None else ["J"]
    for title in ("Kc", "Ti, s", "Td, s", "error variance", "valve travel, %", *costs):
        table.add_column(title, justify="right")
    for case in study.cases:
        pid, converted = case.loop.controller, case.unrounded is not None
        table.add_row(
            Text(case.name),
            *(parameter(value, case.digits, converted=converted) for value in (pid.Kc, pid.Ti, pid.Td)),
            figure(case.run.kpis.error_variance),
            figure(case.run.kpis.valve_travel),
            *([] if case.objective is None else [figure(case.objective, 5)]),
        )
    console.print(table)
