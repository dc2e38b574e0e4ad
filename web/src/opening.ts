// The first view of a scene, and the server's picture of it, which stands before ours until that is whole.
//
// SPDX-License-Identifier: Apache-2.0
import { Vector3 } from "three";

import type { Pose } from "./geo";
import { cornersOfOutline, roughly } from "./homeview";
import { poseOfPoster, Poster, posterUrl } from "./poster";
import type { SceneEntry } from "./source";
import type { Stage } from "./stage";
import type { ViewerOptions } from "./types";

export class Opening {
  homeless = true; // the scene's extent is not known yet
  onGone: () => void = () => {}; // the poster
  private touched = false; // somebody has moved the camera
  private poster: Poster | null = null;
  private framed = ""; // the size of the surface whose first view is the poster's, which stays; "": it is not
  private postered: boolean; // the next scene comes behind one

  constructor(
    private readonly surface: HTMLElement,
    private readonly stage: Stage,
    private readonly options: ViewerOptions,
  ) {
    this.postered = options.poster === undefined && options.backdrop !== false; // it has sky and ground
    if (options.poster) this.hang(options.poster);
  }

  // A picture of the server stands before ours, or is on its way.
  get hasPoster(): boolean {
    return this.poster !== null;
  }

  // It is to be seen, or may come.
  get covers(): boolean {
    return this.poster?.there ?? false;
  }

  // The poster gives way.
  unveil(atOnce: boolean) {
    this.poster?.leave(atOnce);
  }

  // The camera is somebody's from now on.
  touch() {
    this.touched = true;
    this.unveil(true);
  }

  // And is nobody's again.
  home() {
    this.touched = false;
    this.unveil(true);
    this.stage.home();
  }

  // Home, where it may be another now and nobody has moved the camera.
  frameAgain() {
    if (!this.touched && !this.homeless && !this.framed) this.stage.home();
  }

  resize() {
    if (this.framed !== this.size) this.framed = "";
    this.frameAgain();
  }

  // The given view, else that of the poster that is there already, else home as it is known before any tile. The poster is
  // the picture of just that. same: the scene was open before; draws: this browser does.
  begin(entry: SceneEntry, appearance: string, given: Pose | null, same: boolean, draws: boolean) {
    const { stage, options } = this;
    if (entry.outline) stage.outline = cornersOfOutline(entry.outline).map((corner) => new Vector3(...corner));
    const hung = this.postered || same || !this.poster || !options.poster ? null : poseOfPoster(options.poster);
    const { clientWidth, clientHeight } = this.surface;
    const aspect = clientWidth / Math.max(1, clientHeight);
    const hangs = !same && this.postered && draws && entry.preview !== null;
    this.touched = given !== null;
    if (given) stage.look(given);
    else if (hung) stage.look(hung);
    else stage.home(null, hangs ? roughly(aspect) : aspect);
    const url = hangs && posterUrl(entry, appearance, given ?? stage.pose(), aspect);
    if (url) this.hang(url);
    this.framed = !given && (hung || url) ? this.size : "";
    this.postered = options.poster !== "" && options.backdrop !== false;
  }

  private hang(url: string) {
    this.unveil(true);
    this.poster = new Poster(this.surface, url);
    this.poster.onGone = (shown) => {
      this.poster = null;
      if (!shown) {
        this.framed = "";
        this.frameAgain();
      }
      this.onGone();
    };
  }

  private get size(): string {
    return `${this.surface.clientWidth} ${this.surface.clientHeight}`;
  }
}
