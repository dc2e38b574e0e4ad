// WGS 84, the ENU frame at a place, and the picture a camera pose takes: enough to predict where a
// point of the city must appear. Written apart from the client's and the server's code so that it
// can judge both.
//
// SPDX-License-Identifier: Apache-2.0

const A = 6378137;
const E2 = 6.69437999014e-3;
const RAD = Math.PI / 180;

// lon, lat in degrees, h ellipsoidal metres -> ECEF metres.
export function ecefFrom({ lon, lat, h }) {
    const s = Math.sin(lat * RAD);
    const c = Math.cos(lat * RAD);
    const n = A / Math.sqrt(1 - E2 * s * s);
    return [
        (n + h) * c * Math.cos(lon * RAD),
        (n + h) * c * Math.sin(lon * RAD),
        (n * (1 - E2) + h) * s,
    ];
}

// The ENU -> ECEF matrix at a place, column-major, as a 3D Tiles transform.
export function enuToEcef(place) {
    const [sl, cl] = [Math.sin(place.lon * RAD), Math.cos(place.lon * RAD)];
    const [sp, cp] = [Math.sin(place.lat * RAD), Math.cos(place.lat * RAD)];
    const [x, y, z] = ecefFrom(place);
    return [-sl, cl, 0, 0, -sp * cl, -sp * sl, cp, 0, cp * cl, cp * sl, sp, 0, x, y, z, 1];
}

export function applyMatrix(m, [x, y, z]) {
    return [0, 1, 2].map((i) => m[i] * x + m[4 + i] * y + m[8 + i] * z + m[12 + i]);
}

// ECEF -> lon, lat, h (Bowring's start, then fixed-point steps; below a micrometre here).
export function placeFrom([x, y, z]) {
    const p = Math.hypot(x, y);
    let lat = Math.atan2(z, p * (1 - E2));
    let h = 0;
    for (let i = 0; i < 8; i++) {
        const s = Math.sin(lat);
        const n = A / Math.sqrt(1 - E2 * s * s);
        h = p / Math.cos(lat) - n;
        lat = Math.atan2(z, p * (1 - (E2 * n) / (n + h)));
    }
    return { lon: Math.atan2(y, x) / RAD, lat: lat / RAD, h };
}

// A point of the ENU frame at origin as a place.
export function placeOfEnu(origin, enu) {
    return placeFrom(applyMatrix(enuToEcef(origin), enu));
}

// Pixel (x right, y down) at which a camera sees an ENU point; null when it is behind the camera.
// pose: place of the eye, heading clockwise from north, pitch above the horizon, fov vertical;
// degrees.
export function project(origin, pose, enu, width, height) {
    const eye = enuToEcef(pose);
    const p = applyMatrix(enuToEcef(origin), enu);
    const d = [p[0] - eye[12], p[1] - eye[13], p[2] - eye[14]];
    const local = [0, 1, 2].map(
        (i) => d[0] * eye[4 * i] + d[1] * eye[4 * i + 1] + d[2] * eye[4 * i + 2],
    );
    const [sh, ch] = [Math.sin(pose.heading * RAD), Math.cos(pose.heading * RAD)];
    const [sp, cp] = [Math.sin(pose.pitch * RAD), Math.cos(pose.pitch * RAD)];
    const right = local[0] * ch - local[1] * sh;
    const ahead = local[0] * sh + local[1] * ch;
    const depth = ahead * cp + local[2] * sp;
    const up = -ahead * sp + local[2] * cp;
    if (depth <= 0) return null;
    const f = height / 2 / Math.tan((pose.fov * RAD) / 2);
    return [width / 2 + (f * right) / depth, height / 2 - (f * up) / depth];
}
