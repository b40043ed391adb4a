// Labeling: corrects the identities of the run that the page shows. An edit is one step of work;
// labels are those of the run with all edits applied in order, as `label_edits.py` does.

const labeling = run.labeling;
const NOBODY = -1;
const MIN_ABSENCE = 5; // frames; shorter gaps are flicker
const storeKey = `remind-label ${labeling.run} ${labeling.num_detections} ${labeling.digest}`;
const firstOf = new Map(run.identities.map((who) => [who.id, who])); // as the run had them
const lastFrame = numFrames ? run.frames[numFrames - 1].frame : 0;

let edits = readKept();
let labels = []; // identity of each detection of each frame
let picked = null; // position and row of the detection that edits speak of
let asking = null; // the action that waits for an identity

// --- edits and labels -----------------------------------------------------------------------

function readKept() {
  try {
    const kept = JSON.parse(localStorage.getItem(storeKey) ?? "[]");
    return Array.isArray(kept) ? kept : [];
  } catch { return []; }
}

function keep() {
  try { localStorage.setItem(storeKey, JSON.stringify(edits)); } catch { /* saved by hand then */ }
}

function applyEdit(edit) {
  const to = edit.to ?? NOBODY;
  if (edit.edit === "assign") {
    labels[run.frames.findIndex((frame) => frame.frame === edit.frame)][edit.detection] = to;
    return;
  }
  const [first, last, into] = edit.edit === "merge" ? [0, lastFrame, edit.into]
    : [edit.first, edit.last, to];
  run.frames.forEach(({ frame }, position) => {
    if (frame < first || frame > last) return;
    labels[position] = labels[position].map((id) => (id === edit.id ? into : id));
  });
}

function relabel() {
  labels = labeling.labels.map((row) => [...row]);
  for (const edit of edits) applyEdit(edit);
}

/** A number that no identity ever had. */
function nextId() {
  const known = [...labeling.labels.flat(), ...edits.map((edit) => edit.to ?? edit.into ?? -1)];
  return known.reduce((most, id) => Math.max(most, id), -1) + 1;
}

/** Frames in which an identity has two detections: no truth can hold that. */
function conflicts() {
  return labels.flatMap((row, position) => {
    const seen = row.filter((id) => id !== NOBODY);
    const twice = seen.find((id, place) => seen.indexOf(id) !== place);
    return twice === undefined ? [] : [{ position, id: twice }];
  });
}

function add(edit) {
  edits.push(edit);
  asking = null;
  keep();
  refresh();
}

function undo() {
  const gone = edits.pop();
  asking = null;
  keep();
  refresh();
  say(gone ? `Undone: ${inWords(gone)}.` : "There is nothing to undo.");
}

function inWords(edit) {
  const to = edit.to === null ? "nobody" : nameOf(edit.to ?? edit.into);
  if (edit.edit === "merge") return `all of ${edit.id} is ${to}`;
  if (edit.edit === "move") return `${edit.id} in frames ${edit.first} to ${edit.last} is ${to}`;
  return `detection ${edit.detection} of frame ${edit.frame} is ${to}`;
}

function labelFile() {
  return JSON.stringify({ format: "remind-jax edits", version: 1, run: labeling.run,
    num_detections: labeling.num_detections, labels: labeling.digest, edits }, null, 1) + "\n";
}

function save() {
  const address = URL.createObjectURL(new Blob([labelFile()], { type: "application/json" }));
  make("a", { href: address, download: "edits.json" }).click();
  setTimeout(() => URL.revokeObjectURL(address), 10000);
  say(`Saved ${plural(edits.length, "edit")} as edits.json.`);
}

// --- the page as labeled --------------------------------------------------------------------

const nameOf = (id) => run.identities.find((who) => who.id === id)?.name
  ?? firstOf.get(id)?.name ?? `${id}`;

/** Colors of new identities are as far apart as those of the run. */
function colorFor(id) {
  if (!colorOf.has(id)) colorOf.set(id, `hsl(${(id * 137.508) % 360} 75% 62%)`);
  return colorOf.get(id);
}

function joinPositions(positions) {
  const spans = [];
  for (const position of positions) {
    if (spans.length && position <= spans.at(-1)[1] + 1) spans.at(-1)[1] = position;
    else spans.push([position, position]);
  }
  return spans;
}

/** Every identity as labeled, by first sight. */
function identitiesNow() {
  const found = new Map();
  labels.forEach((row, position) => row.forEach((id, place) => {
    if (id === NOBODY) return;
    if (!found.has(id)) found.set(id, { positions: [], classes: new Map() });
    const { positions, classes } = found.get(id);
    const label = labeling.classes[position][place];
    positions.push(position);
    classes.set(label, (classes.get(label) ?? 0) + 1);
  }));
  const sightings = cropsNow();
  return [...found].map(([id, { positions, classes }]) => {
    const label = [...classes].reduce((best, one) => (one[1] > best[1] ? one : best))[0];
    const seen = joinPositions(positions);
    const absences = seen.slice(1).map((span, place) => [seen[place][1] + 1, span[0] - 1])
      .filter(([first, last]) => last - first + 1 >= MIN_ABSENCE);
    return { id, label, name: firstOf.get(id)?.name ?? `${label} ${id}`, color: colorFor(id), seen,
      candidate: [], absences, returns: absences.map(([, last]) => last + 1), decided: [],
      first: seen[0][0], last: seen.at(-1)[1], num_frames: new Set(positions).size,
      sightings: sightings.get(id) ?? [] };
  }).sort((a, b) => a.first - b.first || a.id - b.id);
}

/** Crops go with the detection that they were taken of. */
function cropsNow() {
  const crops = new Map();
  for (const who of firstOf.values()) {
    for (const crop of who.sightings) {
      const row = labeling.labels[crop.picture_position].indexOf(who.id);
      const id = row < 0 ? NOBODY : labels[crop.picture_position][row];
      if (id !== NOBODY) crops.set(id, [...(crops.get(id) ?? []), crop]);
    }
  }
  for (const list of crops.values()) list.sort((a, b) => a.position - b.position);
  return crops;
}

function refresh() {
  relabel();
  run.identities = identitiesNow();
  run.frames.forEach(({ detections }, position) => detections.forEach((detection, row) => {
    const id = labels[position][row];
    detection[0] = id;
    detection[1] = id === NOBODY ? `${labeling.classes[position][row]}, nobody` : nameOf(id);
  }));
  redrawIdentities();
  redrawFrame();
  drawPanel();
}

function redrawFrame() {
  drawDetections(shown);
  decorateList(shown);
  drawBoxes(shown);
}

// --- picking --------------------------------------------------------------------------------

function pick(position, row) {
  if (asking) return answer(labels[position][row]);
  picked = { position, row };
  redrawFrame();
  drawPanel();
}

/** Rows of the list can be picked; the one that is picked is marked. */
function decorateList(position) {
  byId("seen").querySelectorAll("tbody tr").forEach((line, row) => {
    const isPicked = picked?.position === position && picked.row === row;
    const name = line.querySelector("td");
    const button = make("button", { type: "button", "aria-pressed": isPicked,
      onclick: () => pick(position, row) }, ...name.childNodes);
    name.replaceChildren(button);
    line.classList.toggle("picked", isPicked);
  });
}

function videoPlace() {
  const { clientWidth: width, clientHeight: height } = video;
  const ratio = video.videoWidth / video.videoHeight || 1;
  const shownWidth = Math.min(width, height * ratio);
  return { left: (width - shownWidth) / 2, top: (height - shownWidth / ratio) / 2,
    width: shownWidth, height: shownWidth / ratio };
}

function drawBoxes(position) {
  if (!run.video) return;
  const canvas = byId("boxes"), place = videoPlace(), sharp = window.devicePixelRatio || 1;
  const [height, width] = labeling.sizes[position];
  Object.assign(canvas.style, { left: `${place.left}px`, top: `${place.top}px`,
    width: `${place.width}px`, height: `${place.height}px` });
  canvas.width = Math.round(place.width * sharp);
  canvas.height = Math.round(place.height * sharp);
  const pen = canvas.getContext("2d");
  pen.scale(sharp * place.width / width, sharp * place.height / height);
  const unit = width / Math.max(place.width, 1);
  labeling.boxes[position].forEach(([left, top, right, bottom], row) => {
    const isPicked = picked?.position === position && picked.row === row;
    const id = labels[position][row];
    pen.strokeStyle = id === NOBODY ? "#ffffff" : colorFor(id);
    pen.lineWidth = (isPicked ? 4 : 1.5) * unit;
    pen.setLineDash(id === NOBODY ? [4 * unit, 4 * unit] : []);
    pen.strokeRect(left, top, right - left, bottom - top);
    pen.font = `600 ${12 * unit}px system-ui, sans-serif`;
    const text = id === NOBODY ? "nobody" : `${id}`;
    const wide = pen.measureText(text).width + 6 * unit;
    pen.fillStyle = "rgba(0, 0, 0, 0.75)";
    pen.fillRect(left, top, wide, 15 * unit);
    pen.fillStyle = pen.strokeStyle;
    pen.fillText(text, left + 3 * unit, top + 11.5 * unit);
  });
}

/** The smallest box under the pointer. */
function rowAt(event) {
  const [height, width] = labeling.sizes[shown];
  const area = byId("boxes").getBoundingClientRect();
  const x = ((event.clientX - area.left) / area.width) * width;
  const y = ((event.clientY - area.top) / area.height) * height;
  const size = ([left, top, right, bottom]) => (right - left) * (bottom - top);
  return labeling.boxes[shown].map((box, row) => ({ box, row }))
    .filter(({ box }) => box[0] <= x && x < box[2] && box[1] <= y && y < box[3])
    .sort((a, b) => size(a.box) - size(b.box))[0]?.row ?? -1;
}

// --- actions --------------------------------------------------------------------------------

const actions = {
  m: { text: "Merge its identity into \u2026", start: "All of it is" },
  v: { text: "This visit is \u2026", start: "This visit is" },
  f: { text: "From here on it is \u2026", start: "From this frame on it is" },
  d: { text: "This detection is \u2026", start: "This detection alone is" },
};

function ask(key) {
  if (!picked) { say("Pick a detection first: in the video, in the list, or by 1 to 9."); return; }
  asking = key;
  drawPanel();
  byId("label-target").focus();
}

/** The identity that somebody typed: a number, `new`, or `none`; undefined if there is no such. */
function targetOf(text) {
  const word = text.trim().toLowerCase();
  const named = run.identities.find((who) => who.name.toLowerCase() === word);
  if (named) return named.id;
  if (word === "new") return nextId();
  if (word === "none" || word === "nobody" || word === "-") return NOBODY;
  return /^\d+$/.test(word) ? run.identities.find((who) => who.id === Number(word))?.id : undefined;
}

function answer(to) {
  const { position, row } = picked;
  const id = labels[position][row], frame = run.frames[position].frame;
  const into = to === NOBODY ? null : to;
  if (to === undefined) { say("There is no such identity; type its number or name, new, or none."); return; }
  if (to === id) { say("It is that already."); return; }
  if (id === NOBODY || asking === "d") {
    add({ edit: "assign", frame, detection: row, to: into });
  } else if (asking === "m" && into !== null && run.identities.some((who) => who.id === to)) {
    add({ edit: "merge", id, into });
  } else {
    const [first, last] = asking === "v" ? visitOf(id, position) : [position, numFrames - 1];
    const whole = asking === "m";
    add({ edit: "move", id, first: whole ? 0 : run.frames[first].frame,
      last: whole ? lastFrame : run.frames[last].frame, to: into });
  }
  const done = inWords(edits.at(-1));
  say(`${done[0].toUpperCase()}${done.slice(1)}.`);
}

/** Positions of the visit of an identity around one. */
function visitOf(id, position) {
  const positions = labels.flatMap((row, place) => (row.includes(id) ? [place] : []));
  return joinPositions(positions).find(([first, last]) => first <= position && position <= last);
}

const say = (text) => { byId("label-said").textContent = text; };

function drawPanel() {
  const id = picked ? labels[picked.position][picked.row] : NOBODY;
  const who = !picked ? "No detection is picked."
    : `${id === NOBODY ? "Nobody" : nameOf(id)}: detection ${picked.row} of frame ` +
      `${run.frames[picked.position].frame}.`;
  const button = (key, text, onclick, on = true) => make("button", { type: "button", class: "chip",
    "data-key": key, ...(on ? {} : { disabled: "" }), onclick }, `${text} `, make("kbd", {}, key));
  byId("label-picked").replaceChildren(...(picked && id !== NOBODY ? [swatch(colorFor(id))] : []),
    who);
  byId("label-actions").replaceChildren(
    ...Object.entries(actions).map(([key, { text }]) => button(key, text, () => ask(key), picked)),
    button("u", "Undo", undo, edits.length > 0), button("s", "Save edits", save));
  byId("label-asked").hidden = !asking;
  if (asking) byId("label-start").textContent = `${actions[asking].start} `;
  byId("label-known").replaceChildren(...run.identities.map((one) =>
    make("option", { value: one.id }, one.name)));
  const wrong = conflicts();
  byId("label-count").textContent =
    `${plural(edits.length, "edit")}; identities: ${run.identities.length}`;
  byId("label-conflicts").replaceChildren(...(wrong.length ? [
    `${plural(wrong.length, "frame")} with an identity twice: `,
    ...wrong.slice(0, 12).map(({ position, id: twice }) =>
      chip(position, `${nameOf(twice)} in ${run.frames[position].frame}`))] : []));
}

function takeKey(event) {
  if (event.ctrlKey && event.key === "z") { event.preventDefault(); undo(); return; }
  if (event.target.matches("input, textarea, select") || event.ctrlKey || event.metaKey ||
    event.altKey) return;
  if (event.key in actions) { event.preventDefault(); ask(event.key); }
  else if (event.key === "u") undo();
  else if (event.key === "s") save();
  else if (event.key === "Escape") { asking = null; drawPanel(); }
  else if (event.key === "," || event.key === ".") seek(shown + (event.key === "." ? 1 : -1));
  else if (/^[1-9]$/.test(event.key) && Number(event.key) <= labels[shown].length) {
    pick(shown, Number(event.key) - 1);
  }
}

function prepareLabeling() {
  const target = make("input", { id: "label-target", list: "label-known", size: "8",
    "aria-label": "Identity: a number, new, or none", autocomplete: "off" });
  const asked = make("form", { id: "label-asked", hidden: "" }, make("span", { id: "label-start" }),
    target, make("button", { class: "chip" }, "do it"),
    make("span", { class: "faint" }, " a number, new, or none; or click an identity. Esc: leave it"));
  asked.addEventListener("submit", (event) => {
    event.preventDefault();
    answer(targetOf(target.value));
    if (!asking) { target.value = ""; byId("label").focus({ preventScroll: true }); }
  });
  target.addEventListener("keydown", (event) => {
    if (event.key !== "Escape") return;
    asking = null;
    drawPanel();
    byId("label").focus({ preventScroll: true });
  });
  byId("stage").after(make("section", { id: "label", "aria-labelledby": "label-title",
    tabindex: "-1" },
  make("h2", { id: "label-title" }, "Labels"),
  make("p", { id: "label-picked" }), make("p", { id: "label-actions" }), asked,
  make("p", { id: "label-said", role: "status" }), make("p", { id: "label-conflicts" }),
  make("p", { class: "faint" }, make("span", { id: "label-count" }), ". Pick a detection: a click " +
    "in the video or the list, or 1 to 9; frames: , and . Names in the video are those of the run, " +
    "numbers at the boxes those of the labels. The browser keeps the edits; what counts is the " +
    "file that is saved."),
  make("datalist", { id: "label-known" })));
  if (run.video) {
    video.controls = false;
    byId("player").style.position = "relative";
    const canvas = make("canvas", { id: "boxes", style: { position: "absolute" } });
    canvas.addEventListener("click", (event) => {
      const row = rowAt(event);
      if (row >= 0) pick(shown, row);
    });
    video.after(canvas);
    for (const name of ["loadedmetadata", "seeked"]) {
      video.addEventListener(name, () => drawBoxes(shown));
    }
    new ResizeObserver(() => drawBoxes(shown)).observe(video);
  }
  const choose = (event, id) => {
    if (!asking || id === undefined) return;
    event.preventDefault();
    event.stopPropagation();
    answer(id);
  };
  byId("names").addEventListener("click", (event) => {
    const place = [...byId("names").children].indexOf(event.target.closest("#names > *"));
    choose(event, lanes[place]?.id);
  }, true);
  byId("cards").addEventListener("click", (event) => {
    const place = [...byId("cards").children].indexOf(event.target.closest("#cards > *"));
    choose(event, shownIdentities()[place]?.id);
  }, true);
  document.addEventListener("keydown", takeKey);
  onFrame.push((position) => { decorateList(position); drawBoxes(position); });
  refresh();
}

prepareLabeling();
