"use strict";
const run = JSON.parse(document.getElementById("run-data").textContent);
const byId = (id) => document.getElementById(id);
const video = byId("video");
const numFrames = run.frames.length;
const colourOf = new Map(run.identities.map((who) => [who.id, who.colour]));

/** An element with attributes and children; text is never read as HTML. */
function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name === "onclick") element.addEventListener("click", value);
    else if (name === "style") Object.assign(element.style, value);
    else element.setAttribute(name, value);
  }
  element.append(...children.map((child) => (child instanceof Node ? child : String(child))));
  return element;
}

const plural = (count, word) => `${count} ${word}${count === 1 ? "" : "s"}`;
const words = (code) => code.replaceAll("_", " ");
const frameLabel = (position) => run.frames[position].frame;
const swatch = (colour) =>
  colour
    ? make("span", { class: "swatch", style: { background: colour } })
    : make("span", { class: "swatch hollow" });
const chip = (position, text) =>
  make("button", { class: "chip", type: "button", "data-position": position,
    onclick: () => seek(position) }, text);

// --- the frame shown: one number that everything follows ------------------------------------

let shown = 0;
const onFrame = []; // functions of the position, called whenever another frame is shown

function show(position) {
  shown = Math.max(0, Math.min(numFrames - 1, position));
  for (const follow of onFrame) follow(shown);
}

/** Shows a frame; aims at its middle, so that rounding cannot show its neighbour. */
function seek(position) {
  show(position);
  if (run.video) video.currentTime = (shown + 0.5) / run.fps;
}

function followVideo() {
  // At its end a browser reports the duration, one frame beyond the last.
  const position = Math.min(Math.floor(video.currentTime * run.fps + 1e-3), numFrames - 1);
  if (!video.seeking && position !== shown) show(position);
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
  onFrame.push((position) => {
    const frame = run.frames[position];
    byId("clock").textContent = `frame ${frame.frame} of ${frameLabel(numFrames - 1)}, ` +
      `${frame.time_s.toFixed(2)} s, ${frame.name}`;
  });
  onFrame.push(drawDetections);
}

function drawDetections(position) {
  const rows = run.frames[position].detections.map(
    ([id, name, outcome, reason, score, confidence, candidates]) => {
      const told = candidates.map(([other, value]) => `${other}: ${number(value)}`).join(", ");
      const why = [words(run.reasons[reason]), told && `candidates ${told}`].filter(Boolean);
      return make("tr", { title: why.join("; ") },
        make("td", {}, swatch(colourOf.get(id)), name),
        make("td", {}, words(run.outcomes[outcome])),
        make("td", { class: "number" }, number(score)),
        make("td", { class: "number" }, number(confidence)));
    });
  const head = make("tr", {}, make("th", {}, "Detection"), make("th", {}, "Outcome"),
    make("th", { class: "number" }, "Score"), make("th", { class: "number" }, "Conf."));
  byId("seen").replaceChildren(rows.length
    ? make("table", {}, make("thead", {}, head), make("tbody", {}, ...rows))
    : make("p", { class: "faint" }, "Nothing was detected."));
}

const number = (value) => (value === null ? "" : value.toFixed(2));

// --- header ---------------------------------------------------------------------------------

function drawHeader() {
  byId("interrupted").hidden = run.complete;
  byId("about").textContent = run.about;
  byId("facts").append(...run.facts.map(([value, name]) =>
    make("li", {}, make("b", {}, value), make("span", {}, name))));
  byId("foot").textContent = run.footer;
}

// --- timeline -------------------------------------------------------------------------------

const lanes = [
  ...run.identities,
  { name: "ambiguous", marks: run.ambiguous, markColour: "#ffffff" },
  { name: "provisional", marks: run.provisional, markColour: "#c8cdd4" },
];
const laneHeight = Math.max(6, Math.min(22, Math.floor(7000 / lanes.length)));

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
  const bar = ([first, last], top, height, colour) => {
    pen.fillStyle = colour;
    pen.fillRect(x(first), top, Math.max(x(last + 1) - x(first), 1.5), height);
  };
  lanes.forEach((lane, row) => {
    const top = row * laneHeight, middle = top + laneHeight / 2;
    if (row % 2 === 0) bar([0, numFrames - 1], top, laneHeight, "#1b1f26");
    if (lane.marks) {
      for (const mark of lane.marks) bar(mark, middle - 3, 6, lane.markColour);
      return;
    }
    pen.globalAlpha = 0.4;
    bar([lane.seen[0][0], lane.seen.at(-1)[1]], middle - 0.5, 1, lane.colour);
    pen.globalAlpha = 1;
    for (const seen of lane.seen) bar(seen, top + 3, laneHeight - 6, lane.colour);
    for (const candidate of lane.candidate) bar(candidate, middle - 2, 4, "#ffffff");
    for (const position of lane.returns) drawReturn(pen, x(position), middle);
  });
  byId("ticks").replaceChildren(...ticks(width).map((position) =>
    make("span", { style: { left: `${(100 * position) / numFrames}%` } }, frameLabel(position))));
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

function ticks(width) {
  const room = 48; // pixels for one number
  const step = run.tick * Math.ceil((room * numFrames) / (Math.max(width, room) * run.tick));
  const positions = [];
  for (let position = 0; position < numFrames; position += step) positions.push(position);
  return positions;
}

function drawTimeline() {
  const style = { height: `${laneHeight}px`, lineHeight: `${laneHeight}px` };
  if (laneHeight < 12) style.fontSize = `${laneHeight}px`;
  byId("names").append(...lanes.map((lane) => lane.marks
    ? make("div", { style }, lane.name)
    : make("button", { type: "button", style, title: `Show ${lane.name} at first sight`,
      onclick: () => seek(lane.seen[0][0]) },
    make("span", {}, lane.label), make("b", {}, `\u00a0${lane.id}`))));
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
    track.setAttribute("aria-valuetext",
      `frame ${frameLabel(position)}, ${run.frames[position].time_s.toFixed(2)} seconds`);
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
  byId("cards").append(...run.identities.map((who) => {
    const crops = who.sightings.map((crop) => {
      const when = `frame ${frameLabel(crop.position)}`;
      const away = crop.absent_frames ? `${crop.absent_frames} frames away` : "first sight";
      return make("button", { type: "button", "data-position": crop.position,
        onclick: () => seek(crop.position) },
      make("img", { src: crop.image, alt: `${who.name} in ${when}, ${away}`, loading: "lazy" }),
      make("span", {}, when), make("span", {}, away));
    });
    return make("div", { class: crops.length > 2 ? "card wide" : "card",
      style: { borderLeftColor: who.colour } },
    make("h3", {}, who.name, make("span", {}, who.returns.length ? plural(who.returns.length, "return") : "no return")),
    make("div", { class: "crops" }, ...crops));
  }));
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
  const sorted = [...run.identities].sort((a, b) => (order.falling ? compare(b, a) : compare(a, b)));
  const heads = columns.map(([name], column) => make("th", {
    scope: "col",
    "aria-sort": column !== order.column ? "none" : order.falling ? "descending" : "ascending",
  }, make("button", { type: "button", onclick: () => sortBy(column) }, name)));
  const rows = sorted.map((who) => make("tr", {},
    make("td", { class: "name" }, swatch(who.colour), who.name),
    make("td", {}, who.label),
    make("td", {}, chip(who.first, frameLabel(who.first))),
    make("td", {}, chip(who.last, frameLabel(who.last))),
    make("td", {}, who.num_frames), make("td", {}, who.returns.length),
    make("td", {}, longest(who) || ""),
    make("td", {}, ...who.absences.map(([first, last]) => {
      const told = chip(last + 1, `${frameLabel(first)}\u2013${frameLabel(last)}`);
      told.title = "Show the return";
      return told;
    }))));
  byId("identities").replaceChildren(make("table", {},
    make("thead", {}, make("tr", {}, ...heads, make("th", { scope: "col" }, "Absences"))),
    make("tbody", {}, ...rows)));
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
    make("td", { class: "number" }, stage.median.toFixed(2)),
    make("td", { class: "number" }, stage.p95.toFixed(2)),
    make("td", { style: { width: "45%" } },
      make("div", { class: "bar", style: { width: `${(100 * stage.median) / slowest}%` } }))));
  const head = make("tr", {}, make("th", {}, "Stage"), make("th", { class: "number" }, "Median ms"),
    make("th", { class: "number" }, "95 % ms"), make("th", {}));
  byId("time").append(rows.length
    ? make("table", {}, make("thead", {}, head), make("tbody", {}, ...rows))
    : make("p", { class: "faint" }, "No times were kept."),
  make("p", { class: "faint" }, run.start_up));
}

function drawLog() {
  const events = run.events.map((event) => make("tr", {},
    make("td", {}, event.position === null ? `frame ${event.frame_index}`
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
  const told = (value) => (typeof value === "string" ? value : JSON.stringify(value));
  return make("dl", {}, ...Object.entries(content).flatMap(([name, value]) => [
    make("dt", {}, name), make("dd", {}, isGroup(value) ? tree(value) : told(value))]));
}

function drawSettings() {
  byId("settings").append(...Object.entries(run.settings).map(([name, content]) =>
    make("details", {}, make("summary", {}, name), tree(content))));
}

drawHeader();
drawStage();
drawTimeline();
drawGallery();
drawIdentities();
drawTime();
drawLog();
drawSettings();
if (numFrames) show(0);
