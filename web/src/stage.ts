// The camera and how a person moves it: mouse and touch through three.js' MapControls, the keyboard
// here. Needs no graphics card, so it also drives the server-rendered view of browsers without
// WebGL 2.
//
// SPDX-License-Identifier: Apache-2.0
import { Box3, MathUtils, Matrix4, PerspectiveCamera, Spherical, Vector3 } from "three";
import { MapControls } from "three/addons/controls/MapControls.js";

import { Frame, type Pose } from "./geo";

const FOV_DEG = 45;
const HOME_HEADING_DEG = 20;
const HOME_PITCH_DEG = -38;
const MARGIN = 1.1;

// Held keys and what they do per second.
const KEYS: Record<string, [action: "east" | "north" | "turn" | "tilt" | "zoom", sign: number]> = {
  ArrowRight: ["east", 1],
  KeyD: ["east", 1],
  ArrowLeft: ["east", -1],
  KeyA: ["east", -1],
  ArrowUp: ["north", 1],
  KeyW: ["north", 1],
  ArrowDown: ["north", -1],
  KeyS: ["north", -1],
  KeyE: ["turn", 1],
  KeyQ: ["turn", -1],
  KeyR: ["tilt", 1],
  KeyF: ["tilt", -1],
  Equal: ["zoom", 1],
  NumpadAdd: ["zoom", 1],
  PageUp: ["zoom", 1],
  Minus: ["zoom", -1],
  NumpadSubtract: ["zoom", -1],
  PageDown: ["zoom", -1],
};
const PAN_PER_S = 0.6; // of the distance to the target
const TURN_RAD_PER_S = 1.2;
const ZOOM_PER_S = 1.5; // natural logarithm

// Keys belong to the scene unless a control that uses them has the focus.
export function isForScene(event: KeyboardEvent): boolean {
  const { target } = event;
  const busy = target instanceof Element && target.closest("input, select, dialog[open]") !== null;
  return !busy && !event.ctrlKey && !event.metaKey && !event.altKey;
}

export class Stage {
  readonly camera = new PerspectiveCamera(FOV_DEG, 1, 1, 10000);
  readonly controls: MapControls;
  frame = new Frame(new Matrix4().makeTranslation(6378137, 0, 0)); // until a scene opens
  private readonly box = new Box3(new Vector3(-50, 0, -50), new Vector3(50, 20, 50));
  private readonly held = new Set<string>();
  private readonly last = { position: new Vector3(), target: new Vector3() };

  onMove: () => void = () => {};

  constructor(surface: HTMLElement) {
    this.controls = new MapControls(this.camera, surface);
    this.controls.enableDamping = true;
    this.controls.dampingFactor = 0.15;
    this.controls.zoomToCursor = true;
    this.controls.maxPolarAngle = MathUtils.degToRad(88);
    this.controls.addEventListener("change", () => this.onMove());
    window.addEventListener("keydown", (event) => this.press(event));
    window.addEventListener("keyup", (event) => this.held.delete(event.code));
    window.addEventListener("blur", () => this.held.clear());
  }

  // What the camera looks at, in world metres. Heights are those of most Gaussians, so the lower
  // face is ground.
  setExtent(box: Box3) {
    this.box.copy(box);
    const size = box.getSize(new Vector3()).length();
    this.controls.minDistance = Math.max(1, size / 500);
    this.controls.maxDistance = Math.max(100, size * 6);
  }

  // The whole extent, seen from above at an angle.
  home() {
    const target = this.box.getCenter(new Vector3());
    target.y = MathUtils.lerp(this.box.min.y, this.box.max.y, 0.3);
    const away = new Vector3().setFromSpherical(
      new Spherical(
        1,
        MathUtils.degToRad(90 + HOME_PITCH_DEG),
        MathUtils.degToRad(-HOME_HEADING_DEG),
      ),
    );
    this.camera.fov = FOV_DEG;
    const distance = this.distanceToFit(target, away) * MARGIN;
    this.controls.target.copy(target);
    this.camera.position.copy(target).addScaledVector(away, distance);
    this.settle();
  }

  // Smallest distance from which all corners of the extent are inside the frustum.
  private distanceToFit(target: Vector3, away: Vector3): number {
    const right = new Vector3(0, 1, 0).cross(away).normalize();
    const up = away.clone().cross(right);
    const tanY = Math.tan(MathUtils.degToRad(this.camera.fov / 2));
    const tanX = tanY * this.camera.aspect;
    let distance = 0;
    for (let i = 0; i < 8; i++) {
      const corner = new Vector3(
        i & 1 ? this.box.max.x : this.box.min.x,
        i & 2 ? this.box.max.y : this.box.min.y,
        i & 4 ? this.box.max.z : this.box.min.z,
      ).sub(target);
      const toward = corner.dot(away);
      const needX = toward + Math.abs(corner.dot(right)) / tanX;
      const needY = toward + Math.abs(corner.dot(up)) / tanY;
      distance = Math.max(distance, needX, needY);
    }
    return distance;
  }

  pose(): Pose {
    this.camera.updateMatrixWorld();
    return this.frame.poseFrom(this.camera.position, this.camera.quaternion, this.camera.fov);
  }

  look(pose: Pose) {
    const { position, rotation } = this.frame.cameraFrom(pose);
    this.camera.fov = pose.fov;
    this.camera.position.copy(position);
    this.camera.quaternion.copy(rotation);
    // MapControls turn about a target: the ground in front of the camera, or a point ahead of it.
    const ahead = new Vector3(0, 0, -1).applyQuaternion(rotation);
    const size = this.box.getSize(new Vector3()).length();
    const fall = (position.y - this.box.min.y) / Math.max(-ahead.y, 1e-6);
    const distance =
      ahead.y < -0.02 && fall > 1 ? Math.min(fall, size * 2) : Math.max(size / 4, 10);
    this.controls.target.copy(position).addScaledVector(ahead, distance);
    this.settle();
  }

  northUp() {
    const offset = this.camera.position.clone().sub(this.controls.target);
    const angles = new Spherical().setFromVector3(offset);
    angles.theta = 0;
    this.camera.position.copy(this.controls.target).add(offset.setFromSpherical(angles));
    this.settle();
  }

  zoom(factor: number) {
    const offset = this.camera.position.clone().sub(this.controls.target);
    const { minDistance, maxDistance } = this.controls;
    offset.setLength(MathUtils.clamp(offset.length() * factor, minDistance, maxDistance));
    this.camera.position.copy(this.controls.target).add(offset);
  }

  resize(width: number, height: number) {
    this.camera.aspect = width / Math.max(1, height);
    this.camera.updateProjectionMatrix();
    this.onMove();
  }

  // Moves on by seconds; true while the camera moves.
  tick(seconds: number): boolean {
    this.applyKeys(seconds);
    this.controls.update(seconds);
    this.adjustPlanes();
    const moved =
      this.last.position.distanceToSquared(this.camera.position) > 1e-8 ||
      this.last.target.distanceToSquared(this.controls.target) > 1e-8;
    this.last.position.copy(this.camera.position);
    this.last.target.copy(this.controls.target);
    if (moved || this.held.size) this.onMove();
    return moved || this.held.size > 0;
  }

  private settle() {
    const damping = this.controls.enableDamping;
    this.controls.enableDamping = false; // stops any motion that was under way
    this.controls.update();
    this.controls.enableDamping = damping;
    this.adjustPlanes();
    this.onMove();
  }

  private adjustPlanes() {
    const reach = this.box.getSize(new Vector3()).length();
    const distance = this.box.distanceToPoint(this.camera.position);
    this.camera.near = MathUtils.clamp(distance / 4, 0.2, 100);
    this.camera.far = distance + 4 * reach + 1000;
    this.camera.updateProjectionMatrix();
  }

  private press(event: KeyboardEvent) {
    if (!(event.code in KEYS) || !isForScene(event)) return;
    event.preventDefault();
    this.held.add(event.code);
    this.onMove();
  }

  private applyKeys(seconds: number) {
    const dt = Math.min(seconds, 0.1);
    const move = { east: 0, north: 0, turn: 0, tilt: 0, zoom: 0 };
    for (const code of this.held) {
      const [action, sign] = KEYS[code]!;
      move[action] += sign * dt;
    }
    if (!Object.values(move).some((v) => v !== 0)) return;
    const target = this.controls.target;
    const offset = this.camera.position.clone().sub(target);
    const angles = new Spherical().setFromVector3(offset);
    angles.theta -= move.turn * TURN_RAD_PER_S;
    angles.phi = MathUtils.clamp(
      angles.phi - move.tilt * TURN_RAD_PER_S,
      0.01,
      this.controls.maxPolarAngle,
    );
    angles.radius *= Math.exp(-move.zoom * ZOOM_PER_S);
    angles.radius = MathUtils.clamp(
      angles.radius,
      this.controls.minDistance,
      this.controls.maxDistance,
    );
    const step = angles.radius * PAN_PER_S;
    const [sin, cos] = [Math.sin(angles.theta), Math.cos(angles.theta)];
    target.x += step * (move.east * cos - move.north * sin);
    target.z -= step * (move.east * sin + move.north * cos);
    this.camera.position.copy(target).add(offset.setFromSpherical(angles));
  }
}
