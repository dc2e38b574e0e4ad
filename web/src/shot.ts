// Pictures of the view at any size: drawn by the server, in parts where they are larger than it draws
// at once, or by this browser. A file of its own, loaded when the first one is asked for.
//
// SPDX-License-Identifier: Apache-2.0
import { MathUtils, Matrix4, type PerspectiveCamera } from "three";

import type { City } from "./city";
import { describe } from "./link";
import { Problem } from "./problem";
import type { SceneEntry } from "./source";
import { text } from "./strings";

export const SIDE_MAX = 16_384;
const AREA_MAX = 200e6; // what canvases of browsers hold
const PART_SIDE = 2048; // what a server draws at once by default
const PART_AREA = 4e6;

// Formats of a picture.
export type ShotFormat = "jpg" | "png" | "webp";
// What a picture is to be.
export interface ShotOptions {
  // Pixels.
  width: number;
  // Pixels.
  height: number;
  format?: ShotFormat; // default: jpg
  background?: "sky" | "black" | "transparent"; // default: as on the screen; transparent: not in jpg
  by?: "server" | "browser"; // default: the server, where there is one that draws
  // Ends it early.
  signal?: AbortSignal;
  // Called as parts of the picture come.
  onPart?: (done: number, total: number) => void;
}

// A rectangle of the picture, in pixels.
export interface Part {
  x: number;
  y: number;
  width: number;
  height: number;
}

export function checkSize(width: number, height: number) {
  const whole = [width, height].every((side) => Number.isInteger(side) && side >= 16 && side <= SIDE_MAX);
  if (!whole || width * height > AREA_MAX)
    throw new Error(text("shot.size", { most: SIDE_MAX, area: AREA_MAX / 1e6 }));
}

// Parts of nearly one size, each small enough.
export function cutUp(width: number, height: number): Part[] {
  let columns = Math.ceil(width / PART_SIDE);
  let rows = Math.ceil(height / PART_SIDE);
  while (Math.ceil(width / columns) * Math.ceil(height / rows) > PART_AREA)
    if (width / columns > height / rows) columns++;
    else rows++;
  const edges = (size: number, n: number) => Array.from({ length: n + 1 }, (_, i) => Math.round((i * size) / n));
  const [across, down] = [edges(width, columns), edges(height, rows)];
  return across.slice(1).flatMap((right, c) =>
    down.slice(1).map((bottom, r) => ({
      x: across[c]!,
      y: down[r]!,
      width: right - across[c]!,
      height: bottom - down[r]!,
    })),
  );
}

// The camera of a part as the server takes it: x right, y down, z forward, from east-north-up metres.
/** @internal */
export function cameraOf(camera: PerspectiveCamera, width: number, height: number, part: Part) {
  const worldFromEnu = new Matrix4().set(1, 0, 0, 0, 0, 0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1);
  const view = camera.matrixWorld.clone().invert().multiply(worldFromEnu);
  const rows = new Matrix4().makeScale(1, -1, -1).multiply(view).transpose().toArray();
  const focal = height / 2 / Math.tan((camera.fov * MathUtils.DEG2RAD) / 2);
  return {
    width: part.width,
    height: part.height,
    fx: focal,
    fy: focal,
    cx: width / 2 - part.x,
    cy: height / 2 - part.y,
    world_to_camera: rows,
  };
}

async function ask(url: URL, body: unknown, signal: AbortSignal | null): Promise<Blob> {
  for (let attempt = 0; ; attempt++) {
    const response = await fetch(url, { method: "POST", body: JSON.stringify(body), signal });
    if (response.ok) return response.blob();
    const wait = Number(response.headers.get("retry-after"));
    const busy = response.status === 429 || (response.status === 503 && wait > 0);
    if (!busy || attempt >= 4)
      throw new Problem("http", { status: response.status, text: await describe(response) }, response.headers.get("x-request-id"));
    await new Promise((done) => setTimeout(done, 1000 * Math.min(10, Math.max(0.5, wait))));
    signal?.throwIfAborted();
  }
}

function encode(canvas: HTMLCanvasElement, format: ShotFormat): Promise<Blob> {
  const type = format === "jpg" ? "image/jpeg" : `image/${format}`;
  return new Promise((resolve, reject) =>
    canvas.toBlob((blob) => (blob?.type === type ? resolve(blob) : reject(new Error(text("shot.memory")))), type, 0.92),
  );
}

// render: where the server takes cameras.
async function drawByServer(
  render: URL,
  camera: PerspectiveCamera,
  appearance: string,
  { width, height, format = "jpg", background = "sky", signal, onPart }: ShotOptions,
): Promise<Blob> {
  const parts = cutUp(width, height);
  const whole = parts.length === 1;
  const shared = {
    format: whole ? format : "png",
    ...(appearance ? { appearance } : {}),
    ...(background === "black" ? {} : { background }),
    ...(whole && format !== "png" ? { quality: 92 } : {}),
  };
  const fetchPart = (part: Part) =>
    ask(render, { ...shared, camera: cameraOf(camera, width, height, part) }, signal ?? null);
  onPart?.(0, parts.length);
  if (whole) return fetchPart(parts[0]!);
  const canvas = document.createElement("canvas");
  Object.assign(canvas, { width, height });
  const pen = canvas.getContext("2d");
  if (!pen) throw new Error(text("shot.memory"));
  for (const [i, part] of parts.entries()) {
    const bitmap = await createImageBitmap(await fetchPart(part));
    pen.drawImage(bitmap, part.x, part.y);
    bitmap.close();
    onPart?.(i + 1, parts.length);
  }
  return encode(canvas, format);
}

// What a picture is taken of, and who can draw it.
/** @internal */
export interface ShotView {
  scene: SceneEntry | null;
  camera: PerspectiveCamera;
  city: City | null;
  canvas: HTMLCanvasElement; // on which it draws
  appearance: string;
}

// By the server, in parts where it draws smaller ones only, or by this browser. Rejects with why not.
/** @internal */
export async function takeShot(view: ShotView, options: ShotOptions): Promise<Blob> {
  const { width, height, format = "jpg" } = options;
  checkSize(width, height);
  const { scene, camera, city } = view;
  const background = options.background ?? (city?.backdrop.visible ? "sky" : "black");
  const by = options.by ?? (scene?.questions ? "server" : "browser");
  if (by === "server") {
    if (!scene?.questions) throw new Problem("noPictures");
    camera.updateMatrixWorld();
    return drawByServer(new URL("render", scene.questions), camera, view.appearance, { ...options, background });
  }
  if (!city) throw new Problem("noPictures");
  return city.drawOnce(width, height, background === "sky", () => encode(view.canvas, format));
}
