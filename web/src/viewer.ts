// The viewer that others put into their pages: a container, a URL, a camera, events. The page of
// this folder is one of its users.
//
// SPDX-License-Identifier: Apache-2.0
import { Box3, Ray, Vector3 } from "three";

import { City, type CityStats } from "./city";
import { Frame, type Place, type Pose } from "./geo";
import { Layers, type Layer } from "./layers";
import { HttpError, Link, type LinkState } from "./link";
import { Overlay } from "./overlay";
import { pickMedian } from "./pick";
import { Pictures, type PictureInfo } from "./pictures";
import { Problem } from "./problem";
import {
  findBasemap,
  findFirst,
  findMapTiles,
  findScenes,
  listAppearances,
  openScene,
  pictureUrl,
  type Appearance,
  type Basemap,
  type MapTiles,
  type SceneEntry,
  type SceneInfo,
} from "./source";
import type { ShotOptions } from "./shot";
import { Stage, type Walk } from "./stage";
import { decodeOnce } from "./core";
import type { Network } from "./network";
import { Tint } from "./tint";

// Of this module, as semantic versioning has it: what docs/viewer.md names is what it promises.
export const version: string = __VERSION__;

export type { Appearance, Basemap, CityStats, LinkState, MapTiles, Place, Pose, SceneEntry, Walk };

export {
  LayerError,
  type Layer,
  type LayerChange,
  type LayerKind,
  type LayerOptions,
  type ModelPlace,
} from "./layers";

export type { ShotFormat, ShotOptions } from "./shot";

export type Mode = "splats" | "pictures"; // drawn here, or by the server

export interface ViewerOptions {
  // A citysplat server's folder, or a tileset.json on any file server. Default: the page's folder.
  url?: string | URL | (string | URL)[];
  scene?: string; // its id; default: the first
  pose?: Pose | null; // default: the whole scene
  appearance?: string; // default: ""
  mode?: Mode | "auto"; // auto: splats where there is WebGL 2
  colours?: "here" | "server"; // who computes those of an appearance; default: here, where that can be
  memoryMb?: number; // for tiles, on the card and in the page together
  detail?: number; // px that a typical Gaussian may have on the screen; default 1
  backdrop?: boolean; // sky and ground; default true
  theme?: "dark" | "light";
  keyboard?: boolean; // keys move the camera; default true
}

export interface ViewerEvents {
  scene: SceneEntry; // opened
  ready: ViewerState; // all that this view wants is on the screen
  move: Pose;
  touch: null; // a person moved the camera
  appearance: string; // the new one is on the screen
  preview: string; // it is there roughly, and the exact picture follows: where frames take long
  link: LinkState;
  problem: Error;
  slow: number; // frames a second: pictures of the server would be quicker
  mode: Mode;
  context: boolean; // the graphics card dropped the page (true), or took it up again
  picture: PictureInfo;
  click: { x: number; y: number; place: Place | null };
  layers: readonly Layer[]; // they changed
  frame: null; // something was drawn
}

export interface ViewerState {
  ready: boolean; // what this view wants is drawn, all of it
  settled: boolean; // nothing more will come by itself
  mode: Mode;
  link: LinkState;
  scene: string | null;
  appearance: string; // on the screen
  wanted: string; // the appearance asked for
  tiles: number; // drawn
  gaussians: number; // drawn
  bytes: number; // of tiles
  received: number; // of everything
  pending: number;
  memory: number;
  heldBack: boolean;
  broken: { name: string; why: string }[];
  error: string | null;
  framesPerSecond: number; // 0 while nothing is drawn
  progress: Progress | null; // what it waits for; null: nothing
}

export interface Progress {
  phase: "catalogue" | "tileset" | "tiles" | "decoding" | "appearance" | "picture" | "layers";
  done: number; // tiles of this wait, or layers
  total: number; // 0: not known
  bytes: number; // received since it began
}

const SMALL_DEVICE = matchMedia("(pointer: coarse)").matches;
const MEMORY_MB = SMALL_DEVICE ? 384 : 1536;
const PIXEL_RATIO_MAX = SMALL_DEVICE ? 1.5 : 2;
const PX_PER_SIGMA = 16; // a tile's geometric error is 16 times its typical Gaussian
const AWAKE_MS = 200; // keep drawing this long after the last event
const MIXING_MS = 150;
const ROUGH_FROM_MS = 80; // frames that take longer are announced by a rough one
const ROUGH_MS = 250; // and follow it when nothing changes for so long
const SLOW_FPS = 10;
const SLOW_FRAMES = 8;
const BRISK_MS = 60; // a frame of a moving camera that takes longer is drawn with fewer pixels
const SHARPNESS_LEAST = 0.4;
const ABOVE_M = 200; // over most of the city: where one looks down from
const FINE_M = 0.25; // how finely
const EMPTY: CityStats = {
  tiles: 0,
  gaussians: 0,
  bytes: 0,
  pending: 0,
  parsing: 0,
  came: 0,
  memory: 0,
  heldBack: false,
  broken: [],
};

type Handler<K extends keyof ViewerEvents> = (value: ViewerEvents[K]) => void;

function extentOf(info: SceneInfo, frame: Frame): Box3 {
  const box = new Box3();
  const toWorld = frame.worldFromEcef.clone().multiply(info.transform);
  for (let i = 0; i < 8; i++) {
    const corner = new Vector3(i & 1 ? 1 : -1, i & 2 ? 1 : -1, i & 4 ? 1 : -1).multiply(info.half);
    box.expandByPoint(corner.add(info.center).applyMatrix4(toWorld));
  }
  return box;
}

export class Viewer {
  readonly surface: HTMLElement; // takes pointer and keys
  readonly canvas: HTMLCanvasElement;
  readonly stage: Stage;
  readonly overlay: Overlay;
  readonly layers: Layers;
  scenes: SceneEntry[] = [];
  scene: SceneEntry | null = null;
  info: SceneInfo | null = null;
  private readonly pictureCanvas: HTMLCanvasElement;
  private readonly link = new Link();
  private readonly pictures: Pictures;
  private readonly handlers = new Map<string, Set<(value: never) => void>>();
  private city: City | null = null;
  private currentMode: Mode = "splats";
  private wantedAppearance: string;
  private wantedSecond: string | null = null; // right of the line
  private shownAppearance = "";
  private error: Error | null = null;
  private tint: Tint | null = null; // computes the colours; null where the server does
  private roughUntil = 0; // a rough picture of the new appearance is on the screen
  private mixingUntil = 0; // the appearance is being changed: quick frames before sharp ones
  private touched = false;
  private homeless = true; // the scene's extent is not known yet
  private opening = 0;
  private describing = 0; // scenes whose documents are on their way
  private readonly waits = { received: 0, came: 0 }; // when the page began to wait
  private awakeUntil = 0;
  private stale = true; // something happened since the last frame began
  private wasReady = false;
  private running = 0;
  private previous = 0;
  private moving = false;
  private closed = false;
  private drewBefore = false;
  private frameMs = 0; // that frames took lately
  private readonly fps = { last: 0, average: 0, slow: 0 };
  private sharpness = 1; // of the picture while the camera moves; always 1 at rest
  private readonly resizing: ResizeObserver;
  private theme: "dark" | "light";
  private readonly positions: boolean; // the container, which had no position of its own

  constructor(
    readonly container: HTMLElement,
    private readonly options: ViewerOptions = {},
  ) {
    this.theme = options.theme ?? "dark";
    const layer = (tag: string) => {
      const node = document.createElement(tag);
      Object.assign(node.style, { position: "absolute", inset: "0", width: "100%", height: "100%" });
      return node;
    };
    this.surface = layer("div");
    this.canvas = layer("canvas") as HTMLCanvasElement;
    this.pictureCanvas = layer("canvas") as HTMLCanvasElement;
    this.pictureCanvas.hidden = true;
    this.pictureCanvas.className = "citysplat-picture";
    Object.assign(this.surface.style, { overflow: "hidden", outline: "none", background: "#0b0e13" });
    this.surface.tabIndex = 0;
    this.surface.append(this.canvas, this.pictureCanvas);
    this.positions = getComputedStyle(container).position === "static";
    if (this.positions) container.style.position = "relative";
    container.append(this.surface);

    this.wantedAppearance = options.appearance ?? "";
    this.stage = new Stage(this.surface);
    this.stage.keyboard = options.keyboard ?? true;
    this.stage.onMove = () => this.wake();
    this.stage.onTouch = () => {
      this.touched = true;
      this.emit("touch", null);
    };
    this.stage.surfaceOn = (ray) => this.surfaceOn(ray);
    this.stage.onClick = (x, y) => {
      const point = this.surfaceOn(this.stage.ray(x, y));
      this.emit("click", { x, y, place: point && this.stage.frame.placeOf(point) });
    };
    this.overlay = new Overlay(this.surface, this.stage);
    this.overlay.onWake = () => this.wake();
    this.layers = new Layers(this.stage, this.overlay, (place) => this.heightOf(place));
    this.layers.onWake = () => this.wake();
    this.layers.onChange = () => {
      this.emit("layers", this.layers.list);
      this.wake();
    };
    this.pictures = new Pictures(this.pictureCanvas, this.link, true);
    this.pictures.onPicture = (info) => {
      this.shownAppearance = this.wantedAppearance;
      this.clearProblem();
      this.emit("picture", info);
    };
    this.pictures.onProblem = (error) => this.fail(error);
    this.link.onState = (state, before) => {
      this.emit("link", state);
      if (before === "away") void this.comeBack();
      this.wake();
    };
    this.startDrawing(options.mode ?? "auto");
    this.resizing = new ResizeObserver(() => this.resize());
    this.resizing.observe(container);
    this.resize();
    this.running = requestAnimationFrame((now) => this.loop(now));
    void this.start();
  }

  // ---- events ----

  on<K extends keyof ViewerEvents>(name: K, handler: Handler<K>): () => void {
    const set = this.handlers.get(name) ?? new Set();
    this.handlers.set(name, set);
    set.add(handler as (value: never) => void);
    return () => set.delete(handler as (value: never) => void);
  }

  private emit<K extends keyof ViewerEvents>(name: K, value: ViewerEvents[K]) {
    for (const handler of this.handlers.get(name) ?? []) (handler as Handler<K>)(value);
  }

  // ---- what it is doing ----

  get state(): ViewerState {
    const drawn = this.currentMode === "splats";
    const stats = (drawn && this.city?.stats()) || EMPTY;
    const settled = this.isSettled();
    return {
      ready: settled && !stats.heldBack && !stats.broken.length && !this.error && this.link.state !== "away",
      settled,
      mode: this.currentMode,
      link: this.link.state,
      scene: this.scene?.id ?? null,
      appearance: this.shownAppearance,
      wanted: this.wantedAppearance,
      tiles: stats.tiles,
      gaussians: stats.gaussians,
      bytes: stats.bytes,
      received: this.link.received,
      pending: drawn ? stats.pending : Number(this.pictures.pending),
      memory: stats.memory,
      heldBack: stats.heldBack,
      broken: stats.broken.map(({ name, why }) => ({ name, why })),
      error: this.error ? this.error.message : null,
      framesPerSecond: this.fps.average ? 1000 / this.fps.average : 0,
      progress: this.progress(stats),
    };
  }

  // What comes is counted from the moment on at which nothing did.
  private progress({ pending, parsing, came }: CityStats): Progress | null {
    const { waits, layers } = this;
    const phase = this.phase(pending, parsing);
    if (!phase) {
      waits.received = this.link.received;
      waits.came = came;
      return null;
    }
    if (came < waits.came) waits.came = came; // other tiles than those that were counted
    const bytes = this.link.received - waits.received;
    const shown = layers.list.filter(({ state }) => state !== "loading").length;
    if (phase === "layers") return { phase, done: shown, total: layers.list.length, bytes: 0 };
    const done = came - waits.came;
    const counted = phase === "tiles" || phase === "decoding" || (phase === "appearance" && pending > 0);
    return { phase, done: counted ? done : 0, total: counted ? done + pending : 0, bytes };
  }

  private phase(pending: number, parsing: number): Progress["phase"] | null {
    if (this.error && !pending) return null;
    if (!this.scene && !this.error) return this.scenes.length ? "tileset" : "catalogue";
    if (this.describing) return this.wantedAppearance !== this.shownAppearance && this.info ? "appearance" : "tileset";
    if (this.currentMode === "pictures") return this.pictures.pending ? "picture" : null;
    if (this.city?.changing) return "appearance";
    if (pending > parsing) return "tiles";
    if (parsing) return "decoding";
    return this.layers.list.some(({ state }) => state === "loading") ? "layers" : null;
  }

  private isSettled(): boolean {
    if (this.moving || this.stale || !this.info) return false;
    if (this.currentMode === "pictures") return this.pictures.settled;
    return this.city?.settled ?? false;
  }

  // ---- the camera ----

  get pose(): Pose {
    return this.stage.pose();
  }

  lookAt(pose: Pose) {
    this.touched = true;
    this.stage.look(pose);
  }

  // Moves there in some seconds; resolves on arrival or when a person takes over.
  flyTo(pose: Pose, seconds?: number): Promise<void> {
    this.touched = true;
    return this.stage.fly(pose, seconds);
  }

  home() {
    this.touched = false;
    this.stage.home();
  }

  // Where the city is at a point of the container, in CSS pixels from its corner; null for the sky.
  pick(x: number, y: number): Place | null {
    const point = this.surfaceOn(this.stage.ray(x, y));
    return point && this.stage.frame.placeOf(point);
  }

  // The height of what is drawn at a place, seen from straight above; null where there is nothing.
  heightOf({ lon, lat }: Pick<Place, "lon" | "lat">): number | null {
    const { frame, extent } = this.stage;
    const above = frame.pointOf({ lon, lat, h: 0 }).setY(extent.max.y + ABOVE_M);
    const perMetre = FINE_M / (above.y - extent.min.y + 1);
    const ray = new Ray(above, new Vector3(0, -1, 0));
    const found = this.city ? pickMedian(this.city.engine.visibleBlocks, ray, perMetre) : null;
    return found && frame.placeOf(found).h;
  }

  private surfaceOn(ray: Ray): Vector3 | null {
    const perMetre =
      (2 * Math.tan((this.stage.camera.fov * Math.PI) / 360)) / Math.max(1, this.surface.clientHeight);
    const point = this.city ? pickMedian(this.city.engine.visibleBlocks, ray, perMetre) : null;
    const other = this.city ? this.layers.meet(ray) : null;
    if (!point || !other) return point ?? other;
    return point.distanceTo(ray.origin) < other.distanceTo(ray.origin) ? point : other;
  }

  // ---- scenes and appearance ----

  async openScene(id: string, pose: Pose | null = null, appearance = ""): Promise<void> {
    const entry = this.scenes.find((one) => one.id === id);
    if (!entry) return this.fail(new Problem("noScene", { id }));
    this.wantedAppearance = appearance;
    await this.open(entry, pose, false);
  }

  // The picture stays as it is until the new one is complete. Where the colours are computed here
  // that is the next frame, and no tile is asked for.
  async setAppearance(appearance: string): Promise<void> {
    if (appearance === this.wantedAppearance || !this.scene) return;
    this.wantedAppearance = appearance;
    const { tint } = this;
    if (!tint) return this.open(this.scene, null, true);
    const ticket = ++this.opening;
    this.clearProblem();
    try {
      const image = await tint.network.find(appearance);
      if (ticket !== this.opening || tint !== this.tint || this.closed) return;
      this.showTint(tint, image, appearance);
    } catch (error) {
      if (tint === this.tint) this.refuseAppearance(error, ticket);
    }
  }

  private showTint(tint: Tint, image: Float32Array, appearance: string) {
    const rough = this.city?.showRoughly(() => tint.set(image, appearance)) ?? false;
    if (!this.city) tint.set(image, appearance);
    if (rough) {
      this.roughUntil = performance.now() + ROUGH_MS;
      this.emit("preview", appearance);
    } else this.mixingUntil = performance.now() + MIXING_MS;
    this.wake();
  }

  private refuseAppearance(error: unknown, ticket: number) {
    if (ticket !== this.opening || this.closed) return;
    this.wantedAppearance = this.shownAppearance;
    this.fail(error);
  }

  // Photographs are listed with time, pose and thumbnail where the server knows them.
  appearances(entry = this.scene): Promise<Appearance[]> {
    if (!entry) return Promise.resolve([]);
    const network = entry === this.scene ? (this.info?.network ?? null) : null;
    return listAppearances(this.link, entry, network);
  }

  // Another appearance right of a part of the width; null: one alone. Needs colours that are computed
  // here. One that is not there is a problem like any other, and leaves what is shown.
  async setSecondAppearance(appearance: string | null, share = 0.5): Promise<void> {
    const { tint } = this;
    if (!tint) return;
    this.wantedSecond = appearance;
    this.clearProblem();
    const late = () => tint !== this.tint || appearance !== this.wantedSecond || this.closed;
    try {
      const image = appearance === null ? null : await tint.network.find(appearance);
      if (late()) return;
      tint.setSecond(image, appearance);
      this.splitAt(image ? share : null);
    } catch (error) {
      if (late()) return;
      this.wantedSecond = tint.names[1];
      this.fail(error);
    }
  }

  // The appearance right of the line; null: there is none.
  get secondAppearance(): string | null {
    return this.tint?.names[1] ?? null;
  }

  // The line between the two, as a part of the width; null: none.
  splitAt(share: number | null) {
    if (this.city) this.city.split = this.secondAppearance === null ? null : share;
    this.mixingUntil = performance.now() + MIXING_MS;
    this.wake();
  }

  // Something of the scene is on the screen.
  get hasPicture(): boolean {
    return this.currentMode === "pictures" ? this.pictures.drawn > 0 : (this.city?.shows ?? false);
  }

  get heightAboveGround(): number {
    return this.stage.camera.position.y - this.stage.extent.min.y;
  }

  // Map tiles of the scene, seen from straight above; null where the server has none.
  async mapTiles(): Promise<MapTiles | null> {
    return this.scene ? findMapTiles(this.link, this.scene).catch(() => null) : null;
  }

  // Map tiles of somebody else, where the operator of the server chose some.
  async basemap(): Promise<Basemap | null> {
    return this.scene ? findBasemap(this.link, this.scene).catch(() => null) : null;
  }

  // Bytes of the server; waits while it is away.
  get(url: string | URL, signal: AbortSignal | null = null): Promise<ArrayBuffer> {
    return this.link.bytes(url, signal);
  }

  // Whether an appearance is a matter of this browser alone.
  get computesColours(): boolean {
    return this.tint !== null;
  }

  private async start() {
    const { url } = this.options;
    const urls = (Array.isArray(url) ? url : [url ?? "./"]).map((one) => new URL(one, location.href));
    try {
      this.link.watch(urls.length === 1 && /\.json$/.test(urls[0]!.pathname) ? urls[0]! : new URL("collections", urls[0]));
      this.scenes = urls.length > 1 ? await findFirst(this.link, urls) : await findScenes(this.link, urls[0]!);
      const id = this.options.scene;
      const entry = id === undefined ? this.scenes[0] : this.scenes.find((one) => one.id === id);
      if (!entry) throw new Problem(id === undefined ? "noScenes" : "noScene", { id: id ?? "" });
      await this.open(entry, this.options.pose ?? null, false);
    } catch (error) {
      this.fail(error);
    }
  }

  private async open(entry: SceneEntry, pose: Pose | null, keep: boolean) {
    const ticket = ++this.opening;
    this.clearProblem();
    this.wake();
    let info: SceneInfo;
    let tint: Tint | null;
    this.describing++;
    try {
      info = await this.describe(entry);
      tint = await this.makeTint(info, this.wantedAppearance);
    } catch (error) {
      if (keep) this.refuseAppearance(error, ticket);
      else if (ticket === this.opening) this.fail(error);
      return;
    } finally {
      this.describing--;
    }
    if (ticket !== this.opening || this.closed) return;
    this.tint = tint;
    this.wantedSecond = null;
    if (this.city) this.city.split = null;
    const sameScene = this.scene === entry;
    this.scene = entry;
    this.info = info;
    this.link.watch(entry.tileset);
    if (!keep) {
      const before = sameScene ? this.stage.pose() : pose;
      this.stage.frame = new Frame(info.transform);
      this.homeless = true;
      this.setExtent(extentOf(info, this.stage.frame));
      this.touched = before !== null;
      if (before) this.stage.look(before);
      else this.stage.home();
      this.overlay.reset();
      this.layers.reset();
      this.pictures.retry();
    }
    this.city?.open(info, this.stage.frame, keep, tint);
    if (!this.city) void this.findCore(info, ticket);
    this.emit("scene", entry);
    this.wake();
  }

  private describe(entry: SceneEntry): Promise<SceneInfo> {
    const { city } = this;
    const here = city && this.options.colours !== "server";
    const compute = here ? (network: Network) => city.canTint(network) : null;
    return openScene(this.link, entry, this.wantedAppearance, compute);
  }

  private async makeTint({ network }: SceneInfo, appearance: string): Promise<Tint | null> {
    if (!network) return null;
    const tint = new Tint(network);
    tint.set(await network.find(appearance), appearance);
    return tint;
  }

  // The server was away. Where it came back with another revision, the tiles of the old one are
  // gone: opened anew, with the picture kept.
  private async comeBack() {
    this.pictures.retry();
    this.city?.retry();
    const { scene, info } = this;
    if (!scene || !info) return;
    try {
      const next = await this.renew(scene, info.revision);
      if (!next || this.info !== info || this.closed) return;
      const { fresh, tint, entry, all } = next;
      this.scenes = all;
      this.scene = entry;
      this.info = fresh;
      this.tint = tint;
      this.wantedSecond = this.secondAppearance; // null where the new revision has not that photograph
      if (this.city && this.wantedSecond === null) this.city.split = null;
      this.city?.open(fresh, this.stage.frame, true, tint);
    } catch {
      // it is gone again, and the link says so
    }
  }

  // The scene as it is now, in the appearances that are wanted when it is there: they may be changed
  // on the way. null: it is of that revision still.
  private async renew(scene: SceneEntry, revision: string) {
    for (;;) {
      const { wantedAppearance: first, wantedSecond: second } = this;
      const fresh = await this.describe(scene);
      if (fresh.revision === revision) return null;
      const tint = await this.makeTint(fresh, first);
      const image = second === null ? null : await fresh.network?.find(second).catch(() => null);
      tint?.setSecond(image ?? null, second);
      const all = scene.catalogue
        ? await findScenes(this.link, scene.catalogue).catch(() => this.scenes)
        : this.scenes;
      const entry = all.find((one) => one.id === scene.id) ?? scene;
      if (first === this.wantedAppearance && second === this.wantedSecond)
        return { fresh, tint, entry, all };
    }
  }

  // Without a card the coarsest tile is read for the extent alone, so that home is the same.
  private async findCore(info: SceneInfo, ticket: number) {
    const core = await decodeOnce(this.link, info, this.stage.frame).catch(() => null);
    if (core && ticket === this.opening) this.setCore(core);
  }

  private setCore(core: Box3) {
    this.setExtent(core);
    this.layers.reset();
    this.homeless = false;
    if (!this.touched) this.stage.home();
  }

  private setExtent(box: Box3) {
    this.stage.setExtent(box);
    this.city?.backdrop.setExtent(box);
  }

  private fail(error: unknown) {
    if (this.closed || (error instanceof DOMException && error.name === "AbortError")) return;
    this.error =
      error instanceof HttpError
        ? new Problem("http", { status: error.status, text: error.message })
        : error instanceof Error
          ? error
          : new Error(String(error));
    this.emit("problem", this.error);
    this.wake();
  }

  private clearProblem() {
    this.error = null;
  }

  // Asks again for what failed.
  retry() {
    const none = !this.scene;
    this.clearProblem();
    this.city?.retry();
    this.pictures.retry();
    if (none) void this.start();
    else if (this.wantedAppearance !== this.shownAppearance) void this.open(this.scene!, null, true);
    this.wake();
  }

  // ---- drawing ----

  get mode(): Mode {
    return this.currentMode;
  }

  // Whether the server draws pictures of this scene.
  async canDrawPictures(): Promise<boolean> {
    if (!this.scene?.pictures) return false;
    const url = pictureUrl(this.scene, this.wantedAppearance, this.pose, 64, 48);
    return fetch(url)
      .then((response) => response.ok)
      .catch(() => false);
  }

  setMode(mode: Mode) {
    if (mode === this.currentMode) return;
    if (mode === "splats" && !this.city && !this.startCity()) return;
    this.currentMode = mode;
    this.pictureCanvas.hidden = mode !== "pictures";
    if (mode === "splats") this.pictures.stop();
    this.fps.slow = 0;
    this.emit("mode", mode);
    this.wake();
  }

  set detail(px: number) {
    if (this.city) this.city.errorTarget = PX_PER_SIGMA * px;
  }

  set backdrop(on: boolean) {
    if (this.city) this.city.backdrop.visible = on;
    this.wake();
  }

  setTheme(theme: "dark" | "light") {
    this.theme = theme;
    this.city?.backdrop.setTheme(theme);
    this.wake();
  }

  // For tiles, on the card and in the page together.
  set memoryMb(megabytes: number) {
    this.city?.setMemory(megabytes * 2 ** 20);
  }

  // The picture on the screen as a PNG.
  async snapshot(): Promise<Blob> {
    const canvas = this.currentMode === "splats" ? this.canvas : this.pictureCanvas;
    if (this.currentMode === "splats") this.city?.redraw();
    return new Promise((resolve, reject) =>
      canvas.toBlob((blob) => (blob ? resolve(blob) : reject(new Error("no picture"))), "image/png"),
    );
  }

  // The view at any size, drawn by the server (in parts where it draws smaller ones only) or, where there
  // is none, by this browser. Rejects with why not.
  async screenshot(options: ShotOptions): Promise<Blob> {
    const { checkSize, drawByServer, encodeCanvas } = await import("./shot");
    const { width, height, format = "jpg" } = options;
    checkSize(width, height);
    const background = options.background ?? (this.city?.backdrop.visible ? "sky" : "black");
    const { scene, stage } = this;
    const by = options.by ?? (scene?.questions ? "server" : "browser");
    if (by === "server") {
      if (!scene?.questions) throw new Problem("noPictures");
      stage.camera.updateMatrixWorld();
      const render = new URL("render", scene.questions);
      return drawByServer(render, stage.camera, this.wantedAppearance, { ...options, background });
    }
    const { city } = this;
    if (!city) throw new Problem("noPictures");
    return city.drawOnce(width, height, background === "sky", () => encodeCanvas(this.canvas, format));
  }

  // The view as the server draws it, at any size that it takes.
  serverPicture(width: number, height: number): URL | null {
    return this.scene?.pictures
      ? pictureUrl(this.scene, this.wantedAppearance, this.pose, width, height)
      : null;
  }

  // The server's drawing of this view on a canvas of the caller's, for comparing.
  comparison(canvas: HTMLCanvasElement): Pictures {
    return new Pictures(canvas, this.link, false);
  }

  get wantedView(): { entry: SceneEntry | null; appearance: string; width: number; height: number } {
    const { clientWidth: width, clientHeight: height } = this.surface;
    return { entry: this.scene, appearance: this.wantedAppearance, width, height };
  }

  private startDrawing(mode: Mode | "auto") {
    if (mode !== "pictures" && this.startCity()) return;
    this.currentMode = "pictures";
    this.pictureCanvas.hidden = false;
  }

  private startCity(): boolean {
    const megabytes = this.options.memoryMb ?? MEMORY_MB;
    try {
      this.city = new City(this.canvas, this.stage.camera, this.link, megabytes * 2 ** 20);
    } catch {
      return false;
    }
    const { city } = this;
    city.onWake = () => this.wake();
    city.onCore = (core) => this.setCore(core);
    city.onContext = (lost) => {
      this.emit("context", lost);
      this.wake();
    };
    city.onFailure = (error) => this.fail(error);
    city.errorTarget = PX_PER_SIGMA * (this.options.detail ?? 1);
    city.backdrop.visible = this.options.backdrop ?? true;
    city.backdrop.setTheme(this.theme);
    city.setOverlay(this.overlay, this.layers);
    this.resize();
    if (this.info && this.scene) {
      city.backdrop.setExtent(this.stage.extent);
      void this.open(this.scene, null, false);
    }
    return true;
  }

  private wake() {
    this.awakeUntil = performance.now() + AWAKE_MS;
    this.stale = true;
  }

  private resize() {
    const { clientWidth: width, clientHeight: height } = this.surface;
    if (!width || !height) return;
    this.sharpen(1);
    this.overlay.resize(width, height);
    this.stage.resize(width, height);
    if (!this.touched && !this.homeless) this.stage.home();
  }

  private loop(now: number) {
    this.running = requestAnimationFrame((next) => this.loop(next));
    const seconds = Math.min((now - this.previous) / 1000, 0.25);
    this.previous = now;
    const asked = this.stale; // also where the last frame took longer than AWAKE_MS
    this.stale = false;
    const moved = this.stage.tick(seconds);
    if (moved) this.emit("move", this.pose);
    this.moving = moved;
    if (this.currentMode === "pictures") this.drawPictures();
    else this.drawCity(now, moved, asked || now < this.awakeUntil);
    this.report();
  }

  private drawPictures() {
    const { entry, appearance, width, height } = this.wantedView;
    if (!entry || !this.info || document.hidden) return;
    if (!entry.pictures) {
      if (!this.error) this.fail(new Problem("noPictures"));
      return;
    }
    this.pictures.want(entry, appearance, this.pose, width, height);
    if (performance.now() < this.awakeUntil) {
      this.overlay.update();
      this.emit("frame", null);
    }
  }

  private drawCity(now: number, moved: boolean, wanted: boolean) {
    const { city } = this;
    if (!city) return;
    if (moved) this.roughUntil = 0;
    if (now < this.roughUntil) {
      this.wake();
      return;
    }
    const mixing = now < this.mixingUntil;
    const draw = wanted || moved || mixing || (!city.settled && this.info !== null);
    if (draw) {
      this.sharpen(moved || mixing ? this.sharpness : 1);
      if (mixing) this.stale = true; // and once more, with all pixels
      city.keepPicture = this.tint !== null && this.frameMs > ROUGH_FROM_MS;
      city.draw();
      this.overlay.update();
      if (!city.changing) this.tellAppearance();
      this.emit("frame", null);
    }
    this.measure(now, draw, moved || mixing);
  }

  // How many of the pixels are drawn, a side.
  private sharpen(share: number) {
    const { clientWidth: width, clientHeight: height } = this.surface;
    if (!width || !height) return;
    this.city?.resize(width, height, share * Math.min(devicePixelRatio, PIXEL_RATIO_MAX));
  }

  private tellAppearance() {
    const now = this.tint ? this.tint.names[0] : this.wantedAppearance;
    if (this.shownAppearance === now || !(this.tint ? this.city?.shows : this.city?.settled)) return;
    this.shownAppearance = now;
    this.emit("appearance", this.shownAppearance);
  }

  private measure(now: number, drew: boolean, moved: boolean) {
    const { fps } = this;
    const gap = now - fps.last;
    if (drew && gap < 3000) fps.average = fps.average ? fps.average * 0.8 + gap * 0.2 : gap;
    else if (gap > 1000) fps.average = 0;
    if (drew && this.drewBefore && gap < 10_000) this.frameMs += 0.3 * (gap - this.frameMs);
    this.drewBefore = drew;
    if (drew) fps.last = now;
    // Only frames of a moving camera tell: while tiles come, decoding and uploading are the cost.
    if (!moved || !drew || document.hidden) return;
    if (gap > BRISK_MS) this.sharpness = Math.max(SHARPNESS_LEAST, this.sharpness * 0.8);
    else if (gap < BRISK_MS / 3) this.sharpness = Math.min(1, this.sharpness * 1.1);
    fps.slow = gap > 1000 / SLOW_FPS && gap < 10_000 ? fps.slow + 1 : Math.max(0, fps.slow - 1);
    if (fps.slow === SLOW_FRAMES) this.emit("slow", 1000 / fps.average);
  }

  private report() {
    const ready = this.state.ready;
    if (ready && !this.wasReady) this.emit("ready", this.state);
    this.wasReady = ready;
  }

  dispose() {
    this.closed = true;
    cancelAnimationFrame(this.running);
    this.resizing.disconnect();
    this.stage.dispose();
    this.pictures.stop();
    this.layers.dispose();
    this.overlay.dispose();
    this.city?.dispose();
    this.link.dispose();
    this.surface.remove();
    if (this.positions) this.container.style.position = "";
    this.handlers.clear();
  }
}

export function createViewer(container: HTMLElement, options: ViewerOptions = {}): Viewer {
  return new Viewer(container, options);
}

export { createMapLayer, MapLayer } from "./maplayer";
export type { MapFrame, MapHost, MapLayerEvents, MapLayerOptions, MapLayerState } from "./maplayer";
