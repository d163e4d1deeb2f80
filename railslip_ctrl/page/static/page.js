"use strict";
// The page of `railslip design`. It draws and sends requests; the server does all computations of control theory.

const $ = (id) => document.getElementById(id);
const make = (tag, given) => Object.assign(document.createElement(tag), given);
const copyOf = structuredClone;
const CLIENT = Math.random().toString(36).slice(2);
const SHORT_WAIT = 100, LONG_WAIT = 350; // ms without a change before a request is sent: quick requests (longer than between two frames of a drag), slow requests
const RETRY = 1000; // ms before a request is repeated if the server is busy or does not answer
const STEPS = 1000, REACH = 10; // steps of a slider; its logarithmic scale covers the first value divided and multiplied by REACH
const SHOWN = 6; // number of sliders shown; the others are under "More parameters"
const PLOTS = ["nyquist", "bode", "step", "stop", "envelope-map"];

let setup = null; // the server's answer to "start"
let design = null; // {kind, values, reference}
let pinned = null; // {design, loop, stops}, drawn in grey for comparison
let loop = null, envelope = null, verdict = null, stops = null, region = null; // the newest answers
let fromKmh = 0, chosen = null, hardest = null; // operating point shown: least speed, the user's choice, else the hardest
let view = null, mapArea = null, regionAll = false, regionKey = ""; // map of gains: axes, panel, all points used, its design
let before = null; // the design before the change that is not yet on the undo list
let disconnected = false, writtenHash = null, addressTimer = 0;
const past = [], future = [], turns = {}, cursors = {}, cursorAt = {}, colours = {};
const fields = new Map(); // by the name of a parameter: {slider, field, low, high, set, now}

// --- texts -----------------------------------------------------------------------------------------------------------

function fmt(x, digits = 4) {
  if (x === null || x === undefined || Number.isNaN(x)) return "–";
  if (!Number.isFinite(x)) return x > 0 ? "∞" : "−∞";
  const size = Math.abs(x);
  const text = size >= 1e5 || (size && size < 1e-4) ? x.toExponential(digits - 1) : String(Number(x.toPrecision(digits)));
  return text.replace("-", "−");
}
const plainName = (name) => name.replaceAll("_", " ");
const unitOf = (unit) => (unit === "1" ? "" : `, ${unit.replaceAll("*", "·").replace("^2", "²")}`);
const msText = (ms, to = Math.ceil, side = -1) => (ms === null ? "unstable" : ms < 100 ? (to(100 * ms * (1 + side * 1e-6)) / 100).toFixed(2) : fmt(ms, 3));
const boundText = (ms) => (ms === null ? "–" : msText(ms, Math.floor, 1)); // as in the verdict: Ms is rounded up, a lower bound down
const quoted = (text) => `“${text.slice(0, 40)}”`;

// Show a message at the top. A message with `refused` disappears when the server accepts a design.
function notify(text, mild = false, refused = false) {
  Object.assign($("message"), { textContent: text, hidden: !text, className: mild ? "mild" : refused ? "refused" : "" });
}

// --- requests --------------------------------------------------------------------------------------------------------

// Return the answer, or {stale} after a newer request, or {busy}, or {error}, which is empty if the server does not answer.
async function send(name, extra = {}) {
  turns[name] = (turns[name] ?? 0) + 1;
  const body = JSON.stringify({ client: CLIENT, turn: turns[name], ...extra });
  let answer;
  try {
    const got = await fetch(name, { method: "POST", headers: { "Content-Type": "application/json" }, body });
    if (got.status === 200) answer = unpacked(await got.arrayBuffer());
    else answer = { 204: { stale: true }, 503: { busy: true } }[got.status] ?? { error: (await got.json()).error };
  } catch {
    serverLost();
    return { error: "" };
  }
  if (disconnected) serverBack();
  return answer;
}

function unpacked(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  let at = 4 + length;
  for (const [name, size] of Object.entries(head.arrays)) {
    head.arrays[name] = new Float32Array(buffer, at, size);
    at += 4 * size;
  }
  return head;
}

function serverLost() {
  notify("The server does not answer. The address of this page contains the whole design. "
    + "Start railslip design again with the same --port; the page then reconnects.");
  if (disconnected) return;
  disconnected = true;
  const later = () => setTimeout(() => disconnected && fetch("page.css").then((got) => (got.ok ? serverBack() : later()), later), RETRY);
  later();
}

function serverBack() {
  if (!disconnected) return;
  disconnected = false;
  notify("");
  if (setup === null) start();
  else designChanged();
}

// Requests of the same name, sent one after the other; if the design changes meanwhile, only the newest is sent.
class LatestRequest {
  constructor(name, wait, onAnswer, extra = () => ({})) {
    Object.assign(this, { name, wait, onAnswer, extra, pending: false, repeat: false, timer: 0 });
  }

  // Send the request after a pause in the changes, or after the answer to the present request.
  soon(wait = this.wait) {
    clearTimeout(this.timer);
    if (this.pending) this.repeat = true;
    else if (wait) this.timer = setTimeout(() => this.now(), wait);
    else this.now();
  }

  async now() {
    if (!kindNow().loop && this.name !== "loop" && this.name !== "stops") return;
    this.pending = true;
    this.repeat = false;
    const answer = await send(this.name, { design, ...this.extra() });
    this.pending = false;
    if (answer.busy) this.soon(RETRY);
    else if (!answer.stale && answer.error !== "" && !(answer.error && this.repeat)) this.onAnswer(answer, this.repeat);
    if (this.repeat && !disconnected) this.soon();
  }
}

const requests = {
  loop: new LatestRequest("loop", 0, takeLoop, () => ({ from: fromKmh, point: chosen ?? hardest })),
  envelope: new LatestRequest("envelope", SHORT_WAIT, takeEnvelope),
  stops: new LatestRequest("stops", SHORT_WAIT, takeStops),
  verdict: new LatestRequest("verdict", LONG_WAIT, takeVerdict),
  region: new LatestRequest("region", SHORT_WAIT, takeRegion, () => ({ axes: axes(), all: regionAll })),
};

// --- the design ------------------------------------------------------------------------------------------------------

const kindNow = () => setup.kinds[design.kind];
const axes = () => (kindNow().tuned ? ["kp", "ki"] : [$("axis-x").value, $("axis-y").value]);
const initialValues = (kind) => Object.fromEntries(setup.kinds[kind].sliders.map((parameter) => [parameter.name, parameter.value]));

// Send all requests again after a change of the design. `undoable`: add the change to the undo list.
function designChanged(undoable = false) {
  if (undoable) recordUndo();
  hardest = verdict = null;
  $("answer").classList.add("stale");
  showNumbers();
  for (const name of kindNow().loop ? ["loop", "envelope", "stops", "verdict"] : ["loop", "stops"]) requests[name].soon();
  if (kindNow().loop) askRegion();
  else takeEnvelope({ error: "No verdict: this controller has no linear loop. See the braking runs." });
  drawMap();
  clearTimeout(addressTimer);
  addressTimer = setTimeout(writeAddress, 150);
}

function recordUndo() {
  if (before !== null && JSON.stringify(before) !== JSON.stringify(design)) {
    past.push(before);
    future.length = 0;
  }
  before = copyOf(design);
  $("undo").disabled = !past.length;
  $("redo").disabled = !future.length;
}

// Replace the design, possibly by one of another kind.
function setDesign(given, undoable = true) {
  design = given;
  notify("");
  showKind();
  designChanged(undoable);
}

function goTo(from, to) {
  if (!from.length) return;
  to.push(copyOf(design));
  before = copyOf(from.at(-1));
  setDesign(from.pop(), false);
  recordUndo();
}

function askRegion() {
  const [x, y] = axes();
  const others = Object.entries(design.values).filter(([name]) => name !== x && name !== y);
  const key = JSON.stringify([design.kind, x, y, others, design.reference]);
  if (key === regionKey) return;
  regionKey = key;
  regionAll = false;
  $("map-note").textContent = "…";
  requests.region.soon();
}

// --- the address -----------------------------------------------------------------------------------------------------

function writeAddress() {
  const slips = Object.entries(design.reference).map(([rail, slip]) => [`slip.${rail}`, slip]);
  writtenHash = `#${new URLSearchParams([["kind", design.kind], ...Object.entries(design.values), ...slips])}`;
  history.replaceState(null, "", writtenHash);
}

// Read the design from the address. Invalid entries are reported and ignored.
function takeAddress() {
  if (location.hash === writtenHash) return null;
  const entries = new URLSearchParams(location.hash.slice(1)), wrong = [];
  let kind = entries.get("kind") ?? design.kind;
  if (!Object.hasOwn(setup.kinds, kind)) {
    wrong.push(`kind ${quoted(kind)} is not known; choose one of ${Object.keys(setup.kinds).join(", ")}`);
    kind = design.kind;
  }
  const free = kind === "transfer-function" && [...entries.keys()].some((name) => /^[ab]\d+$/.test(name));
  const given = { kind, values: free ? {} : kind === design.kind ? { ...design.values } : initialValues(kind), reference: { ...design.reference } };
  for (const [name, text] of entries) {
    const rail = name.startsWith("slip.") ? name.slice(5) : "", value = Number(text);
    const known = rail ? Object.hasOwn(given.reference, rail) : free ? /^[ab]\d{1,2}$/.test(name) : Object.hasOwn(given.values, name);
    if (name === "kind") continue;
    if (!known) wrong.push(`${kind} has no parameter ${quoted(name)}`);
    else if (!text.trim() || !Number.isFinite(value)) wrong.push(`${name}: ${quoted(text)} is not a number`);
    else if (rail && !(value > 0 && value < 1)) wrong.push(`${name}: ${quoted(text)} is not between 0 and 1`);
    else if (rail) given.reference[rail] = value;
    else given.values[name] = value;
  }
  setDesign(given);
  return wrong.length ? notify(`Ignored in the address: ${wrong.join("; ")}.`) : null;
}

// --- fields ----------------------------------------------------------------------------------------------------------

function addNumber(parent, { name, label, unit, meaning, value, most }, set) {
  const caption = make("label", { htmlFor: name, title: meaning, textContent: (label ?? plainName(name)) + unitOf(unit) });
  const slider = make("input", { type: "range", min: 0, max: STEPS, id: `${name}-slider`, title: meaning });
  const field = make("input", { type: "text", inputMode: "decimal", id: name, autocomplete: "off", title: meaning });
  slider.setAttribute("aria-label", `${caption.textContent}: ${meaning}`);
  parent.appendChild(make("div", { className: "number" })).append(caption, slider, field);
  const size = Math.abs(value) || 1, entry = { slider, field, set, low: size / REACH, high: Math.min(size * REACH, most ?? Infinity) };
  slider.addEventListener("input", () => {
    const size = entry.low * (entry.high / entry.low) ** (slider.value / STEPS);
    set(Number((entry.now < 0 ? -size : size).toPrecision(6)));
    designChanged();
  });
  slider.addEventListener("change", recordUndo);
  const typed = () => {
    clearTimeout(entry.timer);
    const text = field.value.trim().replace("−", "-").replace(",", "."), given = Number(text);
    const good = text !== "" && Number.isFinite(given);
    field.setAttribute("aria-invalid", String(!good));
    notify(good ? "" : `${caption.textContent}: ${quoted(text)} is not a number; the previous value is kept`);
    if (!good || given === entry.now) return;
    set(given);
    designChanged();
  };
  field.addEventListener("input", () => {
    clearTimeout(entry.timer);
    entry.timer = setTimeout(typed, LONG_WAIT);
  });
  for (const act of [typed, recordUndo]) field.addEventListener("change", act);
  fields.set(name, entry);
}

function showKind() {
  $("kind").value = design.kind;
  const free = design.kind === "transfer-function", { tuned, loop: linear, sampled, follows } = kindNow();
  const hidden = { tuning: !tuned, "tuning-ki": !tuned, axes: tuned || !linear, coefficients: !free, fixed: !setup.fixed, "own-slip": follows || setup.fixed };
  for (const [id, state] of Object.entries(hidden)) $(id).hidden = state;
  for (const each of document.querySelectorAll(".sampled-too")) each.hidden = !sampled;
  for (const [name, { slider, field }] of fields) if (name.startsWith("slip-")) slider.disabled = field.disabled = setup.fixed || !follows;
  for (const id of ["sliders", "more-sliders"]) $(id).replaceChildren();
  for (const name of fields.keys()) if (!name.startsWith("slip-")) fields.delete(name);
  const known = new Map(kindNow().sliders.map((parameter) => [parameter.name, parameter]));
  const names = free ? Object.keys(design.values).sort((a, b) => b.localeCompare(a, undefined, { numeric: true })) : [...known.keys()];
  names.forEach((name, i) => {
    const parameter = known.get(name) ?? { name, unit: "1", meaning: `coefficient of the power ${name.slice(1)}`, most: null };
    addNumber($(i < SHOWN ? "sliders" : "more-sliders"), { ...parameter, value: parameter.value || design.values[name] }, (value) => (design.values[name] = value));
  });
  for (const [id, letter] of [["num", "b"], ["den", "a"]]) {
    $(id).setAttribute("aria-invalid", "false");
    if (free) $(id).value = names.filter((name) => name[0] === letter).map((name) => design.values[name]).join(", ");
  }
  $("more").hidden = names.length <= SHOWN;
  for (const [id, index] of [["axis-x", 0], ["axis-y", 1]]) {
    const previous = $(id).value;
    $(id).replaceChildren(...names.map((name) => new Option(plainName(name), name)));
    $(id).value = names.includes(previous) ? previous : names[Math.min(index, names.length - 1)];
  }
  showNumbers();
}

function showNumbers() {
  for (const [name, entry] of fields) {
    const value = (entry.now = name.startsWith("slip-") ? design.reference[name.slice(5)] : design.values[name]), size = Math.abs(value);
    if (size) Object.assign(entry, { low: Math.min(entry.low, size), high: Math.max(entry.high, size) });
    entry.slider.value = size ? Math.round((STEPS * Math.log(size / entry.low)) / Math.log(entry.high / entry.low)) : 0;
    entry.slider.setAttribute("aria-valuetext", fmt(value));
    if (document.activeElement === entry.field) continue;
    entry.field.value = String(Number(value.toPrecision(6)));
    entry.field.removeAttribute("aria-invalid");
  }
}

function typedCoefficients() {
  const values = {};
  for (const [id, letter] of [["num", "b"], ["den", "a"]]) {
    const parts = $(id).value.split(/[,;\s]+/).filter(Boolean).map(Number), good = parts.length > 0 && parts.length <= 12 && parts.every(Number.isFinite);
    $(id).setAttribute("aria-invalid", String(!good));
    if (!good) return notify(`${$(id).labels[0].textContent}: give one to twelve numbers, separated by commas; the previous values are kept`);
    parts.forEach((value, i) => (values[`${letter}${parts.length - 1 - i}`] = value));
  }
  return setDesign({ ...design, values });
}

// --- answers ---------------------------------------------------------------------------------------------------------

function takeLoop(answer) {
  if (answer.error) return notify(answer.error, false, true);
  if ($("message").className === "refused") notify("");
  loop = answer;
  showMargins();
  $("where").textContent = answer.where;
  for (const id of ["nyquist", "bode", "step"]) draw[id]();
  document.body.dataset.painted = String(Number(document.body.dataset.painted ?? 0) + 1);
  return null;
}

// Show the margins of the loop, and its gain range over the envelope as soon as it is known.
function showMargins() {
  const { stable, no_loop: none } = loop, least = (verdict ?? envelope)?.least ?? null;
  const margin = (value, unit) => (none || !stable ? "–" : fmt(value ?? Infinity, 3) + unit);
  $("ms").textContent = none ? "–" : msText(loop.ms);
  $("phase-margin").textContent = margin(loop.phase_margin_deg, "°");
  $("delay-margin").textContent = margin(loop.delay_margin_s, " s");
  const range = least ?? (stable ? loop : null);
  let text = none ? "–" : "none";
  if (range) text = `${fmt(range.gain_decrease ?? 0, 3)} to ${fmt(range.gain_increase ?? Infinity, 3)} times`;
  else if (loop.range) text = `stable ${fmt(loop.range[0] ?? 0, 3)} to ${fmt(loop.range[1] ?? Infinity, 3)} times`;
  $("gain-range").textContent = text;
  $("bound").textContent = none ? "–" : `≥ ${boundText(loop.least_ms)}`;
}

function showVerdict(answer, outdated = false) {
  $("verdict").className = answer.verdict ?? "";
  $("verdict").textContent = answer.line;
  $("slip-notes").textContent = answer.notes?.join(". ") ?? "";
  $("answer").classList.toggle("stale", outdated);
  if (loop) showMargins();
  draw["envelope-map"]();
}

function takeEnvelope(answer, outdated) {
  envelope = answer.error ? null : answer;
  if (answer.error) return showVerdict({ line: answer.error });
  const points = Object.keys(answer.points), list = $("point");
  if ([...list.options].slice(1).map((option) => option.textContent).join() !== points.join()) {
    list.replaceChildren(new Option("worst", ""), ...points.map((point) => new Option(point, String(answer.points[point]))));
    chosen = null;
  }
  fromKmh = answer.usable_from_kmh ?? 0;
  if (chosen === null && !outdated && loop?.point !== answer.hardest) {
    hardest = answer.hardest;
    requests.loop.soon();
  }
  return showVerdict(verdict ?? answer, outdated);
}

function takeVerdict(answer, outdated) {
  if (!answer.error && !outdated) showVerdict((verdict = answer));
}

function takeStops(answer) {
  if (answer.error) return notify(answer.error, false, true);
  stops = answer;
  return draw.stop();
}

function takeRegion(answer, outdated) {
  if (outdated) return;
  region = answer.error ? { levels: [] } : answer;
  const none = answer.error ?? "no gains of this kind stabilise every operating point: give a smaller reference slip or choose another kind";
  const few = "at the hardest operating points";
  $("map-note").textContent = region.levels?.length === 0 ? none : region.few ? `${few}; the others follow` : region.levels ? "" : few;
  if (!answer.error) fitMap();
  drawMap();
  if (!region.few) return;
  regionAll = true;
  requests.region.soon();
}

// --- drawing ---------------------------------------------------------------------------------------------------------

const COLOURS = "paper panel ink dim rule grid line pinned worst good fair bad shade from to void".split(" ");
const FONT = "11.5px system-ui, sans-serif", MARGIN = { left: 50, right: 10, title: 17, bottom: 34 };

function readColours() {
  const style = getComputedStyle(document.documentElement);
  for (const name of COLOURS) colours[name] = style.getPropertyValue(`--${name}`).trim();
}

// Return a colour of the Ms scale; 0 is the palest, 1 the strongest.
function mixed(share) {
  const part = (text, i) => parseInt(text.slice(1 + 2 * i, 3 + 2 * i), 16);
  return `rgb(${[0, 1, 2].map((i) => Math.round(part(colours.from, i) + (part(colours.to, i) - part(colours.from, i)) * share)).join()})`;
}

// Clear a canvas and set its units to CSS pixels.
function clearedCanvas(id) {
  const canvas = $(id), ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
  if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
  const ctx = canvas.getContext("2d");
  ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
  ctx.fillStyle = colours.paper;
  ctx.fillRect(0, 0, width, height);
  Object.assign(ctx, { font: FONT, lineJoin: "round", textBaseline: "middle" });
  return { ctx, width, height };
}

function write(ctx, text, x, y, align = "left", colour = colours.dim) {
  Object.assign(ctx, { textAlign: align, fillStyle: colour });
  ctx.fillText(text, x, y);
}

function ticksOf([low, high], log, count) {
  const found = [];
  if (log) {
    const decades = Math.log10(high / low), steps = decades > 3 ? [1] : decades > 1.2 ? [1, 3] : [1, 2, 3, 5];
    for (let k = Math.floor(Math.log10(low)); k <= Math.log10(high); k += Math.max(1, Math.ceil(decades / count))) {
      found.push(...steps.map((step) => step * 10 ** k).filter((at) => at >= low * 0.999 && at <= high * 1.001));
    }
    return found.length > 1 ? found : ticksOf([low, high], false, count);
  }
  const size = 10 ** Math.floor(Math.log10((high - low) / count)), step = size * [1, 2, 5, 10].find((factor) => factor * size >= (high - low) / count);
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i++) found.push(i * step);
  return found.length > 1 || count > 20 ? found : ticksOf([low, high], false, count + 1); // at least two ticks
}

// Draw a panel between two heights of a canvas, with title and ticks; its functions `x` and `y` convert numbers to pixels.
function panel({ ctx, width }, top, bottom, spec) {
  const left = MARGIN.left, right = width - MARGIN.right;
  const share = ([low, high], log) => (v) => (log ? Math.log(v / low) / Math.log(high / low) : (v - low) / (high - low));
  const scale = (ends, log, from, to) => (v) => from + (to - from) * share(ends, log)(v);
  const area = { ctx, left, right, top, bottom, x: scale(spec.x, spec.logX, left, right), y: scale(spec.y, spec.logY, bottom, top) };
  write(ctx, spec.title, left, top - 9);
  Object.assign(ctx, { strokeStyle: colours.grid, lineWidth: 1 });
  ctx.beginPath();
  for (const at of spec.ticksY ?? ticksOf(spec.y, spec.logY, Math.max(2, Math.round((bottom - top) / 30)))) {
    const py = Math.round(area.y(at)) + 0.5;
    ctx.moveTo(left, py);
    ctx.lineTo(right, py);
    write(ctx, fmt(at, 3), left - 5, py, "right");
  }
  for (const at of ticksOf(spec.x, spec.logX, Math.max(3, Math.round((right - left) / 75)))) {
    const px = Math.round(area.x(at)) + 0.5;
    ctx.moveTo(px, top);
    ctx.lineTo(px, bottom);
    if (spec.labelX) write(ctx, fmt(at, 3), px, bottom + 10, "center");
  }
  ctx.stroke();
  if (spec.labelX) write(ctx, spec.labelX, right, bottom + 25, "right");
  ctx.strokeStyle = colours.rule;
  ctx.strokeRect(left + 0.5, top + 0.5, right - left, bottom - top);
  return area;
}

// Draw the panels of a plot one below the other, with equal heights and a common x axis.
function stacked(of, x, logX, labelX, specs) {
  const high = (of.height - MARGIN.bottom) / specs.length;
  return specs.map((spec, i) => panel(of, i * high + MARGIN.title, (i + 1) * high - 4, { ...spec, x, logX, labelX: i === specs.length - 1 ? labelX : "" }));
}

function inside({ ctx, left, right, top, bottom }, work) {
  ctx.save();
  ctx.beginPath();
  ctx.rect(left, top, right - left, bottom - top);
  ctx.clip();
  work(ctx);
  ctx.restore();
}

function line(area, xs, ys, colour, wide = 2, dash = []) {
  const { ctx } = area, far = 4000; // pixels; points farther away are drawn at this distance
  Object.assign(ctx, { strokeStyle: colour, lineWidth: wide });
  ctx.setLineDash(dash);
  ctx.beginPath();
  for (let i = 0, down = false; i < xs.length; i++) {
    const px = area.x(xs[i]), py = Math.max(-far, Math.min(far, area.y(ys[i])));
    const good = Number.isFinite(px) && Number.isFinite(py);
    if (good && down) ctx.lineTo(px, py);
    else if (good) ctx.moveTo(px, py);
    down = good;
  }
  ctx.stroke();
  ctx.setLineDash([]);
}

function ring(ctx, px, py, radius, colour, fill, wide = 2, dash = []) {
  ctx.beginPath();
  ctx.arc(px, py, radius, 0, 2 * Math.PI);
  if (fill) {
    ctx.fillStyle = fill;
    ctx.fill();
  }
  Object.assign(ctx, { strokeStyle: colour, lineWidth: wide });
  ctx.setLineDash(dash);
  ctx.stroke();
  ctx.setLineDash([]);
}

const dot = (area, x, y, colour, hollow = false) => ring(area.ctx, area.x(x), area.y(y), hollow ? 6 : 3.5, colour, hollow ? colours.paper : colour);

function hatch(ctx, x, y, wide, high) {
  ctx.save();
  ctx.beginPath();
  ctx.rect(x, y, wide, high);
  ctx.clip();
  Object.assign(ctx, { strokeStyle: colours.rule, lineWidth: 1 });
  ctx.beginPath();
  for (let at = -high; at < wide; at += 8) {
    ctx.moveTo(x + at, y + high);
    ctx.lineTo(x + at + high, y);
  }
  ctx.stroke();
  ctx.restore();
}

// Show a message in place of a plot.
function plotMessage(id, message) {
  const { ctx, width, height } = clearedCanvas(id), lines = [""];
  ctx.fillStyle = colours.panel;
  ctx.fillRect(0, 0, width, height);
  for (const word of message.split(" ")) {
    if (ctx.measureText(`${lines.at(-1)} ${word}`).width > width - 40) lines.push("");
    lines.push(`${lines.pop()} ${word}`.trim());
  }
  lines.forEach((text, i) => write(ctx, text, width / 2, height / 2 + 17 * (i - (lines.length - 1) / 2), "center"));
  cursors[id] = null;
}

// Return the ends of an axis that shows the values of all lists between two bounds.
function extent(lists, low, high, room) {
  let [a, b] = [Infinity, -Infinity];
  for (const v of lists.flatMap((list) => [...(list ?? [])])) {
    if (v < a && v >= low) a = v;
    if (v > b && v <= high) b = v;
  }
  if (b < a) [a, b] = [0, 1];
  const more = Math.max(0.06 * (b - a), room);
  return [a - more, b + more];
}

// Let the user read values from a plot. Arguments: number of points; functions for the point nearest to the pointer,
// for the dots of a point and for its text.
function readable(id, count, near, marks, text) {
  cursors[id] = { count, near, marks, text };
  const at = cursorAt[id] === null || cursorAt[id] === undefined ? null : Math.min(cursorAt[id], count - 1);
  for (const [area, x, y] of at === null ? [] : marks(at)) inside(area, () => dot(area, x, y, colours.ink));
  $(`${id}-read`).textContent = at === null ? "" : text(at);
}

function nearest(count, away) {
  let best = 0;
  for (let i = 1, least = away(0); i < count; i++) if (away(i) < least) [best, least] = [i, away(i)];
  return best;
}

const nearX = (area, xs) => (px) => nearest(xs.length, (i) => Math.abs(area.x(xs[i]) - px));

const draw = {
  nyquist() {
    if (!loop) return;
    if (loop.no_loop) return plotMessage("nyquist", loop.no_loop);
    const of = clearedCanvas("nyquist"), high = of.height - MARGIN.bottom, reach = 2.3; // length of the imaginary axis shown
    const wide = (reach * (of.width - MARGIN.left - MARGIN.right)) / (high - MARGIN.title);
    const area = panel(of, MARGIN.title, high, { x: [-0.9 - wide / 2, -0.9 + wide / 2], y: [-0.55 * reach, 0.45 * reach], title: "imaginary part of L", labelX: "real part of L" });
    const { re, im, omega } = loop.arrays, old = pinned?.loop.arrays, w = loop.frequencies?.ms, size = area.x(0) - area.x(-1);
    inside(area, (ctx) => {
      ring(ctx, area.x(-1), area.y(0), size / loop.least_ms, colours.dim, "", 1.25, [5, 4]);
      if (loop.ms) ring(ctx, area.x(-1), area.y(0), size / loop.ms, colours.worst, colours.shade, 1.5);
      if (old?.re) line(area, old.re, old.im, colours.pinned);
      line(area, re, im, colours.line);
      line({ ...area, x: (v) => area.x(-1) + v, y: (v) => area.y(0) + v }, [-5, 5, NaN, -5, 5], [-5, 5, NaN, 5, -5], colours.ink);
      const worst = w ? nearest(omega.length, (i) => Math.abs(Math.log(omega[i] / w))) : -1;
      if (worst >= 0) dot(area, re[worst], im[worst], colours.worst, true);
    });
    readable("nyquist", re.length, (px, py) => nearest(re.length, (i) => Math.hypot(area.x(re[i]) - px, area.y(im[i]) - py)), (i) => [[area, re[i], im[i]]],
      (i) => `${fmt(omega[i])} rad/s: L = ${fmt(re[i], 3)} ${im[i] < 0 ? "−" : "+"} ${fmt(Math.abs(im[i]), 3)} j`);
    return $("nyquist").setAttribute("aria-label", loop.stable ? `Nyquist diagram, Ms ${msText(loop.ms)}` : "Nyquist diagram of an unstable loop");
  },

  bode() {
    if (!loop) return;
    if (loop.no_loop) return plotMessage("bode", loop.no_loop);
    const { omega, db, phase } = loop.arrays, old = pinned?.loop.arrays, of = clearedCanvas("bode");
    const shown = [...omega.keys()].filter((i) => Math.abs(db[i]) < 60), ends = shown.length > 20 ? [shown[0], shown.at(-1)] : [0, omega.length - 1];
    const x = ends.map((i) => omega[i]), seen = (list) => list.slice(ends[0], ends[1] + 1), [low, high] = extent([seen(phase)], -1e4, 1e4, 15);
    const y = [Math.max(low, Math.min(high, -120) - 480), high], ticksY = [];
    for (let at = Math.ceil(y[0] / 90) * 90; at <= y[1]; at += y[1] - y[0] > 400 ? 180 : 90) ticksY.push(at);
    const areas = stacked(of, x, true, "rad/s", [{ title: "|L|, dB", y: extent([seen(db)], -60, 60, 3) }, { title: "phase, deg", y, ticksY }]);
    const value = (list, w) => { // interpolated at the frequency w
      const i = Math.min(omega.length - 1, Math.max(1, omega.findIndex((frequency) => frequency >= w)));
      return list[i - 1] + ((list[i] - list[i - 1]) * Math.log(w / omega[i - 1])) / Math.log(omega[i] / omega[i - 1]);
    };
    const { phase_margin: pm, gain_increase: up, gain_decrease: down } = loop.frequencies ?? {};
    const bars = [[up, down].filter(Boolean).map((w) => [w, value(db, w), 0]), [pm].filter(Boolean).map((w) => [w, value(phase, w), Math.round((value(phase, w) - 180) / 360) * 360 + 180])];
    areas.forEach((area, k) => inside(area, (ctx) => {
      const [from, to] = loop.crossover ? [loop.crossover[0] ?? 0, loop.crossover[1] ?? Infinity] : [Infinity, Infinity];
      const [px, qx] = [from, to].map((w) => Math.max(area.left, Math.min(area.right, w ? area.x(w) : area.left)));
      ctx.fillStyle = colours.shade;
      ctx.fillRect(area.left, area.top, px - area.left, area.bottom - area.top);
      ctx.fillRect(qx, area.top, area.right - qx, area.bottom - area.top);
      for (const at of k ? [-180, -540] : [0]) line(area, x, [at, at], colours.dim, 1, [4, 3]);
      if (old?.omega) line(area, old.omega, k ? old.phase : old.db, colours.pinned);
      line(area, omega, k ? phase : db, colours.line);
      for (const [w, a, b] of bars[k]) {
        line(area, [w, w], [a, b], colours.worst, 3);
        dot(area, w, a, colours.worst);
      }
    }));
    readable("bode", omega.length, nearX(areas[0], omega), (i) => [[areas[0], omega[i], db[i]], [areas[1], omega[i], phase[i]]],
      (i) => `${fmt(omega[i])} rad/s: ${fmt(db[i], 3)} dB, ${fmt(phase[i])}°`);
    return $("bode").setAttribute("aria-label", pm ? `Bode diagram, phase margin ${fmt(loop.phase_margin_deg, 3)} degrees at ${fmt(pm, 3)} radians a second` : "Bode diagram");
  },

  step() {
    if (!loop) return;
    if (loop.no_loop || loop.no_step) return plotMessage("step", loop.no_loop ?? loop.no_step);
    const { time, step, load } = loop.arrays, old = pinned?.loop.arrays, most = loop.stable ? 1e6 : 3; // limits the y axis of an unstable loop
    const specs = [
      { title: "slip velocity, m/s: reference step of 1 m/s", y: extent([step, [0, 1], old?.step], -most, most, 0) },
      { title: `slip velocity, m/s: load step of ${fmt(setup.load_step)} N·m at the wheel`, y: extent([load, [0], old?.load], -most, most, 1e-9) },
    ];
    const areas = stacked(clearedCanvas("step"), [0, time.at(-1)], false, "s", specs);
    areas.forEach((area, k) => inside(area, () => {
      line(area, [0, time.at(-1)], k ? [0, 0] : [1, 1], colours.dim, 1, [4, 3]);
      if (old?.time) line(area, old.time, k ? old.load : old.step, colours.pinned);
      line(area, time, k ? load : step, colours.line);
    }));
    return readable("step", time.length, nearX(areas[0], time), (i) => [[areas[0], time[i], step[i]], [areas[1], time[i], load[i]]],
      (i) => `${fmt(time[i], 3)} s: ${fmt(step[i], 3)} m/s after the step, ${fmt(load[i], 3)} m/s after the load`);
  },

  stop() {
    if (!stops) return;
    const name = document.querySelector("input[name=run]:checked").value;
    const columns = (of) => of && Object.fromEntries(["time", "train", "wheel", "slip", "reference", "torque"].map((column) => [column, of.arrays[`${name} ${column}`]]));
    const now = columns(stops), old = columns(pinned?.stops), { time } = now, end = Math.max(time.at(-1), old?.time.at(-1) ?? 0);
    const parts = [["km/h: train (dashed) and wheel", "wheel", "train", 1], ["slip, and its reference (dashed)", "slip", "reference", 0.004], ["torque, N·m", "torque", "torque", 20]];
    const specs = parts.map(([title, first, second, room]) => ({ title, y: extent([now[first], now[second], old?.[first]], -1e9, 1e9, room) }));
    const areas = stacked(clearedCanvas("stop"), [0, end], false, "s", specs);
    areas.forEach((area, k) => inside(area, () => {
      if (old) line(area, old.time, old[parts[k][1]], colours.pinned, 1.5);
      line(area, time, now[parts[k][1]], colours.line, 1.5);
      if (k < 2) line(area, time, now[parts[k][2]], colours.ink, 1.25, [5, 4]);
    }));
    readable("stop", time.length, nearX(areas[0], time), (i) => areas.map((area, k) => [area, time[i], now[parts[k][1]][i]]),
      (i) => `${fmt(time[i], 3)} s: train ${fmt(now.train[i], 3)}, wheel ${fmt(now.wheel[i], 3)} km/h, slip ${fmt(now.slip[i], 3)}, torque ${fmt(now.torque[i])} N·m`);
    $("stop-summary").textContent = stops.descriptions[name].replaceAll("N*m", "N·m").split("\n").join(". ");
    return $("stop").setAttribute("aria-label", `Braking run: ${stops.descriptions[name].split("\n")[0]}`);
  },

  // Worst Ms at each speed and load: the first number is for the operating points, the second includes tolerances.
  "envelope-map"() {
    if (!envelope) return plotMessage("envelope-map", "no map: this controller has no linear loop");
    const { ctx, width, height } = clearedCanvas("envelope-map"), { speeds_kmh: speeds, loads, operating } = envelope.map, worse = verdict?.map.with_tolerances;
    const left = MARGIN.left + 6, wide = (width - left - 4) / speeds.length, high = (height - MARGIN.bottom) / loads.length;
    const cell = (i, j) => [left + i * wide + 2, j * high + 2, wide - 4, high - 4];
    loads.forEach((load, j) => {
      write(ctx, load, left - 6, high * (j + 0.5), "right");
      speeds.forEach((_, i) => {
        const ms = operating[i][j], [px, py] = [left + (i + 0.5) * wide, (j + 0.5) * high];
        ctx.fillStyle = colours.panel;
        ctx.fillRect(...cell(i, j));
        if (envelope.bounds[i][j] > setup.robust_ms) hatch(ctx, ...cell(i, j));
        Object.assign(ctx, { lineWidth: 2, strokeStyle: ms === null ? colours.bad : ms <= setup.robust_ms * (1 + 1e-6) ? colours.good : colours.fair });
        ctx.strokeRect(...cell(i, j));
        write(ctx, ms === null && wide < 60 ? "✗" : msText(ms), px, py - (worse ? 9 : 0), "center", colours.ink);
        if (worse) write(ctx, worse[i][j] === null ? "✗" : msText(worse[i][j]), px, py + 9, "center");
      });
    });
    speeds.forEach((speed, i) => write(ctx, fmt(speed, 3), left + (i + 0.5) * wide, height - 24, "center"));
    write(ctx, "km/h", width - 4, height - 8, "right");
    $("cells-note").textContent = `${worse ? "; second number: with tolerances" : ""}; hatched: no controller has Ms ≤ ${fmt(setup.robust_ms)}`;
    const clamp = (v, most) => Math.max(0, Math.min(most - 1, Math.floor(v))), of = (k) => [k % speeds.length, Math.floor(k / speeds.length)];
    readable("envelope-map", speeds.length * loads.length, (px, py) => clamp((px - left) / wide, speeds.length) + speeds.length * clamp(py / high, loads.length), () => [], (k) => {
      const [i, j] = of(k);
      return `${fmt(speeds[i], 3)} km/h, ${loads[j]}: Ms ${msText(operating[i][j])}${worse ? `, with tolerances ${msText(worse[i][j])}` : ""}; lower bound for any controller ${boundText(envelope.bounds[i][j])}`;
    });
    const all = operating.flat();
    return $("envelope-map").setAttribute("aria-label", `Worst Ms over speed and load: ${all.includes(null) ? "unstable somewhere" : `at most ${msText(Math.max(...all))}`}`);
  },
};

// --- the map of gains ------------------------------------------------------------------------------------------------

function fitMap() {
  const [x, y] = axes().map((name) => design.values[name]);
  if (region.m) {
    const ends = [region.x, region.y].map((list) => [Math.min(...list), Math.max(...list)]);
    view = { x: ends[0], y: ends[1], log: ends[0][0] > 0 && ends[1][0] > 0 };
    return;
  }
  const level = region.levels.find((each) => each.ms !== null) ?? region.levels[0], rows = level?.rows ?? [];
  const kp = [...rows.flatMap((row) => row[1].flat()), x, ...(rows.length ? [] : [x / 3, 3 * x])], room = 0.1 * (Math.max(...kp) - Math.min(...kp));
  const top = Math.max(...rows.map((row) => row[0]), 1e-9);
  view = { x: [Math.min(...kp) - room, Math.max(...kp) + room], y: [0, y > 0.95 * top ? 1.1 * y : top], log: false };
}

function drawMap() {
  $("map-help").hidden = !kindNow().loop;
  $("map-read").textContent = "";
  if (!view || !kindNow().loop) return plotMessage("gain-map", kindNow().loop ? "…" : "no map: this controller has no linear loop");
  const of = clearedCanvas("gain-map"), names = axes(), [x, y] = names.map((name) => design.values[name]), labels = names.map((name) => plainName(name) + unitOf(kindNow().sliders.find((parameter) => parameter.name === name)?.unit ?? "1"));
  const area = (mapArea = panel(of, MARGIN.title, of.height - MARGIN.bottom, { x: view.x, y: view.y, logX: view.log, logY: view.log, labelX: labels[0], title: labels[1] }));
  inside(area, (ctx) => {
    ctx.fillStyle = colours.void;
    ctx.fillRect(area.left, area.top, area.right - area.left, area.bottom - area.top);
    hatch(ctx, area.left, area.top, area.right - area.left, area.bottom - area.top);
    if (region?.m) drawCells(area);
    else if (region) drawLevels(area);
    if (pinned?.design.kind === design.kind) dot(area, ...names.map((name) => pinned.design.values[name]), colours.pinned);
    const [px, py] = [[area.x(x), area.left, area.right], [area.y(y), area.top, area.bottom]].map(([at, a, b]) => Math.max(a + 9, Math.min(b - 9, at)));
    ring(ctx, px, py, 8, colours.worst, colours.paper, 3);
    ring(ctx, px, py, 1.5, colours.worst, colours.worst);
  });
  return ($("map-read").textContent = `${labels[0]}: ${fmt(x, 5)}; ${labels[1]}: ${fmt(y, 5)}`);
}

// Draw each level as bands between neighbouring rows of ki, then its outline and its Ms at the top.
function drawLevels(area) {
  const { ctx } = area;
  region.levels.forEach(({ ms, rows }, k) => {
    ctx.beginPath();
    rows.slice(1).forEach(([top, above], i) => {
      const [bottom, below] = rows[i];
      for (const [a, b] of below) {
        for (const [c, d] of above) {
          if (b < c || d < a) continue;
          [[a, bottom], [b, bottom], [d, top], [c, top]].forEach(([kp, ki], n) => ctx[n ? "lineTo" : "moveTo"](area.x(kp), area.y(ki)));
          ctx.closePath();
        }
      }
    });
    ctx.fillStyle = ctx.strokeStyle = ms === null ? colours.paper : mixed((0.85 * k) / (region.levels.length - 1));
    ctx.lineWidth = 1; // closes the gap between bands
    ctx.fill();
    ctx.stroke();
  });
  for (const { ms, rows } of region.levels) {
    const single = rows.filter((row) => row[1].length === 1), strong = ms === null || ms === setup.robust_ms;
    for (const side of [0, 1]) line(area, single.map((row) => row[1][0][side]), single.map((row) => row[0]), strong ? colours.ink : colours.dim, strong ? 1.75 : 0.75);
  }
  for (const { ms, rows } of region.levels.filter((each) => each.ms !== null)) {
    const [ki, gaps] = rows.at(-1), [px, py] = [area.x((gaps[0][0] + gaps.at(-1)[1]) / 2), Math.max(area.top + 8, Math.min(area.bottom - 8, area.y(ki)))];
    ctx.fillStyle = colours.paper;
    ctx.fillRect(px - 10, py - 7, 20, 14);
    write(ctx, fmt(ms, 2), px, py, "center", colours.ink);
  }
}

// Draw the worst Ms as coloured cells, with a dot in each robust cell.
function drawCells(area) {
  const middles = (list, along) => list.slice(1).map((v, i) => (along(v) + along(list[i])) / 2);
  const edges = (list, along) => [along(list[0]), ...middles(list, along), along(list.at(-1))];
  const xs = edges(region.x, area.x), ys = edges(region.y, area.y);
  region.m.forEach((column, i) => column.forEach((ms, j) => {
    if (ms === null) return;
    const [px, py, qx, qy] = [xs[i], ys[j], xs[i + 1], ys[j + 1]];
    area.ctx.fillStyle = mixed(0.85 * Math.max(0, Math.min(1, 1 - Math.log(ms / 1.4) / Math.log(3))));
    area.ctx.fillRect(Math.min(px, qx), Math.min(py, qy), Math.abs(qx - px) + 0.6, Math.abs(qy - py) + 0.6);
    if (ms <= setup.robust_ms) ring(area.ctx, (px + qx) / 2, (py + qy) / 2, 1, colours.ink, colours.ink, 1);
  }));
}

function dragTo(event) {
  if (!view || !mapArea || !kindNow().loop) return; // no map yet after a change of kind
  const box = $("gain-map").getBoundingClientRect(), { left, right, top, bottom } = mapArea, names = axes();
  const along = ([low, high], share) => (view.log ? low * (high / low) ** share : low + (high - low) * share);
  const shares = [(event.clientX - box.left - left) / (right - left), (bottom - event.clientY + box.top) / (bottom - top)];
  const values = shares.map((share, i) => along(i ? view.y : view.x, Math.max(0, Math.min(1, share))));
  values.forEach((value, i) => (design.values[names[i]] = Number(value.toPrecision(6))));
  designChanged();
}

function moveBy(event) {
  const along = { ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowDown: [1, -1], ArrowUp: [1, 1] }[event.key];
  if (!along || !kindNow().loop) return;
  event.preventDefault();
  const name = axes()[along[0]], now = design.values[name], step = event.shiftKey ? 0.1 : event.altKey ? 0.002 : 0.02;
  design.values[name] = now ? Number((now * (1 + step) ** (along[1] * Math.sign(now))).toPrecision(8)) : along[1] * step;
  designChanged();
}

// --- buttons ---------------------------------------------------------------------------------------------------------

async function save(name) {
  notify(name === "report.html" ? "The report takes about a minute; you can continue to work." : "", true);
  const answer = await send("file", { design, name });
  if (answer.text === undefined) return answer.error ? notify(answer.error) : null;
  notify(name === "controller.toml" ? "Saved. To judge it: railslip margins --controller controller.toml --envelope default, with the --vehicle of this page." : "", true);
  const link = make("a", { href: URL.createObjectURL(new Blob([answer.text], { type: "text/plain" })), download: name });
  link.click();
  return setTimeout(() => URL.revokeObjectURL(link.href), RETRY);
}

async function tune(name, field, label, least) {
  const value = Number($(field).value.replace(",", "."));
  $(field).setAttribute("aria-invalid", String(!(value > least)));
  if (!(value > least)) return notify(`${label}: ${quoted($(field).value)} is not allowed; give a number > ${least}`);
  $("best").disabled = $("most").disabled = true;
  notify("Tuning over the whole envelope…", true);
  const sent = design, answer = await send("tune", { design, [name]: value });
  $("best").disabled = $("most").disabled = false;
  if (!answer.values) return answer.error ? notify(answer.error) : null;
  notify("");
  if (sent.kind !== design.kind) return null;
  Object.assign(design.values, answer.values);
  return designChanged(true);
}

function pin() {
  pinned = pinned ? null : { design: copyOf(design), loop, stops };
  $("pin").ariaPressed = String(pinned !== null);
  drawAll();
}

function copyAddress() {
  writeAddress();
  return navigator.clipboard.writeText(location.href).then(
    () => notify("Address copied; it contains the whole design.", true), () => notify(`Copy this address: ${location.href}`, true));
}

async function chooseKind() {
  const kind = $("kind").value;
  if (kind === "transfer-function" && kindNow().loop) { // convert the present design to a ratio of polynomials
    const answer = await send("start", { design });
    if (answer.kinds) setup.kinds = answer.kinds;
  }
  const values = initialValues(kind);
  if (kind !== "transfer-function") for (const name of Object.keys(values)) values[name] = design.values[name] ?? values[name];
  chosen = region = view = null;
  setDesign({ kind, values, reference: design.reference });
}

function drawAll() {
  readColours();
  for (const id of PLOTS) if (id !== "envelope-map" || envelope || !kindNow().loop) draw[id]();
  drawMap();
}

function listen() {
  const map = $("gain-map");
  map.addEventListener("pointerdown", (event) => map.setPointerCapture(event.pointerId) ?? dragTo(event));
  map.addEventListener("pointermove", (event) => map.hasPointerCapture(event.pointerId) && dragTo(event));
  map.addEventListener("lostpointercapture", recordUndo);
  map.addEventListener("keydown", moveBy);
  map.addEventListener("keyup", recordUndo);
  for (const id of PLOTS) {
    const moveCursor = (i) => cursors[id] && draw[id]((cursorAt[id] = i));
    $(id).addEventListener("pointermove", (event) => cursors[id] && moveCursor(cursors[id].near(event.offsetX, event.offsetY)));
    for (const end of ["pointerleave", "blur"]) $(id).addEventListener(end, () => moveCursor(null));
    $(id).addEventListener("keydown", (event) => {
      const by = { ArrowLeft: -1, ArrowRight: 1 }[event.key], cursor = cursors[id];
      if (!by || !cursor) return;
      event.preventDefault();
      const step = cursor.count < 100 ? 1 : event.shiftKey ? 25 : 4;
      moveCursor(Math.max(0, Math.min(cursor.count - 1, (cursorAt[id] ?? cursor.count >> 1) + by * step)));
    });
  }
  const clicks = {
    best: () => tune("ki_min", "ki-min", "ki ≥", 0), most: () => tune("ms_max", "ms-max", "Ms ≤", 1), rule: () => setDesign({ kind: design.kind, values: initialValues(design.kind), reference: { ...setup.reference } }),
    undo: () => goTo(past, future), redo: () => goTo(future, past), pin, copy: copyAddress,
    save: () => save("controller.toml"), script: () => save("design.py"), report: () => save("report.html"),
  };
  for (const [id, act] of Object.entries(clicks)) $(id).addEventListener("click", act);
  $("kind").addEventListener("change", chooseKind);
  for (const id of ["num", "den"]) $(id).addEventListener("change", typedCoefficients);
  for (const id of ["axis-x", "axis-y"]) $(id).addEventListener("change", askRegion);
  $("point").addEventListener("change", () => {
    chosen = $("point").value === "" ? null : Number($("point").value);
    requests.loop.soon();
  });
  for (const button of document.querySelectorAll("input[name=run]")) button.addEventListener("change", draw.stop);
  document.addEventListener("keydown", (event) => {
    if (!(event.ctrlKey || event.metaKey) || event.target.matches("input[type=text]")) return;
    const key = event.key.toLowerCase(), forth = key === "y" || event.shiftKey;
    if (key !== "z" && key !== "y") return;
    event.preventDefault();
    goTo(forth ? future : past, forth ? past : future);
  });
  window.addEventListener("hashchange", takeAddress);
  window.addEventListener("resize", drawAll);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawAll);
}

async function start() {
  readColours();
  const answer = await send("start");
  if (!answer.kinds || setup) return answer.error ? notify(answer.error) : null;
  setup = answer;
  design = { kind: setup.kind, values: initialValues(setup.kind), reference: { ...setup.reference } };
  for (const id of ["vehicle", "envelope"]) $(id).textContent = setup[id];
  $("ki-min").value = String(Number(((design.values.ki ?? 1) / 100).toPrecision(1)));
  $("ms-max").value = String(setup.robust_ms);
  for (const [name, kind] of Object.entries(setup.kinds)) $("kind").append(new Option(`${name}: ${kind.title}`, name));
  for (const [rail, value] of Object.entries(setup.reference)) {
    const parameter = { name: `slip-${rail}`, label: `${rail} rail`, unit: "1", meaning: `reference slip ratio on ${rail} rail`, value, most: 0.9 };
    addNumber($("slips"), parameter, (slip) => (design.reference[rail] = slip));
  }
  listen();
  return takeAddress();
}

start();
