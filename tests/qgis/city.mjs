// node city.mjs FOLDER: the test city of tests/web as FOLDER/city.tiles, and where things are in it as
// FOLDER/places.json, for show.py. CITYSPLAT_BIN names the program.
//
// SPDX-License-Identifier: Apache-2.0
import { writeFileSync } from "node:fs";
import { join } from "node:path";

import { BLUE_TOP, fCellCenter, ORIGIN, RED_TOP } from "../web/lib/city.mjs";
import { placeOfEnu } from "../web/lib/geo.mjs";
import { importCity } from "../web/lib/source.mjs";

const at = (enu) => {
    const { lon, lat } = placeOfEnu(ORIGIN, enu);
    return [lon, lat];
};
const [folder] = process.argv.slice(2);
importCity(folder);
const places = [
    { name: "the red tower", at: at(RED_TOP), color: "red" },
    { name: "the blue tower", at: at(BLUE_TOP), color: "blue" },
    { name: "the F", at: at(fCellCenter(3, 1)), color: "yellow" },
    { name: "the ground", at: at([25, -25, 0]), color: "grey" },
];
const heights = [
    { name: "the red tower", at: at(RED_TOP), m: ORIGIN.h + RED_TOP[2] },
    { name: "the blue tower", at: at(BLUE_TOP), m: ORIGIN.h + BLUE_TOP[2] },
    { name: "the ground", at: at([25, -25, 0]), m: ORIGIN.h },
];
writeFileSync(join(folder, "places.json"), JSON.stringify({ middle: at([0, 0, 0]), places, heights }));
