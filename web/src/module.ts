// What other pages import: the viewer, the layer for maps, the element <city-splat>, which this defines.
//
// SPDX-License-Identifier: Apache-2.0
import { CitySplatElement } from "./embed";

export * from "./viewer";

export { createMapLayer, MapLayer } from "./maplayer";
export type { Bounds, MapControl, MapFrame, MapHost, MapLayerEvents, MapLayerOptions, MapLayerState } from "./maplayer";


export { CitySplatElement, type Attribute, type CitySplatEvents } from "./embed";

// Where a page is made on a server there are no elements. A second copy of this module leaves the first.
if (typeof customElements === "object" && !customElements.get("city-splat"))
  customElements.define("city-splat", CitySplatElement);
