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

const STEEP = 0.999; // the sine from which the direction of the view tells no heading

// Clockwise from north, in degrees, of vectors in the horizon (east, north): of the view or, where that is steep, of
// what is right in the picture.
function headingOf(ahead: [number, number], right: [number, number], sine: number): number {
  const steep = Math.abs(sine) > STEEP;
  const radians = steep ? Math.atan2(-right[1], right[0]) : Math.atan2(ahead[0], ahead[1]);
  return (radians * MathUtils.RAD2DEG + 360) % 360;
}

/** @internal */
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
    const local = enu.invert().multiply(this.ecefFromWorld);
    const turned = (x: number, z: number) =>
      new Vector3(x, 0, z).applyQuaternion(rotation).transformDirection(local);
    const [ahead, right] = [turned(0, -1), turned(1, 0)];
    return {
      lon: lon * MathUtils.RAD2DEG,
      lat: lat * MathUtils.RAD2DEG,
      h: height,
      heading: headingOf([ahead.x, ahead.y], [right.x, right.y], ahead.z),
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

  // World position and rotation of a camera at a pose, and where it looks: radians, in the scene's own horizon.
  cameraFrom(pose: Pose): { position: Vector3; rotation: Quaternion; heading: number; pitch: number } {
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
    rotation.multiply(new Quaternion().setFromEuler(turn));
    const ahead = new Vector3(0, 0, -1).applyQuaternion(rotation);
    const right = new Vector3(1, 0, 0).applyQuaternion(rotation);
    const heading = headingOf([ahead.x, -ahead.z], [right.x, -right.z], ahead.y) * MathUtils.DEG2RAD;
    return { position, rotation, heading, pitch: Math.asin(MathUtils.clamp(ahead.y, -1, 1)) };
  }
}
