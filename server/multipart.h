/* Pictures of a stream, one after the other, as parts of multipart/x-mixed-replace: what of them
 * has been read, and what comes next. A part ends with the delimiter of the next one, because
 * browsers show a part when the delimiter behind it has come.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_MULTIPART_H
#define SERVER_MULTIPART_H

#include <stdbool.h>
#include <stddef.h>

#include "core/err.h"

struct body;

#define MULTIPART_BOUNDARY "citysplat-picture"
extern const char MULTIPART_TYPE[]; /* Content-Type of all of it */

enum { MULTIPART_HEAD = 384 };
struct multipart {
    char head[MULTIPART_HEAD];
    size_t n_head, at;    /* at: bytes of head, picture and tail that were read */
    struct body *picture; /* being read, owned; NULL: none */
};
/* What stands before the first picture. */
void multipart_begin(struct multipart *m);
bool multipart_is_read(const struct multipart *m); /* all of what there is */
/* The next part, once all was read: header fields, and the picture, whose reference is taken. */
void multipart_put(struct multipart *m, struct body *picture, const char *format, ...)
    ERR_PRINTF(3, 4);
/* Copy the next bytes, at most room. *read: a picture all of which was read, for the caller to drop
 * outside of its lock, or NULL. */
size_t multipart_read(struct multipart *m, char *out, size_t room, struct body **read);

#endif
