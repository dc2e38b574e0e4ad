// Lengths and areas as texts, in the viewer's language.
//
// SPDX-License-Identifier: Apache-2.0
import type { Place } from "./pose";
import { getLanguage, text } from "./strings";

// The same everywhere: latitude first, labels, and above what the height is.
export function formatPlace({ lon, lat, h }: Place, digits = 7): string {
  return text("place.text", { lat: lat.toFixed(digits), lon: lon.toFixed(digits), h: h.toFixed(digits > 6 ? 2 : 1) });
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
