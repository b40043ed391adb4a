"use strict";

// Asks for the state, which is answered when there is news, and loads the picture that goes with it.
// All text is set as text, never as HTML.

const RETRY_MS = 1000;
const SILENT_S = 2;
const byId = (id) => document.getElementById(id);
let image = byId("frame");
let version = -1;
let age = null;  // {ms, at}: how old the picture was, and when that was said

function make(kind, content, className) {
  const made = document.createElement(kind);
  if (content !== undefined) made.textContent = content;
  if (className) made.className = className;
  return made;
}

function swatch(color) {
  const made = make("i", "", "swatch");
  made.style.background = color;
  return made;
}

function duration(seconds) {
  if (seconds < 10) return `${seconds.toFixed(1)} s`;
  if (seconds < 120) return `${Math.round(seconds)} s`;
  if (seconds < 7200) return `${Math.round(seconds / 60)} min`;
  return `${Math.round(seconds / 3600)} h`;
}

function sentence(state) {
  const silent = duration(state.silent_s || 0);
  switch (state.source) {
    case "lost": return `${state.shown}: connection lost ${silent} ago, trying again`;
    case "ended": return `${state.shown}: ended; see the folder of the run`;
    case "connected":
      return state.silent_s > SILENT_S
        ? `${state.shown}: connected, but no picture that can be used for ${silent}`
        : `${state.shown}: connected`;
    default: return `${state.shown}: recorded`;
  }
}

function list(parent, items) {
  parent.replaceChildren(...(items.length ? items : [make("li", "nobody", "nobody")]));
}

function entry(mark, name, note) {
  const made = make("li");
  made.append(mark, make("b", name), make("span", note));
  return made;
}

function picture(one) {
  if (one.key === null) return swatch(one.color);
  const made = make("img");
  made.src = `object/${one.key}.jpg`;
  made.alt = "";
  made.style.outline = `2px solid ${one.color}`;
  return made;
}

const known = new Map();  // rows of remembered objects, so that their pictures are loaded once

function remember(objects) {
  const rows = objects.map((one) => {
    const key = `${one.key} ${one.name}`;
    const row = known.get(key) || entry(picture(one), one.name, "");
    known.set(key, row);
    const seen = one.frames === 1 ? "1 frame" : `${one.frames} frames`;
    const last = one.unseen_s === null ? "before this run" : `${duration(one.unseen_s)} ago`;
    row.lastChild.textContent = `${last}, ${seen}`;
    return row;
  });
  const kept = new Set(rows);
  for (const [key, row] of known) if (!kept.has(row)) known.delete(key);
  list(byId("remembered"), rows);
}

function drawTimeline(timeline) {
  const length = timeline.to_s - timeline.from_s;
  const cells = [];
  for (const row of timeline.rows) {
    const lane = make("div", "", "lane");
    for (const [from, to] of row.spans) {
      const bar = make("i");
      const left = Math.max(0, (from - timeline.from_s) / length);
      bar.style.left = `${100 * left}%`;
      bar.style.width = `${100 * Math.max(0, (to - timeline.from_s) / length - left)}%`;
      bar.style.background = row.color;
      lane.append(bar);
    }
    cells.push(make("span", row.name), lane);
  }
  byId("lanes").replaceChildren(...cells);
  byId("from").textContent = duration(timeline.from_s);
  byId("to").textContent = duration(timeline.to_s);
}

function show(state) {
  document.title = `${state.title}, live`;
  byId("title").textContent = state.title;
  byId("said").textContent = sentence(state);
  const isSilent = state.source === "connected" && state.silent_s > SILENT_S;
  byId("light").className = isSilent ? "silent" : state.source;
  byId("speed").textContent = state.fps === null ? "–" : state.fps.toFixed(1);
  byId("frames").textContent = state.frames;
  byId("missed").textContent = state.missed === null ? "–" : state.missed;
  byId("objects").textContent = state.num_objects;
  showMemory(state.memory);
  list(byId("in-view"), state.in_view.map((one) => entry(
    swatch(one.color), one.name,
    one.confidence === null ? one.outcome : `${one.outcome}, ${one.confidence.toFixed(2)}`)));
  remember(state.remembered);
  drawTimeline(state.timeline);
  age = state.age_ms === null ? null : {ms: state.age_ms, at: performance.now()};
  showAge();
}

function showMemory(memory) {
  if (memory === null) return;
  byId("bytes").textContent = `${(memory.bytes / 1e6).toFixed(1)} MB`;
  byId("held").textContent =
    `memory: ${memory.working_set} objects in the working set, ${memory.at_rest} at rest`;
}

function showAge() {
  byId("age").textContent =
    age === null ? "–" : duration((age.ms + performance.now() - age.at) / 1000);
}

/** The last picture stays where the next one does not come, as when the run ends. */
function loadPicture() {
  return new Promise((done) => {
    const next = image.cloneNode();
    next.onload = () => {
      image.replaceWith(next);
      image = next;
      done();
    };
    next.onerror = done;
    next.src = `frame.jpg?v=${version}`;
  });
}

async function follow() {
  for (;;) {
    try {
      const answer = await fetch(`state.json?after=${version}`, {cache: "no-store"});
      if (!answer.ok) throw new Error(answer.status);
      const state = await answer.json();
      const isNew = state.version !== version;
      version = state.version;
      if (isNew && state.frames) await loadPicture();
      show(state);
    } catch (error) {
      byId("light").className = "";
      byId("said").textContent = "the run does not answer: it is over, or busy";
      age = null;
      showAge();
      await new Promise((done) => setTimeout(done, RETRY_MS));
    }
  }
}

setInterval(showAge, 100);
follow();
