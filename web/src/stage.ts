// The camera and how a person moves it: mouse, touch, keyboard, gamepad. Needs no graphics card, so
// it drives the server's pictures as well.
//
// The camera is a place, a heading and a pitch, nothing else: any pose can be had and is kept as
// given. What moves it goes by the surface under the pointer: that point is held while dragging, is
// turned about, and is what zooming nears.
//
// SPDX-License-Identifier: Apache-2.0
import { Box3, Euler, MathUtils, Matrix4, PerspectiveCamera, Plane, Ray, Vector3 } from "three";

import { cornersOf } from "./extent";
import { Frame } from "./geo";
import type { Area } from "./free";
import { homeView } from "./homeview";
import { EYES_M, FOV_DEG, type Pose, type Walk } from "./pose";
import type { Walker } from "./walk";

const PITCH_MOST = MathUtils.degToRad(89.9);
const ABOVE_M = 200; // of most of the city: from there all of it is below

// Held keys and what they do per second.
type Action = "east" | "north" | "turn" | "tilt" | "zoom" | "rise";
const KEYS: Record<string, [action: Action, sign: number]> = {
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
  Space: ["rise", 1],
  KeyC: ["rise", -1],
};
const PAN_PER_S = 0.6; // of the distance to what is looked at
const WALK_M_S = 4;
const WALK_ZOOM_M = 3; // that a press of a button to zoom walks,
const WALK_WHEEL_M = 0.01; // a pixel of the wheel,
const WALK_PINCH_M = 8; // and fingers, for each natural logarithm
const TAP_S = 0.05; // a key counts for so long at least: a press may be over before the next frame, or lie in one after a rest
const PRESS_MS = 600; // what is held longer is no click
const TWICE_MS = 350; // between two presses of one
const TWICE_PX = 20;
const TWICE_ZOOM = 0.5;
const TWICE_S = 0.4;
const WALK_MOST_M = 40; // that two presses walk: longer ways would hold up the page
const TURN_RAD_PER_S = 1.2;
const ZOOM_PER_S = 1.5; // natural logarithm
const LOOK_RAD_PER_PX = 0.0035;
const GLIDE_S = 0.12; // how fast a throw dies out

// Keys belong to the scene unless a control that uses them has the focus.
export function isForScene(event: KeyboardEvent): boolean {
  const target = event.composedPath()[0];
  if (event.ctrlKey || event.metaKey || event.altKey) return false;
  if (!(target instanceof Element)) return true;
  const presses = ["Space", "Enter"].includes(event.code) && target.closest("button, a, summary");
  return !presses && target.closest("input, select, textarea, dialog[open]") === null;
}

// Of several in one page, keys and gamepad move the one that was touched or focused last.
const stages = new Set<Stage>();
let active: Stage | null = null;

interface Drag {
  kind: "pan" | "turn" | "look";
  x: number;
  y: number;
  pivot: Vector3;
}

export class Stage {
  readonly camera = new PerspectiveCamera(FOV_DEG, 1, 1, 10000);
  frame = new Frame(new Matrix4().makeTranslation(6378137, 0, 0)); // until a scene opens
  keyboard: boolean | "focus" = true; // "focus": keys count while the surface has it
  // The surface on a ray, where the owner knows it.
  surfaceOn: (ray: Ray) => Vector3 | null = () => null;
  free: () => Area = () => ({ left: 0, right: 1, top: 0, bottom: 1 }); // what nothing of the page covers
  onMove: () => void = () => {};
  onTouch: () => void = () => {}; // a person moved the camera
  onClick: (x: number, y: number) => void = () => {};
  onUnclick: () => void = () => {};
  onWalk: (how: Walk) => void = () => {};
  onHeld: (wheel: boolean) => void = () => {}; // a wheel or one finger, which scroll the page here
  shares: () => boolean = () => false; // the page around scrolls: one finger and a bare wheel are for it
  walker: Walker | null = null; // knows streets; null: nobody walks
  private before: Pose | null = null; // where somebody stood who walks now
  private searches = 0; // for streets, and what ended them
  heading = 0; // radians clockwise from north
  pitch = -0.6; // above the horizon
  private walking: Walk = "orbit";
  private readonly box = new Box3(new Vector3(-50, 0, -50), new Vector3(50, 20, 50));
  outline: readonly Vector3[] | null = null; // corners of what home shows; null: those of the box
  private readonly held = new Set<string>();
  private readonly tapped = new Set<string>(); // pressed since the last turn, if only shortly
  private readonly pointers = new Map<number, { x: number; y: number }>();
  private readonly last = { place: new Vector3(), heading: 0, pitch: 0, fov: 0 };
  private readonly throwing = new Vector3(); // metres a second
  private thrownAt = 0;
  private drag: Drag | null = null;
  // Times of presses are those of their events: a slow frame between two of them does not count.
  private pressed = { x: 0, y: 0, at: 0, moved: false };
  private clicked = { x: 0, y: 0, at: -Infinity }; // the last one
  private flight: { from: Pose; to: Pose; at: number; ms: number; done: () => void } | null = null;
  private readonly listening = new AbortController();

  constructor(private readonly surface: HTMLElement) {
    const { signal } = this.listening;
    const on = <K extends keyof HTMLElementEventMap>(
      name: K,
      run: (event: HTMLElementEventMap[K]) => void,
    ) => surface.addEventListener(name, run, { signal, passive: false });
    on("pointerdown", (event) => this.press(event));
    on("pointermove", (event) => this.move(event));
    on("pointerup", (event) => this.release(event));
    on("pointercancel", (event) => this.release(event));
    on("contextmenu", (event) => event.preventDefault());
    on("wheel", (event) => this.wheel(event));
    // Two fingers are ours: before a page can take them for scrolling.
    const keep = (event: TouchEvent) => event.touches.length > 1 && event.cancelable && event.preventDefault();
    on("touchstart", keep);
    on("touchmove", keep);
    surface.addEventListener("focusin", () => (active = this), { signal });
    stages.add(this);
    active ??= this;
    this.shareTouch();
    window.addEventListener("keydown", (event) => this.key(event), { signal });
    window.addEventListener("keyup", (event) => this.held.delete(event.code), { signal });
    window.addEventListener("blur", () => this.held.clear(), { signal });
    surface.addEventListener("pointerenter", () => this.shareTouch(), { signal });
  }

  private shareTouch() {
    this.surface.style.touchAction = this.shares() ? "pan-x pan-y" : "none";
  }

  dispose() {
    this.listening.abort();
    this.flight?.done();
    this.flight = null;
    stages.delete(this);
    if (active === this) [active = null] = stages;
  }

  get walk(): Walk {
    return this.walking;
  }

  // Walking ends where it began.
  set walk(how: "orbit" | "fly") {
    this.searches++;
    const { before } = this;
    this.become(how, null);
    if (before) this.flyOver(before);
  }

  private become(how: Walk, before: Pose | null) {
    if (how === this.walking) return;
    this.before = before;
    this.walking = how;
    if (how !== "orbit") this.onTouch();
    this.onMove();
    this.onWalk(how);
  }

  // Over to the street nearest to a place, level; from then on somebody walks. False where there is none. The search takes a
  // moment; who does something else meanwhile stays with that.
  async toStreet(near: Vector3): Promise<boolean> {
    const search = ++this.searches;
    const street = await this.walker?.street(this.box.clampPoint(near, new Vector3()), this.box.max.y + ABOVE_M);
    if (search !== this.searches || this.listening.signal.aborted) return true;
    if (!street) return false;
    const here = this.pose();
    this.flyOver({ ...this.frame.placeOf(street.setY(street.y + EYES_M)), pitch: 0 });
    this.become("walk", here);
    return true;
  }

  private flyOver(to: Partial<Pose>, seconds?: number) {
    void this.fly({ ...this.pose(), ...to }, seconds);
  }

  // Nobody walks or flies any more, and the camera stays.
  stand() {
    this.before = null;
    this.walk = "orbit";
  }

  // It moves the camera in the next turn of the loop, or may.
  get moves(): boolean {
    return this.flight !== null || this.held.size > 0 || this.tapped.size > 0 || this.pointers.size > 0 || this.throwing.lengthSq() >= 1e-4;
  }

  // A gamepad may be touched at any time, and has no events.
  get hasPad(): boolean {
    return this.pad !== null;
  }

  private get pad(): Gamepad | null {
    if (!this.keyboard || active !== this) return null;
    return navigator.getGamepads?.().find((one) => one?.connected) ?? null;
  }

  // What the camera looks at, in world metres. Heights are those of most Gaussians, so the lower
  // face is ground.
  setExtent(box: Box3) {
    this.box.copy(box);
    this.outline = null;
    this.adjustPlanes();
    this.onMove();
  }

  get extent(): Box3 {
    return this.box;
  }

  get ground(): number {
    return this.box.min.y;
  }

  // The whole city, or a box of the caller's, seen from above at an angle, in the part of the surface that is free. aspect:
  // of the surface, or near it.
  home(box: Box3 | null = null, aspect = this.camera.aspect) {
    const points = box ? cornersOf(box) : (this.outline ?? cornersOf(this.box));
    this.stand();
    this.land();
    this.camera.fov = FOV_DEG;
    const { heading, pitch, position } = homeView(points.map(({ x, y, z }) => [x, y, z] as const), { free: this.free(), aspect, fov: FOV_DEG });
    this.set(heading * MathUtils.DEG2RAD, pitch * MathUtils.DEG2RAD);
    this.camera.position.set(...position);
    this.halt();
  }

  pose(): Pose {
    this.camera.updateMatrixWorld();
    return this.frame.poseFrom(this.camera.position, this.camera.quaternion, this.camera.fov);
  }

  look(pose: Pose) {
    if (this.walking === "walk") this.stand();
    this.land();
    this.place(pose);
    this.halt();
  }

  private place(pose: Pose) {
    const { position, heading, pitch } = this.frame.cameraFrom(pose);
    this.camera.fov = pose.fov;
    this.camera.position.copy(position);
    this.set(heading, pitch);
  }

  // Over to another pose; resolves on arrival, or when a person takes over. At once where motion is
  // not wanted.
  fly(to: Pose, seconds = 2): Promise<void> {
    this.land();
    if (matchMedia("(prefers-reduced-motion: reduce)").matches || seconds <= 0) {
      this.place(to);
      this.halt();
      return Promise.resolve();
    }
    return new Promise((done) => {
      this.flight = { from: this.pose(), to, at: performance.now(), ms: 1000 * seconds, done };
      this.onMove();
    });
  }

  northUp() {
    const pivot = this.center();
    this.turnAbout(pivot, -this.heading, 0);
    this.onTouch();
    this.halt();
  }

  // Nearer by a factor, about what is in the middle of the picture.
  zoom(factor: number) {
    if (this.walking === "walk") this.stepOn(factor < 1 ? WALK_ZOOM_M : -WALK_ZOOM_M);
    else this.nearTo(this.center(), factor);
    this.onTouch();
    this.onMove();
  }

  resize(width: number, height: number) {
    this.shareTouch();
    this.camera.aspect = width / Math.max(1, height);
    this.camera.updateProjectionMatrix();
    this.onMove();
  }

  // Moves on by seconds; true while the camera moves.
  tick(seconds: number): boolean {
    this.stepFlight();
    this.applyKeys(seconds);
    this.applyGamepad(seconds);
    this.glide(seconds);
    if (this.walking === "walk" && !this.flight) this.walker?.settle(this.camera.position, seconds);
    this.adjustPlanes();
    const { last, camera } = this;
    const moved =
      last.place.distanceToSquared(camera.position) > 1e-8 ||
      Math.abs(last.heading - this.heading) + Math.abs(last.pitch - this.pitch) > 1e-6 ||
      last.fov !== camera.fov;
    last.place.copy(camera.position);
    last.heading = this.heading;
    last.pitch = this.pitch;
    last.fov = camera.fov;
    if (moved || this.flight) this.onMove();
    return moved || this.flight !== null;
  }

  // The ray through a point of the surface, in CSS pixels from its corner.
  ray(x: number, y: number): Ray {
    const { clientWidth, clientHeight } = this.surface;
    this.camera.updateMatrixWorld();
    const far = new Vector3((2 * x) / clientWidth - 1, 1 - (2 * y) / clientHeight, 0.5);
    far.unproject(this.camera).sub(this.camera.position).normalize();
    return new Ray(this.camera.position.clone(), far);
  }

  // The surface at a point of the picture, or the ground there, or a point ahead.
  under(x: number, y: number): Vector3 {
    const ray = this.ray(x, y);
    const hit = this.surfaceOn(ray);
    if (hit) return hit;
    const ground = ray.intersectPlane(new Plane(new Vector3(0, 1, 0), -this.ground), new Vector3());
    const reach = 3 * this.size();
    if (ground && ground.distanceTo(ray.origin) < reach) return ground;
    return ray.at(Math.min(reach, Math.max(10, this.box.distanceToPoint(ray.origin) + this.size() / 4)), new Vector3());
  }

  // ---- the camera itself ----

  private size(): number {
    return this.box.getSize(new Vector3()).length();
  }

  // What is in the middle of the picture.
  center(): Vector3 {
    return this.under(this.surface.clientWidth / 2, this.surface.clientHeight / 2);
  }

  private set(heading: number, pitch: number) {
    const round = 2 * Math.PI;
    this.heading = ((heading % round) + round) % round;
    this.pitch = MathUtils.clamp(pitch, -Math.PI / 2, Math.PI / 2);
    this.camera.quaternion.setFromEuler(new Euler(this.pitch, -this.heading, 0, "YXZ"));
  }

  private turnAbout(pivot: Vector3, heading: number, pitch: number) {
    const { camera } = this;
    const offset = camera.position.clone().sub(pivot).applyQuaternion(camera.quaternion.clone().invert());
    const before = this.pitch;
    this.set(this.heading + heading, MathUtils.clamp(before + pitch, -PITCH_MOST, PITCH_MOST));
    camera.position.copy(offset.applyQuaternion(camera.quaternion)).add(pivot);
    this.stayAbove();
  }

  // Towards a point, never through it.
  private nearTo(point: Vector3, factor: number) {
    const offset = this.camera.position.clone().sub(point);
    const most = 8 * this.size() + 100;
    offset.setLength(MathUtils.clamp(offset.length() * factor, 0.5, most));
    this.camera.position.copy(point).add(offset);
    this.stayAbove();
  }

  private stayAbove() {
    const least = this.ground + 0.5;
    if (this.camera.position.y < least) this.camera.position.y = least;
  }

  private halt() {
    this.throwing.set(0, 0, 0);
    this.drag = null;
    this.adjustPlanes();
    this.onMove();
  }

  private adjustPlanes() {
    const reach = this.size();
    const distance = this.box.distanceToPoint(this.camera.position);
    this.camera.near = MathUtils.clamp(distance / 4, 0.2, 100);
    this.camera.far = distance + 4 * reach + 1000;
    this.camera.updateProjectionMatrix();
  }

  private stepFlight() {
    const { flight } = this;
    if (!flight) return;
    const t = Math.min(1, (performance.now() - flight.at) / flight.ms);
    const s = t * t * (3 - 2 * t);
    const mix = (a: number, b: number) => a + (b - a) * s;
    const { from, to } = flight;
    const turn = ((to.heading - from.heading + 540) % 360) - 180;
    this.place({
      lon: mix(from.lon, to.lon),
      lat: mix(from.lat, to.lat),
      h: mix(from.h, to.h),
      heading: from.heading + turn * s,
      pitch: mix(from.pitch, to.pitch),
      fov: mix(from.fov, to.fov),
    });
    if (t === 1) {
      this.flight = null;
      flight.done();
    }
  }

  // A flight ends where it is, and whoever waits for it goes on.
  private land() {
    this.flight?.done();
    this.flight = null;
  }

  private takeOver() {
    if (this.walking === "walk" && this.flight) this.place(this.flight.to); // on the street, not above it
    this.land();
    this.throwing.set(0, 0, 0);
    this.onTouch();
  }

  // ---- pointers ----

  private local(event: MouseEvent): { x: number; y: number } {
    const box = this.surface.getBoundingClientRect();
    return { x: event.clientX - box.left, y: event.clientY - box.top };
  }

  private press(event: PointerEvent) {
    if (event.target instanceof Element && event.target.closest("[data-own]")) return;
    this.surface.focus({ preventScroll: true });
    this.surface.setPointerCapture(event.pointerId);
    const at = this.local(event);
    this.pointers.set(event.pointerId, at);
    const scrolls = event.pointerType === "touch" && this.shares();
    if (scrolls && this.pointers.size < 2) {
      this.pressed = { ...at, at: event.timeStamp, moved: false };
      this.drag = null;
      return;
    }
    this.takeOver();
    this.pressed = { ...at, at: event.timeStamp, moved: this.pointers.size > 1 };
    this.beginDrag(at, event.button === 2 || event.button === 1 || event.ctrlKey || event.shiftKey);
  }

  private beginDrag(at: { x: number; y: number }, turning: boolean) {
    if (this.pointers.size > 1) this.drag = null;
    else {
      const kind = this.walk !== "orbit" ? "look" : turning ? "turn" : "pan";
      const middle = { x: this.surface.clientWidth / 2, y: this.surface.clientHeight / 2 };
      const from = kind === "turn" ? middle : at;
      this.drag = { kind, ...at, pivot: this.under(from.x, from.y) };
    }
  }

  private move(event: PointerEvent) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const at = this.local(event);
    const { pressed } = this;
    if (Math.hypot(at.x - pressed.x, at.y - pressed.y) > 5) pressed.moved = true;
    if (this.pointers.size > 1) this.pinch(event.pointerId, before, at);
    else if (this.drag) this.dragTo(this.drag, at);
    else if (pressed.moved) this.onHeld(false);
    this.pointers.set(event.pointerId, at);
    this.onMove();
  }

  private dragTo(drag: Drag, at: { x: number; y: number }) {
    const [dx, dy] = [at.x - drag.x, at.y - drag.y];
    if (drag.kind === "pan") this.pan(drag.pivot, at);
    else if (drag.kind === "turn") this.turnAbout(drag.pivot, dx * 0.005, -dy * 0.005);
    else
      this.set(
        this.heading - dx * LOOK_RAD_PER_PX,
        MathUtils.clamp(this.pitch + dy * LOOK_RAD_PER_PX, -PITCH_MOST, PITCH_MOST),
      );
    drag.x = at.x;
    drag.y = at.y;
  }

  // Keeps the held point under the pointer, at the camera's height. Towards the horizon the plane
  // runs away, so a step is bounded by what a pixel is worth at that distance.
  private pan(pivot: Vector3, at: { x: number; y: number }) {
    const ray = this.ray(at.x, at.y);
    const plane = new Plane(new Vector3(0, 1, 0), -pivot.y);
    const step = new Vector3();
    const distance = pivot.distanceTo(this.camera.position);
    const hit = ray.intersectPlane(plane, new Vector3());
    if (hit && Math.abs(ray.direction.y) > 0.08 && hit.distanceTo(ray.origin) < 6 * distance) {
      step.copy(pivot).sub(hit);
    } else {
      step.copy(this.stepOf(distance, at.x - this.drag!.x, at.y - this.drag!.y));
    }
    step.y = 0;
    this.camera.position.add(step);
    this.throwing.lerp(step.multiplyScalar(60), 0.5);
    this.thrownAt = performance.now();
  }

  // What a move by some pixels is worth at a distance.
  private stepOf(distance: number, dx: number, dy: number): Vector3 {
    const perPx = (2 * distance * Math.tan((this.camera.fov * Math.PI) / 360)) / this.surface.clientHeight;
    const [sin, cos] = [Math.sin(this.heading), Math.cos(this.heading)];
    return new Vector3(-dx * cos + dy * sin, 0, -dx * sin - dy * cos).multiplyScalar(perPx);
  }

  private slide(pivot: Vector3, dx: number, dy: number) {
    this.camera.position.add(this.stepOf(pivot.distanceTo(this.camera.position), dx, dy));
  }

  // Two fingers: apart is nearer, round each other turns, up and down together tilts.
  private pinch(id: number, before: { x: number; y: number }, at: { x: number; y: number }) {
    const other = [...this.pointers].find(([key]) => key !== id)?.[1];
    if (!other) return;
    const span = (p: { x: number; y: number }) => Math.hypot(p.x - other.x, p.y - other.y);
    const angle = (p: { x: number; y: number }) => Math.atan2(p.y - other.y, p.x - other.x);
    const middle = { x: (at.x + other.x) / 2, y: (at.y + other.y) / 2 };
    const pivot = this.under(middle.x, middle.y);
    const nearer = MathUtils.clamp(span(before) / Math.max(10, span(at)), 0.5, 2);
    if (this.walking === "walk") return this.stepOn(-WALK_PINCH_M * Math.log(nearer));
    this.nearTo(pivot, nearer);
    // Where one finger is the page's, two move the ground, too.
    if (this.shares()) this.slide(pivot, (at.x - before.x) / 2, (at.y - before.y) / 2);
    let turn = angle(at) - angle(before);
    if (turn > Math.PI) turn -= 2 * Math.PI;
    if (turn < -Math.PI) turn += 2 * Math.PI;
    this.turnAbout(pivot, -turn, this.shares() ? 0 : -(at.y - before.y) * 0.002);
  }

  private release(event: PointerEvent) {
    if (!this.pointers.delete(event.pointerId)) return;
    const { pressed } = this;
    const still = !pressed.moved && event.timeStamp - pressed.at < PRESS_MS;
    this.drag = null;
    if (performance.now() - this.thrownAt > 60) this.throwing.set(0, 0, 0);
    const [rest] = this.pointers.values();
    if (rest && !this.shares()) this.beginDrag(rest, false);
    else if (still && event.type === "pointerup" && event.button === 0) this.click(pressed.x, pressed.y, event.timeStamp);
    this.onMove();
  }

  // Two presses of one place go nearer. The first is told at once, and taken back by the second.
  private click(x: number, y: number, at: number) {
    const { clicked } = this;
    const twice = at - clicked.at < TWICE_MS && Math.hypot(x - clicked.x, y - clicked.y) < TWICE_PX;
    this.clicked = { x, y, at: twice ? -Infinity : at };
    if (!twice) return this.onClick(x, y);
    this.onUnclick();
    this.goNearer(x, y);
  }

  private goNearer(x: number, y: number) {
    const { camera, walker } = this;
    const to = this.under(x, y);
    this.takeOver();
    if (this.walking === "walk") {
      const from = camera.position.clone();
      const most = Math.min(1, WALK_MOST_M / Math.max(1e-6, Math.hypot(to.x - from.x, to.z - from.z)));
      walker?.go(camera.position, most * (to.x - from.x), most * (to.z - from.z));
      to.copy(camera.position);
      camera.position.copy(from);
    } else to.lerp(camera.position, TWICE_ZOOM);
    this.flyOver(this.frame.placeOf(to), TWICE_S);
  }

  // On foot, along the view.
  private stepOn(metres: number) {
    this.walker?.go(this.camera.position, metres * Math.sin(this.heading), -metres * Math.cos(this.heading));
  }

  private wheel(event: WheelEvent) {
    if (this.shares() && !event.ctrlKey && !event.metaKey) return this.onHeld(true);
    event.preventDefault();
    this.takeOver();
    const lines = event.deltaMode === 1 ? 24 : event.deltaMode === 2 ? 400 : 1;
    const amount = MathUtils.clamp(event.deltaY * lines, -300, 300);
    const at = this.local(event);
    if (this.walking === "walk") this.stepOn(-amount * WALK_WHEEL_M);
    else this.nearTo(this.under(at.x, at.y), Math.exp(amount * 0.0016));
    this.onMove();
  }

  // After a throw the ground slides on for a moment.
  private glide(seconds: number) {
    if (this.drag || this.throwing.lengthSq() < 1e-4) return;
    if (matchMedia("(prefers-reduced-motion: reduce)").matches) this.throwing.set(0, 0, 0);
    this.camera.position.addScaledVector(this.throwing, seconds);
    this.throwing.multiplyScalar(Math.exp(-seconds / GLIDE_S));
    if (this.throwing.length() < 0.02) this.throwing.set(0, 0, 0);
  }

  // ---- keys and gamepad ----

  private key(event: KeyboardEvent) {
    if (!this.keyboard || active !== this || !(event.code in KEYS) || !isForScene(event)) return;
    if (this.keyboard === "focus" && !event.composedPath().includes(this.surface)) return;
    event.preventDefault();
    if (!this.held.size) this.takeOver();
    this.held.add(event.code);
    if (!event.repeat) this.tapped.add(event.code);
    this.onMove();
  }

  private applyKeys(seconds: number) {
    const pressed = new Set([...this.held, ...this.tapped]);
    if (!pressed.size) return;
    const amount: Record<Action, number> = { east: 0, north: 0, turn: 0, tilt: 0, zoom: 0, rise: 0 };
    for (const code of pressed) {
      const [action, sign] = KEYS[code]!;
      amount[action] += sign;
    }
    const least = this.tapped.size ? TAP_S : 0;
    this.tapped.clear();
    this.apply(amount, Math.max(least, Math.min(seconds, 0.1)));
  }

  private applyGamepad(seconds: number) {
    const { pad } = this;
    if (!pad) return;
    const axis = (i: number) => (Math.abs(pad.axes[i] ?? 0) > 0.15 ? pad.axes[i]! : 0);
    const button = (i: number) => pad.buttons[i]?.value ?? 0;
    const amount = {
      east: axis(0),
      north: -axis(1),
      turn: axis(2),
      tilt: -axis(3),
      zoom: button(7) - button(6),
      rise: button(0) - button(1),
    };
    if (Object.values(amount).some((v) => v !== 0)) {
      this.takeOver();
      this.apply(amount, Math.min(seconds, 0.1));
    }
  }

  private apply(amount: Record<Action, number>, dt: number) {
    const free = this.walk !== "orbit";
    const on = amount.north + (free ? amount.zoom : 0);
    const pivot = free ? this.camera.position.clone() : this.center();
    const distance = Math.max(2, this.camera.position.distanceTo(pivot));
    if (amount.turn || amount.tilt)
      this.turnAbout(pivot, amount.turn * TURN_RAD_PER_S * dt, amount.tilt * TURN_RAD_PER_S * dt);
    if (amount.zoom && !free) this.nearTo(pivot, Math.exp(-amount.zoom * ZOOM_PER_S * dt));
    const high = Math.max(2, this.camera.position.y - this.ground);
    const speed = this.walk === "walk" ? WALK_M_S : free ? Math.max(WALK_M_S, high) : distance * PAN_PER_S;
    const [sin, cos] = [Math.sin(this.heading), Math.cos(this.heading)];
    const step = new Vector3(
      amount.east * cos + on * sin,
      amount.rise + (this.walk === "fly" ? on * Math.sin(this.pitch) : 0),
      amount.east * sin - on * cos,
    ).multiplyScalar(speed * dt);
    if (this.walking === "walk") return this.walker?.go(this.camera.position, step.x, step.z);
    this.camera.position.add(step);
    if (on || amount.rise) this.stayAbove();
  }
}
