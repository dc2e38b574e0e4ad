/* Parts of a stream: see multipart.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/http/multipart.h"

#include <assert.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "server/base/body.h"

const char MULTIPART_TYPE[] = "multipart/x-mixed-replace; boundary=" MULTIPART_BOUNDARY;
const char MULTIPART_FRAME_TYPE[] = "video/VP9";
static const char multipart_tail[] = "\r\n--" MULTIPART_BOUNDARY "\r\n";
enum { MULTIPART_TAIL = sizeof multipart_tail - 1 };

void multipart_begin(struct multipart *m)
{
    *m = (struct multipart){0};
    m->n_head = (size_t)snprintf(m->head, sizeof m->head, "%s", multipart_tail + 2);
}

bool multipart_is_read(const struct multipart *m)
{
    return !m->picture && m->at == m->n_head;
}

void multipart_put(struct multipart *m, struct body *picture, const char *format, ...)
{
    va_list ap;
    va_start(ap, format);
    int n = vsnprintf(m->head, sizeof m->head, format, ap);
    va_end(ap);
    assert(n > 0 && (size_t)n < sizeof m->head);
    m->n_head = (size_t)n;
    m->at = 0;
    m->picture = picture;
}

/* Copy what of [from, from + n) of the part lies at m->at and has room. */
static size_t multipart_copy(struct multipart *m, size_t from, const void *bytes, size_t n,
                             char *out, size_t room)
{
    if (m->at < from || m->at >= from + n || !room)
        return 0;
    size_t at = m->at - from, k = n - at < room ? n - at : room;
    memcpy(out, (const char *)bytes + at, k);
    m->at += k;
    return k;
}

size_t multipart_read(struct multipart *m, char *out, size_t room, struct body **read)
{
    size_t n = multipart_copy(m, 0, m->head, m->n_head, out, room);
    *read = NULL;
    if (!m->picture)
        return n;
    size_t size = m->picture->size;
    n += multipart_copy(m, m->n_head, m->picture->data, size, out + n, room - n);
    n += multipart_copy(m, m->n_head + size, multipart_tail, MULTIPART_TAIL, out + n, room - n);
    if (m->at == m->n_head + size + MULTIPART_TAIL) {
        *read = m->picture;
        m->picture = NULL;
        m->at = m->n_head;
    }
    return n;
}
