// Heights along a measured path: asked of the server, which sees its finest tiles from straight above;
// without one, taken from the Gaussians that are drawn. Shown as a chart, saved as CSV or GeoJSON.
//
// SPDX-License-Identifier: Apache-2.0
import { download, element, setText } from "./dom";
import type { Place } from "./geo";
import { getLanguage, text } from "./strings";
import { formatLength } from "./units";
import type { Viewer } from "./viewer";

const SAMPLES = 300;
const LOCAL_SAMPLES = 160; // each asks all Gaussians that are drawn
const LOCAL_AT_A_TIME = 8;
const TIMEOUT_MS = 20_000;
const LEAST_PX = 240; // of the chart's width
const HEIGHT = 136; // of it, pixels
const LABEL_PX = 110; // a number below it, with room
const LEFT = 54;
const RIGHT = 12;
const TOP = 10;
const BOTTOM = 24;

export interface ProfilePoint {
  distance: number; // along the path, in the plan, metres
  lon: number;
  lat: number;
  h: number | null; // as the scene counts it; null where there is no surface
}
export interface Profile {
  points: ProfilePoint[];
  by: "server" | "browser";
}

export interface Heights {
  length: number;
  climb: number;
  fall: number;
  lowest: number;
  highest: number;
}

export function heightsOf(points: ProfilePoint[]): Heights | null {
  const known = points.filter((one) => one.h !== null).map((one) => one.h!);
  if (!known.length) return null;
  let climb = 0;
  let fall = 0;
  for (let i = 1; i < points.length; i++) {
    const [a, b] = [points[i - 1]!.h, points[i]!.h];
    if (a === null || b === null) continue;
    if (b > a) climb += b - a;
    else fall += a - b;
  }
  return {
    length: points.at(-1)!.distance,
    climb,
    fall,
    lowest: Math.min(...known),
    highest: Math.max(...known),
  };
}

// A step of 1, 2 or 5 times a power of ten that divides a span into about so many.
export function niceStep(span: number, count: number): number {
  const raw = Math.max(span, 1e-9) / count;
  const power = 10 ** Math.floor(Math.log10(raw));
  return power * ([1, 2, 5, 10].find((factor) => factor * power >= raw * 0.999) ?? 10);
}

// `heights` says what heights count from (SceneEntry.heights).
export function toCsv(points: ProfilePoint[], heights = ""): string {
  const rows = points.map(({ distance, lon, lat, h }) =>
    [distance.toFixed(3), lon.toFixed(8), lat.toFixed(8), h === null ? "" : h.toFixed(3), heights].join(","),
  );
  return ["distance_m,lon,lat,height_m,heights", ...rows, ""].join("\r\n"); // RFC 4180
}

// One line a stretch that has a surface (RFC 7946).
export function toGeoJson(points: ProfilePoint[], heights?: string): string {
  const lines: number[][][] = [];
  let line: number[][] = [];
  for (const { lon, lat, h } of [...points, { lon: 0, lat: 0, h: null }]) {
    if (h !== null) line.push([Number(lon.toFixed(8)), Number(lat.toFixed(8)), Number(h.toFixed(3))]);
    else {
      if (line.length > 1) lines.push(line);
      line = [];
    }
  }
  const { length = 0, ...rest } = heightsOf(points) ?? {};
  const values = Object.entries({ length, ...rest }).map(([key, v]) => [`${key}_m`, Number(v.toFixed(3))]);
  const feature = {
    type: "Feature",
    geometry: { type: "MultiLineString", coordinates: lines },
    properties: { heights, ...Object.fromEntries(values) } as Record<string, unknown>,
  };
  return JSON.stringify({ type: "FeatureCollection", features: [feature] }, null, 1);
}

// ---- where the heights come from ----

function planLength(viewer: Viewer, places: Place[]): number[] {
  const points = places.map((place) => viewer.stage.frame.pointOf(place));
  const out = [0];
  for (let i = 1; i < points.length; i++)
    out.push(out[i - 1]! + Math.hypot(points[i]!.x - points[i - 1]!.x, points[i]!.z - points[i - 1]!.z));
  return out;
}

async function askServer(viewer: Viewer, places: Place[], signal: AbortSignal): Promise<Profile | null> {
  const url = viewer.scene?.questions;
  if (!url || viewer.state.link === "away") return null;
  const length = planLength(viewer, places).at(-1)!;
  const body = JSON.stringify({
    line: places.map(({ lon, lat }) => [lon, lat]),
    step_m: Math.max(0.01, length / SAMPLES),
  });
  const both = AbortSignal.any([signal, AbortSignal.timeout(TIMEOUT_MS)]);
  const response = await fetch(new URL("profile", url), { method: "POST", body, signal: both });
  if (!response.ok) return null;
  type Sample = Record<"distance_m" | "lon" | "lat", number> & { height_m: number | null };
  const { samples } = (await response.json()) as { samples: Sample[] };
  const points = samples.map(({ distance_m, lon, lat, height_m }) => ({
    distance: distance_m,
    lon,
    lat,
    h: height_m,
  }));
  return points.length > 1 ? { points, by: "server" } : null;
}

async function sampleHere(viewer: Viewer, places: Place[], signal: AbortSignal): Promise<Profile> {
  const at = planLength(viewer, places);
  const length = at.at(-1)!;
  const points: ProfilePoint[] = [];
  for (let i = 0; i <= LOCAL_SAMPLES; i++) {
    const distance = (length * i) / LOCAL_SAMPLES;
    let leg = 1;
    while (leg < at.length - 1 && at[leg]! < distance) leg++;
    const [a, b] = [places[leg - 1]!, places[leg]!];
    const share = (distance - at[leg - 1]!) / Math.max(1e-9, at[leg]! - at[leg - 1]!);
    const place = {
      lon: a.lon + share * (b.lon - a.lon),
      lat: a.lat + share * (b.lat - a.lat),
    };
    points.push({ distance, ...place, h: viewer.heightOf(place) });
    if (i % LOCAL_AT_A_TIME === 0) await new Promise((done) => setTimeout(done));
    signal.throwIfAborted();
  }
  return { points, by: "browser" };
}

export async function findProfile(viewer: Viewer, places: Place[], signal: AbortSignal): Promise<Profile> {
  const served = await askServer(viewer, places, signal).catch(() => null);
  signal.throwIfAborted();
  return served ?? sampleHere(viewer, places, signal);
}

// ---- the chart ----

function svg(tag: string, attributes: Record<string, string | number>, content = ""): SVGElement {
  const node = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, String(value));
  if (content) node.textContent = content;
  return node;
}

export class ProfileChart {
  private profile: Profile | null = null;
  private chosen = 0;
  private marker = 0;
  private request = new AbortController();
  private width = LEAST_PX;
  private x = (_: number) => 0;
  private y = (_: number) => 0;

  constructor(private readonly viewer: Viewer) {
    const click = (id: string, run: () => void) => element(id).addEventListener("click", run);
    click("profile-close", () => this.close());
    click("profile-csv", () => this.save("csv", "text/csv", toCsv));
    click("profile-geojson", () => this.save("geojson", "application/geo+json", toGeoJson));
    const chart = element("profile-chart");
    chart.addEventListener("pointermove", (event) => this.point(event));
    chart.addEventListener("pointerdown", (event) => this.point(event));
    chart.addEventListener("keydown", (event) => this.key(event));
  }

  get isOpen(): boolean {
    return !element("profile").hidden;
  }

  // Of a path; what is shown stays until the new one is there.
  async show(places: Place[]) {
    this.request.abort();
    this.request = new AbortController();
    const { signal } = this.request;
    element("profile").hidden = false;
    setText("profile-text", text("profile.wait"));
    try {
      this.profile = await findProfile(this.viewer, places, signal);
    } catch (error) {
      if (!signal.aborted) setText("profile-text", String(error)); // else another path took its place, or it was closed
      return;
    }
    this.draw(planLength(this.viewer, places));
  }

  close() {
    this.request.abort();
    element("profile").hidden = true;
    this.profile = null;
    this.mark(null);
  }

  private save(ending: string, type: string, write: (points: ProfilePoint[], heights?: string) => string) {
    if (this.profile) download(`profile.${ending}`, type, write(this.profile.points, this.viewer.scene?.heights));
  }

  private draw(legs: number[]) {
    const { points, by } = this.profile!;
    const chart = element("profile-chart");
    const heights = heightsOf(points);
    chart.replaceChildren();
    if (!heights) {
      setText("profile-text", text("profile.none"));
      return;
    }
    const { length, climb, fall, lowest, highest } = heights;
    const values = {
      climb: formatLength(climb),
      fall: formatLength(fall),
      lowest: formatLength(lowest),
      highest: formatLength(highest),
    };
    setText("profile-text", `${text("profile.text", values)} · ${text(`profile.${by}`)}`);
    const step = niceStep(Math.max(1, highest - lowest), 3);
    const low = Math.floor(lowest / step) * step;
    const high = Math.max(low + step, Math.ceil(highest / step) * step);
    this.width = Math.max(LEAST_PX, chart.clientWidth);
    this.x = (d) => LEFT + ((this.width - LEFT - RIGHT) * d) / Math.max(length, 1e-9);
    this.y = (h) => TOP + ((HEIGHT - TOP - BOTTOM) * (high - h)) / (high - low);
    const root = svg("svg", { viewBox: `0 0 ${this.width} ${HEIGHT}`, "aria-hidden": "true" });
    root.append(...this.axes(low, high, step, length));
    for (const d of legs.slice(1, -1))
      root.append(svg("line", { class: "leg", x1: this.x(d), x2: this.x(d), y1: TOP, y2: HEIGHT - BOTTOM }));
    root.append(...this.lines(points));
    root.append(
      svg("line", { class: "cursor", y1: TOP, y2: HEIGHT - BOTTOM }),
      svg("circle", { class: "cursor", r: 4.5 }),
    );
    chart.append(root);
    chart.setAttribute("aria-valuemax", String(points.length - 1));
    this.choose(Math.floor(points.length / 2));
  }

  private axes(low: number, high: number, step: number, length: number): SVGElement[] {
    const number = new Intl.NumberFormat(getLanguage(), { maximumFractionDigits: 1 });
    const out: SVGElement[] = [];
    for (let h = low; h <= high + step / 2; h += step)
      out.push(
        svg("line", { class: "grid", x1: LEFT, x2: this.width - RIGHT, y1: this.y(h), y2: this.y(h) }),
        svg("text", { x: LEFT - 6, y: this.y(h) + 4, "text-anchor": "end" }, `${number.format(h)} m`),
      );
    const along = niceStep(length, this.width / LABEL_PX);
    for (let d = 0; d <= length * 1.0001; d += along) {
      const last = d + along > length * 1.0001;
      const anchor = d === 0 ? "start" : last && this.x(d) > this.width - 40 ? "end" : "middle";
      out.push(svg("text", { x: this.x(d), y: HEIGHT - 6, "text-anchor": anchor }, `${number.format(d)} m`));
    }
    return out;
  }

  // A line and the ground below it, with gaps where there is no surface.
  private lines(points: ProfilePoint[]): SVGElement[] {
    const out: SVGElement[] = [];
    const foot = HEIGHT - BOTTOM;
    let run: ProfilePoint[] = [];
    const end = () => {
      if (run.length > 1) {
        const path = run.map((p) => `${this.x(p.distance).toFixed(1)} ${this.y(p.h!).toFixed(1)}`).join("L");
        const [a, b] = [this.x(run[0]!.distance), this.x(run.at(-1)!.distance)];
        out.push(
          svg("path", { class: "fill", d: `M${a} ${foot}L${path}L${b} ${foot}Z` }),
          svg("path", { class: "line", d: `M${path}` }),
        );
      }
      run = [];
    };
    for (const point of points) {
      if (point.h === null) end();
      else run.push(point);
    }
    end();
    return out;
  }

  // ---- one of its points ----

  private point(event: PointerEvent) {
    if (!this.profile) return;
    const { left, width } = element("profile-chart").getBoundingClientRect();
    const across = ((event.clientX - left) / Math.max(1, width)) * this.width;
    const { points } = this.profile;
    const share = (across - LEFT) / (this.width - LEFT - RIGHT);
    this.choose(Math.round(share * (points.length - 1)));
  }

  private key(event: KeyboardEvent) {
    const step = { ArrowLeft: -1, ArrowRight: 1, ArrowDown: -1, ArrowUp: 1, PageDown: -20, PageUp: 20 }[event.key];
    const ends = { Home: -Infinity, End: Infinity }[event.key];
    if (step === undefined && ends === undefined) return;
    event.preventDefault();
    event.stopPropagation(); // the camera stays
    this.choose(this.chosen + (step ?? ends ?? 0));
  }

  private choose(index: number) {
    if (!this.profile) return;
    const { points } = this.profile;
    this.chosen = Math.max(0, Math.min(points.length - 1, index));
    const point = points[this.chosen]!;
    const where = { distance: formatLength(point.distance), height: point.h === null ? "–" : formatLength(point.h) };
    const said = text("profile.at", where);
    const chart = element("profile-chart");
    chart.setAttribute("aria-valuenow", String(this.chosen));
    chart.setAttribute("aria-valuetext", said);
    setText("profile-at", said);
    const [line, dot] = chart.querySelectorAll(".cursor");
    const x = this.x(point.distance).toFixed(1);
    for (const name of ["x1", "x2"]) line?.setAttribute(name, x);
    dot?.setAttribute("cx", x);
    dot?.setAttribute("cy", point.h === null ? "-20" : this.y(point.h).toFixed(1));
    this.mark(point.h === null ? null : { lon: point.lon, lat: point.lat, h: point.h });
  }

  private mark(place: Place | null) {
    const { overlay } = this.viewer;
    if (this.marker) overlay.remove(this.marker);
    this.marker = place ? overlay.add({ kind: "point", places: [place], color: "#ff5ea8" }) : 0;
  }
}
