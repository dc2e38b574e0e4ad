// A view as text: "lon,lat,h,heading,pitch,appearance", what the address bar holds behind the "#".
// Links with "#camera=lon,lat,h@heading,pitch,fov" keep working.
//
// SPDX-License-Identifier: Apache-2.0
import { FOV_DEG, parsePose, type Pose } from "./pose";

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
  const text = hash.replace(/^#/, "");
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
