// The test city: nothing in it is symmetric, so every wrong axis, mirrored scene or swapped byte
// shows.
//
// Seen from the south: a yellow F lies on grey ground to the south-west and reads correctly, a blue
// tower stands in the centre, a red one to the east, and one long magenta Gaussian, the needle,
// leans up towards the east in the north-east. A ball in the south-east is green from the south and
// magenta from the north (spherical harmonics of degree 1). Positions are east-north-up metres
// about ORIGIN.
//
// SPDX-License-Identifier: Apache-2.0

export const ORIGIN = { lon: 13.4, lat: 52.5, h: 80 };

// Letter cells of CELL metres, first row north. The F covers [-60, -25] x [-75, -26] at height 1 m.
export const F_ROWS = ["#####", "#....", "#....", "####.", "#....", "#....", "#...."];
export const F_CELL_M = 7;
export const F_WEST_M = -60;
export const F_NORTH_M = -26;

// Sampling places for tests: [east, north, up] metres.
export const RED_TOP = [55, 0, 30];
export const BLUE_TOP = [0, 0, 45];
export const NEEDLE = { center: [50, 50, 28], dir: [Math.SQRT1_2, 0, Math.SQRT1_2], sigma: 10 };
export const BALL = { center: [45, -55, 14], radius: 10 };

export function fCellCenter(row, col) {
    return [F_WEST_M + (col + 0.5) * F_CELL_M, F_NORTH_M - (row + 0.5) * F_CELL_M, 1];
}

function splat(pos, sigma, rgb, opacity = 0.95, quat = [1, 0, 0, 0], sh1 = null) {
    return { pos, sigma, rgb, opacity, quat, sh1 };
}

function ground(out) {
    for (let e = -88; e <= 88; e += 8) {
        for (let n = -88; n <= 88; n += 8) {
            out.push(splat([e, n, 0], [4, 4, 0.3], [0.42, 0.43, 0.45], 0.9));
        }
    }
}

function letter(out) {
    const step = F_CELL_M / 4;
    F_ROWS.forEach((line, row) => {
        [...line].forEach((cell, col) => {
            if (cell !== "#") return;
            const [e, n, u] = fCellCenter(row, col);
            for (let i = 0; i < 4; i++) {
                for (let j = 0; j < 4; j++) {
                    const pos = [e + (i - 1.5) * step, n + (j - 1.5) * step, u];
                    out.push(splat(pos, [0.9, 0.9, 0.25], [0.98, 0.85, 0.05]));
                }
            }
        });
    });
}

// The skin of an upright box: four walls and a roof.
function tower(out, cx, cy, half, height, rgb) {
    const step = 1.6;
    const wall = (e, n, u) => out.push(splat([e, n, u], [0.9, 0.9, 0.9], rgb));
    for (let u = 0.8; u < height; u += step) {
        for (let t = -half; t <= half; t += step) {
            wall(cx + t, cy - half, u);
            wall(cx + t, cy + half, u);
            wall(cx - half, cy + t, u);
            wall(cx + half, cy + t, u);
        }
    }
    for (let e = -half; e <= half; e += step) {
        for (let n = -half; n <= half; n += step) wall(cx + e, cy + n, height);
    }
}

// The needle's long axis is its local z: the quaternion (wxyz) turns z to dir.
function needle(out) {
    const { center, dir, sigma } = NEEDLE;
    const half = Math.acos(dir[2]) / 2; // dir lies in the east-up plane: a turn about north
    const quat = [Math.cos(half), 0, Math.sin(half), 0];
    out.push(splat(center, [0.8, 0.8, sigma], [0.95, 0.05, 0.9], 0.99, quat));
}

// Grey, brighter green when the view goes north (d = +y): degree-1 colour is -0.4886 y sh1[0] + ...
function ball(out) {
    const { center, radius } = BALL;
    const count = 300;
    const sh1 = [0.8, -0.8, 0.8, 0, 0, 0, 0, 0, 0];
    for (let i = 0; i < count; i++) {
        const z = 1 - (2 * (i + 0.5)) / count;
        const r = Math.sqrt(1 - z * z);
        const a = i * Math.PI * (3 - Math.sqrt(5)); // golden-angle spiral
        const pos = [
            center[0] + radius * r * Math.cos(a),
            center[1] + radius * r * Math.sin(a),
            center[2] + radius * z,
        ];
        out.push(splat(pos, [1.1, 1.1, 1.1], [0.5, 0.5, 0.5], 0.95, [1, 0, 0, 0], sh1));
    }
}

// All Gaussians: pos (ENU m), sigma (m), rgb 0..1, opacity 0..1, quat wxyz, sh1 9 numbers
// (coefficient-major) or null.
export function makeCity() {
    const out = [];
    ground(out);
    letter(out);
    tower(out, 0, 0, 7, 45, [0.08, 0.2, 0.95]);
    tower(out, 55, 0, 6, 30, [0.95, 0.06, 0.06]);
    needle(out);
    ball(out);
    return out;
}

// The test city again and again, side by side: so many a side, so far apart.
export function manyCities(copies, apartM) {
    const one = makeCity();
    const at = Array.from({ length: copies }, (_, i) => apartM * (i - (copies - 1) / 2));
    return at.flatMap((e) => at.flatMap((n) => one.map((g) => ({ ...g, pos: [g.pos[0] + e, g.pos[1] + n, g.pos[2]] }))));
}
