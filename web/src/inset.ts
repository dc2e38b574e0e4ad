// A small map beside the picture: where the camera is and what it looks at, from the server's own map
// tiles. A click flies there. Nothing of it is loaded before it is opened.
//
// SPDX-License-Identifier: Apache-2.0
import { Vector3 } from "three";

import { element, later, toast } from "./dom";
import type { Place } from "./geo";
import type { MapSource, MiniMap } from "./minimap";
import { text } from "./strings";
import type { Viewer } from "./viewer";

const EDGE_M = 5; // around the city
const LOOK_DOWN_DEG = -5; // flatter views are moved to the place, others look at it

export class Inset {
  private map: MiniMap | null = null;
  private module: typeof import("./minimap") | null = null;
  private ticket = 0;

  constructor(private readonly viewer: Viewer) {
    const click = (id: string, run: () => void) => element(id).addEventListener("click", run);
    click("map-button", () => this.toggle());
    click("inset-close", () => this.toggle());
    viewer.on("scene", () => this.isOpen && void this.open());
    viewer.on("move", () => this.follow());
    new ResizeObserver(() => this.map?.resize()).observe(element("inset-map"));
  }

  get isOpen(): boolean {
    return !element("inset").hidden;
  }

  toggle() {
    const open = !this.isOpen;
    element("inset").hidden = !open;
    element("map-button").setAttribute("aria-pressed", String(open));
    if (open) void this.open();
    else {
      this.close();
      element("map-button").focus();
    }
  }

  translate() {
    if (this.isOpen) void this.open();
  }

  private close() {
    this.ticket++;
    this.map?.dispose();
    this.map = null;
  }

  private async open() {
    this.close();
    const ticket = this.ticket;
    const { viewer } = this;
    const parts = await later(Promise.all([import("./minimap"), this.ownTiles(), viewer.basemap()]));
    if (ticket !== this.ticket || !viewer.scene) return;
    if (!parts) return this.toggle(); // an empty map says nothing
    const [module, own, base] = parts;
    this.module = module;
    this.map = new module.MiniMap(element("inset-map"), {
      bounds: own?.bounds ?? this.extent(),
      own,
      base: base && { tiles: base.tiles, maxZoom: 19, fetch: fetchBytes },
      attribution: base?.attribution ?? "",
      texts: { zoomIn: text("tool.in"), zoomOut: text("tool.out") },
      camera: [viewer.pose.lat, viewer.pose.lon],
      still: matchMedia("(prefers-reduced-motion: reduce)").matches,
    });
    this.map.onChoose = (place) => this.goTo(place);
    this.follow();
  }

  // Map tiles of this scene, where the server has them.
  private async ownTiles(): Promise<(MapSource & { bounds: [[number, number], [number, number]] }) | null> {
    const { viewer } = this;
    const about = await viewer.mapTiles();
    if (!about) return null;
    const [west, south, east, north] = about.bounds;
    return {
      tiles: about.tiles,
      maxZoom: about.maxZoom,
      bounds: [
        [south, west],
        [north, east],
      ],
      fetch: (url, signal) => viewer.get(url, signal),
    };
  }

  private extent(): [[number, number], [number, number]] {
    const { stage } = this.viewer;
    const { min, max } = stage.extent;
    const a = stage.frame.placeOf(new Vector3(min.x - EDGE_M, stage.ground, max.z + EDGE_M));
    const b = stage.frame.placeOf(new Vector3(max.x + EDGE_M, stage.ground, min.z - EDGE_M));
    return [
      [a.lat, a.lon],
      [b.lat, b.lon],
    ];
  }

  // The farthest that anything of the city can be from the camera's foot, or nearly so.
  private get most(): number {
    const { extent, camera } = this.viewer.stage;
    const size = extent.getSize(new Vector3());
    const middle = extent.getCenter(new Vector3());
    const away = Math.hypot(middle.x - camera.position.x, middle.z - camera.position.z);
    return away + Math.hypot(size.x, size.z) / 2;
  }

  private follow() {
    const { map, module, viewer } = this;
    if (!map || !module) return;
    const { pose, stage } = viewer;
    const corners = module.wedge(pose, stage.camera.aspect, viewer.heightAboveGround, this.most);
    map.show(pose, corners, text("map.at", { heading: pose.heading.toFixed(0) }));
  }

  // What was looked at is now this place; who looks ahead stands there, who walks on the street next to it.
  private goTo(place: Pick<Place, "lon" | "lat">) {
    const { module, viewer } = this;
    if (!module) return;
    const { pose, stage } = viewer;
    if (stage.walk === "walk") {
      void stage.toStreet(stage.frame.pointOf({ ...place, h: pose.h })).then((there) => there || toast(text("walk.noStreet")));
      return;
    }
    const down = pose.pitch < LOOK_DOWN_DEG;
    const back = down ? module.reach(viewer.heightAboveGround, pose.pitch, this.most) : 0;
    const [lat, lon] = module.along(place, pose.heading + 180, back);
    void viewer.flyTo({ ...pose, lat, lon });
  }
}

async function fetchBytes(url: string, signal: AbortSignal): Promise<ArrayBuffer> {
  const response = await fetch(new URL(url, location.href), { signal, credentials: "omit" });
  if (!response.ok) throw new Error(`${response.status}`);
  return response.arrayBuffer();
}
