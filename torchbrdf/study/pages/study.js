// From the first page to the last: which part is shown, and what is asked before the trials.
import { say, send } from "./send.js";
import { run } from "./trials.js";

const at = id => document.getElementById(id);
const link = location.pathname;
const CHROME = { width: 24, height: 36 + 16 + 24 };  // CSS pixels around the pictures

function open(name) {
  for (const part of document.querySelectorAll("main")) part.hidden = part.id !== name;
  scrollTo(0, 0);
  document.querySelector(`#${name} [tabindex]`).focus();
}

// A form that is sent once, and again only if the server refused it.
function onSubmit(form, sent) {
  form.addEventListener("submit", async event => {
    event.preventDefault();
    const button = form.querySelector("button:not([type])");
    button.disabled = true;
    await sent(new FormData(form));
    button.disabled = false;
  });
}

async function post(what, record) {
  const { state, error } = await send(`${link}/${what}`, record);
  if (state) go(state);
  else say(error);
}

// The window against the pictures, in device pixels.
function measure() {
  const { width, height } = document.body.dataset, ratio = devicePixelRatio;
  at("small").hidden = 2 * width <= (innerWidth - CHROME.width) * ratio && 2 * height <= (innerHeight - CHROME.height) * ratio;
}

function go(state) {
  if (state.stage === "trials" && state.trial === 0) open("instructions");
  else if (state.stage === "trials") start(state);
  else open(state.stage);
  measure();
}

function start(state) {
  open("trials");
  run(link, state, go);
}

function prepare() {
  for (const field of document.querySelectorAll(".link")) {
    field.value = location.href;
    field.onfocus = () => field.select();
  }
  onSubmit(document.querySelector("#questions form"), data => post("profile", Object.fromEntries(data)));

  const card = at("card"), width = at("width"), skip = at("skip");
  const unsure = () => width.setCustomValidity(skip.checked || width.dataset.moved ? "" : "Make the box as wide as a card, or tick below.");
  width.oninput = () => {
    width.dataset.moved = true;
    card.style.width = width.value + "px";
    unsure();
  };
  skip.onchange = () => {
    width.disabled = skip.checked;
    unsure();
  };
  unsure();
  window.addEventListener("resize", measure);
  at("full").onclick = () => document.documentElement.requestFullscreen();
  onSubmit(document.querySelector("#screen form"), data => post("screen", {
    dark_steps: Number(data.get("dark_steps")),
    bright_steps: Number(data.get("bright_steps")),
    card: skip.checked ? null : card.getBoundingClientRect().width * devicePixelRatio,
    pixel_ratio: devicePixelRatio,
    window_width: innerWidth,
    window_height: innerHeight,
    screen_width: screen.width,
    screen_height: screen.height,
    colour_depth: screen.colorDepth,
  }));

  onSubmit(document.querySelector("#instructions form"), async () => {
    const { state } = await send(`${link}/state`);
    if (state.stage === "trials") start(state);
    else go(state);
  });
}

if (at("landing")) {
  onSubmit(at("consent"), async () => {
    const { link: own, error } = await send("begin", { agreed: true });
    if (own) location.replace(`.${own}`);  // a proxy may have put a prefix before it
    else say(error);
  });
} else {
  prepare();
  const { state, error } = await send(`${link}/state`);
  if (state) go(state);
  else say(error);
}
