// Worker: keeps the centres of all Gaussians and returns those of the wanted tiles from far to near: by depth along
// the view, as they were trained and as the server draws them. By distance from the eye, ground seen aslant would cover
// what lies flat on it.
//
// SPDX-License-Identifier: Apache-2.0
// Seen from above: least and most x, least and most z.
export type Rectangle = readonly [number, number, number, number];

export type SortMessage =
  | { kind: "add"; block: number; first: number; centres: Float32Array<ArrayBuffer> }
  | { kind: "remove"; block: number }
  | {
      kind: "sort";
      ticket: number;
      blocks: number[];
      without: (Rectangle[] | null)[]; // of each block: Gaussians in these are left out
      before: (Rectangle[] | null)[] | null; // and were until a fade began that is under way
      eye: [number, number, number];
      ahead: [number, number, number];
      spare: Uint32Array<ArrayBuffer> | null; // an order that is not on the screen any more
    };
export interface SortReply {
  ticket: number;
  order: Uint32Array<ArrayBuffer>; // at least count long; top bits: 1 comes, 2 goes
  count: number;
  left: number; // Gaussians that others stand in for
}

const BUCKETS = 1 << 16;
const COMES = 1 << 30;
const GOES = 2 << 30;
const held = new Map<number, { first: number; centres: Float32Array<ArrayBuffer> }>();
const starts = new Uint32Array(BUCKETS + 1);
let depths = new Float32Array(0);
let indices = new Uint32Array(0);

function isIn(all: Rectangle[], x: number, z: number): boolean {
  return all.some(([left, right, far, near]) => x >= left && x <= right && z >= far && z <= near);
}

// A counting sort of depths: 65536 steps between the nearest and the farthest.
function sort(message: SortMessage & { kind: "sort" }): SortReply {
  const { blocks, without, before, eye, ahead, ticket } = message;
  let total = 0;
  for (const block of blocks) total += (held.get(block)?.centres.length ?? 0) / 3;
  if (depths.length < total) {
    depths = new Float32Array(Math.ceil(total * 1.25));
    indices = new Uint32Array(depths.length);
  }
  let n = 0;
  let nearest = Infinity;
  let farthest = 0;
  let left = 0;
  for (const [b, block] of blocks.entries()) {
    const own = held.get(block);
    if (!own) continue;
    const { centres, first } = own;
    const [out, was] = [without[b], before?.[b]];
    for (let i = 0, k = 0; k < centres.length; i++, k += 3) {
      const gone = out && isIn(out, centres[k]!, centres[k + 2]!);
      const fresh = before ? was && isIn(was, centres[k]!, centres[k + 2]!) : gone;
      if (gone && fresh) {
        left++;
        continue;
      }
      const x = centres[k]! - eye[0];
      const y = centres[k + 1]! - eye[1];
      const z = centres[k + 2]! - eye[2];
      const d = x * ahead[0] + y * ahead[1] + z * ahead[2];
      if (d <= 0) continue; // behind the camera
      depths[n] = d;
      indices[n++] = (first + i) | (gone ? GOES : fresh ? COMES : 0);
      if (d < nearest) nearest = d;
      if (d > farthest) farthest = d;
    }
  }
  const scale = (BUCKETS - 1) / Math.max(farthest - nearest, 1e-6);
  starts.fill(0);
  for (let i = 0; i < n; i++) starts[BUCKETS - (((depths[i]! - nearest) * scale) | 0)]!++;
  for (let b = 1; b <= BUCKETS; b++) starts[b]! += starts[b - 1]!;
  const order =
    message.spare && message.spare.length >= n
      ? message.spare
      : new Uint32Array(Math.ceil((n * 1.25) / 1024) * 1024 || 1024);
  for (let i = 0; i < n; i++) {
    const bucket = BUCKETS - 1 - (((depths[i]! - nearest) * scale) | 0);
    order[starts[bucket]!++] = indices[i]!;
  }
  return { ticket, order, count: n, left };
}

self.onmessage = ({ data }: MessageEvent<SortMessage>) => {
  if (data.kind === "add") held.set(data.block, data);
  else if (data.kind === "remove") held.delete(data.block);
  else {
    const reply = sort(data);
    self.postMessage(reply, { transfer: [reply.order.buffer] });
  }
};
