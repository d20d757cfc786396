"""How quickly the page answers: `python benchmarks/ui.py` (needs playwright and Chromium; some half minute).

Measured in headless Chromium, from the event of a slider to the frame in which the new figures and pictures are drawn:
the paper's loop, N = 1,000 and 20,000 samples. First page: from starting the command to the last byte of the page, and
until the browser has drawn it. Memory: the server's resident set with five sessions open.
"""

from __future__ import annotations

import os
import re
import shutil
import statistics
import subprocess
import sys
import time
import urllib.request
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright

ROOT = Path(__file__).parents[1]
COMMAND = [sys.executable, "-m", "workbench", "ui", "--no-browser", "--port", "0"]
PATH = "loop.controller.Kc"
MOVES = """async ([path, moves]) => {
  const slider = document.querySelector(`[data-slider="${path}"]`);
  const drawn = () => new Promise((done) => {
    const watch = new MutationObserver(() => { watch.disconnect(); done(); });
    watch.observe(document.documentElement, { attributes: true, attributeFilter: ["data-drawn"] });
  });
  const times = [];
  for (let i = 0; i < moves; i += 1) {
    slider.value = String(350 + ((37 * i) % 300));
    const seen = drawn();
    const began = performance.now();
    slider.dispatchEvent(new Event("input", { bubbles: true }));
    await seen;
    times.push(performance.now() - began);
  }
  return times;
}"""
DRAG = """async ([path, seconds]) => {
  const slider = document.querySelector(`[data-slider="${path}"]`);
  let count = 0;
  const watch = new MutationObserver(() => { count += 1; });
  watch.observe(document.documentElement, { attributes: true, attributeFilter: ["data-drawn"] });
  const began = performance.now();
  for (let i = 0; performance.now() - began < 1000 * seconds; i += 1) {
    slider.value = String(350 + ((7 * i) % 300));
    slider.dispatchEvent(new Event("input", { bubbles: true }));
    await new Promise((done) => { setTimeout(done, 8); });
  }
  watch.disconnect();
  return count / (performance.now() - began) * 1000;
}"""


def serve() -> tuple[subprocess.Popen[str], str, float]:
    """Start the command; return it, its page's address and the seconds until the page was there."""
    began = time.perf_counter()
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(
        [*COMMAND, str(ROOT / "scenarios" / "table_2.yaml")], stdout=subprocess.PIPE, text=True, env=environment
    )
    assert process.stdout is not None
    found = re.search(r"http://\S+", process.stdout.readline())
    assert found is not None
    with urllib.request.urlopen(found[0], timeout=60) as answer:
        answer.read()
    return process, found[0], time.perf_counter() - began


def memory(pid: int) -> float:
    """Resident set of a process, MiB."""
    found = re.search(r"VmRSS:\s+(\d+) kB", Path(f"/proc/{pid}/status").read_text())
    assert found is not None
    return int(found[1]) / 1024


def opened(browser: Any, url: str) -> Any:
    """Open the page in a session of its own."""
    page = browser.new_context(viewport={"width": 1280, "height": 900}, bypass_csp=True).new_page()
    page.goto(url)
    page.wait_for_selector("html[data-drawn]")
    return page


def processor(pid: int) -> float:
    """Processor time that a process has taken, s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def measure(page: Any, moves: int, server: int) -> str:
    """Return median and 95th percentile of the time from a slider's move to its picture, and what a move takes."""
    page.evaluate(MOVES, [PATH, 20])
    session = page.context.new_cdp_session(page)
    session.send("Performance.enable", {"timeDomain": "threadTicks"})

    def browser() -> float:
        found = {one["name"]: one["value"] for one in session.send("Performance.getMetrics")["metrics"]}
        return float(found["TaskDuration"])

    before = browser(), processor(server)
    times = sorted(page.evaluate(MOVES, [PATH, moves]))
    took = [1e3 * (now - then) / moves for now, then in zip((browser(), processor(server)), before, strict=True)]
    return (
        f"median {statistics.median(times):.0f} ms, 95th percentile {times[int(0.95 * len(times))]:.0f} ms; processor "
        f"time a move: {took[0]:.0f} ms of the browser's page, {took[1]:.0f} ms of the server"
    )


def main() -> None:
    """Measure and print."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        raise SystemExit("no chromium is installed")
    warm, _, _ = serve()
    warm.kill()
    process, url, first = serve()
    print(f"load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    print(f"first page: {first:.1f} s after the command")
    try:
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
            began = time.perf_counter()
            page = opened(browser, url)
            print(f"drawn in the browser: {time.perf_counter() - began:.1f} s after it is asked for")
            print(f"slider to picture, N = 1,000: {measure(page, 200, process.pid)}")
            page.fill('[data-entry="experiment.duration"]', "20000")
            page.press('[data-entry="experiment.duration"]', "Enter")
            page.wait_for_selector("html[data-idle=true]")
            print(f"slider to picture, N = 20,000: {measure(page, 100, process.pid)}")
            print(f"redraws while dragging, N = 20,000: {page.evaluate(DRAG, [PATH, 4]):.1f} a second")
            for _ in range(4):
                opened(browser, url)
            print(f"memory of the server with 5 sessions: {memory(process.pid):.0f} MiB")
            browser.close()
    finally:
        process.kill()
    print(f"load average {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
