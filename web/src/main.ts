// Starts the page: what the address asks for, the viewer, the controls around it. window.citysplat
// is there for tests and for people at the console.
//
// SPDX-License-Identifier: Apache-2.0
import { parseView } from "./address";
import { language, theme } from "./choices";
import { element } from "./dom";
import { Page } from "./page";
import "./style.css";
import { setLanguage } from "./strings";
import { createViewer, type Pose, type Viewer, type ViewerOptions, type ViewerState } from "./viewer";

interface Console {
  readonly viewer: Viewer;
  readonly state: ViewerState;
  readonly ready: boolean;
  readonly settled: boolean;
  readonly error: string | null;
  pose(): Pose;
  look(pose: Pose): void;
}
declare global {
  interface Window {
    citysplat: Console;
  }
}

// ?server=URL or ?url=TILESET, else what lies around the page: a server's catalogue in its folder,
// above it or at the root of the host, or an exported tileset beside it.
function places(query: URLSearchParams): string[] {
  const given = query.get("url") ?? query.get("server");
  if (given) return [given];
  const own = document.documentElement.dataset["source"];
  return own ? [own] : ["./", "../", "/", "./tileset.json"];
}

async function main() {
  const query = new URLSearchParams(location.search);
  await setLanguage(query.get("lang") ?? language());
  document.documentElement.dataset["theme"] = theme();
  if (query.get("ui") === "off") document.documentElement.dataset["ui"] = "off";
  const view = parseView(location.hash);
  const scene = query.get("scene") ?? query.get("ds");
  const memory = Number(query.get("memory"));
  const fade = query.get("crossfade");
  const thin = query.has("thin");
  const basemap = query.get("basemap");
  const options: ViewerOptions = {
    url: places(query),
    pose: view?.pose ?? null,
    appearance: view?.appearance || (query.get("appearance") ?? query.get("light") ?? ""),
    colours: query.get("colours") === "server" ? "server" : "here",
    mode: thin ? "pictures" : "auto",
    backdrop: query.get("backdrop") !== "off",
    ...(document.documentElement.dataset["poster"] ? { poster: document.documentElement.dataset["poster"] } : {}),
    basemap: basemap ? { tiles: basemap, attribution: query.get("credit") ?? "" } : null,
    ...(scene === null ? {} : { scene }),
    ...(fade === null ? {} : { fadeMs: Number(fade) }),
    ...(memory > 0 ? { memoryMb: memory } : {}),
  };
  const viewer = createViewer(element("view"), options);
  new Page(viewer);
  window.citysplat = {
    viewer,
    get state() {
      return viewer.state;
    },
    get ready() {
      return viewer.state.ready;
    },
    get settled() {
      return viewer.state.settled;
    },
    get error() {
      return viewer.state.error;
    },
    pose: () => viewer.pose,
    look: (pose) => viewer.lookAt(pose),
  };
}

void main();
