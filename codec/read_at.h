/* Bytes that are read in parts: a file, or an object at a web server.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_READ_AT_H
#define CODEC_READ_AT_H

#include "core/base.h"

struct read_at {
    const char *name; /* for messages */
    uint64_t size_bytes;
    void *user;
    /* Reads n bytes, which lie within the size. Several threads may call it at once. Errors are the
     * source's own. */
    enum err_code (*read)(void *user, uint64_t at, void *out, size_t n, struct err *e);
};

#endif
