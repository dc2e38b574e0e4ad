// What a picture of the test city must show, and what any picture of splats must.
//
// SPDX-License-Identifier: Apache-2.0
import { BALL, BLUE_TOP, F_ROWS, fCellCenter, NEEDLE, ORIGIN, RED_TOP } from "./city.mjs";
import { placeOfEnu, project } from "./geo.mjs";

// From the south, looking north and down: the F reads correctly. From the north for the ball's
// other colour.
export const SOUTH = { ...placeOfEnu(ORIGIN, [0, -200, 160]), heading: 0, pitch: -36, fov: 45 };
export const NORTH = { ...placeOfEnu(ORIGIN, [0, 200, 160]), heading: 180, pitch: -36, fov: 45 };

// Wide enough for differences of low-pass, level of detail and JPEG; far narrower than the
// distances between the colours of the city.
const IS = {
    yellow: ([r, g, b]) => r > 130 && g > 100 && b < 120 && r - b > 60,
    red: ([r, g, b]) => r > 140 && g < 90 && b < 90,
    blue: ([r, g, b]) => b > 140 && r < 110 && g < 130,
    magenta: ([r, g, b]) => r > 90 && b > 80 && g < 0.7 * Math.min(r, b),
    green: ([r, g, b]) => g > 80 && g > 1.25 * r && g > 1.25 * b,
    grey: ([r, g, b]) => Math.max(r, g, b) - Math.min(r, g, b) < 40 && r > 40 && r < 160,
};

class Probe {
    faults = [];
    constructor(png, pose) {
        this.png = png;
        this.pose = pose;
    }
    colorAt(enu) {
        const { png, pose } = this;
        const px = project(ORIGIN, pose, enu, png.width, png.height);
        if (!px) throw new Error(`${enu} is behind the camera`);
        return { px: px.map(Math.round), rgb: png.mean(px[0], px[1], 1).map(Math.round) };
    }
    want(color, enu, what) {
        const { px, rgb } = this.colorAt(enu);
        if (!IS[color](rgb))
            this.faults.push(`${what} at pixel ${px}: want ${color}, got rgb ${rgb}`);
    }
    wantNot(color, enu, what) {
        const { px, rgb } = this.colorAt(enu);
        if (IS[color](rgb))
            this.faults.push(`${what} at pixel ${px}: must not be ${color}, got rgb ${rgb}`);
    }
}

// Faults of a picture taken from SOUTH, as lines of text.
export function checkSouth(png) {
    const probe = new Probe(png, SOUTH);
    F_ROWS.forEach((line, row) => {
        [...line].forEach((cell, col) => {
            const place = fCellCenter(row, col);
            if (cell === "#") probe.want("yellow", place, `F cell ${row},${col}`);
            else probe.wantNot("yellow", place, `gap of the F ${row},${col}`);
        });
    });
    // Faces and roofs of the towers; their mirror images are ground.
    probe.want("red", [RED_TOP[0], -6, 20], "red tower");
    probe.want("red", [RED_TOP[0], RED_TOP[1], RED_TOP[2] + 0.5], "red roof");
    probe.want("grey", [-60, 5, 0], "ground opposite the red tower");
    probe.want("blue", [0, -7, 30], "blue tower");
    probe.want("blue", [BLUE_TOP[0], BLUE_TOP[1], BLUE_TOP[2] + 0.5], "blue roof");
    for (const t of [-1, -0.5, 0, 0.5, 1]) {
        const along = (sign) =>
            NEEDLE.center.map(
                (c, i) => c + t * NEEDLE.sigma * NEEDLE.dir[i] * (i === 0 ? sign : 1),
            );
        probe.want("magenta", along(1), `needle at ${t} sigma`);
        if (Math.abs(t) === 1)
            probe.wantNot("magenta", along(-1), `needle leaning the wrong way at ${t} sigma`);
    }
    probe.want("green", BALL.center, "ball from the south");
    return probe.faults;
}

export function checkNorth(png) {
    const probe = new Probe(png, NORTH);
    probe.want("magenta", BALL.center, "ball from the north");
    probe.want("red", [RED_TOP[0], 6, 20], "red tower");
    probe.want("blue", [0, 7, 30], "blue tower");
    probe.want("yellow", fCellCenter(6, 0), "foot of the F");
    return probe.faults;
}

// Share of pixels that differ from the corner-less background, and how many different colours there
// are.
export function measureContent(png, background = [0, 0, 0]) {
    let differ = 0;
    const colors = new Set();
    let n = 0;
    for (let y = 2; y < png.height; y += 4) {
        for (let x = 2; x < png.width; x += 4) {
            const rgb = png.at(x, y);
            n++;
            if (rgb.some((v, i) => Math.abs(v - background[i]) > 12)) differ++;
            colors.add(rgb.map((v) => v >> 4).join());
        }
    }
    return { share: differ / n, colors: colors.size };
}

// Root mean square difference of two pictures of one size, 0..255.
export function rmsDifference(a, b) {
    let sum = 0;
    let n = 0;
    for (let y = 0; y < a.height; y += 2) {
        for (let x = 0; x < a.width; x += 2) {
            const [p, q] = [a.at(x, y), b.at(x, y)];
            for (let k = 0; k < 3; k++) sum += (p[k] - q[k]) ** 2;
            n += 3;
        }
    }
    return Math.sqrt(sum / n);
}

// Of 255, over all pixels and colours.
export function meanDifference(a, b) {
    let sum = 0;
    for (let y = 0; y < a.height; y++)
        for (let x = 0; x < a.width; x++) {
            const [p, q] = [a.at(x, y), b.at(x, y)];
            for (let k = 0; k < 3; k++) sum += Math.abs(p[k] - q[k]);
        }
    return sum / (3 * a.width * a.height);
}
