/* What the sender of a request may do, by a token, a session or a signed address (auth.h).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_PERMISSIONS_H
#define SERVER_PERMISSIONS_H

#include "server/access/auth.h"
#include "server/base/request.h"
#include "server/route/target.h"

/* AUTH_OK where there is no --auth. t NULL: the path does not count. ds NULL with AUTH_ADMIN. */
enum auth_answer permissions_check(const struct request *r, const struct target *t,
                                   enum auth_need need, const char *ds);
/* Returns whether everybody may read a dataset. */
bool permissions_is_public(const struct request *r, const char *ds);

#endif
