// The inset's map: Leaflet with the server's own map tiles, the camera's place and what it looks
// towards. Loaded when somebody opens the inset; needs no graphics card.
//
// SPDX-License-Identifier: Apache-2.0
import { GridLayer, Map as LeafletMap, circleMarker, control, latLngBounds, layerGroup, point, polygon, rectangle } from "leaflet";
import type {
  Coords,
  DoneCallback,
  GridLayerOptions,
  LatLngBounds,
  LatLngBoundsLiteral,
  LatLngTuple,
} from "leaflet";
import "leaflet/dist/leaflet.css";

import type { Place, Pose } from "./geo";

const TILE_PX = 256;
const SMALL_ZOOMS = 1; // a map that could be larger by more than that is made larger
const BLURRED_ZOOMS = 3; // beyond the last zoom that there is
const METRES_PER_DEGREE = 111_320;
const WEDGE_LEAST_M = 30;
const WEDGE_PITCH_DEG = 4; // an upper edge of the picture above this sees to the end of the city
const ARC_STEPS = 6; // of the far edge, to either side
const ZOOM_MOST = 22;
const EDGE_PX = 14; // around what is to be seen

export type Fetch = (url: string, signal: AbortSignal) => Promise<ArrayBuffer>;

export interface MapSource {
  tiles: string; // with {z}, {x}, {y}
  maxZoom: number;
  fetch: Fetch;
}

// From a place so many metres along a direction, in degrees clockwise from north.
export function along({ lon, lat }: Pick<Place, "lon" | "lat">, degrees: number, metres: number): LatLngTuple {
  const angle = (degrees * Math.PI) / 180;
  const east = METRES_PER_DEGREE * Math.max(0.01, Math.cos((lat * Math.PI) / 180));
  return [
    lat + (metres * Math.cos(angle)) / METRES_PER_DEGREE,
    lon + (metres * Math.sin(angle)) / east,
  ];
}

// How far from the camera's foot a direction below the horizon meets the ground.
export function reach(above: number, pitch: number, most: number): number {
  const tangent = Math.tan((-pitch * Math.PI) / 180);
  return tangent > 1e-3 ? Math.min(most, Math.max(0, above) / tangent) : most;
}

// What the picture shows of the ground, roughly: the camera's foot and the far edge.
export function wedge(pose: Pose, aspect: number, above: number, most: number): LatLngTuple[] {
  const half = pose.fov / 2;
  const sides = (Math.atan(Math.tan((half * Math.PI) / 180) * aspect) * 180) / Math.PI;
  const top = pose.pitch + half;
  const far = top > -WEDGE_PITCH_DEG ? most : Math.max(WEDGE_LEAST_M, reach(above, top, most));
  const out: LatLngTuple[] = [[pose.lat, pose.lon]];
  for (let i = -ARC_STEPS; i <= ARC_STEPS; i++) {
    const turn = (sides * i) / ARC_STEPS;
    const edge = far / Math.cos((Math.min(Math.abs(turn), 75) * Math.PI) / 180);
    out.push(along(pose, pose.heading + turn, Math.min(most, edge)));
  }
  return out;
}

// Tiles that are fetched, not linked as images: the page's policy lets pictures come from its own host
// alone, and what the server refuses must not show as a broken image.
class FetchedTiles extends GridLayer {
  private readonly running = new WeakMap<HTMLElement, AbortController>();

  constructor(
    private readonly source: MapSource,
    options: GridLayerOptions,
  ) {
    super({ ...options, maxNativeZoom: source.maxZoom, maxZoom: ZOOM_MOST } as GridLayerOptions);
    this.on("tileunload", ({ tile }) => this.running.get(tile as HTMLElement)?.abort());
  }

  protected override createTile(at: Coords, done: DoneCallback): HTMLElement {
    const canvas = document.createElement("canvas");
    canvas.width = canvas.height = TILE_PX;
    const stop = new AbortController();
    this.running.set(canvas, stop);
    void this.paint(canvas, at, stop.signal).then(
      () => done(undefined, canvas),
      (error: unknown) => done(error instanceof Error ? error : new Error(String(error)), canvas),
    );
    return canvas;
  }

  private async paint(canvas: HTMLCanvasElement, { x, y, z }: Coords, signal: AbortSignal) {
    const numbers: Record<string, number> = { x, y, z };
    const url = this.source.tiles.replace(/\{([xyz])\}/g, (_, axis: string) => String(numbers[axis]));
    const bytes = await this.source.fetch(url, signal);
    const image = await createImageBitmap(new Blob([bytes]));
    canvas.getContext("2d")?.drawImage(image, 0, 0, TILE_PX, TILE_PX);
    image.close();
  }
}

export interface MiniMapOptions {
  bounds: LatLngBoundsLiteral; // of the city
  own: MapSource | null; // map tiles of the city
  base: MapSource | null; // below them
  attribution: string; // of the base, as text
  texts: { zoomIn: string; zoomOut: string };
  still: boolean; // no animation
  camera: LatLngTuple; // seen as well at first
}

export class MiniMap {
  onChoose: (place: { lon: number; lat: number }) => void = () => {};
  private readonly map: LeafletMap;
  private readonly city: LatLngBounds;
  private readonly over = layerGroup();
  private fitted = 0; // the zoom that fit() found

  constructor(
    box: HTMLElement,
    { bounds, own, base, attribution, texts, still, camera }: MiniMapOptions,
  ) {
    this.map = new LeafletMap(box, {
      attributionControl: false,
      zoomControl: false,
      zoomSnap: 0.25,
      zoomDelta: 1,
      zoomAnimation: !still,
      fadeAnimation: !still,
      markerZoomAnimation: !still,
      inertia: !still,
      maxZoom: base ? ZOOM_MOST : Math.min(ZOOM_MOST, (own?.maxZoom ?? 19) + BLURRED_ZOOMS),
    });
    control.zoom({ zoomInTitle: texts.zoomIn, zoomOutTitle: texts.zoomOut }).addTo(this.map);
    if (base) {
      new FetchedTiles(base, { className: "base" }).addTo(this.map);
      const credit = document.createElement("span");
      credit.textContent = attribution;
      if (attribution) control.attribution({ prefix: false }).addAttribution(credit.innerHTML).addTo(this.map);
    }
    if (own) new FetchedTiles(own, { bounds, className: "own" }).addTo(this.map);
    rectangle(bounds, { className: "extent", interactive: false, fill: false }).addTo(this.map);
    this.over.addTo(this.map);
    this.city = latLngBounds(bounds);
    this.fit(camera);
    this.map.on("click", ({ latlng }) => this.onChoose({ lon: latlng.lng, lat: latlng.lat }));
  }

  // The city and the camera.
  private fit(camera: LatLngTuple) {
    const all = this.city.pad(0).extend(camera);
    this.map.fitBounds(all, { animate: false, padding: [EDGE_PX, EDGE_PX] });
    this.fitted = this.map.getZoom();
  }

  // The camera came back from afar, and nobody chose this zoom.
  private isSmall(camera: LatLngTuple): boolean {
    const { map, city } = this;
    const zoom = map.getBoundsZoom(city.pad(0).extend(camera), false, point(2 * EDGE_PX, 2 * EDGE_PX));
    return map.getZoom() === this.fitted && zoom > this.fitted + SMALL_ZOOMS;
  }

  // The camera and what it sees. The map follows where the camera leaves it.
  show(pose: Pose, corners: LatLngTuple[], label: string) {
    this.over.clearLayers();
    polygon(corners, { className: "wedge", interactive: false }).addTo(this.over);
    circleMarker([pose.lat, pose.lon], { className: "camera", radius: 6, interactive: false }).addTo(this.over);
    this.map.getContainer().setAttribute("aria-label", label);
    const at: LatLngTuple = [pose.lat, pose.lon];
    if (this.isSmall(at)) this.fit(at);
    else if (this.city.contains(at)) this.map.panInside(at, { padding: [EDGE_PX, EDGE_PX], animate: false });
    else if (!this.map.getBounds().contains(at)) this.fit(at);
  }

  resize() {
    this.map.invalidateSize({ animate: false });
  }

  dispose() {
    this.map.remove();
  }
}
