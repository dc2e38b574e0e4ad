// What is drawn at a point of the screen or at a place, by the Gaussians and layers that are here.
//
// SPDX-License-Identifier: Apache-2.0
import { Ray, Vector3 } from "three";

import type { City } from "./city";
import type { Place } from "./geo";
import type { Layers } from "./layers";
import { pickMedian } from "./pick";
import type { Stage } from "./stage";

const ABOVE_M = 200; // over most of the city: where one looks down from
const FINE_M = 0.25; // how finely

export class Probe {
  layers: Layers | null = null;

  constructor(
    private readonly surface: HTMLElement,
    private readonly stage: Stage,
    private readonly city: () => City | null,
  ) {}

  surfaceOn(ray: Ray): Vector3 | null {
    const perMetre =
      (2 * Math.tan((this.stage.camera.fov * Math.PI) / 360)) / Math.max(1, this.surface.clientHeight);
    const city = this.city();
    const point = city && pickMedian(city.engine.visibleBlocks, ray, perMetre);
    const other = (city && this.layers?.meet(ray)) ?? null;
    if (!point || !other) return point ?? other;
    return point.distanceTo(ray.origin) < other.distanceTo(ray.origin) ? point : other;
  }

  // In CSS pixels from the surface's corner; null for the sky.
  pick(x: number, y: number): Place | null {
    const point = this.surfaceOn(this.stage.ray(x, y));
    return point && this.stage.frame.placeOf(point);
  }

  // Of what is drawn, seen from straight above; null where there is nothing.
  heightOf({ lon, lat }: Pick<Place, "lon" | "lat">): number | null {
    const { frame, extent } = this.stage;
    const above = frame.pointOf({ lon, lat, h: 0 }).setY(extent.max.y + ABOVE_M);
    const perMetre = FINE_M / (above.y - extent.min.y + 1);
    const ray = new Ray(above, new Vector3(0, -1, 0));
    const city = this.city();
    const found = city && pickMedian(city.engine.visibleBlocks, ray, perMetre);
    return found && frame.placeOf(found).h;
  }

  // Above the ground of the surroundings, below roofs; null where it is not known.
  aboveGround(place: Place): number | null {
    const point = this.stage.frame.pointOf(place);
    const ground = this.city()?.groundAt(point) ?? null;
    return ground === null ? null : Math.max(0, point.y - ground);
  }
}
