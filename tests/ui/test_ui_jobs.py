"""Long tasks in a process of their own: what they send, how they stop, and that their death is only theirs."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from pathlib import Path

import pytest

import workbench as wb
from workbench.errors import ScenarioError, WorkbenchError
from workbench.report.words import change, figure
from workbench.scenario.loader import read_scenario
from workbench.ui import work
from workbench.ui.jobs import Event, Job, _serve
from workbench.ui.screen import Screen, estimate_text, scenario_text

SHORT = {"experiment.duration": "120", "tune.restarts": "1", "tune.digits": "2"}
LONG = {"experiment.duration": "3000", "tune.restarts": "64", "tune.kind": "PID"}


class Told:
    """Keeps what a job tells."""

    def __init__(self) -> None:
        self.events: list[Event] = []
        self.more = threading.Condition()

    def __call__(self, event: Event) -> None:
        with self.more:
            self.events.append(event)
            self.more.notify_all()

    def wait_for(self, *kinds: str, timeout: float = 60.0) -> Event:
        with self.more:
            assert self.more.wait_for(lambda: any(e.kind in kinds for e in self.events), timeout), self.events
            return next(e for e in self.events if e.kind in kinds)


def job(task: str, text: str, folder: Path) -> tuple[Job, Told]:
    told = Told()
    return Job(task, text, str(folder), told), told


def tuning(entries: dict[str, str]) -> str:
    return scenario_text(Screen().with_entries(entries), tune=True)


def silent(words: str, share: float) -> None:
    """Tell nobody."""


def test_a_tuning_comes_back_verified_with_progress_on_the_way(tmp_path):
    running, told = job("tune", tuning(SHORT), tmp_path)
    last = told.wait_for("done", "failed", "stopped")
    running.join(10)
    assert not running.alive
    assert last.kind == "done"
    result = last.result
    assert isinstance(result, work.TunedCase)
    assert result.success
    loop = wb.Loop(wb.FOPDT(1.0, 5.0, 1.0), wb.Stenman(2.0), result.controller, 1.0)
    experiment = wb.Experiment(120.0, wb.Step(4.0))
    assert wb.evaluate(loop, experiment, wb.Objective())[0] == result.objective
    assert result.objective < result.start_objective
    shares = [e.share for e in told.events if e.kind == "progress"]
    assert shares == sorted(shares)
    assert len(shares) > 2


def test_a_stopped_tuning_hands_over_its_best_so_far_even_where_the_server_ignores_interrupts(tmp_path, monkeypatch):
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # as of a server that a script put in the background
    try:
        running, told = job("tune", tuning(LONG), tmp_path)
    finally:
        signal.signal(signal.SIGINT, before)
    told.wait_for("progress")
    killed = []
    monkeypatch.setattr(running, "kill", lambda: killed.append(running.pid))
    running.stop()
    last = told.wait_for("done", "failed", "stopped", timeout=30.0)
    assert last.kind in ("done", "stopped")
    if last.kind == "done":
        assert isinstance(last.result, work.TunedCase)
        assert last.result.status == "interrupted"
    running.join(10)
    assert not running.alive
    assert not killed


@pytest.mark.skipif(os.name != "posix", reason="asks a process to end by a signal")
def test_a_task_that_is_stopped_twice_is_interrupted_once(tmp_path, monkeypatch):
    running, told = job("tune", tuning(LONG), tmp_path)
    told.wait_for("progress")
    asked = []
    monkeypatch.setattr(os, "kill", lambda *sent: asked.append(sent))
    running.stop()
    running.stop()
    monkeypatch.undo()
    running.kill()
    running.join(10)
    assert asked == [(running.pid, signal.SIGINT)]


def test_a_task_that_is_stopped_before_it_began_is_stopped(tmp_path):
    running, told = job("tune", tuning(LONG), tmp_path)
    running.stop()
    assert told.wait_for("done", "failed", "stopped").kind == "stopped"


@pytest.mark.skipif(os.name != "posix", reason="ends a process by a signal")
def test_a_killed_worker_is_a_failure_that_says_so(tmp_path):
    running, told = job("tune", tuning(LONG), tmp_path)
    told.wait_for("progress")
    assert running.pid is not None
    os.kill(running.pid, signal.SIGKILL)
    last = told.wait_for("done", "failed", "stopped")
    assert last.kind == "failed"
    assert "SIGKILL" in last.words
    assert "nothing else is affected" in last.words


def test_what_is_wrong_with_the_input_comes_back_in_words(tmp_path):
    _, told = job("read", estimate_text(Screen(), "gone.csv"), tmp_path)
    last = told.wait_for("done", "failed", "stopped")
    assert last.kind == "failed"
    assert "gone.csv: no such file" in last.words


def test_a_defect_comes_back_in_words_too(tmp_path):
    ours, theirs = multiprocessing.Pipe()
    with ours, theirs:
        _serve(theirs, "no such task", "", str(tmp_path))  # what a worker does, here
        assert ours.recv()[0] == "ready"
        kind, words, *_ = ours.recv()
    assert kind == "failed"
    assert "an error of the program, KeyError" in words


def test_a_killed_job_leaves_no_process(tmp_path):
    running, told = job("tune", tuning(LONG), tmp_path)
    running.kill()
    running.join(20)
    assert told.wait_for("stopped").kind == "stopped"
    deadline = time.monotonic() + 20
    while Path(f"/proc/{running.pid}").exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not Path(f"/proc/{running.pid}").exists()


# the tasks themselves, here -----------------------------------------------------------------------------------------


@pytest.fixture
def record(tmp_path: Path) -> Path:
    loop = wb.Loop(wb.FOPDT(-1.0, 6.0, 2.0), wb.Stenman(1.0), wb.PID(0.6, 15.0, action="direct"), 1.0)
    run = wb.simulate(loop, wb.Experiment(600.0, (wb.Step(2.0), wb.Step(1.5, 300.0)), noise=wb.Noise(0.02, 3)))
    lines = ["time,SP,PV,<script>,OP"]
    lines += [f"{t:g},{r},{y},x,{u}" for t, r, y, u in zip(run.time, run.sp, run.pv, run.op, strict=True)]
    path = tmp_path / "loop.csv"
    path.write_text("\n".join(lines))
    return path


def test_reading_says_what_was_kept(record):
    found = work.read_data(estimate_text(Screen(), record.name), str(record.parent), silent)
    assert found.pv.size == found.op.size == found.time.size == 600
    assert found.sp is not None
    assert found.summary[0].startswith("600 samples of 1 s")


def test_an_estimate_brings_model_evidence_and_the_action_that_the_gain_needs(record):
    told: list[float] = []
    text = estimate_text(Screen(), record.name)
    found = work.estimate_record(text, str(record.parent), lambda _words, share: told.append(share))
    assert found.verdict == "stiction"
    assert found.action == "direct"
    assert isinstance(found.valve, wb.Stenman)
    assert found.valve.d == pytest.approx(1.0, rel=0.05)
    assert found.prediction.shape == found.stem.shape == (600,)
    assert found.parameters.rows
    assert found.evidence.rows
    assert all(reason[0].isupper() and reason.endswith(".") for reason in found.reasons)
    assert told == sorted(told)


def test_a_tuning_says_what_it_makes_of_error_and_wear(tmp_path):
    screen = Screen().with_entries({**SHORT, "tune.digits": "2", "tune.restarts": "1"})
    found = work.tune_loop(scenario_text(screen, tune=True), str(tmp_path), silent)
    plan = read_scenario(scenario_text(screen), tmp_path / "screen.yaml")
    was, now = (
        wb.simulate(plan.loop.with_controller(one), plan.experiment).kpis
        for one in (plan.loop.controller, found.controller)
    )
    error = f"{figure(now.mean_square_error)} EU² ({change(now.mean_square_error, was.mean_square_error)})"
    travel = f"{figure(now.valve_travel)} % ({change(now.valve_travel, was.valve_travel)})"
    assert found.lines[2] == f"In the run on the page: mean square error {error}, valve travel {travel}."


def test_a_map_and_a_report_of_the_page(undrawn, tmp_path):
    screen = Screen().with_entries({**SHORT, "analyze.map.points": "6"})
    found = work.map_tunings(scenario_text(screen, mapped=True), str(tmp_path), silent)
    assert found.outcome.shape == (6, 6)
    assert all(values.shape == (6, 6) for values in found.figures.values())
    report = work.write_html(scenario_text(screen), str(tmp_path), silent)
    assert report.html.startswith("<!DOCTYPE html>")
    assert "A loop with a sticky valve" in report.html
    assert {path.name for path in tmp_path.iterdir()} == {".report"}


@pytest.mark.slow
def test_a_front_that_is_stopped_brings_what_was_found_till_then(record):
    screen = Screen().with_entries({**SHORT, "loop.plant.time_constant": "1.2"})
    told: list[str] = []

    def stop_once(words: str, share: float) -> None:
        told.append(words)
        if share > 0.3 and "interrupted" not in told:
            told.append("interrupted")
            raise KeyboardInterrupt

    found = work.trade_off(scenario_text(screen), str(record.parent), stop_once)
    assert "interrupted" in told
    assert found.repaired == ()
    assert len(found.sticky) > 5
    assert [p.valve_travel for p in found.sticky] == sorted(p.valve_travel for p in found.sticky)
    assert [name for name, *_ in found.cases] == ["On screen"]
    assert found.cases[0][1] > 0.0
    assert "ended as “interrupted”" in " ".join(found.text)
    with pytest.raises(ScenarioError, match="no loop was given"):
        work.trade_off(estimate_text(Screen(), record.name), str(record.parent), silent)


def test_tasks_that_were_not_asked_for_are_refused(tmp_path):
    with pytest.raises(ScenarioError, match="no tuning"):
        work.tune_loop(scenario_text(Screen()), str(tmp_path), silent)
    with pytest.raises(ScenarioError, match="no map"):
        work.map_tunings(scenario_text(Screen()), str(tmp_path), silent)
    with pytest.raises(ScenarioError, match="no record"):
        work.read_data(scenario_text(Screen()), str(tmp_path), silent)
    with pytest.raises(WorkbenchError):
        work.write_html("title: x\n", str(tmp_path), silent)
