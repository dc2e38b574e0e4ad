/* The address of the service as a client sees it.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_ORIGIN_H
#define SERVER_ORIGIN_H

#include "server/response.h"

enum { ORIGIN_MAX = 512 };
/* Vary for answers that depend on origin_of. */
/* without Accept-Encoding, then with it */
extern const char ORIGIN_VARY[], ORIGIN_VARY_ENCODED[];
/* Writes the origin: --public-url, else "https://HOST/BASE" from the request. The request gives
 * Host and the listener's scheme; behind a trusted proxy (--trusted-proxy) it gives
 * X-Forwarded-Host and X-Forwarded-Proto if the proxy sends them. "": not known, because Host is no
 * valid name, or an untrusted proxy, which may have another name, is in between. */
const char *origin_of(const struct services *s, const struct request *r, char out[ORIGIN_MAX]);

#endif
