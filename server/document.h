/* JSON documents as bodies, and the parts that most of them have.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_DOCUMENT_H
#define SERVER_DOCUMENT_H

#include "server/body.h"

struct json_t;

/* The document's text, appended to out. json's reference is taken, as below. ERR_MEM. */
enum err_code document_write(struct json_t *json, struct buf *out, struct err *e) ERR_USE;
/* The document as a body, with its gzip form. json's reference is taken; NULL json is out of
 * memory. ERR_MEM. */
enum err_code document_make(struct json_t *json, struct body **out, struct err *e) ERR_USE;
/* Bytes that were written already, which are taken; rc says how that went and is passed on.
 * ERR_MEM.
 */
enum err_code document_take(enum err_code rc, struct buf *b, struct body **out,
                            struct err *e) ERR_USE;
/* A link object of OGC API; NULL when out of memory, which document_make notices. title may be
 * NULL.
 */
struct json_t *document_link(const char *rel, const char *type, const char *href,
                             const char *title);
struct json_t *document_numbers(const double *v, size_t n);

#endif
