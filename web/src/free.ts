// The part of the picture that panels leave free.
//
// SPDX-License-Identifier: Apache-2.0
export interface Area {
  left: number; // all from 0 to 1 of the whole
  right: number;
  top: number;
  bottom: number;
}

const COVERS = "#panel, #tools, #dock > :not(#banners, #toast)"; // what comes and goes does not move Home

// The largest rectangle that none of the covers touches: each side is the picture's or that of a cover.
export function largestFree(width: number, height: number, covers: readonly DOMRect[]): Area {
  let best: Area = { left: 0, right: 1, top: 0, bottom: 1 };
  let most = 0;
  const sides = (end: number, edges: number[]) => [...new Set([end, ...edges.filter((edge) => edge > 0)])];
  for (const left of sides(0, covers.map((one) => one.right)))
    for (const right of sides(width, covers.map((one) => one.left)))
      for (const top of sides(0, covers.map((one) => one.bottom)))
        for (const bottom of sides(height, covers.map((one) => one.top))) {
          const size = Math.max(0, right - left) * Math.max(0, bottom - top);
          if (size <= most || right > width || bottom > height) continue;
          if (covers.some((one) => one.left < right && one.right > left && one.top < bottom && one.bottom > top)) continue;
          most = size;
          best = { left: left / width, right: right / width, top: top / height, bottom: bottom / height };
        }
  return best;
}

// Of this page, as it is now.
export function freePart(): Area {
  const covers = [...document.querySelectorAll(COVERS)].map((node) => node.getBoundingClientRect());
  return largestFree(innerWidth, innerHeight, covers.filter(({ width, height }) => width > 0 && height > 0));
}
