// Places, lengths and areas in the city: click points, read, copy, save as GeoJSON.
//
// SPDX-License-Identifier: Apache-2.0
import { Vector3 } from "three";

import { copy, download, element, later, setText, toast } from "./dom";
import type { Frame, Place } from "./geo";
import type { Shape } from "./overlay";
import type { ProfileChart } from "./profile";
import { text } from "./strings";
import { formatArea, formatLength, formatPlace, formatVolume } from "./units";
import { askVolume, type Volume } from "./volume";
import type { Viewer } from "./viewer";

type Kind = "path" | "area";

export interface Measures {
  length: number; // along the points, in space; of an area: around it
  straight: number; // from the first point to the last
  rise: number; // of the last above the first
  area: number; // m2, seen from above
}

export function measure(points: Vector3[], kind: Kind): Measures {
  const around = kind === "area" && points.length > 2 ? [...points, points[0]!] : points;
  let length = 0;
  for (let i = 1; i < around.length; i++) length += around[i - 1]!.distanceTo(around[i]!);
  let twice = 0;
  points.forEach((p, i) => {
    const q = points[(i + 1) % points.length]!;
    twice += p.x * q.z - q.x * p.z;
  });
  const [first, last] = [points[0], points.at(-1)];
  return {
    length,
    straight: first && last ? first.distanceTo(last) : 0,
    rise: first && last ? last.y - first.y : 0,
    area: Math.abs(twice) / 2,
  };
}

// RFC 7946: longitude, latitude, height as the scene counts it; `heights` says from what (SceneEntry.heights).
export function toGeoJson(places: Place[], kind: Kind, values: Measures, heights?: string, volume: Volume | null = null): string {
  const at = places.map(({ lon, lat, h }) => [
    Number(lon.toFixed(8)),
    Number(lat.toFixed(8)),
    Number(h.toFixed(3)),
  ]);
  const geometry =
    kind === "area" && at.length > 2
      ? { type: "Polygon", coordinates: [[...at, at[0]!]] }
      : at.length > 1
        ? { type: "LineString", coordinates: at }
        : { type: "Point", coordinates: at[0] };
  const rounded = Object.fromEntries(
    Object.entries(values).map(([key, value]) => [`${key}_m${key === "area" ? "2" : ""}`, Number((value as number).toFixed(3))]),
  );
  for (const [key, value] of Object.entries(volume ?? {})) rounded[`volume_${key}_m3`] = value as number;
  const feature = { type: "Feature", geometry, properties: { heights, ...rounded } };
  return JSON.stringify({ type: "FeatureCollection", features: [feature] }, null, 1);
}

export class MeasureTool {
  open = false;
  private places: Place[] = [];
  private before: Place[] = []; // those before the last click
  private shapes: number[] = []; // what is measured, and a label for each part of it
  private marker = 0;
  private place: Place | null = null;
  private volume: Volume | null = null; // of the area, by the server
  private asking = new AbortController();
  private profile: ProfileChart | null = null; // comes when it is asked for

  constructor(private readonly viewer: Viewer) {
    viewer.on("click", ({ place }) => {
      this.before = this.places;
      if (this.open) this.add(place);
      else this.tell(place);
    });
    viewer.on("unclick", () => {
      if (!this.open) this.tell(null, true);
      else if (this.places !== this.before) this.set(this.before);
    });
    const click = (id: string, run: () => void) => element(id).addEventListener("click", run);
    click("measure-button", () => this.show(!this.open));
    click("measure-close", () => this.show(false));
    click("measure-undo", () => this.set(this.places.slice(0, -1)));
    click("measure-clear", () => this.set([]));
    click("measure-copy", () => void copy(this.summary(), text("place.copied")));
    click("measure-save", () => this.save());
    click("measure-profile", () => void this.showProfile());
    click("measure-volume", () => void this.findVolume());
    click("place-close", () => this.tell(null, true));
    click("place-copy", () => {
      if (this.place) void copy(this.where(this.place), text("place.copied"));
    });
    for (const radio of document.querySelectorAll('input[name="measure"]'))
      radio.addEventListener("change", () => this.set(this.places));
    viewer.on("scene", () => {
      this.set([]);
      this.tell(null, true);
    });
  }

  show(open: boolean) {
    this.open = open;
    element("measure").hidden = !open;
    element("measure-button").setAttribute("aria-pressed", String(open));
    this.tell(null, true);
    if (!open) this.set([]);
  }

  private get kind(): Kind {
    return document.querySelector<HTMLInputElement>('input[name="measure"]:checked')!.value as Kind;
  }

  private frame(): Frame {
    return this.viewer.stage.frame;
  }

  private tell(place: Place | null, close = false) {
    this.place = place;
    element("place").hidden = close;
    element("place-copy").hidden = !place;
    setText("place-text", place ? this.words(place) : text("place.none"));
    if (this.marker) this.viewer.overlay.remove(this.marker);
    this.marker = place
      ? this.viewer.overlay.add({ kind: "point", places: [place], color: "#ff5ea8" })
      : 0;
  }

  private words(place: Place): string {
    const up = this.viewer.aboveGround(place);
    return up === null ? this.where(place) : text("place.up", { place: this.where(place), up: up.toFixed(0) });
  }

  private where(place: Place): string {
    return formatPlace(place, this.viewer.scene?.heights ?? "");
  }

  private add(place: Place | null) {
    if (place) this.set([...this.places, place]);
  }

  private set(places: Place[]) {
    this.places = places;
    this.asking.abort();
    this.volume = null;
    const { overlay } = this.viewer;
    for (const shape of this.shapes) overlay.remove(shape);
    this.shapes = places.length ? this.drawn(places).map((shape) => overlay.add(shape)) : [];
    const line = this.kind === "path" && places.length > 1;
    element<HTMLButtonElement>("measure-profile").disabled = !line;
    if (!line) this.profile?.close();
    else if (this.profile?.isOpen) void this.profile.show(places);
    setText("measure-text", places.length > 1 ? this.summary() : text("measure.hint"));
    const area = this.kind === "area" && places.length > 2;
    element("measure-volume").hidden = !area || !this.viewer.scene?.questions;
  }

  private async showProfile() {
    const module = await later(import("./profile"));
    if (!module) return;
    this.profile ??= new module.ProfileChart(this.viewer);
    await this.profile.show(this.places);
  }

  // Above and below the plane of the rim, by the server.
  private async findVolume() {
    this.asking.abort();
    this.asking = new AbortController();
    const { signal } = this.asking;
    const answer = await askVolume(this.viewer, this.places, signal);
    if (signal.aborted) return;
    if (typeof answer === "string") return toast(answer);
    this.volume = answer;
    setText("measure-text", this.summary());
  }

  // The path or area with its sum; of more than one part each with its length, in the middle; every point.
  private drawn(places: Place[]): Shape[] {
    const closed = this.kind === "area" && places.length > 2;
    const kind = places.length === 1 ? "point" : this.kind === "area" ? "area" : "line";
    const whole: Shape = { kind, places, ...(places.length > 1 && (closed || places.length === 2) ? { label: this.summary(true) } : {}) };
    if (places.length < 3) return [whole];
    const frame = this.frame();
    const points = places.map((place) => frame.pointOf(place));
    const ends = closed ? [...points.slice(1), points[0]!] : points.slice(1);
    const parts = ends.map((end, i): Shape => {
      const middle = frame.placeOf(points[i]!.clone().lerp(end, 0.5));
      return { kind: "label", places: [middle], label: formatLength(points[i]!.distanceTo(end)) };
    });
    return [whole, ...parts];
  }

  private values(): Measures {
    return measure(
      this.places.map((place) => this.frame().pointOf(place)),
      this.kind,
    );
  }

  private summary(brief = false): string {
    const { length, straight, rise, area } = this.values();
    const closed = this.kind === "area" && this.places.length > 2;
    if (brief) return closed ? formatArea(area) : formatLength(length);
    if (closed) {
      const plan = text("measure.area.text", { area: formatArea(area), length: formatLength(length) });
      const { volume } = this;
      if (!volume) return plan;
      const [above, below, error] = [volume.above, volume.below, volume.error].map(formatVolume);
      return `${plan}, ${text("measure.volume.text", { above: above!, below: below!, error: error! })}`;
    }
    return text("measure.path.text", {
      length: formatLength(length),
      straight: formatLength(straight),
      rise: formatLength(rise),
    });
  }

  private save() {
    if (!this.places.length) return;
    const saved = toGeoJson(this.places, this.kind, this.values(), this.viewer.scene?.heights, this.volume);
    download("measure.geojson", "application/geo+json", saved);
  }
}
