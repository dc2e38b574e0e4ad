// Lines, areas and labels over the city, in places of the map. Lines hide behind the city where they
// are asked to. Labels are HTML, whole inside of the picture; notes keep out of panels, and go where the city or a panel is in
// front of them.
//
// SPDX-License-Identifier: Apache-2.0
import {
  BufferAttribute,
  BufferGeometry,
  Color,
  DoubleSide,
  Group,
  Mesh,
  MeshBasicMaterial,
  Ray,
  ShapeUtils,
  Vector2,
  Vector3,
  type Material,
} from "three";
import { LineMaterial } from "three/addons/lines/LineMaterial.js";
import { LineSegments2 } from "three/addons/lines/LineSegments2.js";
import { LineSegmentsGeometry } from "three/addons/lines/LineSegmentsGeometry.js";

import type { Place } from "./geo";
import type { Stage } from "./stage";

export interface Shape {
  kind: "line" | "area" | "point" | "label";
  places: Place[];
  holes?: Place[][]; // of an area
  color?: string;
  label?: string; // at its middle
  behind?: boolean; // hidden where the city is in front of it; default false
  note?: boolean; // shown whole or not at all: not where the city is in front of its place
}

interface Entry {
  shape: Shape;
  object: Group;
  label: HTMLElement | null;
  anchor: Vector3;
  covered: boolean; // of a note: the city is in front of it, or a panel
  box: { left: number; right: number; middle: number }; // of the label, as it is or would be, in CSS pixels
}

const EDGE_PX = 4; // between a label and the edge of the picture
const COVER_MS = 150; // after the last frame: what notes are hidden by is looked up
const COVER_BUSY_MS = 12; // of that, at a time: each note is a walk over all Gaussians
const RAISED_M = 1; // a note is looked for so far above its foot
const COVER_M = 2; // nearer to a note than this, or than this part of the way, the city does not hide it
const COVER_SHARE = 0.02;

export class Overlay {
  /** @internal */
  readonly group = new Group();
  onWake: () => void = () => {};
  private readonly entries = new Map<number, Entry>();
  private readonly surface: HTMLElement;
  private readonly labels: HTMLElement;
  private readonly size = new Vector2(1, 1);
  private next = 1;
  private coverTimer = 0;

  /** @internal */
  constructor(
    surface: HTMLElement,
    private readonly stage: Stage,
  ) {
    this.surface = surface;
    this.group.renderOrder = 5;
    this.labels = document.createElement("div");
    this.labels.className = "citysplat-labels";
    Object.assign(this.labels.style, { position: "absolute", inset: "0", pointerEvents: "none", overflow: "hidden" });
    surface.append(this.labels);
  }

  // Returns a number to change or remove it by.
  add(shape: Shape): number {
    const id = this.next++;
    this.entries.set(id, this.build(shape));
    this.onWake();
    return id;
  }

  change(id: number, shape: Shape) {
    this.drop(id);
    this.entries.set(id, this.build(shape));
    this.onWake();
  }

  remove(id: number) {
    this.drop(id);
    this.entries.delete(id);
    this.onWake();
  }

  // Another scene has another frame: all that is drawn is placed anew.
  reset() {
    for (const [id, { shape }] of [...this.entries]) this.change(id, shape);
  }

  resize(width: number, height: number) {
    this.size.set(width, height);
    for (const { object } of this.entries.values())
      object.traverse((node) => {
        if (node instanceof LineSegments2) node.material.resolution.copy(this.size);
      });
  }

  // Some shape wants to know what the city hides.
  get needsDepth(): boolean {
    return [...this.entries.values()].some(({ shape }) => shape.behind && shape.kind !== "label");
  }

  // Labels to where their places are on the screen; after every change of the camera.
  update() {
    const { camera } = this.stage;
    const whole = { left: 0, right: this.size.x, top: 0, bottom: this.size.y };
    let free: typeof whole | null = null; // what panels leave
    for (const entry of this.entries.values()) {
      const { label, anchor, shape, covered } = entry;
      if (!label) continue;
      if (shape.note) free ??= this.free();
      const at = anchor.clone().project(camera);
      label.hidden = !(at.z > -1 && at.z < 1 && Math.abs(at.x) < 1 && Math.abs(at.y) < 1);
      if (label.hidden) continue;
      const { offsetWidth: width, offsetHeight: height } = label;
      const [px, py] = [((at.x + 1) / 2) * this.size.x, ((1 - at.y) / 2) * this.size.y];
      const among = free && shape.note && px > free.left && px < free.right && py > free.top && py < free.bottom;
      const { left, right, top, bottom } = among ? free! : whole;
      const inside = (start: number, length: number, from: number, to: number) => Math.round(Math.max(from + EDGE_PX, Math.min(start, to - length - EDGE_PX)));
      const x = inside(px - width / 2, width, left, right);
      const y = inside(py - 1.4 * height, height, top, bottom);
      label.style.transform = `translate(${x}px, ${y}px)`;
      entry.box = { left: x, right: x + width, middle: y + height / 2 };
      label.hidden = covered;
    }
    const notes = free !== null;
    if (!notes) return;
    clearTimeout(this.coverTimer);
    this.coverTimer = window.setTimeout(() => this.lookUp([...this.entries.values()]), COVER_MS);
  }

  private free() {
    const { left, right, top, bottom } = this.stage.free();
    const { x, y } = this.size;
    return { left: left * x, right: right * x, top: top * y, bottom: bottom * y };
  }

  // Whether something of the page lies over an end of a note's label.
  private isUnder({ left, right, middle }: Entry["box"]): boolean {
    const root = this.surface.getRootNode() as Document | ShadowRoot;
    const { x, y } = this.surface.getBoundingClientRect();
    const hits = [left, right].map((at) => root.elementFromPoint(x + at, y + middle));
    return hits.some((hit) => hit !== null && !this.surface.contains(hit) && !hit.contains(this.surface));
  }

  // Which notes the city or a panel is in front of, once the picture rests.
  private lookUp(left: Entry[], changed = false) {
    const end = performance.now() + COVER_BUSY_MS;
    const { camera } = this.stage;
    for (let one = left.pop(); one; one = left.pop()) {
      if (!one.shape.note) continue;
      const to = one.anchor.clone().setY(one.anchor.y + RAISED_M).sub(camera.position);
      const far = to.length();
      const hit = this.stage.surfaceOn(new Ray(camera.position.clone(), to.normalize()));
      const behind = hit !== null && hit.distanceTo(camera.position) < far - Math.max(COVER_M, COVER_SHARE * far);
      const covered = behind || this.isUnder(one.box);
      changed ||= covered !== one.covered;
      one.covered = covered;
      one.object.visible = !covered;
      if (performance.now() > end && left.length) {
        this.coverTimer = window.setTimeout(() => this.lookUp(left, changed), 0);
        return;
      }
    }
    if (changed) this.onWake();
  }

  dispose() {
    clearTimeout(this.coverTimer);
    for (const id of [...this.entries.keys()]) this.drop(id);
    this.entries.clear();
    this.labels.remove();
  }

  private drop(id: number) {
    const entry = this.entries.get(id);
    if (!entry) return;
    entry.label?.remove();
    this.group.remove(entry.object);
    entry.object.traverse((node) => {
      if (!(node instanceof Mesh)) return;
      (node.geometry as BufferGeometry).dispose();
      (node.material as Material).dispose();
    });
  }

  private build(shape: Shape): Entry {
    const points = shape.places.map((place) => this.stage.frame.pointOf(place));
    const object = new Group();
    const color = new Color(shape.color ?? "#ffd166");
    const closed = shape.kind === "area" && points.length > 2;
    const path = closed ? [...points, points[0]!] : points;
    if (path.length > 1 && shape.kind !== "label") object.add(this.line(path, color, shape.behind ?? false));
    const holes = (shape.holes ?? []).map((ring) => ring.map((place) => this.stage.frame.pointOf(place)));
    if (closed) object.add(this.fill(points, holes, color, shape.behind ?? false));
    for (const [first, ...rest] of holes)
      if (first) object.add(this.line([first, ...rest, first], color, shape.behind ?? false));
    if (shape.kind === "point")
      for (const point of points) {
        const foot = point.clone();
        const top = point.clone().setY(point.y + 4);
        object.add(this.line([foot, top], color, shape.behind ?? false));
      }
    this.group.add(object);
    const anchor = points.reduce((sum, p) => sum.add(p), new Vector3()).divideScalar(points.length || 1);
    let label: HTMLElement | null = null;
    if (shape.label) {
      label = document.createElement("span");
      label.className = "citysplat-label";
      label.textContent = shape.label;
      Object.assign(label.style, { position: "absolute", left: "0", top: "0", width: "max-content", maxWidth: "min(260px, 60vw)", overflowWrap: "anywhere" });
      this.labels.append(label);
    }
    return { shape, object, label, anchor, covered: false, box: { left: 0, right: 0, middle: 0 } };
  }

  private line(points: Vector3[], color: Color, behind: boolean): LineSegments2 {
    const geometry = new LineSegmentsGeometry();
    const pairs: number[] = [];
    for (let i = 1; i < points.length; i++) pairs.push(...points[i - 1]!.toArray(), ...points[i]!.toArray());
    geometry.setPositions(pairs);
    const material = new LineMaterial({ linewidth: 3, depthTest: behind, depthWrite: false, transparent: true });
    material.color.copy(color);
    material.resolution.copy(this.size);
    const line = new LineSegments2(geometry, material);
    line.frustumCulled = false;
    line.renderOrder = 6;
    return line;
  }

  private fill(points: Vector3[], holes: Vector3[][], color: Color, behind: boolean): Mesh {
    const [flat, ...cut] = [points, ...holes].map((ring) => ring.map((p) => new Vector2(p.x, p.z)));
    const index = ShapeUtils.triangulateShape(flat!, cut).flat();
    const geometry = new BufferGeometry();
    const corners = new Float32Array([points, ...holes].flat().flatMap((p) => p.toArray()));
    geometry.setAttribute("position", new BufferAttribute(corners, 3));
    geometry.setIndex(index);
    const material = new MeshBasicMaterial({
      color,
      opacity: 0.25,
      transparent: true,
      side: DoubleSide,
      depthTest: behind,
      depthWrite: false,
    });
    const mesh = new Mesh(geometry, material);
    mesh.frustumCulled = false;
    mesh.renderOrder = 5;
    return mesh;
  }
}
