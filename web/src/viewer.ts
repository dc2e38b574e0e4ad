// The viewer that others put into their pages: a container, a URL, a camera, events. The page of
// this folder is one of its users.
//
// SPDX-License-Identifier: Apache-2.0
import type { Box3 } from "three";

import type { Block } from "./block";
import { City, NO_STATS, type CityStats } from "./city";
import { Clicks } from "./clicks";
import { decodeOnce } from "./core";
import { Events, type Handler } from "./events";
import type { Area } from "./free";
import { extentOf, type Extent } from "./extent";
import { Frame, type Place, type Pose } from "./geo";
import { Layers } from "./layers";
import { Link, problemOf, type LinkState } from "./link";
import { Opening } from "./opening";
import { Overlay } from "./overlay";
import { Pace } from "./pace";
import { Pictures } from "./pictures";
import type { Walk } from "./pose";
import { Probe } from "./probe";
import { Problem } from "./problem";
import { Waits } from "./progress";
import { Scenes, type Opened, type SceneHost } from "./scenes";
import type { ShotOptions } from "./shot";
import {
  askPlace,
  creditOf,
  findMapTiles,
  isTileAddress,
  listAppearances,
  pictureUrl,
  type Appearance,
  type Basemap,
  type MapTiles,
  type SceneEntry,
  type SceneInfo,
} from "./source";
import { seesAny } from "./sight";
import { Stage } from "./stage";
import { Surface } from "./surface";
import { TOUCH } from "./touch";
import { Turns } from "./turns";
import type { Mode, Progress, ViewerEvents, ViewerOptions, ViewerState } from "./types";

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
export type { Mode, Progress, ViewerEvents, ViewerOptions, ViewerState } from "./types";
export { Problem, type ProblemKind } from "./problem";

const MEMORY_MB = TOUCH ? 384 : 1536;
const PIXEL_RATIO_MAX = TOUCH ? 1.5 : 2;
const PX_PER_SIGMA = 16; // a tile's geometric error is at most 16 times its typical Gaussian
const LOOK_MS = 100; // between two looks at what is on its way, while nothing happens
const PAD_MS = 50; // at a gamepad that is not touched

// The viewer in a container of a page.
export class Viewer {
  readonly surface: HTMLElement; // takes pointer and keys
  // What it draws on.
  readonly canvas: HTMLCanvasElement;
  /** @internal */
  readonly stage: Stage;
  // Lines, areas and points of the page over the city.
  readonly overlay: Overlay;
  // Data of others in the city: GeoJSON, models, tiles.
  readonly layers: Layers;
  private readonly nodes: Surface; // in the container
  private readonly opening: Opening;
  private readonly probe: Probe;
  private readonly clicks = new Clicks();
  private readonly turns = new Turns((now, seconds) => this.turn(now, seconds));
  private readonly link = new Link();
  private readonly pictures: Pictures;
  private readonly pace = new Pace();
  private readonly waits = new Waits();
  private readonly book: Scenes; // which scene is open and in which light
  private readonly events = new Events<ViewerEvents>();
  private city: City | null = null;
  private currentMode: Mode = "splats";
  private shownAppearance = "";
  private error: Error | null = null;
  private wasReady = false;
  private looked = false; // for the city in this view, since it came to rest
  private sight = true;
  private without3d = ""; // why this browser does not draw
  private moving = false;
  private closed = false;
  private readonly listening = new AbortController();
  private readonly resizing: ResizeObserver;
  private map: Basemap | null = null; // on the ground
  private theme: "dark" | "light";
  private memoryMost: number; // MB

  constructor(
    // The element that it fills.
    readonly container: HTMLElement,
    private readonly options: ViewerOptions = {},
  ) {
    this.theme = options.theme ?? "light";
    this.memoryMost = options.memoryMb ?? MEMORY_MB;
    this.nodes = new Surface(container);
    this.surface = this.nodes.node;
    this.canvas = this.nodes.canvas;
    this.nodes.setTheme(this.theme);
    this.book = this.makeBook();
    this.stage = new Stage(this.surface);
    this.stage.keyboard = options.keyboard ?? true;
    this.stage.onMove = () => this.wake();
    this.opening = new Opening(this.surface, this.stage, options);
    this.opening.onGone = () => this.wake(false);
    this.stage.onTouch = () => {
      this.opening.touch();
      this.events.emit("touch", null);
    };
    this.probe = new Probe(this.surface, this.stage, () => this.city);
    this.stage.surfaceOn = (ray) => this.probe.surfaceOn(ray);
    this.stage.onClick = (x, y) => void this.clicks.tell(x, y, this.placeAt(x, y));
    this.stage.onUnclick = () => this.clicks.takeBack();
    this.clicks.onClick = (x, y, place) => this.events.emit("click", { x, y, place });
    this.clicks.onUnclick = () => this.events.emit("unclick", null);
    this.stage.onWalk = (how) => this.events.emit("walk", how);
    this.overlay = new Overlay(this.surface, this.stage);
    this.overlay.onWake = () => this.wake();
    this.layers = new Layers(this.stage, this.overlay, (place) => this.heightOf(place));
    this.probe.layers = this.layers;
    this.layers.onWake = () => this.wake();
    this.layers.onChange = () => {
      this.events.emit("layers", this.layers.list);
      this.wake();
    };
    this.pictures = new Pictures(this.nodes.pictures, this.link, true);
    this.pictures.onPicture = (info) => {
      this.wake(false);
      this.shownAppearance = this.book.appearance;
      this.error = null;
      if (!info.moving) this.opening.unveil(true); // the same, and larger
      this.events.emit("picture", info);
    };
    this.pictures.onProblem = (error) => this.fail(error);
    this.pictures.onNoVideo = (why) => this.events.emit("problem", new Problem("noVideo", { why }));
    this.link.onState = (state, before) => {
      this.events.emit("link", state);
      if (before === "away") this.comeBack();
      else if (state === "away" && !this.scene) this.tell(new Problem("noAnswer", { url: this.book.urls[0]?.href ?? "" }));
      this.wake();
    };
    this.startDrawing(options.mode ?? "auto");
    this.setBasemap(options.basemap ?? null);
    this.resizing = new ResizeObserver(() => this.resize());
    this.resizing.observe(container);
    this.resize();
    this.listen();
    this.wake();
    void this.book.start();
  }

  private makeBook(): Scenes {
    const host: SceneHost = {
      closed: () => this.closed,
      city: () => this.city,
      shown: () => this.shownAppearance,
      show: (entry, info, how) => this.show(entry, info, how),
      renew: (info) => this.city?.open(info, this.stage.frame, true, this.book.tint),
      recolour: (appearance, change) => this.recolour(appearance, change),
      split: (share) => this.splitAt(share),
      fail: (error) => this.fail(error),
      tell: (problem) => this.tell(problem),
      clearProblem: () => this.clearProblem(),
    };
    return new Scenes(host, this.link, this.options);
  }

  // The cities of the server.
  get scenes(): readonly SceneEntry[] {
    return this.book.all;
  }

  // The city that is open; null until it is.
  get scene(): SceneEntry | null {
    return this.book.entry;
  }

  /** @internal */
  get info(): SceneInfo | null {
    return this.book.info;
  }

  // ---- events ----

  // Calls the handler at each event of this name. Returns a function that ends it.
  on<K extends keyof ViewerEvents>(name: K, handler: Handler<ViewerEvents, K>): () => void {
    return this.events.on(name, handler);
  }

  // ---- what it is doing ----

  // What it draws and waits for now.
  get state(): ViewerState {
    const drawn = this.currentMode === "splats";
    const stats = (drawn && this.city?.stats()) || NO_STATS;
    const settled = this.isSettled();
    return {
      ready: settled && !stats.heldBack && !stats.broken.length && !this.error && this.link.state !== "away",
      settled,
      // Who draws: this browser (splats), or the server (pictures).
      mode: this.currentMode,
      link: this.link.state,
      scene: this.scene?.id ?? null,
      appearance: this.shownAppearance,
      wanted: this.book.appearance,
      tiles: stats.tiles,
      gaussians: stats.gaussians,
      bytes: stats.bytes,
      received: this.link.received,
      pending: drawn ? stats.pending : Number(this.pictures.pending),
      memory: stats.memory,
      heldBack: stats.heldBack,
      broken: stats.broken.map(({ name, why }) => ({ name, why })),
      error: this.error ? this.error.message : null,
      framesPerSecond: this.pace.framesPerSecond,
      progress: this.progress(stats),
    };
  }

  private progress(stats: CityStats): Progress | null {
    const { book, link } = this;
    return this.waits.progress({
      stats,
      received: link.received,
      scenes: book.all.length,
      open: book.entry !== null,
      failed: this.error !== null,
      describing: book.busy,
      relighting: book.appearance !== this.shownAppearance && book.info !== null,
      picture: this.currentMode === "pictures" ? this.pictures.pending : null,
      changing: this.city?.changing ?? false,
      layers: this.layers.list,
    });
  }

  private isSettled(): boolean {
    return this.isWhole() && !this.opening.covers;
  }

  // What is below the poster.
  private isWhole(): boolean {
    if (this.moving || this.pace.restless || !this.info) return false;
    if (this.currentMode === "pictures") return this.pictures.settled;
    return this.city?.settled ?? false;
  }

  // ---- the camera ----

  // Where the camera stands and looks.
  get pose(): Pose {
    return this.stage.pose();
  }

  // Puts the camera there at once.
  lookAt(pose: Pose) {
    this.opening.touch();
    this.stage.look(pose);
  }

  // Moves there in some seconds; resolves on arrival or when a person takes over.
  flyTo(pose: Pose, seconds?: number): Promise<void> {
    this.opening.touch();
    if (this.stage.walk === "walk") this.stage.stand(); // over the roofs, no longer on foot
    return this.stage.fly(pose, seconds);
  }

  // Flies to where the whole city is in sight.
  home() {
    this.opening.home();
  }

  /** @internal */
  // Parts of the surface may be covered: home is in what is free. Again, where nobody has moved the camera.
  fitInto(free: () => Area) {
    this.stage.free = free;
    this.opening.frameAgain();
    this.wake(); // notes make way
  }

  /** @internal */
  // A picture of the server stands before ours, or is on its way.
  get hasPoster(): boolean {
    return this.opening.hasPoster;
  }

  // Where the city is at a point of the container, in CSS pixels from its corner; null for the sky.
  pick(x: number, y: number): Place | null {
    return this.probe.pick(x, y);
  }

  // Where the server draws it also knows what is there.
  private placeAt(x: number, y: number): Place | null | Promise<Place | null> {
    const { clientWidth: width, clientHeight: height } = this.surface;
    if (this.currentMode !== "pictures" || !this.scene?.questions) return this.pick(x, y);
    return askPlace(this.link, this.scene, this.pose, { x, y, width, height }).catch(() => null);
  }

  // The height of what is drawn at a place, seen from straight above; null where there is nothing.
  heightOf(place: Pick<Place, "lon" | "lat">): number | null {
    return this.probe.heightOf(place);
  }

  // How high a place is above the ground there, roughly: that of the surroundings, below roofs. null where it is not known.
  aboveGround(place: Place): number | null {
    return this.probe.aboveGround(place);
  }

  /** @internal */
  // What is drawn here; nothing where the server draws.
  get blocks(): readonly Block[] {
    return (this.currentMode === "splats" && this.city?.engine.visibleBlocks) || [];
  }

  // ---- scenes and appearance ----

  // Opens a city by its id, in a view and a light where these are given.
  async openScene(id: string, pose: Pose | null = null, appearance = ""): Promise<void> {
    const entry = this.scenes.find((one) => one.id === id);
    if (!entry) return this.fail(new Problem("noScene", { id }));
    this.book.appearance = appearance;
    await this.book.open(entry, pose, false);
  }

  // The picture stays as it is until the new one is complete. Where the colours are computed here
  // that is the next frame, and no tile is asked for.
  setAppearance(appearance: string): Promise<void> {
    return this.book.setAppearance(appearance);
  }

  // Roughly where frames take long; the exact picture follows.
  private recolour(appearance: string, change: () => void) {
    const rough = this.pace.takesLong && (this.city?.showRoughly(change) ?? false);
    if (!rough) change();
    if (rough) {
      this.pace.showedRough();
      this.events.emit("preview", appearance);
    } else this.pace.mix();
    this.turns.run(); // the loop may rest
  }

  // Photographs are listed with time, pose and thumbnail where the server knows them.
  appearances(entry = this.scene): Promise<Appearance[]> {
    if (!entry) return Promise.resolve([]);
    const network = entry === this.scene ? (this.info?.network ?? null) : null;
    return listAppearances(this.link, entry, network);
  }

  // Another appearance right of a part of the width; null: one alone. Needs colours that are computed
  // here. One that is not there is a problem like any other, and leaves what is shown.
  setSecondAppearance(appearance: string | null, share = 0.5): Promise<void> {
    return this.book.setSecond(appearance, share);
  }

  // The appearance right of the line; null: there is none.
  get secondAppearance(): string | null {
    return this.book.tint?.names[1] ?? null;
  }

  // The line between the two, as a part of the width; null: none.
  splitAt(share: number | null) {
    const wanted = this.secondAppearance === null ? null : share;
    if (!this.city || (wanted === null && this.city.split === null)) return;
    this.city.split = wanted;
    this.pace.mix();
    this.turns.run(); // the loop may rest
  }

  // Something of the scene is on the screen.
  get hasPicture(): boolean {
    return this.currentMode === "pictures" ? this.pictures.drawn > 0 : (this.city?.shows ?? false);
  }

  // Of the camera, in metres.
  get heightAboveGround(): number {
    return this.stage.camera.position.y - this.stage.extent.min.y;
  }

  // Map tiles of the scene, seen from straight above; null where the server has none.
  async mapTiles(): Promise<MapTiles | null> {
    return this.scene ? findMapTiles(this.link, this.scene).catch(() => null) : null;
  }

  // Bytes of the server; waits while it is away.
  get(url: string | URL, signal: AbortSignal | null = null): Promise<ArrayBuffer> {
    return this.link.bytes(url, signal);
  }

  // Whether an appearance is a matter of this browser alone.
  get computesColours(): boolean {
    return this.book.tint !== null;
  }

  private show(entry: SceneEntry, info: SceneInfo, how: Opened) {
    const { stage, city } = this;
    if (!how.keep) {
      const before = how.same ? stage.pose() : how.pose;
      stage.frame = new Frame(info.transform);
      this.opening.homeless = true;
      this.setExtent(extentOf(info, stage.frame));
      this.opening.begin(entry, this.book.appearance, before, how.same, this.currentMode === "splats");
      this.overlay.reset();
      this.layers.reset();
      this.pictures.retry();
    }
    city?.open(info, stage.frame, how.keep, this.book.tint);
    this.showCredit();
    if (!city) void this.findCore(info);
    this.events.emit("scene", entry);
    this.wake();
  }

  private comeBack() {
    this.pictures.retry();
    this.city?.retry();
    void this.book.comeBack();
  }

  // Without a card the coarsest tile is read for the extent alone, so that home is the same.
  private async findCore(info: SceneInfo) {
    const core = await decodeOnce(this.link, info, this.stage.frame).catch(() => null);
    if (core && info === this.info) this.setCore(core);
  }

  private setCore({ box, corners }: Extent) {
    this.setExtent(box);
    this.stage.outline = corners;
    this.layers.reset();
    this.opening.homeless = false;
    this.opening.frameAgain();
  }

  private setExtent(box: Box3) {
    this.stage.setExtent(box);
    this.city?.backdrop.setExtent(box);
  }

  private fail(error: unknown) {
    if (this.closed || (error instanceof DOMException && error.name === "AbortError")) return;
    if (!this.scene) this.opening.unveil(true);
    const problem = problemOf(error);
    this.error = problem;
    this.events.emit("problem", problem);
    this.wake();
  }

  // A problem that leaves the viewer something to do; after the caller's turn, in which it adds its handlers.
  private tell(problem: Problem) {
    console.warn(`citysplat: ${problem.message}`);
    queueMicrotask(() => this.closed || this.events.emit("problem", problem));
  }

  private clearProblem() {
    this.error = null;
    this.wake(false);
  }

  // Asks again for what failed.
  retry() {
    const none = !this.scene;
    this.clearProblem();
    this.link.tryNow();
    this.city?.retry();
    this.pictures.retry();
    if (none) void this.book.start();
    else if (this.book.appearance !== this.shownAppearance) void this.book.open(this.scene!, null, true);
    this.wake();
  }

  // ---- drawing ----

  // Who draws: this browser (splats), or the server (pictures).
  get mode(): Mode {
    return this.currentMode;
  }

  // Whether the server draws pictures of this scene.
  async canDrawPictures(): Promise<boolean> {
    const url = this.serverPicture(64, 48);
    return url !== null && fetch(url).then(({ ok }) => ok).catch(() => false);
  }

  // Changes who draws.
  setMode(mode: Mode) {
    if (mode === this.currentMode) return;
    if (mode === "splats" && !this.city && !this.startCity()) return;
    this.currentMode = mode;
    this.nodes.pictures.hidden = mode !== "pictures";
    if (mode === "splats") this.pictures.stop();
    else this.stage.stand();
    this.pace.forgive();
    this.events.emit("mode", mode);
    this.wake();
  }

  // Pixels that a typical Gaussian may have on the screen; more is coarser.
  set detail(px: number) {
    if (this.city) this.city.errorTarget = PX_PER_SIGMA * px;
  }

  // Sky and ground around the city.
  get backdrop(): boolean {
    return this.city?.backdrop.visible ?? false;
  }

  set backdrop(on: boolean) {
    if (this.city) this.city.backdrop.visible = on;
    this.wake();
  }

  // Map tiles of somebody else on the ground around the city, which tells them what is looked at; null: none. Their credit
  // is shown.
  setBasemap(basemap: Basemap | null) {
    const wrong = basemap !== null && !isTileAddress(basemap.tiles);
    if (wrong) this.tell(new Problem("badBasemap", { tiles: basemap.tiles, z: "{z}", x: "{x}", y: "{y}" }));
    this.map = wrong ? null : basemap;
    this.showCredit();
    if (this.city) this.city.basemap = this.map?.tiles ?? "";
    this.wake();
  }

  // Whom the map on the ground is of; "": there is none.
  get basemapCredit(): string {
    return this.map ? creditOf(this.map) : "";
  }

  // Whose the city is, and the map.
  private showCredit() {
    this.nodes.setCredit([this.info?.attribution, this.basemapCredit].filter(Boolean).join(" · "));
  }

  // dark: a dimmed sky.
  setTheme(theme: "dark" | "light") {
    this.theme = theme;
    this.nodes.setTheme(theme);
    this.city?.backdrop.setTheme(theme);
    this.wake();
  }

  // For tiles, on the card and in the page together.
  set memoryMb(megabytes: number) {
    this.memoryMost = megabytes;
    this.city?.setMemory(megabytes * 2 ** 20);
  }

  // The picture on the screen as a PNG.
  async snapshot(): Promise<Blob> {
    const canvas = this.currentMode === "splats" ? this.canvas : this.nodes.pictures;
    if (this.currentMode === "splats") this.city?.redraw();
    return new Promise((resolve, reject) =>
      canvas.toBlob((blob) => (blob ? resolve(blob) : reject(new Error("no picture"))), "image/png"),
    );
  }

  // The view at any size, drawn by the server (in parts where it draws smaller ones only) or, where there
  // is none, by this browser. Rejects with why not.
  async screenshot(options: ShotOptions): Promise<Blob> {
    const { takeShot } = await import("./shot");
    const { scene, stage, city, canvas } = this;
    return takeShot({ scene, camera: stage.camera, city, canvas, appearance: this.book.appearance }, options);
  }

  // The view as the server draws it, at any size that it takes.
  serverPicture(width: number, height: number): URL | null {
    return this.scene?.pictures
      ? pictureUrl(this.scene, this.book.appearance, this.pose, width, height)
      : null;
  }

  // Another scene of the same server in a container of the caller's, as this one is looked at now. The
  // caller has it follow, and disposes of it.
  beside(container: HTMLElement, scene: string): Viewer {
    const { options, pose, theme } = this;
    const memoryMb = this.memoryMost / 2;
    const backdrop = this.city?.backdrop.visible ?? true;
    const own = { mode: "splats", scene, pose, theme, backdrop, memoryMb, appearance: "", keyboard: false, poster: "" } as const;
    return new Viewer(container, { ...options, ...own });
  }

  // Another viewer beside this one has the other half of the memory for tiles.
  shareMemory(on: boolean) {
    this.city?.setMemory((this.memoryMost * 2 ** 20) / (on ? 2 : 1));
  }

  // The server's drawing of this view on a canvas of the caller's, for comparing.
  /** @internal */
  comparison(canvas: HTMLCanvasElement): Pictures {
    return new Pictures(canvas, this.link, false);
  }

  // What a picture of the server would show of this view.
  get wantedView(): { entry: SceneEntry | null; appearance: string; width: number; height: number } {
    const { clientWidth: width, clientHeight: height } = this.surface;
    return { entry: this.scene, appearance: this.book.appearance, width, height };
  }

  private startDrawing(mode: Mode | "auto") {
    if (mode !== "pictures" && this.startCity()) return;
    this.currentMode = "pictures";
    this.nodes.pictures.hidden = false;
  }

  private startCity(): boolean {
    try {
      this.city = new City(this.canvas, this.stage.camera, this.link, this.memoryMost * 2 ** 20);
    } catch (error) {
      this.missOut(error);
      return false;
    }
    const { city } = this;
    this.canvas.style.visibility = "hidden"; // until something of the city is on it
    city.onStopped = (error) => this.giveUp(city, error);
    city.onWake = (draw) => this.wake(draw);
    city.onCore = (core) => this.setCore(core);
    city.onContext = (lost) => {
      this.events.emit("context", lost);
      this.wake();
    };
    city.onFailure = (error) => this.fail(error);
    city.errorTarget = PX_PER_SIGMA * (this.options.detail ?? 1);
    city.fadeMs = this.options.fadeMs ?? city.fadeMs;
    city.backdrop.visible = this.options.backdrop ?? true;
    city.backdrop.setTheme(this.theme);
    city.basemap = this.map?.tiles ?? "";
    city.setOverlay(this.overlay, this.layers);
    this.resize();
    if (this.info && this.scene) {
      city.backdrop.setExtent(this.stage.extent);
      void this.book.open(this.scene, null, false);
    }
    return true;
  }

  private missOut(error: unknown) {
    this.without3d = error instanceof Error ? error.message : String(error);
    this.tell(new Problem("no3d", { why: this.without3d }));
  }

  // It had started, and cannot go on: the server's pictures are what is left.
  private giveUp(city: City, error: Error) {
    if (city !== this.city || this.closed) return;
    this.city = null;
    city.dispose();
    this.missOut(error);
    this.setMode("pictures");
  }

  private wake(draw = true) {
    this.pace.wake(draw);
    this.turns.run();
  }

  private resize() {
    const { clientWidth: width, clientHeight: height } = this.surface;
    if (!width || !height) return;
    this.sharpen(1);
    this.overlay.resize(width, height);
    this.stage.resize(width, height);
    this.opening.resize();
  }

  private turn(now: number, seconds: number): number | null {
    const moved = this.stage.tick(seconds);
    if (moved) this.events.emit("move", this.pose);
    this.moving = moved;
    if (this.currentMode === "pictures") this.drawPictures(now, moved);
    else this.drawCity(now, moved);
    this.report();
    this.events.emit("turn", null);
    return this.untilNext();
  }

  private untilNext(): number | null {
    const { stage, pace, city } = this;
    const drawing = this.currentMode === "splats" && (city?.clock.busy ?? false);
    if (this.moving || stage.moves || pace.awake || pace.restless || drawing) return 0;
    const coming = this.info !== null && !this.isSettled();
    return coming ? LOOK_MS : stage.hasPad ? PAD_MS : null;
  }

  private listen() {
    const { signal } = this.listening;
    window.addEventListener("gamepadconnected", () => this.wake(false), { signal });
    const look = () => (document.hidden ? this.pictures.pause() : this.pictures.retry());
    document.addEventListener("visibilitychange", look, { signal });
  }

  private drawPictures(now: number, moved: boolean) {
    this.pace.turn(now, moved);
    const { entry, appearance, width, height } = this.wantedView;
    if (!entry || !this.info || document.hidden) return;
    if (!entry.pictures) {
      if (!this.error) this.fail(new Problem(this.without3d ? "nothingDraws" : "noPictures", { why: this.without3d }));
      return;
    }
    this.pictures.want(entry, appearance, this.pose, width, height, moved);
    if (this.pace.awake) {
      this.overlay.update();
      this.events.emit("frame", null);
    }
  }

  // Without a change of the picture only tiles are chosen: drawing is what costs.
  private drawCity(now: number, moved: boolean) {
    const { city, pace } = this;
    if (!city || pace.waits(now, moved)) return;
    const took = city.clock.poll();
    if (took !== null) pace.took(took);
    city.keepsPictures = this.book.tint !== null;
    city.takesLong = pace.takesLong;
    city.frameMs = pace.frameMs;
    // At rest a frame at a time: what comes meanwhile must not wait for more than one.
    const busy = city.clock.busy && pace.takesLong && !moved;
    const turn = pace.turn(now, moved, busy);
    if (turn.draw) {
      this.sharpen(turn.sharpness);
      city.draw();
      if (city.shows || this.isWhole()) this.canvas.style.visibility = "";
      this.overlay.update();
      this.events.emit("frame", null);
    } else if (turn.look || (!city.settled && this.info !== null)) city.choose();
    if (!city.changing) this.tellAppearance();
    const fps = pace.measure(now, turn);
    if (fps !== null) this.events.emit("slow", fps);
  }

  // How many of the pixels are drawn, a side.
  private sharpen(share: number) {
    const { clientWidth: width, clientHeight: height } = this.surface;
    if (!width || !height) return;
    this.city?.resize(width, height, share * Math.min(devicePixelRatio, PIXEL_RATIO_MAX));
  }

  private tellAppearance() {
    const { tint, appearance } = this.book;
    const now = tint ? tint.names[0] : appearance;
    if (this.shownAppearance === now || !(tint ? this.city?.shows : this.city?.settled)) return;
    this.shownAppearance = now;
    this.events.emit("appearance", this.shownAppearance);
  }

  private report() {
    if (this.isWhole()) this.opening.unveil(false);
    this.lookForCity();
    const ready = this.state.ready;
    if (ready && !this.wasReady) this.events.emit("ready", this.state);
    this.wasReady = ready;
  }

  // Once a view is whole: whether anything of the city is in it.
  private lookForCity() {
    const whole = this.isWhole();
    if (whole && !this.looked) {
      const { stage, surface } = this;
      const sight = seesAny(stage.camera, stage.extent, surface.clientHeight, this.blocks);
      if (sight !== this.sight) this.events.emit("sight", sight);
      this.sight = sight;
    }
    this.looked = whole;
  }

  // Ends it, and frees memory and the graphics card.
  dispose() {
    this.closed = true;
    this.opening.unveil(true);
    this.turns.end();
    this.listening.abort();
    this.resizing.disconnect();
    this.stage.dispose();
    this.pictures.stop();
    this.layers.dispose();
    this.overlay.dispose();
    this.city?.dispose();
    this.link.dispose();
    this.nodes.remove();
    this.events.clear();
  }
}

// Puts a viewer into a container, which keeps what else it holds.
export function createViewer(container: HTMLElement, options: ViewerOptions = {}): Viewer {
  return new Viewer(container, options);
}
