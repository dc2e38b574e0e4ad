// The city as a layer of a MapLibre map: drawn into the map's own WebGL context, with the map's camera
// and against the map's depth, so that extrusions and terrain hide it and it hides what comes after.
//
// The state of the context belongs to the map: nothing touches it outside render(), after which MapLibre
// sets all of it anew. Tiles that come in between wait for the next frame.
//
// A map is flat (or a ball) and its heights begin at it; ours are those of the data. The city is one
// rigid body, true in size at its origin.
//
// SPDX-License-Identifier: Apache-2.0
import { Box3, Matrix4, PerspectiveCamera, Ray, Vector3, WebGLRenderer } from "three";

import { City, NO_STATS, type CityStats } from "./city";
import { Events, type Handler } from "./events";
import { Frame, type Place } from "./geo";
import { problemOf, isGone, Link, type LinkState } from "./link";
import type { Network } from "./network";
import { pickMedian } from "./pick";
import { Problem } from "./problem";
import { findScenes, listAppearances, openScene, type Appearance, type SceneEntry, type SceneInfo } from "./source";
import { Tint } from "./tint";

// What createMapLayer() takes.
export interface MapLayerOptions {
  id?: string; // of the layer; default: "citysplat"
  url?: string | URL; // a citysplat server's folder or a tileset.json; default: the page's folder
  scene?: string; // its id; default: the first
  appearance?: string; // default: ""
  // Metres from the map's zero up to that of the data's heights, subtracted from all heights. "ground": the city
  // stands on the map. Default: 0 where the map has terrain, else "ground".
  lower?: number | "ground";
  memoryMb?: number; // for tiles, on the card and in the page together; default 512
  detail?: number; // px that a typical Gaussian may have on the screen; default 1
  fadeMs?: number; // that levels take to fade into each other; 0: they change at once; default 280
}

// West, south, east, north in degrees, as MapLibre's fitBounds() takes them.
export type Bounds = [number, number, number, number];

// Events of a layer, and what comes with each.
export interface MapLayerEvents {
  scene: SceneEntry & { bounds: Bounds }; // opened
  ready: MapLayerState; // all that this view wants is on the screen
  appearance: string; // the new one is asked for or computed, and comes with the next frames
  // Whether the server answers.
  link: LinkState;
  // What went wrong: its kind, words, and the request that the server's log names.
  problem: Problem;
}

// What a layer draws and waits for.
export interface MapLayerState extends Omit<CityStats, "broken"> {
  // All that this view wants is on the screen.
  ready: boolean;
  // The id of the city; null until it is open.
  scene: string | null;
  // The one that is asked for.
  appearance: string;
  // Whether the server answers.
  link: LinkState;
  // Tiles that are wanted and not to be had.
  broken: { name: string; why: string }[];
  // Why no city is open; null: nothing is wrong.
  error: string | null;
}

// What the layer needs of a map, and of what a map says in each frame: MapLibre GL JS 5 and 6 do.
export interface MapHost {
  // The map's own.
  getCanvas(): HTMLCanvasElement;
  // Asks for a frame.
  triggerRepaint(): void;
  // The map's terrain, if it has one.
  getTerrain?(): unknown;
  // Shows the credit; maps without it show none.
  addControl?(control: MapControl, position: "bottom-right"): unknown;
  // Takes the credit away.
  removeControl?(control: MapControl): unknown;
}
// What a map shows at its rim, as MapLibre's IControl.
export interface MapControl {
  // For the map to call.
  onAdd(): HTMLElement;
  // For the map to call.
  onRemove(): void;
}
// What MapLibre hands to a custom layer at each frame, as far as it is used.
export interface MapFrame {
  // Distance of the near plane, in the map's units.
  nearZ: number;
  // Without the place of the camera.
  projectionMatrix: ArrayLike<number>;
  // Of the whole map, flat or a globe.
  defaultProjectionData: {
    // From the unit square or sphere to the screen.
    mainMatrix: ArrayLike<number>;
    // Of the flat map, towards which a globe changes as one comes near.
    fallbackMatrix: ArrayLike<number>;
    // Behind it lies the far side of the globe.
    clippingPlane: ArrayLike<number>;
    projectionTransition: number; // 0: flat, 1: a ball
  };
}

const MEMORY_MB = 512;
const PX_PER_SIGMA = 16; // a tile's geometric error is at most 16 times its typical Gaussian
const RADIUS_M = 6_371_008.8; // MapLibre's Earth is a ball

// East, up, south in metres about a place -> MapLibre's flat world, 1 wide, y to the south, z up.
function flatFrom({ lon, lat }: Place, altitude: number): Matrix4 {
  const p = (lat * Math.PI) / 180;
  const unit = 1 / (2 * Math.PI * RADIUS_M * Math.cos(p));
  const y = 0.5 - Math.atanh(Math.sin(p)) / (2 * Math.PI);
  const [east, up, south] = [new Vector3(1, 0, 0), new Vector3(0, 0, 1), new Vector3(0, 1, 0)];
  return new Matrix4()
    .makeBasis(east, up, south)
    .scale(new Vector3(unit, unit, unit))
    .setPosition((180 + lon) / 360, y, altitude * unit);
}

// The same -> MapLibre's ball of radius 1: y to the north pole, z to the meridian of Greenwich.
function ballFrom({ lon, lat }: Place, altitude: number): Matrix4 {
  const [l, p] = [(lon * Math.PI) / 180, (lat * Math.PI) / 180];
  const up = new Vector3(Math.sin(l) * Math.cos(p), Math.sin(p), Math.cos(l) * Math.cos(p));
  const east = new Vector3(Math.cos(l), 0, -Math.sin(l));
  const south = new Vector3().crossVectors(east, up);
  const at = up.clone().multiplyScalar(1 + altitude / RADIUS_M);
  const size = new Vector3(1, 1, 1).divideScalar(RADIUS_M);
  return new Matrix4().makeBasis(east, up, south).scale(size).setPosition(at);
}

// A city as a custom layer of MapLibre: pass it to addLayer().
export class MapLayer {
  // Of the layer in the map's style.
  readonly id: string;
  // As MapLibre asks of custom layers.
  readonly type = "custom" as const;
  // It shares the depth of the map's other 3-D layers.
  readonly renderingMode = "3d" as const;
  // The city that is open; null until it is.
  scene: SceneEntry | null = null;
  /** @internal */
  info: SceneInfo | null = null;
  private readonly camera = new PerspectiveCamera();
  private readonly events = new Events<MapLayerEvents>();
  private map: MapHost | null = null;
  private link: Link | null = null;
  private city: City | null = null;
  private frame: Frame | null = null;
  private tint: Tint | null = null;
  private core: Box3 | null = null; // where most Gaussians are
  private jobs: (() => void)[] = []; // uploads that wait for the next frame
  private wanted: string; // appearance
  private opening = 0;
  private error: Error | null = null;
  private wasReady = false;
  private refused = false; // this browser does not draw
  private creditNode: HTMLElement | null = null;
  // Whose the city is, beside whose the map is.
  private readonly credit: MapControl = {
    onAdd: () => {
      this.creditNode = document.createElement("div");
      this.creditNode.className = "maplibregl-ctrl maplibregl-ctrl-attrib citysplat-credit";
      this.showCredit();
      return this.creditNode;
    },
    onRemove: () => {
      this.creditNode?.remove();
      this.creditNode = null;
    },
  };

  constructor(private readonly options: MapLayerOptions = {}) {
    this.id = options.id ?? "citysplat";
    this.wanted = options.appearance ?? "";
    this.camera.matrixAutoUpdate = false;
  }

  // ---- events and state ----

  // Calls the handler at each event of this name. Returns a function that ends it.
  on<K extends keyof MapLayerEvents>(name: K, handler: Handler<MapLayerEvents, K>): () => void {
    return this.events.on(name, handler);
  }

  // What it draws and waits for now.
  get state(): MapLayerState {
    const { broken, ...stats } = this.city?.stats() ?? NO_STATS;
    const link = this.link?.state ?? "ok";
    const whole = !stats.heldBack && !broken.length && !this.error && link !== "away";
    return {
      ...stats,
      ready: whole && !this.jobs.length && (this.city?.settled ?? false),
      scene: this.scene?.id ?? null,
      appearance: this.wanted,
      link,
      broken: broken.map(({ name, why }) => ({ name, why })),
      error: this.error ? this.error.message : null,
    };
  }

  // West, south, east, north of the scene in degrees, as fitBounds() takes it; null until it is open.
  get bounds(): Bounds | null {
    const { info, frame } = this;
    if (!info || !frame) return null;
    const { center, half } = info;
    const corner = (east: number, north: number) =>
      frame.placeOf(new Vector3(center.x + east * half.x, center.z, -center.y - north * half.y));
    const [low, high] = [corner(-1, -1), corner(1, 1)];
    return [low.lon, low.lat, high.lon, high.lat];
  }

  // Whose the city is; "" until it is open.
  get attribution(): string {
    return this.info?.attribution ?? "";
  }

  // Where the city is at a point of the map's canvas, in CSS pixels; null where there is none.
  pick(point: { x: number; y: number }): Place | null {
    const { city, frame, camera, map } = this;
    if (!city || !frame || !map) return null;
    const { clientWidth, clientHeight } = map.getCanvas();
    const far = new Vector3((2 * point.x) / clientWidth - 1, 1 - (2 * point.y) / clientHeight, 0.5);
    const ahead = far.unproject(camera).sub(camera.position).normalize();
    const perMetre = 2 / Math.abs(camera.projectionMatrix.elements[5]!) / clientHeight;
    const found = pickMedian(city.engine.visibleBlocks, new Ray(camera.position.clone(), ahead), perMetre);
    return found && frame.placeOf(found);
  }

  // ---- scene and appearance ----

  // The photographs whose light the city can have.
  appearances(): Promise<Appearance[]> {
    const { link, scene, info } = this;
    return link && scene ? listAppearances(link, scene, info?.network ?? null) : Promise.resolve([]);
  }

  // The picture stays as it is until the new one is complete. Where the server offers the network the
  // colours are computed here, and no tile is asked for.
  async setAppearance(appearance: string): Promise<void> {
    const { tint, scene } = this;
    const before = this.wanted;
    this.wanted = appearance;
    if (!scene) return;
    if (!tint) return this.open(scene, true);
    try {
      const image = await tint.network.find(appearance);
      if (tint !== this.tint || this.wanted !== appearance) return;
      tint.set(image, appearance);
      this.events.emit("appearance", appearance);
      this.wake();
    } catch (error) {
      if (this.wanted === appearance) this.wanted = before;
      this.fail(error);
    }
  }

  private async start(link: Link) {
    const url = new URL(this.options.url ?? "./", location.href);
    try {
      link.watch(/\.json$/.test(url.pathname) ? url : new URL("collections", url));
      const scenes = await findScenes(link, url);
      const id = this.options.scene;
      const entry = id === undefined ? scenes[0] : scenes.find((one) => one.id === id);
      if (!entry) throw new Problem(id === undefined ? "noScenes" : "noScene", { id: id ?? "" });
      if (link === this.link) await this.open(entry, false);
    } catch (error) {
      if (link === this.link) this.fail(error);
    }
  }

  // keep: what is drawn stays until the new tiles are complete.
  private async open(entry: SceneEntry, keep: boolean) {
    const { link, city } = this;
    if (!link || !city) return;
    const ticket = ++this.opening;
    this.error = null;
    try {
      const appearance = this.wanted;
      const info = await openScene(link, entry, appearance, (network: Network) => city.canTint(network));
      const image = await info.network?.find(appearance);
      if (ticket !== this.opening || city !== this.city) return;
      const tint = info.network && image ? new Tint(info.network) : null;
      if (image) tint?.set(image, appearance);
      if (!keep || this.info?.revision !== info.revision) this.core = null;
      [this.tint, this.scene, this.info] = [tint, entry, info];
      link.watch(entry.tileset);
      this.frame = new Frame(info.transform);
      city.open(info, this.frame, keep, tint);
      this.showCredit();
      if (keep) this.events.emit("appearance", appearance);
      else this.events.emit("scene", { ...entry, bounds: this.bounds! });
      this.wake();
    } catch (error) {
      if (ticket !== this.opening || city !== this.city) return;
      const name = this.wanted;
      if (keep || !name || !isGone(error)) return this.fail(error);
      this.wanted = ""; // it opens in the default light
      this.events.emit("problem", new Problem("noAppearance", { name }));
      await this.open(entry, false);
    }
  }

  // The server was away: broken tiles are asked for at once, and all of them where it has another
  // revision now.
  private async comeBack() {
    const { link, city, scene, info } = this;
    city?.retry();
    if (!link || !scene || !info) return;
    const now = (await link.json(scene.tileset).catch(() => null)) as { asset?: { tilesetVersion?: string } } | null;
    const revision = now?.asset?.tilesetVersion ?? "";
    if (now && info === this.info && revision !== info.revision) await this.open(scene, true);
  }

  private fail(error: unknown) {
    if (error instanceof DOMException && error.name === "AbortError") return;
    const problem = problemOf(error);
    this.error = problem;
    this.events.emit("problem", problem);
  }

  private showCredit() {
    if (!this.creditNode) return;
    this.creditNode.textContent = this.attribution;
    this.creditNode.hidden = !this.attribution;
  }

  // ---- as MapLibre calls it ----

  // For MapLibre to call.
  onAdd(map: MapHost) {
    this.map = map;
    map.addControl?.(this.credit, "bottom-right");
    this.wake();
  }

  // For MapLibre to call.
  onRemove() {
    this.opening++;
    this.map?.removeControl?.(this.credit);
    this.jobs = [];
    this.city?.dispose();
    this.link?.dispose();
    [this.map, this.city, this.link, this.tint, this.frame] = [null, null, null, null, null];
    [this.scene, this.info, this.core, this.wasReady] = [null, null, null, false];
  }

  // For MapLibre to call.
  render(gl: WebGL2RenderingContext, view: MapFrame) {
    if (!this.map) return;
    const city = this.city ?? this.tryBegin(gl);
    if (!city) return;
    city.renderer.resetState();
    for (const run of this.jobs.splice(0)) run();
    if (this.follow(view)) {
      city.resize(gl.drawingBufferWidth, gl.drawingBufferHeight, 1);
      city.draw();
    }
    const { state } = this;
    if (state.ready && !this.wasReady) this.events.emit("ready", state);
    this.wasReady = state.ready;
  }

  // null where the browser cannot draw it; told once.
  private tryBegin(gl: WebGL2RenderingContext): City | null {
    if (this.refused) return null;
    try {
      return this.begin(gl);
    } catch (error) {
      this.refuse(error);
      return null;
    }
  }

  private refuse(error: unknown) {
    this.refused = true;
    const why = error instanceof Error ? error.message : String(error);
    const problem = new Problem("no3d", { why });
    console.warn(`citysplat: ${problem.message}`);
    this.fail(problem);
  }

  // The canvas of the renderer is none that is seen: its size is all that is used of it.
  private begin(gl: WebGL2RenderingContext): City {
    const canvas = document.createElement("canvas");
    const renderer = new WebGLRenderer({ canvas, context: gl });
    const bytes = (this.options.memoryMb ?? MEMORY_MB) * 2 ** 20;
    const link = new Link();
    const city = new City(renderer, this.camera, link, bytes);
    city.backdrop.visible = false;
    city.errorTarget = PX_PER_SIGMA * (this.options.detail ?? 1);
    city.fadeMs = this.options.fadeMs ?? city.fadeMs;
    city.onWake = () => this.wake();
    city.onCore = ({ box }) => (this.core = box);
    city.onFailure = (error) => this.fail(error);
    city.onStopped = (error) => this.refuse(error);
    city.onCard = (run) => this.atNextFrame(run);
    link.onState = (state, before) => {
      this.events.emit("link", state);
      if (before === "away") void this.comeBack();
      this.wake();
    };
    [this.city, this.link] = [city, link];
    void this.start(link);
    return city;
  }

  private wake() {
    this.map?.triggerRepaint();
  }

  private atNextFrame(run: () => void): Promise<void> {
    this.wake();
    return new Promise((resolve, reject) => {
      this.jobs.push(() => {
        try {
          resolve(run());
        } catch (error) {
          reject(error as Error);
        }
      });
    });
  }

  // ---- the map's camera ----

  private get lower(): number {
    const { lower = this.map?.getTerrain?.() ? 0 : "ground" } = this.options;
    if (lower !== "ground") return lower;
    const { frame, info, core } = this;
    const ground = core ? core.min.y : info!.center.z - info!.half.z;
    return frame!.placeOf(new Vector3()).h + ground;
  }

  // The city's metres -> what is on the screen; null where it is beyond the horizon.
  private clipFrom(view: MapFrame["defaultProjectionData"], frame: Frame): Matrix4 | null {
    const origin = frame.placeOf(new Vector3());
    const altitude = origin.h - this.lower;
    const share = view.projectionTransition; // a map that becomes a ball is drawn between both
    const main = new Matrix4().fromArray(view.mainMatrix);
    if (share <= 0) return main.multiply(flatFrom(origin, altitude));
    const ball = ballFrom(origin, altitude);
    const [a = 0, b = 0, c = 0, d = 0] = Array.from(view.clippingPlane);
    const { x, y, z } = new Vector3().setFromMatrixPosition(ball);
    if (a * x + b * y + c * z + d < 0) return null;
    main.multiply(ball);
    const flat = new Matrix4().fromArray(view.fallbackMatrix).multiply(flatFrom(origin, altitude));
    return main.multiplyScalar(share).fromArray(
      main.elements.map((value, i) => value + (1 - share) * flat.elements[i]!),
    );
  }

  // Sets the camera to that of the map; false where nothing is to be seen of the city.
  private follow({ projectionMatrix, nearZ, defaultProjectionData }: MapFrame): boolean {
    const { frame, camera } = this;
    const clip = frame && this.clipFrom(defaultProjectionData, frame);
    if (!clip) return false;
    // Seen from the camera, in the map's own unit, which has some length in metres.
    const projection = new Matrix4().fromArray(projectionMatrix);
    const seen = clip.premultiply(projection.clone().invert());
    const unit = Math.cbrt(seen.determinant());
    if (!(unit > 0)) return false;
    seen.premultiply(new Matrix4().makeScale(1 / unit, 1 / unit, 1 / unit));
    camera.matrix.copy(seen).invert();
    camera.matrix.decompose(camera.position, camera.quaternion, camera.scale);
    camera.matrix.compose(camera.position, camera.quaternion, camera.scale.set(1, 1, 1));
    projection.elements[14]! /= unit;
    camera.projectionMatrix.copy(projection);
    camera.projectionMatrixInverse.copy(projection).invert();
    camera.near = nearZ / unit;
    camera.updateMatrixWorld(true);
    return true;
  }
}

// For map.addLayer() of MapLibre GL JS 5 or 6.
export function createMapLayer(options: MapLayerOptions = {}): MapLayer {
  return new MapLayer(options);
}
