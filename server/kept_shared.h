/* Named appearances in an object at a web server or in a bucket, which several servers share. For
 * kept.c.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_KEPT_SHARED_H
#define SERVER_KEPT_SHARED_H

#include "server/kept_table.h"

/* The object's text, from and to a table. shown: its address, for messages. ERR_FORMAT: it is no
 * list of names. ERR_MEM. */
enum err_code kept_shared_parse(const char *shown, const void *bytes, size_t n,
                                struct kept_table **out, struct err *e) ERR_USE;
enum err_code kept_shared_text(const struct kept_table *t, struct buf *out, struct err *e) ERR_USE;

struct kept_shared; /* one connection; one thread at a time */
/* Prepares a connection. ERR_ARG, ERR_LIMIT, ERR_MEM. */
enum err_code kept_shared_open(const char *url, struct kept_shared **out, struct err *e) ERR_USE;
void kept_shared_close(struct kept_shared **k);
/* Reads the names, in one request. *newer NULL: they are those of `have`. No object: no names.
 * ERR_FORMAT: the object is no list of names, or its server cannot be used (range_whole). ERR_BUSY:
 * temporary. ERR_IO, ERR_MEM. */
enum err_code kept_shared_read(struct kept_shared *k, const struct kept_table *have, double until_s,
                               struct kept_table **newer, struct err *e) ERR_USE;
/* Writes t in place of the state with this tag ("": there is no object), in one request, and sets
 * t->etag. ERR_DATA, ERR_BUSY, ERR_IO, ERR_MEM as range_put. */
enum err_code kept_shared_write(struct kept_shared *k, const char *etag, struct kept_table *t,
                                double until_s, struct err *e) ERR_USE;
/* Tries whether the server heeds the conditions of a PUT. If it does not, it gets `have` again.
 * ERR_FORMAT: it does not. Other errors are those of range_put. */
enum err_code kept_shared_probe(struct kept_shared *k, const struct kept_table *have,
                                double until_s, struct err *e) ERR_USE;

#endif
