// Layers of others over the city: GeoJSON, models (glTF) and 3D Tiles, by address or from a file. What
// comes is hostile until it was checked; what fails is kept in the list with the reason.
//
// SPDX-License-Identifier: Apache-2.0
import { Box3, DirectionalLight, Group, HemisphereLight, Raycaster, Sphere, Vector3, type Ray } from "three";

import { Drape } from "./drape";
import type { Place } from "./geo";
import { isGeoJson, parseGeoJson, type GeoShape } from "./geojson";
import type { ForeignTiles, Model } from "./models";
import type { Overlay, Shape } from "./overlay";
import type { Stage } from "./stage";
import { text } from "./strings";

const FILE_MAX = 128 * 2 ** 20;
const GEOJSON_MAX = 32 * 2 ** 20;
const LAYERS_MAX = 32;
const LABELS_MAX = 200; // of a draped layer: each costs a look from above
const ANSWER_MS = 30_000;
const SCALE_MAX = 1e4;

// Where a model without coordinates of its own stands: the place of its origin, and its turn.
export interface ModelPlace extends Place {
  // Degrees, clockwise from north.
  heading: number;
  // Of the model's own metres.
  scale: number;
}
// What add() takes.
export interface LayerOptions {
  // Address of the file.
  url?: string | URL;
  file?: File; // instead of the address
  // For people; default: the file's.
  name?: string;
  // Default true.
  visible?: boolean;
  drape?: boolean; // GeoJSON; default: what has no heights
  up?: number; // metres to raise it by, where its heights count from something else than the scene's
  place?: ModelPlace; // of a model; default: what is in the middle of the picture
}
// What a layer is made of.
export type LayerKind = "geojson" | "model" | "tiles";
// Data of others in the city.
export interface Layer {
  // Made by add().
  readonly id: number;
  // For people.
  readonly name: string;
  readonly url: string | null; // null: from a file
  readonly kind: LayerKind | null; // null: not known yet
  // Whether it is there.
  readonly state: "loading" | "shown" | "failed";
  readonly why: string; // it failed
  // It is drawn.
  readonly visible: boolean;
  readonly drape: boolean | null; // null: not GeoJSON
  // Metres by which it is raised.
  readonly up: number;
  readonly place: ModelPlace | null; // null: has coordinates of its own
}

// What change() may change.
export type LayerChange = Partial<Pick<Layer, "visible" | "up"> & { drape: boolean; place: ModelPlace }>;

// Why a layer is not there, for the person at the screen.
export class LayerError extends Error {}

interface Entry {
  layer: { -readonly [K in keyof Layer]: Layer[K] };
  options: LayerOptions;
  stop: AbortController;
  shapes: GeoShape[];
  ids: number[]; // of what it has in the overlay
  model: Model | null;
  tiles: ForeignTiles | null;
}

function nameOf({ name, file, url }: LayerOptions): string {
  if (name) return name.slice(0, 80);
  if (file) return file.name;
  const { pathname, host } = new URL(url!, location.href);
  const parts = pathname.split("/").filter(Boolean);
  const last = parts.at(-1) ?? host;
  const own = /^tileset\.json$/i.test(last) ? (parts.at(-2) ?? host) : last;
  try {
    return decodeURIComponent(own);
  } catch {
    return own;
  }
}

async function readAll(response: Response, most: number): Promise<ArrayBuffer> {
  const parts: Uint8Array<ArrayBuffer>[] = [];
  let length = 0;
  const reader = response.body!.getReader();
  for (let part = await reader.read(); !part.done; part = await reader.read()) {
    length += part.value.length;
    if (length > most) {
      void reader.cancel();
      throw new LayerError(text("layer.large", { mb: most / 2 ** 20 }));
    }
    parts.push(part.value as Uint8Array<ArrayBuffer>);
  }
  return new Blob(parts).arrayBuffer();
}

// A server that answers and does not let other pages read looks to a script like one that does not
// answer: asked once more without reading, it tells the two apart.
async function whyNot(url: URL): Promise<string> {
  const { host } = url;
  const there = await fetch(url, { mode: "no-cors", credentials: "omit", signal: AbortSignal.timeout(5000) })
    .then(() => true)
    .catch(() => false);
  return text(there ? "layer.cors" : "layer.away", { host });
}

async function fetchFile(url: URL, signal: AbortSignal): Promise<ArrayBuffer> {
  if (!/^https?:$/.test(url.protocol)) throw new LayerError(text("layer.address"));
  const slow = new AbortController();
  const timer = setTimeout(() => slow.abort(), ANSWER_MS);
  let response: Response;
  try {
    response = await fetch(url, { signal: AbortSignal.any([signal, slow.signal]), credentials: "omit" });
  } catch {
    signal.throwIfAborted();
    throw new LayerError(await whyNot(url));
  } finally {
    clearTimeout(timer);
  }
  const { status } = response;
  if (status === 404 || status === 410) throw new LayerError(text("layer.missing", { status }));
  if (!response.ok || !response.body) throw new LayerError(text("layer.refused", { status }));
  return readAll(response, FILE_MAX);
}

export class Layers {
  /** @internal */
  readonly models = new Group(); // drawn before the city, and hidden by what is in front of it
  /** @internal */
  readonly drape = new Drape();
  onWake: () => void = () => {};
  onChange: () => void = () => {};
  private readonly entries = new Map<number, Entry>();
  private readonly lights = new Group();
  private next = 1;

  /** @internal */
  constructor(
    private readonly stage: Stage,
    private readonly overlay: Overlay,
    private readonly heightOf: (place: Pick<Place, "lon" | "lat">) => number | null,
  ) {
    const sun = new DirectionalLight(0xffffff, 2);
    sun.position.set(0.5, 1, 0.4);
    this.lights.add(new HemisphereLight(0xffffff, 0x8a8f98, 1.6), sun);
  }

  get list(): readonly Layer[] {
    return [...this.entries.values()].map(({ layer }) => ({ ...layer }));
  }

  // Something comes still.
  get loading(): boolean {
    return [...this.entries.values()].some(
      ({ layer, tiles }) => layer.state === "loading" || (layer.visible && tiles?.loading),
    );
  }

  // Resolves when it is shown; rejects with why it is not, and the list keeps it until it is removed.
  async add(options: LayerOptions): Promise<Layer> {
    if (this.entries.size >= LAYERS_MAX) throw new LayerError(text("layer.many", { count: LAYERS_MAX }));
    if (!options.file && !URL.canParse(String(options.url ?? ""), location.href))
      throw new LayerError(text("layer.address"));
    const url = options.file ? null : new URL(options.url!, location.href).href;
    const { visible = true, drape, up = 0, place } = options;
    const layer = {
      ...{ id: this.next++, name: nameOf(options), url, kind: null, state: "loading" as const, why: "" },
      ...{ visible, drape: drape ?? null, up, place: place ?? null },
    };
    const entry: Entry = {
      ...{ layer, options, stop: new AbortController(), shapes: [], ids: [], model: null, tiles: null },
    };
    this.entries.set(layer.id, entry);
    await this.load(entry);
    return { ...entry.layer };
  }

  // Once more, where it failed.
  async retry(id: number): Promise<void> {
    const entry = this.entries.get(id);
    if (entry?.layer.state === "failed") await this.load(entry);
  }

  change(id: number, change: LayerChange) {
    const entry = this.entries.get(id);
    if (!entry) return;
    Object.assign(entry.layer, change);
    this.show(entry);
    this.onChange();
  }

  remove(id: number) {
    const entry = this.entries.get(id);
    if (!entry) return;
    this.entries.delete(id);
    entry.stop.abort();
    this.hide(entry);
    this.drop(entry);
    this.dressUp();
    this.onChange();
  }

  // Shapes of GeoJSON; 0 of anything else.
  countOf(id: number): number {
    return this.entries.get(id)?.shapes.length ?? 0;
  }

  // Where it is, in the scene's metres; null where that is not known.
  /** @internal */
  extentOf(id: number): Box3 | null {
    const { shapes, model, tiles, layer } = this.entries.get(id) ?? {};
    const box = new Box3();
    if (model && layer) box.setFromObject(model.object);
    const sphere: Sphere | null = tiles?.where() ?? null;
    if (sphere) sphere.getBoundingBox(box);
    for (const { places } of shapes ?? [])
      for (const place of places) box.expandByPoint(this.stage.frame.pointOf(place));
    return box.isEmpty() ? null : box;
  }

  // Another scene has another frame.
  reset() {
    for (const entry of this.entries.values()) if (entry.layer.state === "shown") this.show(entry);
  }

  // Before a frame is drawn.
  /** @internal */
  step(camera: Stage["camera"], renderer: Parameters<ForeignTiles["step"]>[1]) {
    for (const { layer, tiles } of this.entries.values())
      if (tiles && layer.visible && layer.state === "shown") tiles.step(camera, renderer);
  }

  // The nearest point of a model on a ray; null where there is none.
  /** @internal */
  meet(ray: Ray): Vector3 | null {
    if (!this.models.children.length) return null;
    const caster = new Raycaster(ray.origin, ray.direction);
    (caster as Raycaster & { firstHitOnly?: boolean }).firstHitOnly = true;
    return caster.intersectObject(this.models)[0]?.point ?? null;
  }

  dispose() {
    for (const id of [...this.entries.keys()]) this.remove(id);
    this.drape.dispose();
  }

  // ---- reading ----

  private async load(entry: Entry) {
    const { layer, stop } = entry;
    layer.state = "loading";
    layer.why = "";
    this.onChange();
    try {
      await this.read(entry);
      stop.signal.throwIfAborted();
      layer.state = "shown";
      this.show(entry);
    } catch (error) {
      if (stop.signal.aborted) return;
      this.fail(entry, error);
      throw new LayerError(layer.why);
    } finally {
      if (!stop.signal.aborted) this.onChange();
    }
  }

  private fail(entry: Entry, error: unknown) {
    // Others' loaders run into what is not there.
    const strange = error instanceof TypeError || error instanceof RangeError;
    const why = strange ? text("layer.parts") : whyOf(error);
    this.hide(entry);
    this.drop(entry);
    entry.layer.state = "failed";
    entry.layer.why =
      error instanceof LayerError ? why : text("layer.damaged", { why: why.slice(0, 200) });
    this.dressUp();
  }

  // By what is in it: names and types of servers say too little.
  private async read(entry: Entry) {
    const { layer, options, stop } = entry;
    const { file } = options;
    const base = layer.url === null ? null : new URL(layer.url);
    if (file && file.size > FILE_MAX) throw new LayerError(text("layer.large", { mb: FILE_MAX / 2 ** 20 }));
    const bytes = base ? await fetchFile(base, stop.signal) : await file!.arrayBuffer();
    const head = new TextDecoder("latin1").decode(bytes.slice(0, 4));
    if (head === "glTF") return this.readModel(entry, bytes, base);
    const root = parseJson(bytes);
    if (isGeoJson(root)) {
      if (bytes.byteLength > GEOJSON_MAX) throw new LayerError(text("layer.large", { mb: GEOJSON_MAX / 2 ** 20 }));
      return this.readShapes(entry, root);
    }
    const { asset, root: first, geometricError } = (root ?? {}) as Record<string, unknown>;
    if (asset && first && geometricError !== undefined) {
      if (!base) throw new LayerError(text("layer.tilesFile"));
      return this.readTiles(entry, base, root);
    }
    if (asset) return this.readModel(entry, bytes, base);
    throw new LayerError(text("layer.unknown"));
  }

  private readShapes(entry: Entry, root: unknown) {
    const { stage } = this;
    const foot = stage.extent.getCenter(new Vector3()).setY(stage.ground);
    entry.layer.kind = "geojson";
    try {
      entry.shapes = parseGeoJson(root, stage.frame.placeOf(foot).h + 0.3);
    } catch (error) {
      throw new LayerError(text("layer.geojson", { why: (error as Error).message }));
    }
    entry.layer.drape ??= entry.shapes.every(({ flat }) => flat);
  }

  private async readModel(entry: Entry, bytes: ArrayBuffer, base: URL | null) {
    const { layer, stop } = entry;
    layer.kind = "model";
    const { loadModel } = await import("./models");
    const model = await loadModel(bytes, base);
    if (stop.signal.aborted) return model.dispose();
    entry.model = model;
    if (model.onEarth) layer.place = null;
    else layer.place ??= this.ahead();
  }

  private async readTiles(entry: Entry, base: URL, document: unknown) {
    const { layer, stop } = entry;
    layer.kind = "tiles";
    const { ForeignTiles } = await import("./models");
    stop.signal.throwIfAborted();
    const tiles = new ForeignTiles(base, document, this.stage.frame.worldFromEcef, this.stage.camera);
    entry.tiles = tiles;
    tiles.onChange = () => this.onWake();
    await new Promise<void>((resolve, reject) => {
      const end = (run: () => void) => (clearTimeout(timer), run());
      const timer = setTimeout(() => reject(new LayerError(text("layer.slow"))), ANSWER_MS);
      stop.signal.addEventListener("abort", () => end(resolve), { once: true });
      tiles.onProblem = (error) => end(() => reject(error));
      tiles.addEventListener("load-root-tileset", () => end(resolve));
      tiles.update(); // reads the document
    });
    if (!stop.signal.aborted && !tiles.where()) throw new LayerError(text("layer.nowhere"));
    tiles.onProblem = (error) => {
      this.fail(entry, error);
      this.onChange();
    };
  }

  // What is in the middle of the picture, or the ground there.
  private ahead(): ModelPlace {
    const { stage } = this;
    return { ...stage.frame.placeOf(stage.center()), heading: 0, scale: 1 };
  }

  // ---- showing ----

  private show(entry: Entry) {
    this.hide(entry);
    const { layer, shapes, model, tiles } = entry;
    if (layer.state === "shown" && layer.visible) {
      if (model) this.stand(model, layer);
      tiles?.stand(this.stage.frame.worldFromEcef, layer.up);
      if (tiles) this.models.add(tiles.group);
      if (shapes.length) this.showShapes(entry);
    }
    this.dressUp();
  }

  private stand({ object, onEarth }: Model, { place, up }: Layer) {
    const { frame } = this.stage;
    if (onEarth || !place) {
      // glTF's y is ECEF's z.
      object.rotation.set(Math.PI / 2, 0, 0);
      object.updateMatrix();
      object.matrix.premultiply(frame.worldFromEcef);
      object.matrix.decompose(object.position, object.quaternion, object.scale);
      object.position.y += up;
    } else {
      const turned = frame.cameraFrom({ ...place, pitch: 0, fov: 45 });
      object.position.copy(turned.position);
      object.quaternion.copy(turned.rotation);
      object.position.y += up;
      object.scale.setScalar(Math.min(SCALE_MAX, Math.max(1 / SCALE_MAX, place.scale)));
    }
    object.updateMatrixWorld(true);
    this.models.add(object);
  }

  private showShapes({ layer, shapes, ids }: Entry) {
    if (layer.drape) {
      const named = shapes.filter(({ label }) => label).slice(0, LABELS_MAX);
      for (const shape of named) ids.push(this.overlay.add(this.labelOf(shape)));
      return;
    }
    const raised = (ring: Place[]) => ring.map((place) => ({ ...place, h: place.h + layer.up }));
    for (const shape of shapes) {
      const holes = shape.holes ? { holes: shape.holes.map(raised) } : {};
      ids.push(this.overlay.add({ ...shape, places: raised(shape.places), ...holes }));
    }
  }

  private labelOf({ places, label }: GeoShape): Shape {
    const middle = places.reduce(
      (sum, { lon, lat }) => ({ lon: sum.lon + lon / places.length, lat: sum.lat + lat / places.length }),
      { lon: 0, lat: 0 },
    );
    const h = this.heightOf(middle) ?? places[0]!.h;
    return { kind: "label", places: [{ ...middle, h }], ...(label ? { label } : {}) };
  }

  private hide({ ids, model, tiles }: Entry) {
    for (const id of ids.splice(0)) this.overlay.remove(id);
    if (model) this.models.remove(model.object);
    if (tiles) this.models.remove(tiles.group);
  }

  private drop(entry: Entry) {
    entry.model?.dispose();
    try {
      entry.tiles?.dispose();
    } catch {
      // a tileset that failed half way holds half of what it should
    }
    entry.model = entry.tiles = null;
    entry.shapes = [];
  }

  // What all layers together make: the draped picture, and light where there are models.
  private dressUp() {
    const draped = [...this.entries.values()].filter(
      ({ layer }) => layer.state === "shown" && layer.visible && layer.drape,
    );
    this.drape.set(
      draped.flatMap(({ shapes }) => shapes),
      this.stage.frame,
      this.stage.extent,
    );
    this.models.remove(this.lights);
    if (this.models.children.length) this.models.add(this.lights);
    this.onWake();
  }
}

// Others' decoders reject with objects of their own.
function whyOf(error: unknown): string {
  const { message, error: inner } = (error ?? {}) as { message?: unknown; error?: unknown };
  return [message, inner, error].find((one) => typeof one === "string" && one) as string ?? text("layer.parts");
}

function parseJson(bytes: ArrayBuffer): unknown {
  const first = new Uint8Array(bytes.slice(0, 64)).find((byte) => byte > 32 && byte < 128);
  if (first !== 0x7b) return null; // "{"
  try {
    return JSON.parse(new TextDecoder().decode(bytes));
  } catch (error) {
    throw new LayerError(text("layer.json", { why: (error as Error).message.slice(0, 120) }));
  }
}
