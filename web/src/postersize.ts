// Sizes of the pictures that are shown before the viewer's own. They are few, so that the server makes each picture once:
// one covers the surface, and its height is that of the view.
//
// SPDX-License-Identifier: Apache-2.0
const HEIGHT_PX = 360;
const WIDTHS_PX = [270, 450, 640, 900]; // the least that covers the surface

// "640x360" for a surface of this shape.
export function posterSize(aspect: number): string {
  return `${WIDTHS_PX.find((width) => width >= aspect * HEIGHT_PX) ?? WIDTHS_PX.at(-1)!}x${HEIGHT_PX}`;
}
