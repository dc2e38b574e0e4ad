// What the viewer takes, tells and promises: the interface that docs/viewer.md names.
//
// SPDX-License-Identifier: Apache-2.0
import type { Place, Pose } from "./geo";
import type { Layer } from "./layers";
import type { LinkState } from "./link";
import type { PictureInfo } from "./pictures";
import type { Walk } from "./pose";
import type { Problem } from "./problem";
import type { Basemap, SceneEntry } from "./source";

export type Mode = "splats" | "pictures"; // drawn here, or by the server

// What createViewer() takes.
export interface ViewerOptions {
  // A citysplat server's folder, or a tileset.json on any file server. Default: the page's folder.
  url?: string | URL | (string | URL)[];
  scene?: string; // its id; default: the first
  pose?: Pose | null; // default: the whole scene
  appearance?: string; // default: ""
  mode?: Mode | "auto"; // auto: splats where there is WebGL 2
  colours?: "here" | "server"; // who computes those of an appearance; default: here, where that can be
  memoryMb?: number; // for tiles, on the card and in the page together
  detail?: number; // px that a typical Gaussian may have on the screen; default 1
  fadeMs?: number; // that levels take to fade into each other; 0: they change at once; default 280
  backdrop?: boolean; // sky and ground; default true
  basemap?: Basemap | null; // raster tiles on the ground around the city, of whoever it names; default: none
  theme?: "dark" | "light"; // dark: a dimmed sky; default light
  /** @internal */
  poster?: string; // address of the picture of the first view that the page shows already; "": no scene comes behind one
  keyboard?: boolean | "focus"; // keys move the camera; "focus": only while it has the focus; default true
}

// Events of the viewer, and what comes with each.
export interface ViewerEvents {
  scene: SceneEntry; // opened
  ready: ViewerState; // all that this view wants is on the screen
  // The camera moved.
  move: Pose;
  touch: null; // a person moved the camera
  walk: Walk; // how a person moves it now
  sight: boolean; // whether anything of the city is in the view that came to rest
  appearance: string; // the new one is on the screen
  preview: string; // it is there roughly, and the exact picture follows: where frames take long
  // Whether the server answers.
  link: LinkState;
  problem: Problem; // its kind, words, and the request that the server's log names
  slow: number; // frames a second: pictures of the server would be quicker
  // Another one draws.
  mode: Mode;
  context: boolean; // the graphics card dropped the page (true), or took it up again
  // A picture of the server is on the screen.
  picture: PictureInfo;
  // Pixels of the container, and what is there; null: the sky.
  click: { x: number; y: number; place: Place | null };
  unclick: null; // the last click was the first of two that go nearer: what it did is taken back
  layers: readonly Layer[]; // they changed
  frame: null; // something was drawn
  turn: null; // it looked at all that it does, which the state tells now; none while it rests
}

// What the viewer draws and waits for.
export interface ViewerState {
  ready: boolean; // what this view wants is drawn, all of it
  settled: boolean; // nothing more will come by itself
  // Who draws.
  mode: Mode;
  // Whether the server answers.
  link: LinkState;
  // The id of the city; null until one is open.
  scene: string | null;
  appearance: string; // on the screen
  wanted: string; // the appearance asked for
  tiles: number; // drawn
  gaussians: number; // drawn
  bytes: number; // of tiles
  received: number; // of everything
  // Tiles or pictures that are on their way.
  pending: number;
  // Bytes of tiles on the card and in the page.
  memory: number;
  // Memory is used up: the view is coarser than it wants.
  heldBack: boolean;
  // Tiles that are wanted and not to be had.
  broken: { name: string; why: string }[];
  // What went wrong last, in words; null: nothing.
  error: string | null;
  framesPerSecond: number; // 0 while nothing is drawn
  progress: Progress | null; // what it waits for; null: nothing
}

// What it waits for, and how far that is.
export interface Progress {
  // What is waited for.
  phase: "catalogue" | "tileset" | "tiles" | "decoding" | "appearance" | "picture" | "layers";
  done: number; // tiles of this wait, or layers
  total: number; // 0: not known
  bytes: number; // received since it began
}

// A tile that is wanted, and not to be had.
export interface Broken {
  name: string;
  why: string;
  tries: number;
  again: number; // performance.now() of the next attempt
}
