"""Writing a study's report: report.html, results.json, cases.csv, figures and run.json, each whole or not at all."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path

from markupsafe import Markup
from matplotlib.figure import Figure

from workbench.errors import OutputError
from workbench.model.record import Record
from workbench.model.study import NamedEstimate, Study
from workbench.model.valve import Ideal
from workbench.report import draw_cascade, figures
from workbench.report.before_after import before_after_table
from workbench.report.cascade import cascade_lines, cascade_tables
from workbench.report.cascade_results import cascade_csv
from workbench.report.cascade_settings import cascade_site_table
from workbench.report.cycles import cycle_tables
from workbench.report.detections import detection_table, detection_words, first_with
from workbench.report.draw_map import map_figure
from workbench.report.estimates import candidates_table, estimate_table
from workbench.report.files import write_files
from workbench.report.how import how_tables
from workbench.report.interactive import Zoomable, zoomable
from workbench.report.known import known_sentences
from workbench.report.over_ensemble import (
    ensemble_tables,
    ensemble_text,
    front_table,
    front_text,
    named_points,
)
from workbench.report.plain_truth import map_points, map_text
from workbench.report.repair import repair_tables, repair_text, robust_repair_table, robust_repair_text
from workbench.report.results import cases_csv, results_json, run_json
from workbench.report.settings import site_table
from workbench.report.shared import loop_lines
from workbench.report.style import svg_text
from workbench.report.summary import summarise
from workbench.report.tables import case_tables, difference_table
from workbench.report.templating import environment, style_sheet
from workbench.report.trade import trade_figure
from workbench.report.words import join, rule_words, sentences, slug

__all__ = ["render", "write_report"]

DETAIL = 900  # samples of a longer record that a figure of its own shows from near


def write_report(study: Study, folder: Path | str, *, interactive: bool = False) -> None:
    """Write a study's report into `folder`, which is made where it is missing.

    interactive: the cases' figures in report.html, the map and the front can be zoomed (see `report.interactive`); the
    page is then 1.2 MiB and the data larger, and no longer the same to the byte.

    report.html, results.json, cases.csv and the figures are the same to the byte for the same study; run.json holds
    what changes (times, versions, machine). All content is made before the first file is touched, and every file is
    written beside its place and renamed: an interrupted run leaves the last good report. Figures of a former report
    that are no longer made are removed. Raises `OutputError` where the folder cannot be written.
    """
    drawn = _figures(study)
    files = {name: figures.svg_file(svg) for name, svg in drawn.items()}
    files["cases.csv"] = cascade_csv(study) if study.cascade else cases_csv(study)
    files["results.json"] = results_json(study)
    files["run.json"] = run_json(study)
    files["report.html"] = render(study, drawn, zoomable(study) if interactive and study.cases else None)
    write_files(files, Path(folder))
    _remove_former(Path(folder), files)


def _remove_former(folder: Path, kept: Collection[str]) -> None:
    """Remove the figures of a former report that are no longer made."""
    try:
        for old in folder.glob("*.svg"):
            if old.name not in kept and old.is_file() and _ours(old):
                old.unlink()
    except OSError as error:
        raise OutputError(f"{folder}: a former figure cannot be removed ({error.strerror or error})") from error


def _ours(path: Path) -> bool:
    with path.open("rb") as file:
        return figures.SVG_MARK.encode() in file.read(200)


def render(study: Study, drawn: Mapping[str, str], zoom: Zoomable | None) -> str:
    """Return report.html for a study and its figures (file name to `<svg>` element), all in one page.

    zoom: figures to take the place of the static ones where scripts run, or None.
    """
    return (
        environment()
        .get_template("report.html.j2")
        .render(
            study=study,
            css=style_sheet("report.css", *(["zoom.css"] if zoom is not None else [])),
            svg={name: Markup(text) for name, text in drawn.items()},  # noqa: S704 - matplotlib has escaped its text
            names=figure_names(study),
            zoom=zoom,
            summary=summarise(study),
            loop_lines=loop_lines(study),
            case_tables=case_tables(study),
            before_after_table=before_after_table(study),
            difference_table=difference_table(study),
            site_table=site_table(study),
            cycle_tables=cycle_tables(study),
            estimate_tables=[estimate_table(e) for e in study.estimates],
            known=[known_sentences(e.found) for e in study.estimates],
            candidates_tables=[candidates_table(e.found) for e in study.estimates],
            evidence=[_evidence(study, place) for place in range(len(study.estimates))],
            how=how_tables(study),
            cascade_lines=cascade_lines(study) if study.cascade else [],
            cascade_tables=cascade_tables(study) if study.cascade else [],
            cascade_site_table=cascade_site_table(study),
            ensemble_text=ensemble_text(study),
            ensemble_tables=ensemble_tables(study),
            front_text=front_text(study),
            front_table=None if study.front is None else front_table(study.front),
            robust_repair_text=robust_repair_text(study),
            robust_repair_table=robust_repair_table(study),
            map_text=[] if study.cycle_map is None else map_text(study.cycle_map),
            repair_tables=repair_tables(study),
            repair_text=repair_text(study),
            rules=[(c.name, rule_words(c.rule)) for c in study.cases if c.rule is not None],
            agreements=_agreements(study),
            seeds=_seeds(study),
            sentences=sentences,
        )
    )


def _evidence(study: Study, place: int) -> dict[str, object] | None:
    """Return what the page says of an estimate's detection: once for each record."""
    named = study.estimates[place]
    if named.detection is None:
        return None
    earlier = first_with(study.estimates, place)
    if earlier:
        return {"earlier": earlier}
    found = named.detection
    return {
        "earlier": "",
        "words": detection_words(named, found),
        "reasons": [text for text in found.reasons if text not in named.found.reasons],
        "table": detection_table(found),
    }


def _agreements(study: Study) -> list[tuple[str, str]]:
    """Return (cases, sentence) on describing function and exact simulation, each sentence once."""
    told = dict.fromkeys(c.agreement for c in study.cases if c.agreement)
    return [(join([c.name for c in study.cases if c.agreement == text]), text) for text in told]


def _seeds(study: Study) -> str:
    noise = None if study.experiment is None else study.experiment.noise
    parts = ["no noise was drawn" if noise is None else f"noise {noise.seed}"]
    searched = [(case.name, case.tuned) for case in study.cases]
    searched += [(case.name, None if case.tuned is None else case.tuned.primary) for case in study.cascade]
    for name, tuned in searched:
        if tuned is not None:
            many = len(tuned.restarts)
            searches = f" ({many} searches)" if many > 1 else ""
            parts.append(f"search of {name} {tuned.seed}{searches}")
    return "; ".join(parts)


def figure_names(study: Study) -> dict[str, list[dict[str, str]]]:
    """Return the figures' file names: for each case trend and pv_op, for each estimate those that it has."""
    taken: set[str] = set()
    cases = []
    for case in study.cases:
        stem = slug(case.name, taken)
        cases.append({"trend": f"trend_{stem}.svg", "pv_op": f"pv_op_{stem}.svg"})
    taken = set()
    estimates = []
    for place, named in enumerate(study.estimates):
        stem = slug(named.name, taken)
        names = {"fit": f"estimate_{stem}.svg"}
        if not isinstance(named.found.valve, Ideal):
            names["linear"] = f"linear_fit_{stem}.svg"
        if "linear" in names or named.found.record.valve_position is not None:
            names["stem"] = f"op_stem_{stem}.svg"
        if _detail(named.found.record) is not None:
            names["detail"] = f"detail_{stem}.svg"
        if named.found.profile_d.size > 1:
            names["profile"] = f"profile_{stem}.svg"
        if len(named.found.iterations) > 1:
            names["convergence"] = f"convergence_{stem}.svg"
        evidence = named.detection
        if evidence is not None and not first_with(study.estimates, place):
            if evidence.test is not None:
                names |= {"autocorrelation": f"autocorrelation_{stem}.svg", "ellipse": f"ellipse_{stem}.svg"}
            if evidence.bicoherence is not None:
                names["bicoherence"] = f"bicoherence_{stem}.svg"
        estimates.append(names)
    taken = set()
    stems = [slug(case.name, taken) for case in study.cascade]
    both = [{kind: f"{kind}_{stem}.svg" for kind in ("trend", "pv_op", "cycle")} for stem in stems]
    return {"cases": cases, "estimates": estimates, "cascade": both}


def _detail(record: Record) -> tuple[float, float] | None:
    """Return the middle stretch (s) of a record too long to be read in one figure, or None."""
    n = len(record)
    if n <= 2 * DETAIL:
        return None
    first = (n - DETAIL) // 2
    return float(record.time[first]), float(record.time[first + DETAIL])


def _figures(study: Study) -> dict[str, str]:
    """Return every figure as an `<svg>` element by its file name."""
    out: dict[str, str] = {}

    def add(name: str, figure: Figure, title: str) -> None:
        out[name] = svg_text(figure, name.removesuffix(".svg"), title)

    names = figure_names(study)
    if len(study.cases) > 1:
        add("overlay.svg", figures.overlay_figure(study.cases), "PV and valve position of all cases")
    for case, own in zip(study.cases, names["cases"], strict=True):
        add(own["trend"], figures.trend_figure(case.run), f"{case.name}: PV, SP, OP and valve against time")
        add(own["pv_op"], figures.pv_op_figure(case.run), f"{case.name}: PV and valve position against OP")
    analysed = [(c.name, c.describing_function) for c in study.cases if c.describing_function is not None]
    if analysed:
        add("frequency.svg", figures.frequency_figure(analysed), "L(jω) and −1/N(A) in the complex plane")
    if study.front is not None and study.front.sticky:
        title = "Mean square error against mean valve travel over the ensemble"
        add("tradeoff.svg", trade_figure(study.front, named_points(study)), title)
    if study.cycle_map is not None:
        title = "Late period, PV swing, mean square error and valve travel over a plane of tunings"
        add("map.svg", map_figure(study.cycle_map, map_points(study)), title)
    for result, own in zip(study.cascade, names["cascade"], strict=True):
        add(own["trend"], draw_cascade.trend_figure(result.run), f"{result.name}: both loops against time")
        add(own["pv_op"], draw_cascade.pv_op_figure(result.run), f"{result.name}: PV against output of each loop")
        late = None if result.cycle is None else draw_cascade.cycle_figure(result.cycle)
        if late is not None:
            add(own["cycle"], late, f"{result.name}: the cycle in both loops, without noise")
    for named, own in zip(study.estimates, names["estimates"], strict=True):
        _estimate_figures(named, own, add)
    return out


def _estimate_figures(named: NamedEstimate, own: Mapping[str, str], add: object) -> None:
    assert callable(add)  # noqa: S101
    found, name = named.found, named.name
    add(
        own["fit"],
        figures.estimate_figure(found, name),
        f"{name}: PV with prediction, OP with estimated valve position",
    )
    window = _detail(found.record)
    if window is not None:
        add(own["detail"], figures.estimate_figure(found, name, window), f"{name}: a stretch of the same from near")
    if "linear" in own:
        add(
            own["linear"],
            figures.linear_fit_figure(found, name, window),
            f"{name}: PV with the prediction of the model, and of the fit that ignores stiction",
        )
    if "stem" in own:
        add(own["stem"], figures.op_stem_figure(found, name), f"{name}: PV and valve position against OP")
    if "profile" in own:
        add(own["profile"], figures.profile_figure(found, name), f"{name}: AIC against d")
    if "convergence" in own:
        add(own["convergence"], figures.convergence_figure(found, name), f"{name}: convergence of the two-step method")
    evidence = named.detection
    if evidence is not None and "autocorrelation" in own:
        add(own["autocorrelation"], figures.autocorrelation_figure(evidence, name), f"{name}: autocorrelation of PV")
        add(own["ellipse"], figures.apparent_stiction_figure(evidence), f"{name}: PV against OP with the ellipse")
    if evidence is not None and "bicoherence" in own:
        add(own["bicoherence"], figures.bicoherence_figure(evidence), f"{name}: squared bicoherence of SP − PV")
