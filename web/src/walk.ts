// On foot: where a street is, how high it lies, and what stands in the way. All of it comes from the Gaussians that are
// drawn, so it is the surface that the server's /height tells.
//
// SPDX-License-Identifier: Apache-2.0
import { Ray, Vector3 } from "three";

import type { Block } from "./block";
import { Columns, gather, gatherBySteps, pickIn, type Cloud } from "./pick";
import { EYES_M } from "./pose";

const STEP_UP_M = 0.6; // that legs take,
const STEP_DOWN_M = 2.5; // and that they dare
const BODY_M = 0.4; // from eyes to a wall at least
const BODY_UP_M = [0.8, 1.6]; // where a body meets what stands there
const STRIDE_M = 0.4; // what lies on the way is looked at so often
const BESIDE_M = 0.25; // of the way, where a wall is looked at for its direction,
const WALL_MOST_M = 3; // and how far on it is the same wall
const HEAD_ON = 0.2; // of a stride along the wall: less is a stop
const REACH_M = 30; // around somebody who walks,
const AGAIN_M = 10; // and how far he goes in that
const FINE_PER_M = 0.002; // of a ray, as a pixel at one metre
const TASK_MS = 30; // of the search for a street, without a pause for the page
// Where a street is looked for: a close grid and a wide one, both about the middle of the view.
const GRIDS_M = [
  { step: 2.5, count: 9 },
  { step: 10, count: 13 },
];
// A street is level within these metres, and no place around lies much lower than a slope would bring it: else it is a roof.
const LEVEL_WITHIN_M = 1.5;
const LEVEL_M = 0.35;
const ABOVE_M = 1.2;
const SLOPE = 0.15;

const DOWN = new Vector3(0, -1, 0);

export class Walker {
  private near: Cloud | null = null;
  private key = ""; // of the blocks that it is of
  private readonly at = new Vector3();

  constructor(private readonly blocks: () => readonly Block[]) {}

  // What stands around a place.
  private around({ x, z }: Vector3): Cloud {
    const blocks = this.blocks();
    const key = blocks.map(({ id }) => id).join();
    const there = this.near && key === this.key && Math.hypot(x - this.at.x, z - this.at.z) < AGAIN_M;
    if (there) return this.near!;
    this.key = key;
    this.at.set(x, 0, z);
    return (this.near = gather(blocks, x, z, REACH_M));
  }

  private heightIn(cloud: Cloud, x: number, from: number, z: number): number | null {
    return pickIn([cloud], new Ray(new Vector3(x, from, z), DOWN), FINE_PER_M)?.y ?? null;
  }

  // The street nearest to a place; null where there is none near by. top: above all of the city. The page goes on meanwhile.
  async street(middle: Vector3, top: number): Promise<Vector3 | null> {
    const steps = this.streetBySteps(middle, top);
    for (let since = performance.now(); ; ) {
      const { done, value } = steps.next();
      if (done) return value;
      if (performance.now() - since < TASK_MS) continue;
      await new Promise((resolve) => setTimeout(resolve));
      since = performance.now();
    }
  }

  private *streetBySteps(middle: Vector3, top: number): Generator<void, Vector3 | null> {
    const side = Math.max(...GRIDS_M.map(({ step, count }) => (step * count) / 2)) + LEVEL_WITHIN_M;
    const columns = new Columns(yield* gatherBySteps(this.blocks(), middle.x, middle.z, side * Math.SQRT2));
    yield* columns.fill(middle, side, top, FINE_PER_M);
    const heightAt = (x: number, z: number) => this.heightIn(columns.at(x, z), x, top, z);
    const found: Vector3[] = [];
    for (const { step, count } of GRIDS_M)
      for (let i = 0; i < count * count; i++) {
        const x = middle.x + step * ((i % count) - (count - 1) / 2);
        const z = middle.z + step * (Math.floor(i / count) - (count - 1) / 2);
        const y = heightAt(x, z);
        if (y !== null) found.push(new Vector3(x, y, z));
        yield;
      }
    const apart = (a: Vector3, b: Vector3) => Math.hypot(a.x - b.x, a.z - b.z);
    const isLow = (place: Vector3) => found.every((other) => place.y - other.y < ABOVE_M + SLOPE * apart(place, other));
    const isLevel = ({ x, y, z }: Vector3) =>
      [[1, 0], [0, 1], [-1, 0], [0, -1]].every(([east, south]) => {
        const beside = heightAt(x + LEVEL_WITHIN_M * east!, z + LEVEL_WITHIN_M * south!);
        return beside !== null && Math.abs(beside - y) < LEVEL_M;
      });
    found.sort((a, b) => apart(a, middle) - apart(b, middle));
    for (const place of found) {
      if (isLow(place) && isLevel(place)) return place;
      yield;
    }
    return null;
  }

  // Lets the eyes sink or rise to where they belong, within some seconds.
  settle(eye: Vector3, seconds: number) {
    const ground = this.heightIn(this.around(eye), eye.x, eye.y + STEP_UP_M, eye.z);
    if (ground === null) return;
    const off = ground + EYES_M - eye.y;
    eye.y += Math.abs(off) < 0.01 ? off : off * Math.min(1, 8 * seconds);
  }

  // A way over the ground in strides, as far as it is free; along a wall where it meets one. Moves the eyes.
  go(eye: Vector3, dx: number, dz: number) {
    const strides = Math.ceil(Math.hypot(dx, dz) / STRIDE_M);
    const [x, z] = [dx / strides, dz / strides];
    for (let i = 0; i < strides; i++) {
      if (this.stride(eye, x, z)) continue;
      const along = this.alongWall(eye, x, z);
      if (!along || !this.stride(eye, along.x, along.z)) return;
    }
  }

  // What of a stride goes along the wall before it, and a little off it where it is too near. null: nothing stands there,
  // or it is met head on.
  private alongWall(eye: Vector3, dx: number, dz: number): Vector3 | null {
    const cloud = this.around(eye);
    const way = new Vector3(dx, 0, dz);
    const ahead = way.clone().normalize();
    const right = new Vector3(-ahead.z, 0, ahead.x);
    const length = way.length();
    for (const up of BODY_UP_M) {
      const from = new Vector3(eye.x, eye.y - EYES_M + up, eye.z);
      const meet = (aside: number) => pickIn([cloud], new Ray(from.clone().addScaledVector(right, aside), ahead), FINE_PER_M);
      const wall = meet(0);
      if (!wall || wall.distanceTo(from) > length + BODY_M) continue;
      // Beside it the wall is farther on the side to which it leads on; on the other, one may be within it.
      const ends = [-BESIDE_M, BESIDE_M].map(meet).filter((end) => end !== null && end.distanceTo(wall) < WALL_MOST_M) as Vector3[];
      const far = ends.sort((a, b) => b.clone().sub(a).dot(ahead))[0];
      if (!far) return null;
      const tangent = far.sub(wall).setY(0).normalize();
      const share = way.dot(tangent);
      if (Math.abs(share) < HEAD_ON * length) return null;
      const off = way.clone().addScaledVector(tangent, -share).normalize().negate();
      const gap = from.clone().sub(wall).setY(0).dot(off);
      return tangent.multiplyScalar(share).addScaledVector(off, Math.min(0.2 * length, Math.max(0, BODY_M - gap)));
    }
    return null;
  }

  private stride(eye: Vector3, dx: number, dz: number): boolean {
    const length = Math.hypot(dx, dz);
    if (length < 1e-6) return false;
    const cloud = this.around(eye);
    const ahead = new Vector3(dx / length, 0, dz / length);
    const feet = eye.y - EYES_M;
    const ground = this.heightIn(cloud, eye.x + dx, eye.y, eye.z + dz);
    if (ground === null || ground - feet > STEP_UP_M || feet - ground > STEP_DOWN_M) return false;
    const stands = Math.max(feet, ground); // on a curb, what is met is met from above it
    const blocked = BODY_UP_M.some((up) => {
      const from = new Vector3(eye.x, stands + up, eye.z);
      const wall = pickIn([cloud], new Ray(from, ahead), FINE_PER_M);
      return wall !== null && wall.distanceTo(from) < length + BODY_M;
    });
    if (blocked) return false;
    eye.set(eye.x + dx, eye.y + (ground + EYES_M - eye.y) / 2, eye.z + dz);
    return true;
  }
}
