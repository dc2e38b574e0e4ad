// A map of somebody else on the ground around the city: raster tiles of an address with {z}, {x}, {y}, where one is given.
// Nothing is asked of anybody else.
//
// SPDX-License-Identifier: Apache-2.0
import { Vector3 } from "three";

import type { Frame } from "./geo";
import type { Square } from "./groundmap";

export const BASE_PX = 1536; // of the picture, a side
const ACROSS = 6; // tiles of the picture, a side, at most
const ZOOM_MOST = 19;
const AT_ONCE = 6;
const TIMEOUT_MS = 20_000;
const BYTES_MOST = 4 << 20; // of a tile
const LAT_MOST = 85;

// Tiles by number, of a world that is 2^zoom of them wide.
export const tileX = (lon: number, zoom: number) => ((lon + 180) / 360) * 2 ** zoom;
export const tileY = (lat: number, zoom: number) => {
  const sine = Math.sin((lat * Math.PI) / 180);
  return (0.5 - Math.log((1 + sine) / (1 - sine)) / (4 * Math.PI)) * 2 ** zoom;
};
const lonOf = (x: number, zoom: number) => (x / 2 ** zoom) * 360 - 180;
const latOf = (y: number, zoom: number) => (Math.atan(Math.sinh(Math.PI * (1 - (2 * y) / 2 ** zoom))) * 180) / Math.PI;

export interface Piece {
  url: string;
  west: number;
  north: number;
  east: number;
  south: number;
}

// The tiles of an area, of the finest zoom at which they are few.
export function piecesOf(template: string, west: number, south: number, east: number, north: number): Piece[] {
  let zoom = ZOOM_MOST;
  const span = (z: number) => [
    Math.floor(tileX(west, z)),
    Math.floor(tileX(east, z)),
    Math.floor(tileY(Math.min(LAT_MOST, north), z)),
    Math.floor(tileY(Math.max(-LAT_MOST, south), z)),
  ] as const;
  const wide = ([x0, x1, y0, y1]: ReturnType<typeof span>) => Math.max(x1 - x0, y1 - y0) + 1;
  while (zoom > 0 && wide(span(zoom)) > ACROSS) zoom--;
  const [x0, x1, y0, y1] = span(zoom);
  const out: Piece[] = [];
  for (let y = y0; y <= y1; y++)
    for (let x = x0; x <= x1; x++) {
      const numbers: Record<string, number> = { x: ((x % 2 ** zoom) + 2 ** zoom) % 2 ** zoom, y, z: zoom };
      out.push({
        url: template.replace(/\{([xyz])\}/g, (_, axis: string) => String(numbers[axis])),
        ...{ west: lonOf(x, zoom), east: lonOf(x + 1, zoom), north: latOf(y, zoom), south: latOf(y + 1, zoom) },
      });
    }
  return out;
}

async function fetchTile(url: string, signal: AbortSignal): Promise<ImageBitmap> {
  const both = AbortSignal.any([signal, AbortSignal.timeout(TIMEOUT_MS)]);
  const response = await fetch(new URL(url, document.baseURI), { signal: both, credentials: "omit" });
  if (!response.ok) throw new Error(`${response.status}`);
  const blob = await response.blob();
  if (blob.size > BYTES_MOST) throw new Error("a tile of more than 4 MB");
  return createImageBitmap(blob);
}

// A picture of a square of the ground, north above; transparent where no tile came. null where none did.
export async function drawBasemap(
  template: string,
  { x, z, half }: Square,
  frame: Frame,
  signal: AbortSignal,
): Promise<HTMLCanvasElement | null> {
  const places = [-1, 1].flatMap((i) => [-1, 1].map((k) => frame.placeOf(new Vector3(x + i * half, 0, z + k * half))));
  const [lons, lats] = [places.map(({ lon }) => lon), places.map(({ lat }) => lat)];
  const pieces = piecesOf(template, Math.min(...lons), Math.min(...lats), Math.max(...lons), Math.max(...lats));
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = BASE_PX;
  const context = canvas.getContext("2d")!;
  const scale = BASE_PX / (2 * half);
  const at = (lon: number, lat: number) => {
    const point = frame.pointOf({ lon, lat, h: frame.placeOf(new Vector3(x, 0, z)).h });
    return [(point.x - x + half) * scale, (point.z - z + half) * scale] as const;
  };
  let drawn = 0;
  const queue = [...pieces];
  const work = async () => {
    for (let piece = queue.shift(); piece && !signal.aborted; piece = queue.shift()) {
      const image = await fetchTile(piece.url, signal).catch(() => null);
      if (!image) continue;
      const [left, top] = at(piece.west, piece.north);
      const [right, bottom] = at(piece.east, piece.south);
      context.drawImage(image, left, top, right - left + 0.5, bottom - top + 0.5);
      image.close();
      drawn++;
    }
  };
  await Promise.all(Array.from({ length: AT_ONCE }, work));
  return drawn && !signal.aborted ? canvas : null;
}
