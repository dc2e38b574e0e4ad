/* Pictures of a stream as parts of multipart/x-mixed-replace: the bytes that were read, and the
 * next ones. A part ends with the delimiter of the next one, because browsers show a part only when
 * the delimiter after it has arrived.
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
extern const char MULTIPART_TYPE[];       /* Content-Type of the stream */
extern const char MULTIPART_FRAME_TYPE[]; /* of a frame of VP9 (RFC 9628) */

enum { MULTIPART_HEAD = 384 };
struct multipart {
    char head[MULTIPART_HEAD];
    size_t n_head, at;    /* at: number of bytes of head, picture and tail that were read */
    struct body *picture; /* the picture that is being read, owned; NULL: none */
};
/* Prepares the bytes before the first picture. */
void multipart_begin(struct multipart *m);
bool multipart_is_read(const struct multipart *m); /* all bytes were read */
/* Adds the next part when all was read: header fields, and the picture, whose reference it takes
 * over. */
void multipart_put(struct multipart *m, struct body *picture, const char *format, ...)
    ERR_PRINTF(3, 4);
/* Copies the next bytes, at most `room`. *read: a picture that was read completely, which the
 * caller drops without its lock; or NULL. */
size_t multipart_read(struct multipart *m, char *out, size_t room, struct body **read);

#endif
