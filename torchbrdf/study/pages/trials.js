// The trials: three pictures at their own pixels, a choice, a short blank, the next.
import { say, send, wait } from "./send.js";

const at = id => document.getElementById(id);
const BLANK = 250;  // milliseconds between trials
const GAP = 24;  // CSS pixels between pictures
const MARGIN = 8;  // and above and below them, at least
const NAMES = ["reference", "left", "right"];
const AHEAD = Number(document.body.dataset.ahead);
const LONGEST = 86400;  // seconds; the server takes no more
const room = at("trials");

// phase, for the style too: blank, shows (pictures are on, not yet on the screen), shown (and an answer is awaited),
// paused.
let base, finished, of, trial, pictures, since, asked = 0, frame = 0;
let ready = false, paused = false;
const phase = name => { room.dataset.phase = name; };
const loaded = new Map();

// One image pixel is one pixel of the device, and edges lie between pixels. The window in device pixels, so that nothing
// is rounded twice.
function place() {
  if (!pictures) return;
  const ratio = devicePixelRatio, gap = Math.round(GAP * ratio), { reference, left, right } = pictures;
  const below = Math.max(left.naturalHeight, right.naturalHeight);
  const half = Math.max(left.naturalWidth, right.naturalWidth, Math.ceil(reference.naturalWidth / 2));
  const stage = at("stage"), all = reference.naturalHeight + gap + below;
  const needed = { width: 2 * half + gap, height: all + 2 * Math.round(MARGIN * ratio) };
  const width = Math.max(needed.width, Math.floor(stage.clientWidth * ratio));
  const height = Math.max(needed.height, Math.floor(stage.clientHeight * ratio));
  const top = Math.floor((height - all) / 2), middle = Math.floor(width / 2);
  const inner = Math.floor(gap / 2), lower = top + reference.naturalHeight + gap;
  const places = {
    reference: [middle - Math.floor(reference.naturalWidth / 2), top],
    left: [middle - inner - left.naturalWidth, lower],
    right: [middle - inner + gap, lower],
  };
  for (const name of NAMES) {
    const picture = pictures[name], [x, y] = places[name];
    Object.assign(at(name).style, { left: x / ratio + "px", top: y / ratio + "px" });
    Object.assign(picture.style, { width: picture.naturalWidth / ratio + "px", height: picture.naturalHeight / ratio + "px" });
  }
  // As large as the window where that is enough, so that nothing scrolls.
  const fits = needed.width <= stage.clientWidth * ratio && needed.height <= stage.clientHeight * ratio;
  stage.style.overflow = fits ? "hidden" : "auto";
  Object.assign(at("place").style, { width: width / ratio + "px", height: height / ratio + "px" });
  at("tight").hidden = fits;
}

// When the window moves to a screen with other pixels, its size may stay.
function watch() {
  matchMedia(`(resolution: ${devicePixelRatio}dppx)`).addEventListener("change", () => { place(); watch(); }, { once: true });
}

// The three pictures of a trial, decoded; asked for once.
function load(number) {
  if (!loaded.has(number)) {
    const made = Promise.all(NAMES.map(async name => {
      const picture = new Image();
      picture.alt = "";
      picture.draggable = false;
      picture.src = `${base}/${number}/${name}.png`;
      await picture.decode();
      return [name, picture];
    })).then(Object.fromEntries);
    made.catch(() => loaded.delete(number));  // asked for again when it is its turn
    loaded.set(number, made);
  }
  return loaded.get(number);
}

async function present(state, blank) {
  if (state.stage !== "trials") return finished(state);
  const mine = ++asked;
  [ready, trial, of] = [false, state.trial, state.of];
  if (room.dataset.phase !== "paused") phase("blank");
  at("count").textContent = `${trial + 1} of ${of}`;
  at("bar").value = trial / of;
  for (const number of loaded.keys()) if (number < trial) loaded.delete(number);
  let found;
  try {
    found = await load(trial);
  } catch {
    // Not reachable; or answered in another window, then there is another trial now.
    say("The pictures cannot be loaded. Nothing is lost; trying again …");
    await wait(1000);
    const { status, state: now } = await send(`${base}/state`);
    return status === 200 ? present(now, wait(0)) : location.reload();
  }
  await blank;
  if (mine !== asked) return;
  pictures = found;
  for (const name of NAMES) at(name).replaceChildren(pictures[name]);
  place();
  ready = true;
  show();
}

// The clock runs from the frame after the one that first has the pictures.
function show() {
  if (!ready || paused) return;
  const mine = ++frame;
  phase("shows");
  requestAnimationFrame(() => requestAnimationFrame(() => {
    if (mine !== frame) return;
    since = performance.now();
    phase("shown");
    for (let next = trial + 1; next <= Math.min(trial + AHEAD, of - 1); next++) load(next);
  }));
}

async function choose(side) {
  if (room.dataset.phase !== "shown") return;
  const time = Math.min((performance.now() - since) / 1000, LONGEST), blank = wait(BLANK);
  phase("blank");
  ready = false;
  const { status, state } = await send(`${base}/answer`, { trial, side, response_time: time });
  // 409: answered before, as when an acknowledgment got lost; the state says how to go on.
  if (status === 200 || status === 409) return present(state, blank);
  location.reload();
}

function pause(on) {
  if (paused === on) return;
  paused = on;
  at("paused").hidden = !on;
  at("pause").hidden = on;
  if (on) {
    frame++;
    phase("paused");
    at("resume").focus();
  } else {
    phase("blank");
    at("stage").focus();
    show();
  }
}

function pressed(event) {
  if (event.ctrlKey || event.altKey || event.metaKey || event.target.matches("input")) return;
  const { key } = event;
  if (event.repeat) event.preventDefault();  // a held key does nothing, on a button either
  else if (key === " " || key === "Escape") pause(!paused);
  else if (!paused && (key === "ArrowLeft" || key === "ArrowRight")) choose(key === "ArrowLeft" ? "left" : "right");
  else return;
  event.preventDefault();
}

// Begin where the observer is; those who come back find a pause.
export function run(link, state, after) {
  [base, finished] = [link, end => { stop.abort(); after(end); }];
  const stop = new AbortController(), { signal } = stop;
  document.addEventListener("keydown", pressed, { signal });
  // Some browsers press the button that has the focus when Space is let go, whatever became of its keydown.
  document.addEventListener("keyup", event => { if (event.key === " ") event.preventDefault(); }, { signal });
  document.addEventListener("visibilitychange", () => { if (document.hidden) pause(true); }, { signal });
  window.addEventListener("resize", place, { signal });
  watch();
  at("left").onclick = () => choose("left");
  at("right").onclick = () => choose("right");
  at("pause").onclick = () => pause(true);
  at("resume").onclick = () => pause(false);
  at("stage").focus();
  if (state.trial > 0) pause(true);
  present(state, wait(BLANK));
}
