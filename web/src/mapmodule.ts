// What a page with a map of MapLibre needs, alone: the city as one of its layers.
//
// SPDX-License-Identifier: Apache-2.0
export { createMapLayer, MapLayer } from "./maplayer";
export type { Bounds, MapFrame, MapHost, MapLayerEvents, MapLayerOptions, MapLayerState } from "./maplayer";

export { Problem, type ProblemKind } from "./problem";
