/* Large bodies in files of memory, from which libmicrohttpd sends without a copy.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef SERVER_BODY_FILE_H
#define SERVER_BODY_FILE_H

#include "server/base/body.h"

/* At most this many bodies lie in files, each of which takes a descriptor. 0, as it is at first:
 * none. */
void body_file_limit(size_t most);
/* Moves the bytes of a body of 128 KB and more into a file of memory. Where it has a compressed
 * form, or where there is no room for one more, it stays as it is. Call it before the body is
 * shared. */
void body_file_move(struct body *b);
/* A descriptor of the file, which the caller closes, and where in it `data` lies. -1: it is in no
 * file, or there are no more descriptors. */
int body_file_of(const struct body *b, const uint8_t *data, uint64_t *at);

#endif
