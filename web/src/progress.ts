// What the viewer waits for, counted from the moment on at which it waited for nothing.
//
// SPDX-License-Identifier: Apache-2.0
import type { CityStats } from "./city";
import type { Layer } from "./layers";
import type { Progress } from "./types";

// What a wait can be told from.
export interface Doings {
  stats: CityStats;
  received: number; // bytes of everything
  scenes: number; // known
  open: boolean; // a scene is
  failed: boolean;
  describing: boolean; // documents of a scene are on their way
  relighting: boolean; // they are those of another appearance of this scene
  picture: boolean | null; // the server draws one; null: pictures are drawn here
  changing: boolean; // tiles in another light are on their way
  layers: readonly Layer[];
}

function phaseOf(doings: Doings): Progress["phase"] | null {
  const { stats, scenes, open, failed, describing, relighting, picture, changing, layers } = doings;
  const { pending, parsing } = stats;
  if (failed && !pending) return null;
  if (!open && !failed) return scenes ? "tileset" : "catalogue";
  if (describing) return relighting ? "appearance" : "tileset";
  if (picture !== null) return picture ? "picture" : null;
  if (changing) return "appearance";
  if (pending > parsing) return "tiles";
  if (parsing) return "decoding";
  return layers.some(({ state }) => state === "loading") ? "layers" : null;
}

export class Waits {
  private received = 0; // when it began to wait
  private came = 0;

  progress(doings: Doings): Progress | null {
    const { stats, received, layers } = doings;
    const { pending, came } = stats;
    const phase = phaseOf(doings);
    if (!phase) {
      this.received = received;
      this.came = came;
      return null;
    }
    if (came < this.came) this.came = came; // other tiles than those that were counted
    const bytes = received - this.received;
    const shown = layers.filter(({ state }) => state !== "loading").length;
    if (phase === "layers") return { phase, done: shown, total: layers.length, bytes: 0 };
    const done = came - this.came;
    const counted = phase === "tiles" || phase === "decoding" || (phase === "appearance" && pending > 0);
    return { phase, done: counted ? done : 0, total: counted ? done + pending : 0, bytes };
  }
}
