// Where scenes come from: a citysplat server with its catalogue, or one tileset on any file server
// (`citysplat export --format 3dtiles`).
//
// SPDX-License-Identifier: Apache-2.0
import { Matrix4, Vector3 } from "three";

import { formatPose, type Place, type Pose } from "./geo";
import { HttpError, isGone, type Link } from "./link";
import { NAME_DEFAULT, Network, type Photograph } from "./network";
import { Problem } from "./problem";
import { boxIn } from "./screenerror";

// A city of a server.
export interface SceneEntry {
  // Its name in addresses.
  id: string;
  // Its name for people.
  title: string;
  // Whose it is.
  attribution: string;
  heights: string; // above what: "ellipsoid", "sea", "sea-exif", "takeoff", "EPSG:7837", "unknown", "unscaled"
  created: string; // day when the scene was made, 2024-06-01; "": not known
  taken: [string, string] | null; // days of its first and last photograph; null: not known
  catalogue: URL | null; // the folder of the server that lists it; null on a file server
  // Address of its 3D Tiles.
  tileset: URL;
  appearances: URL | null; // null where it was trained without
  network: URL | null; // of its revision: colours can be computed here; null where they cannot
  pictures: URL | null; // the folder of its static views; null on a file server
  questions: URL | null; // the folder of height, profile, measure; null on a file server
  map: URL | null; // TileJSON of its map tiles; null where there are none
  outline: readonly number[] | null; // what home shows: homeview.ts; null: it is found in the coarsest tiles
  preview: URL | null; // a small picture of the whole scene; null where nobody draws one
  packed: boolean; // tiles are to be had as .drc, and as drafts
}

/** @internal */
export interface SceneInfo {
  url: string; // of the tileset, with the appearance
  network: Network | null; // colours of the tiles are as they were trained; null: as they are shown
  packed: boolean; // its tiles are asked for as .drc, with drafts
  document: unknown; // the tileset itself
  revision: string;
  attribution: string;
  transform: Matrix4; // east-north-up metres -> ECEF
  center: Vector3; // of the bounding box, ENU
  half: Vector3; // half its size along east, north, up
  most: number[] | null; // where most Gaussians are, ENU: least corner, then greatest; null where the tileset does not tell
}

// A light that the city can have: that of a photograph.
export type Appearance = Photograph;

// Map tiles seen from straight above.
export interface MapTiles {
  tiles: string; // a URL with {z}, {x}, {y}
  // Deepest zoom that there is.
  maxZoom: number;
  // West, south, east, north in degrees.
  bounds: [west: number, south: number, east: number, north: number];
}
// Map tiles of somebody else, which the operator chose.
export interface Basemap {
  // Address of a tile, with {z}, {x} and {y}.
  tiles: string;
  // Whose the map is.
  attribution: string;
}

// The credit of a map on the ground: what is given, or the host that it comes from.
/** @internal */
export function creditOf({ tiles, attribution }: Basemap): string {
  return attribution || new URL(tiles, document.baseURI).host;
}

// Whether tiles can be asked for there.
/** @internal */
export function isTileAddress(tiles: string): boolean {
  if (!URL.canParse(tiles, document.baseURI)) return false;
  const { protocol } = new URL(tiles, document.baseURI);
  return /^https?:$/.test(protocol) && ["{z}", "{x}", "{y}"].every((part) => tiles.includes(part));
}

interface Collection {
  id?: string;
  title?: string;
  attribution?: string;
  links?: { rel?: string; href?: string }[];
  splats?: { revision?: string; formats?: unknown; heights?: string; created?: string; taken?: string[]; outline?: number[] };
}
interface TilesetDocument {
  asset?: { tilesetVersion?: string; extras?: { verticalDatum?: string; cesium?: { credits?: { html?: string }[] } } };
  root?: Node & { transform?: number[]; boundingVolume?: { box?: number[] }; extras?: { extent?: unknown } };
}
interface Node {
  geometricError?: number;
  content?: { uri?: string };
  children?: Node[];
}

const ANSWER_MS = 20_000;
const APPEARANCE_NONE = "none";
const LOWPASS = /\.lowpass\.glb(?=\?|$)/;
export const DRAFT = "preset=preview&sh=0"; // letter by letter what server/documents/link_header.c says
const VOLUMES = "http://www.opengis.net/def/rel/ogc/1.0/3d-geovolumes";

// Credits may be HTML; the viewer shows their text.
function plainText(html: string): string {
  return new DOMParser().parseFromString(html, "text/html").body.textContent?.trim() ?? "";
}

function entryOf(collection: Collection, base: URL): SceneEntry {
  const id = String(collection.id);
  const href = (rel: string) => collection.links?.find((link) => link.rel === rel)?.href;
  const appearances = href("appearances");
  const network = href("appearance-model");
  const preview = href("preview");
  const map = collection.links?.find((link) => /\/map\.json$/.test(link.href ?? ""))?.href;
  const { revision, heights = "ellipsoid", created = "", taken, outline } = collection.splats ?? {};
  const folder = `d/${encodeURIComponent(id)}/`;
  return {
    id,
    title: collection.title || id,
    attribution: plainText(collection.attribution ?? ""),
    heights: String(heights),
    created: String(created).slice(0, 10),
    taken: Array.isArray(taken) && taken.length === 2 ? [String(taken[0]), String(taken[1])] : null,
    catalogue: base,
    tileset: new URL(href(VOLUMES) ?? `${folder}tileset.json`, base),
    appearances: appearances ? new URL(appearances, base) : null,
    network: network ? new URL(network, base) : null,
    pictures: new URL(revision ? `${folder}r/${revision}/static/` : `${folder}static/`, base),
    questions: new URL(folder, base),
    map: map ? new URL(map, base) : null,
    outline: Array.isArray(outline) && outline.length === 10 && outline.every(Number.isFinite) ? outline : null,
    preview: preview ? new URL(preview, base) : null,
    packed: Array.isArray(collection.splats?.formats) && collection.splats.formats.includes("drc"),
  };
}

// A tileset alone: its folder's name is its title.
function entryOfTileset(tileset: URL): SceneEntry {
  const folder = decodeURIComponent(tileset.pathname.split("/").at(-2) ?? "");
  const id = folder || "city";
  const absent = { catalogue: null, appearances: null, network: null };
  const unasked = { pictures: null, questions: null, map: null, preview: null, packed: false };
  const unknown = { attribution: "", heights: "ellipsoid", created: "", taken: null, outline: null };
  return { id, title: id, tileset, ...unknown, ...absent, ...unasked };
}

// The scenes at a URL: a server's folder, or a tileset.json.
/** @internal */
export async function findScenes(link: Link, url: URL): Promise<SceneEntry[]> {
  if (/\.json$/.test(url.pathname)) return [entryOfTileset(url)];
  const base = new URL(url);
  base.pathname = base.pathname.replace(/\/*$/, "/");
  const body = (await link.json(new URL("collections", base))) as { collections?: Collection[] };
  if (!Array.isArray(body?.collections))
    throw new Problem("notCitysplat", { url: new URL("collections", base).pathname });
  if (!body.collections.length) throw new Problem("noScenes");
  return body.collections.map((collection) => entryOf(collection, base));
}

// The first of some places that has scenes. A place that says no is passed over; one that does not
// answer is waited for. Where nothing is in any of them, that is what is said.
/** @internal */
export async function findFirst(link: Link, urls: URL[]): Promise<SceneEntry[]> {
  let first: unknown;
  let nothing = true;
  for (const url of urls) {
    try {
      if (/\.json$/.test(url.pathname)) await link.json(url); // a guess, until it is there
      return await findScenes(link, url);
    } catch (error) {
      if (!(error instanceof HttpError || error instanceof Problem)) throw error;
      first ??= error;
      nothing &&= isGone(error) || (error instanceof Problem && error.kind === "notCitysplat");
    }
  }
  throw nothing ? new Problem("nothingHere") : first;
}

function withAppearance(url: URL, appearance: string): URL {
  const out = new URL(url);
  if (appearance) out.searchParams.set("appearance", appearance);
  return out;
}

// Other clients get tiles with a low-pass filter built in, and below a leaf the tile itself. We filter, and take the tiles.
/** @internal */
export function useUnfilteredTiles(document: { root?: Node }) {
  const visit = (node: Node) => {
    const { content, children } = node;
    if (content?.uri && LOWPASS.test(content.uri)) {
      content.uri = content.uri.replace(LOWPASS, ".glb");
      if (children?.length === 1 && children[0]!.content?.uri === content.uri) {
        node.geometricError = 0;
        delete node.children;
      }
    }
    node.children?.forEach(visit);
  };
  if (document.root) visit(document.root);
}

// Tiles are asked for in their smallest form, which carries embeddings too, in every document of a
// tileset. drafts: the first tile of each branch comes as one: it is there soon, and mostly gone as soon
// as finer ones are.
/** @internal */
export function usePackedTiles(document: { root?: Node }, drafts = true) {
  useUnfilteredTiles(document);
  const visit = ({ content, children }: Node, first: boolean) => {
    const tile = content?.uri && /\.glb(?=\?|$)/.test(content.uri);
    if (tile) {
      content.uri = content.uri!.replace(/\.glb(?=\?|$)/, ".drc");
      if (first) content.uri += (content.uri.includes("?") ? "&" : "?") + DRAFT;
    }
    children?.forEach((child) => visit(child, first && !tile));
  };
  if (document.root) visit(document.root, drafts);
}

// The network of this revision: fetched together with the tileset, and once more where the catalogue
// was older than that. null where there is none to be had: the server's colours do without.
async function fetchNetwork(
  link: Link,
  url: URL,
  tileset: Promise<TilesetDocument>,
): Promise<Network | null> {
  const early = link.json(url).catch(() => null);
  try {
    const revision = (await tileset).asset?.tilesetVersion ?? "";
    const named = url.pathname.split("/").at(-2)?.split("-")[0]; // .../r/REV-EDITION/appearance.json
    const own = named === revision ? url : new URL(`../${revision}/appearance.json`, url);
    const document = own.href === url.href ? await early : null;
    return new Network(document ?? (await link.json(own)), new URL("appearances.json", own), link);
  } catch (error) {
    console.warn(`citysplat: the server computes the colours: ${String(error)}`);
    return null;
  }
}

// compute: colours are to be computed here, if the server lets us.
/** @internal */
export async function openScene(
  link: Link,
  entry: SceneEntry,
  appearance: string,
  compute: ((network: Network) => boolean) | null,
): Promise<SceneInfo> {
  if (compute && entry.network) {
    const url = withAppearance(entry.tileset, APPEARANCE_NONE);
    const tileset = link.json(url) as Promise<TilesetDocument>;
    const [document, network] = await Promise.all([
      tileset,
      fetchNetwork(link, entry.network, tileset),
    ]);
    if (network && compute(network)) {
      usePackedTiles(document);
      return describe(entry, url, document, network, true);
    }
  }
  const url = withAppearance(entry.tileset, appearance);
  const document = (await link.json(url)) as TilesetDocument;
  if (entry.packed) usePackedTiles(document);
  else useUnfilteredTiles(document);
  return describe(entry, url, document, null, entry.packed);
}

// By the words of a tileset alone: those of heights_datum in core/geo/heights.c.
function countedFrom(datum: string): string {
  if (!datum || datum.startsWith("WGS 84")) return "ellipsoid";
  return datum.startsWith("sea level") ? "sea" : "unknown";
}

function describe(
  entry: SceneEntry,
  url: URL,
  document: TilesetDocument,
  network: Network | null,
  packed: boolean,
): SceneInfo {
  const { transform, boundingVolume } = document.root ?? {};
  const box = boundingVolume?.box;
  if (transform?.length !== 16 || box?.length !== 12)
    throw new Problem("badTileset", { url: url.pathname });
  const extent = (axis: number) =>
    Math.abs(box[3 + axis]!) + Math.abs(box[6 + axis]!) + Math.abs(box[9 + axis]!);
  const credits = document.asset?.extras?.cesium?.credits ?? [];
  if (!entry.catalogue) entry.heights = countedFrom(document.asset?.extras?.verticalDatum ?? "");
  return {
    url: url.href,
    network,
    packed,
    document,
    revision: document.asset?.tilesetVersion ?? "",
    attribution: entry.attribution || credits.map((c) => plainText(c.html ?? "")).join(" · "),
    transform: new Matrix4().fromArray(transform),
    center: new Vector3(box[0], box[1], box[2]),
    half: new Vector3(extent(0), extent(1), extent(2)),
    most: boxIn(document.root?.extras?.extent),
  };
}

// Every appearance of a scene. The time is that of the photograph, where the server tells it.
/** @internal */
export async function listAppearances(
  link: Link,
  entry: SceneEntry,
  network: Network | null,
): Promise<Appearance[]> {
  const standard = { name: NAME_DEFAULT, time: "", thumbnail: "", place: null };
  if (network) return [standard, ...(await network.list())];
  if (!entry.appearances) return [];
  const body = (await link.json(entry.appearances)) as { appearances?: { name?: string }[] };
  return (body.appearances ?? []).map((one) => ({ ...standard, name: String(one.name) }));
}

// sky: with sky and ground behind the city, as the viewer draws them by day; else before black.
/** @internal */
export function pictureUrl(
  entry: SceneEntry,
  appearance: string,
  pose: Pose,
  width: number,
  height: number,
  sky = false,
): URL {
  if (!entry.pictures) throw new Problem("noPictures");
  const url = withAppearance(
    new URL(`${formatPose(pose)}/${width}x${height}.jpg`, entry.pictures),
    appearance,
  );
  if (sky) url.searchParams.set("background", "sky");
  return url;
}

// What the server sees at a pixel of a view; null for the sky.
/** @internal */
export async function askPlace(
  link: Link,
  { questions }: SceneEntry,
  { h, ...pose }: Pose,
  at: { x: number; y: number; width: number; height: number },
): Promise<Place | null> {
  if (!questions || link.state === "away") return null;
  const [x, y] = [Math.floor(at.x), Math.floor(at.y)];
  const body = JSON.stringify({ pose: { ...pose, height: h }, ...at, x, y });
  const signal = AbortSignal.timeout(ANSWER_MS);
  const response = await fetch(new URL("pick", questions), { method: "POST", body, signal });
  if (!response.ok) return null;
  const { lon, lat, height_m } = (await response.json()) as Record<string, unknown>;
  const place = { lon: Number(lon ?? NaN), lat: Number(lat ?? NaN), h: Number(height_m ?? NaN) };
  return Object.values(place).every(Number.isFinite) ? place : null;
}

// What the server says of a scene's map tiles; null where there are none.
/** @internal */
export async function findMapTiles(link: Link, entry: SceneEntry): Promise<MapTiles | null> {
  if (!entry.map || !entry.pictures) return null;
  const about = (await link.json(entry.map)) as { maxzoom?: unknown; bounds?: unknown };
  const bounds = Array.isArray(about.bounds) ? about.bounds.map(Number) : [];
  const maxZoom = Number(about.maxzoom);
  if (bounds.length !== 4 || !bounds.every(Number.isFinite) || !Number.isInteger(maxZoom)) return null;
  const folder = new URL("../map/", entry.pictures).href; // of the same revision
  return { tiles: `${folder}{z}/{x}/{y}.webp`, maxZoom, bounds: bounds as MapTiles["bounds"] };
}
