// Where a tile is covered, as seen from straight above: a rectangle that is turned as the city's streets are. Home fills the
// screen with it, where a box along east and north has empty corners.
//
// SPDX-License-Identifier: Apache-2.0
const SAMPLES = 20_000;
const STRAYS = 0.01; // of the centres, beyond each side of the cells
const CELLS = 40; // a side; each counts once, however many Gaussians are in it: towers have most of them
const STEP_DEG = 5;
const EDGE = 0.05; // of the cells, beyond each side of the rectangle

// x and z of its four corners, one after the other around it.
export type Outline = [number, number, number, number, number, number, number, number];

// The shares `edge` and 1 - edge of values, which are sorted for it.
function span(values: Float32Array, edge: number): [number, number] {
  values.sort();
  const at = (share: number) => values[Math.round(share * (values.length - 1))]!;
  return [at(edge), at(1 - edge)];
}

// Middles of the cells that are covered: x, z of each.
function coveredCells(centres: Float32Array): Float32Array {
  const count = centres.length / 3;
  const step = Math.max(1, Math.floor(count / SAMPLES));
  const length = Math.ceil(count / step);
  const along = (axis: number) => Float32Array.from({ length }, (_, i) => centres[3 * i * step + axis]!);
  const [xs, zs] = [along(0), along(2)];
  const [[x0, x1], [z0, z1]] = [span(xs.slice(), STRAYS), span(zs.slice(), STRAYS)];
  const [dx, dz] = [Math.max((x1 - x0) / CELLS, 1e-6), Math.max((z1 - z0) / CELLS, 1e-6)];
  const covered = new Set<number>();
  for (let i = 0; i < length; i++) {
    const [a, b] = [Math.floor((xs[i]! - x0) / dx), Math.floor((zs[i]! - z0) / dz)];
    if (a >= 0 && b >= 0 && a < CELLS && b < CELLS) covered.add(b * CELLS + a);
  }
  return Float32Array.from([...covered].flatMap((cell) => [x0 + ((cell % CELLS) + 0.5) * dx, z0 + (Math.floor(cell / CELLS) + 0.5) * dz]));
}

// centres: x, y, z of each Gaussian.
export function findOutline(centres: Float32Array): Outline {
  const cells = coveredCells(centres);
  const length = cells.length / 2;
  const along = (dx: number, dz: number) =>
    span(Float32Array.from({ length }, (_, i) => dx * cells[2 * i]! + dz * cells[2 * i + 1]!), EDGE);
  let least = Infinity;
  let best: Outline = [0, 0, 0, 0, 0, 0, 0, 0];
  for (let degrees = 0; degrees < 90; degrees += STEP_DEG) {
    const [c, s] = [Math.cos((degrees * Math.PI) / 180), Math.sin((degrees * Math.PI) / 180)];
    const [u0, u1] = along(c, s);
    const [v0, v1] = along(-s, c);
    const area = (u1 - u0) * (v1 - v0);
    if (!(area < least)) continue;
    least = area;
    best = [[u0, v0], [u1, v0], [u1, v1], [u0, v1]].flatMap(([u, v]) => [c * u! - s * v!, s * u! + c * v!]) as Outline;
  }
  return best;
}
