// Lengths and areas as texts, in the viewer's language.
//
// SPDX-License-Identifier: Apache-2.0
import type { Place } from "./pose";
import { getLanguage, text } from "./strings";

// The same everywhere: latitude first, labels, and above what the height is (SceneEntry.heights).
export function formatPlace({ lon, lat, h }: Place, heights: string, digits = 7): string {
  const ground = { lat: lat.toFixed(digits), lon: lon.toFixed(digits) };
  return text("place.text", { ...ground, h: h.toFixed(digits > 6 ? 2 : 1), above: aboveWhat(heights) });
}

// "20° N" of a heading: degrees clockwise from north, and the nearest of eight directions.
export function compass(heading: number): string {
  const names = text("compass").split(" ");
  return `${Math.round(heading) % 360}° ${names[Math.round(heading / 45) % 8]}`;
}

function aboveWhat(heights: string): string {
  if (heights.startsWith("EPSG:")) return text("height.system", { code: heights });
  if (heights.startsWith("sea")) return text("height.sea");
  if (heights === "takeoff") return text("height.takeoff");
  if (heights === "unscaled") return text("height.unscaled");
  return text(heights === "unknown" ? "height.unknown" : "height.ellipsoid");
}

// "1 June 2024", "1 June to 3 July 2024" of days that begin with the year; "" of none.
export function formatDays(first: string, last = first): string {
  const format = new Intl.DateTimeFormat(getLanguage(), { day: "numeric", month: "long", year: "numeric", timeZone: "UTC" });
  const [from, to] = [first, last].map((day) => Date.parse(`${day.slice(0, 10)}T12:00:00Z`));
  return Number.isFinite(from) && Number.isFinite(to) ? format.formatRange(from!, to!) : "";
}

export function formatLength(metres: number): string {
  const number = (value: number, digits: number) =>
    new Intl.NumberFormat(getLanguage(), { maximumFractionDigits: digits, minimumFractionDigits: digits }).format(value);
  return Math.abs(metres) >= 1000 ? `${number(metres / 1000, 3)} km` : `${number(metres, 2)} m`;
}

export function formatArea(squareMetres: number): string {
  const format = new Intl.NumberFormat(getLanguage(), { maximumFractionDigits: 1 });
  return squareMetres >= 1e6 ? `${format.format(squareMetres / 1e6)} km²` : `${format.format(squareMetres)} m²`;
}

// Three figures: errors are some per cent.
export function formatVolume(cubicMetres: number): string {
  const format = new Intl.NumberFormat(getLanguage(), { maximumSignificantDigits: 3 });
  return `${format.format(cubicMetres)} m³`;
}
