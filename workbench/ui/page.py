"""The page of one session: what the browser asks for, done to the session's state, and what is shown of it.

Browser and server speak through one model of two texts: `up`, a request as JSON, and `down`, the answer. Figures are
Bokeh's own. Every answer names the request that it answers, so that the browser has one under way at a time.
"""

from __future__ import annotations

import base64
import binascii
import json
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from bokeh.core.properties import String
from bokeh.document import Document
from bokeh.model import DataModel

from workbench.errors import InvalidValue, RecordError, WorkbenchError
from workbench.ui import export
from workbench.ui.draw import positive
from workbench.ui.fields import FIELDS
from workbench.ui.figures import MAP_FIGURES, Pictures
from workbench.ui.frequency import map_key, tuning_key, verdicts
from workbench.ui.given import found_words, record_words, safe_name
from workbench.ui.jobs import Event, Job
from workbench.ui.load import Loaded, bounds_entries, controller_entries
from workbench.ui.screen import estimate_text
from workbench.ui.state import Session, unplaced
from workbench.ui.work import Found, FrontFound, MapFound, ReadRecord, Report, TunedCase

__all__ = ["LARGEST_UPLOAD", "VIEWS", "Page"]

VIEWS = ("loop", "compare", "estimate", "tune", "frequency", "export")
LARGEST_UPLOAD = 16 << 20  # bytes of a file; a day of SP, PV, OP and MODE at 1 s takes a third of it
LARGEST_SCENARIO = 1 << 20
LONGEST = 400  # characters of a line that can be typed
WORDS = {
    "read": "Reading",
    "estimate": "Estimating",
    "tune": "Tuning",
    "map": "Mapping",
    "front": "Searching the front",
    "report": "Writing the report",
}


OF_ONE_LOOP = ("suit_bounds", "map", "front", "tap")


class Bridge(DataModel):  # type: ignore[misc]
    """What goes up from the browser and comes down to it, as JSON."""

    up = String(default="")
    down = String(default="")


class Page:
    """One session's page. `send` takes the answers; requests come by `ask`."""

    def __init__(self, document: Document, loaded: Loaded | None, data: Path | None) -> None:
        self.document = document
        self.session = Session(loaded)
        self.pictures = Pictures()
        self.bridge = Bridge()
        self.view = "loop"
        self._own = tempfile.TemporaryDirectory(prefix="workbench-ui-")  # removed at the latest when the program ends
        self.folder = Path(self._own.name)
        self.job: Job | None = None
        self.task = ""
        self.data = ""
        self.waits = ""  # a record that is read as soon as the task under way has ended
        self.record: ReadRecord | None = None
        self.found: Found | None = None
        self.tuned: TunedCase | None = None
        self.tuned_of: object = None
        self.map: MapFound | None = None
        self.map_of: object = None
        self.map_figure = "period"
        self.front: FrontFound | None = None
        self.front_of: object = None
        self.asked_of: object = None  # what stood on the screen when the task under way was asked for
        self.sent = 0
        self.message = ""
        self.bridge.on_change("up", lambda _attr, _old, new: self.ask(new))
        if self.session.own is not None:
            self.pictures.show_run(self.session.own)
        if data is not None:
            self.view = "estimate"
            self._take(data)

    def close(self) -> None:
        """End what is under way and remove what was uploaded."""
        if self.job is not None:
            self.job.kill()
        self._own.cleanup()

    # requests ------------------------------------------------------------------------------------------------------

    def ask(self, text: str) -> None:
        """Do what a request asks; whatever is wrong with it is said on the page."""
        self.message = ""
        extra: dict[str, Any] = {}
        number = 0
        try:
            request = json.loads(text)
            number = int(request["n"])
            if self.session.screen.cascade and request["do"] in OF_ONE_LOOP:
                raise InvalidValue("page", request["do"], "must be of a single loop, and a cascade stands here")
            extra = getattr(self, f"_do_{request['do']}")(request) or {}
        except WorkbenchError as error:
            self.message = self._plain(str(error))
        except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
            self.message = f"the page's request was not understood ({type(error).__name__}: {error})"
        self.show({"ack": number, **extra})

    def show(self, extra: Mapping[str, Any] | None = None) -> None:
        """Send what the page shows, and draw what its view shows."""
        session = self.session
        kind, other = ("cascade", "loop") if session.screen.cascade else ("loop", "cascade")
        answer: dict[str, Any] = {
            "view": self.view,
            "kind": kind,
            "entries": {p: text for p, text in session.screen.entries.items() if not p.startswith(f"{other}.")},
            "title": session.screen.title,
            "problems": [{"field": p.field, "text": self._plain(p.text)} for p in session.problems],
            "notes": list(session.notes),
            "message": self.message,
            "figures": session.figures(),
            "stale": session.stale,
            "undo": bool(session.past),
            "cases": [{"name": case.name, "note": case.note} for case in session.screen.cases],
            "busy": self.task,
            **(extra or {}),
        }
        if session.own is not None and self.view == "loop":
            self.pictures.show_run(session.own)
        if self.view == "compare":
            runs = session.runs()
            self.pictures.show_cases(runs, session.own)
            answer["comparison"] = session.comparison(runs)
            answer["front"] = self._front_words()
        if self.view == "frequency":
            answer["frequency"] = self._frequency()
        if self.view == "export":
            answer["scenario"] = self._scenario()
        tuned = self._tuned()
        if tuned is not None:
            kind = "PID" if tuned.controller.Td > 0.0 else "PI"
            answer["tuned"] = {
                "lines": [*tuned.lines, *self._outdated()],
                "status": tuned.status,
                "name": f"Tuned {kind if tuned.primary is None else 'in turn'}",
            }
        answer["axes"] = self.pictures.moved(all_of_them="start" in answer, anew=str(answer.get("refit", "")))
        self._send(answer)

    def _send(self, answer: Mapping[str, Any]) -> None:
        self.sent += 1
        self.bridge.down = json.dumps({"sent": self.sent, **answer})

    def _plain(self, text: str) -> str:
        """Return a message without the session's own folder, and without places in a file that nobody has seen."""
        text = "\n".join(map(unplaced, text.splitlines()))
        return text.replace(f"{self.folder}/", "").replace(str(self.folder), "")

    def _do_hello(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """The page is there: send everything. lost: it was there in another session, which is gone."""
        if request.get("lost"):
            self.message = "The connection was lost, and what stood on this page with it: here it is as it begins."
        return {"record": record_words(self.data, self.record), "found": found_words(self.found), "start": True}

    def _do_set(self, request: Mapping[str, Any]) -> None:
        self.session.change({p: _typed(p, t) for p, t in request["entries"].items()}, str(request.get("gesture", "")))

    def _do_view(self, request: Mapping[str, Any]) -> None:
        if request["view"] not in VIEWS:
            raise InvalidValue("view", request["view"], f"must be one of {', '.join(VIEWS)}")
        self.view = request["view"]

    def _do_undo(self, _request: Mapping[str, Any]) -> None:
        if not self.session.undo():
            self.message = "there is nothing to undo"

    def _do_pin(self, request: Mapping[str, Any]) -> None:
        self.session.pin(str(request["name"]))

    def _do_rename(self, request: Mapping[str, Any]) -> None:
        self.session.rename(self._case(request), str(request["name"]))

    def _do_move(self, request: Mapping[str, Any]) -> None:
        place = self._case(request)
        self.session.move(place, place + int(request["by"]))

    def _do_remove(self, request: Mapping[str, Any]) -> None:
        # A second click, or one of another tab, that comes before the first is seen removes no other case.
        if (place := self.session.place(int(request["case"]))) is not None:
            self.session.remove(place)

    def _do_show(self, request: Mapping[str, Any]) -> None:
        self.session.show(self._case(request))

    def _case(self, request: Mapping[str, Any]) -> int:
        """Return the place of the case that a request names by its key: places change while it is on its way."""
        if (place := self.session.place(int(request["case"]))) is None:
            raise WorkbenchError("that case is no longer there")
        return place

    # long tasks ----------------------------------------------------------------------------------------------------

    def _begin(self, task: str, text: str) -> None:
        if self.task:
            raise InvalidValue("task", WORDS[task].lower(), f"must wait: {WORDS[self.task].lower()} is under way")
        self.task = task
        holder: list[Job] = []
        self.job = Job(task, text, str(self.folder), lambda event: self._later(holder, event))
        holder.append(self.job)

    def _later(self, holder: list[Job], event: Event) -> None:
        """Hand an event of a job's thread to the document's own."""
        with suppress(Exception):  # the session may be gone
            self.document.add_next_tick_callback(partial(self._happened, holder, event))

    def _happened(self, holder: list[Job], event: Event) -> None:
        if not holder or holder[0] is not self.job:
            return
        if event.kind == "progress":
            words = f"{WORDS[self.task]}: {event.words}" if event.words else WORDS[self.task]
            self._send({"progress": {"words": words, "share": event.share}})
            return
        task, self.task = self.task, ""
        extra: dict[str, Any] = {"ended": task}
        self.message = "" if event.kind == "done" else self._plain(event.words)
        if event.kind == "stopped":
            self.message = f"{WORDS[task]} was stopped."
        if event.kind == "done":
            extra |= self._ended(event.result)
        if event.kind != "done" and task == "read":
            # The file stays to be read again, by other columns perhaps; what is shown is not of it.
            self.record, self.found = None, None
            self.pictures.show_no_record()
            extra |= {"record": record_words(self.data, None), "found": None}
        if self.waits:
            self._read(self.waits)
        self.show(extra)

    def _ended(self, result: object) -> dict[str, Any]:
        """Take a task's result and return what the page is to be told of it."""
        if isinstance(result, ReadRecord):
            self.record, self.found = result, None
            self.pictures.show_record(None, result)
        elif isinstance(result, Found):
            self.record, self.found = result.record, result
            self.pictures.show_record(result, result.record)
        elif isinstance(result, TunedCase):
            self.tuned, self.tuned_of = result, self.asked_of
            self.message = "" if result.success else f"The tuning ended as {result.status}."
        elif isinstance(result, MapFound):
            self.map, self.map_of = result, self.asked_of
            self.pictures.show_map(result, self.map_figure)
            return {"refit": "f_map"}
        elif isinstance(result, FrontFound):
            self.front, self.front_of = result, self.asked_of
            self.pictures.show_front(result)
        elif isinstance(result, Report):
            return {"download": {"name": "report.html", "type": "text/html", "text": result.html}}
        return {"record": record_words(self.data, self.record), "found": found_words(self.found)}

    def _do_stop(self, _request: Mapping[str, Any]) -> None:
        if self.job is not None and self.task:
            self.job.stop()

    # compare -------------------------------------------------------------------------------------------------------

    def _do_front(self, _request: Mapping[str, Any]) -> None:
        self._begin("front", self.session.scenario())
        self.asked_of = self._front_key()

    def _front_key(self) -> object:
        built = self.session.built
        return None if built is None else (built.loop, tuple(self.session.screen.cases))

    def _front_words(self) -> list[str]:
        if self.front is None or self.session.screen.cascade:
            return []
        old = "This is of the loop and the cases as they stood when it was made; make it anew for the present ones."
        return [*([old] if self.front_of != self._front_key() else []), *self.front.text]

    def _do_tap(self, request: Mapping[str, Any]) -> None:
        """Put a tuning that was clicked on the screen: a place of the map, or a point of the front."""
        picture, x, y = request["picture"], float(request["x"]), float(request["y"])
        if not positive(x, y):
            return
        if picture == "f_map" and self.map is not None:
            self.session.use_tuning(x, y, self.map.axis)
        elif picture == "c_front" and self.front is not None and (point := self.front.near(x, y)) is not None:
            self.session.change(controller_entries(point.controller))

    # estimate ------------------------------------------------------------------------------------------------------

    def _do_upload(self, request: Mapping[str, Any]) -> dict[str, Any] | None:
        """Take a file: a scenario is shown, anything else is a record to be read."""
        name, coded = str(request["name"]), str(request["data"])
        try:
            content = base64.b64decode(coded, validate=True)
        except binascii.Error:
            raise RecordError(f"{name}: did not arrive whole") from None
        if len(content) > LARGEST_UPLOAD:
            given = f"{len(content) / 2**20:.1f} MiB"
            raise RecordError(f"{name}: {given} given; at most {LARGEST_UPLOAD >> 20} MiB can be uploaded")
        if name.lower().endswith((".yaml", ".yml")):
            self._show_scenario(name, content)
            return {"start": True}
        target = self.folder / safe_name(name)
        arriving = self.folder / ".arriving"  # which no file that was opened is called
        try:
            # A task under way may be reading the one of that name.
            arriving.write_bytes(content)
            arriving.replace(target)
        except OSError as error:
            raise RecordError(f"{name}: cannot be kept here ({error.strerror})") from None
        self._read_in_turn(name)
        return None

    def _show_scenario(self, name: str, content: bytes) -> None:
        if len(content) > LARGEST_SCENARIO:
            raise RecordError(f"{name}: a scenario file is at most 1 MiB")
        try:
            text = content.decode("utf-8-sig")
        except UnicodeDecodeError:
            raise RecordError(f"{name}: is no UTF-8 text; a scenario is UTF-8 text") from None
        data = self.session.read(text, self.folder / safe_name(name))
        self.waits = ""
        if data:
            self._read_in_turn(data)

    def _read_in_turn(self, name: str) -> None:
        """Read a record that was opened by this name, after the task under way where there is one."""
        if not self.task:
            self._read(safe_name(name))
            return
        self.waits = safe_name(name)
        self.message = f"{name} is read as soon as {WORDS[self.task].lower()} has ended."

    def _take(self, data: Path) -> None:
        """Read a file that the command named, as if it had been uploaded."""
        target = self.folder / safe_name(data.name)
        try:
            shutil.copyfile(data, target)
        except OSError as error:
            self.message = f"{data}: cannot be read ({error.strerror})"
            return
        self._read(target.name)

    def _read(self, name: str) -> None:
        self.data, self.waits = name, ""
        self._begin("read", estimate_text(self.session.screen, name))

    def _do_read(self, _request: Mapping[str, Any]) -> None:
        self._begin("read", estimate_text(self.session.screen, self._given()))

    def _do_estimate(self, _request: Mapping[str, Any]) -> None:
        self._begin("estimate", estimate_text(self.session.screen, self._given()))

    def _given(self) -> str:
        if not self.data:
            raise RecordError("no record; choose or drop a file first")
        return self.data

    def _do_use_model(self, _request: Mapping[str, Any]) -> None:
        if self.found is None:
            raise RecordError("nothing was estimated yet")
        found = self.found
        record = found.record
        self.session.use_model(found.plant, found.valve, record.sample_time, found.action, record.source)
        self.view = "loop"

    # tune ----------------------------------------------------------------------------------------------------------

    def _do_tune(self, _request: Mapping[str, Any]) -> None:
        text = self.session.tuning()
        self._begin("tune", text)
        self.tuned, self.asked_of = None, tuning_key(self.session.built)

    def _do_pin_tuned(self, request: Mapping[str, Any]) -> None:
        tuned = self._found_tuning()
        settings = 1 if tuned.primary is None else 2
        note = " ".join([*tuned.lines[settings:], *self._outdated()])
        self.session.pin(str(request["name"]), tuned.controller, note, tuned.primary)

    def _do_use_tuned(self, _request: Mapping[str, Any]) -> None:
        tuned = self._found_tuning()
        self.session.use(tuned.controller, tuned.primary)

    def _tuned(self) -> TunedCase | None:
        """Return the tuning found, if it is of what stands on the page: a loop or a cascade."""
        tuned = self.tuned
        return None if tuned is None or (tuned.primary is not None) != self.session.screen.cascade else tuned

    def _outdated(self) -> list[str]:
        """Return what is to be said of a tuning found that is not of what stands on the page now."""
        if self.tuned_of == tuning_key(self.session.built):
            return []
        return ["This is of the loop, experiment and weights as they stood when the search began, not as they are now."]

    def _found_tuning(self) -> TunedCase:
        tuned = self._tuned()
        if tuned is None:
            raise InvalidValue("tuning", "none", "must be found first")
        return tuned

    def _do_suit_bounds(self, _request: Mapping[str, Any]) -> None:
        """Set the bounds to what suits the loop as it stands."""
        from workbench.analyze.cycle_map import map_ranges
        from workbench.model.tuning import Bounds

        built = self.session.built
        if built is None:
            return
        ranges = map_ranges(built.loop, [built.loop.controller])
        Kc, Ti = (tuple(float(f"{end:.3g}") for end in ranges[name]) for name in ("Kc", "Ti"))
        longest = float(f"{max(built.loop.controller.Td, Ti[1] / 40.0):.3g}")
        entries = bounds_entries(Bounds((0.0, Kc[1]), (Ti[0], Ti[1]), (0.0, longest)))
        del entries["tune.kind"]
        self.session.change(entries)

    # frequency -----------------------------------------------------------------------------------------------------

    def _frequency(self) -> dict[str, Any]:
        built = self.session.built
        if built is None:
            return {}
        found, lines = verdicts(built)
        self.pictures.show_loci(found)
        if built.cascade is not None:
            return {"lines": lines, "loci": False, "map": []}
        cases = [(c.name, c.controller.Kc, c.controller.Ti) for c in self.session.screen.cases]
        here = built.loop.controller
        self.pictures.mark([*cases, ("On screen", here.Kc, here.Ti)])
        text = [] if self.map is None else list(self.map.text)
        if self.map is not None and self.map_of != map_key(built):
            text.insert(0, "This map is of the loop as it stood when it was made; make it anew for the present one.")
        return {"lines": lines, "loci": found is not None, "map": text}

    def _do_map(self, request: Mapping[str, Any]) -> None:
        """Map the tunings around the cases, or those of the part of the map that is looked at."""
        seen = request.get("seen")
        view = None if seen is None else (_ends(seen["x"]), _ends(seen["y"]))
        self._begin("map", self.session.mapped(view))
        self.asked_of = map_key(self.session.built)

    def _do_map_figure(self, request: Mapping[str, Any]) -> None:
        if request["name"] not in MAP_FIGURES:
            raise InvalidValue("map figure", request["name"], f"must be one of {', '.join(MAP_FIGURES)}")
        self.map_figure = request["name"]
        if self.map is not None:
            self.pictures.show_map(self.map, self.map_figure)

    # export --------------------------------------------------------------------------------------------------------

    def _scenario(self) -> str:
        try:
            return self.session.scenario()
        except WorkbenchError as error:
            return "\n".join(f"# {line}" for line in str(error).splitlines())

    def _do_export(self, request: Mapping[str, Any]) -> dict[str, Any] | None:
        what, session = request["what"], self.session
        if what == "report":
            self._begin("report", session.scenario())
            return None
        name, kind, text = export.made(what, session)
        return {"download": {"name": name, "type": kind, "text": text}}


def _ends(pair: Sequence[float]) -> tuple[float, float]:
    low, high = pair
    return float(low), float(high)


def _typed(path: str, text: object) -> str:
    """Return what was typed, no longer than its field may hold."""
    field = FIELDS.get(path)
    return str(text)[: LONGEST * max(1 if field is None else field.rows, 1)]
