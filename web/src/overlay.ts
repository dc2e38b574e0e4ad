// Lines, areas and labels over the city, in places of the map. Lines hide behind the city where they
// are asked to. Labels are HTML, whole inside of the picture.
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
}

interface Entry {
  shape: Shape;
  object: Group;
  label: HTMLElement | null;
  anchor: Vector3;
}

const EDGE_PX = 4; // between a label and the edge of the picture

export class Overlay {
  /** @internal */
  readonly group = new Group();
  onWake: () => void = () => {};
  private readonly entries = new Map<number, Entry>();
  private readonly labels: HTMLElement;
  private readonly size = new Vector2(1, 1);
  private next = 1;

  /** @internal */
  constructor(
    surface: HTMLElement,
    private readonly stage: Stage,
  ) {
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
    const { x: across, y: down } = this.size;
    for (const { label, anchor } of this.entries.values()) {
      if (!label) continue;
      const at = anchor.clone().project(camera);
      label.hidden = !(at.z > -1 && at.z < 1 && Math.abs(at.x) < 1 && Math.abs(at.y) < 1);
      if (label.hidden) continue;
      const { offsetWidth: width, offsetHeight: height } = label;
      const inside = (start: number, length: number, whole: number) => Math.round(Math.max(EDGE_PX, Math.min(start, whole - length - EDGE_PX)));
      const x = inside(((at.x + 1) / 2) * across - width / 2, width, across);
      const y = inside(((1 - at.y) / 2) * down - 1.4 * height, height, down);
      label.style.transform = `translate(${x}px, ${y}px)`;
    }
  }

  dispose() {
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
    return { shape, object, label, anchor };
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
