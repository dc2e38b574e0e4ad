// GeoJSON over the city: files dropped on the page. Heights are above the ellipsoid; without one a
// shape lies on the ground of the scene.
//
// SPDX-License-Identifier: Apache-2.0
import { toast } from "./dom";
import type { Place } from "./geo";
import type { Shape } from "./overlay";
import { text } from "./strings";
import type { Viewer } from "./viewer";

const FILE_MAX = 32 * 2 ** 20;
const SHAPES_MAX = 5000;

type Position = number[];
interface Geometry {
  type?: string;
  coordinates?: unknown;
  geometries?: Geometry[];
}
interface Feature {
  type?: string;
  geometry?: Geometry | null;
  properties?: Record<string, unknown> | null;
  features?: Feature[];
}

function placesOf(positions: unknown, ground: number): Place[] {
  if (!Array.isArray(positions)) throw new Error("coordinates are no list");
  return positions.map((at: Position) => {
    const [lon, lat, h = ground] = at;
    if (![lon, lat, h].every(Number.isFinite)) throw new Error("a position is no list of numbers");
    return { lon: lon!, lat: lat!, h };
  });
}

function shapesOf(geometry: Geometry, ground: number): Shape[] {
  const { type, coordinates } = geometry;
  const many = (coordinates ?? []) as unknown[];
  const one = (kind: Shape["kind"], positions: unknown): Shape => ({
    kind,
    places: placesOf(positions, ground),
    behind: true,
  });
  switch (type) {
    case "Point":
      return [one("point", [coordinates])];
    case "MultiPoint":
      return [one("point", coordinates)];
    case "LineString":
      return [one("line", coordinates)];
    case "MultiLineString":
      return many.map((line) => one("line", line));
    case "Polygon":
      return many.slice(0, 1).map((ring) => one("area", (ring as unknown[]).slice(0, -1)));
    case "MultiPolygon":
      return many.map((rings) => one("area", ((rings as unknown[][])[0] ?? []).slice(0, -1)));
    case "GeometryCollection":
      return (geometry.geometries ?? []).flatMap((each) => shapesOf(each, ground));
    default:
      throw new Error(`unknown geometry ${String(type)}`);
  }
}

// Throws with what is wrong. ground: the height of positions without one.
export function parseGeoJson(source: string, ground: number): Shape[] {
  const root = JSON.parse(source) as Feature & Geometry;
  const features =
    root.type === "FeatureCollection"
      ? (root.features ?? [])
      : root.type === "Feature"
        ? [root]
        : [{ geometry: root }];
  const shapes = features.slice(0, SHAPES_MAX).flatMap((feature: Feature) => {
    if (!feature.geometry) return [];
    const { name, color, stroke } = feature.properties ?? {};
    const paint = [stroke, color].find((v) => typeof v === "string" && /^#[0-9a-f]{6}$/i.test(v));
    return shapesOf(feature.geometry, ground).map((shape) => ({
      ...shape,
      ...(typeof name === "string" ? { label: name.slice(0, 80) } : {}),
      color: (paint as string | undefined) ?? "#5ee0a0",
    }));
  });
  if (!shapes.length) throw new Error("no shapes");
  return shapes;
}

export class GeoJsonDrop {
  constructor(private readonly viewer: Viewer) {
    const over = (on: boolean) => document.body.classList.toggle("dropping", on);
    window.addEventListener("dragover", (event) => {
      event.preventDefault();
      over(true);
    });
    window.addEventListener("dragleave", () => over(false));
    window.addEventListener("drop", (event) => {
      event.preventDefault();
      over(false);
      for (const file of event.dataTransfer?.files ?? []) void this.take(file);
    });
  }

  async take(file: File) {
    try {
      if (file.size > FILE_MAX) throw new Error("too large");
      const { stage, overlay } = this.viewer;
      const foot = stage.extent.getCenter(stage.camera.position.clone()).setY(stage.ground);
      const shapes = parseGeoJson(await file.text(), stage.frame.placeOf(foot).h + 0.3);
      for (const shape of shapes) overlay.add(shape);
      toast(text("overlay.added", { count: shapes.length, file: file.name }));
    } catch {
      toast(text("overlay.bad", { file: file.name }));
    }
  }
}
