// Clicks into the city, told with the place that is there. Who asks the server for it gets the answer later.
//
// SPDX-License-Identifier: Apache-2.0
import type { Place } from "./geo";

export class Clicks {
  onClick: (x: number, y: number, place: Place | null) => void = () => {};
  onUnclick: () => void = () => {};
  private last = { told: true }; // whether what is there was told

  // place: what is there; a promise where it is asked for.
  async tell(x: number, y: number, place: Place | null | Promise<Place | null>) {
    const asks = place instanceof Promise;
    const click = { told: false };
    this.last = click;
    const found = asks ? await place : place;
    if (this.last !== click && asks) return;
    click.told = true;
    this.onClick(x, y, found);
  }

  takeBack() {
    if (this.last.told) this.onUnclick();
    this.last = { told: true }; // one that the server has not answered is not told any more
  }
}
