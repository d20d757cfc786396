// The page's side: what is typed goes up as JSON, one request under way at a time; what comes down is shown as text.
"use strict";

const spec = JSON.parse(document.getElementById("spec").textContent);
const byId = (id) => document.getElementById(id);
const entryInputs = new Map([...document.querySelectorAll("[data-entry]")].map((el) => [el.dataset.entry, el]));
const sliders = new Map([...document.querySelectorAll("[data-slider]")].map((el) => [el.dataset.slider, el]));
const boxes = new Map([...document.querySelectorAll("[data-field]")].map((el) => [el.dataset.field, el]));
const ranges = new Map();
const queue = [];
let bridge = null;
let waiting = null;
let number = 0;
let sent = 0; // ms, when the request under way was sent
let heard = 0; // the number of the last answer, by the session's own count
let gesture = 0; // counts drags and runs of key strokes, each of which is undone at once
let view = "loop";
let entries = {};
let notes = "";

// requests ------------------------------------------------------------------------------------------------------------

// Which a second click, or Enter, before the first is answered does not ask for once more.
const once = new Set(["pin", "pin_tuned", "read", "estimate", "tune", "map", "front", "use_model", "use_tuned", "export"]);

function ask(what, more = {}) {
  const last = queue[queue.length - 1];
  if (once.has(what) && JSON.stringify({ ...(last ?? waiting), n: undefined }) === JSON.stringify({ do: what, ...more })) return;
  // While a request is under way only the latest of what is dragged or typed counts.
  if (what === "set" && last && last.do === "set" && last.gesture === more.gesture) {
    Object.assign(last.entries, more.entries);
  } else {
    queue.push({ do: what, ...more });
  }
  pump();
}

function pump() {
  document.documentElement.dataset.idle = String(!waiting && queue.length === 0);
  if (waiting || !bridge || queue.length === 0) return;
  document.documentElement.dataset.idle = "false";
  waiting = { n: ++number, ...queue.shift() };
  sent = performance.now();
  bridge.up = JSON.stringify(waiting);
}

// A server that has ended says nothing more.
setInterval(() => {
  if (!waiting || performance.now() - sent < 6000) return;
  byId("message").textContent = "No answer for some seconds. Where `workbench ui` has ended, start it again and reload this page.";
  byId("message").hidden = false;
}, 1000);

function taken() {
  const answer = JSON.parse(bridge.down);
  const asked = waiting && answer.ack === waiting.n ? waiting : null;
  show(answer, asked);
  // Another session answers: the server was started anew, or has forgotten this page while it was out of reach.
  if (answer.sent <= heard) ask("hello", { lost: true });
  heard = answer.sent;
  if (asked) {
    waiting = null;
    // The figures of this answer are painted in this frame; the next request goes out after it.
    requestAnimationFrame(() => {
      document.documentElement.dataset.drawn = String(answer.ack);
      pump();
    });
  }
}

// showing -------------------------------------------------------------------------------------------------------------

function make(tag, text = "", attributes = {}, ...children) {
  const el = document.createElement(tag);
  if (text) el.textContent = text;
  for (const [name, value] of Object.entries(attributes)) el.setAttribute(name, value);
  el.append(...children);
  return el;
}

function list(el, lines) {
  el.replaceChildren(...(lines || []).map((line) => make("li", line)));
  el.hidden = !(lines && lines.length);
}

function show(answer, asked) {
  if (answer.progress) {
    byId("progress").hidden = false;
    byId("progress-words").textContent = answer.progress.words;
    byId("progress-share").value = answer.progress.share;
    return;
  }
  const before = entries;
  entries = answer.entries;
  document.documentElement.dataset.kind = answer.kind;
  fitAxes(answer.axes, answer.refit);
  showEntries(asked, before);
  showProblems(answer.problems);
  byId("title").textContent = answer.title;
  byId("undo").disabled = !answer.undo;
  byId("message").textContent = answer.message;
  byId("message").hidden = !answer.message;
  // A name that is refused stays, to be mended, and so does one that was typed since.
  for (const name of document.querySelectorAll("input.name")) {
    name.setAttribute("aria-invalid", String(Boolean(answer.message) && asked?.from === name.id));
  }
  if (asked?.do === "pin" && !answer.message && byId(asked.from).value === asked.name) byId(asked.from).value = "";
  if (answer.busy && (byId("progress").hidden || answer.ended)) {
    byId("progress-words").textContent = "Starting";
    byId("progress-share").removeAttribute("value");
  }
  byId("progress").hidden = !answer.busy;
  for (const el of document.querySelectorAll("#tune, #map, #map-view, #front, [data-export=report]")) el.disabled = Boolean(answer.busy);
  if (answer.notes.join() !== notes) list(byId("notes"), answer.notes);
  notes = answer.notes.join();
  showFigures(answer.figures);
  document.querySelector("main").classList.toggle("stale", answer.stale);
  if (answer.comparison) showComparison(answer.comparison, answer.cases.length, asked, answer.message);
  if (answer.front) {
    list(byId("front-lines"), answer.front);
    byId("front-box").hidden = !answer.front.length;
  }
  if (answer.frequency) {
    list(byId("frequency-lines"), answer.frequency.lines);
    list(byId("map-lines"), answer.frequency.map);
    byId("map-box").hidden = byId("map-view").hidden = !answer.frequency.map?.length;
    byId("loci-box").hidden = !answer.frequency.loci;
  }
  if (answer.scenario !== undefined) byId("scenario").textContent = answer.scenario;
  if (answer.record) showRecord(answer.record);
  for (const id of ["estimate", "read"]) byId(id).disabled = Boolean(answer.busy) || !byId("record-name").textContent;
  // Where a record cannot be read its columns may have to be named.
  if (answer.ended === "read" && answer.message) byId("view-estimate").querySelector("details.group").setAttribute("open", "");
  if (answer.found !== undefined) showFound(answer.found);
  byId("tuned").hidden = !answer.tuned;
  if (answer.tuned) byId("tuned").querySelector("ul").replaceChildren(...answer.tuned.lines.map((l) => make("li", l)));
  if (answer.ended === "tune" && answer.tuned) suggest(answer.tuned.name, answer.cases);
  if (answer.download) download(answer.download);
  // A view that was turned to since stays.
  const turned = queue.some((one) => one.do === "view") || (!asked && waiting?.do === "view");
  if (answer.view !== view && !turned) turn(answer.view, false);
}

const fitted = new Map();

function fitAxes(axes, refit) {
  for (const [name, [start, end]] of Object.entries(axes)) {
    const [figure, axis] = name.split(".");
    const range = Bokeh.documents[0].get_model_by_name(figure)[`${axis}_range`];
    const before = fitted.get(name);
    fitted.set(name, [start, end]);
    // What the user has zoomed stays until it is reset, or drawn anew.
    const zoomed = before && figure !== refit && (range.start !== before[0] || range.end !== before[1]);
    range.setv({ reset_start: start, reset_end: end, ...(zoomed ? {} : { start, end }) }, { sync: false });
  }
}

let suggested = "";

function suggest(base, cases) {
  // What was typed stays; what was suggested was for the tuning before.
  if (![suggested, ""].includes(byId("tuned-name").value)) return;
  const names = cases.map((one) => one.name);
  let name = base;
  for (let i = 2; names.includes(name); i += 1) name = `${base} ${i}`;
  byId("tuned-name").value = suggested = name;
}

const typable = (el) => el.type === "text" || el.type === "textarea";

function showEntries(asked, before) {
  const sliding = asked && asked.do === "set" ? asked.entries : {};
  const queued = new Set(queue.flatMap((one) => (one.do === "set" ? Object.keys(one.entries) : [])));
  let kinds = false;
  const used = [];
  for (const [path, el] of entryInputs) {
    const text = entries[path];
    if (text === undefined) continue; // of the other kind of scenario
    if (text === before[path] && el.value === text && el.type !== "checkbox") continue;
    // What is being typed or dragged stays as it is until it is answered, whoever's answer this is.
    const typing = el === document.activeElement && typable(el) && path in before && el.value !== before[path];
    if (queued.has(path) || (typing && el.value.trim() !== sliding[path])) continue;
    if (el.type === "checkbox") el.checked = text === "true";
    else if (el.value !== text) el.value = text;
    kinds ||= el.type !== "text";
    if (text !== before[path] && text !== spec.fields[path]?.usual) used.push(path);
  }
  for (const [path, field] of Object.entries(spec.fields)) {
    if (kinds && field.when) boxes.get(path).hidden = !shows(path);
    if (field.otherwise) {
      const [other, value, unit] = field.otherwise;
      const shown = boxes.get(path).querySelector(".unit");
      const text = entries[other] === value ? unit : field.units[0];
      if (shown.textContent !== text) shown.textContent = text;
    }
  }
  // What few loops have shows where it comes with a scenario.
  for (const path of used) boxes.get(path)?.closest("details.more")?.setAttribute("open", "");
  for (const path of sliders.keys()) {
    if (entries[path] !== before[path] && !queued.has(path)) place(path, asked);
  }
}

function shows(path) {
  const when = spec.fields[path].when;
  return !when || (when[1].includes(entries[when[0]]) && shows(when[0]));
}

function showProblems(problems) {
  for (const box of document.querySelectorAll(".field.wrong")) {
    box.classList.remove("wrong");
    const said = box.querySelector(".said");
    said.hidden = true;
    said.textContent = "";
    const input = box.querySelector("[data-entry]");
    input.removeAttribute("aria-invalid");
  }
  const homeless = [];
  for (const problem of problems) {
    const box = problem.field && boxes.get(problem.field);
    if (!box) {
      homeless.push(problem.text);
      continue;
    }
    box.classList.add("wrong");
    const said = box.querySelector(".said");
    said.textContent = said.textContent ? `${said.textContent} ${problem.text}` : problem.text;
    said.hidden = false;
    box.querySelector("[data-entry]").setAttribute("aria-invalid", "true");
    for (let part = box; part; part = part.parentElement.closest("details")) part.setAttribute("open", "");
  }
  if (homeless.length) {
    byId("message").textContent = homeless.join("\n");
    byId("message").hidden = false;
  }
}

function showFigures(figures) {
  const box = byId("figures");
  if (box.children.length !== figures.length) {
    box.replaceChildren(
      ...figures.map(() => make("div", "", {}, make("dt"), make("dd"))),
    );
  }
  figures.forEach((figure, i) => {
    const [title, value] = box.children[i].children;
    box.children[i].dataset.figure = figure.name;
    if (title.textContent !== figure.title) title.textContent = figure.title;
    const small = figure.unit ? [make("small", ` ${figure.unit}`)] : [];
    if (figure.doubt) small.push(make("small", figure.doubt, { class: "doubt" }));
    const text = figure.text + small.map((one) => one.textContent).join("");
    if (value.textContent !== text) value.replaceChildren(figure.text, ...small);
  });
}

function swatch(index, own) {
  const look = own ? { color: "#9aa5b1", dash: "" } : spec.cases[index % spec.cases.length];
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  const line = document.createElementNS("http://www.w3.org/2000/svg", "line");
  for (const [name, value] of Object.entries({ width: 34, height: 8, "aria-hidden": "true" })) svg.setAttribute(name, value);
  const drawn = { x1: 0, x2: 34, y1: 4, y2: 4, stroke: look.color, "stroke-width": own ? 4 : 2, "stroke-dasharray": look.dash };
  for (const [name, value] of Object.entries(drawn)) line.setAttribute(name, value);
  svg.append(line);
  return svg;
}

// The heads of the pinned cases, by their keys: what is typed, held or clicked there is not taken away by an answer.
const heads = new Map();

function headOf(key) {
  if (heads.has(key)) return heads.get(key);
  const name = make("input", "", { type: "text", maxlength: "80" });
  name.addEventListener("change", () => ask("rename", { case: key, name: name.value }));
  name.addEventListener("keydown", (event) => {
    if (event.key !== "Escape") return;
    name.value = name.defaultValue;
    name.setAttribute("aria-invalid", "false");
  });
  const buttons = [
    ["←", "to the left", "move", { by: -1 }],
    ["→", "to the right", "move", { by: 1 }],
    ["▲", "on the screen", "show", {}],
    ["✕", "away", "remove", {}],
  ].map(([text, words, what, more]) => {
    const button = make("button", text, { type: "button", class: "small", title: words });
    button.addEventListener("click", () => ask(what, { case: key, ...more }));
    return button;
  });
  const words = make("small");
  const cell = make("th", "", { scope: "col" }, swatch(0), make("br"), name, words, ...buttons);
  heads.set(key, { cell, name, words, buttons });
  return heads.get(key);
}

function showHead(head, i, pinned, asked, message) {
  const settings = head.refused || head.settings;
  if (i >= pinned) return make("th", "", { scope: "col" }, swatch(i, true), make("br"), make("span", head.name), make("small", settings));
  const { cell, name, words, buttons } = headOf(head.case);
  cell.firstChild.replaceWith(swatch(i));
  const renamed = asked?.do === "rename" && asked.case === head.case && asked.name === name.value;
  const refused = renamed && Boolean(message);
  name.setAttribute("aria-invalid", String(refused));
  const typing = name === document.activeElement && name.value !== name.defaultValue && !renamed;
  if (!typing && !refused) name.value = head.name;
  name.defaultValue = name.title = head.name;
  name.setAttribute("aria-label", `Name of case ${i + 1}`);
  words.textContent = settings;
  for (const button of buttons) button.setAttribute("aria-label", `${head.name}: ${button.title}`);
  buttons[0].disabled = i === 0;
  buttons[1].disabled = i === pinned - 1;
  return cell;
}

function showComparison(table, pinned, asked, message) {
  const focus = document.activeElement;
  const held = focus.closest("#comparison th");
  const [at, part] = held ? [held.cellIndex, [...held.children].indexOf(focus)] : [];
  const cells = table.heads.map((head, i) => showHead(head, i, pinned, asked, message));
  for (const [key, { cell }] of heads) if (!cells.includes(cell)) heads.delete(key);
  const rows = table.rows.map((row) => {
    const title = make("th", row.title, { scope: "row" });
    if (row.unit) title.append(make("span", row.unit, { class: "unit" }));
    const cells = row.cells.map((cell) => {
      const td = make("td", cell.text, cell.best ? { class: "best" } : {});
      if (cell.doubt) td.append(make("small", cell.doubt));
      if (cell.difference) td.append(make("small", cell.difference));
      if (cell.published) td.append(make("small", `publ. ${cell.published}`));
      return td;
    });
    return make("tr", "", {}, title, ...cells);
  });
  byId("comparison-note").textContent = table.note;
  const grid = byId("comparison");
  const body = make("tbody", "", {}, ...rows);
  const shown = [...(grid.rows[0]?.cells ?? [])].slice(1);
  if (shown.length === cells.length && cells.every((cell, i) => i >= pinned || cell === shown[i])) {
    for (let i = pinned; i < cells.length; i += 1) shown[i].replaceWith(cells[i]);
    grid.tBodies[0].replaceWith(body);
  } else {
    const corner = make("th", "Figure", { scope: "col", style: "text-align: left" });
    grid.replaceChildren(make("thead", "", {}, make("tr", "", {}, corner, ...cells)), body);
  }
  if (!held) return;
  // The focus goes along with its case; from one that is gone to its neighbour.
  const cell = held.isConnected ? held : cells[Math.min(at, pinned) - 1];
  const wanted = cell?.children[part];
  (wanted?.disabled ? cell.querySelector("input") : (wanted ?? byId("pin-name"))).focus();
}

function tableOf(table, first) {
  const corner = make("th", first, { scope: "col", style: "text-align: left" });
  const heads = table.heads.map((head) => make("th", head, { scope: "col", style: "text-align: left" }));
  const rows = table.rows.map((row) => {
    const title = make("th", row.label, { scope: "row" });
    if (row.unit) title.append(make("span", row.unit, { class: "unit" }));
    const cells = row.cells.map((cell) => {
      const td = make("td", cell.text);
      if (cell.small) td.append(make("small", cell.small));
      return td;
    });
    return make("tr", "", {}, title, ...cells);
  });
  const whole = make("table", "", {}, make("thead", "", {}, make("tr", "", {}, corner, ...heads)), make("tbody", "", {}, ...rows));
  return table.note ? make("div", "", {}, whole, make("p", table.note, { class: "soft" })) : whole;
}

function showRecord(record) {
  byId("record-name").textContent = record.name;
  list(byId("record-summary"), record.summary);
}

function showFound(found) {
  byId("use-model").disabled = !found;
  byId("evidence").hidden = !found;
  byId("verdict").replaceChildren();
  byId("parameters").replaceChildren();
  if (!found) return;
  const reasons = make("ul");
  list(reasons, [...found.sentences, ...found.reasons]);
  byId("verdict").append(make("p", "", {}, "Verdict: ", make("strong", found.verdict)), reasons);
  byId("parameters").append(tableOf(found.parameters, "Parameter"));
  byId("evidence").querySelector("div").replaceChildren(make("p", found.detection), tableOf(found.evidence, "Statistic"));
}

function download(file) {
  const link = make("a", "", { download: file.name, href: URL.createObjectURL(new Blob([file.text], { type: file.type })) });
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

// sliders -------------------------------------------------------------------------------------------------------------

function place(path, asked) {
  const slider = sliders.get(path);
  const value = Number(entries[path]);
  slider.disabled = entries[path] === "" || !Number.isFinite(value);
  if (slider.disabled) return;
  const dragged = asked && asked.gesture?.startsWith(`slide ${path} `);
  let range = ranges.get(path);
  if (!dragged && !(range && inside(range, value))) {
    range = suited(path, value);
    ranges.set(path, range);
  }
  if (dragged || slider === document.activeElement && slider.matches(":active")) return;
  slider.value = String(Math.round(1000 * share(range, value)));
  slider.setAttribute("aria-valuetext", entries[path]);
}

function suited(path, value) {
  const field = spec.fields[path];
  if (field.slider === "log" && value !== 0) return { log: true, sign: Math.sign(value), low: Math.abs(value) / 10, high: Math.abs(value) * 10 };
  const reach = Math.max(field.reach, 2 * Math.abs(value));
  return { log: false, low: field.signed || value < 0 ? -reach : 0, high: reach };
}

function inside(range, value) {
  if (!range.log) return value >= range.low && value <= range.high;
  return Math.sign(value) === range.sign && Math.abs(value) >= range.low * 0.999 && Math.abs(value) <= range.high * 1.001;
}

function share(range, value) {
  if (range.log) return Math.log(Math.abs(value) / range.low) / Math.log(range.high / range.low);
  return (value - range.low) / (range.high - range.low);
}

function valueAt(range, part) {
  const value = range.log
    ? range.sign * range.low * (range.high / range.low) ** part
    : range.low + part * (range.high - range.low);
  const step = range.log ? 0 : (range.high - range.low) / 1000;
  const rounded = Math.abs(value) < step / 2 ? 0 : Number(value.toPrecision(3));
  return String(rounded);
}

function slid(path, done) {
  const slider = sliders.get(path);
  const range = ranges.get(path);
  if (!range) return;
  const text = valueAt(range, Number(slider.value) / 1000);
  entryInputs.get(path).value = text;
  slider.setAttribute("aria-valuetext", text);
  if (!done) ask("set", { entries: { [path]: text }, gesture: `slide ${path} ${gesture}` });
}

for (const [path, slider] of sliders) {
  slider.addEventListener("input", () => slid(path, false));
  slider.addEventListener("change", () => {
    slid(path, true);
    gesture += 1;
  });
}

// typing --------------------------------------------------------------------------------------------------------------

function typed(path, el) {
  const text = el.type === "checkbox" ? String(el.checked) : el.value.trim();
  ask("set", { entries: { [path]: text }, gesture: "" });
}

function nudge(path, el, up) {
  const value = Number(el.value);
  if (el.value.trim() === "" || !Number.isFinite(value)) return;
  const size = spec.fields[path]?.whole ? 1 : value === 0 ? (spec.fields[path]?.reach ?? 1) / 10 : 10 ** (Math.floor(Math.log10(Math.abs(value))) - 1);
  el.value = String(Number((value + (up ? size : -size)).toPrecision(6)));
  ask("set", { entries: { [path]: el.value }, gesture: `nudge ${path} ${gesture}` });
}

for (const [path, el] of entryInputs) {
  el.addEventListener("change", () => typed(path, el));
  if (!typable(el)) continue;
  el.addEventListener("blur", () => (gesture += 1));
  if (el.type !== "text") continue;
  el.addEventListener("keydown", (event) => {
    if (event.key === "ArrowUp" || event.key === "ArrowDown") {
      event.preventDefault();
      nudge(path, el, event.key === "ArrowUp");
    }
  });
}
byId("inputs").addEventListener("submit", (event) => event.preventDefault());

// views ---------------------------------------------------------------------------------------------------------------

const tabs = [...document.querySelectorAll("[role=tab]")];

function turn(name, tell = true) {
  view = name;
  for (const tab of tabs) {
    const on = tab.dataset.view === name;
    tab.setAttribute("aria-selected", String(on));
    tab.tabIndex = on ? 0 : -1;
    byId(`view-${tab.dataset.view}`).hidden = !on;
  }
  if (tell) ask("view", { view: name });
}

for (const [i, tab] of tabs.entries()) {
  tab.addEventListener("click", () => turn(tab.dataset.view));
  tab.addEventListener("keydown", (event) => {
    const to = { ArrowRight: i + 1, ArrowLeft: i - 1, Home: 0, End: tabs.length - 1 }[event.key];
    if (to === undefined) return;
    event.preventDefault();
    const next = tabs[(to + tabs.length) % tabs.length];
    next.focus();
    turn(next.dataset.view);
  });
}

document.addEventListener("keydown", (event) => {
  const el = event.target;
  // While something is typed, Ctrl+Z is the browser's own; names, which are no entries, begin as they were shown.
  const typing = typable(el) && el.value !== (entries[el.dataset.entry] ?? el.defaultValue);
  if ((event.ctrlKey || event.metaKey) && event.key.toLowerCase() === "z" && !event.shiftKey && !typing) {
    event.preventDefault();
    ask("undo");
  }
});
byId("undo").addEventListener("click", () => ask("undo"));

// actions -------------------------------------------------------------------------------------------------------------

for (const button of document.querySelectorAll("[data-pin-button]")) {
  const name = byId(button.dataset.pinButton);
  const pin = () => ask("pin", { name: name.value, from: name.id });
  button.addEventListener("click", pin);
  name.addEventListener("keydown", (event) => {
    if (event.key === "Enter") pin();
  });
}
for (const button of document.querySelectorAll("[data-export]")) {
  button.addEventListener("click", () => ask("export", { what: button.dataset.export }));
}
const plain = { estimate: "estimate", read: "read", "use-model": "use_model", tune: "tune", stop: "stop", map: "map", front: "front", "suit-bounds": "suit_bounds", "use-tuned": "use_tuned" };
for (const [id, what] of Object.entries(plain)) byId(id).addEventListener("click", () => ask(what));
byId("pin-tuned").addEventListener("click", () => ask("pin_tuned", { name: byId("tuned-name").value, from: "tuned-name" }));
byId("map-view").addEventListener("click", () => {
  const plane = Bokeh.documents[0].get_model_by_name("f_map");
  const [x, y] = [plane.x_range, plane.y_range].map((range) => [range.start, range.end]);
  ask("map", { seen: { x, y } });
});
byId("map-figure").addEventListener("change", (event) => ask("map_figure", { name: event.target.value }));

function upload(file) {
  if (!file) return;
  if (file.size > spec.largest) {
    byId("message").textContent = `${file.name}: ${(file.size / 1048576).toFixed(1)} MiB given; at most ${spec.largest / 1048576} MiB can be uploaded`;
    byId("message").hidden = false;
    return;
  }
  const reader = new FileReader();
  reader.onload = () => {
    const isScenario = /\.ya?ml$/i.test(file.name);
    if (!isScenario && view !== "estimate") turn("estimate");
    ask("upload", { name: file.name, data: reader.result.slice(reader.result.indexOf(",") + 1) });
  };
  reader.onerror = () => {
    byId("message").textContent = `${file.name}: cannot be read`;
    byId("message").hidden = false;
  };
  reader.readAsDataURL(file);
}

for (const id of ["open", "record"]) {
  byId(id).addEventListener("change", (event) => {
    upload(event.target.files[0]);
    event.target.value = "";
  });
}
document.addEventListener("dragover", (event) => {
  event.preventDefault();
  byId("drop").classList.add("over");
});
document.addEventListener("dragleave", () => byId("drop").classList.remove("over"));
document.addEventListener("drop", (event) => {
  event.preventDefault();
  byId("drop").classList.remove("over");
  upload(event.dataTransfer.files[0]);
});

// A page that is left or loaded anew begins from the start: the browser asks first where something would be lost.
window.addEventListener("beforeunload", (event) => {
  if (!byId("undo").disabled || !byId("use-model").disabled || !byId("progress").hidden) event.preventDefault();
});

// What sticks below the header begins where that ends: on a narrow page it has two lines.
new ResizeObserver(([{ target }]) => {
  document.documentElement.style.setProperty("--top", `${target.offsetHeight}px`);
}).observe(document.querySelector("header"));

// the connection ------------------------------------------------------------------------------------------------------

function connect() {
  const doc = window.Bokeh && Bokeh.documents[0];
  bridge = doc ? doc.get_model_by_name("bridge") : null;
  if (!bridge) {
    setTimeout(connect, 20);
    return;
  }
  bridge.properties.down.change.connect(taken);
  // A click in a picture waits its turn behind what was changed before it.
  for (const picture of ["f_map", "c_front"]) {
    const figure = doc.get_model_by_name(picture);
    figure.on_event("tap", ({ x, y }) => ask("tap", { picture, x, y }));
    doc.event_manager.subscribed_models.add(figure);
  }
  ask("hello");
}
connect();
