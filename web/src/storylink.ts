// Whether there is a tour, before the code for it is asked for: most pages have none.
//
// SPDX-License-Identifier: Apache-2.0
import type { Viewer } from "./viewer";

// Behind the view: "#lon,lat,...&story=TEXT". null where the address has none.
export function storyOf(hash: string): string | null {
  return /&story=([\w-]+)/.exec(hash)?.[1] ?? null;
}

export const storyKey = (viewer: Viewer) => `citysplat.tour.${viewer.scene?.id ?? ""}`;

export function isStoryKept(viewer: Viewer): boolean {
  try {
    return localStorage.getItem(storyKey(viewer)) !== null;
  } catch {
    return false;
  }
}
