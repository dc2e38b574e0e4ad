/* Real spherical harmonics as colours have them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_SH_H
#define CORE_SH_H

#include <stdint.h>

#include "core/layout.h"
#include "core/splat/gauss.h"

/* Basis of real spherical harmonics up to `degree`, with INRIA's signs; the coefficients of higher
 * bands are 0. dir points from the eye to the Gaussian and has length 1. */
void sh_basis(const double dir[3], uint32_t degree, double out[LAYOUT_SH_MAX]);

#endif
