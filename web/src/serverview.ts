// The server's own rendering of the current camera, laid over the client's picture: faded or wiped,
// for comparison, or alone where the browser cannot draw Gaussians.
//
// SPDX-License-Identifier: Apache-2.0
import { Problem, type Server } from "./api";
import type { Pose } from "./geo";

const SIDE_MAX_PX = 2048; // what a server takes by default
const AREA_MAX_PX = 4e6;
const WAIT_MS = 350; // after the camera came to rest

export type Compare = "fade" | "wipe";

export class ServerView {
  open = false;
  onDrag: (amount: number) => void = () => {}; // the person moves the divider
  private compare: Compare = "wipe";
  private amount = 0.5;
  private timer = 0;
  private request: AbortController | null = null;
  private objectUrl = "";

  constructor(
    private readonly image: HTMLImageElement,
    private readonly divider: HTMLElement,
    private readonly say: (text: string, busy: boolean) => void,
  ) {
    image.addEventListener("load", () => image.classList.add("fresh"));
    divider.addEventListener("pointerdown", (event) => divider.setPointerCapture(event.pointerId));
    divider.addEventListener("pointermove", (event) => {
      if (divider.hasPointerCapture(event.pointerId))
        this.onDrag(1 - event.clientX / image.clientWidth);
    });
  }

  // How the two pictures share the screen; amount 0 is the client's, 1 the server's.
  setCompare(compare: Compare, amount: number) {
    this.compare = compare;
    this.amount = amount;
    this.layOut();
  }

  show(open: boolean) {
    this.open = open;
    this.image.hidden = !open;
    this.layOut();
    if (!open) this.cancel();
  }

  // The camera moved: the picture on the screen is of another place.
  stale() {
    if (!this.open) return;
    this.image.classList.remove("fresh");
    this.cancel();
  }

  // Ask for the picture once the camera has been still for a moment.
  schedule(server: Server, id: string, light: string, pose: Pose, width: number, height: number) {
    if (!this.open) return;
    this.cancel();
    const url = (w: number, h: number) => server.viewUrl(id, light, pose, w, h);
    this.timer = window.setTimeout(() => void this.fetch(server, url, width, height), WAIT_MS);
  }

  private cancel() {
    clearTimeout(this.timer);
    this.request?.abort();
    this.request = null;
  }

  private async fetch(
    server: Server,
    url: (width: number, height: number) => URL,
    width: number,
    height: number,
  ) {
    const shrink = Math.min(
      1,
      SIDE_MAX_PX / Math.max(width, height),
      Math.sqrt(AREA_MAX_PX / (width * height)),
    );
    const [w, h] = [
      Math.max(16, Math.round(width * shrink)),
      Math.max(16, Math.round(height * shrink)),
    ];
    const request = new AbortController();
    this.request = request;
    this.say("The server is rendering …", true);
    try {
      const { blob, milliseconds } = await server.view(url(w, h), request.signal);
      URL.revokeObjectURL(this.objectUrl);
      this.objectUrl = URL.createObjectURL(blob);
      this.image.src = this.objectUrl;
      const size =
        blob.size < 1e6
          ? `${Math.round(blob.size / 1e3)} kB`
          : `${(blob.size / 1e6).toFixed(1)} MB`;
      this.say(`${w} × ${h} px, ${size}, ${(milliseconds / 1000).toFixed(2)} s`, false);
    } catch (error) {
      if (request.signal.aborted) return;
      this.say(
        error instanceof Problem ? `${error.title}. ${error.message}` : String(error),
        false,
      );
    }
  }

  private layOut() {
    const wipe = this.compare === "wipe";
    const percent = 100 * (1 - this.amount);
    this.image.style.opacity = wipe ? "1" : String(this.amount);
    this.image.style.clipPath = wipe ? `inset(0 0 0 ${percent}%)` : "none";
    this.divider.hidden = !(this.open && wipe && this.amount > 0 && this.amount < 1);
    this.divider.style.left = `${percent}%`;
  }
}
