// What somebody tells of a city: views in order, and notes at places. As a file: {"type": "citysplat-tour", "views": [{"name",
// "view", "seconds"}], "notes": [{"lon", "lat", "h", "text"}]}. In a link: the same as short JSON, deflated, in base64 of URLs. Both come from
// anybody, so everything is bounded, and texts are only ever text.
//
// SPDX-License-Identifier: Apache-2.0
import { parseView } from "./address";
import type { Place } from "./geo";

const VIEWS_MAX = 100;
const NOTES_MAX = 100;
export const TEXT_MAX = 200; // characters of a caption or a note
const FLY_S = 3;
const FLY_MAX_S = 60;
const HEIGHT_MAX_M = 20_000;
export const LINK_MAX = 4000; // characters in a link: mail and messengers break longer ones
const BYTES_MAX = 100_000; // of a link's JSON: a short text may inflate to anything

// A view of a tour, with its words.
export interface Stop {
  name: string; // also what is said there
  view: string; // as in the address bar
  seconds: number; // of the way there
}

// Words at a place.
export interface Note {
  // Where it stands.
  place: Place;
  // What it says.
  text: string;
}

// A tour: views and notes.
export interface Story {
  // In their order.
  views: Stop[];
  // At their places.
  notes: Note[];
}

export const isEmpty = ({ views, notes }: Story) => !views.length && !notes.length;

// One line, without marks that turn the direction of what follows.
const clean = (value: unknown) =>
  String(value ?? "")
    .replace(/[\p{Cc}\s\u202a-\u202e\u2066-\u2069]+/gu, " ")
    .trim()
    .slice(0, TEXT_MAX);

// Throws where the view cannot be read.
export function makeStop(name: unknown, view: unknown, seconds: unknown = FLY_S): Stop {
  if (typeof view !== "string" || !parseView(view)) throw new Error("a view cannot be read");
  const way = Number(seconds);
  return { name: clean(name) || view, view, seconds: Number.isFinite(way) ? Math.min(FLY_MAX_S, Math.max(0, way)) : FLY_S };
}

// Throws where the place is none, or nothing is said.
export function makeNote(lon: unknown, lat: unknown, h: unknown, text: unknown): Note {
  const place = { lon: Number(lon), lat: Number(lat), h: Number(h) };
  const within = Math.abs(place.lon) <= 180 && Math.abs(place.lat) <= 90 && Math.abs(place.h) <= HEIGHT_MAX_M;
  if (!within || !clean(text)) throw new Error("a note cannot be read");
  return { place, text: clean(text) };
}

// Throws when the text holds none.
export function parseStory(source: string): Story {
  const root = JSON.parse(source) as { type?: string; views?: Partial<Stop>[]; notes?: Record<string, unknown>[] };
  if (root?.type !== "citysplat-tour" || !Array.isArray(root.views ?? []) || !Array.isArray(root.notes ?? []))
    throw new Error("no tour");
  return {
    views: (root.views ?? []).slice(0, VIEWS_MAX).map(({ name, view, seconds }) => makeStop(name, view, seconds)),
    notes: (root.notes ?? []).slice(0, NOTES_MAX).map(({ lon, lat, h, text }) => makeNote(lon, lat, h, text)),
  };
}

export function formatStory({ views, notes }: Story): string {
  const flat = notes.map(({ place: { lon, lat, h }, text }) => ({ lon, lat, h, text }));
  return JSON.stringify({ type: "citysplat-tour", views, notes: flat }, null, 1);
}

async function pass(bytes: Uint8Array<ArrayBuffer>, through: CompressionStream | DecompressionStream): Promise<Uint8Array<ArrayBuffer>> {
  const reader = new Blob([bytes]).stream().pipeThrough(through).getReader();
  const parts: Uint8Array<ArrayBuffer>[] = [];
  let length = 0;
  for (let part = await reader.read(); !part.done; part = await reader.read()) {
    length += part.value.length;
    if (length > BYTES_MAX) {
      void reader.cancel();
      throw new Error("a tour of too many bytes");
    }
    parts.push(part.value);
  }
  return new Uint8Array(await new Blob(parts).arrayBuffer());
}

// For a link. "" for nothing; null for more than a link carries.
export async function packStory(story: Story): Promise<string | null> {
  if (isEmpty(story)) return "";
  const views = story.views.map(({ name, view, seconds }) => [name, view, seconds]);
  const notes = story.notes.map(({ place: { lon, lat, h }, text }) => [+lon.toFixed(7), +lat.toFixed(7), +h.toFixed(2), text]);
  const bytes = new TextEncoder().encode(JSON.stringify([views, notes]));
  if (bytes.length > BYTES_MAX) return null;
  const packed = await pass(bytes, new CompressionStream("deflate-raw"));
  const text = btoa(String.fromCharCode(...packed)).replaceAll("+", "-").replaceAll("/", "_").replaceAll("=", "");
  return text.length > LINK_MAX ? null : text;
}

// Throws when the link's text is none.
export async function unpackStory(text: string): Promise<Story> {
  if (text.length > LINK_MAX) throw new Error("a tour of too many characters");
  const raw = atob(text.replaceAll("-", "+").replaceAll("_", "/"));
  const bytes = await pass(Uint8Array.from(raw, (c) => c.charCodeAt(0)), new DecompressionStream("deflate-raw"));
  const [views, notes] = JSON.parse(new TextDecoder().decode(bytes)) as [unknown[][], unknown[][]];
  return {
    views: views.slice(0, VIEWS_MAX).map(([name, view, seconds]) => makeStop(name, view, seconds)),
    notes: notes.slice(0, NOTES_MAX).map(([lon, lat, h, said]) => makeNote(lon, lat, h, said)),
  };
}
