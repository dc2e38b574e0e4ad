/* The address of the service as a client sees it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_ORIGIN_H
#define SERVER_ORIGIN_H

#include "server/response.h"

enum { ORIGIN_MAX = 512 };
/* What caches must tell answers apart by that hold origin_of. */
extern const char ORIGIN_VARY[], ORIGIN_VARY_ENCODED[]; /* without, with Accept-Encoding */
/* --public-url, else "https://HOST/BASE" by the request: its Host and the listener's scheme, behind
 * a trusted proxy (--trusted-proxy) X-Forwarded-Host and X-Forwarded-Proto where it sends them.
 * "": unknown. The host is no name, or a proxy that is not trusted stands between: it may have
 * another name. */
const char *origin_of(const struct services *s, const struct request *r, char out[ORIGIN_MAX]);

#endif
