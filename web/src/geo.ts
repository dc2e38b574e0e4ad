// Camera poses in the scene's frame and back. The scene's world is three.js': x east, y up, z south,
// metres about the scene origin.
//
// SPDX-License-Identifier: Apache-2.0
import { WGS84_ELLIPSOID } from "3d-tiles-renderer/three";
import { Euler, MathUtils, Matrix4, Quaternion, Vector3 } from "three";

import type { Place, Pose } from "./pose";

export { formatPose, parsePose, type Place, type Pose } from "./pose";

const ENU_TO_WORLD = new Matrix4().makeBasis(
  new Vector3(1, 0, 0),
  new Vector3(0, 0, -1),
  new Vector3(0, 1, 0),
);

export class Frame {
  readonly worldFromEcef = new Matrix4();
  readonly ecefFromWorld = new Matrix4();

  // ecefFromEnu: the transform of a tileset's root, which turns east-north-up metres into ECEF.
  constructor(ecefFromEnu: Matrix4) {
    this.worldFromEcef.copy(ENU_TO_WORLD).multiply(ecefFromEnu.clone().invert());
    this.ecefFromWorld.copy(this.worldFromEcef).invert();
  }

  poseFrom(position: Vector3, rotation: Quaternion, fov: number): Pose {
    const eye = position.clone().applyMatrix4(this.ecefFromWorld);
    const { lat, lon, height } = WGS84_ELLIPSOID.getPositionToCartographic(eye, {});
    const enu = WGS84_ELLIPSOID.getEastNorthUpFrame(lat, lon, height, new Matrix4());
    const ahead = new Vector3(0, 0, -1)
      .applyQuaternion(rotation)
      .transformDirection(this.ecefFromWorld);
    ahead.transformDirection(enu.invert());
    return {
      lon: lon * MathUtils.RAD2DEG,
      lat: lat * MathUtils.RAD2DEG,
      h: height,
      heading: (Math.atan2(ahead.x, ahead.y) * MathUtils.RAD2DEG + 360) % 360,
      pitch: Math.asin(MathUtils.clamp(ahead.z, -1, 1)) * MathUtils.RAD2DEG,
      fov,
    };
  }

  placeOf(point: Vector3): Place {
    const eye = point.clone().applyMatrix4(this.ecefFromWorld);
    const { lat, lon, height } = WGS84_ELLIPSOID.getPositionToCartographic(eye, {});
    return { lon: lon * MathUtils.RAD2DEG, lat: lat * MathUtils.RAD2DEG, h: height };
  }

  pointOf({ lon, lat, h }: Place): Vector3 {
    return WGS84_ELLIPSOID.getCartographicToPosition(
      lat * MathUtils.DEG2RAD,
      lon * MathUtils.DEG2RAD,
      h,
      new Vector3(),
    ).applyMatrix4(this.worldFromEcef);
  }

  // World position and rotation of a camera at a pose.
  cameraFrom(pose: Pose): { position: Vector3; rotation: Quaternion } {
    const lat = pose.lat * MathUtils.DEG2RAD;
    const lon = pose.lon * MathUtils.DEG2RAD;
    const enu = WGS84_ELLIPSOID.getEastNorthUpFrame(lat, lon, pose.h, new Matrix4());
    const local = enu
      .premultiply(this.worldFromEcef)
      .multiply(new Matrix4().copy(ENU_TO_WORLD).invert());
    const position = new Vector3();
    const rotation = new Quaternion();
    local.decompose(position, rotation, new Vector3());
    const turn = new Euler(
      pose.pitch * MathUtils.DEG2RAD,
      -pose.heading * MathUtils.DEG2RAD,
      0,
      "YXZ",
    );
    return { position, rotation: rotation.multiply(new Quaternion().setFromEuler(turn)) };
  }
}
