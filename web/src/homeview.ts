// The view of a whole city: of some headings and angles the one that fills most of what is free, if it is not far from the
// usual one. Also of the small script that asks for the server's picture of it before all others: without libraries.
//
// SPDX-License-Identifier: Apache-2.0
import type { Area } from "./free";

const HEADING_DEG = 20;
const PITCH_DEG = -38;
const TILTS_DEG = [0, 5, 10, -7, -14, -22]; // that it may differ from these two,
const TURNS_DEG = Array.from({ length: 19 }, (_, i) => 5 * i - 45);
const TILT_COST = 0.006; // and what each degree costs of the share of the free part that the city fills
const TURN_COST = 0.003;
// Of the free part, on each side: a tenth of what is covered lies outside the outline; at the near side it is large.
const MARGIN = { x: 0.07, y: 0.16 };
const TALL_CUT = 0.26; // more at the sides of a part that is twice as high as wide: there the edge of the city is cut
const STEP = 1.08;

export type Point = readonly [x: number, y: number, z: number]; // east, up, south: metres

export interface HomeView {
  heading: number; // degrees
  pitch: number;
  position: Point;
}

// Of what a server tells of a city: four corners, each east and north of the origin, then the least and the greatest height.
export function cornersOfOutline(outline: readonly number[]): Point[] {
  return Array.from({ length: 8 }, (_, i) => [outline[2 * (i >> 1)]!, outline[i & 1 ? 9 : 8]!, -outline[2 * (i >> 1) + 1]!] as const);
}

interface Screen {
  free: Area; // what nothing of the page covers
  aspect: number;
  fov: number; // degrees, vertical
}

const dot = (a: Point, b: Point) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

// Within four percent: views of windows that differ so little are the same, and the server draws them once.
export function roughly(size: number): number {
  return STEP ** Math.round(Math.log(size) / Math.log(STEP));
}

// The nearest place from which all points are in the free part, in this direction; and how much of that part they span.
function fit(points: readonly Point[], heading: number, pitch: number, { free, aspect, fov }: Screen): { position: Point; share: number } {
  const [turn, tilt] = [(heading * Math.PI) / 180, (pitch * Math.PI) / 180];
  const [ch, sh, cp, sp] = [Math.cos(turn), Math.sin(turn), Math.cos(tilt), Math.sin(tilt)];
  const right: Point = [ch, 0, sh];
  const up: Point = [-sp * sh, cp, sp * ch];
  const ahead: Point = [cp * sh, sp, -cp * ch];
  const middleOf = (axis: 0 | 1 | 2) => {
    const along = points.map((point) => point[axis]);
    return (Math.min(...along) + Math.max(...along)) / 2;
  };
  const target: Point = [middleOf(0), middleOf(1), middleOf(2)];
  const corners = points.map((point) => {
    const corner: Point = [point[0] - target[0], point[1] - target[1], point[2] - target[2]];
    return { x: dot(corner, right), y: dot(corner, up), z: dot(corner, ahead) };
  });
  const { left, right: end, top, bottom } = free;
  const tanY = Math.tan((fov * Math.PI) / 360);
  const tanX = tanY * aspect;
  // From -1 to 1 across the surface, times the tangent: what a corner may have for each metre that it is away.
  const within = (from: number, to: number, tan: number, margin: number) => {
    const gap = margin * (to - from);
    return [tan * (2 * (from + gap) - 1), tan * (2 * (to - gap) - 1)] as const;
  };
  const tall = (bottom - top) / ((end - left) * aspect); // 1: as high as wide
  const [x0, x1] = within(left, end, tanX, MARGIN.x - TALL_CUT * Math.min(Math.max(tall - 1, 0), 1));
  const [y0, y1] = within(1 - bottom, 1 - top, tanY, MARGIN.y);
  // Where the camera may be across the view so that all corners are within: from the first to the second, if that is a span.
  const span = (axis: "x" | "y", low: number, high: number, away: number) =>
    [
      Math.max(...corners.map((corner) => corner[axis] - high * (corner.z + away))),
      Math.min(...corners.map((corner) => corner[axis] - low * (corner.z + away))),
    ] as const;
  const fits = (away: number) => {
    const [a, b] = span("x", x0, x1, away);
    const [c, d] = span("y", y0, y1, away);
    return a <= b && c <= d;
  };
  let near = Math.max(...corners.map(({ z }) => -z));
  let far = near + 1;
  while (!fits(far) && far < 1e8) far *= 2;
  for (let i = 0; i < 50; i++) {
    const middle = (near + far) / 2;
    if (fits(middle)) far = middle;
    else near = middle;
  }
  const middle = ([a, b]: readonly [number, number]) => (a + b) / 2;
  const x = middle(span("x", x0, x1, far));
  const y = middle(span("y", y0, y1, far));
  const spread = (axis: "x" | "y", at: number) => {
    const seen = corners.map((corner) => (corner[axis] - at) / (corner.z + far));
    return Math.max(...seen) - Math.min(...seen);
  };
  const along = (axis: 0 | 1 | 2) => target[axis] + x * right[axis] + y * up[axis] - far * ahead[axis];
  return { position: [along(0), along(1), along(2)], share: (spread("x", x) / (x1 - x0)) * (spread("y", y) / (y1 - y0)) };
}

export function homeView(points: readonly Point[], screen: Screen): HomeView {
  let best: HomeView = { heading: HEADING_DEG, pitch: PITCH_DEG, position: [0, 0, 0] };
  let most = 0;
  for (const tilt of TILTS_DEG)
    for (const turn of TURNS_DEG) {
      const [heading, pitch] = [HEADING_DEG + turn, PITCH_DEG + tilt];
      const { position, share } = fit(points, heading, pitch, screen);
      const worth = share * (1 - TILT_COST * Math.abs(tilt)) * (1 - TURN_COST * Math.abs(turn));
      if (worth <= most) continue;
      most = worth;
      best = { heading, pitch, position };
    }
  return best;
}
