// Before anything is painted: the page's colours, and the server's picture of the view that is to be seen first. A small
// script of its own, which the page waits for. The server tells where its pictures are, if it draws any, and where the city
// is. The viewer begins with the view of that picture.
//
// SPDX-License-Identifier: Apache-2.0
import { parseView } from "./address";
import { theme } from "./choices";
import type { Area } from "./free";
import { cornersOfOutline, homeView, type Point, roughly } from "./homeview";
import { FOV_DEG, formatPose, type Place } from "./pose";
import { posterSize } from "./postersize";

const root = document.documentElement;
root.dataset["theme"] = theme();

const RADIUS_M = 6378137;
const E2 = 0.00669437999014;

// A place by metres east, up and south of another, to a metre in a city: the viewer stands where this says.
function placeAt({ lon, lat, h }: Place, [east, up, south]: Point): Place {
  const [b, degrees] = [(lat * Math.PI) / 180, 180 / Math.PI];
  const flat = 1 - E2 * Math.sin(b) ** 2;
  const across = RADIUS_M / Math.sqrt(flat); // of curvature, and along the meridian
  const along = (across * (1 - E2)) / flat;
  return { lon: lon + (degrees * east) / (across + h) / Math.cos(b), lat: lat - (degrees * south) / (along + h), h: h + up + (east * east + south * south) / (2 * across) };
}

// What the page's panels will leave free of a window. There are none yet: style.css, which comes before this, knows.
function freeOf(width: number, height: number): Area {
  const [top = 0, right = 0, bottom = 0, left = 0] = getComputedStyle(root).getPropertyValue("--free").trim().split(" ").map(Number);
  return { left: left / width, right: 1 - right / width, top: top / height, bottom: 1 - bottom / height };
}

// The whole city; outline: four corners, each east and north of the place, then the least and the greatest height, metres.
function home(origin: string, outline: string): string {
  const [lon = 0, lat = 0, h = 0] = origin.split(",").map(Number);
  const points = cornersOfOutline(outline.split(",").map(Number));
  const [width, height] = [roughly(innerWidth), roughly(innerHeight)];
  const { heading, pitch, position } = homeView(points, { free: freeOf(width, height), aspect: width / height, fov: FOV_DEG });
  return formatPose({ ...placeAt({ lon, lat, h }, position), heading, pitch, fov: FOV_DEG });
}

const { still, origin, outline } = (document.currentScript as HTMLScriptElement).dataset; // a folder
const query = new URLSearchParams(location.search);
if (query.get("ui") === "off") root.dataset["ui"] = "off";
const here = !query.has("url") && !query.has("server"); // the city is this server's
if (here && still && origin && outline && innerWidth && innerHeight && query.get("backdrop") !== "off") {
  const view = parseView(location.hash);
  const pose = view ? formatPose(view.pose) : home(origin, outline);
  const appearance = view?.appearance || (query.get("appearance") ?? query.get("light") ?? "");
  const light = appearance && `&appearance=${encodeURIComponent(appearance)}`;
  const url = new URL(`${still}${pose}/${posterSize(innerWidth / innerHeight)}.jpg?background=sky${light}`, location.href).href;
  root.dataset["poster"] = url;
  root.style.setProperty("--poster", `url("${url}")`);
}
