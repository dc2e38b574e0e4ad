/* The functions that rows of routes.def name. A new row needs no declaration. Each function fills a
 * response. It does not block and cannot fail: a failure is an answer, too. The family
 * answer_<family> is in answer_<family>.c. Functions that several families use are in
 * answer_<family>.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_ANSWER_H
#define SERVER_ANSWER_H

#include "server/answers/response.h"

#define ANSWER_DECLARE(f)                                                                          \
    void f(struct services *s, const struct request *r, struct dataset *d, const struct target *t, \
           struct response *out);
#define GET(f, gives, about) ANSWER_DECLARE(f)
#define STREAM(f, gives, about) ANSWER_DECLARE(f)
#define POST(f, takes, gives, about) ANSWER_DECLARE(f)
#define PUT(f, takes, gives, about) ANSWER_DECLARE(f)
#define DELETE(f, gives, about) ANSWER_DECLARE(f)
#define ROUTE(name, path, scope, cache, rate, query, on) on
#include "server/route/routes.def"
#undef ROUTE
#undef GET
#undef STREAM
#undef POST
#undef PUT
#undef DELETE
#undef ANSWER_DECLARE

#endif
