// The parts of CesiumJS that the globe uses, bundled apart (vite.config.ts): bundling them with the
// rest takes minutes.
//
// SPDX-License-Identifier: Apache-2.0
export {
  Cartesian2,
  Cartesian3,
  Cesium3DTileset,
  CesiumWidget,
  CustomHeightmapTerrainProvider,
  EasingFunction,
  HeadingPitchRange,
  ImageryLayer,
  Math as CesiumMath,
  PerspectiveFrustum,
  ScreenSpaceEventHandler,
  ScreenSpaceEventType,
  TileMapServiceImageryProvider,
  buildModuleUrl,
} from "@cesium/engine";
