/* What host and kernels share: plain C that both an OpenCL 1.2 and a C17 compiler read. Sizes are asserted
 * on the host; a test asks the device for its own sizeof.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_LAYOUT_H
#define CORE_LAYOUT_H

#define LAYOUT_LANES 16 /* Gaussians per group of the AoSoA-16 parameter layout */
#define LAYOUT_TILE 16  /* pixels per tile edge */

#endif
