/* The route table of the program: routes.def.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_ROUTES_H
#define SERVER_ROUTES_H

#include "server/route/route.h"

extern const struct route ROUTES[];
extern const size_t ROUTES_COUNT;

#endif
