// GeoJSON (RFC 7946): longitude, latitude and, where there is one, the height, as the scene counts it.
//
// SPDX-License-Identifier: Apache-2.0
import type { Place } from "./geo";
import type { Shape } from "./overlay";

const SHAPES_MAX = 5000;
const POSITIONS_MAX = 500_000;
const DEPTH_MAX = 20; // of collections in collections
const TYPES = new Set([
  "FeatureCollection",
  "Feature",
  "GeometryCollection",
  ...["Point", "LineString", "Polygon"].flatMap((name) => [name, `Multi${name}`]),
]);

// flat: none of its positions has a height.
export interface GeoShape extends Shape {
  flat: boolean;
}

interface Geometry {
  type?: unknown;
  coordinates?: unknown;
  geometries?: unknown;
}
interface Feature extends Geometry {
  geometry?: Geometry | null;
  properties?: Record<string, unknown> | null;
  features?: unknown;
}

export function isGeoJson(root: unknown): boolean {
  const type = typeof root === "object" && root !== null ? (root as Feature).type : null;
  return typeof type === "string" && TYPES.has(type);
}

function listOf(value: unknown, what: string): unknown[] {
  if (!Array.isArray(value)) throw new Error(`${what} is no list`);
  return value;
}

class Reader {
  readonly shapes: GeoShape[] = [];
  private positions = 0;

  constructor(private readonly ground: number) {}

  feature(feature: Feature) {
    const geometry = feature.type === "Feature" ? feature.geometry : feature;
    if (!geometry) return;
    const { name, color, stroke, fill } = (feature.type === "Feature" && feature.properties) || {};
    const paint = [stroke, fill, color].find((v) => typeof v === "string" && /^#[0-9a-f]{6}$/i.test(v));
    const look = {
      ...(typeof name === "string" && name ? { label: name.slice(0, 80) } : {}),
      color: (paint as string | undefined) ?? "#5ee0a0",
      behind: true,
    };
    this.geometry(geometry, look, 0);
  }

  private geometry(geometry: Geometry, look: Partial<Shape>, depth: number) {
    const { type, coordinates, geometries } = geometry;
    const add = (kind: Shape["kind"], outer: unknown, holes: unknown[] = []) => {
      const [places, ...rest] = [outer, ...holes].map((ring) => this.places(ring, kind));
      if (!places!.places.length) return;
      if (this.shapes.length >= SHAPES_MAX) throw new Error(`more than ${SHAPES_MAX} shapes`);
      const flat = places!.flat;
      const more = rest.length ? { holes: rest.map((ring) => ring.places) } : {};
      this.shapes.push({ ...look, kind, places: places!.places, ...more, flat });
    };
    const polygon = (rings: unknown) => {
      const [outer = [], ...holes] = listOf(rings, "a polygon");
      add("area", outer, holes);
    };
    const many = () => listOf(coordinates, "coordinates");
    if (type === "Point") add("point", [coordinates]);
    else if (type === "MultiPoint") add("point", coordinates);
    else if (type === "LineString") add("line", coordinates);
    else if (type === "MultiLineString") for (const line of many()) add("line", line);
    else if (type === "Polygon") polygon(coordinates);
    else if (type === "MultiPolygon") for (const rings of many()) polygon(rings);
    else if (type === "GeometryCollection" && depth < DEPTH_MAX)
      for (const each of listOf(geometries, "geometries")) this.geometry(each as Geometry, look, depth + 1);
    else throw new Error(`an unknown geometry, ${String(type).slice(0, 40)}`);
  }

  private places(positions: unknown, kind: Shape["kind"]): { places: Place[]; flat: boolean } {
    const list = listOf(positions, "coordinates");
    this.positions += list.length;
    if (this.positions > POSITIONS_MAX) throw new Error(`more than ${POSITIONS_MAX} positions`);
    let flat = true;
    const places = list.map((at) => {
      const [lon, lat, h] = listOf(at, "a position") as number[];
      if (h !== undefined) flat = false;
      if (![lon, lat, h ?? 0].every(Number.isFinite)) throw new Error("a position is no list of numbers");
      if (Math.abs(lon!) > 180 || Math.abs(lat!) > 90)
        throw new Error(`${lon}, ${lat} is no longitude and latitude (EPSG:4326)`);
      return { lon: lon!, lat: lat!, h: h ?? this.ground };
    });
    const [first, last] = [places[0], places.at(-1)];
    const closed = kind === "area" && places.length > 1 && first!.lon === last!.lon && first!.lat === last!.lat;
    return { places: closed ? places.slice(0, -1) : places, flat };
  }
}

// Throws with what is wrong. ground: the height of positions without one.
export function parseGeoJson(root: unknown, ground: number): GeoShape[] {
  if (!isGeoJson(root)) throw new Error("its type is none of GeoJSON's");
  const { type, features } = root as Feature;
  const reader = new Reader(ground);
  const all = type === "FeatureCollection" ? listOf(features, "features") : [root];
  for (const feature of all) if (typeof feature === "object" && feature) reader.feature(feature as Feature);
  if (!reader.shapes.length) throw new Error("it has no shapes");
  return reader.shapes;
}
