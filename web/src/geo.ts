// Camera poses as maps give them, and the scene's frame.
//
// The scene's world is three.js': x east, y up, z south, metres about the scene origin. A pose is a
// place on WGS 84 (degrees, ellipsoidal height), a heading clockwise from north, a pitch above the
// horizon and a vertical field of view; heading and pitch are measured in the horizon at the
// camera.
//
// SPDX-License-Identifier: Apache-2.0
import { WGS84_ELLIPSOID } from "3d-tiles-renderer/three";
import { Euler, MathUtils, Matrix4, Quaternion, Vector3 } from "three";

export interface Place {
  lon: number;
  lat: number;
  h: number; // above the ellipsoid
}

export interface Pose extends Place {
  heading: number;
  pitch: number;
  fov: number;
}

const FOV_DEFAULT = 60;

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

// "lon,lat,h@heading,pitch,fov", as in the server's static views.
export function formatPose(pose: Pose): string {
  const { lon, lat, h, heading, pitch, fov } = pose;
  const turn = heading.toFixed(3) === "360.000" ? "0.000" : heading.toFixed(3);
  return `${lon.toFixed(7)},${lat.toFixed(7)},${h.toFixed(2)}@${turn},${pitch.toFixed(3)},${fov.toFixed(1)}`;
}

// fov may be left out: the server's default then.
export function parsePose(text: string): Pose | null {
  const [place = "", turn = "", ...rest] = text.split("@");
  const number = (v: string) => (v.trim() === "" ? NaN : Number(v));
  const [lon = NaN, lat = NaN, h = NaN, ...more] = place.split(",").map(number);
  const [heading = NaN, pitch = NaN, fov = FOV_DEFAULT, ...others] = turn.split(",").map(number);
  const numbers = [lon, lat, h, heading, pitch, fov];
  if (rest.length || more.length || others.length || !numbers.every(Number.isFinite)) return null;
  if (Math.abs(lon) > 180 || Math.abs(lat) > 90 || Math.abs(pitch) > 90 || fov < 1 || fov > 160)
    return null;
  return { lon, lat, h, heading, pitch, fov };
}
