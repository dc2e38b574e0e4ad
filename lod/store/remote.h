/* Random access to an object at a web server or in a bucket, as to a file. Blocks come by range
 * requests (range.h), and stay on this machine (blocks.h).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef LOD_REMOTE_H
#define LOD_REMOTE_H

#include "lod/store/range.h"

struct remote; /* one reader; one thread at a time */

/* Opens the object at an address as it is now, with one request. *fd is the file of its blocks
 * (blocks.h), for this state of the object. Other processes may use that file as well. The caller
 * closes *fd. ERR_ARG, ERR_BUSY, ERR_NOENT, ERR_FORMAT, ERR_IO, ERR_LIMIT, ERR_MEM: see range_get.
 */
enum err_code remote_open(const char *url, int *fd, struct err *e) ERR_USE;
/* Makes a reader of such a file. fd is borrowed during the call. ERR_ARG, ERR_FORMAT, ERR_IO,
 * ERR_LIMIT, ERR_MEM. */
enum err_code remote_attach(int fd, struct remote **out, struct err *e) ERR_USE;
void remote_close(struct remote **r);
/* Returns whether fd is such a file. */
bool remote_is(int fd);
const char *remote_shown(const struct remote *r); /* the address for messages; borrowed */
uint64_t remote_size(const struct remote *r);
/* Reads n bytes, which must lie within the object. Each failure but ERR_MEM is ERR_BUSY: the bytes
 * are not available now, but the object may be sound. */
enum err_code remote_read(struct remote *r, uint64_t at, void *out, size_t n,
                          struct err *e) ERR_USE;
/* Announces that the next reads lie together, within this many bytes. 0: not known. */
void remote_expect(struct remote *r, uint64_t bytes);
/* The error of the last remote_read that failed; ERR_OK: none failed since remote_forgive. */
const struct err *remote_failed(const struct remote *r);
void remote_forgive(struct remote *r);
/* Returns whether any reader of the file has found that the server has another object now. */
bool remote_changed(const struct remote *r);
/* Asks the server. ERR_DATA: it has another object; else as range_get. */
enum err_code remote_check(struct remote *r, double wait_s, struct err *e) ERR_USE;

/* Sets how long a read may take, for all threads. Default: 15 s. Call it before threads start. */
void remote_patience(double wait_s);
/* Sets the time (clock_s()) at which reads of this thread end, if patience does not end them
 * earlier. 0: there is no such time. */
void remote_until(double until_s);

#endif
