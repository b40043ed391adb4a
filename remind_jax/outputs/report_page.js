"use strict";
const run = JSON.parse(document.getElementById("run-data").textContent);
const byId = (id) => document.getElementById(id);
const video = byId("video");
const numFrames = run.frames.length;
const colorOf = new Map(run.identities.map((who) => [who.id, who.color]));

/** An element with attributes and children; text is never read as HTML. */
function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name === "style") Object.assign(element.style, value);
    else element.setAttribute(name, value);
  }
  element.append(...children.map((child) => (child instanceof Node ? child : String(child))));
  return element;
}

const plural = (count, word) => `${count} ${word}${count === 1 ? "" : "s"}`;
const words = (code) => code.replaceAll("_", " ");
const frameLabel = (position) => run.frames[position].frame;
const swatch = (color) =>
  color
    ? make("span", { class: "swatch", style: { background: color } })
    : make("span", { class: "swatch hollow" });
const chip = (position, text) =>
  make("button", { class: "chip", type: "button", "data-position": position,
    onclick: () => seek(position) }, text);

const cell = (text) => make("td", { class: "number" }, text);

/** A table; `isNumber`: of a column, whether it holds numbers. */
const table = (heads, rows, isNumber) => make("table", {},
  make("thead", {}, make("tr", {}, ...heads.map((head, column) => (head instanceof Node ? head
    : make("th", isNumber(column) ? { class: "number" } : {}, head))))),
  make("tbody", {}, ...rows));

// --- the frame shown: one number that everything follows ------------------------------------

let shown = 0;
const onFrame = []; // functions of the position, called whenever another frame is shown

function show(position) {
  shown = Math.max(0, Math.min(numFrames - 1, position));
  for (const follow of onFrame) follow(shown);
}

let isBehind = false; // whether the video has yet to seek what was asked for during a seek

/** Shows a frame, in the video too. */
function seek(position) {
  show(position);
  if (run.video) aim();
}

/** Aims at the middle of the frame shown, so that rounding cannot show its neighbor. */
function aim() {
  // One seek at a time: sent elsewhere and back during a seek, Chromium may never end it.
  isBehind = video.seeking;
  if (!isBehind) video.currentTime = (shown + 0.5) / run.fps;
}

function followVideo() {
  if (video.seeking) return;
  if (isBehind) { aim(); return; }
  // At its end a browser reports the duration, one frame beyond the last.
  const position = Math.min(Math.floor(video.currentTime * run.fps + 1e-3), numFrames - 1);
  if (position !== shown) show(position);
}

function drawStage() {
  if (!run.video) {
    byId("player").hidden = true;
    byId("stage").classList.add("no-video");
  } else {
    video.src = run.video;
    video.addEventListener("error", () => { byId("video-missing").hidden = false; });
    for (const name of ["timeupdate", "seeked"]) video.addEventListener(name, followVideo);
    if ("requestVideoFrameCallback" in video) {
      const next = () => { followVideo(); video.requestVideoFrameCallback(next); };
      video.requestVideoFrameCallback(next);
    }
  }
  byId("back").addEventListener("click", () => seek(shown - 1));
  byId("forth").addEventListener("click", () => seek(shown + 1));
  document.addEventListener("keydown", takePlayerKey);
  onFrame.push((position) => {
    byId("clock").textContent = `frame ${frameLabel(position)} of ${frameLabel(numFrames - 1)}, ` +
      `${timesOf(position)}, ${run.frames[position].name}`;
  });
  onFrame.push(drawDetections);
}

const hasOtherClock = run.frames.some(({ time_s: time }, position) =>
  Math.abs(time - position / run.fps) > 1);

/** When a frame is in the video and, where that differs, by the clock of the source, which jumps. */
function timesOf(position) {
  const inVideo = timeLabel(position / run.fps, 0.1);
  return hasOtherClock ? `${inVideo} in the video, ` +
    `${timeLabel(run.frames[position].time_s, 0.1)} by the clock of the source` : inVideo;
}

/** Arrow keys and space, wherever the focus is, but in what needs them itself. */
function takePlayerKey(event) {
  if (event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.target.matches("input, select, textarea")) return;
  if (event.key === "ArrowLeft" || event.key === "ArrowRight") {
    seek(shown + (event.key === "ArrowLeft" ? -1 : 1));
  } else if (event.key === " " && run.video && !event.target.matches("button, summary")) {
    if (video.paused) video.play();
    else video.pause();
  } else return;
  event.preventDefault();
}

const hasScores = run.frames.some((frame) => frame.detections.some((row) => row[4] !== null));

function drawDetections(position) {
  const rows = run.frames[position].detections.map((detection, row) => {
    const [id, name, outcome, reason, score, confidence, candidates] = detection;
    const list = candidates.map(([other, value]) => `${other}: ${number(value)}`).join(", ");
    const why = [words(run.reasons[reason]), list && `candidates ${list}`].filter(Boolean);
    return make("tr", { title: why.join("; "), ...rowToExplain(position, row, passes(detection)) },
      make("td", {}, swatch(colorOf.get(id)), nameToExplain(position, row, name)),
      make("td", {}, words(run.outcomes[outcome])),
      ...(hasScores ? [cell(number(score))] : []), cell(number(confidence)));
  });
  const scored = make("th", { class: "number narrow" }, "Score with context");
  const heads = ["Detection", "Outcome", ...(hasScores ? [scored] : []), "Confidence"];
  byId("seen").replaceChildren(rows.length ? table(heads, rows, (column) => column > 1)
    : make("p", { class: "faint" }, "Nothing was detected."));
}

/** Two decimals, three for what would look like nothing. */
const number = (value) => (value === null ? ""
  : value.toFixed(value !== 0 && Math.abs(value) < 0.01 ? 3 : 2));

// --- why: the decision about one detection ---------------------------------------------------

const canExplain = Boolean(run.explanations) && "DecompressionStream" in window;
const canOpen = !run.labeling; // there, a click picks what is corrected
const unpacked = new Map(); // block of frames -> promise of its content
let asked = null; // position and row of the detection explained

/** What makes a row of the list of detections open the panel. */
function rowToExplain(position, row, stands) {
  const kind = stands ? "" : " dim";
  return canOpen ? { class: `open${kind}`, onclick: () => explain(position, row, true) } : { class: kind };
}

/** Its name, as a button for the keyboard; a click reaches the row as well. */
function nameToExplain(position, row, name) {
  if (!canOpen) return name;
  const isAsked = asked !== null && asked.position === position && asked.row === row;
  return make("button", { type: "button", "aria-expanded": isAsked, "aria-controls": "why" }, name);
}

async function explanationsOf(position) {
  if (!canExplain) return null;
  const { blocks, frames_per_block: size } = run.explanations;
  const block = Math.floor(position / size);
  if (block >= blocks.length) return null;
  if (!unpacked.has(block)) unpacked.set(block, unpack(blocks[block]));
  return (await unpacked.get(block))[position % size];
}

async function unpack(text) {
  const bytes = Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return JSON.parse(await new Response(stream).text());
}

async function explain(position, row, takesFocus = false) {
  asked = { position, row };
  drawDetections(position);
  const frame = await explanationsOf(position);
  if (!asked || asked.position !== position || asked.row !== row) return; // asked for another since
  drawWhy(frame, position, row);
  byId("why").hidden = false;
  if (!takesFocus) return;
  byId("why").focus({ preventScroll: true });
  byId("why").scrollIntoView({ block: "nearest" });
}

function closeWhy() {
  asked = null;
  byId("why").hidden = true;
  drawDetections(shown);
}

/** Follows the identity explained to another frame; closes where it is not seen. */
function followWhy(position) {
  if (!asked || asked.position === position) return;
  const [id] = run.frames[asked.position].detections[asked.row];
  const row = run.frames[position].detections.findIndex(([other]) => other === id);
  if (id >= 0 && row >= 0) explain(position, row);
  else closeWhy();
}

function drawWhy(frame, position, row) {
  const [id, name, outcome, reason, score, confidence, candidates] =
    run.frames[position].detections[row];
  const explained = frame?.detections[row];
  byId("why-title").textContent = `Why ${(explained?.name ?? name).replace("?", "")}? ` +
    `(frame ${frameLabel(position)}, detection ${row})`;
  const sum = [`${words(run.outcomes[outcome])} (${words(run.reasons[reason])})`,
    score !== null && `score with context ${number(score)}`,
    confidence !== null && `confidence ${number(confidence)}`].filter(Boolean).join(", ");
  const shares = new Map(id >= 0 ? [[id, null]] : candidates);
  const could = run.identities.filter((who) => shares.has(who.id))
    .sort((a, b) => shares.get(b.id) - shares.get(a.id));
  byId("why-body").replaceChildren(make("p", { class: "faint" }, sum),
    ...(explained ? [make("ol", {}, ...explained.why.map((text) => make("li", {}, text))),
      ...explained.sections.flatMap(drawSection)] : [make("p", {}, ...howToExplain(position, row))]),
    ...(id < 0 && could.length ? [make("h3", {}, "It could be")] : []),
    make("div", { class: "candidates" }, ...could.map((who) => drawCard(who, shares.get(who.id)))));
}

/** Where the reasons are that this page does not hold. */
function howToExplain(position, row) {
  if (!run.explanations) return ["Run with ", make("code", {}, "--trace"), " to read here why it was decided so."];
  return ["The run is too long to be explained whole in this page. In a terminal: ",
    make("code", {}, `remind explain RUN --frame ${frameLabel(position)} --detection ${row}`)];
}

/** What the decision was made of: sentences, and a table. */
function drawSection({ title, lines, heads, rows, is_text: texts }) {
  const isNumber = (column) => !texts.includes(column);
  const tr = (row) => make("tr", { class: row[0].startsWith("*") ? "decided" : "" },
    ...row.map((text, column) => (isNumber(column) ? cell(text) : make("td", {}, text))));
  return [make("h3", {}, capital(title)), ...lines.map((text) => make("p", { class: "faint" }, text)),
    ...(rows.length ? [make("div", { class: "scroll" }, table(heads.map(capital), rows.map(tr), isNumber))] : [])];
}

const capital = (text) => text.charAt(0).toUpperCase() + text.slice(1);

/** The detection that a lane of the timeline shows in a frame, -1 for none. */
function rowOfLane(lane, position) {
  const { detections } = run.frames[position];
  const isKind = ([, , outcome]) => run.outcomes[outcome].startsWith(lane.name);
  if (lane.marks) return detections.findIndex(isKind);
  const seen = detections.findIndex(([id]) => id === lane.id);
  return seen >= 0 ? seen : detections.findIndex(([, , , , , , candidates]) =>
    candidates.some(([id]) => id === lane.id));
}

function prepareWhy() {
  byId("why-close").addEventListener("click", closeWhy);
  byId("why").addEventListener("keydown", (event) => { if (event.key === "Escape") closeWhy(); });
  onFrame.push(followWhy);
}

// --- filter ---------------------------------------------------------------------------------

const filter = { name: "", class: "", outcome: "" };
let withOutcome = new Set(); // identities that a detection of the outcome is, or could be
let hits = []; // positions of the frames with a detection that passes

const nameFits = (name) => name.toLowerCase().includes(filter.name.trim().toLowerCase());
const passes = ([, name, outcome, , , , , label]) => nameFits(name) &&
  (!filter.class || run.classes[label] === filter.class) &&
  (!filter.outcome || run.outcomes[outcome] === filter.outcome);
const shownIdentities = () => run.identities.filter((who) => nameFits(who.name) &&
  (!filter.class || who.label === filter.class) && (!filter.outcome || withOutcome.has(who.id)));

function applyFilter() {
  for (const name of Object.keys(filter)) filter[name] = byId(`filter-${name}`).value;
  const isSet = Object.values(filter).some(Boolean);
  let count = 0;
  [withOutcome, hits] = [new Set(), []];
  run.frames.forEach(({ detections }, position) => {
    for (const [id, , outcome, , , , candidates] of detections) {
      if (run.outcomes[outcome] !== filter.outcome) continue;
      for (const one of [id, ...candidates.map(([other]) => other)]) withOutcome.add(one);
    }
    const found = detections.filter(passes).length;
    count += found;
    if (found) hits.push(position);
  });
  byId("filter-next").hidden = !isSet || !hits.length;
  byId("filter-count").textContent = isSet
    ? `${plural(count, "detection")} in ${plural(hits.length, "frame")}` : "";
  redrawIdentities();
  show(shown);
}

function redrawIdentities() {
  layOutLanes();
  drawNames();
  drawLanes();
  drawGallery();
  drawIdentities();
}

function prepareFilter() {
  const used = new Set(run.frames.flatMap(({ detections }) => detections.map((row) => row[2])));
  const option = (value) => make("option", { value }, words(value));
  byId("filter-class").append(...[...run.classes].sort().map(option));
  byId("filter-outcome").append(...run.outcomes.filter((_, code) => used.has(code)).map(option));
  for (const kind of ["input", "change"]) byId("filter").addEventListener(kind, applyFilter);
  byId("filter").addEventListener("submit", (event) => {
    event.preventDefault();
    if (hits.length) seek(hits.find((position) => position > shown) ?? hits[0]);
  });
}

// --- header ---------------------------------------------------------------------------------

function drawHeader() {
  byId("interrupted").hidden = run.complete;
  byId("about").textContent = run.about;
  byId("facts").append(...run.facts.map(([value, name]) =>
    make("li", {}, make("b", {}, value), make("span", {}, name))));
  byId("foot").textContent = run.footer;
  if (!run.comparison.length) return;
  byId("comparison").hidden = false;
  const [heads, ...rows] = run.comparison;
  const isNumber = (column) => column % 3;
  const lines = rows.map((row) => make("tr", {}, ...row.map((text, column) =>
    (isNumber(column) ? cell(text) : make("td", {}, text)))));
  byId("comparison").append(table(heads, lines, isNumber));
}

// --- timeline -------------------------------------------------------------------------------

let lanes = [], laneHeight = 0;

function layOutLanes() {
  lanes = [
    ...shownIdentities(),
    { name: "ambiguous", marks: run.ambiguous, markColor: "#ffffff" },
    { name: "provisional", marks: run.provisional, markColor: "#c8cdd4" },
  ];
  laneHeight = Math.max(6, Math.min(22, Math.floor(7000 / lanes.length)));
}

function drawLanes() {
  const canvas = byId("lanes");
  const width = byId("track").clientWidth;
  const sharp = window.devicePixelRatio || 1;
  canvas.style.height = `${laneHeight * lanes.length}px`;
  canvas.width = Math.round(width * sharp);
  canvas.height = Math.round(laneHeight * lanes.length * sharp);
  const pen = canvas.getContext("2d");
  pen.scale(sharp, sharp);
  const x = (position) => (position / numFrames) * width;
  const bar = ([first, last], top, height, color) => {
    pen.fillStyle = color;
    pen.fillRect(x(first), top, Math.max(x(last + 1) - x(first), 1.5), height);
  };
  lanes.forEach((lane, row) => {
    const top = row * laneHeight, middle = top + laneHeight / 2;
    if (row % 2 === 0) bar([0, numFrames - 1], top, laneHeight, "#1b1f26");
    if (lane.marks) {
      for (const mark of lane.marks) bar(mark, middle - 3, 6, lane.markColor);
      return;
    }
    pen.globalAlpha = 0.4;
    bar([lane.seen[0][0], lane.seen.at(-1)[1]], middle - 0.5, 1, lane.color);
    pen.globalAlpha = 1;
    const height = Math.max(3, laneHeight - 6);
    for (const seen of lane.seen) bar(seen, middle - height / 2, height, lane.color);
    for (const candidate of lane.candidate) bar(candidate, middle - 2, 4, "#ffffff");
    for (const position of lane.returns) drawReturn(pen, x(position), middle);
  });
  drawTicks(byId("ticks"), (least) => roundStep(Math.max(1, least)), 1, width, frameLabel);
  if (run.fps > 0) drawTicks(byId("times"), timeStep, run.fps, width, timeLabel);
}

function drawReturn(pen, x, middle) {
  const half = Math.min(6, laneHeight / 3);
  pen.beginPath();
  pen.moveTo(x - half, middle - half);
  pen.lineTo(x - half, middle + half);
  pen.lineTo(x + half, middle);
  pen.closePath();
  pen.fillStyle = "#ffffff";
  pen.strokeStyle = "#14171d";
  pen.stroke();
  pen.fill();
}

/** The smallest of 1, 2 and 5 times a power of ten that is no less. */
function roundStep(least) {
  const power = 10 ** Math.floor(Math.log10(least));
  return [1, 2, 5, 10].map((factor) => factor * power).find((step) => step >= least);
}

/** Round seconds and, from half a minute on, round minutes. */
function timeStep(least) {
  return least <= 20 ? roundStep(least) : 60 * roundStep(Math.max(1, least / 60));
}

/** Labels at round numbers, as close as there is room; units are so many frames. */
function drawTicks(axis, chooseStep, framesPerUnit, width, label) {
  const room = 64; // pixels for one label
  const length = numFrames / framesPerUnit;
  const step = chooseStep(room * length / width);
  const labels = [];
  for (let number = 0; step && number * step < length; number += 1) {
    const left = `${(100 * number * step) / length}%`;
    labels.push(make("span", { style: { left } }, label(number * step, step)));
  }
  axis.replaceChildren(...labels);
}

/** Minutes and seconds, `1:05`, with the decimals that the step needs. */
function timeLabel(seconds, step) {
  const decimals = Math.max(0, Math.ceil(-Math.log10(step) - 1e-9));
  const rounded = Number(seconds.toFixed(decimals));
  const rest = (rounded % 60).toFixed(decimals);
  return `${Math.floor(rounded / 60)}:${rest.padStart(decimals ? 3 + decimals : 2, "0")}`;
}

function drawNames() {
  const style = { height: `${laneHeight}px`, lineHeight: `${laneHeight}px` };
  if (laneHeight < 12) style.fontSize = `${laneHeight}px`;
  byId("names").replaceChildren(...lanes.map((lane) => lane.marks
    ? make("div", { style }, lane.name)
    : make("button", { type: "button", style, title: `Show ${lane.name} at first sight`,
      onclick: () => seek(lane.seen[0][0]) },
    make("span", {}, lane.name === `${lane.label} ${lane.id}` ? lane.label : lane.name),
    make("b", {}, `\u00a0${lane.id}`))));
}

function drawTimeline() {
  layOutLanes();
  drawNames();
  const track = byId("track");
  track.setAttribute("aria-valuemax", numFrames - 1);
  const at = (event) => {
    const box = track.getBoundingClientRect();
    return Math.floor(((event.clientX - box.left) / box.width) * numFrames);
  };
  track.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    track.setPointerCapture(event.pointerId);
    seek(at(event));
    const lane = lanes[Math.floor(event.offsetY / laneHeight)];
    const row = lane && canOpen ? rowOfLane(lane, shown) : -1;
    if (row >= 0 && (canExplain || run.frames[shown].detections[row][0] < 0)) explain(shown, row);
  });
  track.addEventListener("pointermove", (event) => {
    if (track.hasPointerCapture(event.pointerId)) seek(at(event));
    drawTip(event, at(event));
  });
  track.addEventListener("pointerleave", () => { byId("tip").hidden = true; });
  track.addEventListener("keydown", stepByKey);
  onFrame.push((position) => {
    byId("playhead").style.left = `${(100 * (position + 0.5)) / numFrames}%`;
    track.setAttribute("aria-valuenow", position);
    track.setAttribute("aria-valuetext", `frame ${frameLabel(position)}, ${timesOf(position)}`);
  });
  new ResizeObserver(drawLanes).observe(track);
}

function stepByKey(event) {
  const page = Math.max(1, Math.round(numFrames / 10));
  const steps = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1, PageDown: -page,
    PageUp: page, Home: -numFrames, End: numFrames };
  if (!(event.key in steps)) return;
  event.preventDefault();
  seek(shown + steps[event.key]);
}

function drawTip(event, position) {
  const tip = byId("tip");
  const row = Math.floor(event.offsetY / laneHeight);
  if (!lanes[row] || position < 0 || position >= numFrames) { tip.hidden = true; return; }
  tip.textContent = `${lanes[row].name}, frame ${frameLabel(position)}`;
  tip.hidden = false;
  const left = Math.min(event.clientX + 14, window.innerWidth - tip.offsetWidth - 8);
  tip.style.left = `${left}px`;
  tip.style.top = `${event.clientY + 16}px`;
}

// --- gallery and identities -----------------------------------------------------------------

function drawGallery() {
  byId("cards").replaceChildren(...shownIdentities().map((who) => drawCard(who)));
}

/** The visits of an identity; `share`: how far something undecided may be it. */
function drawCard(who, share = null) {
  const crops = who.sightings.map((crop) => {
    const { position, absent_frames: absent, picture_position: pictured } = crop;
    const when = `frame ${frameLabel(pictured)}`;
    const start = chip(position, `${absent ? "back" : "first"} at ${frameLabel(position)}`);
    return make("div", {}, make("button", { type: "button", class: "view",
      "data-position": pictured, onclick: () => seek(pictured) },
    make("img", { src: crop.image, alt: `${who.name}, best view of a visit, ${when}`, loading: "lazy" }),
    make("span", {}, when)), start, ...decidedChip(who, position),
    ...(absent ? [make("span", { class: "faint" }, `${absent} frames away`)] : []));
  });
  const said = share === null
    ? (who.returns.length ? plural(who.returns.length, "return") : "no return") : number(share);
  return make("div", { class: crops.length > 2 ? "card wide" : "card",
    style: { borderLeftColor: who.color } },
  make("h3", {}, who.name, make("span", {}, said)), make("div", { class: "crops" }, ...crops));
}

/** A link to the frame in which a return was decided, where the run tells it. */
function decidedChip(who, position) {
  const decided = who.decided[who.returns.indexOf(position)] ?? -1;
  if (decided < 0) return [];
  const link = chip(decided, `decided at ${frameLabel(decided)}`);
  link.addEventListener("click", () => {
    const row = rowOfLane(who, decided);
    if (row >= 0) explain(decided, row, true);
  });
  return [link];
}

const columns = [
  ["Identity", (who) => who.id], ["Class", (who) => who.label],
  ["First frame", (who) => who.first], ["Last frame", (who) => who.last],
  ["Frames seen", (who) => who.num_frames], ["Returns", (who) => who.returns.length],
  ["Longest absence", (who) => longest(who)],
];
const longest = (who) => Math.max(0, ...who.absences.map(([first, last]) => last - first + 1));
let order = { column: 0, falling: false };

function drawIdentities() {
  const key = columns[order.column][1];
  const compare = (a, b) => (key(a) < key(b) ? -1 : key(a) > key(b) ? 1 : a.id - b.id);
  const sorted = shownIdentities().sort((a, b) => (order.falling ? compare(b, a) : compare(a, b)));
  const heads = columns.map(([name], column) => make("th", {
    scope: "col",
    "aria-sort": column !== order.column ? "none" : order.falling ? "descending" : "ascending",
  }, make("button", { type: "button", onclick: () => sortBy(column) }, name)));
  const rows = sorted.map((who) => make("tr", {},
    make("td", { class: "name" }, swatch(who.color), who.name),
    make("td", {}, who.label),
    make("td", {}, chip(who.first, frameLabel(who.first))),
    make("td", {}, chip(who.last, frameLabel(who.last))),
    make("td", {}, who.num_frames), make("td", {}, who.returns.length),
    make("td", {}, longest(who) || ""),
    make("td", {}, ...who.absences.map(([first, last]) => {
      const absence = chip(last + 1, `${frameLabel(first)}\u2013${frameLabel(last)}`);
      absence.title = "Show the return";
      return make("span", {}, absence, ...decidedChip(who, last + 1));
    }))));
  byId("identities").replaceChildren(
    table([...heads, make("th", { scope: "col" }, "Absences")], rows));
}

function sortBy(column) {
  order = { column, falling: column === order.column && !order.falling };
  drawIdentities();
  byId("identities").querySelectorAll("th button")[column].focus();
}

// --- times, events, settings ----------------------------------------------------------------

function drawTime() {
  const slowest = Math.max(...run.stages.map((stage) => stage.median), 1e-9);
  const rows = run.stages.map((stage) => make("tr", {}, make("td", {}, stage.name),
    cell(stage.median.toFixed(2)), cell(stage.p95.toFixed(2)),
    make("td", { style: { width: "45%" } },
      make("div", { class: "bar", style: { width: `${(100 * stage.median) / slowest}%` } }))));
  const heads = ["Stage", "Median ms", "95 % ms", ""];
  byId("time").append(rows.length ? table(heads, rows, (column) => column === 1 || column === 2)
    : make("p", { class: "faint" }, "No times were kept."),
  make("p", { class: "faint" }, run.start_up));
}

function drawLog() {
  const events = run.events.map((event) => make("tr", {},
    make("td", {}, event.position === null ? (event.frame_index < 0 ? "all" : `frame ${event.frame_index}`)
      : chip(event.position, `frame ${event.frame_index}`)),
    make("td", {}, event.kind), make("td", {}, event.message)));
  const skipped = run.skipped.map((frame) => make("tr", {},
    make("td", {}, frame.name), make("td", {}, "skipped"), make("td", {}, frame.reason)));
  byId("log").append(events.length + skipped.length
    ? make("table", {}, make("tbody", {}, ...skipped, ...events))
    : make("p", { class: "faint" }, "None."));
}

function tree(content) {
  const isGroup = (value) =>
    value !== null && typeof value === "object" && !Array.isArray(value);
  const text = (value) => (typeof value === "string" ? value : JSON.stringify(value));
  return make("dl", {}, ...Object.entries(content).flatMap(([name, value]) => [
    make("dt", {}, name), make("dd", {}, isGroup(value) ? tree(value) : text(value))]));
}

function drawSettings() {
  byId("settings").append(...Object.entries(run.settings).map(([name, content]) =>
    make("details", {}, make("summary", {}, name), tree(content))));
}

drawHeader();
drawStage();
prepareWhy();
prepareFilter();
drawTimeline();
drawGallery();
drawIdentities();
drawTime();
drawLog();
drawSettings();
if (numFrames) show(0);
