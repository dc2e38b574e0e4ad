/* JSON documents as bodies, and parts that most documents have.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_DOCUMENT_H
#define SERVER_DOCUMENT_H

#include "server/base/body.h"

struct json_t;

/* Appends the document's text to `out`. It takes over the reference to json. ERR_MEM. */
enum err_code document_write(struct json_t *json, struct buf *out, struct err *e) ERR_USE;
/* Makes a body of the document, with its gzip form. It takes over the reference to json; NULL means
 * out of memory. ERR_MEM. */
enum err_code document_make(struct json_t *json, struct body **out, struct err *e) ERR_USE;
/* Makes a body of bytes that were written already, and takes them over. `rc` is the result of
 * writing them: an error is returned unchanged. ERR_MEM. */
enum err_code document_take(enum err_code rc, struct buf *b, struct body **out,
                            struct err *e) ERR_USE;
/* A link object of OGC API. NULL: out of memory, which document_make reports. title may be NULL. */
struct json_t *document_link(const char *rel, const char *type, const char *href,
                             const char *title);
struct json_t *document_numbers(const double *v, size_t n);

#endif
