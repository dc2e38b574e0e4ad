// A view as text: "lon,lat,h,heading,pitch,appearance", what the address bar holds behind the "#", before any "&".
// Links with "#camera=lon,lat,h@heading,pitch,fov" keep working.
//
// SPDX-License-Identifier: Apache-2.0
import { FOV_DEG, parsePose, type Pose } from "./pose";

// What lies over the view, to be compared with it: ?compare=SCENE&wipe=65, ?compare=SCENE&fade=35, and "swap".
export interface Comparison {
  scene: string; // "" for the server's drawing of the view
  by: "wipe" | "fade";
  percent: number; // wipe: of the width, where the line is; fade: how much of it is to be seen
  swapped: boolean; // it lies on the left, or is seen at 0
}

// Another appearance right of a line: ?second=PHOTOGRAPH&split=48, percent of the width.
export interface SecondLight {
  appearance: string;
  percent: number;
}

const MIDDLE = 50;

function percentOf(query: URLSearchParams, name: string): number {
  const text = query.get(name) ?? "";
  const percent = text.trim() === "" ? NaN : Number(text);
  return percent >= 0 && percent <= 100 ? percent : MIDDLE;
}

const digits = (percent: number) => String(Number(percent.toFixed(2)));

// null where the link compares nothing.
export function parseComparison(query: URLSearchParams): Comparison | null {
  const scene = query.get("compare");
  if (scene === null) return null;
  const by = query.has("fade") ? "fade" : "wipe";
  return { scene, by, percent: percentOf(query, by), swapped: query.has("swap") };
}

export function writeComparison(query: URLSearchParams, how: Comparison | null) {
  for (const name of ["compare", "wipe", "fade", "swap"]) query.delete(name);
  if (!how) return;
  query.set("compare", how.scene);
  query.set(how.by, digits(how.percent));
  if (how.swapped) query.set("swap", "");
}

export function parseSecondLight(query: URLSearchParams): SecondLight | null {
  const appearance = query.get("second");
  return appearance === null ? null : { appearance, percent: percentOf(query, "split") };
}

export function writeSecondLight(query: URLSearchParams, second: SecondLight | null) {
  for (const name of ["second", "split"]) query.delete(name);
  if (!second) return;
  query.set("second", second.appearance);
  query.set("split", digits(second.percent));
}

export interface View {
  pose: Pose;
  appearance: string; // "" for the default one
}

// Digits that name the view to a millimetre on the ground and to a hundredth of a pixel.
export function formatView({ pose, appearance }: View): string {
  const { lon, lat, h, heading, pitch, fov } = pose;
  const turn = heading.toFixed(2) === "360.00" ? "0.00" : heading.toFixed(2);
  const parts = [lon.toFixed(7), lat.toFixed(7), h.toFixed(2), turn, pitch.toFixed(2)];
  const wide = Math.abs(fov - FOV_DEG) > 0.05;
  if (appearance || wide) parts.push(encodeURIComponent(appearance));
  if (wide) parts.push(fov.toFixed(1));
  return parts.join(",");
}

// null when the text is not a view. A view of the open sky, from below the ground or far away is one.
export function parseView(hash: string): View | null {
  const text = hash.replace(/^#/, "").split("&")[0]!;
  const old = /^camera=(.+)$/.exec(decode(text));
  if (old) {
    const pose = parsePose(old[1]!);
    return pose && { pose, appearance: "" };
  }
  const [lon, lat, h, heading, pitch, appearance = "", fov = String(FOV_DEG), ...rest] =
    text.split(",");
  const pose = parsePose(`${lon},${lat},${h}@${heading},${pitch},${fov}`);
  return pose && !rest.length ? { pose, appearance: decode(appearance) } : null;
}

function decode(text: string): string {
  try {
    return decodeURIComponent(text);
  } catch {
    return text;
  }
}
