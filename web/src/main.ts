// The page: finds the server and its scenes, wires camera, splats, server view and controls
// together, and keeps window.citysplat for tests and for people at the console.
//
// SPDX-License-Identifier: Apache-2.0
import { Box3, Vector3 } from "three";

import { Problem, Server, type DataSet, type SceneInfo } from "./api";
import { formatPose, Frame, parsePose, type Pose } from "./geo";
import { ServerView, type Compare } from "./serverview";
import { SplatLayer } from "./splats";
import { isForScene, Stage } from "./stage";
import "./style.css";

const SMALL_DEVICE = matchMedia("(pointer: coarse)").matches;
const MEMORY_BYTES = (SMALL_DEVICE ? 192 : 768) * 2 ** 20;
const PIXEL_RATIO_MAX = SMALL_DEVICE ? 1.5 : 2;
const DETAIL_DEFAULT = SMALL_DEVICE ? 3 : 4;
const DETAIL_MIDDLE = 4; // the slider position of 16 px of error: a typical Gaussian is one pixel
const AWAKE_MS = 200; // keep drawing this long after the last event

interface State {
  ready: boolean; // the view is complete and on the screen
  tilesLoaded: number; // drawn in this view
  gaussians: number;
  bytes: number;
  error: string | null;
  dataSet: string | null;
  light: string; // the look that is drawn, "" for the default one
  pose(): Pose;
  look(pose: Pose): void;
}
declare global {
  interface Window {
    citysplat: State;
  }
}

function element<T extends HTMLElement>(id: string): T {
  const found = document.getElementById(id);
  if (!found) throw new Error(`no #${id}`);
  return found as T;
}

const surface = element("surface");
const canvas = element<HTMLCanvasElement>("canvas");
const stage = new Stage(surface);
const serverView = new ServerView(element("server-image"), element("divider"), (text, busy) => {
  const line = element("compare-text");
  line.textContent = text;
  line.classList.toggle("busy", busy);
});

const state: State = {
  ready: false,
  tilesLoaded: 0,
  gaussians: 0,
  bytes: 0,
  error: null,
  dataSet: null,
  light: "",
  pose: () => stage.pose(),
  look: (pose) => stage.look(pose),
};
window.citysplat = state;

let layer: SplatLayer | null = null;
let server: Server | null = null;
let current: DataSet | null = null;
let awakeUntil = 0;
let touched = false; // the person has moved the camera, so it is theirs

// ---- problems and notes -------------------------------------------------------------------------

function showProblem(error: unknown) {
  const title = error instanceof Problem ? error.title : "Something went wrong";
  const text = error instanceof Error ? error.message : String(error);
  state.error = `${title}: ${text}`;
  element("problem-title").textContent = title;
  element("problem-text").textContent = text;
  element("problem").hidden = false;
}

let toastTimer = 0;
function toast(text: string) {
  const box = element("toast");
  box.textContent = text;
  box.hidden = false;
  clearTimeout(toastTimer);
  toastTimer = window.setTimeout(() => (box.hidden = true), 4000);
}

// ---- scenes -------------------------------------------------------------------------------------

function extentOf(info: SceneInfo, frame: Frame): Box3 {
  const box = new Box3();
  const toWorld = frame.worldFromEcef.clone().multiply(info.transform);
  for (let i = 0; i < 8; i++) {
    const corner = new Vector3(i & 1 ? 1 : -1, i & 2 ? 1 : -1, i & 4 ? 1 : -1).multiply(info.half);
    box.expandByPoint(corner.add(info.center).applyMatrix4(toWorld));
  }
  return box;
}

let opening = 0; // counts, so that a slow answer for an earlier choice is dropped
async function openScene(set: DataSet, pose: Pose | null) {
  if (!server) return;
  const ticket = ++opening;
  current = set;
  state.dataSet = set.id;
  element("title").textContent = set.title;
  document.title = `${set.title} – citysplat`;
  const info = await server.scene(set, state.light);
  if (ticket !== opening) return;
  element("attribution").textContent = info.attribution;
  stage.frame = new Frame(info.transform);
  stage.setExtent(extentOf(info, stage.frame));
  touched = pose !== null;
  if (pose) stage.look(pose);
  else stage.home();
  if (layer) {
    // The tileset's box holds every stray Gaussian; most of them make a better frame.
    layer.onCore = (min, max) => {
      stage.setExtent(new Box3(min, max));
      if (!touched) stage.home();
    };
    layer.open(info.url, stage.frame, MEMORY_BYTES);
  }
}

function fillChooser(sets: DataSet[], chosen: DataSet) {
  const select = element<HTMLSelectElement>("dataset");
  select.replaceChildren(
    ...sets.map((set) => new Option(set.title, set.id, false, set === chosen)),
  );
  element("chooser").hidden = sets.length < 2;
  select.onchange = () => {
    const set = sets.find((s) => s.id === select.value);
    if (!set) return;
    state.light = "";
    void openScene(set, null).catch(showProblem);
    void fillLights(set).catch(showProblem);
  };
}

// ---- light and weather --------------------------------------------------------------------------

const NAME_DEFAULT = "default";
const LIGHT_WAIT_MS = 400; // after the slider came to rest: every mix is a set of tiles of its own

// A look is a name, or NAME:WEIGHT,NAME:WEIGHT.
function lightChosen(): string {
  const from = element<HTMLSelectElement>("light").value;
  const to = element<HTMLSelectElement>("light-to").value;
  const percent = Number(element<HTMLInputElement>("light-mix").value);
  if (!to || percent === 0) return from === NAME_DEFAULT ? "" : from;
  return percent === 100 ? to : `${from}:${(100 - percent) / 100},${to}:${percent / 100}`;
}

// The other way round, for links: false when the look is none of those two shapes.
function chooseLight(light: string, names: string[]): boolean {
  const parts = light.split(",").map((part) => /^(.*?)(?::([\d.]+))?$/.exec(part)!);
  const weights = parts.map((part) => Number(part[2] ?? 1));
  if (parts.length > 2 || parts.some((part) => !names.includes(part[1]!))) return false;
  element<HTMLSelectElement>("light").value = parts[0]![1]!;
  element<HTMLSelectElement>("light-to").value = parts[1]?.[1] ?? "";
  if (parts[1])
    element<HTMLInputElement>("light-mix").value = String(
      (100 * weights[1]!) / (weights[0]! + weights[1]!),
    );
  return true;
}

let lightTimer = 0;
async function fillLights(set: DataSet) {
  if (!server) return;
  const names = await server.lights(set);
  if (set !== current) return;
  const from = element<HTMLSelectElement>("light");
  const to = element<HTMLSelectElement>("light-to");
  const mix = element<HTMLInputElement>("light-mix");
  element("lights").hidden = names.length === 0;
  const photographs = names.filter((name) => name !== NAME_DEFAULT);
  from.replaceChildren(
    new Option("all photographs", NAME_DEFAULT),
    ...photographs.map((name) => new Option(name, name)),
  );
  to.replaceChildren(
    new Option("nothing", ""),
    ...photographs.filter((name) => !name.includes(",")).map((name) => new Option(name, name)),
  );
  if (state.light) chooseLight(state.light, names);
  mix.hidden = !to.value;
  const apply = (waitMs: number) => {
    mix.hidden = !to.value;
    clearTimeout(lightTimer);
    lightTimer = window.setTimeout(() => {
      if (lightChosen() === state.light) return;
      state.light = lightChosen();
      state.ready = false;
      askedFor = "";
      void openScene(set, stage.pose()).catch(showProblem);
    }, waitMs);
  };
  from.onchange = to.onchange = () => apply(0);
  mix.oninput = () => apply(LIGHT_WAIT_MS);
}

async function start() {
  const page = new URL(location.href);
  const found = await Server.find(page);
  server = found.server;
  const wanted = page.searchParams.get("ds");
  const set = wanted ? found.dataSets.find((s) => s.id === wanted) : found.dataSets[0];
  if (!set) {
    const text = wanted ? `The server has no scene "${wanted}".` : "The server has no scenes.";
    throw new Problem("Nothing to show", text);
  }
  fillChooser(found.dataSets, set);
  state.light = page.searchParams.get("light") ?? "";
  await openScene(set, poseOfHash());
  await fillLights(set);
}

// ---- the address bar ----------------------------------------------------------------------------

function poseOfHash(): Pose | null {
  const match = /^#camera=(.+)$/.exec(decodeURIComponent(location.hash));
  return match ? parsePose(match[1]!) : null;
}

function shareUrl(): string {
  const url = new URL(location.href);
  if (current) url.searchParams.set("ds", current.id);
  if (state.light) url.searchParams.set("light", state.light);
  else url.searchParams.delete("light");
  url.hash = `camera=${formatPose(stage.pose())}`;
  return url.href;
}

async function share() {
  const url = shareUrl();
  history.replaceState(null, "", url);
  try {
    await navigator.clipboard.writeText(url);
    toast("Link copied");
  } catch {
    toast(url); // no clipboard outside secure contexts: the address bar and this line hold it
  }
}

// ---- drawing ------------------------------------------------------------------------------------

function wake() {
  awakeUntil = performance.now() + AWAKE_MS;
  state.ready = false;
}

function resize() {
  const { clientWidth: width, clientHeight: height } = surface;
  layer?.resize(width, height, Math.min(devicePixelRatio, PIXEL_RATIO_MAX));
  stage.resize(width, height);
}

const frames = { last: 0, average: 0 };
function countFrame(now: number, drew: boolean) {
  const gap = now - frames.last;
  if (drew && gap < 1000) frames.average = frames.average ? frames.average * 0.9 + gap * 0.1 : gap;
  if (drew) frames.last = now;
  else if (gap > 1000) frames.average = 0;
}

const whole = new Intl.NumberFormat("en");
function short(n: number): string {
  if (n >= 999_500) return `${(n / 1e6).toFixed(2)} M`;
  return n >= 10_000 ? `${Math.round(n / 1e3)} k` : whole.format(n);
}

function showNumbers() {
  const pose = stage.pose();
  element("north").querySelector("svg")!.style.transform = `rotate(${-pose.heading}deg)`;
  element("where").textContent =
    `${pose.lat.toFixed(6)}°, ${pose.lon.toFixed(6)}°, ${pose.h.toFixed(1)} m · heading ${pose.heading.toFixed(0)}°`;
  if (!layer) return;
  const stats = layer.stats();
  state.tilesLoaded = stats.tiles;
  state.gaussians = stats.gaussians;
  state.bytes = stats.bytes;
  element("stat-gaussians").textContent = short(stats.gaussians);
  element("stat-tiles").textContent = stats.pending
    ? `${stats.tiles} + ${stats.pending}`
    : String(stats.tiles);
  element("stat-bytes").textContent =
    `${(stats.bytes / 1e6).toFixed(stats.bytes < 1e7 ? 2 : 1)} MB`;
  element("stat-fps").textContent = frames.average ? (1000 / frames.average).toFixed(0) : "idle";
  element("progress").hidden = stats.pending === 0;
  if (layer.failure && !state.error)
    showProblem(new Problem("The tiles cannot be shown", layer.failure.message));
}

let previous = 0;
let numbersAt = 0;
let askedFor = ""; // pose of the last server view
function loop(now: number) {
  requestAnimationFrame(loop);
  const seconds = Math.min((now - previous) / 1000, 0.25);
  previous = now;
  const moving = stage.tick(seconds);
  const draw = layer !== null && (now < awakeUntil || !layer.settled);
  if (draw) layer!.draw();
  countFrame(now, draw);
  if (now - numbersAt > 150) {
    numbersAt = now;
    showNumbers();
  }
  if (!moving) requestServerView();
  if (layer) state.ready = !moving && layer.settled && state.tilesLoaded > 0 && !state.error;
}

function requestServerView() {
  if (!serverView.open || !server || !current) return;
  const { clientWidth: width, clientHeight: height } = surface;
  const pose = stage.pose();
  const key = `${current.id} ${state.light} ${formatPose(pose)} ${width}x${height}`;
  if (key === askedFor) return;
  askedFor = key;
  serverView.stale();
  serverView.schedule(server, current.id, state.light, pose, width, height);
}

// ---- buttons and keys ---------------------------------------------------------------------------

function toggleServerView(open = !serverView.open) {
  askedFor = "";
  serverView.show(open);
  element("compare").hidden = !open;
  element("server-button").setAttribute("aria-pressed", String(open));
}

function applyCompare() {
  const mode = document.querySelector<HTMLInputElement>('input[name="mode"]:checked')!
    .value as Compare;
  serverView.setCompare(mode, Number(element<HTMLInputElement>("amount").value) / 100);
}

// A step of the slider is a factor of two. A tile's error is 16 times the size of its typical
// Gaussian, which is the number shown.
function applyDetail() {
  const slider = element<HTMLInputElement>("detail");
  const pixels = 16 * 2 ** (DETAIL_MIDDLE - Number(slider.value));
  element("detail-text").textContent = `Gaussians of ${Number((pixels / 16).toPrecision(2))} px`;
  if (layer) layer.errorTarget = pixels;
}

function fold(folded: boolean) {
  element("panel").classList.toggle("folded", folded);
  const button = element("fold");
  button.setAttribute("aria-expanded", String(!folded));
  button.title = folded ? "Show panel" : "Hide panel";
  button.querySelector(".sr")!.textContent = button.title;
}

const SHORTCUTS: Record<string, () => void> = {
  KeyN: () => stage.northUp(),
  KeyH: () => stage.home(),
  Home: () => stage.home(),
  KeyV: () => toggleServerView(),
  KeyL: () => void share(),
};

function wireControls() {
  const click = (id: string, action: () => void) => element(id).addEventListener("click", action);
  const help = element<HTMLDialogElement>("help");
  click("north", () => stage.northUp());
  click("home", () => stage.home());
  click("zoom-in", () => stage.zoom(0.7));
  click("zoom-out", () => stage.zoom(1 / 0.7));
  click("help-button", () => help.showModal());
  click("server-button", () => toggleServerView());
  click("compare-close", () => toggleServerView(false));
  click("share", () => void share());
  click("fold", () => fold(!element("panel").classList.contains("folded")));
  click("problem-retry", () => location.reload());
  element("amount").addEventListener("input", applyCompare);
  serverView.onDrag = (amount) => {
    element<HTMLInputElement>("amount").value = String(100 * Math.min(1, Math.max(0, amount)));
    applyCompare();
  };
  for (const radio of document.querySelectorAll('input[name="mode"]'))
    radio.addEventListener("change", applyCompare);
  element<HTMLInputElement>("detail").value = String(DETAIL_DEFAULT);
  element("detail").addEventListener("input", applyDetail);
  for (const kind of ["pointerdown", "wheel", "keydown"]) {
    window.addEventListener(kind, () => (touched = true), { passive: true });
  }
  window.addEventListener("keydown", (event) => {
    if (!isForScene(event)) return;
    if (event.key === "?") help.showModal();
    else SHORTCUTS[event.code]?.();
  });
  window.addEventListener("resize", resize);
  window.addEventListener("hashchange", () => {
    const pose = poseOfHash();
    if (pose) stage.look(pose);
  });
  applyDetail();
  applyCompare();
}

// Without WebGL 2, or with ?thin in the address, the server draws every view: the camera works as
// usual.
function startWithoutGraphics(thin: boolean) {
  if (!thin) toast("This browser has no WebGL 2: the server renders the pictures.");
  for (const id of ["detail", "detail-hint", "server-button"]) element(id).hidden = true;
  document.querySelector<HTMLElement>(".range")!.hidden = true;
  document.querySelector<HTMLElement>("#panel dl")!.hidden = true;
  serverView.setCompare("fade", 1);
  serverView.show(true);
}

function main() {
  const thin = new URLSearchParams(location.search).has("thin");
  try {
    if (!thin) layer = new SplatLayer(canvas, stage.camera);
  } catch {
    layer = null;
  }
  stage.onMove = wake;
  if (layer) layer.onWake = wake;
  wireControls();
  if (!layer) startWithoutGraphics(thin);
  resize();
  if (SMALL_DEVICE || innerWidth < 640) fold(true);
  requestAnimationFrame(loop);
  start().catch(showProblem);
}

main();
