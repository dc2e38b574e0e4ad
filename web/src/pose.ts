// A camera as maps give it: a place on WGS 84 (degrees, height as the data have it), a heading clockwise from
// north, a pitch above the horizon and a vertical field of view; heading and pitch are measured in the horizon
// at the camera.
//
// SPDX-License-Identifier: Apache-2.0

// A place of the data.
export interface Place {
  lon: number; // degrees
  lat: number; // degrees
  h: number; // metres, as the data have them
}

// A camera.
export interface Pose extends Place {
  heading: number; // degrees, clockwise from north
  pitch: number; // degrees above the horizon
  fov: number; // degrees, vertical
}

export const FOV_DEG = 45; // of the viewer, where nothing else is said
const FOV_DEFAULT = 60; // of the server's static views

// "lon,lat,h@heading,pitch,fov", as in the server's static views.
export function formatPose(pose: Pose): string {
  const { lon, lat, h, heading, pitch, fov } = pose;
  const turn = heading.toFixed(3) === "360.000" ? "0.000" : heading.toFixed(3);
  return `${lon.toFixed(7)},${lat.toFixed(7)},${h.toFixed(2)}@${turn},${pitch.toFixed(3)},${fov.toFixed(1)}`;
}

// fov may be left out: the server's default then.
export function parsePose(text: string): Pose | null {
  const [place = "", turn = "", ...rest] = text.split("@");
  const number = (v: string) => (v.trim() === "" ? NaN : Number(v));
  const [lon = NaN, lat = NaN, h = NaN, ...more] = place.split(",").map(number);
  const [heading = NaN, pitch = NaN, fov = FOV_DEFAULT, ...others] = turn.split(",").map(number);
  const numbers = [lon, lat, h, heading, pitch, fov];
  if (rest.length || more.length || others.length || !numbers.every(Number.isFinite)) return null;
  if (Math.abs(lon) > 180 || Math.abs(lat) > 90 || Math.abs(pitch) > 90 || fov < 1 || fov > 160)
    return null;
  return { lon, lat, h, heading, pitch, fov };
}

export const EYES_M = 1.7; // above the ground, of somebody on foot

// How a person moves the camera.
export type Walk = "orbit" | "fly" | "walk";
