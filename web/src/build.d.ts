// What the build puts into the scripts.
//
// SPDX-License-Identifier: Apache-2.0
declare const __VERSION__: string; // of package.json
declare const __ASSETS__: string; // folder of assets/, from the script
